"""One step of all tracks (König 2008, section 6.4.3) as loops over arrays that the caller made.

All kernels are in one file because Numba's cache on disk notices changes of the file that a kernel is in, not of
others.
"""

import math

import numpy as np
from numba import njit

from rangecam.tracking.association import NO_PAIR
from rangecam.types import Cut, Floats, Ints, TrackStatus

_TENTATIVE, _CONFIRMED, _COASTING = (int(s) for s in TrackStatus)
GONE = -1
"""In the place of a status: the track ends with this frame."""
CONTESTED = -1
"""In the place of a number of tracks: some compete for a segment, or segments for a track."""
WHOLE, PAIRING, PAIRED = 0, 1, 2
"""What to do of a step: all, if nothing competes; up to the costs; all, with the pairing given."""

RULES = (
    *("gate", "common", "extent", "time_variance", "weight", "vertical", "confirm_hits", "confirm_frames"),
    *("max_misses", "max_misses_vru", "max_misses_vehicle", "max_misses_obstacle", "max_variance"),
    *("euclidean", "adapt_s", "adapt_limit", "turns", "cut"),
)
"""What the kernels are told by the settings, as one array: largest squared distance, variance of every position, of the
centroid as a share of the squared size, of the time, weight of new shapes, share of the vertical Q, rules of life,
largest variance of a position; variance of a Euclidean distance, 0 for Mahalanobis'; adaptive process noise; whether
the model turns; variance of the centroid of what is cut short, as a share of the squared size."""
_RELIABILITY, _NOISE, _GROUP, _PARTS = 6, 7, 8, 9  # columns of MEMORY

Seen = tuple[Ints, Floats, Floats, Floats, Floats, Ints, Ints, Floats, Floats, Floats, Ints]
"""label, position_m, covariance_m2, size_m, near_m, n_pixels, box, range_m, amplitude, sigma_range_m and cut of
`Segments`: int64 and float64. One of no pixels is no segment, but what `groups` makes of one: it teaches neither shape
nor NIS."""
_ACROSS, _UP = int(Cut.LEFT | Cut.RIGHT | Cut.OCCLUDED), int(Cut.TOP | Cut.BOTTOM | Cut.OCCLUDED)
_Room = tuple[Floats, Floats, Floats, Floats]


@njit(cache=True, nogil=True)
def advance(
    state: Floats,
    covariance: Floats,
    status: Ints,
    age: Ints,
    hits: Ints,
    misses: Ints,
    shape: Floats,
    near_offset: Floats,
    n_pixels: Floats,
    class_probability: Floats,
    memory: Floats,
    label: Ints,
    position: Floats,
    position_covariance: Floats,
    size: Floats,
    near: Floats,
    pixels: Ints,
    box: Ints,
    range_m: Floats,
    amplitude: Floats,
    sigma: Floats,
    cut: Ints,
    model: Floats,
    rules: Floats,
    own: Floats,
    x: Floats,
    P: Floats,
    counts: Ints,
    means: Floats,
    new_shape: Floats,
    new_memory: Floats,
    cost: Floats,
    took: Ints,
    weights: Floats,
    stage: int,
) -> tuple[int, int, int]:
    """Predict, gate, associate, update and age; return how many tracks end, how many segments are left over, ignored.

    Left over is -1 - that number where a confirmed track that took none is expected inside a segment.

    Given one by one, as a tuple of arrays costs a call more than what is done with them: eleven fields of the tracks,
    ten of the segments, F and Q of one axis (2, 3, 3), `RULES`, own velocity (2,) for the turn.

    Written: x (N, 9), P (N, 9, 9); counts (5, N): status, age, hits, misses, label of the segment; means (3, N):
    near_offset, n_pixels, NIS; new_shape (N, 3), new_memory; took (N,): index of the segment, -1 for none. Where tracks
    or segments compete, `CONTESTED` is returned and the cost (N, M) of each pairing written: fill in took, and weights
    (N, M) where a track takes several by their probabilities, (0, 0) where none does, and call once more: `PAIRED`.
    """
    R = np.empty_like(position_covariance)
    measured = position, R, rules[3], pixels
    complete(position_covariance, size, cut, rules, R)
    scale = memory[:, _NOISE].copy()
    if rules[16] > 0:
        _predict_turning(state, covariance, model, rules[5], scale, own, x, P)
    else:
        _predict(state, covariance, model, rules[5], scale, x, P)
    unseen(x, P, memory, position, size, cut, rules, R)
    if stage != PAIRED:
        _gate(x, P, measured, rules[0], rules[13], cost)
        if not take_only_candidates(cost, took) or stage == PAIRING:
            return CONTESTED, 0, 0
    _update(x, P, took, weights, measured, means[2])
    seen = label, position, size, near, pixels, box, range_m, amplitude, sigma, cut
    _reshape(took, (shape, near_offset, n_pixels, memory), seen, rules[4], (counts[4], new_shape, means, new_memory))
    _adapt(means[2], model[0, 0, 1], rules, new_memory)
    ended = _count(took, pixels, (status, age, hits, misses, class_probability), P, rules, counts)
    return _summed(ended, took, status, (x, P), position, size, R)


