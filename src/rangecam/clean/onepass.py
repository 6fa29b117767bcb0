"""Judging, median and cutting in one pass over the rows: what `judge`, `median` and `cut` do one after the other.

Most of the time goes into moving images and into medians nobody asked for. So a few rows are kept at hand, and blocks
of eight pixels are told apart: those in which every pixel will be refused as floor are left alone, those in which all
neighbours of all pixels are common get the plain median of nine, and only the rest the general one.

The rows lie in one array at distances known to the compiler, and its indices have no sign: only then does a loop over
eight pixels become vector instructions without questions about overlap, which would cost more than the loop. The parts
are laid into one function (`forceinline`), because handing a dozen arrays to each of them costs as much as they do.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.clean.limits import REFUSE
from rangecam.clean.median import HALF9, RISE9, V9, both, middle, uneven_part, variance_of_median, window_rules
from rangecam.clean.neighbours import RIM, singles, tolerance_rules
from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints, Why

WEAKEST, WRAPPED, NEEDED, FLOOR, NEAREST_FLOOR, NEAR, FAR = range(7)
"""Planes of limits: least amplitude, least amplitude times squared range, common neighbours needed, range of the floor,
the farthest of it within 3x3 pixels, entry into the area of interest, exit."""

_LOW_AMPLITUDE, _WRAPPED, _ISOLATED, _BORDER, _FLOOR, _OUTSIDE, _NONE, _ALL_COMMON, _CODE = (
    np.int32(code)
    for code in (Why.LOW_AMPLITUDE, Why.WRAPPED, Why.ISOLATED, Why.BORDER, Why.FLOOR, Why.OUTSIDE_AREA, 0, 256, 255)
)
_ZERO, _ONE, _TWO, _QUARTER, _NINE, _HUGE, _NAN, _REFUSE = singles(0, 1, 2, 0.25, 9, 3e38, np.nan, REFUSE)

_PITCH, _SLOTS = 1048, 8  # pixels from row to row, and rows; together within the cache, and apart in it
_CAME, _REACH, _KEPT, _WEIGHT, _SIGMA, _PLANES = range(6)
WIDEST = _PITCH - 2 * RIM
"""Columns of the widest image that fits."""
_U = np.uint64
_C, _T, _K, _W, _S = (_U(plane * _SLOTS * _PITCH) for plane in range(_PLANES))
_ROW, _NO, _1, _2 = _U(_PITCH), _U(0), _U(1), _U(2)
_PLAIN, _GENERAL = _1, _2

_MANY = np.int32(1 << 30)
_KEPT_BIT, _NEARER_BITS, _COMMON_BIT, _EIGHT = (np.int32(bits) for bits in (1, 3, 4, 8))
"""Flags of a pixel: not refused, nearer than the floor around it (and kept), all neighbours common."""
_ALL_KEPT, _ALL_NEARER, _ALL_COMMON_BITS = (_U(bit * 0x0101010101010101) for bit in (1, 2, 4))
_LAST_KEPT, _LAST_NEARER, _FIRST_NEARER = _U(1 << 56), _U(2 << 56), _U(2)


def clean_in_one_pass(
    planes: tuple[Floats, Floats, Floats], why: Ints, limits: Floats, settings: CleanSettings
) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """Return range and sigma after the median and why after the cut: (H, W) float32 m each and uint8.

    planes: range, sigma and amplitude; limits (7, H, W) float32: see `WEAKEST` and so on. At most `WIDEST` columns.
    """
    images, reason = np.empty((2, *why.shape), np.float32), np.empty(why.shape, np.uint8)
    _clean(*planes, why, limits, _rules(settings), images, reason)  # a tuple would take longer to be handed over
    return images[0], images[1], reason


@lru_cache(maxsize=16)
def _rules(settings: CleanSettings) -> Floats:
    """Return the reach of a pixel (constant, factor of sigma), what the window adds to it, and the floor's sigmas."""
    parts = [*tolerance_rules(settings), *window_rules(settings), settings.floor_margin_sigmas]
    return np.array(parts, np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _clean(
    range_m: Floats, sigma_m: Floats, amplitude: Floats, why: Ints, limits: Floats, rules: Floats, images: Floats,
    reason: Ints,
) -> None:  # fmt: skip
    """Let row after row come, judge the row before it, and filter and cut the one before that.

    Medians take the place of what came: nobody asks for it any more by then.
    """
    (height, width), planes = why.shape, (range_m, sigma_m, amplitude)
    work = np.empty(_PLANES * _SLOTS * _PITCH, np.float32)
    rows = work.reshape((_PLANES, _SLOTS, _PITCH))
    codes, flags = np.empty((_SLOTS, width), np.int32), np.zeros((_SLOTS, (width + 7) // 8 * 8 + 16), np.uint8)
    words, kinds = flags.view(np.uint64), np.empty((width + 7) // 8, np.uint64)
    for slot in range(_SLOTS):
        _blank(rows, slot, 0, width + 2 * RIM)
    slot, begin, end, begin_before, end_before = 2, 0, 0, 0, 0
    for y in range(height + 2):
        slot += 1
        if slot == _SLOTS:
            _begin_again(rows, codes, words, width + 2 * RIM)
            slot = 3
        came = _come(planes, why, y, rules, rows, slot)
        for b in range(words.shape[1]):
            words[slot - 1, b] = _NO
        if end > begin:
            _judge(planes, limits, y - 1, work, rows, slot - 1, begin, end, codes, flags)
        if y > 1 and end_before > begin_before:
            spread, sigma_m = rows[_SIGMA, slot - 2, begin_before + RIM :], planes[1][y - 2, begin_before:]
            for x in range(end_before - begin_before):
                spread[x] = sigma_m[x]
            _filter(work, slot - 2, begin_before, end_before, words, kinds, rules)
        if y > 1:
            _pass_on(planes, why, y - 2, images, reason)
        if y > 1 and end_before > begin_before:
            _cut(why, limits, rules, y - 2, rows, slot - 2, begin_before, end_before, codes, images, reason)
        begin_before, end_before, begin, end = begin, end, came[0], came[1]


@njit(cache=True, nogil=True, forceinline=True)
def _blank(rows: Floats, slot: int, begin: int, end: int) -> None:
    """Let nothing be there; what a comparison with it adds to the reach does not matter."""
    came, kept = rows[_CAME, slot, begin:], rows[_KEPT, slot, begin:]
    for x in range(end - begin):
        came[x] = _NAN
    for x in range(end - begin):
        kept[x] = _NAN


@njit(cache=True, nogil=True, forceinline=True)
def _begin_again(rows: Floats, codes: Ints, words: Any, length: int) -> None:
    """Move the last three rows to the first slots."""
    for to in range(3):
        for plane in range(_SIGMA):
            source, target = rows[plane, _SLOTS - 3 + to], rows[plane, to]
            for x in range(length):
                target[x] = source[x]
        for x in range(codes.shape[1]):
            codes[to, x] = codes[_SLOTS - 3 + to, x]
        for b in range(words.shape[1]):
            words[to, b] = words[_SLOTS - 3 + to, b]


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _come(planes: Any, why: Ints, y: int, rules: Floats, rows: Floats, slot: int) -> tuple[int, int]:
    """Lay a row into its slot, invalid pixels as NaN; return where it begins and ends to be valid, in whole blocks."""
    range_m, sigma_m, _ = planes
    width = why.shape[1]
    least = np.uint8(255)
    if y < why.shape[0]:
        for x in range(width):
            least = min(least, why[y, x])
    if least > 0:
        _blank(rows, slot, RIM, width + RIM)
        return 0, 0
    came, reach = rows[_CAME, slot, RIM:], rows[_REACH, slot, RIM:]
    for x in range(width):
        came[x] = range_m[y, x] if why[y, x] == 0 else _NAN
    for x in range(width):
        reach[x] = rules[0] + rules[1] * sigma_m[y, x]
    first, last = np.int32(width), np.int32(0)
    for x in range(width):
        number = np.int32(x)
        low, high = (number, number) if why[y, x] == 0 else (_MANY, _NONE)
        first = low if low < first else first
        last = high if high > last else last
    return int(first) // 8 * 8, min((int(last) + 8) // 8 * 8, width)


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _judge(
    planes: Any, limits: Floats, y: int, work: Floats, rows: Floats, slot: int, begin: int, end: int, codes: Ints,
    flags: Ints,
) -> None:  # fmt: skip
    """Fill code, what is kept and its weight; of the code 256 says that all neighbours are common ones."""
    range_m, sigma_m, amplitude = planes
    code = codes[slot, begin:]
    _count(work, slot, begin, end, code)
    light, distance, need = amplitude[y, begin:], range_m[y, begin:], limits[NEEDED, y, begin:]
    wrapped, weakest = limits[WRAPPED, y, begin:], limits[WEAKEST, y, begin:]
    for x in range(end - begin):
        number = code[x]
        first = _ISOLATED if np.float32(number) < need[x] else _NONE
        first = _BORDER if need[x] == _REFUSE else first
        first = _WRAPPED if light[x] * distance[x] * distance[x] < wrapped[x] else first
        first = _LOW_AMPLITUDE if light[x] < weakest[x] else first
        code[x] = _ALL_COMMON if (first == _NONE) & (number == _EIGHT) else first
    for x in range(begin):
        rows[_KEPT, slot, x + RIM] = _NAN
    rest, came = rows[_KEPT, slot, end + RIM :], rows[_CAME, slot, begin + RIM :]
    for x in range(range_m.shape[1] - end):
        rest[x] = _NAN
    kept, weight, sigma = rows[_KEPT, slot, begin + RIM :], rows[_WEIGHT, slot, begin + RIM :], sigma_m[y, begin:]
    for x in range(end - begin):
        kept[x] = came[x] if code[x] & _CODE == _NONE else _NAN
    for x in range(end - begin):
        weight[x] = _ONE / sigma[x] if kept[x] == kept[x] else _ZERO
    flag, nearest = flags[slot, begin + 8 :], limits[NEAREST_FLOOR, y, begin:]
    for x in range(end - begin):
        bits = _NEARER_BITS if kept[x] <= nearest[x] else _KEPT_BIT
        bits = bits if kept[x] == kept[x] else _NONE
        flag[x] = bits + _COMMON_BIT if code[x] == _ALL_COMMON else bits


@njit(cache=True, nogil=True, forceinline=True)
def _count(work: Floats, slot: int, begin: int, end: int, number: Ints) -> None:
    """Count the common neighbours of each pixel."""
    start = _U((slot - 1) * _PITCH + RIM - 1 + begin)
    for i in range(_U(end - begin)):
        a = start + _U(i)
        b = a + _ROW
        c = b + _ROW
        value, reach = work[_C + b + _1], work[_T + b + _1]
        n = _common(work[_C + a], value, reach + work[_T + a])
        n = np.int32(n + _common(work[_C + a + _1], value, reach + work[_T + a + _1]))
        n = np.int32(n + _common(work[_C + a + _2], value, reach + work[_T + a + _2]))
        n = np.int32(n + _common(work[_C + b], value, reach + work[_T + b]))
        n = np.int32(n + _common(work[_C + b + _2], value, reach + work[_T + b + _2]))
        n = np.int32(n + _common(work[_C + c], value, reach + work[_T + c]))
        n = np.int32(n + _common(work[_C + c + _1], value, reach + work[_T + c + _1]))
        number[i] = np.int32(n + _common(work[_C + c + _2], value, reach + work[_T + c + _2]))


@njit(cache=True, nogil=True, forceinline=True)
def _common(other: float, value: float, reach: float) -> Any:
    return _KEPT_BIT if abs(other - value) <= reach else _NONE


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _filter(work: Floats, slot: int, begin: int, end: int, words: Any, kinds: Any, rules: Floats) -> None:
    """Take the medians of a row, run by run of blocks of the same kind."""
    _sort_blocks(words, slot, begin // 8, (end + 7) // 8, rules[3] >= _ZERO, kinds)
    block, stop = begin // 8, (end + 7) // 8
    while block < stop:
        kind, first = kinds[block], block
        block += 1
        while block < stop and kinds[block] == kind:
            block += 1
        start, number = _U((slot - 1) * _PITCH + RIM - 1 + 8 * first), _U(min(8 * block, end) - 8 * first)
        if kind == _PLAIN:
            _plain_median(work, start, number)
        elif kind == _GENERAL:
            _median(work, start, number, rules[2], rules[3])


@njit(cache=True, nogil=True, forceinline=True)
def _sort_blocks(words: Any, slot: int, first: int, stop: int, whole: bool, kinds: Any) -> None:
    """Say of each block whether no median matters, all neighbours are common, or anything else.

    Eight flags of eight pixels are one word, so that the last pixel of the block before is its highest byte.
    """
    above, here, below, kind = words[slot - 1, first:], words[slot, first:], words[slot + 1, first:], kinds[first:]
    for b in range(stop - first):
        left, right = above[b] | here[b] | below[b], above[b + 2] | here[b + 2] | below[b + 2]
        near = (above[b + 1] | here[b + 1] | below[b + 1]) & _ALL_NEARER
        wanted = ((near | (left & _LAST_NEARER) | (right & _FIRST_NEARER)) != _NO) & ((here[b + 1] & _ALL_KEPT) != _NO)
        left, right = above[b] & here[b] & below[b] & _LAST_KEPT, above[b + 2] & here[b + 2] & below[b + 2] & _1
        complete = (above[b + 1] & here[b + 1] & below[b + 1] & _ALL_KEPT) == _ALL_KEPT
        complete &= (left != _NO) & (right != _NO) & ((here[b + 1] & _ALL_COMMON_BITS) == _ALL_COMMON_BITS) & whole
        kind[b] = (_PLAIN if complete else _GENERAL) if wanted else _NO


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _plain_median(work: Floats, start: Any, number: Any) -> None:
    """Take the median of nine pixels that all take part."""
    for i in range(number):
        a = start + _U(i)
        b = a + _ROW
        c = b + _ROW
        v0, v1, v2 = work[_K + a], work[_K + a + _1], work[_K + a + _2]
        v3, v4, v5 = work[_K + b], work[_K + b + _1], work[_K + b + _2]
        v6, v7, v8 = work[_K + c], work[_K + c + _1], work[_K + c + _2]
        uneven = (v0 - v8) * (v0 - v8) + (v1 - v7) * (v1 - v7)
        uneven += (v2 - v6) * (v2 - v6) + (v3 - v5) * (v3 - v5)
        weight = work[_W + b + _1] + (work[_W + a] + work[_W + c + _2]) + (work[_W + a + _1] + work[_W + c + _1])
        weight += (work[_W + a + _2] + work[_W + c]) + (work[_W + b] + work[_W + b + _2])
        precision = weight / _NINE
        steep = _QUARTER * uneven * precision * precision - _TWO
        work[_C + b + _1] = middle(v0, v1, v2, v3, v4, v5, v6, v7, v8)
        work[_S + b + _1] = np.sqrt(V9 + RISE9 * steep / (steep + HALF9)) / precision


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _median(work: Floats, start: Any, number: Any, in_row: Any, off_row: Any) -> None:
    """Take the median of the pairs of common neighbours; a pair that takes no part is -huge and +huge (`median`)."""
    for i in range(number):
        a = start + _U(i)
        b = a + _ROW
        c = b + _ROW
        v0, v1, v2 = work[_K + a], work[_K + a + _1], work[_K + a + _2]
        v3, v4, v5 = work[_K + b], work[_K + b + _1], work[_K + b + _2]
        v6, v7, v8 = work[_K + c], work[_K + c + _1], work[_K + c + _2]
        here, reach, beside = v4 == v4, work[_T + b + _1] + in_row, work[_T + b + _1] + off_row
        p = both(v0, v8, v4, beside + work[_T + a], beside + work[_T + c + _2])
        q = both(v1, v7, v4, beside + work[_T + a + _1], beside + work[_T + c + _1])
        r = both(v2, v6, v4, beside + work[_T + a + _2], beside + work[_T + c])
        s = both(v3, v5, v4, reach + work[_T + b], reach + work[_T + b + _2])
        taken = _ONE + ((_TWO if p else _ZERO) + (_TWO if q else _ZERO))
        taken += (_TWO if r else _ZERO) + (_TWO if s else _ZERO)
        weight = work[_W + b + _1] + (work[_W + a] + work[_W + c + _2] if p else _ZERO)
        weight += work[_W + a + _1] + work[_W + c + _1] if q else _ZERO
        third = work[_W + a + _2] + work[_W + c] if r else _ZERO
        weight += third + (work[_W + b] + work[_W + b + _2] if s else _ZERO)
        uneven = uneven_part(p, v0, v8) + uneven_part(q, v1, v7)
        uneven += uneven_part(r, v2, v6) + uneven_part(s, v3, v5)
        v0, v8 = (v0 if p else -_HUGE), (v8 if p else _HUGE)
        v1, v7 = (v1 if q else -_HUGE), (v7 if q else _HUGE)
        v2, v6 = (v2 if r else -_HUGE), (v6 if r else _HUGE)
        v3, v5 = (v3 if s else -_HUGE), (v5 if s else _HUGE)
        precision = weight / taken if here else _ONE
        steep = uneven * precision * precision - _QUARTER * (taken - _ONE)  # less what noise makes of it
        noise = np.sqrt(variance_of_median(taken, steep)) / precision
        work[_C + b + _1] = middle(v0, v1, v2, v3, v4, v5, v6, v7, v8) if here else work[_C + b + _1]
        work[_S + b + _1] = noise if here else work[_S + b + _1]


@njit(cache=True, nogil=True, forceinline=True)
def _cut(
    why: Ints, limits: Floats, rules: Floats, y: int, rows: Floats, slot: int, begin: int, end: int, codes: Ints,
    images: Floats, reason: Ints,
) -> None:  # fmt: skip
    """Lay the filtered pixels over the row and refuse those that see the floor or lie outside the area of interest."""
    value, sigma, code = rows[_CAME, slot, begin + RIM :], rows[_SIGMA, slot, begin + RIM :], codes[slot, begin:]
    out, spread = images[0, y, begin:], images[1, y, begin:]
    for x in range(end - begin):
        out[x] = value[x] if value[x] == value[x] else out[x]
    for x in range(end - begin):
        spread[x] = sigma[x]
    old, new, factor = why[y, begin:], reason[y, begin:], rules[4]
    floor, near, far = limits[FLOOR, y, begin:], limits[NEAR, y, begin:], limits[FAR, y, begin:]
    for x in range(end - begin):
        first = _NONE if (value[x] >= near[x]) & (value[x] <= far[x]) else _OUTSIDE
        first = _FLOOR if value[x] + factor * sigma[x] > floor[x] else first
        judged = code[x] & _CODE
        first = judged if judged != _NONE else first
        new[x] = old[x] if old[x] != 0 else first


@njit(cache=True, nogil=True, forceinline=True)
def _pass_on(planes: Any, why: Ints, y: int, images: Floats, reason: Ints) -> None:
    """Let a row leave as it came."""
    range_m, sigma_m, _ = planes
    for x in range(why.shape[1]):
        images[0, y, x] = range_m[y, x]
    for x in range(why.shape[1]):
        images[1, y, x] = sigma_m[y, x]
    for x in range(why.shape[1]):
        reason[y, x] = why[y, x]
