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
    return _grown(image, points, np.zeros(0, np.int32), settings)


def region_growing_seeded(
    image: RangeImage, points: Floats, settings: SegmentSettings, tracks: Tracks | None = None
) -> Ints:
    """Grow in 3D from where the confirmed tracks of the last frame are expected, then as `region_growing_3d` (S-SEG-05).

    All seeds grow at once, each a ring of pixels at a time, so that objects that touch part where they meet: what was
    told apart stays apart. A seed is the valid pixel nearest to the predicted position, not farther than
    `seed_reach_m`; of two tracks as near to each other as that, only the first is one. Labels begin with the seeds.
    """
    return _grown(image, points, _seeds(image, points, settings, tracks or Tracks.empty()), settings)


def _seeds(image: RangeImage, points: Floats, settings: SegmentSettings, tracks: Tracks) -> Ints:
    """Return the flat indices of the seed pixels, in the order of the tracks."""
    seconds = image.time_s - tracks.time_s if len(tracks) else 0.0
    places: list[Floats] = []
    for i in np.flatnonzero(np.asarray(tracks.status) == TrackStatus.CONFIRMED):
        place = tracks.state[i, POSITION] + max(seconds, 0.0) * tracks.state[i, VELOCITY]
        if all(np.linalg.norm(place - other) > settings.seed_reach_m for other in places):
            places.append(place)
    seeds = np.full(len(places), -1, np.int32)
    if places:
        _nearest_pixels(np.array(places, np.float32), points.reshape(-1, 3), image.why.ravel(), seeds)
    seen = [
        seed
        for seed, place in zip(seeds.tolist(), places, strict=True)
        if seed >= 0 and np.linalg.norm(points.reshape(-1, 3)[seed] - place) <= settings.seed_reach_m
    ]
    return np.array(list(dict.fromkeys(seen)), np.int32)


@njit(cache=True, nogil=True)
def _nearest_pixels(places: Floats, points: Floats, why: Ints, seeds: Ints) -> None:
    best = np.full(len(places), np.inf, np.float32)
    for pixel in range(len(why)):
        if why[pixel] == 0:
            for k in range(len(places)):
                away = np.float32(0)
                for axis in range(3):
                    away += (points[pixel, axis] - places[k, axis]) ** 2
                if away < best[k]:
                    best[k], seeds[k] = away, pixel


def _grown(image: RangeImage, points: Floats, seeds: Ints, settings: SegmentSettings) -> Ints:
    labels = np.empty(image.shape, np.int32)
    planes = (np.ascontiguousarray(p, np.float32) for p in (image.range_m, image.sigma_m, image.amplitude))
    limits = (
        math.tan(math.radians(settings.surface_incidence_deg)) ** 2,
        settings.surface_sigmas,
        settings.amplitude_difference,
        settings.connectivity,
        settings.min_pixels,
    )
    _grow(np.ascontiguousarray(points, np.float32), *planes, np.ascontiguousarray(image.why), seeds, limits, labels)
    return labels


@njit(cache=True, nogil=True)
def _grow(
    points: Any, range_m: Any, sigma_m: Any, amplitude: Any, why: Any, seeds: Any, limits: Any, labels: Any
) -> Any:
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
    for seed in seeds:
        if labels[seed // width, seed % width] == -1:
            label += 1
            labels[seed // width, seed % width], members[count] = label, seed
            count += 1
    for start in range(height * width + 1):
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
        if start < height * width and labels[start // width, start % width] == -1:
            label += 1
            labels[start // width, start % width], members[count] = label, start
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