@njit(cache=True, nogil=True)
def advance_modes(
    old: tuple[Floats, Floats, Floats, Ints, Ints, Ints, Ints, Floats, Floats, Floats, Floats, Floats],
    seen: Seen,
    motion: tuple[Floats, Floats, Floats],
    rules: Floats,
    own: Floats,
    new: tuple[Floats, Floats, Floats, Floats, Floats, Ints, Floats, Floats, Floats],
    cost: Floats,
    took: Ints,
    weights: Floats,
    stage: int,
) -> tuple[int, int, int]:
    """Do what `advance` does for an interacting multiple model (Blom and Bar-Shalom 1988; K-FUT-09).

    old: mode_probability (N, K), mode_state (N, K, 9), mode_covariance (N, K, 9, 9), then status, age, hits, misses,
    size, near_offset, n_pixels, class_probability, memory; motion: F and Q of each mode (K, 2, 3, 3), probabilities of
    switching (K, K), whether it turns (K,). Written, in `new`: the modes as in `old`, x and P, which are their mean,
    counts, means, new_shape, new_memory.
    """
    position, size, pixels, memory = seen[1], seen[3], seen[5], old[11]
    mu, modes, spreads, x, P, counts, means, new_shape, new_memory = new
    R = np.empty_like(seen[2])
    measured = position, R, rules[3], pixels
    complete(seen[2], size, seen[10], rules, R)
    _mix((old[0], old[1], old[2]), motion[1], (mu, modes, spreads))
    scale = memory[:, _NOISE].copy()
    for k in range(mu.shape[1]):
        before, spread = modes[:, k].copy(), spreads[:, k].copy()
        if motion[2][k] > 0:
            _predict_turning(before, spread, motion[0][k], rules[5], scale, own, modes[:, k], spreads[:, k])
        else:
            _predict(before, spread, motion[0][k], rules[5], scale, modes[:, k], spreads[:, k])
    _moments(mu, modes, spreads, x, P)
    unseen(x, P, memory, position, size, seen[10], rules, R)
    if stage != PAIRED:
        _gate(x, P, measured, rules[0], rules[13], cost)
        if not take_only_candidates(cost, took) or stage == PAIRING:
            return CONTESTED, 0, 0
    _update_modes((mu, modes, spreads), (x, P), took, weights, measured, means[2])
    shapes = seen[0], position, size, seen[4], pixels, seen[6], seen[7], seen[8], seen[9], seen[10]
    _reshape(took, (old[7], old[8], old[9], memory), shapes, rules[4], (counts[4], new_shape, means, new_memory))
    _adapt(means[2], motion[0][0, 0, 0, 1], rules, new_memory)
    ended = _count(took, pixels, (old[3], old[4], old[5], old[6], old[10]), P, rules, counts)
    return _summed(ended, took, old[3], (x, P), position, size, R)


@njit(cache=True, nogil=True)
def _summed(
    ended: int, took: Ints, status: Ints, predicted: tuple[Floats, Floats], position: Floats, size: Floats, R: Floats
) -> tuple[int, int, int]:
    """Return how many tracks end, how many finite segments are left over, how many are not finite: see `advance`."""
    left, taken, hidden = left_over(took, position, R, np.empty(len(position), np.int64)), 0, False
    x, P = predicted
    for i in range(took.size):
        if took[i] >= 0:
            taken += 1
        elif status[i] != _TENTATIVE and not hidden:
            for j in range(len(position)):
                hidden = hidden or inside(x[i], P[i], position[j], size[j])
    ignored = len(position) - left - taken
    return ended, -1 - left if hidden else left, ignored


@njit(cache=True, nogil=True)
def inside(x: Floats, P: Floats, position: Floats, size: Floats) -> bool:
    """Return whether a predicted centre lies in the box of a segment, within two standard deviations.

    Of its depth hardly anything is seen, so half a metre of it is allowed for.
    """
    for a in range(3):
        reach = size[a] / 2 + 2 * math.sqrt(max(P[3 * a, 3 * a], 0.0)) + (0.5 if a == 0 else 0.0)
        if not abs(x[3 * a] - position[a]) <= reach:
            return False
    return True


