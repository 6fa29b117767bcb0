"""From measured to true range: one curve for the camera, then a line for each pixel (König 2008, 4.3.2).

The thesis fits a line to the quotient of each pixel. As the measured range is a linear function of the quotient, so
slope and intercept of the range are those of the quotient in other units. Where soft edges bend the quotient, the bend
is that of pulse and shutter, which all pixels share: a curve of few parameters, found by all of them together.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.errors import DataError
from rangecam.types import Floats, RangeImage, Why

_OUT_OF_RANGE = np.uint8(Why.OUT_OF_RANGE)
_POINTS = 129
_LEAST_SLOPE = 0.2
_LARGEST_DEGREE = 3
_MOST_POINTS_IN_FIT = 200_000


class Plane(NamedTuple):
    """What many images of one plane target say of each pixel: all (H, W).

    known_m: true range. measured_m: weighted mean of the valid ranges. weight: sum of their 1 / sigma2, 0 for a pixel
    that was valid in less than half of the images: which of its values are missing depends on their noise.
    """

    known_m: Floats
    measured_m: Floats
    weight: Floats


class Line(NamedTuple):
    """true range = slope curve(measured) + intercept_m of each pixel (H, W)."""

    slope: Floats
    intercept_m: Floats


Curve = tuple[tuple[float, float], ...]
"""Points (measured, true), m, both increasing; empty: nothing to bend."""


def mean_plane(images: Iterable[RangeImage], known_m: Floats | float) -> Plane:
    """Return what images (at least one) of a target at `known_m` (H, W) say; raises DataError if there are none."""
    total, weighted, valid, count = np.zeros(()), np.zeros(()), np.zeros(()), 0
    for image in images:
        ok = image.valid
        weight = np.where(ok, 1 / np.where(ok, image.sigma_m, 1.0).astype(np.float64) ** 2, 0.0)
        weighted = weighted + weight * np.where(ok, image.range_m, 0.0)
        total, valid, count = total + weight, valid + ok, count + 1
    if not count:
        raise DataError("no images of the target: at least one is needed")
    weight = np.where(valid >= count / 2, total, 0.0)
    return Plane(np.broadcast_to(known_m, total.shape), weighted / np.where(total > 0, total, 1.0), weight)


def fit_curve(planes: Sequence[Plane], least_slope: float = _LEAST_SLOPE) -> Curve:
    """Return the curve from measured to true range that all pixels share, as points to interpolate between.

    The measured range is fitted over the known one, which has no noise, by a cubic spline with as many parameters as
    there are planes, and tabulated in the interval around the middle plane in which it grows by at least `least_slope`
    per metre: elsewhere its inverse would multiply noise and drift, or have two answers. Where it grows up to the first
    or last plane, half the way to the next one is added, straight. Raises DataError for fewer than four planes, or a
    measured range that grows nowhere.
    """
    from scipy.interpolate import make_lsq_spline

    seen = [plane for plane in planes if (plane.weight > 0).any()]
    centres = sorted(float(np.median(plane.known_m[plane.weight > 0])) for plane in seen)
    if len({round(centre, 6) for centre in centres}) < _LARGEST_DEGREE + 1:
        raise DataError(
            f"{len(seen)} plane targets with valid pixels; a curve needs at least {_LARGEST_DEGREE + 1} at different "
            "ranges"
        )
    known, measured, weight = (
        np.concatenate([np.asarray(getattr(plane, name))[plane.weight > 0] for plane in seen])
        for name in ("known_m", "measured_m", "weight")
    )
    order = np.argsort(known, kind="stable")[:: max(1, len(known) // _MOST_POINTS_IN_FIT)]
    known, measured, weight = known[order], measured[order], weight[order]
    distinct = np.array(sorted({round(centre, 6) for centre in centres}))
    ends = [known[0]] * (_LARGEST_DEGREE + 1), [known[-1]] * (_LARGEST_DEGREE + 1)
    inner = distinct[2:-2]
    knots = np.concatenate([ends[0], inner[(inner > known[0]) & (inner < known[-1])], ends[1]])
    spline = make_lsq_spline(known, measured, knots, _LARGEST_DEGREE, w=np.sqrt(weight / weight.max()))
    true_m = np.linspace(known[0], known[-1], _POINTS)
    inside = _around(spline.derivative()(true_m) >= least_slope, int(np.searchsorted(true_m, np.median(distinct))))
    if not inside.any():
        raise DataError(f"the measured range does not grow by {least_slope:g} m a metre around {true_m.mean():.3g} m")
    points = np.column_stack([spline(true_m), true_m])[inside]
    before, after = (distinct[1] - distinct[0]) / 2 * inside[0], (distinct[-1] - distinct[-2]) / 2 * inside[-1]
    slopes = spline.derivative()(points[[0, -1], 1])
    if before:
        points = np.concatenate([points[:1] - before * np.array([[slopes[0], 1.0]]), points])
    if after:
        points = np.concatenate([points, points[-1:] + after * np.array([[slopes[1], 1.0]])])
    return tuple((x, y) for x, y in points.round(6).tolist())


def _around(good: NDArray[np.bool_], middle: int) -> NDArray[np.bool_]:
    """Return the longest run of True that holds the place `middle`."""
    bad = np.flatnonzero(~good)
    first = bad[bad <= middle].max(initial=-1) + 1
    last = bad[bad >= middle].min(initial=len(good))
    run: NDArray[np.bool_] = (np.arange(len(good)) >= first) & (np.arange(len(good)) < last)
    return run


def fit_range(planes: Sequence[Plane], curve: Curve = ()) -> Line:
    """Return the line of each pixel from its measured range, once through the curve, to the true one.

    The measured range is fitted over the known one, by weight, and the line inverted (K-CAL-03). Measured ranges beyond
    the ends of the curve count nothing. Raises DataError if a pixel was not seen at two ranges, or its range does not
    grow.
    """
    known = np.stack([plane.known_m for plane in planes])
    measured = np.stack([plane.measured_m for plane in planes])
    weight = np.stack([plane.weight for plane in planes])
    if curve:
        x, y = np.array(curve).T
        inside = (measured >= x[0]) & (measured <= x[-1])
        slope = (np.diff(y) / np.diff(x))[np.searchsorted(x, measured).clip(1, len(x) - 1) - 1]
        weight = np.where(inside, weight / slope**2, 0.0)
        measured = np.interp(measured, x, y)
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1.0)
    mean_known, mean_measured = (weight * known).sum(axis=0) / safe, (weight * measured).sum(axis=0) / safe
    spread = (weight * (known - mean_known) ** 2).sum(axis=0)
    seen = spread > 1e-12 * total
    gain = (weight * (known - mean_known) * (measured - mean_measured)).sum(axis=0) / np.where(seen, spread, 1.0)
    bad = np.argwhere(~seen | (gain <= 0))
    if len(bad):
        row, column = bad[0]
        raise DataError(
            f"{len(bad)} pixels, the first in row {row}, column {column}, have no line from measured to true range: "
            "each must be valid at two ranges or more, and measure the farther one as farther"
        )
    return Line(1 / gain, mean_known - mean_measured / gain)


def apply_curve(image: RangeImage, points: Floats, line: Line, margin_sigmas: float) -> RangeImage:
    """Return the image with true ranges: through the curve of the camera, then along the line of each pixel.

    points (N, 2): those of a `Curve`, none for a straight one. sigma_m grows with the slopes of both. A pixel whose
    measured range is not `margin_sigmas` of its standard deviations within the curve is OUT_OF_RANGE: there nobody
    knows what it means.
    """
    shape, single = image.shape, np.float32
    range_m, sigma_m, why = np.empty(shape, single), np.empty(shape, single), image.why.copy()
    slope, intercept_m = (np.ascontiguousarray(each, np.float64) for each in line)
    _bend(image.range_m, image.sigma_m, points, slope, intercept_m, margin_sigmas, range_m, sigma_m, why)
    return RangeImage(image.time_s, range_m, sigma_m, image.amplitude, why)


@njit(cache=True, nogil=True, error_model="numpy")
def _bend(
    measured_m: Any,
    deviation_m: Any,
    points: Any,
    slope: Any,
    intercept_m: Any,
    margin: Any,
    range_m: Any,
    sigma_m: Any,
    why: Any,
) -> Any:
    """Fill range_m and sigma_m and complete why; NaN stays NaN."""
    measured_m, deviation_m, slope, intercept_m = (
        measured_m.reshape(-1),
        deviation_m.reshape(-1),
        slope.reshape(-1),
        intercept_m.reshape(-1),
    )
    range_m, sigma_m, why = range_m.reshape(-1), sigma_m.reshape(-1), why.reshape(-1)
    last = len(points) - 1
    for i in range(measured_m.size):
        x, sigma = np.float64(measured_m[i]), np.float64(deviation_m[i])
        if last > 0:
            low, high = 0, last
            while high - low > 1:
                middle = (low + high) // 2
                if points[middle, 0] <= x:
                    low = middle
                else:
                    high = middle
            inside = (x - margin * sigma >= points[0, 0]) & (x + margin * sigma <= points[last, 0])
            if why[i] == 0 and not inside:
                why[i] = _OUT_OF_RANGE
            steep = (points[low + 1, 1] - points[low, 1]) / (points[low + 1, 0] - points[low, 0])
            x, sigma = points[low, 1] + steep * (x - points[low, 0]), steep * sigma
        range_m[i] = slope[i] * x + intercept_m[i]
        sigma_m[i] = slope[i] * sigma
