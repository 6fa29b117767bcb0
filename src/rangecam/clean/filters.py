"""Filters on the neighbourhood of each pixel, with the standard deviation of what they return.

The kernels have no branches within a row and write every step out, so that they become vector instructions.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.clean.limits import REFUSE
from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints, Why

_LOW_AMPLITUDE, _WRAPPED, _ISOLATED = int(Why.LOW_AMPLITUDE), int(Why.WRAPPED), int(Why.ISOLATED)
_BORDER, _FLOOR, _OUTSIDE_AREA = int(Why.BORDER), int(Why.FLOOR), int(Why.OUTSIDE_AREA)


def _singles(*values: float) -> list[Any]:
    return [np.float32(value) for value in values]  # a double among the constants would halve the speed


Codes = NDArray[np.uint8]
_NAN, _ZERO, _ONE, _HALF, _HUGE = _singles(math.nan, 0, 1, 0.5, 3e38)
_MEDIAN_VARIANCE = (1, 1 / 2, 0.448671, 0.298200, 0.286834, 0.214743, 0.210447, 0.168181, 0.166101)
# of the median of n = 1..9 normal values of variance 1, the midpoint of the two in the middle where n is even
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8, _S9 = _singles(*np.sqrt(_MEDIAN_VARIANCE))


def judge(
    planes: tuple[Floats, Floats, Floats],
    why: Ints,
    amplitudes: tuple[Floats, Floats],
    needed: Ints,
    settings: CleanSettings,
) -> tuple[Codes, Floats]:
    """Return the first reason to refuse each pixel (H, W) uint8, and what `smooth` needs of those not refused.

    planes: range, sigma and amplitude; amplitudes: the least of each pixel, alone and times squared range; needed:
    common neighbours it must have. Two pixels are common neighbours if their ranges differ by no more than the sum of
    their reaches (Steinbäck 2016, eqs 2.8-2.9, with T_2 = tolerance + k (sigma_i + sigma_j) / sqrt 2, which for equal
    sigmas is k times the sigma of the difference). Only pixels that came in valid are neighbours.
    The second array (3, H + 2, W + 2) float32 holds range, reach and 1/sigma of those not refused; NaN, anything and 0
    of the others and in its rim.
    """
    height, width = why.shape
    reason = why.astype(np.uint8)
    came = np.empty((height + 2, width + 2), np.float32)
    around = np.empty((3, height + 2, width + 2), np.float32)
    _spread(planes[0], planes[1], why, _tolerance(settings), came, around)
    _refuse(planes, amplitudes, needed, came, around, reason)
    return reason, around


@lru_cache(maxsize=16)
def _tolerance(settings: CleanSettings) -> Floats:
    """Return the reach of a pixel: a constant and a factor of its sigma."""
    return np.array(
        [settings.neighbour_tolerance_m / 2, settings.neighbour_tolerance_sigmas / math.sqrt(2)], np.float32
    )


@njit(cache=True, nogil=True)
def _spread(range_m: Floats, sigma_m: Floats, why: Ints, tolerance: Floats, came: Floats, around: Floats) -> None:
    """Give the image a rim of NaN; invalid pixels are NaN too, so that no comparison with them is true."""
    height, width = range_m.shape
    came[:, 0] = _NAN
    came[:, width + 1] = _NAN
    for y in (0, height + 1):
        came[y, :] = _NAN
        around[0, y, :] = _NAN
        around[1, y, :] = _ZERO
        around[2, y, :] = _ZERO
    around[1, :, 0] = _ZERO
    around[1, :, width + 1] = _ZERO
    for y in range(height):
        for x in range(width):
            came[y + 1, x + 1] = range_m[y, x] if why[y, x] == 0 else _NAN
            around[1, y + 1, x + 1] = tolerance[0] + tolerance[1] * sigma_m[y, x]


@njit(cache=True, nogil=True, error_model="numpy")
def _refuse(
    planes: tuple[Floats, Floats, Floats],
    amplitudes: tuple[Floats, Floats],
    needed: Ints,
    came: Floats,
    around: Floats,
    reason: Ints,
) -> None:
    range_m, sigma_m, amplitude = planes
    weakest, wrapped = amplitudes
    width = reason.shape[1]
    common = np.empty(width, np.float32)
    for y in range(reason.shape[0]):
        begin, end = _span(reason[y])
        if begin == end:
            for x in range(width + 2):
                around[0, y + 1, x] = _NAN
                around[2, y + 1, x] = _ZERO
            continue
        r0, r1, r2 = came[y, begin : end + 2], came[y + 1, begin : end + 2], came[y + 2, begin : end + 2]
        t0, t1, t2 = around[1, y, begin : end + 2], around[1, y + 1, begin : end + 2], around[1, y + 2, begin : end + 2]
        for x in range(end - begin):
            value, reach = r1[x + 1], t1[x + 1]
            number = _common(r0[x], value, reach + t0[x]) + _common(r0[x + 1], value, reach + t0[x + 1])
            number += _common(r0[x + 2], value, reach + t0[x + 2]) + _common(r1[x], value, reach + t1[x])
            number += _common(r1[x + 2], value, reach + t1[x + 2]) + _common(r2[x], value, reach + t2[x])
            number += _common(r2[x + 1], value, reach + t2[x + 1]) + _common(r2[x + 2], value, reach + t2[x + 2])
            common[x] = number
        light, least, least_wrapped = amplitude[y, begin:], weakest[y, begin:], wrapped[y, begin:]
        why, need, distance = reason[y, begin:], needed[y, begin:], range_m[y, begin:]
        for x in range(end - begin):
            first = _ISOLATED if common[x] < need[x] else 0
            first = _BORDER if need[x] == REFUSE else first
            first = _WRAPPED if light[x] * distance[x] * distance[x] < least_wrapped[x] else first
            first = _LOW_AMPLITUDE if light[x] < least[x] else first
            why[x] = why[x] if why[x] != 0 else first
        for rest in (slice(0, begin + 1), slice(end + 1, width + 2)):
            around[0, y + 1, rest] = _NAN
            around[2, y + 1, rest] = _ZERO
        kept, weight, sigma = around[0, y + 1, begin + 1 :], around[2, y + 1, begin + 1 :], sigma_m[y, begin:]
        for x in range(end - begin):
            kept[x] = r1[x + 1] if why[x] == 0 else _NAN
            weight[x] = _ONE / sigma[x] if why[x] == 0 else _ZERO


@njit(cache=True, nogil=True)
def _span(why: Ints) -> tuple[int, int]:
    """Return where a row begins and ends to hold zeros, in whole vectors: part of one would take as long."""
    if _none(why):
        return 0, 0
    columns = len(why)
    begin, end = 0, columns
    while why[begin] != 0:
        begin += 1
    while why[end - 1] != 0:
        end -= 1
    return begin // _VECTOR * _VECTOR, min(-(-end // _VECTOR) * _VECTOR, columns)


@njit(cache=True, nogil=True)
def _none(why: Ints) -> bool:
    """Return whether a row holds no zero; many do not, and this loop becomes vector instructions."""
    least = np.uint8(255)
    for x in range(len(why)):
        least = min(least, why[x])
    return bool(least > 0)


_VECTOR = 8  # pixels in a vector register, or a multiple


@njit(cache=True, nogil=True)
def _less(value: float, least: float) -> float:
    return value if value < least else least


@njit(cache=True, nogil=True)
def _common(other: float, value: float, reach: float) -> Any:
    return _ONE if abs(other - value) <= reach else _ZERO


def smooth(
    range_m: Floats, sigma_m: Floats, why: Ints, around: Floats, floor: Floats, settings: CleanSettings
) -> tuple[Floats, Floats]:
    """Return the median of each pixel's neighbourhood and its standard deviation: (H, W) float32 m each.

    Only valid pixels give and get a median; only common neighbours of the pixel give one, unless `median_across_edges`.
    Of an even number it is the midpoint. Its variance is that of the median of n normal values with the harmonic mean
    of their sigmas: the density at the median of unlike values is the mean of theirs, each 1/(sqrt(2 pi) sigma).
    why and around: from `judge`. Pixels whose neighbours all lie beyond `floor` (H, W) m keep their range, because
    `cut` refuses them with any median.
    """
    median, sigma = range_m.copy(), sigma_m.copy()
    _smooth(why, around, _window(settings), floor, median, sigma)
    return median, sigma


@lru_cache(maxsize=16)
def _window(settings: CleanSettings) -> Floats:
    """Return what is added to the reach of neighbours in the same row and in others, minus infinity to leave out."""
    all_of_them = _HUGE if settings.median_across_edges else _ZERO
    return np.array([all_of_them, -np.inf if settings.median == "3x1" else all_of_them], np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _smooth(why: Ints, around: Floats, window: Floats, floor: Floats, median: Floats, sigma: Floats) -> None:
    """Sort each neighbourhood by the network of 25 exchanges (Steinbäck 2016, A.8; the compiler drops the needless).

    Values that take no part are replaced by turns with +huge and -huge, so that the median of the others stays in the
    middle: place 4, or between 3 and 4 where their number is even, which is where the next turn would be -huge.
    """
    unwanted = np.empty(median.shape[1], np.uint8)
    in_row, off_row = window[0], window[1]
    for y in range(median.shape[0]):
        begin, end = _span(why[y])
        if begin < end:
            _unwanted(around, floor, y, unwanted)
            begin, end = _span(unwanted)
        if begin == end:
            continue
        r0, r1, r2 = around[0, y, begin : end + 2], around[0, y + 1, begin : end + 2], around[0, y + 2, begin : end + 2]
        t0, t1, t2 = around[1, y, begin : end + 2], around[1, y + 1, begin : end + 2], around[1, y + 2, begin : end + 2]
        w0, w1, w2 = around[2, y, begin : end + 2], around[2, y + 1, begin : end + 2], around[2, y + 2, begin : end + 2]
        middle, spread = median[y, begin:], sigma[y, begin:]
        for x in range(end - begin):
            value, side = r1[x + 1], _HUGE
            reach, beside = t1[x + 1] + in_row, t1[x + 1] + off_row
            v0, side, n0 = _take(r0[x], value, beside + t0[x], side)
            v1, side, n1 = _take(r0[x + 1], value, beside + t0[x + 1], side)
            v2, side, n2 = _take(r0[x + 2], value, beside + t0[x + 2], side)
            v3, side, n3 = _take(r1[x], value, reach + t1[x], side)
            v5, side, n5 = _take(r1[x + 2], value, reach + t1[x + 2], side)
            v6, side, n6 = _take(r2[x], value, beside + t2[x], side)
            v7, side, n7 = _take(r2[x + 1], value, beside + t2[x + 1], side)
            v8, side, n8 = _take(r2[x + 2], value, beside + t2[x + 2], side)
            v4 = value
            v0, v1 = _order(v0, v1)
            v3, v4 = _order(v3, v4)
            v6, v7 = _order(v6, v7)
            v1, v2 = _order(v1, v2)
            v4, v5 = _order(v4, v5)
            v7, v8 = _order(v7, v8)
            v0, v1 = _order(v0, v1)
            v3, v4 = _order(v3, v4)
            v6, v7 = _order(v6, v7)
            v0, v3 = _order(v0, v3)
            v3, v6 = _order(v3, v6)
            v0, v3 = _order(v0, v3)
            v1, v4 = _order(v1, v4)
            v4, v7 = _order(v4, v7)
            v1, v4 = _order(v1, v4)
            v2, v5 = _order(v2, v5)
            v5, v8 = _order(v5, v8)
            v2, v5 = _order(v2, v5)
            v1, v3 = _order(v1, v3)
            v5, v7 = _order(v5, v7)
            v2, v6 = _order(v2, v6)
            v4, v6 = _order(v4, v6)
            v2, v4 = _order(v2, v4)
            v2, v3 = _order(v2, v3)
            v5, v6 = _order(v5, v6)
            weight = n0 * w0[x] + n1 * w0[x + 1] + n2 * w0[x + 2]
            weight += n3 * w1[x] + w1[x + 1] + n5 * w1[x + 2]
            weight += n6 * w2[x] + n7 * w2[x + 1] + n8 * w2[x + 2]
            n = _ONE + n0 + n1 + n2 + n3 + n5 + n6 + n7 + n8
            between = _HALF * (v3 + v4) if side < _ZERO else v4
            middle[x] = between if w1[x + 1] > _ZERO else middle[x]
            spread[x] = _median_sigma(n) * n / weight if w1[x + 1] > _ZERO else spread[x]


@njit(cache=True, nogil=True)
def _unwanted(around: Floats, floor: Floats, y: int, unwanted: Ints) -> None:
    """Mark the pixels of a row that were refused or see the floor for sure: no median is below the least value."""
    r0, r1, r2, limit = around[0, y], around[0, y + 1], around[0, y + 2], floor[y]
    for x in range(len(limit)):
        least = _less(r0[x], _less(r0[x + 1], _less(r0[x + 2], _HUGE)))
        least = _less(r1[x], _less(r1[x + 1], _less(r1[x + 2], least)))
        least = _less(r2[x], _less(r2[x + 1], _less(r2[x + 2], least)))
        value = r1[x + 1]
        unwanted[x] = 0 if (value == value) & (least <= limit[x]) else 1


@njit(cache=True, nogil=True)
def _take(other: float, value: float, reach: float, side: float) -> tuple[float, float, float]:
    taken = abs(other - value) <= reach
    return (other if taken else side), (side if taken else -side), (_ONE if taken else _ZERO)


@njit(cache=True, nogil=True)
def _order(a: float, b: float) -> tuple[float, float]:
    return (a if a < b else b), (b if a < b else a)


@njit(cache=True, nogil=True)
def _median_sigma(n: float) -> Any:
    sigma = _S1
    sigma = _S2 if n == 2 else sigma
    sigma = _S3 if n == 3 else sigma
    sigma = _S4 if n == 4 else sigma
    sigma = _S5 if n == 5 else sigma
    sigma = _S6 if n == 6 else sigma
    sigma = _S7 if n == 7 else sigma
    sigma = _S8 if n == 8 else sigma
    sigma = _S9 if n == 9 else sigma
    return sigma


def cut(
    range_m: Floats, sigma_m: Floats, why: Ints, limits: tuple[Floats, Floats, Floats], settings: CleanSettings
) -> Codes:
    """Return why (H, W) uint8 with the pixels that see the floor or lie outside the area of interest refused too.

    limits: the range at which each pixel meets the floor, enters and leaves the area.
    """
    reason = np.empty(why.shape, np.uint8)
    _cut(range_m, sigma_m, why, limits, settings.floor_margin_sigmas, reason)
    return reason


@njit(cache=True, nogil=True)
def _cut(
    range_m: Floats, sigma_m: Floats, why: Ints, limits: tuple[Floats, Floats, Floats], sigmas: float, reason: Ints
) -> None:
    floor, near, far = limits
    factor = np.float32(sigmas)
    for y in range(range_m.shape[0]):
        for x in range(range_m.shape[1]):
            value = range_m[y, x]
            first = 0 if (value >= near[y, x]) & (value <= far[y, x]) else _OUTSIDE_AREA
            first = _FLOOR if value + factor * sigma_m[y, x] > floor[y, x] else first
            reason[y, x] = why[y, x] if why[y, x] != 0 else first
