"""The ranging methods of the pulsed camera compared: standard deviation over range, calculated and simulated."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed import RANGING
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import expected_sigma_m, targets_on_axis
from rangecam.pulsed.pixel import dark_noise
from rangecam.pulsed.settings import PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.thesis_camera import thesis_camera
from rangecam.types import Floats

METHODS = ("mdsi1", "mdsi2", "mdsi3", "mdsi4")
RATIO_AT_M = (3.0, 5.0, 8.0, 10.0, 13.5, 16.0, 18.0, 20.0, 21.0)
_REFLECTIVITY = 0.5
_ACCUMULATIONS = 16
_REPEATS = 5000
_TOLERANCE = 3 / np.sqrt(2 * (_REPEATS - 1)) + 0.01
_GRADIENT_STEPS_S = (10e-9, 30e-9, 50e-9)
_GRADIENT_AT_M = (5.0, 10.0, 15.0)
_DCSI_STEP_S = 9e-9
_CODES = 16
"""Bits over the wide scale: the step of 12 bits over 1.5 V."""


def pulsed_methods(rng: np.random.Generator) -> Study:
    """Ranging methods of the pulsed camera compared: MDSI1-4, gradient, DCSI, calculated and simulated.

    rng: of the simulated images.
    """
    camera = _camera()
    at_m = np.linspace(2.0, 22.0, 201)
    calculated = {name: expected_sigma_m(at_m, _REFLECTIVITY, camera, name)[0] for name in METHODS}
    simulated_m = np.array([5.0, 8.0, 12.0, 16.0, 20.0])
    found = {name: _simulated(simulated_m, name, camera, rng) for name in METHODS}
    rounding = replace(camera, pixel=replace(camera.pixel, adc_bits=_CODES))
    rounded = {name: _simulated(simulated_m, name, rounding, rng) for name in ("mdsi1", "mdsi3")}
    delayed = _with_delays(camera, 5)
    others = {
        "gradient 1, 30 ns": expected_sigma_m(at_m, _REFLECTIVITY, _with_step(camera, 30e-9), "gradient1")[0],
        "DCSI, 5 delays": expected_sigma_m(at_m, _REFLECTIVITY, delayed, "dcsi")[0],
    }
    calculated["dcsi"] = others["DCSI, 5 delays"]
    found["dcsi"] = _simulated(simulated_m, "dcsi", delayed, rng)
    claims = [
        *_ratios(camera),
        *_shapes(at_m, calculated),
        *_gradient(camera),
        *_dcsi(camera),
        *_equal(simulated_m, camera, found, rounded),
        _dcsi_equal(simulated_m, delayed, found["dcsi"]),
    ]
    panels = [_sigma_panel(at_m, calculated, simulated_m, found), _ratio_panel(at_m, calculated, others)]
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


def _gradient(camera: PulsedCamera) -> list[Claim]:
    """Return how much worse the gradient method is (eq 5.8 with the difference below the line, E-K-12)."""
    mdsi3 = expected_sigma_m(_GRADIENT_AT_M, _REFLECTIVITY, camera)[0]
    claims = []
    for step_s in _GRADIENT_STEPS_S:
        sigma = expected_sigma_m(_GRADIENT_AT_M, _REFLECTIVITY, _with_step(camera, step_s), "gradient1")[0]
        for range_m, ratio in zip(_GRADIENT_AT_M, sigma / mdsi3, strict=True):
            number, step = f"N-K-063.{step_s * 1e9:g}", f"{step_s * 1e9:g} ns apart"
            text = f"GRAD1 especially bad: sigma_d over that of MDSI3 at {range_m:g} m, {step}"
            why = "above one; with the sum of the print below the line it would be the best method (E-K-12)"
            claims.append(judged(number, text, None, ratio, "", ratio > 1, why))
    return claims


def _with_step(camera: PulsedCamera, step_s: float) -> PulsedCamera:
    return replace(camera, shutters="aa", gradient_step_s=step_s)


def _dcsi(camera: PulsedCamera) -> list[Claim]:
    """Return the standard deviation of DCSI where its delays lie evenly about the change of sign.

    In units of c/2 T_Pw sigma_U / U_c, in which MDSI3 has 0.71 to 1 and MDSI1 1 to 1.41.
    """
    claims = [
        derived("N-K-064", f"DCSI with {used} delays, over c/2 T_Pw sigma_U/U_c", _dcsi_unit(camera, used), "")
        for used in (2, 5, 10, 20)
    ]
    why = "the noise does not make it worse than MDSI1 and MDSI3; frame rate and complexity speak against it (E-K-42)"
    for used in (5, 10, 20):
        n = 100 // used
        fewer = replace(camera, pixel=replace(camera.pixel, accumulations=(n,)))
        dark = [float(dark_noise(k, camera.pixel)) / k for k in (n, 100)]
        share = _dcsi_unit(fewer, used) * dark[0] / dark[1]
        text = f"DCSI worse than MDSI3 (1 at most) at equal pulses: {used} delays of {n}, in units of n = 100"
        claims.append(judged("N-K-064b", text, None, share, "", share > 1, why))
    return claims


def _dcsi_equal(at_m: Floats, delayed: PulsedCamera, found: Floats) -> Claim:
    ratio = found / expected_sigma_m(at_m, _REFLECTIVITY, delayed, "dcsi")[0]
    worst = float(ratio[np.argmax(np.abs(ratio - 1))])
    text = "sigma_d DCSI with 5 delays, simulated over calculated, 5-20 m: farthest from 1"
    agrees = abs(worst - 1) < _TOLERANCE
    return judged(
        "N-K-065", text, None, worst, "", agrees, f"within three standard errors of {_REPEATS} values and 1 %"
    )


def _dcsi_unit(camera: PulsedCamera, used: int) -> float:
    at_m = np.linspace(12.0, 13.5, 151)  # more than one step of the delays
    sigma_m = expected_sigma_m(at_m, _REFLECTIVITY, _with_delays(camera, used), "dcsi")[0]
    quotient = at_m / (camera.speed_of_light_mps / 2 * camera.pulse_width_s)
    mdsi3_m = expected_sigma_m(at_m, _REFLECTIVITY, camera)[0]
    return float((sigma_m / mdsi3_m * np.hypot(quotient, 1 - quotient)).min())  # eq 5.6


def _with_delays(camera: PulsedCamera, used: int) -> PulsedCamera:
    """Return the camera with laser delays that reach all ranges, `used` of them in the line of DCSI."""
    step_s = _DCSI_STEP_S
    return replace(
        camera,
        shutters="ab_delayed",
        delay_first_s=-20 * step_s,
        delay_step_s=step_s,
        delay_count=43,
        linear_part_s=used * step_s,
    )


def _equal(at_m: Floats, camera: PulsedCamera, found: dict[str, Floats], rounded: dict[str, Floats]) -> list[Claim]:
    """Return that simulation leads to the same as calculation (fig 5.2), within three standard errors and 1 %.

    1 %: the quotient of two noisy values spreads a little more than its linear propagation says.
    """
    why = f"simulated ({_REPEATS} values); within three standard errors and 1 % of the calculated"
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
                agrees = abs(values[name][i] / sigma[i] - 1) < _TOLERANCE
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


def _ratio_panel(at_m: Floats, calculated: dict[str, Floats], others: dict[str, Floats]) -> Panel:
    mdsi = {name.upper(): calculated[name] for name in METHODS if name != "mdsi3"}
    series = [Series(name, at_m, sigma / calculated["mdsi3"]) for name, sigma in (mdsi | others).items()]
    golden = Series("golden ratio", at_m, np.full(at_m.shape, (1 + np.sqrt(5)) / 2), line="--")
    return Panel("Beside MDSI3", "range (m)", "ratio of standard deviations to MDSI3", [*series, golden])
