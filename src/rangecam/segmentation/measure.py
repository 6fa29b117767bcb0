"""Where each segment is, how large, and how surely that is known."""

import numpy as np
from numba import njit

from rangecam.geometry import (
    Lens,
    Mounting,
    angle_sigmas,
    pixel_pitch,
    polar,
    polar_covariance,
    rotation,
    to_camera,
    turn_covariance,
)
from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage, Segments


def measure_segments(
    labels: Ints, points: Floats, image: RangeImage, lens: Lens, mounting: Mounting, settings: SegmentSettings
) -> Segments:
    """Measure every segment of a label image (H, W), 0 for background and 1..N, from the points (H, W, 3) m.

    The position is the plain mean of the points: weights 1/sigma^2 would favour pixels whose noise made them near. Its
    covariance has the noise of the mean range, a part that no number of pixels makes smaller, and the uncertainty of
    the image position (König 2008, 6.4.3.3, E-K-22). Sizes come from the spread of the points, which for a rectangle
    of n pixels is (n^2 - 1)/12 of the pixel's footprint squared, with the noise taken off.
    """
    count = int(labels.max(initial=0))
    sums, bounds, box = np.zeros((count, 10)), np.zeros((count, 6)), np.zeros((count, 4), np.int64)
    planes = tuple(np.ascontiguousarray(plane, np.float32) for plane in (image.range_m, image.sigma_m, image.amplitude))
    near_m = np.zeros(count)
    _sum(labels, points, planes, (sums, bounds, box))
    _nearest(labels, points, (sums, bounds), settings.near_fraction, near_m)
    number = sums[:, 0]
    mean = sums / number[:, None]
    position, range_m, variance, amplitude = mean[:, 1:4], mean[:, 7], mean[:, 8], mean[:, 9]
    sigma_range = np.sqrt(
        variance * np.minimum(settings.shared_noise_pixels / number, 1.0) + settings.sigma_systematic_m**2
    )
    extent = np.stack([box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]], axis=-1)
    # a border of so many pixels on either side; columns are uncertain by the height of the segment, rows by its width
    sigma_px = np.sqrt(settings.sigma_pixel**2 + settings.edge_jitter**2 / (2 * extent))
    in_camera = to_camera(position, mounting)
    azimuth, elevation, radius = polar(in_camera)
    angles = angle_sigmas(in_camera, sigma_px, lens, image.shape)
    covariance = turn_covariance(polar_covariance(azimuth, elevation, radius, (*angles, sigma_range)), mounting)
    footprint = np.array([0.0, *pixel_pitch(lens, image.shape)]) * in_camera[:, :1] @ np.abs(rotation(mounting)).T
    ray = (in_camera / radius[:, None]) @ rotation(mounting).T
    spread = np.maximum(mean[:, 4:7] - position**2 - variance[:, None] * ray**2, 0.0)
    size = np.minimum(np.sqrt(12 * spread + footprint**2), bounds[:, 3:] - bounds[:, :3] + footprint)
    label = np.arange(1, count + 1)
    return Segments(
        label, position, covariance, size, near_m, number.astype(np.int64), box, range_m, sigma_range, amplitude
    )


@njit(cache=True, nogil=True)
def _sum(labels: Ints, points: Floats, planes: tuple[Floats, Floats, Floats], out: tuple[Floats, Floats, Ints]) -> None:
    range_m, sigma_m, amplitude = planes
    sums, bounds, box = out
    bounds[:, :3], bounds[:, 3:] = np.inf, -np.inf
    box[:, :2], box[:, 2:] = max(labels.shape), 0
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            k = labels[row, column] - 1
            if k < 0:
                continue
            sums[k, 0] += 1
            for axis in range(3):
                value = float(points[row, column, axis])
                sums[k, 1 + axis] += value
                sums[k, 4 + axis] += value * value
                bounds[k, axis] = min(bounds[k, axis], value)
                bounds[k, 3 + axis] = max(bounds[k, 3 + axis], value)
            sums[k, 7] += range_m[row, column]
            sums[k, 8] += float(sigma_m[row, column]) ** 2
            sums[k, 9] += amplitude[row, column]
            box[k, 0], box[k, 1] = min(box[k, 0], row), min(box[k, 1], column)
            box[k, 2], box[k, 3] = max(box[k, 2], row + 1), max(box[k, 3], column + 1)


@njit(cache=True, nogil=True)
def _nearest(labels: Ints, points: Floats, known: tuple[Floats, Floats], fraction: float, near_m: Floats) -> None:
    """Find the x of which only a fraction of each segment's pixels is nearer, by a histogram of x."""
    sums, bounds = known
    counts = np.zeros((len(near_m), _NEAR_BINS), np.int64)
    per_metre = np.empty(len(near_m))
    for k in range(len(near_m)):
        width = bounds[k, 3] - bounds[k, 0]
        per_metre[k] = (_NEAR_BINS - 1e-3) / width if width > 0 else 0.0
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            k = labels[row, column] - 1
            if k >= 0:
                counts[k, int((points[row, column, 0] - bounds[k, 0]) * per_metre[k])] += 1
    for k in range(len(near_m)):
        near_m[k] = bounds[k, 0]
        wanted, before = fraction * sums[k, 0], 0
        for place in range(_NEAR_BINS):
            if before + counts[k, place] >= wanted:
                if per_metre[k] > 0:
                    near_m[k] += (place + (wanted - before) / counts[k, place]) / per_metre[k]
                break
            before += counts[k, place]


_NEAR_BINS = 32
