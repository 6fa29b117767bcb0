"""What an object does, from its velocity over ground and how surely that is known."""

import math
from typing import Any

import numpy as np
from numba import njit

from rangecam.classify.ground import own_velocity
from rangecam.types import ACTIONS, Ego, Floats, Tracks


def _normal_points(rings: int, spokes: int) -> Floats:
    """Return points (rings * spokes, 2) that each stand for an equal part of the standard normal distribution."""
    radius = np.sqrt(-2 * np.log(1 - (np.arange(rings) + 0.5) / rings))  # the squared radius is exponential
    angle = 2 * math.pi * (np.arange(spokes)[None] + np.arange(rings)[:, None] / rings) / spokes
    return np.stack([radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)], axis=-1).reshape(-1, 2)


_POINTS = _normal_points(8, 12)
_SLANTED = math.cos(math.radians(30.0)), math.cos(math.radians(60.0))


def actions(tracks: Tracks, ego: Ego, moving_mps: float) -> Floats:
    """Return the probability of each action (N, 5), over `ACTIONS`.

    Slower than `moving_mps` over ground it stands. Otherwise the angle between its velocity and the line to us tells:
    within 30 degrees of it it approaches, of its opposite it leaves, of the right angle it crosses, and what goes in
    any direction between walks on its own way. The probabilities are the parts of the distribution of its velocity in
    which it does so. Where nobody measures the own speed, velocities are taken relative to us.
    """
    probability = np.empty((tracks.status.size, len(ACTIONS)))
    _actions(tracks.state, tracks.covariance, own_velocity(ego), moving_mps, _POINTS, probability)
    return probability


@njit(cache=True, nogil=True)
def _actions(state: Any, covariance: Any, own: Any, moving_mps: Any, points: Any, probability: Any) -> None:
    along, across = _SLANTED
    own_x, own_y = (own[0], own[1]) if own[0] == own[0] else (0.0, 0.0)  # not a number: nobody measures it
    for i in range(len(state)):
        vx, vy = state[i, 1] + own_x, state[i, 4] + own_y
        # Cholesky factor of the covariance of the velocity
        l00 = math.sqrt(max(covariance[i, 1, 1], 1e-12))
        l10 = covariance[i, 4, 1] / l00
        l11 = math.sqrt(max(covariance[i, 4, 4] - l10 * l10, 1e-12))
        x, y = state[i, 0], state[i, 3]
        away = max(math.sqrt(x * x + y * y), 1e-9)
        for k in range(5):
            probability[i, k] = 0.0
        for n in range(len(points)):
            a = vx + l00 * points[n, 0]
            b = vy + l10 * points[n, 0] + l11 * points[n, 1]
            speed = math.sqrt(a * a + b * b)
            cosine = -(a * x + b * y) / (away * max(speed, 1e-9))
            if speed < moving_mps:
                does = 0
            elif cosine > along:
                does = 3
            elif cosine < -along:
                does = 4
            elif abs(cosine) < across:
                does = 2
            else:
                does = 1
            probability[i, does] += 1.0 / len(points)
