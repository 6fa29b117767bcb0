"""Which segment is which track's: the best pairing, from the cost of each pair."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment

from rangecam.types import Floats, Ints

NO_PAIR = 1e6
"""Cost of a pairing outside the gate: far above any that is inside."""


def associate_globally(cost: Floats, age: Ints) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: as many pairs as possible, of the least total cost.

    cost (N, M): squared Mahalanobis distance plus log det S, twice the negative log-likelihood of the pairing but for
    a constant; `NO_PAIR` outside the gate.
    """
    took = np.full(len(age), -1)
    rows, columns = linear_sum_assignment(cost)
    took[rows] = np.where(cost[rows, columns] < NO_PAIR, columns, -1)
    return took


def associate_by_age(cost: Floats, age: Ints) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: the oldest chooses first (K-TRK-04, K-TRK-05)."""
    took = np.full(len(age), -1)
    if cost.shape[1]:
        free = cost.copy()
        for i in np.argsort(-age, kind="stable"):
            j = int(np.argmin(free[i]))
            if free[i, j] < NO_PAIR:
                took[i] = j
                free[:, j] = NO_PAIR
    return took


ASSOCIATION: dict[str, Callable[[Floats, Ints], Ints]] = {"global": associate_globally, "by_age": associate_by_age}
"""Association methods by name: (cost of each pairing, age of each track) -> segment of each track.

Asked only where tracks or segments compete: every method takes a pairing in the gate that nothing competes with.
"""
