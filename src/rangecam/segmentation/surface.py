"""How the surface of a segment is bent: a wall is flat, a trunk is round, a person is neither."""

import math
from typing import Any

import numpy as np
from numba import njit

_MOST = 400  # pixels of a segment that are looked at: the fit is no better for more
_TERMS = 5
_RIDGE = 1e-3  # on squares of metres: what few pixels do not tell is zero


@njit(cache=True, nogil=True, error_model="numpy")
def surface_shape(labels: Any, points: Any, light: Any, sums: Any, box: Any, surface: Any) -> None:
    """Write the `surface` of `Segments` (N, 8); a kernel. light: range and amplitude (H, W); sums (N, 10) of points.

    A parabola is fitted to the inner pixels of a segment, those whose four neighbours belong to it as well: distance
    along the line of sight over places across and up (m) from the middle, d = c0 + c1 u + c2 v + c3 u^2 + c4 v^2, by
    least squares. The same is fitted to their light, amplitude times squared range, as a share of its mean: where a
    surface turns away from us it sends less back (Lambert). At the edges of a segment pixels are mixed, or torn by what
    moves. Of large segments every second, third, ... row and column is looked at.
    """
    range_m, amplitude = light
    moments, told = np.empty((_TERMS, _TERMS)), np.empty((_TERMS, 2))
    term = np.ones(_TERMS)
    for k in range(len(box)):
        number = sums[k, 0]
        x, y, z = sums[k, 1] / number, sums[k, 2] / number, sums[k, 3] / number
        away = max(math.sqrt(x * x + y * y), 1e-6)
        cosine, sine = x / away, y / away
        stride = math.ceil(math.sqrt(number / _MOST))
        moments[:], told[:] = 0.0, 0.0
        first_row = box[k, 0] + (box[k, 2] - box[k, 0] - 1) % stride // 2
        first_column = box[k, 1] + (box[k, 3] - box[k, 1] - 1) % stride // 2
        looked, inner, squares, pieces, lines, total = 0, 0, 0.0, 0, 0, 0.0
        for row in range(first_row, box[k, 2], stride):
            lines += 1
            before = False
            for column in range(box[k, 1], box[k, 3]):
                own = labels[row, column] == k + 1
                pieces += own and not before
                before = own
                if not own or (column - first_column) % stride:
                    continue
                looked += 1
                if not _inner(labels, row, column):
                    continue
                ahead, beside = float(points[row, column, 0]), float(points[row, column, 1])
                u, v = beside * cosine - ahead * sine, float(points[row, column, 2]) - z
                d = ahead * cosine + beside * sine - away
                distance = float(range_m[row, column])
                sent = float(amplitude[row, column]) * distance * distance
                term[1], term[2], term[3], term[4] = u, v, u * u, v * v
                for a in range(_TERMS):
                    told[a, 0] += term[a] * d
                    told[a, 1] += term[a] * sent
                    for b in range(a + 1):
                        moments[a, b] += term[a] * term[b]
                inner, squares, total = inner + 1, squares + d * d, total + sent
        least = squares - _solve(moments, told)
        surface[k, 0] = math.sqrt(max(least, 0.0) / max(inner - _TERMS, 1))
        for a in range(1, _TERMS):
            surface[k, a] = told[a, 0]
        shade = told[3, 1] * inner / total if total > 0.0 else 0.0
        surface[k, 5] = shade if math.isfinite(shade) else 0.0  # an amplitude may be missing
        surface[k, 6], surface[k, 7] = inner / max(looked, 1), pieces / lines


@njit(cache=True, nogil=True, forceinline=True)
def _inner(labels: Any, row: int, column: int) -> bool:
    """Return whether the four neighbours of a pixel are of its segment; an edge of the image is none of a segment."""
    height, width = labels.shape
    own, above, below = labels[row, column], max(row - 1, 0), min(row + 1, height - 1)
    if labels[above, column] != own or labels[below, column] != own:
        return False
    return bool(labels[row, max(column - 1, 0)] == own and labels[row, min(column + 1, width - 1)] == own)


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy")
def _solve(moments: Any, told: Any) -> float:
    """Replace the right sides by the solutions of `moments` (lower half) c = `told`; return what the first explains.

    moments is positive definite: its Cholesky factor replaces it. With L z = t, what a fit explains of the squares is
    the sum of z^2.
    """
    explained = 0.0
    for a in range(_TERMS):
        moments[a, a] += _RIDGE
        for b in range(a + 1):
            left = moments[a, b]
            for c in range(b):
                left -= moments[a, c] * moments[b, c]
            moments[a, b] = math.sqrt(left) if a == b else left / moments[b, b]
        for side in range(2):
            for c in range(a):
                told[a, side] -= moments[a, c] * told[c, side]
            told[a, side] /= moments[a, a]
        explained += told[a, 0] * told[a, 0]
    for a in range(_TERMS - 1, -1, -1):
        for side in range(2):
            for c in range(a + 1, _TERMS):
                told[a, side] -= moments[c, a] * told[c, side]
            told[a, side] /= moments[a, a]
    return explained
