"""The steps of calibrating a pulsed camera, each from recordings of something known (König 2008, 4.3)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from rangecam.calibration import (
    Calibration,
    Plane,
    Recording,
    attach,
    begun,
    estimate_dark,
    fit_curve,
    fit_range,
    known_of,
    mean_plane,
)
from rangecam.calibration.noise import NoiseFit, fit_noise
from rangecam.errors import DataError, UsageError
from rangecam.geometry import rays
from rangecam.pulsed.calibrated import INTERCEPT, SLOPE, made_for
from rangecam.pulsed.noise_fit import fit_dark_noise
from rangecam.pulsed.settings import PulsedCamera
from rangecam.types import Floats, RangeImage

_LEAST_FOR_CURVE = 4
_SAME_S = 1e-13
_USED_OF_SATURATION = 0.6


def dark(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with the dark images of each number of accumulations (K-CAL-01).

    Recordings without any light, together of all numbers of accumulations that the camera takes. A three-tap camera
    gets dark_1..3 instead, of which the background that was there is a part. Raises DataError as `estimate_dark` does.
    """
    camera, taps = _camera(recordings), _camera(recordings).readout == "three_tap"
    still = estimate_dark(chain.from_iterable(each.frames for each in recordings), "tap_" if taps else "shutter_")
    taken = {**_taken(start, camera), "dark": {"frames": still.frames.tolist(), "n_acc": still.accumulations.tolist()}}
    start = replace(begun(recordings, start, camera, made_for), taken=taken)
    if taps:
        images = {name.replace("tap_", "dark_"): stack[0] for name, stack in still.mean.items()}
        return replace(start, planes={**start.planes, **images})
    stepped = {name.replace("shutter_", "offset_"): stack for name, stack in still.mean.items()}
    return replace(start, accumulations=still.accumulations, stepped=stepped)


def distance(recordings: Sequence[Recording], start: Calibration, *, straight: bool = False) -> Calibration:
    """Return the calibration with curve and lines, from recordings of a plane target at known distances (K-CAL-03).

    The target stands across the optical axis; `known` is its distance from the camera along that axis, m. straight: no
    curve, as in the thesis; there is none either with fewer than four distances. Raises DataError as `fit_curve` and
    `fit_range` do.
    """
    camera = _camera(recordings)
    depth_m = [known_of(each, "distance of its target") for each in recordings]
    along = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    planes = [
        mean_plane(_images(one, camera, start), depth / along) for one, depth in zip(recordings, depth_m, strict=True)
    ]
    return _with_range(
        planes, begun(recordings, start, camera, made_for), camera, straight, {"targets_m": sorted(depth_m)}
    )


def delay(
    recordings: Sequence[Recording],
    start: Calibration,
    *,
    distance_m: float,
    straight: bool = False,
) -> Calibration:
    """Return the calibration with curve and lines, from one plane target and a laser that fires later (K-CAL-04).

    `known` says how much later than in use, s; that stands for c/2 times it beyond `distance_m`. What it cannot see:
    whatever changes with the amount of light, which does not fall here (offsets of other numbers of accumulations,
    crosstalk and stray light), blur and parallax of the near range, and an error of the delays themselves, which goes
    into the ranges in full. Raises UsageError if the laser delays that the recordings state do not fit `known`.
    """
    later_s = [known_of(each, "delay of its laser") for each in recordings]
    camera = _in_use([each.camera for each in recordings], later_s)
    along = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    half_c = camera.speed_of_light_mps / 2
    planes = [
        mean_plane(_images(one, camera, start), distance_m / along + half_c * later)
        for one, later in zip(recordings, later_s, strict=True)
    ]
    in_use = [replace(each, camera=camera) for each in recordings]
    facts = {"delays_s": sorted(later_s), "target_m": distance_m}
    return _with_range(planes, begun(in_use, start, camera, made_for), camera, straight, facts)