@njit(cache=True, nogil=True)
def _mix(old: tuple[Floats, Floats, Floats], switching: Floats, new: tuple[Floats, Floats, Floats]) -> None:
    """Write the predicted probability of each mode, and what it starts from: the mean over where it may come from."""
    n, K = old[0].shape
    share = np.empty((1, K))
    for i in range(n):
        for k in range(K):
            total = 0.0
            for j in range(K):
                share[0, j] = old[0][i, j] * switching[j, k]
                total += share[0, j]
            new[0][i, k] = total
            for j in range(K):
                share[0, j] /= total
            _moments(share, old[1][i : i + 1], old[2][i : i + 1], new[1][i : i + 1, k], new[2][i : i + 1, k])


@njit(cache=True, nogil=True)
def _moments(mu: Floats, modes: Floats, spreads: Floats, x: Floats, P: Floats) -> None:
    """Write mean and covariance of the mixture: each mode's own covariance, and how far its mean is from the mean."""
    for i in range(mu.shape[0]):
        x[i] = 0.0
        P[i] = 0.0
        for k in range(mu.shape[1]):
            for a in range(9):
                x[i, a] += mu[i, k] * modes[i, k, a]
        for k in range(mu.shape[1]):
            weight = mu[i, k]
            for a in range(9):
                apart = weight * (modes[i, k, a] - x[i, a])
                for b in range(9):
                    P[i, a, b] += weight * spreads[i, k, a, b] + apart * (modes[i, k, b] - x[i, b])


@njit(cache=True, nogil=True)
def _update_modes(
    predicted: tuple[Floats, Floats, Floats],
    mean: tuple[Floats, Floats],
    took: Ints,
    weights: Floats,
    measured: tuple[Floats, Floats, float, Ints],
    nis: Floats,
) -> None:
    """Update every mode of the tracks that took a segment, its probability by its likelihood, and their mean.

    Without a measurement the probabilities stay as the switching left them: nothing was seen that speaks for a mode.
    """
    (mu, modes, spreads), (x, P) = predicted, mean
    room, soft = _room(), weights.shape[0] > 0
    S, V = room[0], room[1]
    for i in range(took.size):
        nis[i] = np.nan
        if soft and _any(weights[i]):
            _blend_modes(mu[i], modes[i], spreads[i], weights[i], measured)
        elif took[i] >= 0:
            z, R = measured[0][took[i]], measured[1][took[i]]
            if measured[3][took[i]] > 0:
                _innovation_covariance(x[i], P[i], R, measured[2], S)
                _invert(S, V)
                nis[i] = _squared_distance(x[i], V, z)
            _correct_modes(mu[i], modes[i], spreads[i], z, R, measured[2], room)
        else:
            continue
        _moments(mu[i : i + 1], modes[i : i + 1], spreads[i : i + 1], x[i : i + 1], P[i : i + 1])


@njit(cache=True, nogil=True)
def _correct_modes(
    mu: Floats, modes: Floats, spreads: Floats, z: Floats, R: Floats, time_variance: float, room: _Room
) -> None:
    """Update the modes (K,), (K, 9), (K, 9, 9) of one track and their probabilities by one measurement in place."""
    likelihood = np.empty(mu.size)
    for k in range(mu.size):
        squared, determinant = _correct(modes[k], spreads[k], z, R, time_variance, room)
        likelihood[k] = -0.5 * (squared + math.log(determinant))
    best, total = likelihood[_largest(likelihood)], 0.0
    for k in range(mu.size):
        mu[k] = max(mu[k] * math.exp(likelihood[k] - best), _LEAST_PROBABLE)
        total += mu[k]
    for k in range(mu.size):
        mu[k] /= total


@njit(cache=True, nogil=True)
def _blend_modes(
    mu: Floats, modes: Floats, spreads: Floats, weights: Floats, measured: tuple[Floats, Floats, float, Ints]
) -> None:
    """Update one track's modes by several segments, each with the probability that it is the track's own.

    Under each segment the modes are those of the usual update; of a mode, the mixture over the segments has the weights
    P(segment) P(mode | segment).
    """
    n, K, m, room = weights.size, mu.size, 1, _room()
    rest = 1.0
    for j in range(n):
        m += weights[j] > 0
        rest -= weights[j]
    share, states, covariances = np.empty((K, m)), np.empty((K, m, 9)), np.empty((K, m, 9, 9))
    each, one, its = np.empty(K), np.empty((K, 9)), np.empty((K, 9, 9))
    at = 0
    for j in range(-1, n):
        if j >= 0 and not weights[j] > 0:
            continue
        for k in range(K):
            each[k] = mu[k]
            _copy(modes[k], spreads[k], one[k], its[k])
        if j >= 0:
            _correct_modes(each, one, its, measured[0][j], measured[1][j], measured[2], room)
        for k in range(K):
            share[k, at] = each[k] * (weights[j] if j >= 0 else max(rest, 0.0))
            _copy(one[k], its[k], states[k, at], covariances[k, at])
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
    _moments(share, states, covariances, modes, spreads)


