"""From a range image to a clean one: fewer valid pixels, less noise, sigma kept true.

Every stage only refuses pixels, with a reason, or lowers their noise: a pixel that came in invalid stays so.
- limits: what is known of each pixel before the image: least amplitudes, floor, area of interest
- neighbours, flying: which pixels are refused
- filters (median, variation): less noise from neighbours; temporal: from the last image
- onepass: neighbours, median and limits in one pass over the rows, where nothing comes between them
"""

import dataclasses
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from rangecam.clean.filters import FILTERS, shared_noise_pixels
from rangecam.clean.flying import flying
from rangecam.clean.limits import area_of_interest, cut, floor_limit, neighbours_needed, weakest_amplitudes
from rangecam.clean.neighbours import Kept, judge
from rangecam.clean.onepass import WIDEST, clean_in_one_pass, limits_in_one
from rangecam.clean.settings import CleanSettings
from rangecam.clean.temporal import settle
from rangecam.geometry import Lens, Mounting
from rangecam.types import Floats, Ints, RangeImage

__all__ = ["FILTERS", "STAGES", "CleanSettings", "clean", "clean_stages", "shared_noise_pixels"]

STAGES = ("flying", "amplitude", "neighbourhood", "filter", "floor", "area")
"""The stages of cleaning, in their order."""

_OFF: tuple[dict[str, Any], ...] = (  # what switches off each of STAGES
    {"reject_flying": False},
    {"amplitude_threshold": 0.0, "wrap_threshold": 0.0},
    {"min_neighbours": 0, "discard_border": False},
    {"filter": "off", "temporal_frames": 1.0},
    {"floor": "off"},
    {"x_min_m": None, "x_max_m": None, "width_m": None, "z_min_m": None, "z_max_m": None},
)


def clean(
    image: RangeImage, lens: Lens, mounting: Mounting, settings: CleanSettings, before: RangeImage | None = None
) -> RangeImage:
    """Refuse pixels that cannot be trusted or do not matter, and smooth the rest.

    Flying pixels go first, as if they had not come. Amplitude thresholds and the test for common neighbours both judge
    the image as it came (Steinbäck 2016, alg 4.2); the filter takes what they left; floor and area of interest are cut
    from its result. before: what this function returned for the last frame, for the average over time.
    """
    why = np.ascontiguousarray(image.why, np.uint8)
    range_m, sigma_m = np.ascontiguousarray(image.range_m, np.float32), np.ascontiguousarray(image.sigma_m, np.float32)
    amplitude = np.ascontiguousarray(image.amplitude, np.float32)
    if settings.reject_flying:
        why = flying(range_m, sigma_m, why, settings)
    if _at_once(why.shape, settings, before):
        limits = _all_limits(lens, mounting, why.shape, settings)
        planes = range_m, sigma_m, amplitude
        range_m, sigma_m, why = clean_in_one_pass(planes, why, limits)
        return RangeImage(image.time_s, range_m, sigma_m, amplitude, why)
    least, needed, floor, near, far = _known_limits(lens, mounting, why.shape, settings)
    why, around = judge((range_m, sigma_m, amplitude), why, least, needed, settings)
    if settings.filter != "off":
        kept = Kept(range_m, sigma_m, amplitude, why, around, floor)
        range_m, sigma_m = FILTERS[settings.filter](kept, settings)
    if settings.temporal_frames > 1 and before is not None and before.shape == image.shape:
        range_m, sigma_m = settle(range_m, sigma_m, why, before, settings)
    if settings.floor == "fit":
        floor = floor_limit(range_m, why, lens, mounting, settings)
    why = cut(range_m, sigma_m, why, (floor, near, far), settings)
    return RangeImage(image.time_s, range_m, sigma_m, amplitude, why)


def _at_once(shape: tuple[int, ...], settings: CleanSettings, before: RangeImage | None) -> bool:
    """Return whether nothing comes between median and cut, and the image is not too wide: then one pass does it all."""
    alone = settings.temporal_frames <= 1 or before is None
    return settings.filter == "median" and settings.floor != "fit" and alone and shape[1] <= WIDEST


@lru_cache(maxsize=4)
def _all_limits(lens: Lens, mounting: Mounting, shape: tuple[int, int], settings: CleanSettings) -> Floats:
    """Return the limits in one array, as `onepass` takes them."""
    amplitudes, needed, floor, near, far = _known_limits(lens, mounting, shape, settings)
    return limits_in_one(amplitudes, needed, floor, (near, far), settings)


@lru_cache(maxsize=16)
def _known_limits(
    lens: Lens, mounting: Mounting, shape: tuple[int, int], settings: CleanSettings
) -> tuple[tuple[Floats, Floats], Ints, Floats, Floats, Floats]:
    """Return the limits known before the image: amplitudes, neighbours, floor (infinite if it is fitted), area."""
    floor = np.full(shape, np.inf, np.float32)
    if settings.floor != "fit":
        floor = floor_limit(floor, np.zeros(shape, np.uint8), lens, mounting, settings)
    near, far = area_of_interest(lens, mounting, shape, settings)
    return weakest_amplitudes(lens, shape, settings), neighbours_needed(shape, settings), floor, near, far


def clean_stages(
    image: RangeImage, lens: Lens, mounting: Mounting, settings: CleanSettings, before: RangeImage | None = None
) -> Iterator[tuple[str, RangeImage]]:
    """Yield the name of each of `STAGES` and the image cleaned up to it; the last is the result of `clean`."""
    for number, stage in enumerate(STAGES, start=1):
        off = {key: value for later in _OFF[number:] for key, value in later.items()}
        yield stage, clean(image, lens, mounting, dataclasses.replace(settings, **off), before)
