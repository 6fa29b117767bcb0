"""Segmentation by the histogram of distances: what lies between two minima is one object."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.errors import DataError
from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage

MAX_BINS = 10_000
"""Most bins that a histogram may need before it is taken for a mistake in the data or the bin width."""


def range_histogram(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Cut the distances of the valid pixels at minima of their histogram: labels (H, W) int32, nearest first.

    The histogram is smoothed, minima and very small bins are possible borders, and borders must keep objects with
    enough pixels, a high enough peak and clear, similar minima apart (Steinbäck 2016, 3.5.3, 4.5.3, eq 2.13; eq 2.14
    corrected, E-S-11). Objects at the same distance become one (S-SEG-04), unless a gap of `max_gap_m` across is
    between them. Raises DataError if the distances spread over more than `MAX_BINS` bins.
    """
    distance = points[..., 0] if settings.histogram_of == "depth" else image.range_m
    labels, values = np.zeros(image.shape, np.int32), np.empty(distance.size, np.float32)
    places = np.empty(distance.size, np.int32)
    number, low, high = _gather(distance, image.why, values, places)
    if low > high:
        return labels
    bins = math.floor((high - low) / settings.bin_width_m) + 1
    if not bins <= MAX_BINS:
        raise DataError(
            f"valid distances from {low:.3g} to {high:.3g} m need {bins} bins of {settings.bin_width_m} m; "
            f"at most {MAX_BINS}: check the data, or set segments.bin_width_m"
        )
    _label(values, places, number, low, bins, _criteria(settings), labels)
    if settings.max_gap_m is not None:
        _part(labels, np.ascontiguousarray(points, np.float32), settings.max_gap_m, settings.min_pixels)
    return labels


@lru_cache(maxsize=16)
def _criteria(settings: SegmentSettings) -> Floats:
    """Return what the kernels need of the settings, in their order."""
    half = settings.smoothing_bins // 2
    limits = settings.min_pixels, settings.min_peak, settings.max_valley_to_peak, settings.max_valley_difference
    return np.array([settings.bin_width_m, half, settings.small_bin, *limits], float)


@njit(cache=True, nogil=True)
def _gather(distance: Floats, why: Ints, values: Floats, places: Ints) -> tuple[int, float, float]:
    """List the distances of valid pixels and where they are; return their number, the least and the greatest."""
    height, width = why.shape
    number, low, high = 0, np.inf, -np.inf
    for row in range(height):
        least = np.uint8(255)
        for column in range(width):
            least = min(least, why[row, column])
        if least > 0:
            continue
        for column in range(width):
            if why[row, column] == 0:
                value = float(distance[row, column])
                if not math.isfinite(value):
                    continue
                low, high = (value if value < low else low), (value if value > high else high)
                values[number], places[number] = value, row * width + column
                number += 1
    return number, low, high


@njit(cache=True, nogil=True)
def _label(values: Any, places: Any, number: Any, low: Any, bins: Any, criteria: Any, labels: Any) -> Any:
    """Give each listed pixel the label of its bin."""
    counts, label_of_bin, flat = np.zeros(bins, np.int64), np.zeros(bins, np.int32), labels.reshape(-1)
    bin_of = np.empty(number, np.int32)
    for i in range(number):
        bin_of[i] = int((values[i] - low) / criteria[0])
        counts[bin_of[i]] += 1
    _divide(counts, criteria, label_of_bin)
    for i in range(number):
        flat[places[i]] = label_of_bin[bin_of[i]]


@njit(cache=True, nogil=True)
def _part(labels: Any, points: Any, gap_m: float, min_pixels: int) -> None:
    """Give what lies beside each other, farther apart than the gap, labels of its own, from left to right, in place."""
    height, width = labels.shape
    count = 0
    for row in range(height):
        for column in range(width):
            count = max(count, labels[row, column])
    most, least = np.full((count + 1, width), -np.inf), np.full((count + 1, width), np.inf)
    pixels, part = np.zeros((count + 1, width), np.int64), np.zeros((count + 1, width), np.int32)
    for row in range(height):
        for column in range(width):
            label, y = labels[row, column], points[row, column, 1]
            if label > 0:
                pixels[label, column] += 1
                most[label, column], least[label, column] = max(most[label, column], y), min(least[label, column], y)
    number = 0
    for label in range(1, count + 1):
        first, end, total = 0, np.inf, 0
        for column in range(width + 1):
            parted = column == width or (pixels[label, column] > 0 and most[label, column] < end - gap_m)
            if parted and total > 0:
                number += total >= min_pixels
                part[label, first:column] = number if total >= min_pixels else 0
            if parted:
                first, end, total = column, np.inf, 0
            if column < width and pixels[label, column] > 0:
                end, total = min(end, least[label, column]), total + pixels[label, column]
    for row in range(height):
        for column in range(width):
            labels[row, column] = part[labels[row, column], column]


@njit(cache=True, nogil=True)
def _divide(counts: Ints, criteria: Floats, labels: Ints) -> None:
    """Number the objects in the runs of bins that are not very small; bins outside the histogram count as empty."""
    half, small, min_pixels, min_peak = int(criteria[1]), criteria[2], criteria[3], criteria[4]
    bins = len(counts)
    smoothed = np.zeros(bins)
    for place in range(bins):
        for other in range(max(0, place - half), min(bins, place + half + 1)):
            smoothed[place] += counts[other] / (2 * half + 1)
    first, label = 0, 0
    while first < bins:
        end = first
        while end < bins and smoothed[end] > small:
            end += 1
        if end > first:
            borders = _minima(smoothed, first, end)
            while len(borders) > 2:
                worst = _worst(smoothed, borders, criteria[5], criteria[6])
                if worst < 0:
                    break
                borders.pop(worst)
            for place in range(len(borders) - 1):
                low, high = borders[place], borders[place + 1]
                if counts[low:high].sum() >= min_pixels and smoothed[low:high].max() >= min_peak:
                    label += 1
                    labels[low:high] = label
        first = end + 1


@njit(cache=True, nogil=True)
def _minima(smoothed: Floats, first: int, end: int) -> list[int]:
    """Return the borders of a run: its first bin, the middle of each minimum, the bin after its last.

    A minimum is where the derivative (eq 2.13) rises after the last change before it was a fall (E-S-11).
    """
    borders = [first]
    low = -1  # first bin after the last fall, -1 after a rise or none
    for place in range(first + 1, end):
        derivative = smoothed[place] - smoothed[place - 1]
        if derivative < -_EQUAL:
            low = place
        elif derivative > _EQUAL:
            if low >= 0:
                borders.append((low + place) // 2)
            low = -1
    borders.append(end)
    return borders


_EQUAL = 1e-9  # averages of whole numbers of pixels differ by more than this or by rounding


@njit(cache=True, nogil=True)
def _worst(smoothed: Floats, borders: list[int], max_ratio: float, max_difference: float) -> int:
    """Return the border that separates least, -1 if all separate well enough.

    A border is too weak by how far its minimum exceeds the allowed part of the lower peak beside it, or exceeds the
    minimum on the other side of a peak by more than the allowed part of that peak.
    """
    worst, excess = -1, 0.0
    for place in range(1, len(borders) - 1):
        minimum = smoothed[borders[place]]
        for low, high, other in ((place - 1, place, place - 1), (place, place + 1, place + 1)):
            peak = smoothed[borders[low] : borders[high]].max()
            opposite = smoothed[borders[other]] if 0 < other < len(borders) - 1 else 0.0
            over = max(minimum / peak - max_ratio, (minimum - opposite) / peak - max_difference)
            if over > excess:
                worst, excess = place, over
    return worst
