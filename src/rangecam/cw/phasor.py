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


_REACH = {"off": 0, "3x3": 1, "5x5": 2}


def shared_noise_pixels(camera: CwCamera) -> float:
    """Return how many pixels' worth of noise each pixel shares with its neighbours after the filter of the phasor."""
    return float((2 * _REACH[camera.phasor_filter] + 1) ** 2)


def filter_rule(camera: CwCamera, wavelengths_m: tuple[float, ...]) -> tuple[int, Floats]:
    """Return how many rows and columns around a pixel are averaged with it, and the rule for taking part (4,).

    wavelengths_m: the range after which the phase of each frequency repeats.
    """
    reach = _REACH[camera.phasor_filter]
    tolerance = sum((2 * math.pi * camera.phasor_filter_tolerance_m / each) ** 2 for each in wavelengths_m)
    rule = [camera.phasor_filter_sigmas**2, camera.phasor_filter_contrast, camera.phasor_min_support, tolerance]
    return reach, np.array(rule, np.float32)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def demodulate(planes: Any, y: int, model: Any, ring: Any, slot: int, scratch: Any, why: Any) -> None:
    """Fill one row of the ring with the phasors of all frequencies.

    planes: a tuple of images, the steps of a frequency after each other. model: `harmonic_weights`, `noise_model`.
    ring: units (rows, 2 K, W + rim), cosine and sine of each phase; phasors alike, Re and Im; noises (rows, K, ...),
    variance across each phasor, LSB2; spread (rows, 3, ...), sums over the frequencies of the phase variance (rad2, NaN
    where a pixel cannot be used), of the amplitude and of the variance. scratch (10, W).
    """
    (weights, noise), (units, phasors, noises, spread) = model, ring
    n_steps, width = weights.shape[1], why.size
    rim = (units.shape[2] - width) // 2
    inner = slice(rim, rim + width)
    sums = (spread[slot, 0, inner], spread[slot, 1, inner], spread[slot, 2, inner])
    why[:] = _VALID
    for row in sums:
        row[:] = _ZERO
    for k in range(units.shape[1] // 2):
        first = k * n_steps
        _three_samples(planes[first][y], planes[first + 1][y], planes[first + 2][y], weights, scratch)
        for n in range(3, n_steps):
            _add_sample(planes[first + n][y], weights[0, n], weights[1, n], scratch, n)
        scratch[2:5] = _ZERO
        if noise[1] > _ZERO:
            for n in range(n_steps):
                samples = planes[first + n][y]
                _add_light(samples, noise[3], weights[0, n], weights[1, n], scratch[2], scratch[3], scratch[4])
        unit = (units[slot, 2 * k, inner], units[slot, 2 * k + 1, inner])
        phasor = (phasors[slot, 2 * k, inner], phasors[slot, 2 * k + 1, inner])
        _polar(scratch, noise, unit, phasor, noises[slot, k, inner], sums)
        limits = 5 if n_steps % 2 else 7
        _reason(scratch[limits], scratch[limits + 1], noise, scratch[9], why)
    _mark(why, sums[0])


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _three_samples(c0: Any, c1: Any, c2: Any, weights: Any, scratch: Any) -> None:
    real, imaginary, smallest, largest = scratch[0], scratch[1], scratch[5], scratch[6]
    r0, r1, r2, i0, i1, i2 = weights[0, 0], weights[0, 1], weights[0, 2], weights[1, 0], weights[1, 1], weights[1, 2]
    for i in range(real.size):
        s0, s1, s2 = np.float32(c0[i]), np.float32(c1[i]), np.float32(c2[i])
        real[i] = r0 * s0 + r1 * s1 + r2 * s2
        imaginary[i] = i0 * s0 + i1 * s1 + i2 * s2
        low, high = (s0 if s0 < s1 else s1), (s0 if s0 > s1 else s1)
        smallest[i], largest[i] = (s2 if s2 < low else low), (s2 if s2 > high else high)


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_sample(samples: Any, to_real: Any, to_imaginary: Any, scratch: Any, n: int) -> None:
    """Add a sample to Re and Im; its limits go from one pair of rows to the other, for in place it would be slow."""
    real, imaginary, old, new = scratch[0], scratch[1], 5 if n % 2 else 7, 7 if n % 2 else 5
    smallest, largest, smallest_now, largest_now = scratch[old], scratch[old + 1], scratch[new], scratch[new + 1]
    for i in range(real.size):
        sample = np.float32(samples[i])
        real[i] += to_real * sample
        imaginary[i] += to_imaginary * sample
        smallest_now[i] = sample if sample < smallest[i] else smallest[i]
        largest_now[i] = sample if sample > largest[i] else largest[i]


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
def _polar(scratch: Any, noise: Any, unit: Any, phasor: Any, variance: Any, sums: Any) -> None:
    """Turn Re and Im into a unit phasor, its amplitude and its variance at right angles to it: what turns the phase."""
    real, imaginary, rr, ri, ii, amplitude = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[9]
    (cosine, sine), (re, im), (spread, total, strewn) = unit, phasor, sums
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
        usable = size > _ZERO  # what is not takes no part, but its product with zero must be zero
        re[i], im[i] = (real[i] if usable else _ZERO), (imaginary[i] if usable else _ZERO)
        spread[i] += across * inverse * inverse
        total[i] += size
        strewn[i] += across


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _reason(smallest: Any, largest: Any, noise: Any, amplitude: Any, why: Any) -> None:
    """Say of each pixel what is wrong with its samples at one frequency; a worse fault replaces a lesser one."""
    low, high = noise[4], noise[5]
    for i in range(why.size):
        reason = why[i]
        limited = (largest[i] >= high) | (smallest[i] <= low)
        reason = _SATURATED if limited & (reason == _VALID) else reason
        equal = (largest[i] == smallest[i]) & (largest[i] < high)
        reason = _NO_SIGNAL if equal & (reason != _NOT_FINITE) else reason
        why[i] = reason if amplitude[i] == amplitude[i] else _NOT_FINITE


@njit(cache=True, nogil=True)
def _mark(why: Any, phase_variance: Any) -> None:
    for i in range(why.size):
        known = phase_variance[i]
        phase_variance[i] = known if why[i] == _VALID else _NAN


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def average(rows: Any, inside: int, ring: Any, rule: Any, scratch: Any, mean: Any, variance: Any, why: Any) -> None:
    """Average one row of phasors with the neighbours that belong to the same surface.

    rows: which rows of the ring hold the neighbourhood, the middle one its centre; inside: how many of them lie in the
    image. A neighbour takes part if the squared distance of the unit phasors is below rule[0] times what noise makes
    of it plus rule[3], and neither amplitude is more than rule[1] times the other. mean (2 K, W): Re and Im; variance
    (K, W): across the phasor, LSB2, shared out among the frequencies as at the centre. Pixels with which less than
    rule[2] of the neighbours that there are can be averaged are FLYING.
    """
    units, phasors, noises, spread = ring
    reach, width, n_frequencies = len(rows) // 2, why.size, variance.shape[0]
    distance, take, count, strewn = scratch[0], scratch[1], scratch[2], scratch[3]
    centre, inner = rows[reach], slice(reach, reach + width)
    here = (spread[centre, 0, inner], spread[centre, 1, inner])
    for k in range(2 * n_frequencies):
        mean[k, :] = phasors[centre, k, inner]
    count[:] = _ONE
    strewn[:] = spread[centre, 2, inner]
    for j in range(len(rows)):
        row = rows[j]
        for dx in range(2 * reach + 1):
            if j == reach and dx == reach:
                continue
            beside = slice(dx, dx + width)
            distance[:] = _ZERO
            for k in range(0, 2 * n_frequencies, 2):
                cosine, sine = units[row, k, beside], units[row, k + 1, beside]
                _add_distance(units[centre, k, inner], units[centre, k + 1, inner], cosine, sine, distance)
            there = (spread[row, 0, beside], spread[row, 1, beside], spread[row, 2, beside])
            _judge(distance, here, there, rule, take, count, strewn)
            for k in range(0, 2 * n_frequencies, 2):
                _add_phasor(take, phasors[row, k, beside], phasors[row, k + 1, beside], mean[k], mean[k + 1])
    for k in range(n_frequencies):
        noise, total = noises[centre, k, inner], spread[centre, 2, inner]
        _divide(count, strewn, noise, total, mean[2 * k], mean[2 * k + 1], variance[k])
    if rule[2] > _ZERO:
        for i in range(width):
            places = inside * (min(i, reach) + min(width - 1 - i, reach) + 1) - 1
            lonely = (count[i] < _ONE + rule[2] * np.float32(places)) & (why[i] == _VALID)
            why[i] = _FLYING if lonely else why[i]


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_distance(cosine_here: Any, sine_here: Any, cosine_there: Any, sine_there: Any, distance: Any) -> None:
    for i in range(distance.size):
        across, up = cosine_here[i] - cosine_there[i], sine_here[i] - sine_there[i]
        distance[i] += across * across + up * up


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _judge(distance: Any, here: Any, there: Any, rule: Any, take: Any, count: Any, strewn: Any) -> None:
    """Decide which neighbours take part; count them and add their variances."""
    (noise_here, total_here), (noise_there, total_there, across) = here, there
    squared, contrast, tolerance = rule[0], rule[1], rule[3]
    for i in range(take.size):
        near = distance[i] <= squared * (noise_here[i] + noise_there[i]) + tolerance
        alike = (total_there[i] <= contrast * total_here[i]) & (total_here[i] <= contrast * total_there[i])
        more = across[i]
        one, more = (_ONE if near & alike else _ZERO), (more if near & alike else _ZERO)
        take[i] = one
        count[i] += one
        strewn[i] += more


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_phasor(take: Any, re: Any, im: Any, real: Any, imaginary: Any) -> None:
    for i in range(take.size):
        real[i] += take[i] * re[i]
        imaginary[i] += take[i] * im[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _divide(count: Any, strewn: Any, noise: Any, total: Any, real: Any, imaginary: Any, variance: Any) -> None:
    for i in range(count.size):
        share = _ONE / count[i]
        real[i] *= share
        imaginary[i] *= share
        variance[i] = share * share * strewn[i] * noise[i] / total[i]


@njit(cache=True, nogil=True)
def keep(ring: Any, mean: Any, variance: Any) -> None:
    """Take the one row of the ring as it is, for want of a filter."""
    mean[:] = ring[1][0]
    variance[:] = ring[2][0]


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
