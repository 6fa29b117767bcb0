"""The noise of a camera from what it recorded: the straight line of variance over light, or over accumulations."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rangecam.errors import DataError
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


def fit_noise(light: Floats, variance: Floats, frames: int, rounding: float = 1 / 12) -> NoiseFit:
    """Return the line of the variance of a sample over the light in it.

    light, variance (N,): mean without what a sample is without light, and variance over time, of each sample of
    `frames` frames, none near saturation. rounding: the part of the variance that comes from rounding. Robust: the
    samples are sorted by light into bins, of which the median counts, and only bins whose quartiles are those of noise,
    and bins off the line count less, so that what flickers or moves does not decide. Raises DataError for too few
    samples or levels, or a line that falls.
    """
    ok = np.isfinite(light) & np.isfinite(variance) & (light > -_DARK_COUNTS)
    light, variance = light[ok].astype(np.float64), variance[ok].astype(np.float64)
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
            y.append(middle / of_median - rounding)
            # the median of M values is 1.25 times as uncertain as their mean; and no camera follows its model better
            error.append(middle * np.hypot(1.25 * np.sqrt(2 / freedom / inside.sum()), _MODEL_ERROR))
    if len(x) < 3:
        raise DataError(f"light at {len(x)} levels with {_LEAST_IN_BIN} samples or more; three are needed for a line")
    fit = fit_line(np.array(x), np.array(y), np.array(error))
    if fit.slope <= 0 or fit.base <= 0:
        raise DataError(f"the variance does not grow with the light: {fit.base:.3g} + {fit.slope:.3g} per count")
    return fit


def fit_line(x: Floats, y: Floats, error: Floats) -> NoiseFit:
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
