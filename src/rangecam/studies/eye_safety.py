"""Eye safety of the laser module: what the thesis' numbers determine, and what they do not."""

import math

import numpy as np

from rangecam.optics import SMALL_SOURCE_RAD, lit_area_m2, mpe_jpm2
from rangecam.pulsed.settings import PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats

WAVELENGTH_M = 905e-9
REPETITION_HZ = 20e3
"""That the thesis takes for the MPE; the camera runs at 10 kHz."""
STATED_MPE_JPM2 = 0.00205
LIT_AREA_M2 = 3.85e-3
"""At 0.1 m, of eq 4.20."""
_NEAR_M = 0.1


def eye_safety(rng: np.random.Generator) -> Study:
    """Eye safety of the laser module: permitted exposure, exposure over distance, distance of class 1.

    rng: not used, nothing here is random.
    """
    camera = PulsedCamera()
    energy_j = camera.laser.peak_power_w * camera.pulse_width_s
    point = float(_mpe(camera, 0.0))
    size = STATED_MPE_JPM2 / point
    near = {
        "30 x 9 degrees": energy_j / float(lit_area_m2(_NEAR_M, math.radians(30), math.radians(9))),
        "the area of eq 4.20": energy_j / LIT_AREA_M2,
    }
    claims = [*_permitted(point, size), *_exposed(near)]
    return Study("eye-safety", "König 2008, 4.2.2.4", claims, [_over_distance(camera, near, size)])


def _mpe(camera: PulsedCamera, source_rad: Floats | float) -> Floats:
    return mpe_jpm2(camera.pulse_width_s, REPETITION_HZ, WAVELENGTH_M, source_rad)


def _permitted(point: float, size: float) -> list[Claim]:
    source_mrad = size * SMALL_SOURCE_RAD * 1e3
    agrees = abs(point - STATED_MPE_JPM2) <= 5e-6
    extended = (
        f"a point source; the print is that of an extended source, C6 = {size:.2f}, which the thesis does not give"
    )
    return [
        judged(
            "N-K-044", "exposure by one pulse that class 1 permits", STATED_MPE_JPM2, point, "J/m2", agrees, extended
        ),
        derived("N-K-044", "angle of the source with which the stated exposure is right", source_mrad, "mrad"),
        derived("N-K-044", "size of that source at 0.1 m", source_mrad * _NEAR_M, "mm"),
    ]


def _exposed(near: dict[str, float]) -> list[Claim]:
    claims = []
    for field, exposure in near.items():
        ratio = exposure / STATED_MPE_JPM2
        safe_m = _NEAR_M * math.sqrt(ratio)
        why = "power, pulse and field of the thesis do not give its 0.3 m: beam shape and source size are open (E-K-29)"
        claims += [
            judged(
                "N-K-045",
                f"exposure at 0.1 m over the stated limit, {field}: violated",
                None,
                ratio,
                "",
                ratio > 1,
                "above one",
            ),
            judged("N-K-045", f"distance of class 1, {field}", 0.3, safe_m, "m", abs(safe_m - 0.3) <= 0.05, why),
        ]
    return claims


def _over_distance(camera: PulsedCamera, near: dict[str, float], size: float) -> Panel:
    """Return the exposure over what is permitted; the source looks the smaller the farther away it is."""
    range_m = np.geomspace(_NEAR_M, 10, 100)
    source_rad = size * SMALL_SOURCE_RAD * _NEAR_M / range_m
    series = []
    for field, exposure in near.items():
        falling = exposure * (_NEAR_M / range_m) ** 2
        series.append(Series(f"{field}, stated limit", range_m, falling / STATED_MPE_JPM2))
        label = f"{field}, limit falling with the source's angle"
        series.append(Series(label, range_m, falling / _mpe(camera, source_rad), line=":"))
    series.append(Series("class 1", range_m, np.ones(range_m.shape), line="--"))
    return Panel("2 kW, 180 ns, 20 kHz, 905 nm", "distance (m)", "exposure over the permitted one", series, "xy")
