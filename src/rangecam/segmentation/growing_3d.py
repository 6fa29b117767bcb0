"""Region growing in 3D: neighbours on one surface belong to one object, seeded by the objects of the last frame."""

import math
from typing import Any

import numpy as np
from numba import njit

from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import POSITION, VELOCITY, Floats, Ints, RangeImage, Tracks, TrackStatus


def region_growing_3d(image: RangeImage, points: Floats, settings: SegmentSettings) -> Ints:
    """Join neighbouring pixels that can lie on one surface: labels (H, W) int32, 1..N in the order of the scan.

    Two neighbours are apart by their footprint across the line of sight and by the difference of their ranges along it.
    A surface seen under the angle of incidence b has a difference of tan(b) times the footprint, so pixels join up to
    the tangent of the largest incidence, plus the noise of the difference. Inclined surfaces stay whole at any
    distance, and a step counts as one where no surface could look like it. The amplitude may have a say too (K-SEG-07).
    """
    labels = np.empty(image.shape, np.int32)
    range_m, sigma_m, light = (
        np.ascontiguousarray(plane, np.float32) for plane in (image.range_m, image.sigma_m, image.amplitude)
    )
    limits = (
        math.tan(math.radians(settings.surface_incidence_deg)) ** 2,
        settings.surface_sigmas,
        settings.amplitude_difference,
        settings.connectivity,
        settings.min_pixels,
    )
    _grow(
        np.ascontiguousarray(points, np.float32),
        range_m,
        sigma_m,
        light,
        np.ascontiguousarray(image.why),
        limits,
        labels,
    )
    return labels


def region_growing_seeded(
    image: RangeImage, points: Floats, settings: SegmentSettings, tracks: Tracks | None = None
) -> Ints:
    """Grow in 3D, each confirmed track of the last frame its own object from where it is expected on (S-SEG-05).

    What `region_growing_3d` joins though several tracks are expected in it is shared among them: each point goes to the
    nearest of their predicted positions, so that objects that touch part where they meet. A track has a say if a valid
    pixel lies within `seed_reach_m` of where it is expected; of two as near to each other, the first alone. The first
    keeps the label, those of the others come after all labels; a part below `min_pixels` stays with the first.
    """
    labels = region_growing_3d(image, points, settings)
    places = _expected(image.time_s, settings, tracks) if tracks is not None and len(tracks) else np.zeros((0, 3))
    if len(places) < 2 or not labels.any():
        return labels
    seeds = np.full(len(places), -1, np.int64)
    _nearest_pixels(places.astype(np.float32), points, labels, settings.seed_reach_m, seeds)
    seen = seeds >= 0
    places, grown = places[seen], labels.ravel()[seeds[seen]]
    most = int(labels.max())
    for label in np.unique(grown):
        inside = labels == label
        its = places[grown == label]
        owner = np.argmin(((points[inside][:, None] - its) ** 2).sum(axis=-1), axis=1)
        parts = np.full(len(owner), label, np.int32)
        for k in range(1, len(its)):
            if np.count_nonzero(owner == k) >= settings.min_pixels:
                most += 1
                parts[owner == k] = most
        labels[inside] = parts
    return labels


def _expected(time_s: float, settings: SegmentSettings, tracks: Tracks) -> Floats:
    """Return where the confirmed tracks will be at that time (K, 3), those left out that are where another one is."""
    seconds = max(time_s - tracks.time_s, 0.0)
    places: list[Floats] = []
    for i in np.flatnonzero(np.asarray(tracks.status) == TrackStatus.CONFIRMED):
        place = tracks.state[i, POSITION] + seconds * tracks.state[i, VELOCITY]
        if all(np.linalg.norm(place - other) > settings.seed_reach_m for other in places):
            places.append(place)
    return np.array(places).reshape(-1, 3)


@njit(cache=True, nogil=True)
def _nearest_pixels(places: Floats, points: Floats, labels: Ints, reach: float, seeds: Ints) -> None:
    """Write the flat index of the labelled pixel nearest to each place, -1 where none is within reach."""
    height, width = labels.shape
    best = np.full(len(places), reach * reach, np.float32)
    for row in range(height):
        for column in range(width):
            if labels[row, column] > 0:
                for k in range(len(places)):
                    away2 = np.float32(0)
                    for axis in range(3):
                        away2 += (points[row, column, axis] - places[k, axis]) ** 2
                    if away2 <= best[k]:
                        best[k], seeds[k] = away2, row * width + column


@njit(cache=True, nogil=True)
def _grow(points: Any, range_m: Any, sigma_m: Any, amplitude: Any, why: Any, limits: Any, labels: Any) -> None:
    """Give every pixel the label of what it grew from; drop what is small and number the rest without gaps."""
    height, width = labels.shape
    rows = np.array([0, 1, 0, -1, 1, 1, -1, -1])
    columns = np.array([1, 0, -1, 0, 1, -1, -1, 1])
    tangent2, sigmas, difference = limits[0], limits[1], limits[2]
    for row in range(height):
        for column in range(width):
            good = why[row, column] == 0 and math.isfinite(range_m[row, column] + sigma_m[row, column])
            labels[row, column] = -1 if good else 0
    members, sizes = np.empty(height * width, np.int32), np.zeros(height * width + 1, np.int32)
    label, count, done = 0, 0, 0
    for start in range(height * width):
        if labels[start // width, start % width] != -1:
            continue
        label += 1
        labels[start // width, start % width], members[count] = label, start
        count += 1
        while done < count:
            row, column = members[done] // width, members[done] % width
            own = labels[row, column]
            sizes[own] += 1
            done += 1
            for k in range(limits[3]):
                y, x = row + rows[k], column + columns[k]
                if 0 <= y < height and 0 <= x < width and labels[y, x] == -1:
                    along = range_m[y, x] - range_m[row, column]
                    away2 = np.float32(0)
                    for axis in range(3):
                        away2 += (points[y, x, axis] - points[row, column, axis]) ** 2
                    across2 = away2 - along * along  # law of cosines: nearly (range times angle)^2
                    if along * along > tangent2 * across2:
                        noise = sigmas * math.sqrt(sigma_m[y, x] ** 2 + sigma_m[row, column] ** 2)
                        if not abs(along) <= math.sqrt(tangent2 * max(across2, np.float32(0))) + noise:
                            continue
                    if difference > 0:
                        one, other = amplitude[row, column], amplitude[y, x]
                        if not abs(one - other) <= difference * 0.5 * (one + other):
                            continue
                    labels[y, x], members[count] = own, y * width + x
                    count += 1
    number = np.zeros(label + 1, np.int32)
    kept = 0
    for k in range(1, label + 1):
        if sizes[k] >= limits[4]:
            kept += 1
            number[k] = kept
    for row in range(height):
        for column in range(width):
            labels[row, column] = number[labels[row, column]]
