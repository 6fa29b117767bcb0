"""The noise model of a pulsed camera, fitted to what it recorded: variance over accumulations, or over signal."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from rangecam.errors import DataError
from rangecam.pulsed.pixel import damping, step_v
from rangecam.pulsed.settings import Pixel
from rangecam.types import Floats

_BINS, _LEAST_IN_BIN = 40, 50
_DARK_COUNTS = 5.0
_LARGEST_QUARTILES = 2.0
"""Upper over lower quartile of the variances in a bin, of 30 frames each: 1.4 for nothing but noise."""
_MODEL_ERROR = 0.02
_HUBER = 2.0


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A straight line variance = base + slope x, fitted by weight, and the points that it goes through, (N,) each.

    x: accumulations, or counts of light. variance: V2 or counts2, of one read-out, without the rounding. error: one
    standard deviation of each. base_error, slope_error: of the line.
    """

    x: Floats
    variance: Floats
    error: Floats
    base: float
    slope: float
    base_error: float
    slope_error: float


def fit_dark_noise(accumulations: ArrayLike, variance_v2: ArrayLike, count: ArrayLike, pixel: Pixel) -> NoiseFit:
    """Return the line whose slope is sigma_S2 and whose base is sigma_R2 (König 2008, eq 4.21).

    accumulations, variance_v2, count (K,): numbers of pulses, the variance of a dark value over time at each, and how
    many values it was taken from. The noise is damped as the signal is, so the variances are divided by d2 before the
    fit (4.2.3.1; E-K-10), after that of the converter's rounding has been taken off. Raises DataError for fewer than
    two numbers of accumulations, or a line without positive parameters.
    """
    n, variance, values = (np.asarray(each, np.float64) for each in (accumulations, variance_v2, count))
    if len(n) < 2:
        raise DataError(f"dark frames of {len(n)} number of accumulations; two or more tell sigma_S from sigma_R")
    undamped = (variance - step_v(pixel) ** 2 / 12) / damping(n, pixel) ** 2
    error = variance * np.sqrt(2 / values) / damping(n, pixel) ** 2
    fit = _line(n, undamped, error)
    if fit.slope <= 0 or fit.base <= 0:
        raise DataError(
            f"dark noise of {', '.join(f'{v:.3g} V2 at n = {i:g}' for i, v in zip(n, variance, strict=True))} does not "
            "grow with the accumulations as n sigma_S2 + sigma_R2"
        )
    return fit


def fit_tap_noise(light_counts: Floats, variance_counts2: Floats, frames: int) -> NoiseFit:
    """Return the line of the variance of a tap over the light in it.

    light_counts, variance_counts2 (N,): mean without the dark image, and variance over time, of each sample of `frames`
    frames, none near saturation. Robust: the samples are sorted by light into bins, of which the median counts, and
    only bins whose quartiles are those of noise, and bins off the line count less, so that what flickers or moves does
    not decide. Raises DataError for too few samples or levels, or a line that falls.
    """
    ok = np.isfinite(light_counts) & np.isfinite(variance_counts2) & (light_counts > -_DARK_COUNTS)
    light, variance = light_counts[ok].astype(np.float64), variance_counts2[ok].astype(np.float64)
    if len(light) < 3 * _LEAST_IN_BIN or frames < 2:
        raise DataError(f"{len(light)} samples of {frames} frames: too few to tell how their variance grows with light")
    edges = np.concatenate([[-_DARK_COUNTS], np.geomspace(_DARK_COUNTS, max(light.max(), 2 * _DARK_COUNTS), _BINS)])
    freedom = frames - 1
    of_median = (1 - 2 / (9 * freedom)) ** 3  # median over mean of the chi-square distribution (Wilson-Hilferty)
    x, y, error = [], [], []
    for low, high in pairwise(edges.tolist()):
        inside = (light >= low) & (light < high)
        if inside.sum() < _LEAST_IN_BIN:
            continue
        lower, middle, upper = np.percentile(variance[inside], [25, 50, 75])
        if upper <= _LARGEST_QUARTILES ** np.sqrt(29 / freedom) * lower:
            x.append(float(np.median(light[inside])))
            y.append(middle / of_median - 1 / 12)
            # the median of M values is 1.25 times as uncertain as their mean; and no camera follows its model better
            error.append(middle * np.hypot(1.25 * np.sqrt(2 / freedom / inside.sum()), _MODEL_ERROR))
    if len(x) < 3:
        raise DataError(f"light at {len(x)} levels with {_LEAST_IN_BIN} samples or more; three are needed for a line")
    fit = _line(np.array(x), np.array(y), np.array(error))
    if fit.slope <= 0 or fit.base <= 0:
        raise DataError(f"the variance does not grow with the light: {fit.base:.3g} + {fit.slope:.3g} per count")
    return fit


def _line(x: Floats, y: Floats, error: Floats) -> NoiseFit:
    """Return the line by 1 / error2, points beyond two errors counting as absolute deviations (Huber).

    Its own errors grow with what it does not explain.
    """
    design = np.column_stack([np.ones_like(x), x]) / error[:, None]
    target, weight = y / error, np.ones_like(x)
    for _ in range(50):
        covariance = np.linalg.inv(design.T @ (weight[:, None] * design))
        line = covariance @ design.T @ (weight * target)
        off = np.abs(target - design @ line)
        weight = np.minimum(1.0, _HUBER / np.maximum(off, 1e-12))
    excess = float(np.sum(weight * off**2)) / max(len(x) - 2, 1)
    base_error, slope_error = np.sqrt(np.diag(covariance) * max(excess, 1.0))
    return NoiseFit(x, y, error, float(line[0]), float(line[1]), float(base_error), float(slope_error))
