"""Wiggling found from ranges that are known: planes at known distances, or another instrument beside the camera."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rangecam.cw.wiggling import BASES
from rangecam.errors import DataError
from rangecam.types import Floats, RangeImage

_BINS = 2048
_LEAST_IN_CELL = 8
_LEAST_FOR_PATTERN = 3
_ROUNDS = 4
_OUTLIER = 5.0
_MODEL_ERROR_M = 1e-3
_USUAL = 0.01
"""Of the unambiguous range: the error of square signals is 0.0113 of it (N-S-035)."""


class Errors(NamedTuple):
    """How much too long each pixel (H, W) measured a known range, m, within half an unambiguous range of zero.

    weight: one over the variance of error_m, 0 for a pixel that is no use.
    """

    known_m: Floats
    error_m: Floats
    weight: Floats


class WigglingFit(NamedTuple):
    """The error of the range over the phase, m, and what else images of it say.

    values: (size,) of a table, without its mean, or (size, 2) of harmonics. offset_m: mean error over a whole period.
    before_m, after_m: robust standard deviation over the pixels of the error less `offset_m`, and of what values and
    the pixels' own offsets leave. unseen_m: true ranges of which there was too little, (first, last) each.
    """

    values: Floats
    offset_m: float
    before_m: float
    after_m: float
    unseen_m: list[tuple[float, float]]


def mean_range(images: Iterable[RangeImage], period_m: float) -> tuple[Floats, Floats]:
    """Return the mean range within the unambiguous one, m, and one over its variance, (H, W), of what stands still.

    The mean of the images (one or more) is one of directions, right across the wrap. Pixels that were valid in less
    than half of them have no weight. Raises DataError if there are no images.
    """
    total, weight, valid, count = np.zeros((), complex), np.zeros(()), np.zeros(()), 0
    for image in images:
        ok = image.valid
        of_one = np.where(ok, 1 / np.where(ok, image.sigma_m, 1.0).astype(np.float64) ** 2, 0.0)
        turns = np.where(ok, image.range_m, 0.0) / period_m
        total = total + of_one * np.exp(2j * np.pi * turns)
        weight, valid, count = weight + of_one, valid + ok, count + 1
    if not count:
        raise DataError("no images of something at rest: at least one is needed")
    return np.mod(np.angle(total) / (2 * np.pi), 1.0) * period_m, np.where(valid >= count / 2, weight, 0.0)


def errors_of(measured_m: Floats, weight: Floats, known_m: Floats, period_m: float) -> Errors:
    """Return the errors of mean ranges (H, W) beside known ones; a pixel whose range is not known has no weight."""
    known = np.isfinite(known_m)
    error_m = _wrapped(measured_m - np.where(known, known_m, 0.0), period_m)
    return Errors(np.where(known, known_m, 0.0), error_m, np.where(known, weight, 0.0))


def mean_offset_m(errors: Sequence[Errors], period_m: float) -> float:
    """Return the mean error of all pixels with weight, within half an unambiguous range of zero.

    Raises DataError if no pixel has any.
    """
    total = sum(complex(np.sum(np.sign(e.weight) * np.exp(2j * np.pi * e.error_m / period_m))) for e in errors)
    if not any((e.weight > 0).any() for e in errors):
        raise DataError("no valid pixel at a known range")
    return float(np.angle(total) / (2 * np.pi) * period_m)


def fit_wiggling(
    errors: Sequence[Errors], period_m: float, model: str = "table", size: int = 64, partial: bool = False
) -> WigglingFit:
    """Return the wiggling of one modulation frequency, by least squares of one of `BASES`, robust against outliers.

    Where pixels were seen three times or more their own offsets (fixed pattern) are found beside it and do not count.
    partial: where a scene has not all ranges, those that it has still count, and the values keep to what is usual;
    ranges that it does not have are then corrected by guess. Raises DataError for no valid pixels, and, unless
    `partial`, for a gap: a period in `size` equal parts (of harmonics 2 `size`) needs pixels in each.
    """
    offset_m = mean_offset_m(errors, period_m)
    known, error, weight = (np.stack([np.asarray(getattr(e, name)) for e in errors]) for name in Errors._fields)
    error = _wrapped(error - offset_m, period_m)
    turns = np.mod((known + offset_m + error) / period_m, 1.0)
    weight = np.where(weight > 0, 1 / (1 / np.where(weight > 0, weight, 1.0) + _MODEL_ERROR_M**2), 0.0)
    used = weight > 0
    own: Floats = np.zeros(error.shape[1:])
    fitted: Floats = np.zeros(error.shape)
    unseen = _gaps(turns[used], size if model == "table" else 2 * size, offset_m, period_m)
    if unseen and not partial:
        places = " and ".join(f"{a:.2f} to {b:.2f} m" for a, b in unseen[:4]) + (" and more" if len(unseen) > 4 else "")
        raise DataError(
            f"wiggling has a gap: no target at {places} (modulo {period_m:.2f} m); record planes there, or ask for "
            f"fewer {'values' if model == 'table' else 'harmonics'} than {size}"
        )
    before_m = _spread(error[used])
    often = used.sum(axis=0) >= _LEAST_FOR_PATTERN
    values: Floats = np.zeros(1)
    for _ in range(_ROUNDS):
        values = _least_squares(turns[used], (error - own)[used], weight[used], model, size, period_m, partial)
        fitted[weight > 0] = values[0] + BASES[model](turns[weight > 0], size) @ values[1:]
        share = np.where(used & often, weight, 0.0)
        total = share.sum(axis=0)
        own = (share * (error - fitted)).sum(axis=0) / np.where(total > 0, total, 1.0)
        if (total > 0).any():  # what all pixels have in common is the constant
            own = np.where(total > 0, own - own[total > 0].mean(), 0.0)
        left = error - fitted - own
        used = (weight > 0) & (np.abs(left) <= _OUTLIER * max(_spread(left[weight > 0]), _MODEL_ERROR_M))
    after_m = _spread((error - fitted - own)[weight > 0])
    constant, values = float(values[0]), values[1:]
    if model == "table":
        mean = 0.0 if partial else float(values.mean())
        constant, values = constant + mean, values - mean
    shape = (size,) if model == "table" else (size, 2)
    return WigglingFit(values.reshape(shape), offset_m + constant, before_m, after_m, unseen)


def _least_squares(
    turns: Floats, error: Floats, weight: Floats, model: str, size: int, period_m: float, partial: bool
) -> Floats:
    """Return a constant and the values of the model; pixels of nearly the same phase are averaged before."""
    n = np.minimum((turns * _BINS).astype(int), _BINS - 1)
    total = np.bincount(n, weight, _BINS)
    some = total > 0
    mean_turns, mean_error = (np.bincount(n, weight * each, _BINS)[some] / total[some] for each in (turns, error))
    basis = BASES[model](mean_turns, size)
    # a table can be constant itself
    design = np.column_stack([np.zeros(len(basis)) if model == "table" else np.ones(len(basis)), basis])
    # what a model cannot describe is alike over a 64th of a period, however many pixels show it
    root = np.sqrt(1 / (1 / total[some] + _MODEL_ERROR_M**2 * _BINS / 64))
    rows, target = design * root[:, None], mean_error * root
    prior = np.full(design.shape[1], 1 / (_USUAL * period_m) if partial else 0.0)
    prior[0] = max(prior[0], 1e-6)
    rows, target = np.concatenate([rows, np.diag(prior)]), np.concatenate([target, np.zeros(len(prior))])
    result: Floats = np.linalg.lstsq(rows, target, rcond=None)[0]
    return result


def _gaps(turns: Floats, cells: int, offset_m: float, period_m: float) -> list[tuple[float, float]]:
    """Return the true ranges of parts of a period with hardly a pixel, neighbouring parts together."""
    empty = np.bincount(np.minimum((turns * cells).astype(int), cells - 1), minlength=cells) < _LEAST_IN_CELL
    if empty.all():
        return [(0.0, period_m)]
    first = int(np.argmin(empty))  # a part that was seen, so that no gap goes round the end
    edges = np.diff(np.concatenate([[0], np.roll(empty, -first).astype(int), [0]]))
    starts, ends = np.flatnonzero(edges == 1) + first, np.flatnonzero(edges == -1) + first
    step_m = period_m / cells
    result = []
    for start, end in zip(starts, ends, strict=True):
        near_m = math.fmod(float(start) * step_m - offset_m + 2 * period_m, period_m)
        result.append((near_m, near_m + float(end - start) * step_m))
    return sorted(result)


def _spread(values: Floats) -> float:
    """Return the standard deviation by the median, which outliers do not change."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def _wrapped(values_m: Floats, period_m: float) -> NDArray[np.float64]:
    result: NDArray[np.float64] = np.mod(values_m + period_m / 2, period_m) - period_m / 2
    return result
