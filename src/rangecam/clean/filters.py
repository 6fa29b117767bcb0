"""Filters on the neighbourhood of each pixel, with the standard deviation of what they return."""

import math

import numpy as np
from numba import njit

from rangecam.clean.limits import REFUSE
from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints, Why

_LOW_AMPLITUDE, _WRAPPED, _ISOLATED = int(Why.LOW_AMPLITUDE), int(Why.WRAPPED), int(Why.ISOLATED)
_BORDER, _FLOOR, _OUTSIDE_AREA = int(Why.BORDER), int(Why.FLOOR), int(Why.OUTSIDE_AREA)

MEDIAN_SIGMA = np.sqrt([np.nan, 1, 1 / 2, 0.448671, 0.298200, 0.286834, 0.214743, 0.210447, 0.168181, 0.166101])
"""Standard deviation of the median of n normal values of standard deviation 1, n = 0..9, midpoint where n is even."""


def judge(
    range_m: Floats,
    sigma_m: Floats,
    amplitude: Floats,
    why: Ints,
    limits: tuple[tuple[Floats, Floats], Ints],
    settings: CleanSettings,
) -> tuple[Ints, Floats]:
    """Return the first reason to refuse each pixel (H, W) uint8, and what `smooth` needs of those not refused.

    limits: least amplitudes and neighbours needed of each pixel. Two pixels are common neighbours if their ranges
    differ by no more than the sum of their reaches (Steinbäck 2016, eqs 2.8-2.9, with T_2 = tolerance + k (sigma_i +
    sigma_j) / sqrt 2, which for equal sigmas is k times the sigma of the difference).
    The second array (3, H + 2, W + 2) float32 holds range, reach and 1/sigma, with a rim of NaN, NaN and 0.
    """
    height, width = range_m.shape
    reason = np.empty((height, width), np.uint8)
    neighbourhood = np.empty((3, height + 2, width + 2), np.float32)
    half = np.float32(settings.neighbour_tolerance_m / 2)
    per_sigma = np.float32(settings.neighbour_tolerance_sigmas / math.sqrt(2))
    _spread(range_m, sigma_m, why, (half, per_sigma), neighbourhood)
    _refuse(range_m, amplitude, why, limits, neighbourhood, reason)
    _blank(reason, sigma_m, neighbourhood)
    return reason, neighbourhood


@njit(cache=True, nogil=True)
def _spread(range_m: Floats, sigma_m: Floats, why: Ints, tolerance: tuple[float, float], around: Floats) -> None:
    height, width = range_m.shape
    nothing = np.float32(np.nan)
    around[:, 0, :] = nothing
    around[:, height + 1, :] = nothing
    around[:, :, 0] = nothing
    around[:, :, width + 1] = nothing
    for row in range(height):
        for column in range(width):
            around[0, row + 1, column + 1] = range_m[row, column] if why[row, column] == 0 else nothing
            around[1, row + 1, column + 1] = tolerance[0] + tolerance[1] * sigma_m[row, column]


@njit(cache=True, nogil=True)
def _refuse(
    range_m: Floats,
    amplitude: Floats,
    why: Ints,
    limits: tuple[tuple[Floats, Floats], Ints],
    around: Floats,
    reason: Ints,
) -> None:
    (weakest, wrapped), needed = limits
    height, width = range_m.shape
    common = np.empty(width, np.int32)
    for row in range(height):
        common[:] = -1  # the pixel itself is counted below
        for i in range(3):
            for j in range(3):
                for column in range(width):
                    difference = abs(around[0, row + i, column + j] - around[0, row + 1, column + 1])
                    reach = around[1, row + i, column + j] + around[1, row + 1, column + 1]
                    common[column] += difference <= reach
        for column in range(width):
            light = amplitude[row, column]
            first = _ISOLATED if common[column] < needed[row, column] else 0
            first = _BORDER if needed[row, column] == REFUSE else first
            first = _WRAPPED if light * range_m[row, column] * range_m[row, column] < wrapped[row, column] else first
            first = _LOW_AMPLITUDE if light < weakest[row, column] else first
            reason[row, column] = why[row, column] if why[row, column] != 0 else first


@njit(cache=True, nogil=True, error_model="numpy")
def _blank(reason: Ints, sigma_m: Floats, around: Floats) -> None:
    """Leave only the pixels that were not refused for the median: range NaN and 1/sigma 0 elsewhere."""
    height, width = reason.shape
    for row in range(height):
        for column in range(width):
            kept = reason[row, column] == 0
            value = around[0, row + 1, column + 1]
            around[0, row + 1, column + 1] = value if kept else np.float32(np.nan)
            around[2, row + 1, column + 1] = np.float32(1) / sigma_m[row, column] if kept else np.float32(0)


