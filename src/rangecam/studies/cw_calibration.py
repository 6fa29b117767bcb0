"""What calibration takes off the ranges of the continuous-wave camera, imperfection by imperfection and all together.

Calibrations are made of noisy images of planes; what they leave is looked at without noise, at planes in between.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rangecam.calibration import Calibration, Recording, attach
from rangecam.config import load_config
from rangecam.cw import CALIBRATE, RANGING, CwCamera, simulate
from rangecam.cw.effects import FixedPattern, Temperature, Waveform
from rangecam.cw.imperfections import IMPERFECTIONS
from rangecam.cw.wiggling import unambiguous_m
from rangecam.cw.wiggling_fit import errors_of, fit_wiggling, mean_offset_m, mean_range
from rangecam.geometry import rays
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats

_METHOD = "cw_four_phase"
_RECORDING = Path("cw_mlx75027") / "tools_scene.npz"
_SQUARE = Waveform(illumination="square", reference="square")
_SOFT = replace(_SQUARE, bandwidth_hz=4 * 17e6)
_PATTERN = FixedPattern(seed=1, range_sigma_m=0.02)
_OFFSET_M, _DRIFT_M_PER_K = 0.1, 2e-3
_WALLS_M, _WALL_FRAMES = np.geomspace(0.15, 9.0, 60), 20
_BETWEEN_M = np.linspace(0.6, 6.1, 12)
_HARMONICS, _SIZES = (2, 4, 8, 16), (16, 32, 64, 128)
_FRAMES, _WARM_C = (4, 16, 64, 256, 1024), (10.0, 25.0, 40.0, 55.0)


def cw_calibration(rng: np.random.Generator) -> Study:
    """Calibration of the continuous-wave camera: wiggling, offset, fixed pattern, temperature; errors before and after.

    rng: of the noise. A recording of real tools is looked at if the environment variable RANGECAM_DATA names the folder
    that holds it.
    """
    wiggling, pattern, drift = _wiggling(rng), _pattern(rng), _temperature(rng)
    together, real = _together(rng), _real()
    claims = [*wiggling[0], *pattern[0], *drift[0], *together[0], *real[0]]
    panels = [*wiggling[1], *pattern[1], *drift[1], *together[1], *real[1]]
    return Study(
        "cw-calibration", "Steinbäck 2016, 2.2.2: systematic errors and what calibration leaves", claims, panels
    )


def _camera(**imperfections: Any) -> CwCamera:
    camera = load_config("scaled_car", {"camera": {"pseudo_rows": 0, "rows": 30, "columns": 40}}).camera
    assert isinstance(camera, CwCamera)
    return replace(camera, **imperfections)


def _wall(depth_m: float, camera: CwCamera) -> View:
    """Return a plane across the axis, its grey such that near and far ones are equally bright."""
    along = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    range_m = (depth_m / along)[None].astype(np.float32)
    return View(range_m, np.full_like(range_m, 0.8 * depth_m**2), along[None].astype(np.float32))


def _recorded(
    depth_m: float, camera: CwCamera, count: int, rng: np.random.Generator, known: float | None = None
) -> Recording:
    view = _wall(depth_m, camera)
    frames = [simulate(lambda _: view, camera, 0.0, rng) for _ in range(count)]
    return Recording(f"{depth_m:g} m", frames, camera, _METHOD, RANGING[_METHOD], known)


def _walls(camera: CwCamera, rng: np.random.Generator) -> list[Recording]:
    return [_recorded(depth_m, camera, _WALL_FRAMES, rng, depth_m) for depth_m in _WALLS_M.tolist()]


def _tuned(camera: CwCamera, calibration: Calibration) -> CwCamera:
    return replace(camera, **{name: _tuples(value) for name, value in calibration.settings.items()})


def _tuples(value: Any) -> Any:
    return tuple(_tuples(each) for each in value) if isinstance(value, list) else value


def _error_mm(camera: CwCamera, calibration: Calibration, depth_m: float) -> Floats:
    """Return the error (H, W) of a plane without noise, mm."""
    for name in ("shot_noise", "read_noise", "quantisation", "converter_limits"):
        camera = IMPERFECTIONS[name](camera)
    view = _wall(depth_m, camera)
    raw = simulate(lambda _: view, camera, 0.0, np.random.default_rng(0))
    image = RANGING[_METHOD](attach(raw, calibration), _tuned(camera, calibration))
    period_m = unambiguous_m(camera)
    return 1e3 * errors_of(image.range_m, np.ones(image.shape), view.range_m[0], period_m).error_m


def _errors_mm(camera: CwCamera, calibration: Calibration) -> Floats:
    """Return the errors (12, H, W) of the planes between those of the calibrations, mm."""
    return np.stack([_error_mm(camera, calibration, depth_m) for depth_m in _BETWEEN_M.tolist()])


_NONE = Calibration({})


def _wiggling(rng: np.random.Generator) -> tuple[list[Claim], list[Panel]]:
    claims: list[Claim] = []
    left: dict[str, tuple[Sequence[int], list[float]]] = {}
    # the error of ideal square signals has kinks, which ask for more values
    for name, waveform, size in (("square signals", _SQUARE, 128), ("square signals, soft light", _SOFT, 64)):
        camera = _camera(waveform=waveform)
        walls = _walls(camera, rng)
        table = CALIBRATE["wiggling"](walls, _NONE, size=size)
        before, after = _errors_mm(camera, _NONE), _errors_mm(camera, table)
        for model, sizes in (("harmonics", _HARMONICS), ("table", _SIZES)):
            left[f"{model}, {name}"] = (sizes, _swept(walls, camera, model, sizes))
        four = left[f"harmonics, {name}"][1][_HARMONICS.index(4)]
        text = f"greatest wiggling error, {name}"
        claims += [
            derived("S-EFF-01", text, _largest(before), "mm", "17 MHz, before"),
            judged("S-EFF-01", f"{text}: left by the table", None, _largest(after), "mm", _largest(after) < 2.0,
                   f"{size} values; below 2 mm"),
            derived("S-EFF-01", f"{text}: left by four harmonics", four, "mm", "the eighth and on are not in it"),
        ]  # fmt: skip
    range_m = np.stack([_wall(depth_m, camera).range_m[0] for depth_m in _BETWEEN_M.tolist()]).ravel()
    order = np.argsort(range_m)[::7]
    curves = [
        Series("before", range_m[order], before.ravel()[order]),
        Series(f"after, table of {size}", range_m[order], after.ravel()[order]),
    ]
    return claims, [
        Panel("wiggling, square signals and soft light", "range, m", "error, mm", curves),
        Panel("what models of wiggling leave", "harmonics, or values of the table", "greatest error, mm",
              [Series(name, *each, line="-o") for name, each in left.items()], "xy"),
    ]  # fmt: skip


def _swept(walls: Sequence[Recording], camera: CwCamera, model: str, sizes: Sequence[int]) -> list[float]:
    """Return the greatest error that models of these sizes leave, mm."""
    period_m = unambiguous_m(camera)
    errors = [
        errors_of(*mean_range((RANGING[_METHOD](raw, camera) for raw in wall.frames), period_m), known_m, period_m)
        for wall, depth_m in zip(walls, _WALLS_M.tolist(), strict=True)
        for known_m in [_wall(depth_m, camera).range_m[0]]
    ]
    result = []
    for size in sizes:
        fit = fit_wiggling(errors, period_m, model, size)
        settings = {f"wiggling_{model}_m": [fit.values.tolist()], "offset_m": -fit.offset_m}
        result.append(_largest(_errors_mm(camera, Calibration({}, settings))))
    return result


def _largest(errors_mm: Floats) -> float:
    return float(np.abs(errors_mm).max())


def _pattern(rng: np.random.Generator) -> tuple[list[Claim], list[Panel]]:
    camera = _camera(fixed_pattern=replace(_PATTERN, global_offset_m=_OFFSET_M))
    before, spreads, calibration = _errors_mm(camera, _NONE), [], _NONE
    for count in _FRAMES:
        calibration = CALIBRATE["pattern"]([_recorded(1.0, camera, count, rng, 1.0)], _NONE)
        spreads.append(_bright_spread(_errors_mm(camera, calibration), camera))
    after = _errors_mm(camera, calibration)
    offset_mm = float(after.mean())
    claims = [
        derived("S-EFF-11", "fixed pattern, standard deviation over pixels", float(before[0].std()), "mm", "before"),
        judged("S-EFF-11", "left by the calibration", None, spreads[-1], "mm", spreads[-1] < 1.0,
               f"{_FRAMES[-1]} images of one plane, middle half of the image; below 1 mm"),
        derived("S-EFF-11", "the same in the whole image", float(after[0].std()), "mm", "its corners are dark"),
        derived("S-EFF-11", "global offset", float(before.mean()), "mm", "before"),
        judged("S-EFF-11", "left of it", None, offset_mm, "mm", abs(offset_mm) < 0.5, "below 0.5 mm"),
    ]  # fmt: skip
    x = np.array(_FRAMES)
    series = [
        Series("left by the calibration", x, spreads, line="-o"),
        Series("one over the square root", x, spreads[0] * np.sqrt(x[0] / x), line="--"),
        Series("before", x, np.full(len(x), _bright_spread(before, camera)), line="--"),
        Series("target", x, np.ones(len(x)), line=":"),
    ]
    return claims, [Panel("fixed pattern", "images that are averaged", "standard deviation, mm", series, "xy")]


def _bright_spread(errors_mm: Floats, camera: CwCamera) -> float:
    """Return the standard deviation over the pixels in the middle half of the image, which the light reaches."""
    rows, columns = camera.rows // 4, camera.columns // 4
    return float(errors_mm[0, rows:-rows, columns:-columns].std())


def _warm(camera: CwCamera, degrees_c: float) -> CwCamera:
    its = Temperature(drift_m_per_k=_DRIFT_M_PER_K, temperature_c=degrees_c, measured=True)
    return replace(camera, temperature=its)


def _temperature(rng: np.random.Generator) -> tuple[list[Claim], list[Panel]]:
    camera = _camera()
    targets = [_recorded(1.0, _warm(camera, degrees_c), 30, rng) for degrees_c in (15.0, 45.0)]
    calibration = CALIBRATE["temperature"](targets, _NONE)
    before, after = (
        [float(np.mean(_error_mm(_warm(camera, degrees_c), each, 1.7))) for degrees_c in _WARM_C]
        for each in (_NONE, calibration)
    )
    found = calibration.settings["drift_m_per_k"]
    left = max(abs(each) for each in after)
    claims = [
        derived("S-EFF-11", "drift at 30 K beside the reference", max(map(abs, before)), "mm", "before"),
        judged("S-EFF-11", "drift found over that of the camera", None, found / _DRIFT_M_PER_K, "",
               abs(found / _DRIFT_M_PER_K - 1) < 0.02, "within 2 %, from 15 and 45 C"),
        judged("S-EFF-11", "drift left at 30 K beside the reference", None, left, "mm", left < 1.0, "below 1 mm"),
    ]  # fmt: skip
    series = [Series("before", _WARM_C, before, line="-o"), Series("after", _WARM_C, after, line="-o")]
    return claims, [Panel("temperature, 2 mm/K", "temperature, °C", "mean error, mm", series)]


def _together(rng: np.random.Generator) -> tuple[list[Claim], list[Panel]]:
    """Return claims and panel of a camera with all of it, calibrated step by step and used 15 K warmer."""
    camera = _camera(waveform=_SOFT, fixed_pattern=replace(_PATTERN, global_offset_m=_OFFSET_M))
    cold, hot = _warm(camera, 25.0), _warm(camera, 40.0)
    steps = [("wiggling", CALIBRATE["wiggling"](_walls(cold, rng), _NONE))]
    near = [_recorded(depth_m, cold, _FRAMES[-1] // 2, rng, depth_m) for depth_m in (0.8, 1.0)]
    steps.append(("and fixed pattern", CALIBRATE["pattern"](near, steps[-1][1])))
    targets = [_recorded(1.0, each, 30, rng) for each in (cold, _warm(camera, 45.0))]
    steps.append(("and temperature", CALIBRATE["temperature"](targets, steps[-1][1])))
    errors = {name: _errors_mm(hot, each) for name, each in (("before", _NONE), *steps)}
    sizes = {name: [_rms(plane) for plane in each] for name, each in errors.items()}
    first, last = _rms(errors["before"]), _rms(errors["and temperature"])
    claims = [
        derived("S-EFF-11", "all together, 15 K warmer: root mean square error", first, "mm", "before"),
        judged("S-EFF-11", "the same, calibrated", None, last, "mm", last < 2.0,
               "below 2 mm in the whole image, dark corners and all"),
    ]  # fmt: skip
    series = [Series(name, _BETWEEN_M, each, line="-o") for name, each in sizes.items()]
    return claims, [Panel("step by step, 15 K warmer", "distance of a plane, m", "RMS error, mm", series, "y")]


def _rms(errors_mm: Floats) -> float:
    return float(np.sqrt(np.mean(errors_mm**2)))


def _real() -> tuple[list[Claim], list[Panel]]:
    """Return what wiggling fitted on every second pixel of a real recording leaves of the others'."""
    from rangecam.io import open_source

    path = Path(os.environ.get("RANGECAM_DATA", "")) / _RECORDING
    if not path.is_file():
        why = f"RANGECAM_DATA names no folder with {_RECORDING}"
        return [derived("S-EFF-01", "real recordings looked at", 0, "", why)], []
    source = open_source(path)
    raw, camera = next(iter(source.captures)).raw, source.config.camera
    assert isinstance(camera, CwCamera)
    known_m, period_m = raw.planes["reference_range_m"], unambiguous_m(camera)
    taken = np.indices(raw.shape).sum(axis=0) % 2 == 0
    half = replace(raw, planes={**raw.planes, "reference_range_m": np.where(taken, known_m, 0)})
    one = Recording(path.name, [half], camera, _METHOD, RANGING[_METHOD])
    spreads, series, claims = {}, [], []
    for name, options in (("before", None), ("4 harmonics", {"model": "harmonics"}), ("table of 64", {})):
        fitted = _NONE if options is None else CALIBRATE["wiggling"]([one], _NONE, partial=True, **options)
        image = RANGING[_METHOD](raw, _tuned(camera, fitted))
        errors = errors_of(image.range_m, image.valid * 1.0, np.where(known_m > 0, known_m, np.nan), period_m)
        used = (errors.weight > 0) & ~taken
        error_mm = 1e3 * (errors.error_m - mean_offset_m([errors], period_m))[used]
        spreads[name] = 1.4826 * float(np.median(np.abs(error_mm - np.median(error_mm))))
        series.append(Series(name, *_medians(known_m[used], error_mm - np.median(error_mm))))
        what = f"real tools, the half of the pixels that nothing was fitted on: spread, {name}"
        if options is None:
            claims.append(derived("S-EFF-01", what, spreads[name], "mm", "beside the camera's own range"))
        else:
            lower = spreads[name] < spreads["before"]
            claims.append(judged("S-EFF-01", what, None, spreads[name], "mm", lower, "lower than before"))
    return claims, [Panel("real tools, the other half of the pixels", "range by the camera itself, m",
                          "median error, mm", series)]  # fmt: skip


def _medians(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the middles of classes of x and the medians of y in them, where there are enough."""
    first, last = np.percentile(x, [0.5, 99.5])
    edges = np.linspace(first, last, 61)
    n = np.digitize(x, edges)
    places: Sequence[int] = [k for k in range(1, 61) if np.sum(n == k) >= 100]
    middles = np.array([(edges[k - 1] + edges[k]) / 2 for k in places])
    return middles, np.array([np.median(y[n == k]) for k in places])
