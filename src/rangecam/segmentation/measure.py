"""Where each segment is, how large, and how surely that is known."""

import math

import numpy as np
from numba import njit

from rangecam.geometry import Lens, Mounting, pixel_pitch, point_covariance, position, rotation
from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage, Segments


def measure_segments(
    labels: Ints, points: Floats, image: RangeImage, lens: Lens, mounting: Mounting, settings: SegmentSettings
) -> Segments:
    """Measure every segment of a label image (H, W), 0 for background and 1..N, from the points (H, W, 3) m.

    The position is the plain mean of the points: weights 1/sigma^2 would favour pixels whose noise made them near. Its
    covariance holds the noise of the mean range, a part that no number of pixels makes smaller, and the uncertainty of
    the image position (König 2008, 6.4.3.3, E-K-22). Sizes come from the spread of the points: n pixels in a row have a
    variance of (n^2 - 1)/12 footprints^2, so 12 variances plus one footprint^2, less the noise, is the width squared.
    """
    count = int(labels.max(initial=0))
    range_m, sigma_m, amplitude = (
        np.ascontiguousarray(plane, np.float32) for plane in (image.range_m, image.sigma_m, image.amplitude)
    )
    sums, bounds, box = np.zeros((count, 10)), np.empty((count, 6), np.float32), np.empty((count, 4), np.int64)
    _sum(labels, points, (range_m, sigma_m, amplitude), (sums, bounds, box))
    near_m = np.empty(count)
    _nearest(labels, points, (bounds, box), sums[:, 0] * settings.near_fraction, near_m)
    position_m, size_m, sigmas = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    noise = settings.shared_noise_pixels, settings.sigma_systematic_m, settings.sigma_pixel, settings.edge_jitter
    perspective = lens.projection == "perspective"
    camera = rotation(mounting), position(mounting), pixel_pitch(lens, image.shape), perspective
    _evaluate((sums, bounds, box), camera, noise, position_m, size_m, sigmas)
    mean = sums[:, 7:10] / sums[:, :1]
    return Segments(
        label=np.arange(1, count + 1),
        position_m=position_m,
        covariance_m2=point_covariance(position_m, sigmas, lens, mounting, image.shape),
        size_m=size_m,
        near_m=near_m,
        n_pixels=sums[:, 0].astype(np.int64),
        box=box,
        range_m=mean[:, 0],
        sigma_range_m=sigmas[:, 2],
        amplitude=mean[:, 2],
    )


@njit(cache=True, nogil=True)
def _sum(labels: Ints, points: Floats, planes: tuple[Floats, Floats, Floats], out: tuple[Floats, Floats, Ints]) -> None:
    """Sum, run by run of one label in a row: number; points, their squares; range, sigma squared, amplitude."""
    sums, bounds, box = out
    bounds[:, :3], bounds[:, 3:] = np.inf, -np.inf
    box[:, :2], box[:, 2:] = max(labels.shape), 0
    width = labels.shape[1]
    for row in range(labels.shape[0]):
        for start in range(0, width, _BLOCK):
            stop = min(start + _BLOCK, width)
            if not _any(labels[row, start:stop]):
                continue
            first = start
            while first < stop:
                label, end = labels[row, first], first + 1
                while end < stop and labels[row, end] == label:
                    end += 1
                if label > 0:
                    k = label - 1
                    sums[k, 0] += end - first
                    _sum_points(points[row, first:end], sums[k], bounds[k])
                    for place in range(3):
                        sums[k, 7 + place] += _sum_plane(planes[place][row, first:end], place == 1)
                    box[k, 0], box[k, 1] = min(box[k, 0], row), min(box[k, 1], first)
                    box[k, 2], box[k, 3] = max(box[k, 2], row + 1), max(box[k, 3], end)
                first = end


_BLOCK = 32  # most of an image is background: so many labels are looked at together


@njit(cache=True, nogil=True)
def _any(labels: Ints) -> bool:
    seen = 0
    for label in labels:
        seen |= label
    return seen != 0


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _sum_plane(values: Floats, squared: bool) -> float:
    total = 0.0
    for value in values:
        exact = float(value)
        total += exact * exact if squared else exact
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nnan", "nsz"})
def _sum_points(points: Floats, sums: Floats, bounds: Floats) -> None:
    for axis in range(3):
        total, squares, low, high = 0.0, 0.0, bounds[axis], bounds[3 + axis]
        for i in range(len(points)):
            value = points[i, axis]
            exact = float(value)
            total += exact
            squares += exact * exact
            low, high = min(low, value), max(high, value)
        sums[1 + axis] += total
        sums[4 + axis] += squares
        bounds[axis], bounds[3 + axis] = low, high


@njit(cache=True, nogil=True)
def _nearest(labels: Ints, points: Floats, known: tuple[Floats, Ints], wanted: Floats, near_m: Floats) -> None:
    """Find the x of each segment than which only the wanted number of pixels is nearer, by a histogram of x."""
    bounds, box = known
    counts = np.empty(_NEAR_BINS, np.int32)
    for k in range(len(near_m)):
        low, width = bounds[k, 0], bounds[k, 3] - bounds[k, 0]
        per_metre = np.float32((_NEAR_BINS - 0.01) / width if width > 0 else 0.0)
        counts[:] = 0
        for row in range(box[k, 0], box[k, 2]):
            for column in range(box[k, 1], box[k, 3]):
                if labels[row, column] == k + 1:
                    counts[int((points[row, column, 0] - low) * per_metre)] += 1
        before, place = 0, 0
        while before + counts[place] < wanted[k]:
            before += counts[place]
            place += 1
        within = (wanted[k] - before) / counts[place]
        near_m[k] = low + ((place + within) / per_metre if per_metre > 0 else 0.0)


_NEAR_BINS = 32


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(
    known: tuple[Floats, Floats, Ints],
    camera: tuple[Floats, Floats, tuple[float, float], bool],
    noise: tuple[float, float, float, float],
    position_m: Floats,
    size_m: Floats,
    sigmas: Floats,
) -> None:
    sums, bounds, box = known
    turn, centre, pitch, perspective = camera
    shared, systematic, pixel, jitter = noise
    for k in range(len(sums)):
        number, variance = sums[k, 0], sums[k, 8] / sums[k, 0]
        radius2, depth = 0.0, 0.0
        for axis in range(3):
            position_m[k, axis] = sums[k, 1 + axis] / number
            away = position_m[k, axis] - centre[axis]
            radius2 += away * away
            depth += away * turn[axis, 0]
        pixel_distance = depth if perspective else math.sqrt(radius2)
        for axis in range(3):
            across, up = turn[axis, 1] * pitch[0] * pixel_distance, turn[axis, 2] * pitch[1] * pixel_distance
            footprint2 = across * across + up * up
            noise2 = variance * (position_m[k, axis] - centre[axis]) ** 2 / radius2
            spread = max(sums[k, 4 + axis] / number - position_m[k, axis] ** 2 - noise2, 0.0)
            whole = bounds[k, 3 + axis] - bounds[k, axis] + math.sqrt(footprint2)
            size_m[k, axis] = min(math.sqrt(12 * spread + footprint2), whole)
        # an outline jitters at each of its pixels: two sides of so many rows, two of so many columns
        sigmas[k, 0] = math.sqrt(pixel**2 + jitter**2 / (2 * (box[k, 2] - box[k, 0])))
        sigmas[k, 1] = math.sqrt(pixel**2 + jitter**2 / (2 * (box[k, 3] - box[k, 1])))
        sigmas[k, 2] = math.sqrt(variance * min(shared / number, 1.0) + systematic**2)
