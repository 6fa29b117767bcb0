"""Phasors from any number of phase steps, and their average over neighbours of the same surface.

The kernels work on a row of a few columns (`cw.block`): each is a loop that becomes vector instructions.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.block import INNER, RIM, WIDTH
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import sample_variance
from rangecam.errors import UsageError
from rangecam.types import Floats, Why

_VALID, _NO_SIGNAL, _NOT_FINITE = np.int32(Why.VALID), np.int32(Why.NO_SIGNAL), np.int32(Why.NOT_FINITE)
_SATURATED, _FLYING = np.int32(Why.SATURATED), np.int32(Why.FLYING)
_LARGEST = np.float32(1e30)
_ZERO, _ONE, _HALF, _NAN = np.float32(0), np.float32(1), np.float32(0.5), np.float32(np.nan)
_TWO, _QUARTER = np.float32(2), np.float32(0.25)
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
def demodulate(block: Any, weights: Any, noise: Any, row: Any) -> None:
    """Turn the samples of a block into unit phasors with their amplitude and variance, and say what is wrong with them.

    block: `samples`; row is filled (`cw.block` says what they hold). weights: two tuples, of Re and Im. noise:
    `noise_model`. What cannot be used has no phasor, and NaN for the variance of its phase.
    """
    samples, cosine, sine = block["samples"], row["cosine"], row["sine"]
    amplitude, variance = row["amplitude"], row["variance"]
    spread, total, strewn, why = row["spread"], row["total"], row["strewn"], row["why"]
    to_real, to_imaginary = weights
    n_frequencies, n_steps = cosine.shape[0], len(to_real)
    floor, per_amplitude, low, high = noise[0], noise[2], noise[4], noise[5]
    g_ri, g_ii, g_difference = _TWO * noise[7], noise[8], noise[6] - noise[8]
    for i in range(WIDTH):
        phase_variance, light, across_all = _ZERO, _ZERO, _ZERO
        limited, equal, finite = False, False, True
        for k in range(n_frequencies):
            first = samples[k * n_steps, i]
            real, imaginary, least, most = to_real[0] * first, to_imaginary[0] * first, first, first
            for n in range(1, n_steps):
                sample = samples[k * n_steps + n, i]
                real += to_real[n] * sample
                imaginary += to_imaginary[n] * sample
                least = sample if sample < least else least
                most = sample if sample > most else most
            square = real * real + imaginary * imaginary
            size = np.sqrt(square)
            inverse = _ONE / size
            c, s = real * inverse, imaginary * inverse
            # at right angles to the phasor: sum of (c w_imaginary - s w_real)^2, with c^2 + s^2 = 1
            across = (floor + per_amplitude * size) * (g_ii + s * (s * g_difference - c * g_ri))
            usable = (square > _ZERO) & (square < _LARGEST)
            cosine[k, i], sine[k, i] = (c if usable else _ZERO), (s if usable else _ZERO)
            amplitude[k, i], variance[k, i] = (size if usable else _ZERO), across
            phase_variance += across * inverse * inverse
            light += size
            across_all += across
            limited |= (most >= high) | (least <= low)
            equal |= (most == least) & (most < high)
            finite &= square < _LARGEST
        reason = _SATURATED if limited else _VALID
        reason = _NO_SIGNAL if equal else reason
        reason = reason if finite else _NOT_FINITE
        why[i] = reason
        spread[i] = phase_variance if reason == _VALID else _NAN
        total[i], strewn[i] = light, across_all
    if noise[1] > _ZERO:
        _add_shot_noise(samples, weights, noise[1], noise[3], row)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _add_shot_noise(samples: Any, weights: Any, per_light: Any, black: Any, row: Any) -> None:
    """Add the shot noise that the samples themselves show, each by its part across the phasor."""
    cosine, sine, amplitude, variance = row["cosine"], row["sine"], row["amplitude"], row["variance"]
    spread, strewn = row["spread"], row["strewn"]
    to_real, to_imaginary = weights
    n_steps = len(to_real)
    for i in range(WIDTH):
        for k in range(cosine.shape[0]):
            across = _ZERO
            for n in range(n_steps):
                light = samples[k * n_steps + n, i] - black
                weight = cosine[k, i] * to_imaginary[n] - sine[k, i] * to_real[n]
                across += weight * weight * (light if light > _ZERO else _ZERO)
            across *= per_light
            variance[k, i] += across
            strewn[i] += across
            spread[i] += across / (amplitude[k, i] * amplitude[k, i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def start_sum(here: Any, block: Any) -> None:
    """Let the sum of each pixel be its own phasor, for neighbours to be added."""
    real, imaginary, count, strewn = block["real"], block["imaginary"], block["count"], block["strewn"]
    cosine, sine, amplitude, across = here["cosine"], here["sine"], here["amplitude"], here["strewn"]
    why, reason = block["why"], here["why"]
    for i in range(INNER):
        x = RIM + i
        for k in range(real.shape[0]):
            real[k, i], imaginary[k, i] = amplitude[k, x] * cosine[k, x], amplitude[k, x] * sine[k, x]
        count[i], strewn[i], why[i] = _ONE, across[x], reason[x]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def add_neighbours(here: Any, there: Any, places: Any, rule: Any, block: Any) -> None:
    """Add those phasors of another row, or of the same one, that belong to the same surface.

    places: where in the row `there` the neighbours of the first pixel are, unsigned, since a place below zero would be
    one from the end, which no vector instruction can load. A neighbour takes part if the squared distance of the unit
    phasors is below rule[0] times what noise makes of it plus rule[3], and neither amplitude is more than rule[1] times
    the other.
    """
    real, imaginary = block["real"], block["imaginary"]
    count, strewn, take = block["count"], block["strewn"], block["take"]
    cosine, sine, spread, total = here["cosine"], here["sine"], here["spread"], here["total"]
    cosines, sines, amplitudes = there["cosine"], there["sine"], there["amplitude"]
    spreads, totals, across = there["spread"], there["total"], there["strewn"]
    squared, contrast, tolerance, n_frequencies = rule[0], rule[1], rule[3], real.shape[0]
    for i in range(INNER):
        x, number, noise = RIM + i, count[i], strewn[i]
        for j, place in enumerate(places):
            at, distance = place + np.uint64(i), _ZERO
            for k in range(n_frequencies):
                right, up = cosine[k, x] - cosines[k, at], sine[k, x] - sines[k, at]
                distance += right * right + up * up
            alike = (totals[at] <= contrast * total[x]) & (total[x] <= contrast * totals[at])
            alike &= distance <= squared * (spread[x] + spreads[at]) + tolerance
            one, more = (_ONE if alike else _ZERO), across[at]
            number += one
            noise += more if alike else _ZERO
            take[j, i] = one
        count[i], strewn[i] = number, noise
        for k in range(n_frequencies):
            re, im = real[k, i], imaginary[k, i]
            for j, place in enumerate(places):
                at = place + np.uint64(i)
                size = take[j, i] * amplitudes[k, at]
                re += size * cosines[k, at]
                im += size * sines[k, at]
            real[k, i], imaginary[k, i] = re, im


@njit(cache=True, nogil=True)
def refuse_lonely(block: Any, column: int, width: int, rows: int, reach: int, least: Any) -> None:
    """Call those pixels FLYING with which less than a part of the neighbours that there are could be averaged.

    column: of the first pixel in the image of that width; rows: how many of the neighbourhood are in the image.
    """
    count, why = block["count"], block["why"]
    for i in range(min(INNER, width - column)):
        x = column + i
        places = rows * (min(x, reach) + min(width - 1 - x, reach) + 1) - 1
        lonely = (count[i] < _ONE + least * np.float32(places)) & (why[i] == _VALID)
        why[i] = _FLYING if lonely else why[i]


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