def smooth(range_m: Floats, sigma_m: Floats, neighbourhood: Floats, settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the median of each pixel's neighbourhood and its standard deviation: (H, W) float32 m each.

    Only valid pixels give and get a median; only common neighbours of the pixel give one, unless `median_across_edges`.
    Of an even number it is the midpoint. Its variance is that of the median of n normal values with the harmonic mean
    of their sigmas: the density at the median of unlike values is the mean of theirs, each 1/(sqrt(2 pi) sigma).
    """
    median, sigma = range_m.copy(), sigma_m.copy()
    columns = (0, 1, 2)
    rows = (0, 1, 2) if settings.median == "3x3" else (1,)
    window = np.array([[i in rows and j in columns for j in range(3)] for i in range(3)])
    _smooth(neighbourhood, window, settings.median_across_edges, MEDIAN_SIGMA, median, sigma)
    return median, sigma


@njit(cache=True, nogil=True, error_model="numpy")
def _smooth(around: Floats, window: Ints, across: bool, factor: Floats, median: Floats, sigma: Floats) -> None:
    """Sort each neighbourhood by a network of 25 exchanges (Steinbäck 2016, A.8), of which the median needs fewer.

    Values that do not take part are replaced by turns with +huge and -huge, so that the median of the others stays in
    the middle: place 4, or between 3 and 4 where their number is even. A row is handled at a time, so that the loops
    over its columns become vector instructions.
    """
    height, width = median.shape
    sorts = np.empty((9, width), np.float32)
    side = np.empty(width, np.float32)
    number = np.empty(width, np.int32)
    weight = np.empty(width, np.float32)
    for row in range(height):
        side[:] = _HUGE
        number[:] = 0
        weight[:] = 0
        for place in range(9):
            i, j = place // 3, place % 3
            for column in range(width):
                value, other = around[0, row + 1, column + 1], around[0, row + i, column + j]
                reach = around[1, row + 1, column + 1] + around[1, row + i, column + j]
                taken = window[i, j] & ((abs(other - value) <= reach) | (across & (other == other)))
                sorts[place, column] = other if taken else side[column]
                side[column] = side[column] if taken else -side[column]
                number[column] += taken
                weight[column] += around[2, row + i, column + j] if taken else np.float32(0)
        for exchange in range(25):
            first, second = _NETWORK[exchange]
            for column in range(width):
                a, b = sorts[first, column], sorts[second, column]
                sorts[first, column], sorts[second, column] = min(a, b), max(a, b)
        for column in range(width):
            n = number[column]
            if around[2, row + 1, column + 1] > 0:
                low, high = sorts[3, column], sorts[4, column]
                median[row, column] = high if n % 2 else (low + high) / 2
                sigma[row, column] = factor[n] * n / weight[column]


_HUGE = np.float32(3e38)
_NETWORK = (
    *((0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (0, 3), (3, 6), (0, 3), (1, 4)),
    *((4, 7), (1, 4), (2, 5), (5, 8), (2, 5), (1, 3), (5, 7), (2, 6), (4, 6), (2, 4), (2, 3), (5, 6)),
)


def cut(
    range_m: Floats, sigma_m: Floats, why: Ints, limits: tuple[Floats, Floats, Floats], settings: CleanSettings
) -> Ints:
    """Return why (H, W) uint8 with the pixels that see the floor or lie outside the area of interest refused too.

    limits: the range at which each pixel meets the floor, enters and leaves the area.
    """
    reason = np.empty_like(why)
    _cut(range_m, sigma_m, why, limits, np.float32(settings.floor_margin_sigmas), reason)
    return reason


@njit(cache=True, nogil=True)
def _cut(
    range_m: Floats, sigma_m: Floats, why: Ints, limits: tuple[Floats, Floats, Floats], sigmas: float, reason: Ints
) -> None:
    floor, near, far = limits
    for row in range(range_m.shape[0]):
        for column in range(range_m.shape[1]):
            value = range_m[row, column]
            inside = (value >= near[row, column]) & (value <= far[row, column])
            first = 0 if inside else _OUTSIDE_AREA
            first = _FLOOR if value + sigmas * sigma_m[row, column] > floor[row, column] else first
            reason[row, column] = why[row, column] if why[row, column] != 0 else first
