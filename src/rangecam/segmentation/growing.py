"""Region growing: neighbours of similar range belong to one object."""

import numpy as np
from numba import njit

from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage


def region_growing(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Grow objects over neighbouring pixels whose range is near the object's mean: labels (H, W) int32.

    The image is scanned from its first corner; each valid pixel without an object starts one, which takes in the
    neighbours of its pixels, first come first looked at, as long as |range - mean range| stays below a threshold
    (König 2008, 6.3; the mean runs as in eq 6.11). Labels 1..N in the order of the scan.
    """
    range_m, sigma_m = (np.ascontiguousarray(plane, np.float32) for plane in (image.range_m, image.sigma_m))
    labels = np.empty(image.shape, np.int32)
    steps = _STEPS[: settings.connectivity]
    thresholds = settings.growing_threshold_m, settings.growing_threshold_sigmas, settings.growing_step_m
    _grow((range_m, sigma_m, image.why), steps, thresholds, settings.min_pixels, labels)
    return labels


_STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)])


@njit(cache=True, nogil=True)
def _grow(
    planes: tuple[Floats, Floats, Ints],
    steps: Ints,
    thresholds: tuple[float, float, float],
    min_pixels: int,
    labels: Ints,
) -> None:
    range_m, sigma_m, why = planes
    absolute, per_sigma, step = thresholds
    height, width = labels.shape
    for row in range(height):
        for column in range(width):
            labels[row, column] = -1 if why[row, column] == 0 else 0  # -1: valid, without an object yet
    members = np.empty(height * width, np.int32)
    label = 0
    for start in range(height * width):
        if labels[start // width, start % width] != -1:
            continue
        label += 1
        labels[start // width, start % width] = label
        members[0], count, done = start, 1, 0
        mean = float(range_m[start // width, start % width])
        while done < count:
            row, column = members[done] // width, members[done] % width
            done += 1
            for k in range(len(steps)):
                i, j = row + steps[k, 0], column + steps[k, 1]
                if i < 0 or i >= height or j < 0 or j >= width or labels[i, j] != -1:
                    continue
                near_mean = abs(range_m[i, j] - mean) < absolute + per_sigma * sigma_m[i, j]
                if near_mean or abs(range_m[i, j] - range_m[row, column]) < step:
                    labels[i, j] = label
                    members[count] = i * width + j
                    count += 1
                    mean += (range_m[i, j] - mean) / count  # eq 6.11
        if count < min_pixels:
            for k in range(count):
                labels[members[k] // width, members[k] % width] = 0
            label -= 1