@njit(cache=True, nogil=True)
def _copy(x: Floats, P: Floats, new_x: Floats, new_P: Floats) -> None:
    """Copy one state; as whole arrays it would compile for seconds."""
    for a in range(9):
        new_x[a] = x[a]
        for b in range(9):
            new_P[a, b] = P[a, b]


@njit(cache=True, nogil=True)
def _any(weights: Floats) -> bool:
    for j in range(weights.size):  # noqa: SIM110 - loops compile quickly
        if weights[j] > 0:
            return True
    return False


_LEAST_PROBABLE = 1e-9
"""No mode is ever ruled out: its probability could not grow again."""


@njit(cache=True, nogil=True)
def complete(covariance: Floats, size: Floats, cut: Ints, rules: Floats, R: Floats) -> None:
    """Write the covariances of the positions, errors that the camera cannot know of included."""
    common, extent, unseen = rules[1], rules[2], rules[17]
    for j in range(size.shape[0]):
        across, up = cut[j] & _ACROSS != 0, cut[j] & _UP != 0
        for a in range(3):
            for b in range(3):
                R[j, a, b] = covariance[j, a, b]
            R[j, a, a] += common + extent * size[j, a] ** 2
            if (a == 1 and across) or (a == 2 and up):
                R[j, a, a] += unseen * size[j, a] ** 2


@njit(cache=True, nogil=True)
def unseen(
    x: Floats, P: Floats, memory: Floats, position: Floats, size: Floats, cut: Ints, rules: Floats, R: Floats
) -> None:
    """Raise the covariances of what is cut short and may be part of a larger track, in place.

    Seen is w of a width W: the centre lies anywhere within (W - w) / 2 of what is seen.
    """
    for j in range(cut.size):
        if cut[j] == 0:
            continue
        for a in range(1, 3):
            missing = 0.0
            for i in range(len(x) if cut[j] & (_ACROSS if a == 1 else _UP) else 0):
                whole = math.exp(memory[i, a - 1])
                reach = (whole + size[j, a]) / 2 + 2 * math.sqrt(P[i, 3 * a, 3 * a])
                beside = abs(x[i, 3 * a] - position[j, a]) <= reach
                if beside and abs(x[i, 0] - position[j, 0]) <= 0.5 + 2 * math.sqrt(P[i, 0, 0]):
                    missing = max(missing, whole - size[j, a])
            R[j, a, a] += rules[17] * missing**2


@njit(cache=True, nogil=True)
def _predict(
    state: Floats, covariance: Floats, model: Floats, vertical: float, scale: Floats, x: Floats, P: Floats
) -> None:
    """Write F x and F P F' + Q (König 2008, fig 6.8) into x and P, block by block; all of F is upper triangular.

    vertical: share of Q that the vertical axis has; scale (N,): factor of each track's Q.
    """
    F, Q = model[0], model[1]
    t, f, r = F[0, 1], F[0, 2], F[1, 2]
    d = F[2, 2]
    for i in range(state.shape[0]):
        for a in (0, 3, 6):
            x[i, a] = state[i, a] + t * state[i, a + 1] + f * state[i, a + 2]
            share = scale[i] * (vertical if a == 6 else 1.0)
            x[i, a + 1] = state[i, a + 1] + r * state[i, a + 2]
            x[i, a + 2] = d * state[i, a + 2]
            for b in range(a, 9, 3):
                for c in range(b, b + 3):
                    p0, p1, p2 = covariance[i, a, c], covariance[i, a + 1, c], covariance[i, a + 2, c]
                    P[i, a, c], P[i, a + 1, c], P[i, a + 2, c] = p0 + t * p1 + f * p2, p1 + r * p2, d * p2
                for c in range(a, a + 3):
                    p0, p1, p2 = P[i, c, b], P[i, c, b + 1], P[i, c, b + 2]
                    P[i, c, b], P[i, c, b + 1], P[i, c, b + 2] = p0 + t * p1 + f * p2, p1 + r * p2, d * p2
            for b in range(3):
                for c in range(3):
                    P[i, a + b, a + c] += share * Q[b, c]
        for a in range(9):
            for b in range(a):
                P[i, a, b] = P[i, b, a]


