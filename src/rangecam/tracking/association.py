"""Which segment is which track's: the best pairing, from the cost of each pair."""

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment

from rangecam.types import MEMORY, Floats, Ints

NO_PAIR = 1e6
"""Cost of a pairing outside the gate: far above any that is inside."""


def likelier_than_new(cost: Floats, misses: Ints, density_per_m3: float) -> Floats:
    """Return the costs (N, M) of the pairings without those of a missed track that are likelier a new object's.

    cost: twice the negative logarithm of the likelihood, but for the constants of the normal densities, log 2 pi for
    each dimension: three of the position, and those of the shape, which are the same for a new object (`shape`).
    """
    new = -2 * math.log(density_per_m3) - 3 * math.log(2 * math.pi)
    return np.where((misses[:, None] > 0) & (cost > new), NO_PAIR, cost)


def associate_globally(cost: Floats, priority: Floats) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: as many pairs as possible, of the least total cost.

    cost (N, M): squared Mahalanobis distance plus log det S, twice the negative log-likelihood of the pairing but for
    a constant; `NO_PAIR` outside the gate.
    """
    took = np.full(len(priority), -1)
    rows, columns = linear_sum_assignment(cost)
    took[rows] = np.where(cost[rows, columns] < NO_PAIR, columns, -1)
    return took


def associate_greedily(cost: Floats, priority: Floats) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: the pair of the least cost first, then the next."""
    took, free = np.full(len(priority), -1), np.ones(cost.shape[1], bool)
    rows, columns = np.nonzero(cost < NO_PAIR)
    for k in np.argsort(cost[rows, columns], kind="stable"):
        i, j = rows[k], columns[k]
        if took[i] < 0 and free[j]:
            took[i], free[j] = j, False
    return took


def associate_by_age(cost: Floats, priority: Floats) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: by priority, the highest first (K-TRK-04, 05)."""
    took = np.full(len(priority), -1)
    if cost.shape[1]:
        free = cost.copy()
        for i in np.argsort(-np.asarray(priority), kind="stable"):
            j = int(np.argmin(free[i]))
            if free[i, j] < NO_PAIR:
                took[i] = j
                free[:, j] = NO_PAIR
    return took


def priorities(age: Ints, n_pixels: Floats, memory: Floats) -> Floats:
    """Return the priority (N,) of each track: log of age times pixels times reliability (König 2008, 6.4.2.2).

    The thesis names the three and no formula. Their product weighs them alike, whatever their units: twice as old
    counts as much as twice as many pixels, or light twice as far above the noise of the range.
    """
    reliability = memory[:, MEMORY.index("reliability")]
    priority: Floats = np.log(np.maximum((age, n_pixels, reliability), 1e-6)).sum(axis=0)
    return priority


ASSOCIATION: dict[str, Callable[[Floats, Floats], Ints]] = {
    "global": associate_globally,
    "greedy": associate_greedily,
    "by_age": associate_by_age,
    "joint_probabilistic": associate_globally,  # for life and shape; the states follow `joint.marginals`
}
"""Association methods by name: (cost of each pairing, priority of each track) -> segment of each track.

Only by_age looks at more of the priorities than how many there are.
Asked only where tracks or segments compete: every method takes a pairing in the gate that nothing competes with.
"""
