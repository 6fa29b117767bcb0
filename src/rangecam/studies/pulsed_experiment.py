"""MDSI1 and MDSI3 measured side by side with the whole camera, and why the sensor before could not use MDSI3."""

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.stats import chi2

from rangecam.pulsed.limits import expected_sigma_m
from rangecam.pulsed.settings import Laser, PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import Ranged, measured_edges, quiet, ranged
from rangecam.types import Floats

AT_M = np.arange(3.0, 21.5, 1.0)
STEPS = (1, 4, 16, 64)
PLYWOOD = 0.5
OLD_EDGE_S = 300e-9
"""Opening edge of the sensor before that of the thesis (5.1.3)."""
Taken = Literal["ac", "bc", "ab", "aa", "bb", "a_delayed", "ab_delayed"]
METHODS: dict[str, Taken] = {
    "mdsi1": "ac", "mdsi2": "bc", "mdsi3": "ab", "mdsi4": "ab", "gradient1": "aa", "gradient2": "bb",
    "csi": "a_delayed", "dcsi": "ab_delayed",
}  # fmt: skip
SHUTTER_S = 390e-9
_STRAIGHT_M = 14.0
_REPEATS = 1000
_METHOD_REPEATS = 600
_METHOD_AT_M = np.array([3.0, 5.0, 8.0, 12.0, 16.0, 21.0]) + 0.013


def pulsed_experiment(rng: np.random.Generator) -> Study:
    """MDSI1 beside MDSI3 with the whole camera at 3-21 m; three ways to sigma; the 300 ns edge of the older sensor.

    rng: of the simulated images.
    """
    camera = _camera()
    found = {
        (name, n): ranged(AT_M, PLYWOOD, _at(camera, name, n), name, _REPEATS, rng)
        for name in ("mdsi1", "mdsi3")
        for n in STEPS
    }
    old_m = _edge_errors(rng)
    claims = [*_compared(found), *_ratio(camera, found), *_three_ways(rng), *_old_sensor(old_m)]
    panels = [_sigma_panel(found), _ratio_panel(camera, found), _edge_panel(old_m)]
    return Study("pulsed-experiment", "König 2008, 5.1.3", claims, panels)


def _camera() -> PulsedCamera:
    """Return the camera with all of its noise, with so much light that one accumulation measures up to 21 m."""
    return PulsedCamera(speed_of_light_mps=3e8, far_margin_sigmas=0.0, min_snr=3.0)


def _at(camera: PulsedCamera, method: str, n: int) -> PulsedCamera:
    """Return the camera with the windows of a method and a fixed number of accumulations that saturate nowhere."""
    pixel = replace(camera.pixel, accumulations=(n,), saturation_v=1.5 * max(1, n), adc_bits=0)
    return replace(camera, shutters=METHODS[method], pixel=pixel)


def _compared(found: dict[tuple[str, int], Ranged]) -> list[Claim]:
    claims = []
    for n in STEPS:
        worse = found["mdsi1", n].sigma_m / found["mdsi3", n].sigma_m
        clear = (found["mdsi1", n].usable > 0.99) & (found["mdsi3", n].usable > 0.99)
        least = float(worse[clear].min())
        text = f"sigma_d MDSI1 over MDSI3, 3-21 m, {n} accumulations: least"
        claims.append(judged("F-K-17", text, None, least, "", least > 1, "MDSI3 is better at every distance"))
        claims.append(derived("K-CMP-07", f"distances of 19 at which {n} accumulations suffice", clear.sum(), ""))
    return claims


def _ratio(camera: PulsedCamera, found: dict[tuple[str, int], Ranged]) -> list[Claim]:
    calculated = _calculated_ratio(camera)
    ratio = found["mdsi1", 16].sigma_m / found["mdsi3", 16].sigma_m
    off = float(np.abs(ratio / calculated - 1).max())
    why = "within four standard errors; the measured one of the thesis exceeds the calculated"
    text = "MDSI1 over MDSI3 at 16 accumulations, measured over calculated: farthest from 1"
    return [judged("F-K-18", text, 1, 1 + off, "", off < 4 * np.sqrt(1 / _REPEATS) + 0.01, why)]


def _calculated_ratio(camera: PulsedCamera) -> Floats:
    one, three = (expected_sigma_m(AT_M, PLYWOOD, _at(camera, name, 16), name)[0] for name in ("mdsi1", "mdsi3"))
    return np.asarray(one / three)


