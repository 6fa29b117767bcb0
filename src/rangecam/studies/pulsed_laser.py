"""The laser on the bench: its pulse shapes, its power, how it falls as the laser warms up, its jitter."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed.laser import power_fraction, thermal_limit_hz
from rangecam.pulsed.settings import Laser, PulsedCamera
from rangecam.pulsed.signal import pulse_shape
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import FALL_S, RISE_S, measured_edges, ranged
from rangecam.types import Floats

TRIGGERS_S = (60e-9, 90e-9, 120e-9, 180e-9, 240e-9)
RATES_HZ = (8e3, 10e3, 11e3)
DIODE_M2, LIT_M2, MEASURED_W = 5.03e-7, 3.85e-3, 0.245
JITTER_S = 30e-12
_ROOM_C = 25.0
_IMAGES = 300


def pulsed_laser(rng: np.random.Generator) -> Study:
    """The laser on the bench: pulse shapes, output power, its fall while warming up, jitter.

    rng: of the jitter of simulated images.
    """
    shapes = {width_s: _shape(width_s) for width_s in TRIGGERS_S}
    at_s = np.linspace(0.0, 600.0, 301)
    courses = {rate_hz: _course(rate_hz, at_s) for rate_hz in RATES_HZ}
    claims = [*_edges(shapes), _power(), *_stable(courses), *_jitter(rng)]
    return Study("pulsed-laser", "König 2008, 4.2.2", claims, [_shape_panel(shapes), _course_panel(at_s, courses)])


def _shape(width_s: float) -> tuple[Floats, Floats]:
    """Return time, s, and power over its peak, of a pulse as the diode sees it (K-CHR-04)."""
    camera = replace(measured_edges(PulsedCamera()), pulse_width_s=width_s, pulse_edges="rounded", pulse_rounding=0.05)
    at_s = np.arange(-60e-9, 320e-9, 0.5e-9)
    return at_s, pulse_shape(at_s, camera)


def _edges(shapes: dict[float, tuple[Floats, Floats]]) -> list[Claim]:
    claims = []
    for width_s, (at_s, part) in shapes.items():
        top = part.max()
        above = np.flatnonzero(part > 0.01 * top)
        level = np.flatnonzero(part > 0.95 * top)
        rise_s, fall_s = at_s[level[0]] - at_s[above[0]], at_s[above[-1]] - at_s[level[-1]]
        agrees = abs(rise_s - RISE_S) < 15e-9 and abs(fall_s - FALL_S) < 15e-9
        name, why = (
            f"pulse of {width_s * 1e9:g} ns",
            "about 60 and 30 ns, whatever the length; 1 to 90 %, with a round top",
        )
        claims += [
            judged("F-K-04", f"{name}: rises in", 60, rise_s * 1e9, "ns", agrees, why),
            judged("F-K-04", f"{name}: falls in", 30, fall_s * 1e9, "ns", agrees, why),
        ]
    return claims


def _power() -> Claim:
    """Return what the diode of the thesis gets of a module (K-CHR-05)."""
    diode_w = Laser().peak_power_w * DIODE_M2 / LIT_M2
    why = "within 10 %: 1.87 kW are measured, 2 kW are taken for all that follows (4.2.2.2)"
    agrees = abs(diode_w / MEASURED_W - 1) < 0.1
    return judged("K-CHR-05", "power on the diode at 0.1 m", MEASURED_W, diode_w, "W", agrees, why)


def _course(rate_hz: float, at_s: Floats) -> Floats:
    return power_fraction(Laser(repetition_hz=rate_hz), PulsedCamera().pulse_width_s, _ROOM_C, at_s)


def _stable(courses: dict[float, Floats]) -> list[Claim]:
    ends = {rate_hz: 100 * float(part[-1]) for rate_hz, part in courses.items()}
    falls = all(part[0] == 1 and np.all(np.diff(part) <= 0) for part in courses.values())
    limit_hz = thermal_limit_hz(Laser(), PulsedCamera().pulse_width_s, _ROOM_C)
    at_10, at_11 = ends[10e3], ends[11e3]
    return [
        judged("N-K-046", "power after 10 minutes at 10 kHz", 70, at_10, "%", 70 < at_10 < 73, "just above 70 %"),
        judged("N-K-046", "power after 10 minutes at 11 kHz", 70, at_11, "%", at_11 < 70, "below 70 %"),
        judged("F-K-05", "power after 10 minutes at 8 kHz", None, ends[8e3], "%", falls, "full at first, then falls"),
        derived("N-K-046", "repetition rate at which it settles at 70 %", limit_hz / 1e3, "kHz"),
    ]


def _jitter(rng: np.random.Generator) -> list[Claim]:
    """Return the spread of ranges that jitter of the trigger makes: of one pulse, and of an image (K-CHR-06)."""
    camera = PulsedCamera()
    of_pulse_mm = camera.speed_of_light_mps / 2 * JITTER_S * 1e3
    quiet = replace(camera.pixel, sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0)
    shaky = replace(camera, laser=Laser(trigger_jitter_s=JITTER_S), pixel=replace(quiet, accumulations=(16,)))
    images_m = [ranged([10.0], 0.5, shaky, "mdsi3", 1, rng).mean_m[0] for _ in range(_IMAGES)]
    spread_mm = 1e3 * float(np.std(images_m))
    averaged = "a mean over 16 pulses of each window"
    return [
        judged("N-K-092", "range of 30 ps: a few mm", None, of_pulse_mm, "mm", 1 < of_pulse_mm < 10, "4.5 mm"),
        judged("N-K-092", "spread of images by it", None, spread_mm, "mm", spread_mm < of_pulse_mm, averaged),
    ]


def _shape_panel(shapes: dict[float, tuple[Floats, Floats]]) -> Panel:
    series = [Series(f"{width_s * 1e9:g} ns", at_s * 1e9, part) for width_s, (at_s, part) in shapes.items()]
    return Panel("Pulses by the length of the trigger", "time (ns)", "power over its peak", series)


def _course_panel(at_s: Floats, courses: dict[float, Floats]) -> Panel:
    series = [Series(f"{rate_hz / 1e3:g} kHz", at_s / 60, 100 * part) for rate_hz, part in courses.items()]
    series.append(Series("least that does no harm", at_s / 60, np.full(at_s.shape, 70.0), line="--"))
    return Panel("Warming up, 2 kW, 180 ns", "time (min)", "power (%)", series)
