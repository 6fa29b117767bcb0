"""What a track is: a vulnerable road user, a vehicle or an obstacle, from its size, shape and motion."""

import math
from functools import lru_cache

import numpy as np
from numba import njit

from rangecam.settings import Fraction, NonNegative, Positive, settings
from rangecam.types import CLASSES, Floats, Ints, Tracks, TrackStatus


@settings
class ClassificationSettings:
    """How tracks are classified. Sizes are those of full-size traffic; models need theirs."""

    vru_width_m: tuple[Positive, Positive] = (0.3, 1.0)
    """Least and greatest width of a pedestrian or cyclist."""
    vru_height_m: tuple[Positive, Positive] = (0.8, 2.1)
    vehicle_width_m: tuple[Positive, Positive] = (1.4, 2.6)
    """Least and greatest width of a car or truck."""
    vehicle_height_m: tuple[Positive, Positive] = (0.8, 4.0)
    size_tolerance: Positive = 0.25
    """How far a size may lie outside its limits, as a share of the nearer limit, before it speaks against the class."""
    moving_mps: NonNegative = 0.3
    """Lateral speed from which an object counts as moving. The own motion hides the speed along x."""
    standing_weight: Fraction = 0.2
    """Weight of `vru` for an object of its size that stands: it may as well be a tree or a pole."""
    obstacle_weight: Fraction = 0.5
    """Weight of `obstacle` for an object of any size that stands."""
    unknown_weight: Positive = 0.2
    """Weight of `unknown`, always."""
    memory: Fraction = 0.8
    """Share of the earlier class probabilities in the new ones."""


def classify(tracks: Tracks, settings: ClassificationSettings) -> Tracks:
    """Return the tracks with new class probabilities (K-CLS-01, K-CLS-02); each row of them sums to one.

    A moving object as wide and high as a person is a VRU, one of the size of a car a vehicle, and whatever stands may
    be an obstacle; what fits none of these stays unknown. The weights of the classes are divided by their sum and
    averaged over time. Tentative tracks are unknown; unseen ones keep what they were.
    """
    probability = np.empty((tracks.status.size, len(CLASSES)))
    earlier = tracks.class_probability
    _classify(tracks.status, tracks.state, tracks.covariance, tracks.size_m, earlier, _rules(settings), probability)
    return Tracks(**{**vars(tracks), "class_probability": probability})


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
        excess = max(abs(state[i, 4]) - moving_mps, 0.0) / math.sqrt(max(covariance[i, 4, 4], 1e-12))
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
