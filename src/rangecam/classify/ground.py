"""Motion over ground: what a track does beside what we do."""

import math

import numpy as np

from rangecam.types import Ego, Floats


def own_velocity(ego: Ego) -> Floats:
    """Return our velocity over ground (2,) along x and y of the vehicle: what makes a track's velocity one over ground.

    NaN where nobody measures the own speed.
    """
    if ego.speed_mps is None or not math.isfinite(ego.speed_mps):
        return np.full(2, math.nan)
    return np.array([ego.speed_mps if ego.forward else -ego.speed_mps, 0.0])
