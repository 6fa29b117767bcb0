"""Joint probabilistic data association: how probably each segment is each track's, where tracks compete."""

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rangecam.tracking.association import NO_PAIR
from rangecam.types import Floats, Ints

LARGEST = 512
"""Sets of taken segments up to which a cluster's joint events are summed exactly."""
_ROUNDS, _SETTLED = 200, 1e-9  # of belief propagation


def marginals(cost: Floats, detection_probability: float, gate_probability: float, clutter_per_m3: float) -> Floats:
    """Return the probability (N, M) that each segment is each track's (Fortmann, Bar-Shalom and Scheffe 1983).

    cost (N, M) as in `association`. A joint event pairs each track with one segment or none, and each segment with one
    track at most; its probability is the product of P_D N(innovation) / clutter over its pairs, and of 1 - P_D P_G over
    the tracks without one. Clusters that share no segment are summed on their own, exactly; where that would take more
    than `LARGEST` pairs or sets of taken segments, by belief propagation. Rows of tracks that compete with none stay
    0: they take their segment as it is.
    """
    weights = np.zeros(cost.shape)
    rows, columns = np.nonzero(cost < NO_PAIR)
    missed = 1 - detection_probability * gate_probability
    scale = math.log(detection_probability / clutter_per_m3 / missed) - 1.5 * math.log(2 * math.pi)
    n, m = cost.shape
    graph = coo_array((np.ones(len(rows)), (rows, n + columns)), shape=(n + m, n + m))
    _, cluster = connected_components(graph, directed=False)
    order = np.argsort(cluster[rows], kind="stable")
    for pairs in np.split(order, np.flatnonzero(np.diff(cluster[rows][order])) + 1):
        if len(pairs) > 1:
            i, tracks = np.unique(rows[pairs], return_inverse=True)
            j, segments = np.unique(columns[pairs], return_inverse=True)
            ratio = np.full((len(i), len(j)), -math.inf)
            ratio[tracks, segments] = scale - cost[rows[pairs], columns[pairs]] / 2
            weights[np.ix_(i, j)] = of_cluster(ratio) if len(pairs) <= LARGEST else by_belief_propagation(ratio)
    return weights


def of_cluster(log_ratio: Floats, largest: int = LARGEST) -> Floats:
    """Return the marginals (n, m) of one cluster from how much likelier each pair is than a track without (log).

    Sums over the joint events track by track: all that the later tracks need to know is which segments are taken, of
    those that they can reach.
    """
    n, m = log_ratio.shape
    log_ratio = np.minimum(log_ratio, 300.0)  # so that a track without a segment never has exactly no probability
    top = np.maximum(log_ratio.max(axis=1), 0.0)  # each row may be scaled: every event has one factor of each
    pair, none = np.exp(log_ratio - top[:, None]), np.exp(-top)
    choices = [[(j, float(pair[i, j])) for j in range(m) if pair[i, j] > 0] for i in range(n)]
    later = [0] * (n + 1)
    for i in reversed(range(n)):
        later[i] = later[i + 1] | sum(1 << j for j, _ in choices[i])
    before: list[dict[int, float]] = [{0: 1.0}]
    for i in range(n):
        if len(before[-1]) > largest:
            return by_belief_propagation(log_ratio)
        after: dict[int, float] = {}
        for taken, weight in before[-1].items():
            for mask, ratio in [(0, float(none[i])), *((1 << j, value) for j, value in choices[i])]:
                if not taken & mask:
                    left = (taken | mask) & later[i + 1]
                    after[left] = after.get(left, 0.0) + weight * ratio
        total = sum(after.values())
        before.append({taken: weight / total for taken, weight in after.items()})

    weights, rest = np.zeros((n, m)), {0: 1.0}
    for i in reversed(range(n)):
        earlier: dict[int, float] = {}
        alone = 0.0
        for taken, weight in before[i].items():
            without = float(none[i]) * rest[taken & later[i + 1]]
            earlier[taken] = without
            alone += weight * without
            for j, ratio in choices[i]:
                if not taken >> j & 1:
                    with_it = ratio * rest[(taken | 1 << j) & later[i + 1]]
                    earlier[taken] += with_it
                    weights[i, j] += weight * with_it
        weights[i] /= alone + weights[i].sum()
        most = max(earlier.values())
        rest = {taken: value / most for taken, value in earlier.items()}
    return weights


def by_belief_propagation(log_ratio: Floats) -> Floats:
    """Return approximate marginals (n, m) of a cluster (Williams and Lau 2014), in time that grows with its pairs.

    Messages between tracks and segments, each what one would choose without the other, until they stand still. Exact
    where the pairs form no loop; it settles whatever they form.
    """
    i, j = np.nonzero(log_ratio > -math.inf)
    n, m = log_ratio.shape
    ratio = np.exp(np.minimum(log_ratio[i, j], 25.0))  # beyond this the sums of `_others` would lose the others
    free = np.ones(len(ratio))
    for _ in range(_ROUNDS):
        wanted = ratio * free
        claim = ratio / (1 + _others(wanted, i, n))
        new = 1 / (1 + _others(claim, j, m))
        settled = bool(np.abs(new - free).max() < _SETTLED)
        free = new
        if settled:
            break
    wanted = ratio * free
    weights = np.zeros((n, m))
    weights[i, j] = wanted / (1 + np.bincount(i, wanted, n))[i]
    return weights


def _others(values: Floats, group: Ints, count: int) -> Floats:
    """Return for each value the sum of the others of its group."""
    others: Floats = np.maximum(np.bincount(group, values, count)[group] - values, 0.0)
    return others
