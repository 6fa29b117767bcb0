"""The shutter pixel: light to volts, accumulation with its damping, and every part of its noise."""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from rangecam.pulsed.laser import REFERENCE_C
from rangecam.pulsed.noise import remaining_v
from rangecam.pulsed.settings import Pixel
from rangecam.types import Floats

ELEMENTARY_CHARGE_C = 1.602176634e-19


def volts_per_coulomb(pixel: Pixel) -> float:
    """Return the output voltage per photo charge of one pulse, V/C (König 2008, eq 4.3).

    The reference voltage and the sign of the raw output (eq 4.1) are taken off in the camera already.
    """
    capacitance_f = pixel.diode_capacitance_f + pixel.sense_capacitance_f
    return pixel.follower_gain * pixel.clamp_capacitance_f / pixel.feedback_capacitance_f / capacitance_f


@lru_cache(maxsize=16)
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
    sensor_v, readout_v = remaining_v(pixel)
    return np.asarray(np.sqrt(np.asarray(n_acc, np.float64) * sensor_v**2 + readout_v**2))


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


@lru_cache(maxsize=8)
def offsets(shape: tuple[int, int, int], widths_s: tuple[float, ...], temperature_c: float, pixel: Pixel) -> Floats:
    """Return the offset of every read-out, V (K, S, H, W): K numbers of accumulations, in order (K-PIX-16).

    shape (S, H, W): of the samples; widths_s (S,): how long the shutters are open. To the `fixed_pattern` come an
    offset of each number of accumulations, one that grows with the length of the shutter, and the drift with the
    temperature of the surroundings from 25 °C.
    """
    steps = sorted(pixel.accumulations)
    readout_v, pulse_v = fixed_pattern(shape, pixel)
    rng = np.random.default_rng([pixel.fixed_pattern_seed, 1])
    rate, drift, own = rng.standard_normal(shape), rng.standard_normal(shape), rng.standard_normal((len(steps), *shape))
    pulse_v = pulse_v + pixel.fixed_pattern_vps * rate * np.reshape(widths_s, (-1, 1, 1))
    per_k = pixel.offset_drift_vpk + pixel.offset_drift_spread_vpk * drift
    still_v = readout_v + (temperature_c - REFERENCE_C) * per_k
    grown_v = accumulated(pulse_v, np.reshape(steps, (-1, 1, 1, 1)), pixel)
    return np.asarray(still_v + pixel.fixed_pattern_per_step_v * own + grown_v)


def read_out(
    single_v: Floats, ambient_v: Floats, offset_v: Floats, pixel: Pixel, averages: int, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.uint8]]:
    """Return what the converter gives, V (S, H, W), and the accumulations of each pixel (H, W), common to its shutters.

    single_v: signal of one pulse (S, H, W), or the mean over the pulses up to each read-out (averages, K, S, H, W).
    ambient_v (S, H, W): background of one exposure. offset_v (K, S, H, W): of each read-out, see `offsets`.
    Of the K numbers of accumulations the largest is taken at which no shutter of the pixel is saturated (4.1.1.3;
    K-PIX-10), else the smallest. Values are means over the averaged images, full scale if one of them is. A pixel that
    laser and background fill in one exposure delivers the full scale: the control sees that before the background is
    subtracted (K-PIX-07).
    The accumulated signal is read without destroying it (4.1.1.4): its noise grows pulse by pulse, while each read-out
    adds its own; together they are `noise_variance`. What counts is drawn, from the last read-out backwards: an earlier
    one only where a pixel is full, and given those after it, since the read-outs of a run share the noise of pulses.
    """
    steps, damped, numbers = _of_read_outs(pixel)
    flat = len(ambient_v), ambient_v[0].size
    means_v = single_v.reshape(*((1, 1) if single_v.ndim == 3 else (averages, len(steps))), *flat)
    walk = np.zeros((3, averages, *flat))
    walk[0] = np.inf
    left: tuple[Floats, ...] = means_v, ambient_v.reshape(flat), offset_v.reshape(len(steps), *flat), walk
    chosen_v, n_acc, pixels = np.empty(flat), np.empty(flat[1], np.uint8), _ALL
    for k in range(len(steps) - 1, -1, -1):
        means_v, ambient_v, offset_v, walk = left
        light = np.ascontiguousarray(means_v[:, min(k, means_v.shape[1] - 1)]), ambient_v, offset_v[k]
        deviates = rng.standard_normal(walk.shape[1:], np.float32)
        values_v, full = np.empty(ambient_v.shape), np.zeros(ambient_v.shape[1])
        _read_out(light, deviates, (steps[k], damped[k], numbers, step_v(pixel)), walk, values_v, full)
        chosen_v[:, pixels], n_acc[pixels] = values_v, steps[k]
        again = full.nonzero()[0]
        if again.size == 0:
            break
        pixels = again if pixels is _ALL else pixels[again]
        left = tuple([each.take(again, axis=-1) for each in left])
    return chosen_v.reshape(single_v.shape[-3:]), n_acc.reshape(single_v.shape[-2:])


