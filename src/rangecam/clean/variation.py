"""Total variation: the image closest to what was measured whose neighbours differ little, and its sigma."""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from scipy.ndimage import map_coordinates, uniform_filter

from rangecam.clean.neighbours import RIM, Kept
from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints

_SWEEPS = 12
_GRID = 48


def total_variation(kept: Kept, settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the image of least total variation near the measured one, and its sigma: (H, W) float32 m each.

    u minimises sum (u - v)^2 / (2 sigma^2) + strength sum h(|u_i - u_j| / s), over pixels and over pairs of common
    neighbours above, below and beside each other (Steinbäck 2016, eq 2.12, with everything in units of the noise, so
    that one strength fits all). h is the absolute value, rounded below one sigma (Huber): it would make stairs of
    slopes. A pixel is linked to a pair of common neighbours or to none (see `filters`), so that edges stay as high.
    sigma by linear propagation: a link below one sigma conducts noise, one above does not (its pull is constant); a
    pixel's variance is that of an endless image that conducts everywhere as it does around the pixel, times the share
    of links that conduct there: noise that gets to a neighbour must get on from it.
    """
    result = kept.range_m.copy()
    along, linked = np.zeros((2, 2, *result.shape), np.float32)
    precision = np.full(result.shape, 0, np.float32)
    _minimise(kept.why, kept.around, np.float32(settings.total_variation), result, (linked, along), precision)
    table, top = _variance(settings.total_variation)
    there, conducting = (uniform_filter(links, (0, 5, 5), mode="nearest") for links in (linked, along))
    along *= conducting / np.maximum(there, 1e-6)
    place = np.sqrt(np.minimum(along, top) / top) * (_GRID - 1)
    factor = map_coordinates(table, place.reshape(2, -1), order=1).reshape(result.shape)
    with np.errstate(divide="ignore"):
        sigma_m = np.where(kept.why == 0, np.sqrt(factor / precision), kept.sigma_m)
    return result, sigma_m.astype(np.float32)


def white_noise_variance(across: Floats, down: Floats) -> Floats:
    """Return what is left of white noise of variance 1 in u - across u'' - down u'' = v, with differences for u''.

    The mean of 1 / (1 + 2 across (1 - cos a) + 2 down (1 - cos b))^2 over all frequencies a and b; across, down (N,).
    """
    cosines = 2 - 2 * np.cos(np.pi * (np.arange(96) + 0.5) / 96)
    response = 1 / (1 + across[:, None, None] * cosines[:, None] + down[:, None, None] * cosines)
    left: Floats = np.mean(response**2, axis=(1, 2))
    return left


@lru_cache(maxsize=4)
def _variance(strength: float) -> tuple[Floats, float]:
    """Return `white_noise_variance` on a grid of roots of conductances up to a top, and the top."""
    top = 4 * strength
    steps = np.linspace(0, 1, _GRID) ** 2 * top
    rows = [white_noise_variance(np.full(_GRID, across), steps) for across in steps]
    return np.stack(rows), top


@njit(cache=True, nogil=True, error_model="numpy")
def _minimise(why: Ints, around: Floats, strength: Any, u: Floats, links: Any, precision: Floats) -> None:
    """Sweep over red and black pixels in turn (Gauss-Seidel, conductances from the last values)."""
    height, width = why.shape
    for sweep in range(2 * _SWEEPS + 1):
        last = sweep == 2 * _SWEEPS
        for y in range(height):
            step = 1 if last else 2
            for x in range(0 if last else (y + sweep) % 2, width, step):
                if why[y, x] == 0:
                    _relax(why, around, strength, u, links, precision, y, x, last)


@njit(cache=True, nogil=True, error_model="numpy")
def _relax(
    why: Ints, around: Floats, strength: Any, u: Floats, links: Any, precision: Floats, y: int, x: int, last: bool
) -> None:
    value, own = around[0, y + RIM, x + RIM], around[2, y + RIM, x + RIM] ** 2
    pulled, weight, information, linked = own * value, own, own, 1
    for axis in range(2):
        i, j = (0, 1) if axis == 0 else (1, 0)
        links_all, conducts = 0.0, 0.0
        if _common(around, y, x, -i, -j) and _common(around, y, x, i, j):
            for side in (-1, 1):
                other, theirs = u[y + side * i, x + side * j], around[2, y + RIM + side * i, x + RIM + side * j] ** 2
                between = 2 * own * theirs / (own + theirs)  # over the mean of the variances
                apart = abs(other - u[y, x]) * np.sqrt(between)
                pull = strength * between * (1 / apart if apart > 1 else 1.0)
                pulled, weight = pulled + pull * other, weight + pull
                information, linked = information + theirs, linked + 1
                links_all += strength * between / own
                conducts += strength * between / own if apart <= 1 else 0.0
        if last:
            links[0][axis, y, x], links[1][axis, y, x] = links_all / 2, conducts / 2
    if last:
        precision[y, x] = information / linked
    else:
        u[y, x] = pulled / weight


@njit(cache=True, nogil=True)
def _common(around: Floats, y: int, x: int, down: int, right: int) -> bool:
    """Return whether a neighbour is there and common."""
    i, j = y + RIM, x + RIM
    apart = abs(around[0, i + down, j + right] - around[0, i, j])
    return bool(apart <= around[1, i, j] + around[1, i + down, j + right])
