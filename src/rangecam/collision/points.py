"""Points that stand for a Gaussian distribution: always the same, so that a prediction is a pure function."""

import numpy as np
from scipy.special import ndtri

from rangecam.types import Floats


def gaussian_points(count: int) -> Floats:
    """Return points (count, 5) with mean 0 and covariance 1, in standard deviations.

    Columns: position and speed across a face, speed along it, acceleration across and along. A quarter of them is a
    sequence of low discrepancy (Roberts 2018: multiples of powers of the root of g^6 = g + 1), mapped to normal
    quantiles; the others are its mirror images across and along. So the mean is exactly 0, left is as likely as
    right, and mirrored tracks have mirrored collisions. `count` is a multiple of 4.
    """
    g = 1.0
    for _ in range(60):
        g = (1 + g) ** (1 / 6)
    steps = g ** -np.arange(1.0, 6.0)
    base = ndtri((0.5 + np.arange(1, count // 4 + 1)[:, None] * steps) % 1.0)
    for block in ([0, 1, 3], [2, 4]):  # the mirror images take away what is between the blocks
        moment = base[:, block].T @ base[:, block] / len(base)
        base[:, block] = np.linalg.solve(np.linalg.cholesky(moment), base[:, block].T).T
    across, along = np.ones(5), np.ones(5)
    across[[0, 1, 3]], along[[2, 4]] = -1.0, -1.0
    return np.ascontiguousarray(np.concatenate([base, base * across, base * along, base * across * along]))