_ALL: Any = slice(None)


@lru_cache(maxsize=16)
def _of_read_outs(pixel: Pixel) -> tuple[Floats, Floats, Floats]:
    """Return what `_read_out` is told of a pixel: numbers of accumulations, damping after each, sizes of noise."""
    steps = np.array(sorted(pixel.accumulations), np.float64)
    sensor_v, readout_v = remaining_v(pixel)
    per_photon = float(photon_noise(1.0, pixel)) ** 2
    return steps, damping(steps, pixel), np.array([sensor_v**2, readout_v**2, per_photon, pixel.saturation_v])


@njit(cache=True, nogil=True, error_model="numpy")
def _read_out(light: Any, deviates: Any, rules: Any, walk: Any, values_v: Any, full: Any) -> Any:
    """Fill values (S, N) of one read-out, and 1 for each pixel that is full; whole rows of pixels, several at once.

    walk (3, averages, S, N): the variance V to which the noise of the pulses has grown at the read-out after this one,
    and what that and later ones tell of this noise, its mean m and variance P; then the same at this one. Where its
    variance was v < V, the noise was m v / V on average, with the variance P (v / V)^2 + v (1 - v / V); the noise of
    reading comes on top of it. V is infinite, m and P are 0 where nothing is known.
    """
    (means_v, ambient_v, offset_v), (n, d, (sensor_v2, readout_v2, per_photon, full_v), step) = light, rules
    (grown_v2, known_v, unsure_v2), (averages, windows, pixels) = walk, walk.shape[1:]
    most_v = np.empty(pixels)
    for s in range(windows):
        values_v[s], most_v[:] = 0.0, 0.0
        for a in range(averages):
            of_a = min(a, len(means_v) - 1)
            for i in range(pixels):
                mean_v, above_v2 = means_v[of_a, s, i], grown_v2[a, s, i]
                so_far_v2 = n * (sensor_v2 + per_photon * ((mean_v if mean_v > 0.0 else 0.0) + 2 * ambient_v[s, i]))
                so_far_v2 = so_far_v2 if so_far_v2 < above_v2 else above_v2
                share = so_far_v2 / above_v2 if so_far_v2 > 0.0 else 0.0
                noise_v = share * known_v[a, s, i]
                noise_v2 = share * share * unsure_v2[a, s, i] + so_far_v2 * (1 - share)
                read_v2 = noise_v2 + readout_v2
                read_v = np.sqrt(read_v2) * deviates[a, s, i]
                told = noise_v2 / read_v2 if read_v2 > 0.0 else 0.0
                grown_v2[a, s, i] = so_far_v2
                known_v[a, s, i] = noise_v + told * read_v
                unsure_v2[a, s, i] = noise_v2 * (1 - told)
                value_v = d * (n * mean_v + noise_v + read_v) + offset_v[s, i]
                value_v = np.inf if mean_v + ambient_v[s, i] >= full_v else value_v
                value_v = _converted(value_v, full_v, step)
                values_v[s, i] += value_v
                most_v[i] = value_v if value_v > most_v[i] else most_v[i]
        for i in range(pixels):
            filled = most_v[i] >= full_v
            values_v[s, i] = full_v if filled else values_v[s, i] / averages
            full[i] = 1.0 if filled else full[i]


def convert(value_v: Floats, pixel: Pixel) -> Floats:
    """Return values as the converter gives them: rounded to its step, never above the full scale."""
    converted = np.empty_like(value_v)
    _convert(np.ascontiguousarray(value_v).reshape(-1), pixel.saturation_v, step_v(pixel), converted.reshape(-1))
    return converted


@njit(cache=True, nogil=True)
def _convert(value_v: Any, full_v: Any, step: Any, converted: Any) -> Any:
    for i in range(value_v.size):
        converted[i] = _converted(value_v[i], full_v, step)


@njit(cache=True, nogil=True)
def _converted(value_v: Any, full_v: Any, step: Any) -> Any:
    rounded_v = np.rint(value_v / step) * step if step > 0 else value_v
    return full_v if value_v >= full_v - step / 2 else rounded_v
