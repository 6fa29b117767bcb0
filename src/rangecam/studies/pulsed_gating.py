"""Gating of the near range: a bead before a target vanishes when the windows open late enough."""

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from rangecam.optics import Objective
from rangecam.pulsed import RANGING, simulate
from rangecam.pulsed.delays import gating_ranges_m
from rangecam.pulsed.limits import targets_on_axis
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.scene.view import View
from rangecam.scene.weather import Weather, mirrored
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed
from rangecam.studies.virtual import SHUTTER_EDGE_S, looking_at, measured_edges, quiet
from rangecam.types import Floats

TARGET_M, BEAD_M, BEAD_DIAMETER_M = 5.0, 0.5, 4e-3
STEP_S = 15e-9
"""Between both windows; *open* in fig 5.8, 5-50 ns in the text."""
GATES_S = np.array([0.0, 2.0, 3.3, 5.0, 8.0, 10.0, 15.0]) * 1e-9
ERROR_M, GATED_ERROR_M, GATE_S = 1.05, 0.10, 10e-9
SHORT_S = 20e-9
"""Edge of the shutter that leaves about the measured error, with the 10 ns of the laser in 4.1.2.1."""
_REFLECTIVITY = 0.5
_REPEATS = 2000


def pulsed_gating(rng: np.random.Generator) -> Study:
    """Gating of the near range: a glass bead at 0.5 m before a target at 5 m, ideal and measured edges.

    rng: of the simulated images with noise.
    """
    ideal = PulsedCamera(
        speed_of_light_mps=3e8, shutters="bb", gradient_step_s=STEP_S, pixel=Pixel(accumulations=(16,))
    )
    # T_G counts from where the window is half open: diffusion opens it half an edge before the switch.
    soft = measured_edges(replace(ideal, shutter_delay_s=SHUTTER_EDGE_S / 2))
    short = replace(ideal, pulse_rise_s=10e-9, pulse_fall_s=10e-9, shutter_edge_s=SHORT_S, shutter_delay_s=SHORT_S / 2)
    cameras = {"ideal edges": ideal, "short edges": short, "edges of the thesis": soft}
    bead = {name: _fitted(camera) for name, camera in cameras.items()}
    gates_s = np.linspace(0, 20e-9, 41)
    errors_m = {name: _errors_m(camera, bead[name], gates_s) for name, camera in cameras.items()}
    noisy_m = {name: _noisy(camera, bead[name], rng) for name, camera in cameras.items()}
    claims = [*_ranges(ideal), *_bead(cameras, bead), *_errors(cameras, bead)]
    return Study("pulsed-gating", "König 2008, 5.2.1.3", claims, [_panel(gates_s, errors_m, noisy_m)])


def _ranges(camera: PulsedCamera) -> list[Claim]:
    text = "gating time for 0.5 m"
    claims = [printed("N-K-073", text, "3.33", 2 * BEAD_M / camera.speed_of_light_mps * 1e9, "ns")]
    gated_m = gating_ranges_m(replace(camera, gating_s=GATE_S))[0]
    claims.append(derived("N-K-073", "range that 10 ns gate", gated_m, "m"))
    for step_ns in (5, 20, 50):
        near_m, full_m, end_m = gating_ranges_m(replace(camera, gating_s=GATE_S, gradient_step_s=step_ns * 1e-9))
        why = "the end is that of the shorter of window and pulse (E-K-15)"
        name = f"10 ns gated, windows {step_ns} ns apart"
        claims += [
            derived(f"N-K-074.{step_ns}", f"nothing is seen up to, {name}", near_m, "m"),
            derived(f"N-K-074.{step_ns}", f"measures from, {name}", full_m, "m"),
            derived(f"N-K-074.{step_ns}", f"measures to, {name}", end_m, "m", why),
        ]
    return claims


def _view(strength: float, rows: int = 1) -> View:
    """Return target and bead in the same pixels; strength: light of the bead over that of the target."""
    range_m = np.broadcast_to(np.reshape([TARGET_M, BEAD_M], (2, 1, 1)), (2, rows, 1))
    of_bead = strength * (BEAD_M / TARGET_M) ** 2
    reflectivity = 2 * _REFLECTIVITY * np.broadcast_to(np.reshape([1.0, of_bead], (2, 1, 1)), (2, rows, 1))
    return View(range_m, reflectivity, np.ones((2, rows, 1)))


def _looked_at(camera: PulsedCamera, gate_s: float, strength: float, rng: np.random.Generator, rows: int) -> Floats:
    many, _ = targets_on_axis([TARGET_M], _REFLECTIVITY, replace(camera, gating_s=gate_s), rows)
    view = _view(strength, rows)
    return RANGING["gradient2"](simulate(looking_at(view), many, 0.0, rng), many).range_m[:, 0].astype(np.float64)


