"""Kalman's filter of the tracks (König 2008, section 6.4.3): gate and update, as loops over arrays."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.tracking.association import NO_PAIR
from rangecam.tracking.sighting import BOTH, aside, emerged, grows, within
from rangecam.types import MEMORY, Floats, Ints

_PLACED, _SIDE = MEMORY.index("placed_width"), MEMORY.index("placed_side")

Measured = tuple[Floats, Floats, float, Ints, Floats, Floats, Floats, float]
"""Positions and R of the segments, variance of the time, their pixels, `sighting.ends`; memory of the tracks,
`sighting.wander`; weight of a new width."""
Symmetric = tuple[float, float, float, float, float, float]
"""The upper half of a (3, 3), row by row, as numbers in registers: arrays would take longer than what is computed."""


@kernel
def gate_pairs(x: Floats, P: Floats, measured: Measured, gate: float, euclidean: float, cost: Floats) -> None:
    """Write the cost of each pairing; the box around the gate's ellipsoid settles it for most.

    euclidean: variance of each axis in place of the innovation covariance (eq 6.13), 0 for Mahalanobis' distance.
    """
    position, R, time_variance = measured[:3]
    z, wander = np.empty(3), np.empty(3)
    for i in range(cost.shape[0] if euclidean > 0 else 0):
        for j in range(cost.shape[1]):
            aim(measured, i, j, z, wander)
            square = (z[0] - x[i, 0]) ** 2 + (z[1] - x[i, 3]) ** 2 + (z[2] - x[i, 6]) ** 2
            inside = square <= gate * euclidean and math.isfinite(R[j, 0, 0] + R[j, 1, 1] + R[j, 2, 2])
            cost[i, j] = square / euclidean + 3 * math.log(euclidean) if inside else NO_PAIR
    if euclidean > 0:
        return
    for i in range(cost.shape[0]):
        s00, s01, s02, s11, s12, s22 = _spread(x[i], P[i], time_variance, measured[6][i])
        for j in range(cost.shape[1]):
            cost[i, j] = NO_PAIR
            u, y = position[j, 0] - x[i, 0], position[j, 1]
            if not u * u <= gate * (s00 + R[j, 0, 0]) < math.inf:  # most ask no more; or it is not a number
                continue
            across = s11 + R[j, 1, 1]
            if aims(measured[4][j, 1], measured[5][i, _SIDE], measured[6][i, 1]):
                across += aim(measured, i, j, z, wander) + wander[1] - measured[6][i, 1]
                y = z[1]
            v, w = y - x[i, 3], position[j, 2] - x[i, 6]
            if not v * v <= gate * across < math.inf or not w * w <= gate * (s22 + R[j, 2, 2]) < math.inf:
                continue
            S = s00 + R[j, 0, 0], s01 + R[j, 0, 1], s02 + R[j, 0, 2], across, s12 + R[j, 1, 2], s22 + R[j, 2, 2]
            V, determinant = inverse(S)
            d2 = squared_distance(V, u, v, w)
            if determinant > 0 and d2 <= gate:
                cost[i, j] = d2 + math.log(determinant)


@kernel
def aims(side: float, before: float, restless: float) -> bool:
    """Return whether `aim` has anything to say of a pair, given what `sighting.aside` asks: seldom, and it takes long.

    Numbers: given all of `measured` it would take longer than what it saves.
    """
    return side != 0 or before != 0 or restless > 0


@kernel
def aim(measured: Measured, i: int, j: int, z: Floats, wander: Floats) -> float:
    """Write position and `wander` (3,) as track i has them if segment j is its own; return by how much y is less known.

    They are those of the segment and of the track, but for what is placed by one end (`sighting.aside`).
    """
    for a in range(3):
        z[a], wander[a] = measured[0][j, a], measured[6][i, a]
    y, wander[1], less = aside(measured[4][j], measured[5][i], wander[1], measured[7])
    if not math.isnan(y):
        z[1] = y
    return less


@kernel
def sight(measured: Measured, i: int, j: int, x: Floats, P: Floats, z: Floats, wander: Floats) -> float:
    """Do what `aim` does for the update of a state; what is seen between two nearer things says only as much."""
    less = aim(measured, i, j, z, wander)
    if measured[4][j, 1] == BOTH:
        z[1], variance = within(x, P, less, measured[4][j], measured[5][i], z[1])
        wander[1] += variance - measured[1][j, 1, 1]
    return less + emerged(measured[4][j], measured[5][i], measured[6][i, 1])


@kernel
def take_only_candidates(cost: Floats, misses: Ints, doubts: bool, took: Ints) -> bool:
    """Write the pairing if no track has two candidates and no segment two takers; return whether that is so.

    doubts: nor is it so if a track that was missed has a candidate.
    """
    taken = np.zeros(cost.shape[1], np.bool_)
    for i in range(cost.shape[0]):
        took[i] = -1
        for j in range(cost.shape[1]):
            if cost[i, j] < NO_PAIR:
                if taken[j] or took[i] >= 0 or (doubts and misses[i] > 0):
                    return False
                taken[j], took[i] = True, j
    return True


@kernel
def update(
    state: Floats,
    covariance: Floats,
    took: Ints,
    weights: Floats | None,
    measured: Measured,
    nis: Floats,
) -> None:
    """Write the measurement update (fig 6.9) of every track that took a segment into its arrays, and its NIS.

    took (N,): index of the segment, -1 for none; weights (N, M): probability of each segment for the tracks that take
    several.
    """
    position, R, time_variance = measured[:3]
    W, z, wander = np.empty((3, 9)), np.empty(3), np.empty(3)
    for i in range(took.size):
        j, nis[i] = took[i], np.nan
        if weights is not None and any_of(weights[i]):
            _blend(state[i], covariance[i], weights[i], measured, i)
            continue
        if j < 0:
            continue
        if measured[4][j, 3] > measured[5][i, _PLACED] or aims(
            measured[4][j, 1], measured[5][i, _SIDE], measured[6][i, 1]
        ):
            covariance[i, 3, 3] += sight(measured, i, j, state[i], covariance[i], z, wander)
            squared, _ = correct(state[i], covariance[i], z, measured[1][j], measured[2], wander, W)
            state[i, 3] += grows(measured[4][j], measured[5][i], measured[7])
        else:
            squared, _ = correct(state[i], covariance[i], position[j], R[j], time_variance, measured[6][i], W)
        if measured[3][j] > 0:
            nis[i] = squared


@kernel
def _blend(x: Floats, P: Floats, weights: Floats, measured: Measured, i: int) -> None:
    """Update track i (9,), (9, 9) by several segments: mean and covariance of the mixture of their updates.

    Each segment has a covariance of its own, so there is no one gain as in Bar-Shalom's form of the update, with which
    this agrees where all are alike; the spread of the innovations is that of the updated means.
    """
    n, m, W, z, wander = weights.size, 1, np.empty((3, 9)), np.empty(3), np.empty(3)
    for j in range(n):
        m += weights[j] > 0
    share, states, covariances = np.empty(m), np.empty((m, 9)), np.empty((m, 9, 9))
    share[0], m = 1.0, 1
    copy(x, P, states[0], covariances[0])
    for j in range(n):
        if weights[j] > 0:
            share[m] = weights[j]
            share[0] = max(share[0] - weights[j], 0.0)
            copy(x, P, states[m], covariances[m])
            covariances[m, 3, 3] += sight(measured, i, j, x, P, z, wander)
            correct(states[m], covariances[m], z, measured[1][j], measured[2], wander, W)
            m += 1
    mixture(share, states, covariances, x, P)


@kernel
def correct(
    x: Floats, P: Floats, z: Floats, R: Floats, time_variance: float, wander: Floats, W: Floats
) -> tuple[float, float]:
    """Update one state by one measurement in place; return the squared distance of the two and det S.

    W (3, 9) is to compute in, made once: that takes as long as an update. P is symmetric.
    """
    V, determinant = inverse(innovation_covariance(x, P, R, time_variance, wander))
    v00, v01, v02, v11, v12, v22 = V
    u, v, w = z[0] - x[0], z[1] - x[3], z[2] - x[6]
    squared = squared_distance(V, u, v, w)
    for b in range(9):
        W[0, b], W[1, b], W[2, b] = P[0, b], P[3, b], P[6, b]  # H P
    for first in range(0, 9, 3):
        for a in range(first, first + 3):
            p0, p1, p2 = W[0, a], W[1, a], W[2, a]
            k0, k1, k2 = p0 * v00 + p1 * v01 + p2 * v02, p0 * v01 + p1 * v11 + p2 * v12, p0 * v02 + p1 * v12 + p2 * v22
            x[a] += k0 * u + k1 * v + k2 * w
            for b in range(first, 9, 3):  # P - K S K'; three at once, as loops of one cost more than what is in them
                P[a, b] -= k0 * W[0, b] + k1 * W[1, b] + k2 * W[2, b]
                P[a, b + 1] -= k0 * W[0, b + 1] + k1 * W[1, b + 1] + k2 * W[2, b + 1]
                P[a, b + 2] -= k0 * W[0, b + 2] + k1 * W[1, b + 2] + k2 * W[2, b + 2]
    for a in range(9):
        for b in range(a):
            P[a, b] = P[b, a]
    return squared, determinant


@kernel
def innovation_covariance(x: Floats, P: Floats, R: Floats, time_variance: float, wander: Floats) -> Symmetric:
    """Return S = H P H' + R; H picks x, y, z (E-K-21)."""
    s00, s01, s02, s11, s12, s22 = _spread(x, P, time_variance, wander)
    return s00 + R[0, 0], s01 + R[0, 1], s02 + R[0, 2], s11 + R[1, 1], s12 + R[1, 2], s22 + R[2, 2]