@njit(cache=True, nogil=True)
def _predict_turning(
    state: Floats, covariance: Floats, model: Floats, vertical: float, scale: Floats, own: Floats, x: Floats, P: Floats
) -> None:
    """Write f(x) and J P J' + Q of the coordinated turn: F of `turning` at each track's own turn rate.

    w = (vx ay - vy ax) / (v^2 + var vx + var vy), the velocities over the ground: the variance is what v^2 of the
    estimate exceeds that of the truth by, and keeps w small where hardly anything is known of the direction. J is F
    plus dF/dw x times dw/dx, the denominator's variance held constant. own (2,): velocity of the vehicle at the end, by
    which the states, relative to it, are over the ground.
    """
    T = model[0, 0, 1]
    F, dF, J, W = np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 9))
    slope = np.zeros(9)
    for i in range(state.shape[0]):
        vx, vy, ax, ay = state[i, 1] + own[0], state[i, 4] + own[1], state[i, 2], state[i, 5]
        square = vx * vx + vy * vy + covariance[i, 1, 1] + covariance[i, 4, 4]
        w = 0.0
        for a in range(9):
            slope[a] = 0.0
        if square > 1e-12:
            w = (vx * ay - vy * ax) / square
            slope[1], slope[2] = (ay - 2 * w * vx) / square, -vy / square
            slope[4], slope[5] = (-ax - 2 * w * vy) / square, vx / square
        turning(T, w, F, dF)
        for a in range(9):
            for b in range(9):
                J[a, b] = 0.0
        for axis in range(3):
            a, v_own, level = 3 * axis, own[axis] if axis < 2 else 0.0, axis < 2
            p, v, acceleration = state[i, a], state[i, a + 1] + v_own, state[i, a + 2]
            for b in range(3):
                x[i, a + b] = 0.0
                for c in range(3):
                    J[a + b, a + c] = F[b, c] if level else model[0, b, c]
                    x[i, a + b] += J[a + b, a + c] * (p if c == 0 else v if c == 1 else acceleration)
                if level:
                    with_w = dF[b, 1] * v + dF[b, 2] * acceleration
                    for c in range(6):
                        J[a + b, c] += with_w * slope[c]
            x[i, a] -= T * v_own
            x[i, a + 1] -= v_own
        for a in range(9):
            for b in range(9):
                W[a, b] = 0.0
                for c in range(9):
                    W[a, b] += J[a, c] * covariance[i, c, b]
        for a in range(9):
            for b in range(a, 9):
                total = 0.0
                for c in range(9):
                    total += W[a, c] * J[b, c]
                if a // 3 == b // 3:
                    total += scale[i] * (vertical if a >= 6 else 1.0) * model[1, a % 3, b % 3]
                P[i, a, b], P[i, b, a] = total, total


@njit(cache=True, nogil=True)
def turning(T: float, w: float, F: Floats, dF: Floats) -> None:
    """Write F (3, 3) of one axis at the turn rate w, and its derivative to w: the exact solution of da/dt = -w^2 v."""
    u = w * T
    sine, cosine = math.sin(u), math.cos(u)
    if abs(u) > 1e-3:
        to_x, a_to_x = sine / w, (1 - cosine) / w**2
        d_to_x, d_a_to_x = (T * cosine - to_x) / w, (T * to_x - 2 * a_to_x) / w
    else:
        to_x, a_to_x = T * (1 - u * u / 6), T * T / 2 * (1 - u * u / 12)
        d_to_x, d_a_to_x = -T * T * u / 3, -(T**3) * u / 12
    F[0, 0], F[0, 1], F[0, 2] = 1.0, to_x, a_to_x
    F[1, 0], F[1, 1], F[1, 2] = 0.0, cosine, to_x
    F[2, 0], F[2, 1], F[2, 2] = 0.0, -w * sine, cosine
    dF[0, 0], dF[0, 1], dF[0, 2] = 0.0, d_to_x, d_a_to_x
    dF[1, 0], dF[1, 1], dF[1, 2] = 0.0, -T * sine, d_to_x
    dF[2, 0], dF[2, 1], dF[2, 2] = 0.0, -sine - u * cosine, -T * sine


