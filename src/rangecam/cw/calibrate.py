"""The steps of calibrating a continuous-wave camera, each from recordings of something known (S-EFF-01, S-EFF-11)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from rangecam.calibration import Calibration, Recording, attach, begun, known_of
from rangecam.cw.calibrated import PATTERN, TEMPERATURE, interval_m, made_for
from rangecam.cw.effects import Scattering
from rangecam.cw.noise_fit import fit_sample_noise, still_samples
from rangecam.cw.ranging import cw_phases
from rangecam.cw.scattering_fit import scattering
from rangecam.cw.sequence import plane_name, single_frequencies
from rangecam.cw.settings import CwCamera
from rangecam.cw.wiggling import unambiguous_m
from rangecam.cw.wiggling_fit import Errors, WigglingFit, errors_of, fit_wiggling, mean_offset_m, mean_range
from rangecam.errors import DataError
from rangecam.geometry import rays
from rangecam.hdr import ranged
from rangecam.types import Floats, RangeImage, RawFrame

REFERENCE = "reference_range_m"
"""Plane of a frame with the range of each pixel by another instrument, m."""
_CORRECTS = ("wiggling_table_m", "wiggling_harmonics_m", "drift_m_per_k", "drift_reference_c", "offset_m")
_SIZES = {"table": 64, "harmonics": 4}
_LEAST_SPREAD_K = 2.0
_SAME_M = 1e-3


def dark(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with `black_level_lsb` and `read_noise_lsb`, from recordings without any light.

    Raises DataError as `estimate_dark` does, and for a single frame, which tells no noise.
    """
    camera = _camera(recordings, start)
    mean, variance, frames = still_samples(recordings, camera)
    noise = float(np.mean([*variance.values()])) - camera.quantisation_lsb**2 / 12
    found = {
        "black_level_lsb": float(np.median([*mean.values()])),
        "read_noise_lsb": float(np.sqrt(max(noise, 0.0))) * camera.binning,
    }
    return _with(recordings, start, camera, found, {"dark": {"frames": frames, **found}})


