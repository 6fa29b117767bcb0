"""What a track is by rules: a vulnerable road user, a vehicle or an obstacle, from its size, shape and motion."""

import math
from functools import lru_cache

import numpy as np
from numba import njit

from rangecam.classify.ground import own_velocity
from rangecam.classify.settings import ClassificationSettings
from rangecam.types import CLASSES, Ego, Floats, Ints, Segments, Tracks, TrackStatus
from rangecam.values import changed


def rules(tracks: Tracks, ego: Ego, settings: ClassificationSettings, segments: Segments) -> Tracks:
    """Return the tracks with new class probabilities (K-CLS-01, K-CLS-02); each row of them sums to one.

    A moving object as wide and high as a person is a VRU, one of the size of a car a vehicle, and whatever stands may
    be an obstacle; what fits none of these stays unknown. The weights of the classes are divided by their sum and
    averaged over time. A person that stands cannot be told from a tree so. The segments of the frame are not needed.
    """
    probability = np.empty((tracks.status.size, len(CLASSES)))
    earlier = tracks.class_probability
    seen = tracks.status, tracks.state, tracks.covariance, tracks.size_m
    _classify(*seen, own_velocity(ego), earlier, _rules(settings), probability)
    return changed(tracks, class_probability=probability)


@lru_cache(maxsize=16)
def _rules(settings: ClassificationSettings) -> Floats:
    """Return what `_classify` is told by the settings, as one array: each further one costs every frame."""
    sizes = (*settings.vru_width_m, *settings.vru_height_m, *settings.vehicle_width_m, *settings.vehicle_height_m)
    weights = settings.standing_weight, settings.obstacle_weight, settings.unknown_weight, settings.memory
    return np.array([*sizes, settings.moving_mps, settings.size_tolerance, *weights])


_CONFIRMED = int(TrackStatus.CONFIRMED)


@njit(cache=True, nogil=True)
def _classify(
    status: Ints,
    state: Floats,
    covariance: Floats,
    size: Floats,
    own: Floats,
    earlier: Floats,
    rules: Floats,
    probability: Floats,
) -> None:
    limits, moving_mps, tolerance = rules[:8], rules[8], rules[9]
    standing, obstacle, unknown, memory = rules[10], rules[11], rules[12], rules[13]
    for i in range(status.size):
        for k in range(4):  # as whole rows it would compile three seconds longer
            probability[i, k] = earlier[i, k]
        if status[i] != _CONFIRMED:
            continue
        vx, vy = state[i, 1] + own[0], state[i, 4] + own[1]
        speed, variance = abs(state[i, 4]), covariance[i, 4, 4]
        if own[0] == own[0] and vx * vx + vy * vy > 0:  # otherwise the own motion hides the speed along x
            speed = math.sqrt(vx * vx + vy * vy)
            variance = vx * vx * covariance[i, 1, 1] + 2 * vx * vy * covariance[i, 1, 4] + vy * vy * covariance[i, 4, 4]
            variance /= speed * speed
        excess = max(speed - moving_mps, 0.0) / math.sqrt(max(variance, 1e-12))
        moves = math.erf(excess / math.sqrt(2.0))  # confidence that it moves
        width, height = size[i, 1], size[i, 2]
        person = _fit(width, limits[0], limits[1], tolerance) * _fit(height, limits[2], limits[3], tolerance)
        car = _fit(width, limits[4], limits[5], tolerance) * _fit(height, limits[6], limits[7], tolerance)
        weight = (unknown, person * (standing + (1 - standing) * moves), car, obstacle * (1 - moves))
        total = weight[0] + weight[1] + weight[2] + weight[3]
        for k in range(4):
            probability[i, k] = memory * earlier[i, k] + (1 - memory) * weight[k] / total


@njit(cache=True, nogil=True)
def _fit(value: float, least: float, greatest: float, tolerance: float) -> float:
    """Return 1 within the limits, and less the further outside."""
    if value < least:
        outside = (least - value) / (tolerance * least)
    else:
        outside = max(value - greatest, 0.0) / (tolerance * greatest)
    return math.exp(-outside * outside / 2)
