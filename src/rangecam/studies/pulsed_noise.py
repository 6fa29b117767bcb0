"""Noise of the shutter pixel: accumulation, damping, noise equivalent exposure, dynamic range, needed input range."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import (
    dynamic_range_photodiode_db,
    dynamic_range_system_db,
    nee_sensor_jpm2,
    nee_system_jpm2,
    required_input_range_db,
    required_snr,
    targets_on_axis,
)
from rangecam.pulsed.pixel import (
    ELEMENTARY_CHARGE_C,
    accumulated,
    damping,
    dark_noise,
    photon_noise,
    responsivity,
    volts_per_coulomb,
)
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed
from rangecam.types import Floats

ACCURACY = 0.03
RANGE_M, REFLECTIVITY = (2.0, 20.0), (0.05, 1.0)
_STEPS = (1, 4, 16, 64, 100)
_DARK_VALUES = 16_000


def pulsed_noise(rng: np.random.Generator) -> Study:
    """Noise of the pulsed camera: accumulation, damping, noise equivalent exposure, dynamic range.

    rng: of simulated dark images.
    """
    camera = PulsedCamera()
    dark = {n: _dark_values(n, camera, rng) for n in _STEPS}
    claims = [
        *_signal(camera.pixel),
        *_noise(camera.pixel),
        *_simulated(dark, camera.pixel),
        *_exposures(camera.pixel),
        *_ranges(camera),
    ]
    return Study("pulsed-noise", "König 2008, 4.1.1, 4.2.1, 4.2.3.1 and 4.2.3.3", claims, _panels(dark, camera.pixel))


def _dark_values(n: int, camera: PulsedCamera, rng: np.random.Generator) -> Floats:
    """Return shutter values without light after `n` accumulations, V (N,), from simulated images."""
    pixel = replace(camera.pixel, accumulations=(n,), adc_bits=0)
    dark, view = targets_on_axis(np.ones(_DARK_VALUES // 100), 0.0, replace(camera, pixel=pixel), rows=100)
    values_v: Floats = np.ravel(simulate(lambda _: view, dark, 0.0, rng).planes["shutter_a"]).astype(np.float64)
    return values_v


def _signal(pixel: Pixel) -> list[Claim]:
    gain, volts = volts_per_coulomb(pixel), responsivity(pixel)
    full_jpm2 = pixel.saturation_v / volts
    limit = float(accumulated(1.0, 10_000, pixel))
    return [
        derived("N-K-023", "conversion gain of the pixel", gain * ELEMENTARY_CHARGE_C * 1e9, "nV/e"),
        printed("N-K-024", "responsivity at 905 nm (sensitivity 0.1204 A/W set for it)", "2617", volts, "V/(J/m2)"),
        derived("N-K-025", "exposure that fills the pixel", full_jpm2 * 1e6, "uJ/m2"),
        derived("N-K-025", "photo electrons of it", pixel.saturation_v / gain / ELEMENTARY_CHARGE_C, "e"),
        printed("N-K-026.1", "damping d(1)", "1", float(damping(1, pixel)), ""),
        *(derived(f"N-K-026.{n}", f"damping d({n})", float(damping(n, pixel)), "") for n in _STEPS[1:]),
        derived("N-K-027", "pulses that an accumulated signal can never exceed", limit, ""),
    ]


def _noise(pixel: Pixel) -> list[Claim]:
    gain = {n: n / float(dark_noise(n, pixel) / dark_noise(1, pixel)) for n in _STEPS}
    return [
        *(derived(f"N-K-028.{n}", f"sigma_U({n})", float(dark_noise(n, pixel)) * 1e3, "mV") for n in _STEPS),
        *(derived(f"N-K-029.{n}", f"SNR({n}) / SNR(1) with read-out noise", gain[n], "") for n in _STEPS),
        *(
            printed(
                f"N-K-030.{n}",
                f"noise that is missed without photon noise, at full scale, n = {n}",
                thesis,
                _missed(n, pixel) * 100,
                "%",
            )
            for n, thesis in ((1, "18"), (16, "2.7"), (100, "0.46"))
        ),
    ]


def _missed(n: int, pixel: Pixel) -> float:
    """Return the relative error of sigma_U without photon noise at full scale (eq 4.30)."""
    dark = float(dark_noise(n, pixel))
    return float(np.hypot(dark, photon_noise(pixel.saturation_v, pixel))) / dark - 1


def _simulated(dark: dict[int, Floats], pixel: Pixel) -> list[Claim]:
    sensor_v, readout_v, errors_v = _fit(dark, pixel)
    share = float(np.mean(np.abs(dark[100]) < 3 * float(damping(100, pixel) * dark_noise(100, pixel))))
    near = 3 * np.sqrt(share * (1 - share) / _DARK_VALUES)
    found = "fitted to simulated dark images; within three standard errors"
    return [
        judged(
            "N-K-097",
            "share of 16000 simulated dark values within 3 sigma_U after 100 accumulations: Gaussian",
            0.997,
            share,
            "",
            abs(share - 0.9973) < near,
            "within three standard errors of 0.9973",
        ),
        judged("N-K-028", "sigma_S", 0.379, sensor_v * 1e3, "mV", abs(sensor_v - 0.379e-3) < 3 * errors_v[0], found),
        judged("N-K-028", "sigma_R", 0.442, readout_v * 1e3, "mV", abs(readout_v - 0.442e-3) < 3 * errors_v[1], found),
    ]


def _fit(dark: dict[int, Floats], pixel: Pixel) -> tuple[float, float, Floats]:
    """Return sigma_S, sigma_R and the standard error of both, V, from dark values: eq 4.21 without the damping."""
    n = np.array(list(dark))
    variance = np.array([values.var() for values in dark.values()]) / damping(n, pixel) ** 2
    weight = 1 / (variance * np.sqrt(2 / (_DARK_VALUES - 1)))
    design = np.stack([n, np.ones(n.shape)], axis=1) * weight[:, None]
    covariance = np.linalg.inv(design.T @ design)
    squares = covariance @ design.T @ (variance * weight)
    sigmas = np.sqrt(np.maximum(squares, 1e-12))
    return float(sigmas[0]), float(sigmas[1]), np.sqrt(np.diag(covariance)) / (2 * sigmas)


def _exposures(pixel: Pixel) -> list[Claim]:
    one, most = (float(nee_system_jpm2(n, pixel)) * 1e9 for n in (1, 100))
    other = "sigma_S, sigma_R and R of the same chapter give 222.5; 225 may be the measured noise, not the fit (E-K-08)"
    return [
        printed("N-K-031", "NEE of the sensor", "145", nee_sensor_jpm2(pixel) * 1e9, "nJ/m2"),
        printed("N-K-032", "NEE of the system at n = 1", "225", one, "nJ/m2", other),
        derived("N-K-039", "NEE of the system at n = 100", most, "nJ/m2", "what eq 4.36 must be taken with (E-K-07)"),
    ]


def _ranges(camera: PulsedCamera) -> list[Claim]:
    system_db = {n: dynamic_range_system_db(replace(camera, averages=n)) for n in (1, 3, 4)}
    snr, snr_20 = required_snr(ACCURACY), required_snr(ACCURACY, 20 / 27)
    needed_db, needed_20_db = (required_input_range_db(RANGE_M, REFLECTIVITY, s) for s in (snr, snr_20))
    at_20 = f"at 20 m of 27 m, not at 27 m: SNR {snr_20:.1f}; three averages are not enough, four are (E-K-09)"
    return [
        derived("N-K-033", "dynamic range of the photodiode", dynamic_range_photodiode_db(camera.pixel), "dB"),
        printed("N-K-034", "dynamic range of the system", "91.9", system_db[1], "dB"),
        printed("N-K-035.3", "dynamic range with 3 averages", "96.7", system_db[3], "dB"),
        printed("N-K-035.4", "dynamic range with 4 averages", "97.9", system_db[4], "dB"),
        printed("N-K-036", "SNR that 3 % need at the end of the measurement range", "33.3", snr, ""),
        printed("N-K-037", "input range that is needed", "96.5", needed_db, "dB"),
        printed("N-K-038", "input range that is needed up to 20 m", "96.5", needed_20_db, "dB", at_20),
        judged(
            "N-K-038",
            "dynamic range above the needed one with 3 averages",
            0.2,
            system_db[3] - needed_20_db,
            "dB",
            system_db[3] > needed_20_db,
            at_20,
        ),
    ]


def _panels(dark: dict[int, Floats], pixel: Pixel) -> list[Panel]:
    n = np.arange(1, 101)
    found = np.array([values.std() for values in dark.values()]) * 1e3
    noise = [
        Series("σ_U (eq 4.21)", n, dark_noise(n, pixel) * 1e3),
        Series("damped, as at the output", n, damping(n, pixel) * dark_noise(n, pixel) * 1e3),
        Series("simulated dark images, ±2σ", list(dark), found, found / np.sqrt(2 * (_DARK_VALUES - 1))),
    ]
    signal_v = np.linspace(0, pixel.saturation_v, 100)
    bright = [
        Series(f"n = {k}", signal_v, np.hypot(dark_noise(k, pixel), photon_noise(signal_v, pixel)) * 1e3)
        for k in (1, 4, 16)
    ]
    ratio = n / (dark_noise(n, pixel) / dark_noise(1, pixel))
    gain = [
        Series("with read-out noise", n, ratio),
        Series("sensor noise only, √n", n, np.sqrt(n), line="--"),
    ]
    return [
        Panel("Dark noise", "accumulations", "standard deviation (mV)", noise),
        Panel("Noise in the light", "undamped signal (V)", "standard deviation (mV)", bright),
        Panel("What accumulation gains", "accumulations", "SNR over that of one", gain),
    ]
