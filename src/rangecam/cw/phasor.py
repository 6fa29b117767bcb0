"""Phasors from any number of phase steps, and their average over neighbours of the same surface.

The kernels work on rows: each is a few loops that become vector instructions, and what they hand on stays in the cache.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import sample_variance
from rangecam.errors import UsageError
from rangecam.types import Floats, Why

_VALID, _NO_SIGNAL, _NOT_FINITE = np.uint8(Why.VALID), np.uint8(Why.NO_SIGNAL), np.uint8(Why.NOT_FINITE)
_SATURATED, _FLYING = np.uint8(Why.SATURATED), np.uint8(Why.FLYING)
_LARGEST = np.float32(1e30)
_ZERO, _ONE, _HALF, _NAN = np.float32(0), np.float32(1), np.float32(0.5), np.float32(np.nan)
_QUARTER = np.float32(0.25)
# Minimax polynomial of arctan(t) / (2 pi) on 0..1 in odd powers, error 4e-8 turns (least squares, Lawson's weights).
_T1, _T3, _T5, _T7, _T9, _T11, _T13 = (
    np.float32(a / (2 * math.pi))
    for a in (0.9999961115, -0.3331736805, 0.1980781549, -0.1323334184, 0.07962366797, -0.03360421694, 0.006811792148)
)


@lru_cache(maxsize=64)
def harmonic_weights(steps_deg: tuple[float, ...]) -> Floats:
    """Return the weights (2, N) that make Re and Im of the phasor A exp(i phase) out of N samples.

    Least squares of sample_n = level + A cos(phase + step_n) with unknown level: exact without noise for any steps of
    which three differ, and (2/N) cos, -(2/N) sin for equally spaced ones; for four that is Steinbäck 2016, eqs 2.1-2.2.
    Raises UsageError if the steps do not determine a phasor.
    """
    steps = np.radians(np.asarray(steps_deg, np.float64))
    design = np.stack([np.ones(steps.shape), np.cos(steps), -np.sin(steps)], axis=1)
    if len(steps) < 3 or np.linalg.matrix_rank(design, 1e-6) < 3:
        raise UsageError(
            f"camera.phase_steps_deg = {[*steps_deg]}: a phase needs three different steps, such as [0, 120, 240]"
        )
    weights = np.linalg.pinv(design)[1:]
    weights[np.abs(weights) < 1e-12] = 0.0
    result: Floats = weights.astype(np.float32)
    result.setflags(write=False)
    return result


@lru_cache(maxsize=16)
def noise_model(camera: CwCamera) -> Floats:
    """Return what the kernels need of the noise and the limits of a sample, in their order (10,) float32.

    Variance without light, variance per LSB of light, and per LSB of amplitude; black level; limits; and the sums over
    the steps of the squared weights: Re Re, Re Im, Im Im.
    """
    single_ended = camera.pixel == "single_ended"
    known_light = 0.0 if single_ended else camera.ambient_lsb
    floor = float(sample_variance(known_light, camera)) + camera.quantisation_lsb**2 / 12
    shot = camera.shot_noise_lsb2_per_lsb / camera.binning**2
    weights = harmonic_weights(camera.phase_steps_deg).astype(np.float64)
    return np.array(
        [
            max(floor, 1e-12),
            shot if single_ended else 0.0,
            0.0 if single_ended else shot / camera.demodulation_contrast,
            camera.black_level_lsb,
            -_LARGEST if camera.lower_limit_lsb is None else camera.lower_limit_lsb,
            _LARGEST if camera.full_scale_lsb is None else camera.full_scale_lsb,
            weights[0] @ weights[0],
            weights[0] @ weights[1],
            weights[1] @ weights[1],
        ],
        np.float32,
    )


def filter_rule(camera: CwCamera) -> tuple[int, Floats]:
    """Return how many rows and columns around a pixel are averaged with it, and the rule for taking part (3,)."""
    reach = {"off": 0, "3x3": 1, "5x5": 2}[camera.phasor_filter]
    rule = [camera.phasor_filter_sigmas**2, camera.phasor_filter_contrast, camera.phasor_min_support]
    return reach, np.array(rule, np.float32)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def demodulate(
    planes: Any, y: int, weights: Any, noise: Any, scratch: Any, units: Any, sizes: Any, spread: Any, why: Any
) -> None:
    """Fill one row with the phasors of all frequencies.

    planes: a tuple of images, the steps of a frequency after each other. units (2 K, W): cosine and sine of the phase;
    sizes (2 K, W): amplitude, and variance across the phasor (LSB2), of each frequency; spread (2, W): sums over the
    frequencies of the phase variance (rad2, NaN where a pixel cannot be used) and of the amplitude; scratch (7, W).
    """
    n_steps = weights.shape[1]
    why[:] = _VALID
    spread[:] = _ZERO
    for k in range(len(planes) // n_steps):
        scratch[:5] = _ZERO
        scratch[5] = _LARGEST
        scratch[6] = -_LARGEST
        for n in range(n_steps):
            samples = planes[k * n_steps + n][y]
            _add_sample(samples, weights[0, n], weights[1, n], scratch[0], scratch[1], scratch[5], scratch[6])
            if noise[1] > _ZERO:
                _add_light(samples, noise[3], weights[0, n], weights[1, n], scratch[2], scratch[3], scratch[4])
        _polar(scratch, noise, units[2 * k], units[2 * k + 1], sizes[2 * k], sizes[2 * k + 1], spread[0], spread[1])
        _reason(scratch, noise, sizes[2 * k], why)
    for i in range(why.size):
        spread[0, i] = spread[0, i] if why[i] == _VALID else _NAN


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_sample(
    samples: Any, to_real: Any, to_imaginary: Any, real: Any, imaginary: Any, smallest: Any, largest: Any
) -> None:
    for i in range(real.size):
        sample = np.float32(samples[i])
        real[i] += to_real * sample
        imaginary[i] += to_imaginary * sample
        smallest[i] = sample if sample < smallest[i] else smallest[i]
        largest[i] = sample if sample > largest[i] else largest[i]


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_light(samples: Any, black: Any, to_real: Any, to_imaginary: Any, rr: Any, ri: Any, ii: Any) -> None:
    """Add the light of a sample, which makes its shot noise, to the covariance of the phasor."""
    squared, mixed, other = to_real * to_real, to_real * to_imaginary, to_imaginary * to_imaginary
    for i in range(rr.size):
        light = np.float32(samples[i]) - black
        light = light if light > _ZERO else _ZERO
        rr[i] += squared * light
        ri[i] += mixed * light
        ii[i] += other * light


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _polar(
    scratch: Any, noise: Any, cosine: Any, sine: Any, amplitude: Any, variance: Any, spread: Any, total: Any
) -> None:
    """Turn Re and Im into a unit phasor, its amplitude and its variance at right angles to it: what turns the phase."""
    real, imaginary, rr, ri, ii = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    floor, per_light, per_amplitude, g_rr, g_ri, g_ii = noise[0], noise[1], noise[2], noise[6], noise[7], noise[8]
    for i in range(real.size):
        square = real[i] * real[i] + imaginary[i] * imaginary[i]
        size = np.sqrt(square if square < _LARGEST else _NAN)
        inverse = _ONE / size
        c, s = real[i] * inverse, imaginary[i] * inverse
        each = floor + per_amplitude * size
        v_rr, v_ri, v_ii = (
            each * g_rr + per_light * rr[i],
            each * g_ri + per_light * ri[i],
            each * g_ii + per_light * ii[i],
        )
        across = s * s * v_rr - (c * s + c * s) * v_ri + c * c * v_ii
        cosine[i], sine[i], amplitude[i], variance[i] = c, s, size, across
        spread[i] += across * inverse * inverse
        total[i] += size


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _reason(scratch: Any, noise: Any, amplitude: Any, why: Any) -> None:
    """Say of each pixel what is wrong with its samples at one frequency; a worse fault replaces a lesser one."""
    low, high, smallest, largest = noise[4], noise[5], scratch[5], scratch[6]
    for i in range(why.size):
        reason = why[i]
        limited = (largest[i] >= high) | (smallest[i] <= low)
        reason = _SATURATED if limited & (reason == _VALID) else reason
        equal = (largest[i] == smallest[i]) & (largest[i] < high)
        reason = _NO_SIGNAL if equal & (reason != _NOT_FINITE) else reason
        why[i] = reason if amplitude[i] == amplitude[i] else _NOT_FINITE


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def average(
    rows: Any,
    units: Any,
    sizes: Any,
    spread: Any,
    rule: Any,
    inside: int,
    scratch: Any,
    mean: Any,
    variance: Any,
    why: Any,
) -> None:
    """Average one row of phasors with the neighbours that belong to the same surface.

    rows: which rows of the ring hold the neighbourhood, the middle one its centre. A neighbour takes part if the mean
    squared distance of the unit phasors is below rule[0] times what noise makes of it, and neither amplitude is more
    than rule[1] times the other. mean (2 K, W): Re and Im; variance (K, W): across the phasor, LSB2. Pixels with which
    less than rule[2] of the neighbours that there are can be averaged are FLYING; inside: rows of them in the image.
    """
    reach, width, n_frequencies = len(rows) // 2, why.size, variance.shape[0]
    distance, take, count = scratch[0], scratch[1], scratch[2]
    centre, inner = rows[reach], slice(reach, reach + width)
    mean[:] = _ZERO
    variance[:] = _ZERO
    count[:] = _ZERO
    for j in range(len(rows)):
        row = rows[j]
        for dx in range(2 * reach + 1):
            beside = slice(dx, dx + width)
            distance[:] = _ZERO
            for k in range(2 * n_frequencies):
                _add_distance(units[centre, k, inner], units[row, k, beside], distance)
            _judge(distance, spread[centre, :, inner], spread[row, :, beside], rule[0], rule[1], take, count)
            for k in range(n_frequencies):
                _add_phasor(
                    take,
                    units[row, 2 * k, beside],
                    units[row, 2 * k + 1, beside],
                    sizes[row, 2 * k, beside],
                    sizes[row, 2 * k + 1, beside],
                    mean[2 * k],
                    mean[2 * k + 1],
                    variance[k],
                )
    for k in range(n_frequencies):
        _divide(count, mean[2 * k], mean[2 * k + 1], variance[k])
    if rule[2] > _ZERO:
        for i in range(width):
            places = inside * (min(i, reach) + min(width - 1 - i, reach) + 1) - 1
            lonely = (count[i] < _ONE + rule[2] * np.float32(places)) & (why[i] == _VALID)
            why[i] = _FLYING if lonely else why[i]


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_distance(here: Any, there: Any, distance: Any) -> None:
    for i in range(distance.size):
        step = here[i] - there[i]
        distance[i] += step * step


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _judge(distance: Any, here: Any, there: Any, squared: Any, contrast: Any, take: Any, count: Any) -> None:
    for i in range(take.size):
        near = distance[i] <= squared * (here[0, i] + there[0, i])
        alike = (there[1, i] <= contrast * here[1, i]) & (here[1, i] <= contrast * there[1, i])
        one = _ONE if near & alike else _ZERO
        take[i] = one
        count[i] += one


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_phasor(
    take: Any, cosine: Any, sine: Any, size: Any, across: Any, real: Any, imaginary: Any, variance: Any
) -> None:
    for i in range(take.size):
        taken = take[i] > _ZERO
        strength = size[i] if taken else _ZERO  # a product would let the NaN of a pixel that takes no part through
        real[i] += strength * (cosine[i] if taken else _ZERO)
        imaginary[i] += strength * (sine[i] if taken else _ZERO)
        variance[i] += across[i] if taken else _ZERO


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _divide(count: Any, real: Any, imaginary: Any, variance: Any) -> None:
    for i in range(count.size):
        share = _ONE / count[i]
        real[i] *= share
        imaginary[i] *= share
        variance[i] *= share * share


@njit(cache=True, nogil=True)
def keep(units: Any, sizes: Any, mean: Any, variance: Any) -> None:
    """Take one row of phasors as it is, for want of a filter."""
    for k in range(variance.shape[0]):
        for i in range(mean.shape[1]):
            mean[2 * k, i] = sizes[2 * k, i] * units[2 * k, i]
            mean[2 * k + 1, i] = sizes[2 * k, i] * units[2 * k + 1, i]
            variance[k, i] = sizes[2 * k + 1, i]


@njit(cache=True, nogil=True, inline="always")
def turns(imaginary: Any, real: Any) -> Any:
    """Return the angle of (real, imaginary) in turns, -0.5..0.5, to 1e-7: a polynomial in the first octant."""
    x, y = abs(real), abs(imaginary)
    t = (y if y < x else x) / (x if y < x else y)
    u = t * t
    v = u * u
    angle = t * (((_T1 + u * _T3) + v * (_T5 + u * _T7)) + (v * v) * ((_T9 + u * _T11) + v * _T13))
    angle = _QUARTER - angle if y > x else angle
    angle = _HALF - angle if real < _ZERO else angle
    return -angle if imaginary < _ZERO else angle
