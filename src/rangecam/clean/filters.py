"""Filters that lower the noise of an image, with the standard deviation of what they return: `FILTERS`.

All keep one contract. Only pixels that were not refused give and get, only common neighbours of a pixel give to it, and
they give in pairs that lie opposite to each other: where one of a pair is missing, the other would pull the pixel along
an inclined surface. So on every plane, with whatever pixels missing, a filter has no bias.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.clean.median import median
from rangecam.clean.neighbours import RIM, Kept
from rangecam.clean.settings import CleanSettings
from rangecam.clean.variation import total_variation, white_noise_variance
from rangecam.types import Floats, Ints

Filter = Callable[[Kept, CleanSettings], tuple[Floats, Floats]]


def mean(kept: Kept, settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the mean of each pixel and its common neighbours, and its standard deviation: (H, W) float32 m each.

    Steinbäck 2016, eq 2.7, the pixel itself included (E-S-12) and divided by the number that takes part.
    """
    return _averaged(kept, _MEAN_3X1 if settings.window == "3x1" else _MEAN_3X3, 0.0, soft=False)


def bilateral(kept: Kept, settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the average of 5x5 pixels, weighted by distance in the image and in range; sigma: (H, W) float32 m each.

    Steinbäck 2016, eq 2.11, with the difference of values in the second weight (E-S-10): (1 - u^2)^2, where u = 1/2 is
    the difference at which two pixels are no more common neighbours, and get nothing. Steeper weights follow the noise.
    """
    return _averaged(kept, _bell(settings), 0.0, soft=True)


def cross_bilateral(kept: Kept, settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the same as `bilateral`, weighted by the difference of amplitudes, too: (H, W) float32 m each.

    The combined amplitude and distance domain of Steinbäck 2016, 2.3.3, which keeps edges seen in either. Amplitudes
    whose difference is `amplitude_tolerance` of their mean have the weight 0.
    """
    return _averaged(kept, _bell(settings), settings.amplitude_tolerance, soft=True)


_MEAN_3X1 = np.array([[0, 1, 1]], np.float32)
_MEAN_3X3 = np.array([[0, 1, 1], [1, -1, 1], [1, 0, 1], [1, 1, 1]], np.float32)
"""One of each pair of neighbours: rows down, columns to the right, weight."""


@lru_cache(maxsize=16)
def _bell(settings: CleanSettings) -> Floats:
    """Return one of each pair of the 24 neighbours within two pixels, with the weight of its distance."""
    rows, columns = np.mgrid[-RIM : RIM + 1, -RIM : RIM + 1]
    half = (rows > 0) | ((rows == 0) & (columns > 0))
    weight = np.exp(-(rows**2 + columns**2) / (2 * settings.bilateral_sigma_px**2))
    return np.stack([rows[half], columns[half], weight[half]], axis=1).astype(np.float32)


def _averaged(kept: Kept, pairs: Floats, amplitude_tolerance: float, soft: bool) -> tuple[Floats, Floats]:
    """Return the weighted average of each pixel and pairs of its neighbours, and its standard deviation."""
    light = np.pad(kept.amplitude, RIM) if amplitude_tolerance > 0 else np.empty((0, 0), np.float32)
    range_m, sigma_m = kept.range_m.copy(), kept.sigma_m.copy()
    _average(kept.why, kept.around, light, pairs, np.float32(amplitude_tolerance), soft, range_m, sigma_m)
    return range_m, sigma_m


@njit(cache=True, nogil=True, error_model="numpy")
def _average(
    why: Ints, around: Floats, light: Floats, pairs: Floats, contrast: Any, soft: bool, range_m: Floats, sigma_m: Floats
) -> None:
    """Add the weighted pairs to each pixel; sigma by the derivatives of the result with respect to every value.

    With a = v_a - v and b = v_b - v of pair p and w_p its weight, v + e with e = sum w_p (a + b) / S and
    S = 1 + 2 sum w_p comes back. de/dv_a = (w_p + w_p' (a + b - 2 e)) / S, and the pixel has the rest to 1. The weights
    depend on the noise, too; w_p' takes that in (on the safe side, by Poincaré's inequality).
    """
    height, width = why.shape
    total, moved = np.empty(width, np.float32), np.empty(width, np.float32)
    variance, rest = np.empty(width, np.float32), np.empty(width, np.float32)
    zero, half, one, two = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
    for y in range(height):
        total[:], moved[:], variance[:], rest[:] = one, zero, zero, one
        values, reaches, weights = around[0], around[1], around[2]
        for turn in range(2):
            for p in range(len(pairs)):
                down, right, near = int(pairs[p, 0]), int(pairs[p, 1]), pairs[p, 2]
                y0, y1, row = y + RIM - down, y + RIM + down, y + RIM
                for x in range(width):
                    x0, x1, k = x + RIM - right, x + RIM + right, x + RIM
                    v, reach = values[row, k], reaches[row, k]
                    a, b = values[y0, x0] - v, values[y1, x1] - v
                    inverse_a, inverse_b = one / (reach + reaches[y0, x0]), one / (reach + reaches[y1, x1])
                    u_a, u_b = half * a * inverse_a, half * b * inverse_b
                    weight = near if (abs(u_a) <= half) & (abs(u_b) <= half) else zero
                    fall_a, fall_b = one - u_a * u_a, one - u_b * u_b
                    if soft:
                        weight = weight * (fall_a * fall_b) ** 2 if weight > zero else zero
                    if light.size > 0:
                        weight *= _alike(light[row, k], light[y0, x0], contrast)
                        weight *= _alike(light[row, k], light[y1, x1], contrast)
                    both = a + b if weight > zero else zero
                    if turn == 0:
                        total[x] += two * weight
                        moved[x] += weight * both
                        continue
                    of_a, of_b = weight, weight
                    if soft and weight > zero:
                        excess = both - two * moved[x]
                        of_a -= weight * two * u_a * inverse_a / fall_a * excess
                        of_b -= weight * two * u_b * inverse_b / fall_b * excess
                    of_a, of_b = of_a / total[x], of_b / total[x]
                    rest[x] -= of_a + of_b
                    if weight > zero:
                        variance[x] += (of_a / weights[y0, x0]) ** 2 + (of_b / weights[y1, x1]) ** 2
            if turn == 0:
                for x in range(width):
                    moved[x] /= total[x]
        for x in range(width):
            if why[y, x] == 0:
                range_m[y, x] += moved[x]
                sigma_m[y, x] = np.sqrt(variance[x] + (rest[x] * sigma_m[y, x]) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(one: float, other: float, contrast: float) -> Any:
    """Return the weight of two amplitudes; one that is not known is like every other."""
    u = (one - other) / (contrast * np.float32(0.5) * (one + other))
    fall = np.float32(1) - u * u
    fall = fall if fall > 0 else np.float32(0)
    return fall * fall if u == u else np.float32(1)


_MEDIAN_SHARED = {"3x1": 2.6, "3x3": 6.6}
"""Variance of the mean of many medians, times their number, over the variance of one (Monte Carlo)."""


def shared_noise_pixels(settings: CleanSettings) -> float:
    """Return over how many pixels the noise of a clean image is the same, on a plane without invalid pixels.

    The mean of N pixels has the variance sigma^2 times this over N. A filter whose weights sum to 1 leaves the noise of
    the mean as it was, so this is the variance that went in over the one that came out. So also with the average over
    time, where a gain of 1/T leaves 1/(2 T - 1): those who average over images again are told what came in.
    """
    alone = {
        "off": 1.0,
        "median": _MEDIAN_SHARED[settings.window],
        "mean": 3.0 if settings.window == "3x1" else 9.0,
        "bilateral": _shared_by(_bell(settings)),
        "cross_bilateral": _shared_by(_bell(settings)),
        "total_variation": _shared_by_variation(settings.total_variation),
    }[settings.filter]
    return alone * (2 * settings.temporal_frames - 1)


def _shared_by(pairs: Floats) -> float:
    weight = pairs[:, 2]
    return float((1 + 2 * weight.sum()) ** 2 / (1 + 2 * (weight**2).sum()))


def _shared_by_variation(strength: float) -> float:
    one = np.array([strength])
    return float(1 / white_noise_variance(one, one)[0])


FILTERS: dict[str, Filter] = {
    "median": median,
    "mean": mean,
    "bilateral": bilateral,
    "cross_bilateral": cross_bilateral,
    "total_variation": total_variation,
}
"""Filters by name: (`Kept`, settings) -> range and its standard deviation, both new arrays."""