@kernel
def _spread(x: Floats, P: Floats, time_variance: float, wander: Floats) -> Symmetric:
    """Return what of S is the track's own. A wrong time shifts a moving object along its way."""
    u, v, w = time_variance * x[1], time_variance * x[4], time_variance * x[7]
    return (
        P[0, 0] + u * x[1] + wander[0],
        P[0, 3] + u * x[4],
        P[0, 6] + u * x[7],
        P[3, 3] + v * x[4] + wander[1],
        P[3, 6] + v * x[7],
        P[6, 6] + w * x[7] + wander[2],
    )


@kernel
def squared_distance(V: Symmetric, u: float, v: float, w: float) -> float:
    """Return the squared Mahalanobis distance (eq 6.14) of (u, v, w) with V the inverse of S (E-K-20)."""
    v00, v01, v02, v11, v12, v22 = V
    return v00 * u * u + v11 * v * v + v22 * w * w + 2 * (v01 * u * v + v02 * u * w + v12 * v * w)


@kernel
def inverse(S: Symmetric) -> tuple[Symmetric, float]:
    """Return the inverse of S and its determinant; if that is not positive, 0s."""
    s00, s01, s02, s11, s12, s22 = S
    v00, v01, v02 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
    v11, v12, v22 = s00 * s22 - s02 * s02, s01 * s02 - s00 * s12, s00 * s11 - s01 * s01
    det = s00 * v00 + s01 * v01 + s02 * v02
    scale = 1 / det if det > 0 else 0.0
    return (v00 * scale, v01 * scale, v02 * scale, v11 * scale, v12 * scale, v22 * scale), det