def noise(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with the noise parameters fitted (K-NOI-04).

    Shutters: dark frames of two or more numbers of accumulations. Three taps: frames of a scene that stands still, or
    one with tap_std_1..3 and dark_1..3. Raises DataError as the fits do.
    """
    camera = _camera(recordings)
    start = begun(recordings, start, camera, made_for)
    fit = (_tap_noise if camera.readout == "three_tap" else _dark_noise)(recordings, camera)
    line, section, found = fit
    settings = {**start.settings, section: {**start.settings.get(section, {}), **found}}
    points = {"x": line.x.tolist(), "variance": line.variance.tolist(), "error": line.error.tolist()}
    before = {name: getattr(getattr(camera, section), name) for name in found}
    about = {
        **points,
        "base": line.base,
        "slope": line.slope,
        "base_error": line.base_error,
        "slope_error": line.slope_error,
        "unit": "V2 over n_acc" if section == "pixel" else "counts2 over counts",
        "found": found,
        "before": before,
        "line_before": _line_before(before),
    }
    return replace(start, settings=settings, taken={**_taken(start, camera), "noise": about})


def _line_before(before: dict[str, float]) -> list[float]:
    """Return base and slope of the line of the settings before."""
    if "sensor_noise_v" in before:
        return [before["readout_noise_v"] ** 2, before["sensor_noise_v"] ** 2]
    return [before["read_noise_counts"] ** 2, before["shot_noise_counts2_per_count"]]


def _dark_noise(recordings: Sequence[Recording], camera: PulsedCamera) -> tuple[NoiseFit, str, dict[str, float]]:
    still = estimate_dark(chain.from_iterable(each.frames for each in recordings), "shutter_")
    variance = np.mean([stack.mean(axis=(1, 2)) for stack in still.variance.values()], axis=0)
    values = (still.frames - 1) * len(still.variance) * camera.rows * camera.columns
    if not np.isfinite(variance).all():
        raise DataError("one dark frame of a number of accumulations has no variance; take two or more of each")
    fit = fit_dark_noise(still.accumulations, variance, values, camera.pixel)
    return fit, "pixel", {"sensor_noise_v": float(np.sqrt(fit.slope)), "readout_noise_v": float(np.sqrt(fit.base))}


def _tap_noise(recordings: Sequence[Recording], camera: PulsedCamera) -> tuple[NoiseFit, str, dict[str, float]]:
    frames = [raw for each in recordings for raw in each.frames]
    planes, count = dict(frames[0].planes) if frames else {}, camera.taps.dark_frames
    if len(frames) > 1 or "tap_std_1" not in planes:
        still, count = estimate_dark(frames, "tap_"), len(frames)
        planes |= {name: stack[0] for name, stack in still.mean.items()}
        planes |= {name.replace("tap_", "tap_std_"): np.sqrt(stack[0]) for name, stack in still.variance.items()}
    if "dark_1" not in planes:
        raise DataError("no dark_1..3 beside the taps: without them nobody knows how much light there was")
    level, black, deviation = (
        np.stack([np.asarray(planes[f"{kind}_{i}"], np.float64) for i in (1, 2, 3)])
        for kind in ("tap", "dark", "tap_std")
    )
    below = level < _USED_OF_SATURATION * camera.taps.saturation_counts
    fit = fit_noise((level - black)[below], deviation[below] ** 2, count)
    return fit, "taps", {
        "read_noise_counts": float(np.sqrt(fit.base)),
        "shot_noise_counts2_per_count": fit.slope,
        "black_level_counts": float(np.median(black)),
    }  # fmt: skip


def _camera(recordings: Sequence[Recording]) -> PulsedCamera:
    camera: PulsedCamera = recordings[0].camera
    return camera


def _taken(start: Calibration, camera: PulsedCamera) -> dict[str, Any]:
    return {**start.taken, "temperature_c": camera.temperature_c}


def _in_use(cameras: Sequence[PulsedCamera], later_s: Sequence[float]) -> PulsedCamera:
    """Return the camera as it is used, its laser not delayed: recordings may state the delay that they were made with.

    Raises UsageError if they state delays that do not fit those that were said.
    """
    stated = {camera.laser_delay_s for camera in cameras}
    if len(stated) == 1:
        return cameras[0]
    first_s = cameras[0].laser_delay_s - later_s[0]
    for camera, later in zip(cameras, later_s, strict=True):
        if abs(camera.laser_delay_s - later - first_s) > _SAME_S:
            raise UsageError(
                f"camera.laser_delay_s = {camera.laser_delay_s:g} of a recording, {later:g} s later than in use: that "
                f"makes {camera.laser_delay_s - later:g} in use, but {first_s:g} for the first recording"
            )
    return replace(cameras[0], laser_delay_s=round(first_s, 15))


def _images(recording: Recording, camera: PulsedCamera, start: Calibration) -> Iterator[RangeImage]:
    """Yield the ranges of a recording, without their offsets but as nothing else has changed them."""
    offsets = replace(start, planes={k: v for k, v in start.planes.items() if k not in (SLOPE, INTERCEPT)})
    bare = replace(camera, range_curve_m=(), offset_m=0.0, min_range_m=-np.inf, max_range_m=None)
    for raw in recording.frames:
        yield recording.ranging(attach(raw, offsets), bare)


def _with_range(
    planes: Sequence[Plane], start: Calibration, camera: PulsedCamera, straight: bool, facts: dict[str, Any]
) -> Calibration:
    """Return the calibration with curve and lines, and how well they do at the targets that they were made of."""
    curve = () if straight or len(planes) < _LEAST_FOR_CURVE else fit_curve(planes)
    line = fit_range(planes, curve)
    settings = {**start.settings, "range_curve_m": [list(point) for point in curve]}
    images = {**start.planes, SLOPE: line.slope, INTERCEPT: line.intercept_m}
    points = np.array(curve).reshape(-1, 2)
    after = [np.interp(p.measured_m, *points.T) if len(points) else p.measured_m for p in planes]
    left = [line.slope * measured + line.intercept_m - p.known_m for measured, p in zip(after, planes, strict=True)]
    facts = {
        **facts,
        "bias_before_m": _biases(planes, [p.measured_m - p.known_m for p in planes]),
        "bias_after_m": _biases(planes, left),
        "curve": f"{curve[0][1]:.2f} to {curve[-1][1]:.2f} m" if curve else "none",
    }
    return replace(start, settings=settings, planes=images, taken={**_taken(start, camera), "range": facts})


def _biases(planes: Sequence[Plane], errors_m: Sequence[Floats]) -> list[float | None]:
    """Return the mean error of the pixels of each target, m; None where none was valid."""
    means = [np.mean(e[p.weight > 0]) if (p.weight > 0).any() else None for p, e in zip(planes, errors_m, strict=True)]
    return [None if mean is None else round(float(mean), 5) for mean in means]


CALIBRATE: dict[str, Callable[..., Calibration]] = {"dark": dark, "range": distance, "delay": delay, "noise": noise}
"""Steps of a calibration by name: (recordings, the calibration so far, options) -> calibration."""