@njit(cache=True, nogil=True)
def _gate(
    x: Floats, P: Floats, measured: tuple[Floats, Floats, float, Ints], gate: float, euclidean: float, cost: Floats
) -> None:
    """Write the cost of each pairing; the box around the gate's ellipsoid settles it for most.

    euclidean: variance of each axis in place of the innovation covariance (eq 6.13), 0 for Mahalanobis' distance.
    """
    z, R, time_variance, _ = measured
    S, V = np.zeros((3, 3)), np.empty((3, 3))
    for i in range(cost.shape[0] if euclidean > 0 else 0):
        for j in range(cost.shape[1]):
            square = (z[j, 0] - x[i, 0]) ** 2 + (z[j, 1] - x[i, 3]) ** 2 + (z[j, 2] - x[i, 6]) ** 2
            inside = square <= gate * euclidean and math.isfinite(R[j, 0, 0] + R[j, 1, 1] + R[j, 2, 2])
            cost[i, j] = square / euclidean + 3 * math.log(euclidean) if inside else NO_PAIR
    if euclidean > 0:
        return
    for i in range(cost.shape[0]):
        for j in range(cost.shape[1]):
            cost[i, j] = NO_PAIR
            for a in range(3):
                variance = P[i, 3 * a, 3 * a] + R[j, a, a] + time_variance * x[i, 3 * a + 1] ** 2
                if not (z[j, a] - x[i, 3 * a]) ** 2 <= gate * variance < math.inf:  # or not a number
                    break
            else:
                _innovation_covariance(x[i], P[i], R[j], time_variance, S)
                det = _invert(S, V)
                d2 = _squared_distance(x[i], V, z[j])
                if det > 0 and d2 <= gate:
                    cost[i, j] = d2 + math.log(det)


@njit(cache=True, nogil=True)
def _innovation_covariance(x: Floats, P: Floats, R: Floats, time_variance: float, S: Floats) -> None:
    """Write S = H P H' + R; H picks x, y, z (E-K-21). A wrong time shifts a moving object along its way."""
    for a in range(3):
        for b in range(3):
            S[a, b] = P[3 * a, 3 * b] + R[a, b] + time_variance * x[3 * a + 1] * x[3 * b + 1]


@njit(cache=True, nogil=True)
def _squared_distance(x: Floats, V: Floats, z: Floats) -> float:
    """Return the squared Mahalanobis distance (eq 6.14) with V the inverse of S (E-K-20)."""
    u, v, w = z[0] - x[0], z[1] - x[3], z[2] - x[6]
    return float(
        V[0, 0] * u * u + V[1, 1] * v * v + V[2, 2] * w * w + 2 * (V[0, 1] * u * v + V[0, 2] * u * w + V[1, 2] * v * w)
    )


@njit(cache=True, nogil=True)
def _invert(S: Floats, V: Floats) -> float:
    """Write the inverse of the symmetric S (3, 3) into V and return its determinant; if it is not positive, 0s."""
    V[0, 0] = S[1, 1] * S[2, 2] - S[1, 2] * S[1, 2]
    V[0, 1] = S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
    V[0, 2] = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]
    V[1, 1] = S[0, 0] * S[2, 2] - S[0, 2] * S[0, 2]
    V[1, 2] = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2]
    V[2, 2] = S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    det = S[0, 0] * V[0, 0] + S[0, 1] * V[0, 1] + S[0, 2] * V[0, 2]
    for a in range(3):
        for b in range(a, 3):
            V[a, b] = V[a, b] / det if det > 0 else 0.0
            V[b, a] = V[a, b]
    return float(det)


@njit(cache=True, nogil=True)
def take_only_candidates(cost: Floats, took: Ints) -> bool:
    """Write the pairing if no track has two candidates and no segment two takers; return whether that is so."""
    taken = np.zeros(cost.shape[1], np.bool_)
    for i in range(cost.shape[0]):
        took[i] = -1
        for j in range(cost.shape[1]):
            if cost[i, j] < NO_PAIR:
                if taken[j] or took[i] >= 0:
                    return False
                taken[j], took[i] = True, j
    return True


@njit(cache=True, nogil=True)
def _update(
    state: Floats,
    covariance: Floats,
    took: Ints,
    weights: Floats,
    measured: tuple[Floats, Floats, float, Ints],
    nis: Floats,
) -> None:
    """Write the measurement update (fig 6.9) of every track that took a segment into its arrays, and its NIS.

    took (N,): index of the segment, -1 for none; weights (N, M): probability of each segment for the tracks that take
    several; measured: positions, R, variance of the time, pixels.
    """
    room, soft = _room(), weights.shape[0] > 0
    for i in range(took.size):
        j, nis[i] = took[i], np.nan
        if soft and _any(weights[i]):
            _blend(state[i : i + 1], covariance[i : i + 1], weights[i], measured)
        elif j >= 0:
            squared, _ = _correct(state[i], covariance[i], measured[0][j], measured[1][j], measured[2], room)
            if measured[3][j] > 0:
                nis[i] = squared