def _errors_m(camera: PulsedCamera, strength: float, gates_s: Floats) -> Floats:
    """Return the error by the bead without noise, m (N,): the range with it less the range without it."""
    still, rng = quiet(replace(camera, pixel=replace(camera.pixel, saturation_v=1e3))), np.random.default_rng(0)
    both = [[_looked_at(still, float(gate), s, rng, 1)[0] for s in (strength, 0.0)] for gate in gates_s]
    pairs = np.array(both)
    return np.asarray(pairs[:, 0] - pairs[:, 1])


def _fitted(camera: PulsedCamera) -> float:
    """Return the strength of the bead that makes the measured error without gating."""

    def off(strength: float) -> float:
        return float(_errors_m(camera, strength, np.zeros(1))[0]) + ERROR_M

    return float(brentq(off, 1e-3, 1e3))


def _bead(cameras: dict[str, PulsedCamera], bead: dict[str, float]) -> list[Claim]:
    lens, pixel = Objective(), Pixel()
    footprint_m2 = pixel.pitch_horizontal_m * pixel.pitch_vertical_m * (BEAD_M / lens.focal_length_m) ** 2
    part = np.pi / 4 * BEAD_DIAMETER_M**2 / footprint_m2
    sharp = part * mirrored(Weather(refractive_index=1.5)) * (TARGET_M / BEAD_M) ** 2
    fitted = "fitted to the measured error; the thesis does not state the bead's light"
    found = [derived("N-K-076", f"light of the bead over the target's, {n}", bead[n], "", fitted) for n in cameras]
    optics = "its front and rear by geometric optics, target of reflectivity 1, without blur"
    return [*found, derived("N-K-076", "the same of a 4 mm glass bead", sharp, "", optics)]


def _errors(cameras: dict[str, PulsedCamera], bead: dict[str, float]) -> list[Claim]:
    at = {name: 100 * _errors_m(camera, bead[name], GATES_S) for name, camera in cameras.items()}
    ideal_cm, short_cm, soft_cm = at.values()
    gated = int(np.flatnonzero(GATES_S == GATE_S)[0])
    past = float(np.abs(ideal_cm[GATES_S > 2 * BEAD_M / 3e8]).max())
    decays = bool(np.all(np.diff(short_cm) > 0) and np.all(np.diff(soft_cm) > 0))
    steeper = (
        "straight edges of 60, 30 and 65 ns have too long a toe for that: where there is little light, the real ones "
        "were steeper; 10 and 20 ns leave about the measured error"
    )
    claims = [
        printed("N-K-075", "factor from 1.05 to 0.10 m", "10.5", ERROR_M / GATED_ERROR_M, ""),
        judged("N-K-076", "ideal edges: largest error gated by over 3.33 ns", 0, past, "cm", past < 0.1, "below 1 mm"),
        judged(
            "F-K-20",
            "error that soft edges leave at 5 ns, and less the longer the gate",
            None,
            short_cm[3],
            "cm",
            decays and short_cm[3] < -10,
            "decays until 10 ns, instead of ending at 3.33 ns",
        ),
        judged(
            "N-K-076",
            "error gated by 10 ns, edges of 10 and 20 ns",
            -10,
            short_cm[gated],
            "cm",
            abs(short_cm[gated] + 10) < 3,
            "within 3 cm; edges chosen for it",
        ),
        judged(
            "N-K-076",
            "error gated by 10 ns, edges of the thesis",
            -10,
            soft_cm[gated],
            "cm",
            abs(soft_cm[gated] + 10) < 3,
            steeper,
        ),
    ]
    for name, errors in at.items():
        values = zip(GATES_S, errors, strict=True)
        claims += [derived("N-K-076", f"error gated by {gate * 1e9:g} ns, {name}", cm, "cm") for gate, cm in values]
    return claims


def _noisy(camera: PulsedCamera, strength: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return error and its standard deviation at GATES_S, m, of single images with noise."""
    without = [_looked_at(quiet(camera), float(gate), 0.0, rng, 1)[0] for gate in GATES_S]
    ranges_m = np.array([_looked_at(camera, float(gate), strength, rng, _REPEATS) for gate in GATES_S])
    return ranges_m.mean(axis=1) - without, ranges_m.std(axis=1)


def _panel(gates_s: Floats, errors_m: dict[str, Floats], noisy_m: dict[str, tuple[Floats, Floats]]) -> Panel:
    series = [Series(name, gates_s * 1e9, 100 * errors, colour=i) for i, (name, errors) in enumerate(errors_m.items())]
    for i, (mean_m, sigma_m) in enumerate(noisy_m.values()):
        series.append(Series("", GATES_S * 1e9, 100 * mean_m, 100 * sigma_m / np.sqrt(_REPEATS), colour=i))
    series.append(Series("measured (fig 5.8)", [0.0, 10.0], [-100 * ERROR_M, -100 * GATED_ERROR_M], line="s", colour=3))
    title = "Bead at 0.5 m before a target at 5 m; points: mean of simulated images, ±2σ"
    return Panel(title, "gating time (ns)", "error of the range (cm)", series)
