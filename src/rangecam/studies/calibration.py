"""Calibration: what dark images and distance curves leave, and laser delays instead of moved targets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rangecam.calibration import Calibration, Recording, attach
from rangecam.geometry import rays
from rangecam.pulsed import CALIBRATE, RANGING, PulsedCamera, simulate
from rangecam.pulsed.settings import Pixel
from rangecam.pulsed.signal import collected_s, shutter_windows
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats, RawFrame

_STEPS = (1, 4, 16, 64, 100)
_TARGETS_M = np.arange(2.0, 22.5, 1.0)
_BETWEEN_M = np.arange(2.0, 20.1, 0.75)
_FIXED_M, _LATER_S = 2.0, np.arange(0.0, 136e-9, 20e-9 / 3)
_DARK_FRAMES, _WALL_FRAMES = 60, 2
_LEAST_SLOPE = 0.2
_CAMERA = PulsedCamera(
    rows=4,
    columns=8,
    frame_rate_hz=0.1,
    averages=500,
    speed_of_light_mps=3e8,
    pulse_rise_s=60e-9,
    pulse_fall_s=30e-9,
    shutter_edge_s=65e-9,
    shutter_a_width_s=230e-9,
    laser_delay_s=27e-9,
)
"""The edges of the thesis' laser and sensor; window a begins before the pulse does, and ends later, by as much."""
_LONG = replace(_CAMERA, pulse_width_s=260e-9, shutter_a_width_s=300e-9, shutter_b_width_s=400e-9, laser_delay_s=55e-9)


def calibration(rng: np.random.Generator) -> Study:
    """Calibration of the pulsed camera: fixed pattern, distance by planes, and by laser delays.

    rng: of the noise of all recordings.
    """
    before, after = _pattern(rng)
    planes, straight = (_by_planes(_CAMERA, rng, straight) for straight in (False, True))
    long, delays = _by_planes(_LONG, rng, True), _by_delays(_CAMERA, rng)
    wrong = _by_delays(_CAMERA, rng, 1.01)
    measured = {each: _measured(each, rng) for each in (_CAMERA, _LONG)}
    bias_m = {
        "180 ns, line": _ranges(measured[_CAMERA], straight) - _BETWEEN_M,
        "180 ns, curve and line": _ranges(measured[_CAMERA], planes) - _BETWEEN_M,
        "260 ns, line": _ranges(measured[_LONG], long) - _BETWEEN_M,
    }
    by_planes_m, by_delays_m, by_wrong_m = (_ranges(measured[_CAMERA], each) for each in (planes, delays, wrong))
    claims = [
        *_pattern_claims(before, after),
        *_distance_claims(bias_m),
        *_delay_claims(by_delays_m - by_planes_m, by_wrong_m - by_planes_m),
    ]
    panels = [
        Panel(
            "Fixed pattern of the shutter values",
            "accumulations",
            "standard deviation over pixels, mV",
            [Series("before", _STEPS, before * 1e3, line="o-"), Series("after", _STEPS, after * 1e3, line="o-")],
            log="xy",
        ),
        Panel(
            "Bias after calibration by planes",
            "range, m",
            "bias, cm",
            [Series(name, _BETWEEN_M, each * 100) for name, each in bias_m.items()],
        ),
        Panel(
            "Calibrated by laser delays, less by planes",
            "range, m",
            "difference, cm",
            [
                Series("true delays", _BETWEEN_M, (by_delays_m - by_planes_m) * 100),
                Series("delays 1 % too long", _BETWEEN_M, (by_wrong_m - by_planes_m) * 100),
            ],
        ),
    ]
    return Study("calibration", "König 2008, 4.3", claims, panels)


def _frame(depth_m: float, camera: PulsedCamera, rng: np.random.Generator) -> RawFrame:
    """Return a frame of a wall across the optical axis that reflects 50 %; infinitely far: darkness."""
    shape = (1, camera.rows, camera.columns)
    range_m = np.broadcast_to(depth_m / rays(camera.lens, shape[1:])[..., 0], shape)
    view = View(range_m, np.full(shape, 0.5 if np.isfinite(depth_m) else 0.0), np.ones(shape))
    return simulate(lambda _: view, camera, 0.0, rng)


def _recording(frames: Sequence[RawFrame], camera: PulsedCamera, known: float | None = None) -> Recording:
    return Recording("simulated", frames, camera, "mdsi3", RANGING["mdsi3"], known)