def _three_ways(rng: np.random.Generator) -> list[Claim]:
    """Return whether each method's own sigma is that of its simulated ranges, jointly at 3 to 21 m with 99 %.

    Twelve times the light: that makes the propagation of noise linear, as the closed forms take it, for the gradient
    methods, too.
    """
    claims = []
    for name in METHODS:
        camera = _bright(name)
        expected_m = expected_sigma_m(_METHOD_AT_M, PLYWOOD, camera, name)[0]
        found = ranged(_METHOD_AT_M, PLYWOOD, camera, name, _METHOD_REPEATS, rng)
        ratio = (found.sigma_m / expected_m) ** 2
        tail = 0.005 / len(ratio)
        low, high = (float(chi2.ppf(end, _METHOD_REPEATS - 1)) / _METHOD_REPEATS for end in (tail, 1 - tail))
        agrees = bool(np.all((ratio > low) & (ratio < high)))
        text = f"variance of {name.upper()}, whole camera over its closed form, 3-21 m: farthest from 1"
        worst = float(ratio[np.abs(ratio - 1).argmax()])
        claims.append(judged("K-CMP-06", text, None, worst, "", agrees, "within the 99 % interval of the variance"))
    return claims


def _bright(method: str) -> PulsedCamera:
    camera = _at(_camera(), method, 16)
    late_s = camera.gradient_step_s if method == "gradient2" else 0.0  # or it would see nothing nearer than 4.5 m
    if method == "dcsi":
        camera = replace(camera, delay_first_s=-200e-9, delay_step_s=8e-9, delay_count=48)
    pixel = replace(camera.pixel, saturation_v=1e3)
    laser = replace(Laser(), peak_power_w=24e3)
    return replace(camera, laser=laser, pixel=pixel, laser_delay_s=late_s)


def _edge_errors(rng: np.random.Generator) -> dict[str, Floats]:
    """Return the errors of the mean range without noise, m (N,), with the edges of both sensors."""
    # Windows of 390 ns have room for the edge; the laser waits until its pulse ends as b opens for 0 m.
    late_s = SHUTTER_S - _camera().pulse_width_s
    ideal = replace(_camera(), shutter_a_width_s=SHUTTER_S, shutter_b_width_s=SHUTTER_S, laser_delay_s=late_s)
    new = measured_edges(ideal)
    cameras = {"sensor of the thesis": new, "older sensor": replace(new, shutter_opening_s=OLD_EDGE_S)}
    errors = {}
    for label, camera in cameras.items():
        for name in ("mdsi1", "mdsi3"):
            still = quiet(replace(_at(camera, name, 16), min_snr=1e-6))
            errors[f"{name.upper()}, {label}"] = ranged(AT_M, PLYWOOD, still, name, 1, rng).mean_m - AT_M
    return errors


def _old_sensor(errors: dict[str, Floats]) -> list[Claim]:
    """Return the errors up to 14 m; beyond, the edges of laser and shutter bend the ranges of both sensors."""
    claims = []
    for label, off_m in errors.items():
        worst_m = float(np.abs(off_m[AT_M <= _STRAIGHT_M]).max())
        fails = label == "MDSI3, older sensor"
        why = "over a metre: a pulse that moves into the window needs its opening edge" if fails else "below 5 cm"
        agrees = worst_m > 1 if fails else worst_m < 0.05
        text = f"largest error without noise, 3-14 m: {label}"
        claims.append(judged("K-CMP-09", text, None, 100 * worst_m, "cm", agrees, why))
    return claims


def _sigma_panel(found: dict[tuple[str, int], Ranged]) -> Panel:
    series = []
    for colour, n in enumerate(STEPS):
        for name, line in (("mdsi1", "--"), ("mdsi3", "-")):
            one = found[name, n]
            clear = one.usable > 0.99
            label = f"{name.upper()}, n = {n}"
            series.append(Series(label, AT_M[clear], 100 * one.sigma_m[clear], line=line, colour=colour))
    title = f"Reflectivity {PLYWOOD:g}, whole camera, {_REPEATS} images"
    return Panel(title, "range (m)", "standard deviation of the range (cm)", series, "y")


def _ratio_panel(camera: PulsedCamera, found: dict[tuple[str, int], Ranged]) -> Panel:
    ratio = found["mdsi1", 16].sigma_m / found["mdsi3", 16].sigma_m
    series = [
        Series("MDSI1 over MDSI3, calculated", AT_M, _calculated_ratio(camera), line="--"),
        Series("measured, ±2σ", AT_M, ratio, ratio / np.sqrt(_REPEATS), colour=0),
    ]
    return Panel("16 accumulations", "range (m)", "ratio of standard deviations", series)


def _edge_panel(errors: dict[str, Floats]) -> Panel:
    series = [Series(label, AT_M, off_m) for label, off_m in errors.items()]
    return Panel("Edges of both sensors, without noise", "range (m)", "error of the range (m)", series)
