"""Points that stand for a Gaussian distribution: always the same, so that a prediction is a pure function."""

import numpy as np
from scipy.special import ndtri

from rangecam.types import Floats


def gaussian_points(count: int, dimensions: int = 3) -> Floats:
    """Return points (count, 3) with mean 0 and covariance 1, in standard deviations; zeros beyond the `dimensions`.

    Columns: position, speed and acceleration across a face. Half of them is a sequence of low discrepancy (Roberts
    2018: multiples of powers of the root of g^(d + 1) = g + 1), mapped to normal quantiles; the others are its mirror
    images. So the mean is exactly 0, and mirrored tracks have mirrored collisions. `count` is a multiple of 2.
    """
    g = 1.0
    for _ in range(60):
        g = (1 + g) ** (1 / (dimensions + 1))
    steps = g ** -np.arange(1.0, dimensions + 1)
    base = ndtri((0.5 + np.arange(1, count // 2 + 1)[:, None] * steps) % 1.0)
    moment = base.T @ base / len(base)
    base = np.linalg.solve(np.linalg.cholesky(moment), base.T).T
    points = np.zeros((count, 3))
    points[:, :dimensions] = np.concatenate([base, -base])
    return points
