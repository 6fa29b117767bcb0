"""The ranging methods of the pulsed camera compared: standard deviation over range, calculated and simulated."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import expected_sigma_m, targets_on_axis
from rangecam.pulsed.ranging import RANGING
from rangecam.pulsed.settings import PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.thesis_camera import thesis_camera
from rangecam.types import Floats

METHODS = ("mdsi1", "mdsi2", "mdsi3", "mdsi4")
RATIO_AT_M = (3.0, 5.0, 8.0, 10.0, 13.5, 16.0, 18.0, 20.0, 21.0)
_REFLECTIVITY = 0.5
_ACCUMULATIONS = 16
_REPEATS = 5000
_CODES = 16
"""Bits over the wide scale: the step of 12 bits over 1.5 V."""


def pulsed_methods(rng: np.random.Generator) -> Study:
    """Ranging methods of the pulsed camera compared: MDSI1-4, calculated and simulated, with and without rounding.

    rng: of the simulated images.
    """
    camera = _camera()
    at_m = np.linspace(2.0, 22.0, 201)
    calculated = {name: expected_sigma_m(at_m, _REFLECTIVITY, camera, name)[0] for name in METHODS}
    simulated_m = np.array([5.0, 8.0, 12.0, 16.0, 20.0])
    found = {name: _simulated(simulated_m, name, camera, rng) for name in METHODS}
    rounding = replace(camera, pixel=replace(camera.pixel, adc_bits=_CODES))
    rounded = {name: _simulated(simulated_m, name, rounding, rng) for name in ("mdsi1", "mdsi3")}
    claims = [*_ratios(camera), *_shapes(at_m, calculated), *_equal(simulated_m, camera, found, rounded)]
    panels = [_sigma_panel(at_m, calculated, simulated_m, found), _ratio_panel(at_m, calculated)]
    return Study("pulsed-methods", "König 2008, 5.1", claims, panels)


def _camera() -> PulsedCamera:
    """Return the camera of section 5.1: no adaptive accumulation, and nothing saturates in the calculation."""
    camera = thesis_camera(shutters="abc")
    return replace(camera, pixel=replace(camera.pixel, accumulations=(_ACCUMULATIONS,), saturation_v=24.0))


def _simulated(at_m: Floats, method: str, camera: PulsedCamera, rng: np.random.Generator) -> Floats:
    """Return the standard deviation of the ranges of many simulated images, m (N,)."""
    many, view = targets_on_axis(at_m, _REFLECTIVITY, camera, _REPEATS)
    range_m = RANGING[method](simulate(lambda _: view, many, 0.0, rng), many).range_m
    deviation_m: Floats = range_m.std(axis=0, dtype=np.float64)
    return deviation_m


def _ratios(camera: PulsedCamera) -> list[Claim]:
    sigma = {name: expected_sigma_m(RATIO_AT_M, _REFLECTIVITY, camera, name)[0] for name in METHODS}
    claims = []
    for i, range_m in enumerate(RATIO_AT_M):
        for name in ("mdsi1", "mdsi2"):
            text = f"sigma_d {name.upper()} / MDSI3 at {range_m:g} m"
            claims.append(derived(f"N-K-060.{range_m:g}", text, sigma[name][i] / sigma["mdsi3"][i], ""))
    return claims


def _shapes(at_m: Floats, sigma: dict[str, Floats]) -> list[Claim]:
    most = float((sigma["mdsi2"] / sigma["mdsi3"]).max())
    inside = (at_m >= 5) & (at_m <= 20)
    least = [float((sigma[name] / sigma["mdsi3"])[inside].min()) for name in ("mdsi1", "mdsi2")]
    apart = float(np.abs(sigma["mdsi4"] / sigma["mdsi3"] - 1).max())
    golden = "eqs 5.5 and 5.6 allow the golden ratio at most, 1.618; only the order of the methods follows (E-K-13)"
    return [
        judged("N-K-061", "sigma_d MDSI2 more than twice that of MDSI3: largest ratio", 2, most, "", most > 2, golden),
        judged(
            "N-K-062", "MDSI1 never better than MDSI3: least ratio, 5-20 m", None, least[0], "", least[0] > 1, "above 1"
        ),
        judged(
            "N-K-062", "MDSI2 never better than MDSI3: least ratio, 5-20 m", None, least[1], "", least[1] > 1, "above 1"
        ),
        judged(
            "N-K-062",
            "MDSI4 is as good as MDSI3: largest difference",
            None,
            apart,
            "",
            apart < 1e-5,
            "to single precision",
        ),
    ]


def _equal(at_m: Floats, camera: PulsedCamera, found: dict[str, Floats], rounded: dict[str, Floats]) -> list[Claim]:
    """Return that simulation leads to the same as calculation (fig 5.2), within three standard errors and 1 %.

    1 %: the quotient of two noisy values spreads a little more than its linear propagation says.
    """
    why = f"simulated ({_REPEATS} values); within three standard errors and 1 % of the calculated"
    tolerance = 3 / np.sqrt(2 * (_REPEATS - 1)) + 0.01
    claims = []
    for number, name in ((1, "mdsi1"), (3, "mdsi3")):
        sigma = expected_sigma_m(at_m, _REFLECTIVITY, camera, name)[0]
        for i, range_m in enumerate(at_m):
            if range_m not in (5.0, 12.0, 20.0):
                continue
            for how, values in (("without", found), ("with", rounded)):
                text = (
                    f"sigma_d {name.upper()}, {range_m:g} m, simulated {how} rounding; calculated {sigma[i] * 100:.2f}"
                )
                agrees = abs(values[name][i] / sigma[i] - 1) < tolerance
                claims.append(
                    judged(f"N-K-065.{number}.{range_m:g}", text, None, values[name][i] * 100, "cm", agrees, why)
                )
    return claims


def _sigma_panel(at_m: Floats, calculated: dict[str, Floats], simulated_m: Floats, found: dict[str, Floats]) -> Panel:
    lines = [
        Series(name.upper(), at_m, sigma * 100, line="--" if name == "mdsi4" else "-")
        for name, sigma in calculated.items()
    ]
    error = np.sqrt(2 * (_REPEATS - 1))
    points = [
        Series("", simulated_m, sigma * 100, sigma * 100 / error, colour=i) for i, sigma in enumerate(found.values())
    ]
    title = f"Reflectivity {_REFLECTIVITY:g}, {_ACCUMULATIONS} accumulations; points: simulated, ±2σ"
    return Panel(title, "range (m)", "standard deviation of the range (cm)", [*lines, *points])


def _ratio_panel(at_m: Floats, calculated: dict[str, Floats]) -> Panel:
    series = [
        Series(f"{name.upper()} / MDSI3", at_m, calculated[name] / calculated["mdsi3"])
        for name in METHODS
        if name != "mdsi3"
    ]
    golden = Series("golden ratio", at_m, np.full(at_m.shape, (1 + np.sqrt(5)) / 2), line="--")
    return Panel("Beside MDSI3", "range (m)", "ratio of standard deviations", [*series, golden])