def _pattern(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the standard deviation of the pattern, V, at each number of accumulations, before and after calibration.

    Of frames that the dark images were not made of; what noise is left in their mean is taken off.
    """
    pixel = Pixel(fixed_pattern_v=5e-3, fixed_pattern_per_pulse_v=0.3e-3)
    camera = PulsedCamera(pixel=pixel)
    frames = {
        n: [_frame(np.inf, replace(camera, pixel=replace(pixel, accumulations=(n,))), rng) for _ in range(_DARK_FRAMES)]
        for n in _STEPS
    }
    half = _DARK_FRAMES // 2
    made = CALIBRATE["dark"]([_recording(f[:half], camera) for f in frames.values()], Calibration({}))
    found = []
    for others in (f[half:] for f in frames.values()):
        for keep in (0, 1):
            values = [np.asarray(attach(f, made).planes["shutter_a"], np.float64) for f in others]
            offset = np.asarray(attach(others[0], made).planes["offset_a"], np.float64)
            found.append(np.std(np.mean(values, axis=0) - keep * offset))
    before, after = np.array(found).reshape(-1, 2).T
    return before, after


def _by_planes(camera: PulsedCamera, rng: np.random.Generator, straight: bool) -> Calibration:
    targets = [
        _recording([_frame(d, camera, rng) for _ in range(_WALL_FRAMES)], camera, d) for d in _TARGETS_M.tolist()
    ]
    return CALIBRATE["range"](targets, Calibration({}), straight=straight)


def _by_delays(camera: PulsedCamera, rng: np.random.Generator, scale: float = 1.0) -> Calibration:
    """Return the calibration by one wall; scale: the delays that are said over those that there were."""
    targets = []
    for later_s in _LATER_S.tolist():
        fired = replace(camera, laser_delay_s=camera.laser_delay_s + later_s)
        frames = [_frame(_FIXED_M, fired, rng) for _ in range(_WALL_FRAMES)]
        targets.append(_recording(frames, camera, later_s * scale))
    return CALIBRATE["delay"](targets, Calibration({}), distance_m=_FIXED_M)


def _measured(camera: PulsedCamera, rng: np.random.Generator) -> list[list[RawFrame]]:
    """Return frames of walls between the targets of the calibration."""
    return [[_frame(d, camera, rng) for _ in range(_WALL_FRAMES)] for d in _BETWEEN_M.tolist()]


def _ranges(walls: Sequence[Sequence[RawFrame]], made: Calibration) -> Floats:
    """Return the mean distance along the axis of each wall, m, as a calibrated camera measures it."""
    base = _CAMERA if made.made_for["pulse_width_s"] == _CAMERA.pulse_width_s else _LONG
    camera = replace(base, range_curve_m=tuple((x, y) for x, y in made.settings["range_curve_m"]))
    along = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    images = [[RANGING["mdsi3"](attach(raw, made), camera) for raw in wall] for wall in walls]
    depths = [
        np.mean([np.mean((image.range_m * along)[image.valid], dtype=np.float64) for image in wall]) for wall in images
    ]
    return np.array(depths)


def _pattern_claims(before: Floats, after: Floats) -> list[Claim]:
    removed = float(1 - np.max(after**2 / before**2))
    text = "least share of the fixed pattern's variance that dark images remove, of all accumulations"
    why = "thesis: 'This removes the FPN'; at least 99 %, from 30 dark frames each"
    return [judged("K-CAL-01", text, None, 100 * removed, "%", removed >= 0.99, why)]


def _distance_claims(bias_m: dict[str, Floats]) -> list[Claim]:
    worst = {name: float(np.abs(each).max()) * 100 for name, each in bias_m.items()}
    curved, line, long = (worst[name] for name in ("180 ns, curve and line", "180 ns, line", "260 ns, line"))
    range_m, slope = _slope(_CAMERA)
    at_2_m, at_20_m = np.interp([2.0, 20.0], range_m, slope)
    last_m = float(range_m[slope >= _LEAST_SLOPE][-1])
    return [
        judged("K-CAL-03", "bias by curve and line, 180 ns and soft edges, 2 to 20 m off 50 %", None, curved, "cm",
               curved < 1, "less than 1 cm"),
        derived("K-CAL-03", "the same by the line of the thesis alone", line, "cm",
                "a straight line; the edges of pulse and shutter bend the quotient"),
        judged("K-CAL-03", "bias by the line alone, 260 ns", None, long, "cm", long < 1,
               "less than 1 cm: the flat top of the pulse is longer than the flight and the edges"),
        derived("K-CAL-03", "slope of the quotient at 2 m, ideal shapes 1", at_2_m, "",
                "the standard deviation of the range is that of the quotient over it"),
        derived("K-CAL-03", "slope of the quotient at 20 m, ideal shapes 1", at_20_m, "", "as above"),
        derived("K-CAL-03", "farthest range at which it is a fifth", last_m, "m",
                "farther the whole pulse lies in window b, and no calibration can tell ranges apart"),
    ]  # fmt: skip


def _slope(camera: PulsedCamera) -> tuple[Floats, Floats]:
    """Return ranges, m, (N,) and how fast the quotient falls there, (N,), in units of what it does for ideal shapes."""
    range_m = np.arange(0.0, 40.0, 0.02)
    windows = shutter_windows(camera)
    at_s = camera.laser_delay_s + 2 / camera.speed_of_light_mps * range_m
    a, b = (collected_s(at_s, windows[name], camera) for name in "ab")
    lit = a + b > 1e-3 * camera.pulse_width_s
    quotient = a / np.where(lit, a + b, 1.0)
    ideal = 2 / camera.speed_of_light_mps / camera.pulse_width_s
    slope: Floats = np.where(lit, -np.gradient(quotient, range_m) / ideal, 0.0)
    return range_m, slope


def _delay_claims(difference_m: Floats, wrong_m: Floats) -> list[Claim]:
    largest, rms = float(np.abs(difference_m).max()) * 100, float(np.sqrt(np.mean(difference_m**2))) * 100
    why = "left open by the thesis; one wall at 2 m, the laser 0 to 133 ns later. Not seen: what changes with the light"
    return [
        judged("K-CAL-04", "largest difference, calibrated by laser delays and by planes, 2 to 20 m", None, largest,
               "cm", largest < 1, "less than 1 cm; " + why),
        derived("K-CAL-04", "root mean square of it", rms, "cm", why),
        derived("K-CAL-04", "largest difference if the delays are 1 % longer than they are taken for",
                float(np.abs(wrong_m).max()) * 100, "cm", "an error of the delay line goes into the ranges in full"),
    ]  # fmt: skip
