"""Ways to measure distance without touching: what each leaves uncertain, the alternatives beside the cameras."""

import numpy as np
from numpy.typing import ArrayLike

from rangecam.config import load_config
from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.effects import Waveform
from rangecam.cw.signal import metres_per_radian
from rangecam.design.experiment import expected_sigma_m, regions
from rangecam.design.settings import Plan
from rangecam.pulsed.limits import expected_sigma_m as pulsed_sigma_m
from rangecam.pulsed.settings import PulsedCamera
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed
from rangecam.types import SPEED_OF_LIGHT, Floats

WAVELENGTH_M = 633e-9
BASELINE_M, FOCAL_LENGTH_M, PIXEL_SIGMA_M = 0.3, 16e-3, 1e-6
"""Of the stereo camera, as an example."""
COUNTER_S = 100e-12
"""Resolution of the clock of a laser scanner, as an example."""
_GREY = 0.5
_AT_M, _MODULATION_HZ = 5.25, 10e6


def range_of_time_m(time_s: ArrayLike, speed_mps: float = SPEED_OF_LIGHT) -> Floats:
    """Return how far away an echo was that came after `time_s` (König 2008, eqs 2.1, 2.12; K-LIT-01, K-LIT-08)."""
    return speed_mps / 2 * np.asarray(time_s, np.float64)


def time_of_range_s(range_m: ArrayLike, speed_mps: float = SPEED_OF_LIGHT) -> Floats:
    """Return when an echo comes from `range_m`: the inverse of `range_of_time_m`."""
    return 2 / speed_mps * np.asarray(range_m, np.float64)


def stereo_range_m(disparity_m: ArrayLike, baseline_m: float, focal_length_m: float) -> Floats:
    """Return how far away a point is whose images are so far apart on both sensors (König 2008, eq 2.7; K-LIT-05)."""
    return baseline_m * focal_length_m / np.asarray(disparity_m, np.float64)


def stereo_sigma_m(range_m: ArrayLike, baseline_m: float, focal_length_m: float, disparity_sigma_m: float) -> Floats:
    """Return the error of a stereo range, m (König 2008, eq 2.8).

    That of an active triangulation with a projector in the place of one camera is the same: the derivative of eq 2.9
    by the place on the sensor is d2/(b f), too (K-LIT-06).
    """
    return np.asarray(range_m, np.float64) ** 2 / (baseline_m * focal_length_m) * disparity_sigma_m


def interferometer_range_m(phase_rad: ArrayLike, wavelength_m: float) -> Floats:
    """Return the range that a phase between the beams of an interferometer stands for (König 2008, eq 2.2; K-LIT-04).

    One turn, beyond which ranges repeat, is half of the wavelength.
    """
    return wavelength_m / (4 * np.pi) * np.asarray(phase_rad, np.float64)


def ranging_principles(rng: np.random.Generator) -> Study:
    """Principles of distance measurement: interferometer, stereo, continuous wave, counter and pulsed camera compared.

    rng: of the simulated continuous-wave image, which has no noise.
    """
    claims = [*_time(), *_interferometer(), *_stereo(), *_continuous_wave(rng)]
    return Study("ranging-principles", "König 2008, chapter 2", claims, [_uncertainty(), _uniqueness()])


def _time() -> list[Claim]:
    return [
        printed("N-K-001", "time of flight of light for each metre", "6.67", float(time_of_range_s(1.0)) * 1e9, "ns/m"),
        derived("N-K-092", "range that 30 ps are", float(range_of_time_m(30e-12, 3e8)) * 1e3, "mm"),
    ]


def _interferometer() -> list[Claim]:
    turn = float(interferometer_range_m(2 * np.pi, WAVELENGTH_M)) / WAVELENGTH_M
    fine_nm = WAVELENGTH_M / 100 * 1e9
    return [
        printed("N-K-002", "unambiguous range of an interferometer over the wavelength", "0.5", turn, ""),
        judged("N-K-002", "a hundredth of 633 nm: a few nm", None, fine_nm, "nm", 1 < fine_nm < 10, "below ten"),
    ]


