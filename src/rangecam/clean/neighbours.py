"""Which pixels are refused because of their light or their neighbours, and the image as filters want it.

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
from rangecam.values import value

Codes = NDArray[np.uint8]
RIM = 2
"""Rows and columns of NaN that `judge` lays around the image, so that no filter need ask where it ends."""

_LOW_AMPLITUDE, _WRAPPED, _ISOLATED, _BORDER = (
    int(code) for code in (Why.LOW_AMPLITUDE, Why.WRAPPED, Why.ISOLATED, Why.BORDER)
)


def singles(*values: float) -> list[Any]:
    """Return constants for kernels: a double among them would halve the speed."""
    return [np.float32(value) for value in values]


_NAN, _ZERO, _ONE = singles(math.nan, 0, 1)


@value
class Kept:
    """What a filter gets: an image and which of its pixels were not refused.

    range_m, sigma_m, amplitude (H, W) float32 as they came; why (H, W) after `judge`. around: from `judge`.
    floor_m (H, W): the range from which on a pixel will be refused as floor; a filter may leave it alone.
    """

    range_m: Floats
    sigma_m: Floats
    amplitude: Floats
    why: Codes
    around: Floats
    floor_m: Floats


def judge(
    planes: tuple[Floats, Floats, Floats],
    why: Ints,
    amplitudes: tuple[Floats, Floats],
    needed: Ints,
    settings: CleanSettings,
) -> tuple[Codes, Floats]:
    """Return the first reason to refuse each pixel (H, W) uint8, and what filters need of those not refused.

    planes: range, sigma and amplitude; amplitudes: the least of each pixel, alone and times squared range; needed:
    common neighbours it must have. Two pixels are common neighbours if their ranges differ by no more than the sum of
    their reaches (Steinbäck 2016, eqs 2.8-2.9, with T_2 = tolerance + k (sigma_i + sigma_j) / sqrt 2, which for equal
    sigmas is k times the sigma of the difference). Only pixels that came in valid are neighbours.
    The second array (3, H + 4, W + 4) float32 holds range, reach and 1/sigma of those not refused; NaN, anything and 0
    of the others and in its rim.
    """
    height, width = why.shape
    reason = why.astype(np.uint8)
    came = np.empty((height + 2 * RIM, width + 2 * RIM), np.float32)
    around = np.empty((3, height + 2 * RIM, width + 2 * RIM), np.float32)
    _refuse(planes, amplitudes, needed, tolerance_rules(settings), came, around, reason)
    return reason, around


@lru_cache(maxsize=16)
def tolerance_rules(settings: CleanSettings) -> Floats:
    """Return the reach of a pixel: a constant and a factor of its sigma."""
    return np.array(
        [settings.neighbour_tolerance_m / 2, settings.neighbour_tolerance_sigmas / math.sqrt(2)], np.float32
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _refuse(
    planes: tuple[Floats, Floats, Floats],
    amplitudes: tuple[Floats, Floats],
    needed: Ints,
    tolerance: Floats,
    came: Floats,
    around: Floats,
    reason: Ints,
) -> None:
    range_m, sigma_m, amplitude = planes
    weakest, wrapped = amplitudes
    height, width = reason.shape
    common = np.empty(width, np.float32)
    for y in (0, 1, height + RIM, height + RIM + 1):
        came[y, :] = _NAN
        around[0, y, :] = _NAN
        around[1, y, :] = _ZERO
        around[2, y, :] = _ZERO
    _spread(range_m, sigma_m, reason, 0, tolerance, came, around)
    for y in range(height):
        if y + 1 < height:  # a row ahead, so that rows are still near when they are needed
            _spread(range_m, sigma_m, reason, y + 1, tolerance, came, around)
        begin, end = span(reason[y])
        if begin == end:
            around[0, y + RIM, :] = _NAN
            around[2, y + RIM, :] = _ZERO
            continue
        here = slice(begin + 1, end + 3)
        r0, r1, r2 = came[y + 1, here], came[y + 2, here], came[y + 3, here]
        t0, t1, t2 = around[1, y + 1, here], around[1, y + 2, here], around[1, y + 3, here]
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
        for rest in (slice(0, begin + RIM), slice(end + RIM, width + 2 * RIM)):
            around[0, y + RIM, rest] = _NAN
            around[2, y + RIM, rest] = _ZERO
        kept, weight, sigma = around[0, y + RIM, begin + RIM :], around[2, y + RIM, begin + RIM :], sigma_m[y, begin:]
        for x in range(end - begin):
            kept[x] = r1[x + 1] if why[x] == 0 else _NAN
            weight[x] = _ONE / sigma[x] if why[x] == 0 else _ZERO


@njit(cache=True, nogil=True)
def _spread(
    range_m: Floats, sigma_m: Floats, why: Ints, y: int, tolerance: Floats, came: Floats, around: Floats
) -> None:
    """Lay a rim around a row; invalid pixels and the rim are NaN, so that no comparison with them is true."""
    width = why.shape[1]
    row, reach = came[y + RIM], around[1, y + RIM]
    for edge in (slice(0, RIM), slice(width + RIM, width + 2 * RIM)):
        row[edge] = _NAN
        reach[edge] = _ZERO
    if _none(why[y]):
        row[:] = _NAN
        reach[:] = _ZERO
        return
    for x in range(width):
        row[x + RIM] = range_m[y, x] if why[y, x] == 0 else _NAN
        reach[x + RIM] = tolerance[0] + tolerance[1] * sigma_m[y, x]


@njit(cache=True, nogil=True)
def span(why: Ints) -> tuple[int, int]:
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
def _common(other: float, value: float, reach: float) -> Any:
    return _ONE if abs(other - value) <= reach else _ZERO