@njit(cache=True, nogil=True)
def _blend(x: Floats, P: Floats, weights: Floats, measured: tuple[Floats, Floats, float, Ints]) -> None:
    """Update one track (1, 9), (1, 9, 9) by several segments: mean and covariance of the mixture of their updates.

    Each segment has a covariance of its own, so there is no one gain as in Bar-Shalom's form of the update, with which
    this agrees where all are alike; the spread of the innovations is that of the updated means.
    """
    n, m, room = weights.size, 1, _room()
    for j in range(n):
        m += weights[j] > 0
    share, states, covariances = np.empty((1, m)), np.empty((1, m, 9)), np.empty((1, m, 9, 9))
    share[0, 0], m = 1.0, 1
    _copy(x[0], P[0], states[0, 0], covariances[0, 0])
    for j in range(n):
        if weights[j] > 0:
            share[0, m] = weights[j]
            share[0, 0] = max(share[0, 0] - weights[j], 0.0)
            _copy(x[0], P[0], states[0, m], covariances[0, m])
            _correct(states[0, m], covariances[0, m], measured[0][j], measured[1][j], measured[2], room)
            m += 1
    _moments(share, states, covariances, x, P)


@njit(cache=True, nogil=True)
def _room() -> _Room:
    """Return what `_correct` computes in: made once, because making it takes as long as an update."""
    return np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 3)), np.empty((9, 3))


@njit(cache=True, nogil=True)
def _correct(x: Floats, P: Floats, z: Floats, R: Floats, time_variance: float, room: _Room) -> tuple[float, float]:
    """Update one state by one measurement in place; return the squared distance of the two and det S.

    room: (3, 3), (3, 3), (9, 3), (9, 3) to compute in.
    """
    S, V, W, K = room
    _innovation_covariance(x, P, R, time_variance, S)
    determinant = _invert(S, V)
    squared = _squared_distance(x, V, z)
    u, v, w = z[0] - x[0], z[1] - x[3], z[2] - x[6]
    for a in range(9):
        W[a, 0], W[a, 1], W[a, 2] = P[a, 0], P[a, 3], P[a, 6]  # P H'
        for b in range(3):
            K[a, b] = W[a, 0] * V[0, b] + W[a, 1] * V[1, b] + W[a, 2] * V[2, b]
    for a in range(9):
        x[a] += K[a, 0] * u + K[a, 1] * v + K[a, 2] * w
        for b in range(a, 9):  # P - K S K', symmetric by construction
            P[a, b] -= K[a, 0] * W[b, 0] + K[a, 1] * W[b, 1] + K[a, 2] * W[b, 2]
            P[b, a] = P[a, b]
    return squared, determinant


@njit(cache=True, nogil=True)
def _count(
    took: Ints,
    pixels: Ints,
    old: tuple[Ints, Ints, Ints, Ints, Floats],
    covariance: Floats,
    rules: Floats,
    new: Ints,
) -> int:
    """Write the new status (`GONE` for the end), age, hits and misses; return how many tracks end.

    One seen only together with others coasts, but is not missed. How long others coast is a matter of their class.
    """
    confirm_hits, confirm_frames, max_variance = rules[6], rules[7], rules[12]
    gone = 0
    for i in range(took.size):
        hit = 1 if took[i] >= 0 and pixels[took[i]] > 0 else 0
        together = took[i] >= 0 and hit == 0
        age, hits, misses = old[1][i] + 1, old[2][i] + hit, 0 if hit else old[3][i] + (0 if together else 1)
        if old[0][i] != _TENTATIVE:
            fate = _CONFIRMED if hit else _COASTING
            if fate == _COASTING and misses > rules[8 + _largest(old[4][i])]:
                fate = GONE
        elif hits >= confirm_hits:
            fate = _CONFIRMED
        else:  # can it still be seen often enough within its first frames?
            fate = _TENTATIVE if confirm_hits - hits <= confirm_frames - age else GONE
        for a in (0, 3, 6):
            if not covariance[i, a, a] <= max_variance:
                fate = GONE
        new[0, i], new[1, i], new[2, i], new[3, i] = fate, age, hits, misses
        gone += fate == GONE
    return gone


@njit(cache=True, nogil=True)
def _largest(values: Floats) -> int:
    best = 0
    for k in range(1, values.size):
        if values[k] > values[best]:
            best = k
    return best


@njit(cache=True, nogil=True)
def _adapt(nis: Floats, T: float, rules: Floats, memory: Floats) -> None:
    """Let each track's process noise follow its innovations (K-FUT-08), in place.

    d log(factor) = (NIS / 3 - 1) dt / adapt_s: it stands still where the innovations are as large as their covariance
    says, whatever the frame rate; after long gaps as one measurement may move it, 1 - exp(-dt / adapt_s).
    """
    if rules[14] > 0:
        gain, limit = -math.expm1(-T / rules[14]), rules[15]
        for i in range(nis.size):
            if math.isfinite(nis[i]):
                factor = memory[i, _NOISE] * math.exp(gain * min(nis[i] / 3 - 1, 10.0))
                memory[i, _NOISE] = min(max(factor, 1 / limit), limit)


