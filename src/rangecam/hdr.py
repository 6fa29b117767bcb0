"""Several exposures of one scene, merged: bright pixels from the short one, dark ones from the long one.

A raw frame of several exposures has planes named exposure_<microseconds>us_<plane>, for example
exposure_2000us_phase_90. `ranged` gives each exposure to the ranging method and merges what comes back.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rangecam.errors import DataError
from rangecam.types import Image, RangeImage, RawFrame, Why

_EXPOSURE = re.compile(r"exposure_(\d+)us_(.+)")
SHORTEST, SHORTEST_SHARE = "shortest_", "shortest_share"
"""Planes beside those of an exposure: the same of the shortest one, and the shortest time over that of the exposure."""
_AGREE = 3.0
"""Exposures that differ from the best by more than so many standard deviations saw something else: it moved."""


def ranged(method: Callable[..., RangeImage], raw: RawFrame, camera: Any) -> RangeImage:
    """Return the range image of a raw frame, merged from all its exposures if it has several.

    Raises DataError as `exposures` does, or what `method` raises.
    """
    if not next(iter(raw.planes)).startswith("exposure_"):
        return method(raw, camera)
    parts = exposures(raw)
    images = [method(_beside_shortest(part, time_s, parts), camera) for time_s, part in parts.items()]
    return merge(images, list(parts))


def _beside_shortest(part: RawFrame, time_s: float, parts: Mapping[float, RawFrame]) -> RawFrame:
    """Return the frame of one exposure with the samples of the shortest, which tell what a saturated pixel saw."""
    shortest_s = min(parts)
    if time_s == shortest_s:
        return part
    shortest = {SHORTEST + name: plane for name, plane in parts[shortest_s].planes.items()}
    share = np.broadcast_to(np.float32(shortest_s / time_s), part.shape)
    return RawFrame(part.time_s, {**part.planes, **shortest, SHORTEST_SHARE: share}, part.frame_id)


def exposure_plane(time_s: float, plane: str) -> str:
    """Return the name of a plane of one of several exposures."""
    return f"exposure_{round(time_s * 1e6)}us_{plane}"


def exposures(raw: RawFrame) -> Mapping[float, RawFrame]:
    """Return a raw frame for each exposure (s), the shortest first.

    Planes that no exposure has of its own, such as those of a calibration, go with all of them. Raises DataError for a
    plane that some exposures have and that names none.
    """
    planes: dict[float, dict[str, Image]] = {}
    shared: dict[str, Image] = {}
    for name, plane in raw.planes.items():
        found = _EXPOSURE.fullmatch(name)
        if found is None or int(found[1]) == 0:
            shared[name] = plane
        else:
            planes.setdefault(int(found[1]) * 1e-6, {})[found[2]] = plane
    own = {name for each in planes.values() for name in each}
    for name in shared:
        if name in own or name.startswith("exposure_"):
            raise DataError(
                f"plane '{name}' belongs to no exposure, but others do: expected exposure_<microseconds>us_<plane>, "
                "such as exposure_2000us_phase_0"
            )
    return {time_s: RawFrame(raw.time_s, {**planes[time_s], **shared}, raw.frame_id) for time_s in sorted(planes)}


def merge(images: Sequence[RangeImage], exposures_s: Sequence[float]) -> RangeImage:
    """Return one image of several that differ in exposure: each pixel from those exposures in which it is valid.

    Weights 1/sigma^2 (the least variance); of a pixel whose exposures contradict each other, because something moved
    between them, those that agree with the one of least sigma. The amplitude is that of the longest exposure, or what
    it would have been; a pixel that no exposure saw says why the longest did not, or, if that was saturated, the next.
    Raises DataError if there is no image, or the number or shape of the images does not fit.
    """
    shapes = {image.shape for image in images}
    if len(shapes) != 1 or len(images) != len(exposures_s):
        raise DataError(
            f"{len(images)} images of {len(exposures_s)} exposures, shapes {sorted(shapes)}: expected one or more "
            "images of one shape, each with its exposure"
        )
    order = np.argsort(exposures_s)[::-1]
    longest = max(exposures_s)
    range_m, sigma_m = (np.stack([getattr(images[k], name) for k in order]) for name in ("range_m", "sigma_m"))
    why = np.stack([images[k].why for k in order])
    amplitude = np.stack([images[k].amplitude * np.float32(longest / exposures_s[k]) for k in order])
    best = np.argmin(np.where(why == 0, sigma_m, np.inf), axis=0)[None]
    first_range, first_sigma = (np.take_along_axis(plane, best, axis=0) for plane in (range_m, sigma_m))
    with np.errstate(invalid="ignore"):  # whatever stands in pixels that are invalid
        alike = np.abs(range_m - first_range) <= _AGREE * np.hypot(sigma_m, first_sigma)
    used = (why == 0) & alike
    weight = np.where(used, 1 / np.where(used, sigma_m, 1) ** 2, 0)
    total, seen = weight.sum(axis=0), used.any(axis=0)
    mean = np.where(used, weight * np.where(used, range_m, 0), 0).sum(axis=0) / np.where(seen, total, 1)
    unsaturated = np.argmax(why != Why.SATURATED, axis=0)[None]
    shown = np.where(seen, np.argmax(used, axis=0), unsaturated)
    of = [np.take_along_axis(plane, shown, axis=0)[0] for plane in (range_m, sigma_m, amplitude, why)]
    return RangeImage(
        images[0].time_s,
        np.where(seen, mean, of[0]).astype(np.float32),
        np.where(seen, 1 / np.sqrt(np.where(seen, total, 1)), of[1]).astype(np.float32),
        of[2].astype(np.float32),
        of[3].astype(np.uint8),
    )