def noise(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with read noise and shot noise, from frames of a scene that stands still.

    The variance of the samples over the light in them. The light in a differential pixel shows in the amplitude alone:
    let there be no ambient light but the `ambient_lsb` that the camera is said to see. Raises DataError as `fit_noise`
    does, and for a single frame.
    """
    camera = _camera(recordings, start)
    mean, variance, frames = still_samples(recordings, camera)
    fit = fit_sample_noise(mean, variance, frames, camera)
    pixels = camera.binning**2
    found = {"read_noise_lsb": float(np.sqrt(fit.base * pixels)), "shot_noise_lsb2_per_lsb": fit.slope * pixels}
    about = {
        "x": fit.x.tolist(),
        "variance": fit.variance.tolist(),
        "error": fit.error.tolist(),
        "base": fit.base,
        "slope": fit.slope,
        "base_error": fit.base_error,
        "slope_error": fit.slope_error,
        "unit": "LSB2 over LSB",
        "found": found,
        "before": {name: getattr(camera, name) for name in found},
        "line_before": [camera.read_noise_lsb**2 / pixels, camera.shot_noise_lsb2_per_lsb / pixels],
    }
    return _with(recordings, start, camera, found, {"noise": about})


def wiggling(
    recordings: Sequence[Recording],
    start: Calibration,
    *,
    model: Literal["table", "harmonics"] = "table",
    size: int | None = None,
    partial: bool = False,
) -> Calibration:
    """Return the calibration with the error of the range over the phase, and with `offset_m` (S-EFF-01).

    `known` is the distance of a plane target across the optical axis, m; without it each frame has the range of every
    pixel as plane reference_range_m. size: values of the table (64) or harmonics (4, with the fourth, which square
    signals make). partial: see `fit_wiggling`. Several frequencies get a row each, and tables the differences of their
    offsets. Raises DataError as `fit_wiggling` does and where harmonics cannot hold those differences, UsageError where
    nothing says how far the target is.
    """
    camera = _camera(recordings, start)
    bare = replace(camera, wiggling_table_m=(), wiggling_harmonics_m=(), offset_m=0.0, drift_m_per_k=0.0)
    cameras, errors, degrees = single_frequencies(bare), [], []
    for each in recordings:
        frames = [_without_planes(raw) for raw in each.frames]
        known_m = _known_range_m(each, frames, camera)
        if known_m is None:
            known_of(each, "distance of its target")
        of_each = [_single_images(frames, each, bare, k) for k in range(len(cameras))]
        errors.append(
            [
                errors_of(*mean_range(images, unambiguous_m(single)), np.asarray(known_m), unambiguous_m(single))
                for images, single in zip(of_each, cameras, strict=True)
            ]
        )
        degrees.append(_temperature_c(frames, camera))
    periods_m = [unambiguous_m(single) for single in cameras]
    fits = [
        fit_wiggling(of_one, period_m, model, size or _SIZES[model], partial)
        for of_one, period_m in zip(zip(*errors, strict=True), periods_m, strict=True)
    ]
    drift_m = camera.drift_m_per_k * (float(np.mean(degrees)) - camera.drift_reference_c)
    empty = {"table": "wiggling_harmonics_m", "harmonics": "wiggling_table_m"}[model]
    rows = _rows(fits, model, periods_m)
    found = {f"wiggling_{model}_m": rows, empty: [], "offset_m": round(drift_m - fits[0].offset_m, 6)}
    about = {
        "model": f"{model} of {size or _SIZES[model]}",
        "offset_m": found["offset_m"],
        "spread_before_m": [fit.before_m for fit in fits],
        "spread_after_m": [fit.after_m for fit in fits],
        "unseen_m": [list(gap) for fit in fits for gap in fit.unseen_m],
    }
    return _with(recordings, start, camera, found, {"wiggling": about, TEMPERATURE: float(np.mean(degrees))})


def pattern(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with the offset of each pixel (range_offset_m) and of all (`offset_m`) (S-EFF-11).

    `known` as for `wiggling`; where nothing says how far the target is, the plane that fits its ranges best takes the
    place of the known one, and tells nothing of the offset of all. Correct wiggling before. Pixels that no recording
    shows get none. Raises DataError if no pixel is valid.
    """
    camera, period_m = _camera(recordings, start), interval_m(_camera(recordings, start))
    absolute, relative, degrees = [], [], []
    for each in recordings:
        frames = [_without_planes(raw) for raw in each.frames]
        measured_m, weight = mean_range((ranged(each.ranging, raw, camera) for raw in frames), period_m)
        known_m = _known_range_m(each, frames, camera)
        if known_m is None:
            known_m = fitted_plane_m(measured_m, weight, camera)
            relative.append(errors_of(measured_m, weight, known_m, period_m))
        else:
            absolute.append(errors_of(measured_m, weight, known_m, period_m))
        degrees.append(_temperature_c(frames, camera))
    mean_m = mean_offset_m(absolute, period_m) if absolute else 0.0
    centres_m = [mean_m] * len(absolute) + [mean_offset_m([each], period_m) for each in relative]
    own_m, seen = _own_offsets(absolute + relative, centres_m, period_m)
    rest_m = float(own_m[seen].mean())
    own_m = np.where(seen, own_m - rest_m, 0.0)
    found = {"offset_m": round(camera.offset_m - mean_m - rest_m, 6)} if absolute else {}
    about = {**found, "spread_m": float(np.std(own_m[seen])), "unseen_pixels": int(np.sum(~seen))}
    taken = {"pattern": about, TEMPERATURE: float(np.mean(degrees))}
    result = _with(recordings, start, camera, found, taken)
    return replace(result, planes={**result.planes, PATTERN: own_m})


def temperature(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with `drift_m_per_k`, from recordings of one scene at rest at several temperatures.

    `known` is the temperature, degrees Celsius; without it each frame carries it as plane temperature_c, so that one
    recording of a camera that warms up will do. No distance need be known. The reference is the temperature at which
    the calibration so far was taken. Correct wiggling before. Raises DataError for less than 2 K or frames without a
    valid pixel in common, UsageError where nothing says the temperature.
    """
    camera, first = replace(_camera(recordings, start), drift_m_per_k=0.0), None
    period_m, degrees, shifts_m = interval_m(camera), [], []
    for each in recordings:
        for raw in each.frames:
            image = ranged(each.ranging, attach(raw, start), camera)
            first = first or image
            shifts_m.append(_shift_m(image, first, period_m, raw))
            given = TEMPERATURE in raw.planes and each.known is None
            measured = float(np.mean(raw.planes[TEMPERATURE])) if given else None
            degrees.append(known_of(each, "temperature of the camera") if measured is None else measured)
    t, shift_m = np.array(degrees), np.array(shifts_m)
    if len(t) < 2 or np.ptp(t) < _LEAST_SPREAD_K:
        raise DataError(
            f"{len(t)} frames at temperatures within {np.ptp(t) if len(t) else 0.0:.2g} K; drift needs some "
            f"{_LEAST_SPREAD_K:g} K apart or more"
        )
    away_k = t - t.mean()
    slope = float(away_k @ shift_m / (away_k @ away_k))
    left_m = shift_m - shift_m.mean() - slope * away_k
    error = float(np.sqrt(left_m @ left_m / max(len(t) - 2, 1) / (away_k @ away_k)))
    reference_c = start.settings.get("drift_reference_c", start.taken.get(TEMPERATURE, camera.drift_reference_c))
    found = {"drift_m_per_k": slope, "drift_reference_c": float(reference_c)}
    about = {**found, "error_m_per_k": error, "temperatures_c": [float(t.min()), float(t.max())]}
    return _with(recordings, start, camera, found, {"temperature": about})


def fitted_plane_m(measured_m: Floats, weight: Floats, camera: CwCamera) -> Floats:
    """Return the ranges (H, W) of the plane that fits ranges within the first unambiguous interval best.

    On a plane n . (r ray) = 1 one over the range is n . ray, linear in three parameters. Raises DataError for fewer
    than three valid pixels.
    """
    ray, used = rays(camera.lens, (camera.rows, camera.columns)), weight > 0
    if used.sum() < 3:
        raise DataError(f"{int(used.sum())} valid pixels of a target; a plane needs three")
    range_m = measured_m[used]
    normal = np.zeros(3)
    for _ in range(3):  # errors of the range count: 1/r - n . ray is -error / r2, and some pixels may see other things
        fitted_m = 1 / (ray[used] @ normal) if normal.any() else range_m
        off_m = np.abs(range_m - fitted_m)
        near = off_m <= 5 * 1.4826 * np.median(off_m) + _SAME_M
        root = np.sqrt(weight[used]) * range_m**2 * near
        normal = np.linalg.lstsq(ray[used] * root[:, None], root / range_m, rcond=None)[0]
    result: Floats = 1 / (ray @ normal)
    return result


def _own_offsets(errors: Sequence[Errors], centres_m: Sequence[float], period_m: float) -> tuple[Floats, Any]:
    """Return the weighted mean over recordings of each pixel's error beside that of all, and which pixels have one."""
    total, weighted = np.zeros(()), np.zeros(())
    for each, centre_m in zip(errors, centres_m, strict=True):
        off_m = np.mod(each.error_m - centre_m + period_m / 2, period_m) - period_m / 2
        total, weighted = total + each.weight, weighted + each.weight * off_m
    return weighted / np.where(total > 0, total, 1.0), total > 0


def _shift_m(image: RangeImage, first: RangeImage, period_m: float, raw: RawFrame) -> float:
    """Return by how much the ranges of a frame are longer than those of the first one, in the mean."""
    both = image.valid & first.valid
    if not both.any():
        raise DataError(f"frame {raw.frame_id} has no valid pixel in common with the first one; let the scene stay")
    turns = (image.range_m - first.range_m)[both].astype(np.float64) / period_m
    return float(np.angle(np.exp(2j * np.pi * turns).mean()) / (2 * np.pi) * period_m)


def _camera(recordings: Sequence[Recording], start: Calibration) -> CwCamera:
    """Return the camera of the recordings as far as the calibration so far corrects it."""
    camera: CwCamera = recordings[0].camera
    found = {name: _tuples(start.settings[name]) for name in _CORRECTS if name in start.settings}
    stray_light = Scattering(**start.settings["stray_light"]) if "stray_light" in start.settings else camera.stray_light
    return replace(camera, **found, stray_light=stray_light)


def _tuples(value: Any) -> Any:
    return tuple(_tuples(each) for each in value) if isinstance(value, list | tuple) else value


def _with(
    recordings: Sequence[Recording],
    start: Calibration,
    camera: CwCamera,
    found: Mapping[str, Any],
    taken: Mapping[str, Any],
) -> Calibration:
    begin = begun(recordings, start, camera, made_for)
    return replace(begin, settings={**start.settings, **found}, taken={**start.taken, **taken})


def _without_planes(raw: RawFrame) -> RawFrame:
    """Return the frame without the pattern that it may have been recorded with."""
    return replace(raw, planes={name: plane for name, plane in raw.planes.items() if name != PATTERN})


def _known_range_m(recording: Recording, frames: Sequence[RawFrame], camera: CwCamera) -> Floats | None:
    """Return the true ranges (H, W): of a plane target at `known`, or of the reference; None if nobody says."""
    if recording.known is not None:
        along: Floats = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
        return recording.known / along
    if not frames or REFERENCE not in frames[0].planes:
        return None
    reference_m = np.asarray(frames[0].planes[REFERENCE], np.float64)
    return np.where(reference_m > 0, reference_m, np.nan)


def _temperature_c(frames: Sequence[RawFrame], camera: CwCamera) -> float:
    measured = [float(np.mean(raw.planes[TEMPERATURE])) for raw in frames if TEMPERATURE in raw.planes]
    return float(np.mean(measured)) if measured else camera.temperature_c


def _single_images(frames: Sequence[RawFrame], recording: Recording, camera: CwCamera, k: int) -> Iterable[RangeImage]:
    """Return the ranges of modulation frequency number k by itself."""
    if not camera.modulations_hz:
        return (ranged(recording.ranging, raw, camera) for raw in frames)
    names = {plane_name(step, k): plane_name(step) for step in camera.phase_steps_deg}
    parts = (replace(raw, planes={new: raw.planes[old] for old, new in names.items()}) for raw in frames)
    return (cw_phases(part, single_frequencies(camera)[k]) for part in parts)


def _rows(fits: Sequence[WigglingFit], model: str, periods_m: Sequence[float]) -> list[Any]:
    """Return what the settings hold: of several frequencies, tables with how their offsets differ from the first."""
    rows = []
    for k, (fit, period_m) in enumerate(zip(fits, periods_m, strict=True)):
        away_m = float(np.mod(fit.offset_m - fits[0].offset_m + period_m / 2, period_m) - period_m / 2)
        if model == "harmonics" and abs(away_m) > _SAME_M:
            raise DataError(
                f"the offset of frequency {k} differs from that of the first by {1e3 * away_m:.1f} mm, which harmonics "
                "cannot hold; fit tables"
            )
        rows.append((fit.values + (away_m if model == "table" else 0.0)).round(7).tolist())
    return rows


CALIBRATE: dict[str, Callable[..., Calibration]] = {
    "dark": dark,
    "wiggling": wiggling,
    "pattern": pattern,
    "temperature": temperature,
    "noise": noise,
    "scattering": scattering,
}
"""Steps of a calibration by name: (recordings, the calibration so far, options) -> calibration."""
