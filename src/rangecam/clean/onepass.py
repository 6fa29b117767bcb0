"""Judging, median and cutting in one pass over the rows: what `judge`, `median` and `cut` do one after the other.

Most of the time goes into moving images and into medians nobody asked for. So a few rows are kept at hand, and blocks
of eight pixels are told apart: those in which every pixel will be refused as floor are left alone, those in which all
neighbours of all pixels are common get the plain median of nine, and only the rest the general one.

The rows lie in one array at distances known to the compiler, and its indices have no sign: only then does a loop over
eight pixels become vector instructions without questions about overlap, which would cost more than the loop. The parts
are laid into one function (`forceinline`), because handing a dozen arrays to each of them costs as much as they do.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from rangecam.clean.limits import REFUSE
from rangecam.clean.median import HALF9, RISE9, V9, both, middle, uneven_part, variance_of_median, window_rules
from rangecam.clean.neighbours import RIM, singles, tolerance_rules
from rangecam.clean.settings import CleanSettings
from rangecam.compiled import kernel
from rangecam.types import Floats, Ints, Why

_WEAKEST, _WRAPS, _NEAREST, _SEEN, _ENTRY, _EXIT, _NEEDED = (np.uint64(plane) for plane in range(7))
"""Planes of limits: least amplitude, least amplitude times squared range, farthest range of the floor in 3x3 pixels,
range of the floor, entry into the area of interest, exit; then three rows of common neighbours needed: in the first
row, in any between, in the last one. Behind them are `_RULES` numbers: the reach of a pixel (a constant and a factor of
its sigma), what the window adds to it in the same row and in others, and the sigmas of the floor."""
_RULES = 5

_LOW_AMPLITUDE, _WRAPPED, _ISOLATED, _BORDER, _FLOOR, _OUTSIDE, _NONE = (
    np.int32(code)
    for code in (Why.LOW_AMPLITUDE, Why.WRAPPED, Why.ISOLATED, Why.BORDER, Why.FLOOR, Why.OUTSIDE_AREA, 0)
)
_ZERO, _ONE, _TWO, _QUARTER, _NINE, _HUGE, _NAN, _REFUSE = singles(0, 1, 2, 0.25, 9, 3e38, np.nan, REFUSE)

_PITCH, _SLOTS = 1048, 8  # pixels from row to row, and rows; together within the cache, and apart in it
_CAME, _REACH, _KEPT, _WEIGHT, _SIGMA, _REASON, _FLAGS, _PLANES = range(8)
WIDEST = _PITCH - 2 * RIM
"""Columns of the widest image that fits."""
_U = np.uint64
_C, _T, _K, _W, _S, _R, _F = (_U(plane * _SLOTS * _PITCH) for plane in range(_PLANES))
_ROW, _RIM, _NO, _1, _2, _8 = _U(_PITCH), _U(RIM), _U(0), _U(1), _U(2), _U(8)
_PLAIN, _GENERAL = _1, _2

_WORDS = _U(WIDEST // 8 + 3)  # a word of eight flags from row to row, with one before and one behind the image
_KEPT_BIT, _NEARER_BITS, _COMMON_BIT, _EIGHT = (np.int32(bits) for bits in (1, 3, 4, 8))
"""Flags of a pixel: not refused, nearer than the floor around it (and kept), all neighbours common."""
_ALL_KEPT, _ALL_NEARER, _ALL_COMMON_BITS = (_U(bit * 0x0101010101010101) for bit in (1, 2, 4))
_LAST_KEPT, _LAST_NEARER, _FIRST_NEARER = _U(1 << 56), _U(2 << 56), _U(2)


def clean_in_one_pass(
    planes: tuple[Floats, Floats, Floats], why: Ints, limits: Floats
) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """Return range and sigma after the median and why after the cut: (H, W) float32 m each and uint8.

    planes: range, sigma and amplitude; limits: from `limits_in_one`. At most `WIDEST` columns.
    """
    images, reason = np.empty((2, *why.shape), np.float32), np.empty(why.shape, np.uint8)
    _clean(*planes, why, limits, images, reason)  # a tuple would take longer to be handed over
    return images[0], images[1], reason


def limits_in_one(
    amplitudes: tuple[Floats, Floats],
    needed: Ints,
    floor: Floats,
    area: tuple[Floats, Floats],
    settings: CleanSettings,
) -> Floats:
    """Return all that the kernel needs to know in one array, which is handed over sooner: (6 H W + 3 W + 5,) float32.

    amplitudes: the least, alone and times squared range; area: entry and exit; all (H, W). See `_WEAKEST` and so on.
    """
    farthest = maximum_filter(floor, 3, mode="nearest")
    rows = needed[[0, len(needed) // 2, -1]]
    rules = np.array([*tolerance_rules(settings), *window_rules(settings), settings.floor_margin_sigmas])
    planes = [plane.ravel() for plane in (*amplitudes, farthest, floor, *area, rows, rules)]
    return np.concatenate(planes, dtype=np.float32)


@kernel(error_model="numpy")
def _clean(
    range_m: Floats, sigma_m: Floats, amplitude: Floats, why: Ints, limits: Floats, images: Floats, reason: Ints
) -> None:
    """Let row after row come, judge the row before it, and filter and cut the one before that.

    Medians take the place of what came: nobody asks for it any more by then.
    """
    height, width, size = why.shape[0], _U(why.shape[1]), _U(why.size)
    range_m, sigma_m, amplitude, why = range_m.reshape(-1), sigma_m.reshape(-1), amplitude.reshape(-1), why.reshape(-1)
    images, reason = images.reshape(-1), reason.reshape(-1)
    rules = limits[limits.size - _RULES :]
    work = np.empty(_PLANES * _SLOTS * _PITCH, np.float32)
    flags = np.zeros(_U(8 * _SLOTS) * _WORDS, np.uint8)
    codes, words, kinds = work.view(np.int32), flags.view(np.uint64), np.empty(_WORDS, np.uint64)
    for row in range(_U(_SLOTS)):
        _blank(work, _U(row) * _ROW, width + _2 * _RIM)
    slot, begin, end, begin_before, end_before = _2, _NO, _NO, _NO, _NO
    for y in range(height + 2):
        slot += _1
        if slot == _U(_SLOTS):
            _begin_again(work, words, width + _2 * _RIM)
            slot = _U(3)
        at, first, last = slot * _ROW + _RIM, _NO, _NO
        if y < height:
            first, last = _span(why, _U(y) * width, width)
        if last > first:
            _come(range_m, sigma_m, why, _U(y) * width, width, rules, work, at)
        else:
            _blank(work, at, width)
        at -= _ROW
        for b in range(_WORDS):
            words[(slot - _1) * _WORDS + _U(b)] = _NO
        if end > begin:
            here, needed = _U(y - 1) * width, _NEEDED * size + (_NO if y == 1 else _2 * width if y == height else width)
            _judge(sigma_m, amplitude, limits, here, size, needed, work, codes, at, begin, end)
            _surround(work, at, begin, end, width)
            _pack(codes, at, begin, end, flags, _8 * ((slot - _1) * _WORDS + _1))
        at -= _ROW
        if end_before > begin_before:
            _sort_blocks(words, slot - _2, begin_before // _8, (end_before + _U(7)) // _8, rules[3] >= _ZERO, kinds)
            _filter(limits, _U(y - 2) * width, size, work, codes, at, begin_before, end_before, kinds, rules)
            _leave(range_m, sigma_m, why, work, codes, at, _U(y - 2) * width, width, size, images, reason)
        elif y > 1:
            _pass_on(range_m, sigma_m, why, _U(y - 2) * width, width, size, images, reason)
        begin_before, end_before, begin, end = begin, end, first, last


@kernel(forceinline=True)
def _blank(work: Floats, start: Any, number: Any) -> None:
    """Let nothing be there; what a comparison with it adds to the reach does not matter."""
    for i in range(number):
        work[_C + start + _U(i)] = _NAN
        work[_K + start + _U(i)] = _NAN


@kernel(forceinline=True)
def _begin_again(work: Floats, words: Any, number: Any) -> None:
    """Move what is still needed of the last three rows to the first slots."""
    shift = _U(_SLOTS - 3) * _ROW
    for i in range(number):
        a = _U(i)
        b, c = a + _ROW, a + _2 * _ROW
        work[_K + a], work[_T + a], work[_W + a] = work[_K + shift + a], work[_T + shift + a], work[_W + shift + a]
        work[_K + b], work[_T + b], work[_W + b] = work[_K + shift + b], work[_T + shift + b], work[_W + shift + b]
        work[_C + b], work[_S + b], work[_R + b] = work[_C + shift + b], work[_S + shift + b], work[_R + shift + b]
        work[_C + c], work[_T + c], work[_K + c] = work[_C + shift + c], work[_T + shift + c], work[_K + shift + c]
    for word in range(_2 * _WORDS):
        words[word] = words[_U(_SLOTS - 3) * _WORDS + _U(word)]


@kernel(forceinline=True)
def _span(why: Ints, here: Any, width: Any) -> Any:
    """Return where a row begins and ends to be valid, in whole blocks; twice zero if it never does."""
    least = np.uint8(255)
    for i in range(width):
        least = min(least, why[here + _U(i)])
    if least > 0:
        return _NO, _NO
    begin, end = _NO, width
    while why[here + begin] != 0:
        begin += _1
    while why[here + end - _1] != 0:
        end -= _1
    return begin // _8 * _8, min((end + _U(7)) // _8 * _8, width)


@kernel(forceinline=True, error_model="numpy")
def _come(
    range_m: Floats, sigma_m: Floats, why: Ints, here: Any, width: Any, rules: Floats, work: Floats, at: Any
) -> None:
    """Lay a row into its slot, invalid pixels as NaN."""
    constant, factor = rules[0], rules[1]
    for i in range(width):
        a, b = here + _U(i), at + _U(i)
        came = range_m[a]
        work[_C + b] = came if why[a] == 0 else _NAN
        work[_T + b] = constant + factor * sigma_m[a]


@kernel(forceinline=True)
def _surround(work: Floats, at: Any, begin: Any, end: Any, width: Any) -> None:
    """Let nothing be kept before and behind the judged part of a row."""
    for i in range(begin):
        work[_K + at + _U(i)] = _NAN
    for i in range(width - end):
        work[_K + at + end + _U(i)] = _NAN


@kernel(forceinline=True)
def _pack(codes: Ints, at: Any, begin: Any, end: Any, flags: Ints, place: Any) -> None:
    """Put the flags of a row together, eight in a word."""
    for i in range(end - begin):
        flags[place + begin + _U(i)] = codes[_F + at + begin + _U(i)]


@kernel(forceinline=True)
def _leave(
    range_m: Floats, sigma_m: Floats, why: Ints, work: Floats, codes: Ints, at: Any, here: Any, width: Any, size: Any,
    images: Floats, reason: Ints,
) -> None:  # fmt: skip
    """Let a row leave; where it came invalid it is what it was."""
    for i in range(width):
        a, b = here + _U(i), at + _U(i)
        was, code, value, sigma = np.int32(why[a]), codes[_R + b], work[_C + b], work[_S + b]
        range_before, sigma_before = range_m[a], sigma_m[a]
        images[a] = value if was == _NONE else range_before
        images[size + a] = sigma if was == _NONE else sigma_before
        reason[a] = code if was == _NONE else was


@kernel(forceinline=True)
def _pass_on(
    range_m: Floats, sigma_m: Floats, why: Ints, here: Any, width: Any, size: Any, images: Floats, reason: Ints
) -> None:
    """Let a row leave as it came."""
    for i in range(width):
        images[here + _U(i)] = range_m[here + _U(i)]
    for i in range(width):
        images[size + here + _U(i)] = sigma_m[here + _U(i)]
    for i in range(width):
        reason[here + _U(i)] = why[here + _U(i)]


@kernel(forceinline=True, error_model="numpy")
def _judge(
    sigma_m: Floats, amplitude: Floats, limits: Floats, here: Any, size: Any, needed: Any, work: Floats, codes: Ints,
    at: Any, begin: Any, end: Any,
) -> None:  # fmt: skip
    """Say what is kept, its weight and flags; call the rest by its reason, and what is kept FLOOR until it is cut."""
    for i in range(end - begin):
        x = begin + _U(i)
        b = at + x
        a, c, p = b - _ROW, b + _ROW, here + x
        value, reach, sigma = work[_C + b], work[_T + b], sigma_m[p]
        n = _common(work[_C + a - _1], value, reach + work[_T + a - _1])
        n = np.int32(n + _common(work[_C + a], value, reach + work[_T + a]))
        n = np.int32(n + _common(work[_C + a + _1], value, reach + work[_T + a + _1]))
        n = np.int32(n + _common(work[_C + b - _1], value, reach + work[_T + b - _1]))
        n = np.int32(n + _common(work[_C + b + _1], value, reach + work[_T + b + _1]))
        n = np.int32(n + _common(work[_C + c - _1], value, reach + work[_T + c - _1]))
        n = np.int32(n + _common(work[_C + c], value, reach + work[_T + c]))
        n = np.int32(n + _common(work[_C + c + _1], value, reach + work[_T + c + _1]))
        light, need = amplitude[p], limits[needed + x]
        first = _ISOLATED if np.float32(n) < need else _FLOOR
        first = _BORDER if need == _REFUSE else first
        first = _WRAPPED if light * value * value < limits[_WRAPS * size + p] else first
        first = _LOW_AMPLITUDE if light < limits[_WEAKEST * size + p] else first
        kept = value if first == _FLOOR else _NAN
        nearest = limits[_NEAREST * size + p]
        bits = _NEARER_BITS if kept <= nearest else _KEPT_BIT
        bits = np.int32(bits + _COMMON_BIT) if n == _EIGHT else bits
        work[_K + b], work[_W + b], work[_S + b] = kept, _ONE / sigma, sigma
        codes[_F + b] = bits if kept == kept else _NONE
        codes[_R + b] = first


@kernel(forceinline=True)
def _common(other: float, value: float, reach: float) -> Any:
    return _KEPT_BIT if abs(other - value) <= reach else _NONE


@kernel(forceinline=True, error_model="numpy")
def _filter(
    limits: Floats, here: Any, size: Any, work: Floats, codes: Ints, at: Any, begin: Any, end: Any, kinds: Any,
    rules: Floats,
) -> None:  # fmt: skip
    """Take the medians of a row and cut it, run by run of blocks of the same kind."""
    block, stop = begin // _8, (end + _U(7)) // _8
    wanted, unwanted = stop, block
    while block < stop:
        kind, first = kinds[block], block
        block += _1
        while block < stop and kinds[block] == kind:
            block += _1
        x = _8 * first
        number = min(_8 * block, end) - x
        if kind == _PLAIN:
            _plain_median(work, at - _ROW + x - _1, number)
        elif kind == _GENERAL:
            _median(work, at - _ROW + x - _1, number, rules[2], rules[3])
        if kind != _NO:
            wanted, unwanted = min(wanted, first), block
    if unwanted > wanted:
        x = _8 * wanted
        _cut(limits, rules[4], here + x, size, work, codes, at + x, min(_8 * unwanted, end) - x)


@kernel(forceinline=True)
def _sort_blocks(words: Any, slot: Any, first: Any, stop: Any, whole: bool, kinds: Any) -> None:
    """Say of each block whether no median matters, all neighbours are common, or anything else.

    Eight flags of eight pixels are one word, so that the last pixel of the block before is its highest byte.
    """
    for k in range(stop - first):
        b = slot * _WORDS + first + _U(k)
        a, c = b - _WORDS, b + _WORDS
        left, right = words[a] | words[b] | words[c], words[a + _2] | words[b + _2] | words[c + _2]
        near = (words[a + _1] | words[b + _1] | words[c + _1]) & _ALL_NEARER
        wanted = ((near | (left & _LAST_NEARER) | (right & _FIRST_NEARER)) != _NO) & (
            (words[b + _1] & _ALL_KEPT) != _NO
        )
        left, right = words[a] & words[b] & words[c] & _LAST_KEPT, words[a + _2] & words[b + _2] & words[c + _2] & _1
        complete = (words[a + _1] & words[b + _1] & words[c + _1] & _ALL_KEPT) == _ALL_KEPT
        complete &= (left != _NO) & (right != _NO) & ((words[b + _1] & _ALL_COMMON_BITS) == _ALL_COMMON_BITS) & whole
        kinds[first + _U(k)] = (_PLAIN if complete else _GENERAL) if wanted else _NO


@kernel(forceinline=True, error_model="numpy")
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


@kernel(forceinline=True, error_model="numpy")
def _median(work: Floats, start: Any, number: Any, in_row: Any, off_row: Any) -> None:
    """Take the median of the pairs of common neighbours; a pair that takes no part is -huge and +huge (`median`)."""
    for i in range(number):
        a = start + _U(i)
        b = a + _ROW
        c = b + _ROW
        v0, v1, v2 = work[_K + a], work[_K + a + _1], work[_K + a + _2]
        v3, v4, v5 = work[_K + b], work[_K + b + _1], work[_K + b + _2]
        v6, v7, v8 = work[_K + c], work[_K + c + _1], work[_K + c + _2]
        reach, beside = work[_T + b + _1] + in_row, work[_T + b + _1] + off_row
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
        precision = weight / taken
        steep = uneven * precision * precision - _QUARTER * (taken - _ONE)  # less what noise makes of it
        noise = np.sqrt(variance_of_median(taken, steep)) / precision
        here, value, sigma = v4 == v4, work[_C + b + _1], work[_S + b + _1]
        work[_C + b + _1] = middle(v0, v1, v2, v3, v4, v5, v6, v7, v8) if here else value
        work[_S + b + _1] = noise if here else sigma


@kernel(forceinline=True)
def _cut(limits: Floats, factor: Any, here: Any, size: Any, work: Floats, codes: Ints, at: Any, number: Any) -> None:
    """Refuse filtered pixels that see the floor or lie outside the area of interest."""
    for i in range(number):
        p, b = here + _U(i), at + _U(i)
        value, kept, before = work[_C + b], work[_K + b], codes[_R + b]
        inside = (value >= limits[_ENTRY * size + p]) & (value <= limits[_EXIT * size + p])
        first = _NONE if inside else _OUTSIDE
        first = _FLOOR if value + factor * work[_S + b] > limits[_SEEN * size + p] else first
        codes[_R + b] = first if kept == kept else before
