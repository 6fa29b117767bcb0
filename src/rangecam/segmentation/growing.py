"""Region growing: neighbours of similar range belong to one object."""

from functools import lru_cache

import numpy as np
from numba import njit

from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage


def region_growing(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Grow objects over neighbouring pixels whose range is near the object's mean: labels (H, W) int32.

    The image is scanned from its first corner; each valid pixel without an object starts one, which takes in the
    neighbours of its pixels, first come first looked at, as long as |range - mean range| stays below a threshold
    (König 2008, 6.3; the mean runs as in eq 6.11). Labels 1..N in the order of the scan. The points are not needed.
    """
    steps, labels = _steps(image.shape[1] + 2, settings.connectivity), np.empty(image.shape, np.int32)
    range_m, sigma_m = (np.ascontiguousarray(plane, np.float32) for plane in (image.range_m, image.sigma_m))
    thresholds = settings.growing_threshold_m, settings.growing_threshold_sigmas, settings.growing_step_m
    _grow((range_m, sigma_m, np.ascontiguousarray(image.why)), steps, thresholds, settings.min_pixels, labels)
    return labels


@lru_cache(maxsize=16)
def _steps(row: int, connectivity: int) -> Ints:
    """Return how far the neighbours of a pixel are in a flat image with rows of this length."""
    return np.array((1, row, -1, -row, row + 1, row - 1, -row - 1, -row + 1)[:connectivity], np.int32)


@njit(cache=True, nogil=True)
def _grow(
    planes: tuple[Floats, Floats, Ints],
    steps: Ints,
    thresholds: tuple[float, float, float],
    min_pixels: int,
    labels: Ints,
) -> None:
    """Work on flat copies with a rim of background, in which every neighbour is one fixed step away."""
    range_m, sigma_m, why = planes
    height, width = labels.shape
    row = width + 2
    label_of = np.zeros((height + 2) * row, np.int32)
    value, reach = np.empty(len(label_of), np.float32), np.empty(len(label_of), np.float32)
    for y in range(height):
        first = (y + 1) * row + 1
        for x in range(width):
            label_of[first + x] = -1 if why[y, x] == 0 else 0  # -1: valid, without an object yet
            value[first + x] = range_m[y, x]
            reach[first + x] = thresholds[0] + thresholds[1] * sigma_m[y, x]
    members = np.empty(height * width, np.int32)
    label = 1
    for start in range(row, len(label_of)):
        if label_of[start] == -1:
            count = _grow_one(start, label, steps, thresholds[2], (label_of, value, reach), members)
            if count >= min_pixels:
                label += 1
            else:
                for k in range(count):
                    label_of[members[k]] = 0
    for y in range(height):
        first = (y + 1) * row + 1
        for x in range(width):
            labels[y, x] = label_of[first + x]


@njit(cache=True, nogil=True)
def _grow_one(
    start: int, label: int, steps: Ints, step_m: float, known: tuple[Ints, Floats, Floats], members: Ints
) -> int:
    """Give the label to the object that begins at `start`, list its pixels and return their number."""
    label_of, value, reach = known
    label_of[start] = label
    members[0] = start
    count, done = 1, 0
    mean = float(value[start])
    while done < count:
        pixel = members[done]
        done += 1
        for step in steps:
            other = pixel + step
            if label_of[other] == -1:
                near_mean = abs(value[other] - mean) < reach[other]
                if near_mean or abs(value[other] - value[pixel]) < step_m:
                    label_of[other] = label
                    members[count] = other
                    count += 1
                    mean += (value[other] - mean) / count  # eq 6.11
    return count
