"""Interacting multiple models (Blom and Bar-Shalom 1988; K-FUT-09), as loops over arrays that the caller made."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.tracking.filter import (
    Measured,
    any_of,
    copy,
    correct,
    innovation_covariance,
    inverse,
    largest,
    mixture,
    sight,
    squared_distance,
)
from rangecam.tracking.moving import Shares, predict, predict_turning, turning_room
from rangecam.tracking.sighting import grows
from rangecam.types import MEMORY, Floats, Ints

_NOISE = MEMORY.index("process_noise")
_LEAST_PROBABLE = 1e-9
"""No mode is ever ruled out: its probability could not grow again."""


@kernel
def predict_modes(
    old: tuple[Floats, Floats, Floats],
    motion: tuple[Floats, Floats, Floats],
    noise: tuple[Shares, Floats],
    own: Floats | None,
    new: tuple[Floats, Floats, Floats],
) -> None:
    """Write the predicted probability and state of each mode, which starts from the mean over where it may come from.

    noise: shares of Q, and the memory, which holds the factor of each track's Q.
    """
    (shares, memory), (models, switching, turns), (mu, modes, spreads) = noise, motion, new
    n, K = mu.shape
    share, before, spread = np.empty(K), np.empty(9), np.empty((9, 9))
    for i in range(n):
        for k in range(K):
            total = 0.0
            for j in range(K):
                share[j] = old[0][i, j] * switching[j, k]
                total += share[j]
            mu[i, k] = total
            for j in range(K):
                share[j] /= total
            mixture(share, old[1][i], old[2][i], before, spread)
            scale = memory[i, _NOISE]
            if own is not None:
                if turns[k] > 0:
                    room = turning_room()
                    to, P = modes[i, k], spreads[i, k]
                    predict_turning(before, spread, models[k], shares, scale, own, to, P, room)
                else:
                    predict(before, spread, models[k], shares, scale, modes[i, k], spreads[i, k])
            else:
                predict(before, spread, models[k], shares, scale, modes[i, k], spreads[i, k])


@kernel
def update_modes(
    predicted: tuple[Floats, Floats, Floats],
    mean: tuple[Floats, Floats],
    took: Ints,
    weights: Floats | None,
    measured: Measured,
    nis: Floats,
) -> None:
    """Update every mode of the tracks that took a segment, its probability by its likelihood, and their mean.

    Without a measurement the probabilities stay as the switching left them: nothing was seen that speaks for a mode.
    """
    (mu, modes, spreads), (x, P) = predicted, mean
    W, likelihood, z, wander = np.empty((3, 9)), np.empty(mu.shape[1]), np.empty(3), np.empty(3)
    for i in range(took.size):
        nis[i] = np.nan
        several = False
        if weights is not None:
            several = any_of(weights[i])
            if several:
                _blend_modes((mu[i], modes[i], spreads[i]), (x[i], P[i]), weights[i], measured, i)
        if took[i] >= 0 and not several:
            j = took[i]
            R, less, grown = (
                measured[1][j],
                sight(measured, i, j, x[i], P[i], z, wander),
                grows(measured[4][j], measured[5][i], measured[7]),
            )
            P[i, 3, 3] += less
            for k in range(mu.shape[1]):
                spreads[i, k, 3, 3] += less
            if measured[3][j] > 0:
                V, _ = inverse(innovation_covariance(x[i], P[i], R, measured[2], wander))
                nis[i] = squared_distance(V, z[0] - x[i, 0], z[1] - x[i, 3], z[2] - x[i, 6])
            _correct_modes(mu[i], modes[i], spreads[i], z, R, measured[2], wander, W, likelihood)
            for k in range(mu.shape[1]):
                modes[i, k, 3] += grown
        if several or took[i] >= 0:
            mixture(mu[i], modes[i], spreads[i], x[i], P[i])


@kernel
def _correct_modes(
    mu: Floats,
    modes: Floats,
    spreads: Floats,
    z: Floats,
    R: Floats,
    time_variance: float,
    wander: Floats,
    W: Floats,
    likelihood: Floats,
) -> None:
    """Update the modes (K,), (K, 9), (K, 9, 9) of one track and their probabilities by one measurement in place."""
    for k in range(mu.size):
        squared, determinant = correct(modes[k], spreads[k], z, R, time_variance, wander, W)
        likelihood[k] = -0.5 * (squared + math.log(determinant))
    best, total = likelihood[largest(likelihood)], 0.0
    for k in range(mu.size):
        mu[k] = max(mu[k] * math.exp(likelihood[k] - best), _LEAST_PROBABLE)
        total += mu[k]
    for k in range(mu.size):
        mu[k] /= total


@kernel
def _blend_modes(
    predicted: tuple[Floats, Floats, Floats], mean: tuple[Floats, Floats], weights: Floats, measured: Measured, i: int
) -> None:
    """Update the modes of track i by several segments, each with the probability that it is the track's own.

    Under each segment the modes are those of the usual update; of a mode, the mixture over the segments has the weights
    P(segment) P(mode | segment).
    """
    (mu, modes, spreads), (x, P) = predicted, mean
    n, K, m, W, z, wander = weights.size, mu.size, 1, np.empty((3, 9)), np.empty(3), np.empty(3)
    rest = 1.0
    for j in range(n):
        m += weights[j] > 0
        rest -= weights[j]
    share, states, covariances = np.empty((K, m)), np.empty((K, m, 9)), np.empty((K, m, 9, 9))
    each, one, its, likelihood = np.empty(K), np.empty((K, 9)), np.empty((K, 9, 9)), np.empty(K)
    at = 0
    for j in range(-1, n):
        if j >= 0 and not weights[j] > 0:
            continue
        for k in range(K):
            each[k] = mu[k]
            copy(modes[k], spreads[k], one[k], its[k])
        if j >= 0:
            less = sight(measured, i, j, x, P, z, wander)
            for k in range(K):
                its[k, 3, 3] += less
            _correct_modes(each, one, its, z, measured[1][j], measured[2], wander, W, likelihood)
        for k in range(K):
            share[k, at] = each[k] * (weights[j] if j >= 0 else max(rest, 0.0))
            copy(one[k], its[k], states[k, at], covariances[k, at])
        at += 1
    everything = 0.0
    for k in range(K):
        mu[k] = 0.0
        for a in range(m):
            mu[k] += share[k, a]
        for a in range(m):
            share[k, a] /= mu[k]
        everything += mu[k]
    for k in range(K):
        mu[k] /= everything
    for k in range(K):
        mixture(share[k], states[k], covariances[k], modes[k], spreads[k])