@kernel
def mixture(mu: Floats, modes: Floats, spreads: Floats, x: Floats, P: Floats) -> None:
    """Write mean (9,) and covariance (9, 9) of the mixture of modes with probabilities mu (K,).

    The covariance is each mode's own, and how far its mean is from the mean.
    """
    for a in range(9):
        x[a] = 0.0
        for k in range(mu.size):
            x[a] += mu[k] * modes[k, a]
        for b in range(9):
            P[a, b] = 0.0
    for k in range(mu.size):
        weight = mu[k]
        for a in range(9):
            apart = modes[k, a] - x[a]
            for b in range(9):
                P[a, b] += weight * (spreads[k, a, b] + apart * (modes[k, b] - x[b]))


@kernel
def copy(x: Floats, P: Floats, new_x: Floats, new_P: Floats) -> None:
    """Copy one state; as whole arrays it would compile for seconds."""
    for a in range(9):
        new_x[a] = x[a]
        for b in range(9):
            new_P[a, b] = P[a, b]


@kernel
def any_of(weights: Floats) -> bool:
    """Return whether any weight is positive."""
    for j in range(weights.size):  # noqa: SIM110 - loops compile quickly
        if weights[j] > 0:
            return True
    return False


@kernel
def largest(values: Floats) -> int:
    """Return the index of the largest value, of the first of several."""
    best = 0
    for k in range(1, values.size):
        if values[k] > values[best]:
            best = k
    return best
