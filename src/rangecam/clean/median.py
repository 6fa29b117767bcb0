"""The median of each pixel's neighbourhood, and its standard deviation.

The kernel has no branches within a row and writes every step out, so that it becomes vector instructions.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from rangecam.clean.neighbours import Kept, singles, span
from rangecam.clean.settings import CleanSettings
from rangecam.compiled import kernel
from rangecam.types import Floats, Ints

_ZERO, _ONE, _TWO, _HALF, _HUGE = singles(0, 1, 2, 0.5, 3e38)
_N3, _N5, _N7, _N9 = singles(3, 5, 7, 9)
_V3, _V5, _V7, V9 = singles(0.448671, 0.286834, 0.210447, 0.166101)
"""Variance of the median of n = 3, 5, 7, 9 normal values of variance 1."""
_RISE3, _RISE5, _RISE7, RISE9 = singles(0.6, 0.75, 0.7, 0.55)
_HALF3, _HALF5, _HALF7, HALF9 = singles(4, 15, 28, 35)
"""On an incline it is v + rise s / (s + half), with s the sum of squared half differences of the pairs in sigmas: a fit
to simulated planes of all directions, within 5 % up to a slope of 1.5 sigma a pixel, 15 % beyond."""


def median(kept: Kept, settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the median of each pixel and its common neighbours, and its standard deviation: (H, W) float32 m each.

    Neighbours take part in pairs, opposite to each other (see `filters`), so that the number of values is odd. With
    `median_across_edges` every valid pair takes part.
    Its variance is that of the median of n normal values with the harmonic mean of their sigmas: the density at the
    median of unlike values is the mean of theirs, each 1/(sqrt(2 pi) sigma). On an incline the values spread and the
    few in the middle decide: what pairs differ by more than their noise raises the variance.
    Pixels whose neighbours all lie beyond `kept.floor_m` keep their range: the floor refuses them with any median.
    """
    range_m, sigma_m = kept.range_m.copy(), kept.sigma_m.copy()
    _median(kept.why, kept.around, window_rules(settings), kept.floor_m, range_m, sigma_m)
    return range_m, sigma_m


@lru_cache(maxsize=16)
def window_rules(settings: CleanSettings) -> Floats:
    """Return what is added to the reach of neighbours in the same row and in others, minus infinity to leave out."""
    all_of_them = _HUGE if settings.median_across_edges else _ZERO
    return np.array([all_of_them, -np.inf if settings.window == "3x1" else all_of_them], np.float32)


@kernel(error_model="numpy")
def _median(why: Ints, around: Floats, window: Floats, floor: Floats, middles: Floats, spread: Floats) -> None:
    """Take the middle of nine, where a pair that takes no part is replaced with -huge and +huge."""
    unwanted = np.empty(middles.shape[1], np.uint8)
    in_row, off_row = window[0], window[1]
    for y in range(middles.shape[0]):
        begin, end = span(why[y])
        if begin < end:
            _unwanted(around, floor, y, unwanted)
            begin, end = span(unwanted)
        if begin == end:
            continue
        here = slice(begin + 1, end + 3)
        r0, r1, r2 = around[0, y + 1, here], around[0, y + 2, here], around[0, y + 3, here]
        t0, t1, t2 = around[1, y + 1, here], around[1, y + 2, here], around[1, y + 3, here]
        w0, w1, w2 = around[2, y + 1, here], around[2, y + 2, here], around[2, y + 3, here]
        out, sigma = middles[y, begin:], spread[y, begin:]
        for x in range(end - begin):
            v4 = r1[x + 1]
            reach, beside = t1[x + 1] + in_row, t1[x + 1] + off_row
            a = both(r0[x], r2[x + 2], v4, beside + t0[x], beside + t2[x + 2])
            b = both(r0[x + 1], r2[x + 1], v4, beside + t0[x + 1], beside + t2[x + 1])
            c = both(r0[x + 2], r2[x], v4, beside + t0[x + 2], beside + t2[x])
            d = both(r1[x], r1[x + 2], v4, reach + t1[x], reach + t1[x + 2])
            number = _ONE + _TWO * ((_ONE if a else _ZERO) + (_ONE if b else _ZERO))
            number += _TWO * ((_ONE if c else _ZERO) + (_ONE if d else _ZERO))
            weight = w1[x + 1] + (w0[x] + w2[x + 2] if a else _ZERO) + (w0[x + 1] + w2[x + 1] if b else _ZERO)
            weight += (w0[x + 2] + w2[x] if c else _ZERO) + (w1[x] + w1[x + 2] if d else _ZERO)
            uneven = uneven_part(a, r0[x], r2[x + 2]) + uneven_part(b, r0[x + 1], r2[x + 1])
            uneven += uneven_part(c, r0[x + 2], r2[x]) + uneven_part(d, r1[x], r1[x + 2])
            v0, v8 = (r0[x] if a else -_HUGE), (r2[x + 2] if a else _HUGE)
            v1, v7 = (r0[x + 1] if b else -_HUGE), (r2[x + 1] if b else _HUGE)
            v2, v6 = (r0[x + 2] if c else -_HUGE), (r2[x] if c else _HUGE)
            v3, v5 = (r1[x] if d else -_HUGE), (r1[x + 2] if d else _HUGE)
            v4 = middle(v0, v1, v2, v3, v4, v5, v6, v7, v8)
            out[x] = v4 if w1[x + 1] > _ZERO else out[x]
            precision = weight / number if w1[x + 1] > _ZERO else _ONE
            steep = uneven * precision * precision - _HALF * _HALF * (number - _ONE)  # less what noise makes of it
            noise = np.sqrt(variance_of_median(number, steep)) / precision
            sigma[x] = noise if w1[x + 1] > _ZERO else sigma[x]


