"""Clusters of points: modes of their density, means of groups; and slices of distance (Steinbäck 2016, 2.3.2)."""

import dataclasses
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.errors import DataError
from rangecam.segmentation.growing import region_growing
from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage

MAX_CELLS = 20_000_000
"""Most cells of a grid around the points before it is taken for a mistake in the data or the cell size."""


def connected_slices(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Cut the distances into slices of equal width and join what touches in each: labels (H, W) int32.

    Neighbours, 4 or 8 (`connectivity`), of one slice are one object, in the order of the scan. The distance is that of
    `histogram_of`. An object that reaches over the border of a slice falls apart.
    """
    distance = points[..., 0] if settings.histogram_of == "depth" else image.range_m
    with np.errstate(invalid="ignore"):
        return _touching(image, np.floor(distance / settings.slice_m), settings)


def _touching(image: RangeImage, group: Floats, settings: SegmentSettings) -> Ints:
    """Return the connected components of equal groups among the valid pixels, in the order of the scan."""
    why = np.where(np.isfinite(group), image.why, 255).astype(np.uint8)
    plane = group.astype(np.float32)
    alone = dataclasses.replace(image, range_m=plane, sigma_m=np.zeros_like(plane), why=why)
    return region_growing(alone, np.empty(0), _by_group(settings))


@lru_cache(maxsize=16)
def _by_group(settings: SegmentSettings) -> SegmentSettings:
    return dataclasses.replace(
        settings, growing_threshold_m=0.5, growing_threshold_sigmas=0.0, growing_step_m=0.0
    )  # groups are whole numbers


def k_means(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Cluster the points around as many means as it takes: labels (H, W) int32 in the order of the scan.

    k-means whose k is found: it begins with the mean of all points; a point farther than `cluster_radius_m` from all
    means begins a new one (DP-means; Kulis and Jordan, ICML 2012), then points go to the nearest mean and means to the
    middle of their points, until nothing changes. What does not touch in the image is not one object. Large objects
    fall apart, near ones that touch merge.
    """
    cell_of, cells = _cells(image, points, settings.cluster_radius_m / _CELLS_IN_RADIUS)
    group_of = np.zeros(len(cells), np.int32)
    _means(cells, settings.cluster_radius_m**2, group_of)
    return _touching(image, _spread(cell_of, group_of), settings)


def mean_shift(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Let each point climb to where the points are densest; those of one summit are an object: labels (H, W) int32.

    Mean shift with a flat kernel of radius `bandwidth_m` (Comaniciu and Meer, PAMI 24, 2002), on cells of half that
    size, which stand for their points. A flat wall is a plateau without a summit: summits less than 0.7 radii apart are
    one. Labels 1..N in the order of the scan. Knows nothing of the image: gaps do not matter, distances do.
    """
    cell_of, cells = _cells(image, points, settings.bandwidth_m / 2)
    group_of = np.zeros(len(cells), np.int32)
    if len(cells):
        low = np.floor(cells[:, :3] / cells[:, 3:] / (settings.bandwidth_m / 2)).astype(np.int64)
        low -= low.min(axis=0)
        grid = np.full(low.max(axis=0) + 1, -1, np.int32)
        grid[tuple(low.T)] = np.arange(len(cells))
        summits = np.empty((len(cells), 3))
        _climb(cells, low, grid, settings.bandwidth_m, summits)
        _join(summits, (0.7 * settings.bandwidth_m) ** 2, group_of)
    groups = _spread(cell_of, group_of)
    labels = np.zeros(image.shape, np.int32)
    _number(groups, len(cells), settings.min_pixels, labels)
    return labels


_CELLS_IN_RADIUS = 10


def _cells(image: RangeImage, points: Floats, size_m: float) -> tuple[Ints, Floats]:
    """Return which cell each pixel's point is in (H, W), -1 for none, and sums of each cell: x, y, z, number (C, 4)."""
    cell_of, why = np.full(image.shape, -1, np.int64), np.ascontiguousarray(image.why)
    limits = np.empty((2, 3))
    count = _limits(points, why, size_m, limits)
    if count == 0:
        return cell_of, np.zeros((0, 4))
    extent = limits[1] - limits[0] + 1
    if extent.prod() > MAX_CELLS:
        raise DataError(
            f"valid points spread over {' x '.join(f'{n * size_m:.3g}' for n in extent)} m; cells of {size_m:.3g} m "
            f"make more than {MAX_CELLS}: check the data, or set segments.bandwidth_m or segments.cluster_radius_m"
        )
    keys, sums = np.full(2 * count + 1, -1, np.int64), np.zeros((count, 4))
    places = np.empty(count, np.int64)
    found = _gather(points, why, size_m, limits[0], extent, keys, places, cell_of, sums)
    order = np.argsort(places[:found])  # by place, as numbers by the scan would hang on the noise of the first pixels
    rank = np.empty(found + 1, np.int64)
    rank[order], rank[found] = np.arange(found), -1
    return rank[cell_of], sums[order]


@njit(cache=True, nogil=True)
def _limits(points: Any, why: Any, size: float, limits: Any) -> int:
    """Write the least and the greatest cell of the points along each axis (2, 3); return how many points there are."""
    limits[0], limits[1] = np.inf, -np.inf
    count = 0
    for row in range(why.shape[0]):
        for column in range(why.shape[1]):
            x, y, z = points[row, column, 0], points[row, column, 1], points[row, column, 2]
            if why[row, column] == 0 and math.isfinite(x + y + z):
                count += 1
                for axis in range(3):
                    place = math.floor(float(points[row, column, axis]) / size)
                    limits[0, axis] = min(limits[0, axis], place)
                    limits[1, axis] = max(limits[1, axis], place)
    return count


@njit(cache=True, nogil=True)
def _gather(
    points: Any, why: Any, size: float, low: Any, extent: Any, keys: Any, places: Any, cell_of: Any, sums: Any
) -> int:
    """Number the cells in the order of the scan and sum their points; return how many there are.

    keys: a table of places, -1 where it is free, in which a place is looked for from its remainder on. Written: places
    (N,) of the cells, cell_of (H, W), sums (N, 4).
    """
    found, number = 0, np.empty(len(keys), np.int64)
    for row in range(why.shape[0]):
        for column in range(why.shape[1]):
            x, y, z = float(points[row, column, 0]), float(points[row, column, 1]), float(points[row, column, 2])
            if why[row, column] != 0 or not math.isfinite(x + y + z):
                continue
            i, j, k = math.floor(x / size) - low[0], math.floor(y / size) - low[1], math.floor(z / size) - low[2]
            key = int((i * extent[1] + j) * extent[2] + k)
            slot = key % len(keys)
            while keys[slot] != key and keys[slot] >= 0:
                slot = slot + 1 if slot + 1 < len(keys) else 0
            if keys[slot] < 0:
                keys[slot], number[slot] = key, found
                places[found] = key
                found += 1
            cell = number[slot]
            cell_of[row, column] = cell
            sums[cell, 0] += x
            sums[cell, 1] += y
            sums[cell, 2] += z
            sums[cell, 3] += 1.0
    return found


def _spread(cell_of: Ints, group_of: Ints) -> Floats:
    """Return the group of each pixel (H, W), NaN for none."""
    groups = np.full(cell_of.shape, np.nan)
    groups[cell_of >= 0] = group_of[cell_of[cell_of >= 0]]
    return groups


@njit(cache=True, nogil=True)
def _means(cells: Any, radius2: float, group_of: Any) -> None:
    """Give each cell the number of its nearest mean."""
    means, sums = np.empty((len(cells), 3)), np.zeros((len(cells), 4))
    count = 0
    if len(cells) > 0:  # the first mean is that of all points
        for c in range(len(cells)):
            sums[0] += cells[c]
        means[0], count = sums[0, :3] / sums[0, 3], 1
    group_of[:] = -1
    for _ in range(_ROUNDS):
        changed = False
        for c in range(len(cells)):
            best, nearest = radius2, -1
            for k in range(count):
                away2 = 0.0
                for axis in range(3):
                    away2 += (cells[c, axis] / cells[c, 3] - means[k, axis]) ** 2
                if away2 <= best:
                    best, nearest = away2, k
            if nearest < 0:
                nearest = count
                for axis in range(3):
                    means[count, axis] = cells[c, axis] / cells[c, 3]
                count += 1
            changed = changed or group_of[c] != nearest
            group_of[c] = nearest
        if not changed:
            return
        sums[:count] = 0.0
        for c in range(len(cells)):
            sums[group_of[c]] += cells[c]
        for k in range(count):
            if sums[k, 3] > 0:
                for axis in range(3):
                    means[k, axis] = sums[k, axis] / sums[k, 3]
            else:
                means[k] = np.inf  # nobody's any more


_ROUNDS = 100


@njit(cache=True, nogil=True)
def _climb(cells: Any, place: Any, grid: Any, radius: float, summits: Any) -> None:
    """Move each cell's mean to the mean of the points within the radius, two cells, until it rests."""
    here, total, means = np.empty(3), np.empty(4), np.empty((len(cells), 3))
    for c in range(len(cells)):
        for axis in range(3):
            means[c, axis] = cells[c, axis] / cells[c, 3]
    for c in range(len(cells)):
        here[:] = means[c]
        at = place[c].copy()
        for _ in range(_ROUNDS):
            total[:] = 0.0
            for i in range(max(at[0] - 2, 0), min(at[0] + 3, grid.shape[0])):
                for j in range(max(at[1] - 2, 0), min(at[1] + 3, grid.shape[1])):
                    for k in range(max(at[2] - 2, 0), min(at[2] + 3, grid.shape[2])):
                        other = grid[i, j, k]
                        if other >= 0:
                            x, y, z = means[other, 0] - here[0], means[other, 1] - here[1], means[other, 2] - here[2]
                            if x * x + y * y + z * z <= radius * radius:
                                for axis in range(4):
                                    total[axis] += cells[other, axis]
            moved2 = 0.0
            for axis in range(3):
                new = total[axis] / total[3]
                moved2 += (new - here[axis]) ** 2
                at[axis] += math.floor(new / (radius / 2)) - math.floor(here[axis] / (radius / 2))
                here[axis] = new
            if moved2 < (1e-3 * radius) ** 2:
                break
        summits[c] = here


@njit(cache=True, nogil=True)
def _join(summits: Any, near2: float, group_of: Any) -> None:
    """Give summits that are near each other, also by way of others, the same group."""
    group_of[:] = -1
    waiting = np.empty(len(summits), np.int64)
    for start in range(len(summits)):
        if group_of[start] >= 0:
            continue
        group_of[start], waiting[0], count = start, start, 1
        while count > 0:
            count -= 1
            one = waiting[count]
            for other in range(len(summits)):
                if group_of[other] < 0:
                    away2 = 0.0
                    for axis in range(3):
                        away2 += (summits[one, axis] - summits[other, axis]) ** 2
                    if away2 < near2:
                        group_of[other], waiting[count] = start, other
                        count += 1


@njit(cache=True, nogil=True)
def _number(groups: Any, most: int, min_pixels: int, labels: Any) -> None:
    """Number the groups that are large enough in the order of the scan."""
    size, number, label = np.zeros(most + 1, np.int64), np.zeros(most + 1, np.int32), 0
    for row in range(groups.shape[0]):
        for column in range(groups.shape[1]):
            if groups[row, column] >= 0:
                size[int(groups[row, column])] += 1
    for row in range(groups.shape[0]):
        for column in range(groups.shape[1]):
            if groups[row, column] >= 0:
                group = int(groups[row, column])
                if size[group] >= min_pixels:
                    if number[group] == 0:
                        label += 1
                        number[group] = label
                    labels[row, column] = number[group]
