"""The shutter pixel: light to volts, accumulation with its damping, and every part of its noise."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rangecam.pulsed.settings import Pixel
from rangecam.types import Floats

ELEMENTARY_CHARGE_C = 1.602176634e-19


def volts_per_coulomb(pixel: Pixel) -> float:
    """Return the output voltage per photo charge of one pulse, V/C (König 2008, eq 4.3).

    The reference voltage and the sign of the raw output (eq 4.1) are taken off in the camera already.
    """
    capacitance_f = pixel.diode_capacitance_f + pixel.sense_capacitance_f
    return pixel.follower_gain * pixel.clamp_capacitance_f / pixel.feedback_capacitance_f / capacitance_f


def responsivity(pixel: Pixel) -> float:
    """Return the output voltage per exposure of one pulse, V/(J/m2) (König 2008, eq 4.13)."""
    area_m2 = pixel.pitch_horizontal_m * pixel.pitch_vertical_m
    return pixel.sensitivity_apw * area_m2 * volts_per_coulomb(pixel)


def damping(n_acc: ArrayLike, pixel: Pixel) -> Floats:
    """Return what is left of an accumulated signal, 0..1, after `n_acc` >= 1 pulses (König 2008, eq 4.17)."""
    n = np.asarray(n_acc, np.float64)
    if pixel.damping == 0:
        return np.ones_like(n)
    return np.asarray(np.expm1(-pixel.damping * n) / (np.expm1(-pixel.damping) * n))


def accumulated(single_v: ArrayLike, n_acc: ArrayLike, pixel: Pixel) -> Floats:
    """Return the output voltage after `n_acc` pulses of `single_v` each (König 2008, eq 4.18)."""
    return damping(n_acc, pixel) * np.asarray(n_acc, np.float64) * np.asarray(single_v, np.float64)


def dark_noise(n_acc: ArrayLike, pixel: Pixel) -> Floats:
    """Return sigma_U without light, V, before the damping that signal and noise share (König 2008, eq 4.21)."""
    n = np.asarray(n_acc, np.float64)
    return np.asarray(np.sqrt(n * pixel.sensor_noise_v**2 + pixel.readout_noise_v**2))


def photon_noise(signal_v: ArrayLike, pixel: Pixel) -> Floats:
    """Return sigma_PS, V, of an undamped accumulated signal (König 2008, eq 4.26); 0 if `photon_noise` is off."""
    volts_per_electron = ELEMENTARY_CHARGE_C * volts_per_coulomb(pixel) if pixel.photon_noise else 0.0
    return np.asarray(np.sqrt(volts_per_electron * np.maximum(signal_v, 0.0)))


def step_v(pixel: Pixel) -> float:
    """Return the step of the converter, V; 0 if it does not round."""
    return pixel.saturation_v / (2**pixel.adc_bits - 1) if pixel.adc_bits else 0.0


def noise_variance(signal_v: ArrayLike, n_acc: ArrayLike, ambient_v: ArrayLike, pixel: Pixel) -> Floats:
    """Return the variance, V2, of a shutter value before it is rounded.

    signal_v: the damped value itself; n_acc: its accumulations; ambient_v: background voltage of one exposure, before
    the correlated double sampling. The noise is damped as the signal is (4.2.3.1; E-K-10): d2 sigma_U*2 (eq 4.28),
    in which the shot noise belongs to the undamped signal U / d. The background adds its shot noise twice, with the
    laser on and off.
    """
    d = damping(n_acc, pixel)
    light_v = np.maximum(signal_v, 0.0) / d + 2 * np.asarray(n_acc) * np.asarray(ambient_v)
    return d**2 * (dark_noise(n_acc, pixel) ** 2 + photon_noise(light_v, pixel) ** 2)


@lru_cache(maxsize=8)
def fixed_pattern(shape: tuple[int, ...], pixel: Pixel) -> tuple[Floats, Floats]:
    """Return the offset of the read-out and that of every pulse, V, of each sample of this shape (K-PIX-16)."""
    rng = np.random.default_rng(pixel.fixed_pattern_seed)
    readout, pulse = rng.standard_normal((2, *shape))
    return pixel.fixed_pattern_v * readout, pixel.fixed_pattern_per_pulse_v * pulse


def read_adaptively(
    single_v: Floats, ambient_v: Floats, pixel: Pixel, averages: int, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.uint8]]:
    """Return the shutter values, V, (S, H, W) and the accumulations of each pixel (H, W), common to its shutters.

    single_v, ambient_v (S, H, W): signal and background of one pulse. Of the numbers of accumulations the largest is
    taken at which no shutter of the pixel is saturated (4.1.1.3; K-PIX-10), else the smallest. The accumulated signal
    is read at all of them without destroying it, so that they share one deviate. A pixel that laser and background fill
    in one exposure delivers the full scale: the control sees that before the background is subtracted (K-PIX-07).
    Values are means over `averages` images, full scale if one of them is.
    """
    deviates = rng.standard_normal((averages, *single_v.shape))
    full = single_v + ambient_v >= pixel.saturation_v
    steps = sorted(pixel.accumulations)
    values_v = _read(steps[0], single_v, ambient_v, full, deviates, pixel)
    chosen = np.full(single_v.shape[1:], steps[0], np.uint8)
    for n in steps[1:]:
        more_v = _read(n, single_v, ambient_v, full, deviates, pixel)
        free = (more_v < pixel.saturation_v).all(axis=(0, 1))
        np.copyto(values_v, more_v, where=free)
        np.copyto(chosen, np.uint8(n), where=free)
    saturated = (values_v >= pixel.saturation_v).any(axis=0)
    return np.where(saturated, pixel.saturation_v, values_v.mean(axis=0)), chosen


def _read(
    n: int, single_v: Floats, ambient_v: Floats, full: NDArray[np.bool_], deviates: Floats, pixel: Pixel
) -> Floats:
    """Return noisy, converted values after `n` pulses: (averages, S, H, W) V."""
    signal_v = accumulated(single_v, n, pixel)
    noisy_v = signal_v + np.sqrt(noise_variance(signal_v, n, ambient_v, pixel)) * deviates
    if pixel.fixed_pattern_v or pixel.fixed_pattern_per_pulse_v:
        readout_v, pulse_v = fixed_pattern(single_v.shape, pixel)
        noisy_v += readout_v + accumulated(pulse_v, n, pixel)
    return np.where(full, pixel.saturation_v, convert(noisy_v, pixel))


def convert(value_v: Floats, pixel: Pixel) -> Floats:
    """Return values as the converter gives them: rounded to its step, never above the full scale."""
    rounded = np.round(value_v / step_v(pixel)) * step_v(pixel) if pixel.adc_bits else value_v
    return np.where(value_v >= pixel.saturation_v - step_v(pixel) / 2, pixel.saturation_v, rounded)