@njit(cache=True, nogil=True)
def describe(
    size: Floats,
    pixels: Ints,
    box: Ints,
    range_m: Floats,
    amplitude: Floats,
    sigma: Floats,
    cut: Ints,
    shape: Floats,
) -> None:
    """Write the shape of each segment (M, 7): logarithms of width, height and fill, their variances, reliability.

    Fill is pixels times squared range over width and height: what the pixels tell beside width and height. The
    variances are those of pixels: each edge lies anywhere in its pixel (1/12 of its square), and each pixel of the
    outline is in or out. Of what is cut short, anything up to as much as is seen may be missing.
    """
    for j in range(len(shape)):
        width, height, n = _at_least(size[j, 1], 1e-3), _at_least(size[j, 2], 1e-3), max(pixels[j], 1)
        rows, columns = max(box[j, 2] - box[j, 0], 1), max(box[j, 3] - box[j, 1], 1)
        shape[j, 0], shape[j, 1] = math.log(width), math.log(height)
        shape[j, 2] = math.log(n * _at_least(range_m[j], 1e-3) ** 2 / (width * height))
        shape[j, 3], shape[j, 4] = 1 / (6 * columns**2), 1 / (6 * rows**2)
        shape[j, 3] += _CUT_SHORT if cut[j] & _ACROSS else 0.0
        shape[j, 4] += _CUT_SHORT if cut[j] & _UP else 0.0
        shape[j, 5] = shape[j, 3] + shape[j, 4] + (rows + columns) / (2 * n**2)
        shape[j, 6] = _at_least(amplitude[j], 0.0) / sigma[j] if sigma[j] > 0 else 0.0


_CUT_SHORT = 2 * math.log(2) ** 2 - 4 * math.log(2) + 2
"""Mean square of log(1 + u) for u evenly between 0 and 1."""


@njit(cache=True, nogil=True)
def _at_least(value: float, least: float) -> float:
    return value if least < value < 1e9 else least  # not so if it is not a number


@njit(cache=True, nogil=True)
def _reshape(
    took: Ints,
    old: tuple[Floats, Floats, Floats, Floats],
    seen: tuple[Ints, Floats, Floats, Floats, Ints, Ints, Floats, Floats, Floats, Ints],
    weight: float,
    new: tuple[Ints, Floats, Floats, Floats],
) -> None:
    """Write the label of the segment each track took, and the running means of size, nearest point, pixels, shape.

    What is cut short says only how large the object is at least.
    """
    label, position, size, near, pixels, box, range_m, amplitude, sigma, cut = seen
    new_label, new_size, means, memory = new
    shape = np.empty((len(label), 7))
    describe(size, pixels, box, range_m, amplitude, sigma, cut, shape)
    for i in range(took.size):
        j = took[i]
        new_label[i], means[0, i], means[1, i] = label[j] if j >= 0 else 0, old[1][i], old[2][i]
        for a in range(3):
            new_size[i, a] = old[0][i, a]
        for a in range(_GROUP):
            memory[i, a] = old[3][i, a]
        memory[i, _GROUP], memory[i, _PARTS] = 0.0, 0.0
        if j >= 0 and pixels[j] > 0:
            means[0, i] += weight * (position[j, 0] - near[j] - old[1][i])
            means[1, i] += weight * (pixels[j] - old[2][i])
            memory[i, _RELIABILITY] += weight * (shape[j, 6] - memory[i, _RELIABILITY])
            for a in range(3):
                short = cut[j] & (_UP if a == 2 else _ACROSS) != 0 and a > 0
                if not short or size[j, a] > old[0][i, a]:
                    new_size[i, a] += weight * (size[j, a] - old[0][i, a])
            for a in range(3):
                apart = shape[j, a] - memory[i, a]
                if cut[j] == 0 or (a < 2 and apart > 0):
                    memory[i, a] += weight * apart
                if cut[j] == 0:
                    memory[i, 3 + a] += weight * (apart * apart - memory[i, 3 + a])


@njit(cache=True, nogil=True)
def left_over(took: Ints, position: Floats, R: Floats, first: Ints) -> int:
    """Write the indices of the finite segments that no track took into the first of `first`; return how many."""
    n = 0
    taken = np.zeros(first.size, np.bool_)
    for i in range(took.size):
        if took[i] >= 0:
            taken[took[i]] = True
    for j in range(first.size):
        total = 0.0
        for a in range(3):
            total += position[j, a] + R[j, a, 0] + R[j, a, 1] + R[j, a, 2]
        if math.isfinite(total) and not taken[j]:
            first[n] = j
            n += 1
    return n
