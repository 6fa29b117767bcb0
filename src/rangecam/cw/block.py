"""The memory in which several frequencies are decoded: a few columns of some rows, small enough for the nearest cache.

Everything lies in two kinds of record of fixed lengths. The compiler thus knows how far apart all arrays are, sees that
they do not overlap, and makes vector instructions of loops over many of them at once.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

INNER = 128
"""Columns that are decoded at a time."""
RIM = 4
"""Columns beside these on either side of which filters need the phasors; two would do, four keep whole vectors."""
WIDTH = INNER + 2 * RIM

_FLOAT, _WHOLE = np.float32, np.int32
_NAN = np.float32(np.nan)


@lru_cache(maxsize=32)
def record_types(n_frequencies: int, n_planes: int) -> tuple[np.dtype[Any], np.dtype[Any]]:
    """Return the types of a row of phasors, and of everything else that the kernels hand on.

    A row: cosine and sine of each phase, amplitude, variance across the phasor, LSB2; sums over the frequencies of the
    variance of the phase (rad2, NaN where a pixel cannot be used), of the amplitude and of the variance; what is wrong.
    The block: samples; sums of phasors, how many and what variance are in them, and who took part; phases in turns with
    one over their variance; parts of the unwrapping; results.
    """
    many = (n_frequencies, WIDTH)
    row: list[tuple[str, Any, tuple[int, ...]]] = []
    row += [(name, _FLOAT, many) for name in ("cosine", "sine", "amplitude", "variance")]
    row += [(name, _FLOAT, (WIDTH,)) for name in ("spread", "total", "strewn")]
    block: list[tuple[str, Any, tuple[int, ...]]] = []
    block += [("samples", _FLOAT, (n_planes, WIDTH)), ("take", _FLOAT, (5, INNER)), ("kept", _FLOAT, (2, 3, INNER))]
    several = ("real", "imaginary", "cycles", "certainty", "apart", "pull")
    block += [(name, _FLOAT, (n_frequencies, INNER)) for name in several]
    single = ("count", "strewn", "inverse", "noise", "range_m", "sigma_m", "mean_amplitude")
    block += [(name, _FLOAT, (INNER,)) for name in single]
    reasons = [(name, _WHOLE, (INNER,)) for name in ("why", "judged", "decided")]
    return np.dtype([*row, ("why", _WHOLE, (WIDTH,))]), np.dtype([*block, *reasons])


@njit(cache=True, nogil=True)
def load(planes: Any, y: int, column: int, block: Any) -> None:
    """Fill the samples of a row from a column on; beyond the image with those at its border."""
    samples, width = block["samples"], planes[0].shape[1]
    first, last = max(0, -column), min(WIDTH, width - column)
    for p in range(len(planes)):
        source, target = planes[p][y, column + first : column + last], samples[p, first:last]
        for i in range(source.size):
            target[i] = np.float32(source[i])
        for i in range(first):
            samples[p, i] = target[0]
        for i in range(last, WIDTH):
            samples[p, i] = target[-1]


@njit(cache=True, nogil=True)
def blind(row: Any, first: int, last: int) -> None:
    """Let pixels of a row from first to before last take no part in any mean."""
    row["spread"][max(first, 0) : max(last, 0)] = _NAN


@njit(cache=True, nogil=True)
def store(block: Any, y: int, column: int, images: Any, why: Any) -> None:
    """Write the results into the images range, sigma and amplitude (3, H, W), and why."""
    n = min(INNER, why.shape[1] - column)
    place = slice(column, column + n)
    _copy(block["range_m"], images[0, y, place])
    _copy(block["sigma_m"], images[1, y, place])
    _copy(block["mean_amplitude"], images[2, y, place])
    decided, reasons = block["decided"], why[y, place]
    for i in range(n):
        reasons[i] = np.uint8(decided[i])


@njit(cache=True, nogil=True)
def store_phases(block: Any, y: int, column: int, turns: Any) -> None:
    """Write phases and one over their variance (2, H, K, W), for those who look at neighbours afterwards."""
    place = slice(column, min(column + INNER, turns.shape[3]))
    for k in range(turns.shape[2]):
        _copy(block["cycles"][k], turns[0, y, k, place])
        _copy(block["certainty"][k], turns[1, y, k, place])


@njit(cache=True, nogil=True)
def _copy(source: Any, target: Any) -> None:
    for i in range(target.size):
        target[i] = source[i]