def _stereo() -> list[Claim]:
    lens = BASELINE_M, FOCAL_LENGTH_M
    disparity_m = BASELINE_M * FOCAL_LENGTH_M / 10.0
    found_m = 10.0 - float(stereo_range_m(disparity_m + PIXEL_SIGMA_M, *lens))
    formula_m = float(stereo_sigma_m(10.0, *lens, PIXEL_SIGMA_M))
    same = abs(found_m / formula_m - 1) < 0.005
    why = "the first order of a curve: within 0.5 %"
    return [
        derived("N-K-003", "error of stereo at 10 m by 1 um of disparity, eq 2.8", formula_m * 1e3, "mm"),
        judged("N-K-003", "the same as a difference of ranges", None, found_m * 1e3, "mm", same, why),
    ]


def _continuous_wave(rng: np.random.Generator) -> list[Claim]:
    """Return the range of a camera with square light and gates, as the thesis describes it (fig 2.5)."""
    camera = CwCamera(
        rows=1,
        columns=1,
        modulation_hz=_MODULATION_HZ,
        speed_of_light_mps=3e8,
        read_noise_lsb=0.0,
        shot_noise_lsb2_per_lsb=0.0,
        waveform=Waveform(illumination="square", reference="square"),
    )
    one = np.ones((1, 1, 1))
    raw = simulate(lambda _: View(_AT_M * one, one, one), camera, 0.0, rng)
    found_m = float(RANGING["cw_four_phase"](raw, camera).range_m[0, 0])
    # eq 2.11 as printed: c T_PW phi / (4 pi), T_PW half of a period
    as_printed_m = 3e8 / (2 * _MODULATION_HZ) * (found_m / metres_per_radian(camera)) / (4 * np.pi)
    wiggle = "within 0.15 m, the wiggling of square light: the phase in 0..2 pi, and the whole period (E-K-01)"
    return [
        judged(
            "E-K-01",
            "range of a target at 5.25 m by square light of 10 MHz",
            None,
            found_m,
            "m",
            abs(found_m - _AT_M) < 0.15,
            wiggle,
        ),
        derived("E-K-01", "the same as eq 2.11 is printed", as_printed_m, "m", "half of it: T_PW is half of a period"),
    ]


def _uncertainty() -> Panel:
    range_m = np.geomspace(0.3, 25, 120)
    car, plan = load_config("scaled_car"), Plan()
    wave_m = range_m[range_m < 8]
    wave_sigma_m = expected_sigma_m(car, regions(car.camera, plan)[0], wave_m, _GREY, plan)
    pulsed_m = range_m[range_m > 1.3]
    series = [
        Series("stereo, 0.3 m, 16 mm, 1 µm", range_m, _stereo_example(range_m)),
        Series("counter of 100 ps", range_m, np.full(range_m.shape, float(range_of_time_m(COUNTER_S)))),
        Series("continuous wave, 17 MHz, 50 %", wave_m, wave_sigma_m),
        Series("pulsed camera, MDSI3, 50 %", pulsed_m, pulsed_sigma_m(pulsed_m, _GREY, PulsedCamera())[0]),
    ]
    return Panel("What each leaves uncertain", "range (m)", "standard deviation or step (m)", series, "xy")


def _stereo_example(range_m: Floats) -> Floats:
    return stereo_sigma_m(range_m, BASELINE_M, FOCAL_LENGTH_M, PIXEL_SIGMA_M)


def _uniqueness() -> Panel:
    period_s = np.geomspace(1e-15, 1e-6, 50)
    waves = 1 / np.array([5e6, 12e6, 17e6, 30e6, 80e6, 100e6])
    pulses = np.array([33.3e-9, 180e-9, 667e-9])
    light = np.array([WAVELENGTH_M / SPEED_OF_LIGHT])
    marked = (("interferometer", light, 1), ("continuous wave, 5-100 MHz", waves, 4), ("pulses, 33-667 ns", pulses, 0))
    series = [Series("half the way of light", period_s, range_of_time_m(period_s), line=":", colour=6)]
    series += [Series(name, s, range_of_time_m(s), line="o", colour=colour) for name, s, colour in marked]
    return Panel("Range without ambiguity", "period or pulse (s)", "range (m)", series, "xy")
