"""Noise parameters from recordings: sigma_S and sigma_R from dark frames, the line of variance over light from taps."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from rangecam.calibration import Calibration, Recording
from rangecam.pulsed import CALIBRATE, RANGING, PulsedCamera, simulate
from rangecam.pulsed.settings import Pixel
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import RawFrame

_STEPS = (1, 4, 16, 64, 100)
_WIDTHS_S = (90e-9, 180e-9, 400e-9)
_DARK_FRAMES, _TAP_FRAMES = 120, 30
_PIXEL = Pixel(fixed_pattern_v=5e-3, fixed_pattern_per_pulse_v=0.3e-3)
_TAPS = PulsedCamera(readout="three_tap", rows=100, columns=60, frame_rate_hz=2.0, pulse_width_s=30e-9)


def noise_fit(rng: np.random.Generator) -> Study:
    """Noise fit: sigma_S and sigma_R from dark frames, and the noise of a three-tap sensor from a scene at rest.

    rng: of the noise of all recordings.
    """
    shutters = {width_s: _shutter_fit(width_s, 0.0153, rng) for width_s in _WIDTHS_S}
    undamped, taps = _shutter_fit(180e-9, 0.0, rng), _tap_fit(rng)
    claims = [*_shutter_claims(shutters, undamped), *_tap_claims(taps)]
    found, x = shutters[180e-9], np.linspace(0, 100)
    light = np.linspace(0, max(taps["x"]))
    panels = [
        Panel(
            "Dark frames, damping taken off",
            "accumulations",
            "variance, mV2",
            [
                Series("simulated", found["x"], np.array(found["variance"]) * 1e6, np.array(found["error"]) * 1e6),
                Series("n sigma_S2 + sigma_R2, fitted", x, (found["base"] + found["slope"] * x) * 1e6),
                Series("damping left in", undamped["x"], np.array(undamped["variance"]) * 1e6, line="o--"),
            ],
        ),
        Panel(
            "Three taps, a staircase of grey",
            "light, counts",
            "variance, counts2",
            [
                Series("simulated", taps["x"], taps["variance"], taps["error"]),
                Series("fitted", light, taps["base"] + taps["slope"] * light),
            ],
        ),
    ]
    return Study("noise-fit", "König 2008, 4.2.3.1", claims, panels)


def _shutter_fit(width_s: float, damping: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return the fit to dark frames of windows of this length, read as if the pixel damped so."""
    camera = PulsedCamera(pixel=_PIXEL, pulse_width_s=width_s)

    nothing = np.zeros((1, camera.rows, camera.columns))
    view = View(nothing + np.inf, nothing, nothing + 1)

    def frames() -> Iterator[RawFrame]:
        for n in _STEPS:
            one = replace(camera, pixel=replace(_PIXEL, accumulations=(n,)))
            yield from (simulate(lambda _: view, one, 0.0, rng) for _ in range(_DARK_FRAMES))

    taken_for = replace(camera, pixel=replace(_PIXEL, damping=damping))
    return _fit(Recording("dark", frames(), taken_for, "mdsi3", RANGING["mdsi3"]))


def _tap_fit(rng: np.random.Generator) -> dict[str, Any]:
    grey = np.geomspace(2e-4, 0.02, _TAPS.columns) * np.ones((1, _TAPS.rows, 1))
    view = View(np.full(grey.shape, 3.0), grey, np.ones(grey.shape))
    frames = (simulate(lambda _: view, _TAPS, 0.0, rng) for _ in range(_TAP_FRAMES))
    return _fit(Recording("staircase", frames, _TAPS, "three_tap", RANGING["three_tap"]))


def _fit(recording: Recording) -> dict[str, Any]:
    fit: dict[str, Any] = CALIBRATE["noise"]([recording], Calibration({})).taken["noise"]
    return fit


def _shutter_claims(shutters: dict[float, dict[str, Any]], undamped: dict[str, Any]) -> list[Claim]:
    claims = []
    for name, thesis_mv, label in (("sensor_noise_v", 0.379, "sigma_S"), ("readout_noise_v", 0.442, "sigma_R")):
        for width_s, fit in shutters.items():
            found_mv = fit["found"][name] * 1e3
            text = f"{label} from dark frames, shutters of {width_s * 1e9:g} ns"
            near = abs(found_mv / thesis_mv - 1) < 0.02
            claims.append(judged("K-NOI-04", text, thesis_mv, found_mv, "mV", near, "within 2 % of what was simulated"))
    found_mv = undamped["found"]["sensor_noise_v"] * 1e3
    why = "variances over n bend down as d2 does; they must be divided by it (E-K-10)"
    return [*claims, derived("K-NOI-03", "sigma_S, if the damping of the noise is left in", found_mv, "mV", why)]


def _tap_claims(taps: dict[str, Any]) -> list[Claim]:
    known, found, near = _TAPS.taps, taps["found"], "within 5 % of what was simulated"
    pairs = (
        ("read noise of a tap", "counts", known.read_noise_counts, found["read_noise_counts"]),
        ("variance per count of light", "counts", known.shot_noise_counts2_per_count,
         found["shot_noise_counts2_per_count"]),
    )  # fmt: skip
    return [
        judged("K-NOI-04", text, None, value, unit, abs(value / true - 1) < 0.05, near)
        for text, unit, true, value in pairs
    ]
