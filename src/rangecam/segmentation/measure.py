"""Where each segment is, how large, and how surely that is known."""

import dataclasses
import math
from functools import lru_cache
from typing import Any

import numpy as np

from rangecam.compiled import kernel
from rangecam.geometry import Lens, Mounting, is_plain, pixel_pitch, pixel_steps, point_covariance, position, rotation
from rangecam.segmentation.outline import cut_short
from rangecam.segmentation.profile import outline_profile
from rangecam.segmentation.settings import SegmentSettings
from rangecam.segmentation.sliding import slides
from rangecam.segmentation.surface import surface_shape
from rangecam.types import PROFILE_BANDS, SURFACE, Floats, Ints, RangeImage, Segments


def measure_segments(
    labels: Ints, points: Floats, image: RangeImage, lens: Lens, mounting: Mounting, settings: SegmentSettings
) -> Segments:
    """Measure every segment of a label image (H, W), 0 for background and 1..N, from the points (H, W, 3) m.

    The position is the plain mean of the points: weights 1/sigma^2 would favour pixels whose noise made them near. Its
    covariance holds the noise of the mean range, a part that no number of pixels makes smaller, and the uncertainty of
    the image position (König 2008, 6.4.3.3, E-K-22). Sizes come from the spread of the points: n pixels in a row have a
    variance of (n^2 - 1)/12 footprints^2, so 12 variances plus one footprint^2, less the noise, is the width squared.
    Of a segment that is `cut` short they are those of the part that is seen, and an edge of the image is a sure end.
    Where the thing goes on at its sides (`dim_sigma_m`), its middle and width across are those of all of it.
    The nearest point is that of the surface: as far from the mean as a quantile of x, less the share of that spread
    which is noise; of a plane that is seen squarely noise alone brings some pixels nearer.
    """
    labels, why = np.ascontiguousarray(labels), np.ascontiguousarray(image.why)
    count, shape = _number(labels), image.shape
    range_m, sigma_m = np.ascontiguousarray(image.range_m, np.float32), np.ascontiguousarray(image.sigma_m, np.float32)
    planes = range_m, sigma_m, np.ascontiguousarray(image.amplitude, np.float32)
    position_m, size_m, sigmas = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    means, n_pixels, box = np.empty((2, count)), np.empty(count, np.int64), np.empty((count, 4), np.int64)
    nearest_m, cut, ends_m = np.empty((count, 3)), np.empty(count, np.uint8), np.empty((count, 2))
    profile, surface = np.empty((count, 3, PROFILE_BANDS)), np.empty((count, len(SURFACE)))
    slide = np.zeros((count, 2))
    known, angles = _known(lens, mounting, shape, settings), _angles(lens, shape)
    filled = position_m, size_m, sigmas, means, n_pixels, box, nearest_m, cut, ends_m, profile, surface, slide
    if not _measure(labels, np.ascontiguousarray(points), *planes, why, known, angles, *filled):
        return _without_holes(labels, points, image, lens, mounting, settings)
    covariance_m2 = point_covariance(position_m, sigmas, lens, mounting, shape)
    if slide.any():
        covariance_m2[:, :2, :2] += slide[:, :, None] * slide[:, None, :]
    return Segments(
        label=np.arange(1, count + 1),
        position_m=position_m,
        covariance_m2=covariance_m2,
        size_m=size_m,
        near_m=nearest_m[:, 0].copy(),
        n_pixels=n_pixels,
        box=box,
        range_m=means[0],
        sigma_range_m=sigmas[:, 2].copy(),
        amplitude=means[1],
        cut=cut,
        nearest_m=nearest_m,
        profile=profile,
        surface=surface,
        ends_m=ends_m,
    )


@lru_cache(maxsize=16)
def _known(lens: Lens, mounting: Mounting, shape: tuple[int, int], settings: SegmentSettings) -> Floats:
    """Return what the kernels need of camera and settings, in their order."""
    noise = settings.shared_noise_pixels, settings.sigma_systematic_m, settings.sigma_pixel, settings.edge_jitter
    pitch = pixel_pitch(lens, shape)
    return np.array(
        [
            *rotation(mounting).ravel(),
            *position(mounting),
            *pitch,
            *noise,
            lens.projection == "perspective",
            settings.near_fraction,
            *(settings.occluder_step_m, settings.occluder_sigmas, settings.occluder_fraction),
            settings.edge_step,
            settings.depth_scatter,
            settings.edge_range_sigma_m,
            settings.dim_sigma_m,
            settings.pieces_slide,
        ],
        float,
    )


def _without_holes(
    labels: Ints, points: Floats, image: RangeImage, lens: Lens, mounting: Mounting, settings: SegmentSettings
) -> Segments:
    """Measure what has a finite point, range and sigma; a segment without any is left out."""
    seen = np.isfinite(points).all(axis=-1) & np.isfinite(image.range_m) & np.isfinite(image.sigma_m)
    kept = np.unique(labels[seen & (labels > 0)])
    renumbered = np.where(seen & (labels > 0), np.searchsorted(kept, labels) + 1, 0).astype(np.int32)
    segments = measure_segments(renumbered, points, image, lens, mounting, settings)
    return dataclasses.replace(segments, label=kept.astype(np.int64))