@kernel
def _unwanted(around: Floats, floor: Floats, y: int, unwanted: Ints) -> None:
    """Mark the pixels of a row that were refused or see the floor for sure: no median is below the least value."""
    here = slice(1, len(unwanted) + 3)
    r0, r1, r2, limit = around[0, y + 1, here], around[0, y + 2, here], around[0, y + 3, here], floor[y]
    for x in range(len(limit)):
        least = _less(r0[x], _less(r0[x + 1], _less(r0[x + 2], _HUGE)))
        least = _less(r1[x], _less(r1[x + 1], _less(r1[x + 2], least)))
        least = _less(r2[x], _less(r2[x + 1], _less(r2[x + 2], least)))
        value = r1[x + 1]
        unwanted[x] = 0 if (value == value) & (least <= limit[x]) else 1


@kernel
def _less(value: float, least: float) -> float:
    return value if value < least else least


@kernel
def both(one: float, other: float, value: float, reach_one: float, reach_other: float) -> Any:
    """Return whether two pixels that lie opposite to each other are both within reach of a value."""
    return (abs(one - value) <= reach_one) & (abs(other - value) <= reach_other)


@kernel
def middle(v0: Any, v1: Any, v2: Any, v3: Any, v4: Any, v5: Any, v6: Any, v7: Any, v8: Any) -> Any:
    """Return the median of nine: the network of Steinbäck 2016, A.8, but for exchanges that do not reach the middle."""
    v1, v2 = _order(v1, v2)
    v4, v5 = _order(v4, v5)
    v7, v8 = _order(v7, v8)
    v0, v1 = _order(v0, v1)
    v3, v4 = _order(v3, v4)
    v6, v7 = _order(v6, v7)
    v1, v2 = _order(v1, v2)
    v4, v5 = _order(v4, v5)
    v7, v8 = _order(v7, v8)
    v0, v3 = _order(v0, v3)
    v5, v8 = _order(v5, v8)
    v4, v7 = _order(v4, v7)
    v3, v6 = _order(v3, v6)
    v1, v4 = _order(v1, v4)
    v2, v5 = _order(v2, v5)
    v4, v7 = _order(v4, v7)
    v4, v2 = _order(v4, v2)
    v6, v4 = _order(v6, v4)
    return _order(v4, v2)[0]


@kernel
def _order(a: float, b: float) -> tuple[float, float]:
    return (a if a < b else b), (b if a < b else a)


@kernel
def uneven_part(taken: bool, one: float, other: float) -> Any:
    """Return the squared half difference of a pair, if it takes part."""
    half = _HALF * (one - other)
    return half * half if taken else _ZERO


@kernel(error_model="numpy")
def variance_of_median(n: float, steep: float) -> Any:
    """Return the variance of the median of n values of variance 1, n = 1, 3, 5, 7 or 9."""
    level, rise, half = _ONE, _ZERO, HALF9
    level, rise, half = (_V3, _RISE3, _HALF3) if n == _N3 else (level, rise, half)
    level, rise, half = (_V5, _RISE5, _HALF5) if n == _N5 else (level, rise, half)
    level, rise, half = (_V7, _RISE7, _HALF7) if n == _N7 else (level, rise, half)
    level, rise, half = (V9, RISE9, HALF9) if n == _N9 else (level, rise, half)
    return level + rise * steep / (steep + half)