@lru_cache(maxsize=16)
def _angles(lens: Lens, shape: tuple[int, int]) -> Floats:
    """Return the size of each pixel across and up (H, W, 2), rad, if the lens is bent, else nothing (0, 0, 2)."""
    return np.zeros((0, 0, 2)) if is_plain(lens) else np.linalg.norm(pixel_steps(lens, shape), axis=-1)


@kernel
def _number(labels: Ints) -> int:
    most = np.int32(0)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            most = max(most, labels[row, column])
    return int(most)


@kernel
def _measure(
    labels: Any,
    points: Any,
    range_m: Any,
    sigma_m: Any,
    amplitude: Any,
    why: Any,
    known: Any,
    angles: Any,
    position_m: Any,
    size_m: Any,
    sigmas: Any,
    means: Any,
    n_pixels: Any,
    box: Any,
    nearest_m: Any,
    cut: Any,
    ends_m: Any,
    profile: Any,
    surface: Any,
    slide: Any,
) -> Any:
    """Fill the twelve last arrays, means: range and amplitude; return False if a point is not finite or missing."""
    sums, bounds = np.zeros((len(box), 10)), np.empty((len(box), 6), np.float32)
    _sum(labels, points, range_m, sigma_m, amplitude, sums, bounds, box)
    for k in range(len(sums)):
        if not math.isfinite(sums[k, :9].sum()):  # an amplitude may be missing
            return False
    _nearest(labels, points, sums, bounds, box, known[19], nearest_m)
    hides = known[11], known[20], known[21], known[22], known[10], known[26]
    further_m = np.zeros((len(box), 2))
    cut_short(labels, points, (range_m, sigma_m, why), box, bounds, hides, cut, ends_m, further_m)
    outline_profile(labels, points, box, profile)
    if known[27] > 0:
        slides(labels, points, (range_m, sigma_m, why), sums, box, (known[20], known[21]), slide)
    surface_shape(labels, points, (range_m, amplitude), sums, box, surface)
    _evaluate(sums, bounds, box, known, angles, position_m, size_m, sigmas, means, n_pixels, cut, nearest_m, further_m)
    return True


@kernel
def _sum(labels: Any, points: Any, range_m: Any, sigma_m: Any, amplitude: Any, sums: Any, bounds: Any, box: Any) -> Any:
    """Sum, run by run of one label in a row: number; points, their squares; range, sigma squared, amplitude."""
    height, width = labels.shape
    bounds[:, :3], bounds[:, 3:] = np.inf, -np.inf
    box[:, :2], box[:, 2:] = max(height, width), 0
    for row in range(height):
        if not _any(labels, row):  # most of an image is background
            continue
        column = 0
        while column < width:
            label, first = labels[row, column], column
            if label <= 0:
                column += 1
                continue
            k = label - 1
            x_sum, y_sum, z_sum, xx, yy, zz, ranges, variances, light = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            x_low, y_low, z_low = bounds[k, 0], bounds[k, 1], bounds[k, 2]
            x_high, y_high, z_high = bounds[k, 3], bounds[k, 4], bounds[k, 5]
            while column < width and labels[row, column] == label:
                x, y, z = points[row, column, 0], points[row, column, 1], points[row, column, 2]
                x_low, x_high = (x if x < x_low else x_low), (x if x > x_high else x_high)
                y_low, y_high = (y if y < y_low else y_low), (y if y > y_high else y_high)
                z_low, z_high = (z if z < z_low else z_low), (z if z > z_high else z_high)
                exact_x, exact_y, exact_z = float(x), float(y), float(z)
                x_sum, y_sum, z_sum = x_sum + exact_x, y_sum + exact_y, z_sum + exact_z
                xx, yy, zz = xx + exact_x * exact_x, yy + exact_y * exact_y, zz + exact_z * exact_z
                ranges += float(range_m[row, column])
                sigma = float(sigma_m[row, column])
                variances += sigma * sigma
                light += float(amplitude[row, column])
                column += 1
            one = (float(column - first), x_sum, y_sum, z_sum, xx, yy, zz, ranges, variances, light)
            for place in range(10):
                sums[k, place] += one[place]
            bounds[k, 0], bounds[k, 1], bounds[k, 2] = x_low, y_low, z_low
            bounds[k, 3], bounds[k, 4], bounds[k, 5] = x_high, y_high, z_high
            box[k, 0], box[k, 1] = min(box[k, 0], row), min(box[k, 1], first)
            box[k, 2], box[k, 3] = max(box[k, 2], row + 1), max(box[k, 3], column)


@kernel
def _any(labels: Ints, row: int) -> bool:
    seen = np.int32(0)
    for column in range(labels.shape[1]):
        seen |= labels[row, column]
    return bool(seen != 0)


@kernel
def _nearest(labels: Any, points: Any, sums: Any, bounds: Any, box: Any, fraction: Any, nearest_m: Any) -> Any:
    """Find the nearest point of each segment.

    Its x by a histogram, so that only a fraction of the pixels is nearer; y and z are the mean of these pixels.
    """
    counts = np.empty(_NEAR_BINS, np.int32)
    for k in range(len(nearest_m)):
        low, width = bounds[k, 0], bounds[k, 3] - bounds[k, 0]
        per_metre = np.float32((_NEAR_BINS - 0.01) / width if width > 0 else 0.0)
        counts[:] = 0
        for row in range(box[k, 0], box[k, 2]):
            for column in range(box[k, 1], box[k, 3]):
                if labels[row, column] == k + 1:
                    counts[int((points[row, column, 0] - low) * per_metre)] += 1
        before, place, wanted = 0, 0, fraction * sums[k, 0]
        while before + counts[place] < wanted:
            before += counts[place]
            place += 1
        within = (wanted - before) / counts[place]
        near = low + np.float32((place + within) / per_metre if per_metre > 0 else 0.0)
        y, z, number = 0.0, 0.0, 0
        for row in range(box[k, 0], box[k, 2]):
            for column in range(box[k, 1], box[k, 3]):
                if points[row, column, 0] <= near and labels[row, column] == k + 1:
                    y, z, number = y + points[row, column, 1], z + points[row, column, 2], number + 1
        nearest_m[k, 0], nearest_m[k, 1], nearest_m[k, 2] = near, y / number, z / number


_NEAR_BINS = 32


@kernel(error_model="numpy")
def _evaluate(
    sums: Any,
    bounds: Any,
    box: Any,
    known: Any,
    angles: Any,
    position_m: Any,
    size_m: Any,
    sigmas: Any,
    means: Any,
    n_pixels: Any,
    cut: Any,
    nearest_m: Any,
    further_m: Any,
) -> Any:
    turn, centre, pitch = known[:9].reshape(3, 3), known[9:12], known[12:14]
    shared, systematic, pixel, jitter, perspective = known[14], known[15], known[16], known[17], known[18]
    step, scatter, torn = known[23], known[24], known[25]
    for k in range(len(sums)):
        number, variance = sums[k, 0], sums[k, 8] / sums[k, 0]
        n_pixels[k], means[0, k], means[1, k] = number, sums[k, 7] / number, sums[k, 9] / number
        radius2, depth = 0.0, 0.0
        for axis in range(3):
            position_m[k, axis] = sums[k, 1 + axis] / number
            away = position_m[k, axis] - centre[axis]
            radius2 += away * away
            depth += away * turn[axis, 0]
        pixel_distance, pitch_h, pitch_v = depth if perspective != 0 else math.sqrt(radius2), pitch[0], pitch[1]
        if len(angles) > 0:
            middle = angles[(box[k, 0] + box[k, 2] - 1) // 2, (box[k, 1] + box[k, 3] - 1) // 2]
            pixel_distance, pitch_h, pitch_v = math.sqrt(radius2), middle[0], middle[1]
        depth_spread = 0.0
        for axis in range(3):
            across, up = turn[axis, 1] * pitch_h * pixel_distance, turn[axis, 2] * pitch_v * pixel_distance
            footprint2 = across * across + up * up
            noise2 = variance * (position_m[k, axis] - centre[axis]) ** 2 / radius2
            spread = max(sums[k, 4 + axis] / number - position_m[k, axis] ** 2 - noise2, 0.0)
            if axis == 0:
                depth_spread = spread
                shape = math.sqrt(spread / (spread + noise2)) if spread > 0 else 0.0
                nearest_m[k, 0] += (position_m[k, 0] - nearest_m[k, 0]) * (1 - shape)
            whole = bounds[k, 3 + axis] - bounds[k, axis] + math.sqrt(footprint2)
            size_m[k, axis] = min(math.sqrt(12 * spread + footprint2), whole)
        position_m[k, 1] += (further_m[k, 0] - further_m[k, 1]) / 2
        size_m[k, 1] += further_m[k, 0] + further_m[k, 1]
        # an outline jitters at each of its pixels, and a straight edge steps as a whole; an edge of the image does not
        rows, columns = box[k, 2] - box[k, 0], box[k, 3] - box[k, 1]
        beside = 2 - (cut[k] & 1) - (cut[k] >> 1 & 1)  # left and right
        above = 2 - (cut[k] >> 2 & 1) - (cut[k] >> 3 & 1)  # top and bottom
        sigmas[k, 0] = math.sqrt(pixel**2 + beside * (step**2 + jitter**2 / rows) / 4)
        sigmas[k, 1] = math.sqrt(pixel**2 + above * (step**2 + jitter**2 / columns) / 4)
        noise2 = (variance + scatter * depth_spread) * min(shared / number, 1.0) + systematic**2
        # of several columns the ends err against each other: what one gains the other loses
        ends = (rows / number) ** 4 * (position_m[k, 1] - centre[1]) ** 2 / radius2
        sigmas[k, 2] = math.sqrt(noise2 + torn**2 * ends)
