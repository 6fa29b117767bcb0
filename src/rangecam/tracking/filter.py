"""One step of all tracks (König 2008, section 6.4.3) as loops over arrays that the caller made.

All kernels are in one file because Numba's cache on disk notices changes of the file that a kernel is in, not of
others.
"""

import math

import numpy as np
from numba import njit

from rangecam.tracking.association import NO_PAIR
from rangecam.types import Floats, Ints, TrackStatus

_TENTATIVE, _CONFIRMED, _COASTING = (int(s) for s in TrackStatus)
GONE = -1
"""In the place of a status: the track ends with this frame."""
CONTESTED = -1
"""In the place of a number of tracks: some compete for a segment, or segments for a track."""

Seen = tuple[Ints, Floats, Floats, Floats, Floats, Ints]
"""label, position_m, covariance_m2, size_m, near_m, n_pixels of `Segments`: int64 and float64."""


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
    label: Ints,
    position: Floats,
    position_covariance: Floats,
    size: Floats,
    near: Floats,
    pixels: Ints,
    model: Floats,
    rules: Floats,
    x: Floats,
    P: Floats,
    counts: Ints,
    means: Floats,
    new_shape: Floats,
    cost: Floats,
    took: Ints,
    associated: bool,
) -> tuple[int, int]:
    """Predict, gate, associate, update and age; return how many tracks end and how many segments are left over.

    Given one by one, as a tuple of arrays costs a call more than what is done with them: nine fields of the tracks,
    six of the segments, F and Q of one axis (2, 3, 3), and `rules`: largest squared Mahalanobis distance, variance of
    every position, of the centroid as a share of the squared size, of the time, weight of new shapes, share of the
    vertical Q, confirm_hits, confirm_frames, max_misses, largest variance of a position.

    Written: x (N, 9), P (N, 9, 9); counts (5, N): status, age, hits, misses, label of the segment; means (3, N):
    near_offset, n_pixels, NIS; new_shape (N, 3); took (N,): index of the segment, -1 for none. Where tracks or segments
    compete, `CONTESTED` is returned and the cost (N, M) of each pairing written: fill in took and call `associated`.
    """
    gate, common, extent, time_variance, weight = rules[0], rules[1], rules[2], rules[3], rules[4]
    R = np.empty_like(position_covariance)
    measured = position, R, time_variance
    complete(position_covariance, size, common, extent, R)
    _predict(state, covariance, model, rules[5], x, P)
    if not associated:
        _gate(x, P, measured, gate, cost)
        if not take_only_candidates(cost, took):
            return CONTESTED, 0
    _update(x, P, took, measured, means[2])
    seen, new = (label, position, size, near, pixels), (counts[4], new_shape, means[0], means[1])
    _reshape(took, (shape, near_offset, n_pixels), seen, weight, new)
    ended = _count(took, (status, age, hits, misses), P, rules[6:], counts)
    return ended, left_over(took, position, R, np.empty_like(label))


@njit(cache=True, nogil=True)
def advance_modes(
    old: tuple[Floats, Floats, Floats, Ints, Ints, Ints, Ints, Floats, Floats, Floats],
    seen: Seen,
    motion: tuple[Floats, Floats],
    rules: Floats,
    new: tuple[Floats, Floats, Floats, Floats, Floats, Ints, Floats, Floats],
    cost: Floats,
    took: Ints,
    associated: bool,
) -> tuple[int, int]:
    """Do what `advance` does for an interacting multiple model (Blom and Bar-Shalom 1988; K-FUT-09).

    old: mode_probability (N, K), mode_state (N, K, 9), mode_covariance (N, K, 9, 9), then status, age, hits, misses,
    size, near_offset, n_pixels; motion: F and Q of each mode (K, 2, 3, 3), probabilities of switching (K, K). Written,
    in `new`: the modes as in `old`, x and P, which are their mean, counts, means and new_shape.
    """
    position, size = seen[1], seen[3]
    mu, modes, spreads, x, P, counts, means, new_shape = new
    R = np.empty_like(seen[2])
    measured = position, R, rules[3]
    complete(seen[2], size, rules[1], rules[2], R)
    _mix((old[0], old[1], old[2]), motion[1], (mu, modes, spreads))
    for k in range(mu.shape[1]):
        _predict(modes[:, k].copy(), spreads[:, k].copy(), motion[0][k], rules[5], modes[:, k], spreads[:, k])
    _moments(mu, modes, spreads, x, P)
    if not associated:
        _gate(x, P, measured, rules[0], cost)
        if not take_only_candidates(cost, took):
            return CONTESTED, 0
    _update_modes((mu, modes, spreads), (x, P), took, measured, means[2])
    shapes = (seen[0], position, size, seen[4], seen[5]), (counts[4], new_shape, means[0], means[1])
    _reshape(took, (old[7], old[8], old[9]), shapes[0], rules[4], shapes[1])
    ended = _count(took, (old[3], old[4], old[5], old[6]), P, rules[6:], counts)
    return ended, left_over(took, position, R, np.empty_like(seen[0]))


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
    measured: tuple[Floats, Floats, float],
    nis: Floats,
) -> None:
    """Update every mode of the tracks that took a segment, its probability by its likelihood, and their mean.

    Without a measurement the probabilities stay as the switching left them: nothing was seen that speaks for a mode.
    """
    (mu, modes, spreads), (x, P) = predicted, mean
    room = _room()
    S, V = room[0], room[1]
    likelihood = np.empty(mu.shape[1])
    for i in range(took.size):
        nis[i] = np.nan
        if took[i] < 0:
            continue
        z, R = measured[0][took[i]], measured[1][took[i]]
        _innovation_covariance(x[i], P[i], R, measured[2], S)
        _invert(S, V)
        nis[i] = _squared_distance(x[i], V, z)
        for k in range(mu.shape[1]):
            squared, determinant = _correct(modes[i, k], spreads[i, k], z, R, measured[2], room)
            likelihood[k] = -0.5 * (squared + math.log(determinant))
        best, total = likelihood.max(), 0.0
        for k in range(mu.shape[1]):
            mu[i, k] = max(mu[i, k] * math.exp(likelihood[k] - best), _LEAST_PROBABLE)
            total += mu[i, k]
        for k in range(mu.shape[1]):
            mu[i, k] /= total
        _moments(mu[i : i + 1], modes[i : i + 1], spreads[i : i + 1], x[i : i + 1], P[i : i + 1])


_LEAST_PROBABLE = 1e-9
"""No mode is ever ruled out: its probability could not grow again."""


@njit(cache=True, nogil=True)
def complete(covariance: Floats, size: Floats, common: float, extent: float, R: Floats) -> None:
    """Write the covariances of the positions, errors that the camera cannot know of included."""
    for j in range(size.shape[0]):
        for a in range(3):
            for b in range(3):
                R[j, a, b] = covariance[j, a, b]
            R[j, a, a] += common + extent * size[j, a] ** 2


@njit(cache=True, nogil=True)
def _predict(state: Floats, covariance: Floats, model: Floats, vertical: float, x: Floats, P: Floats) -> None:
    """Write F x and F P F' + Q (König 2008, fig 6.8) into x and P, block by block; all of F is upper triangular.

    vertical: share of Q that the vertical axis has.
    """
    F, Q = model[0], model[1]
    t, f, r = F[0, 1], F[0, 2], F[1, 2]
    d = F[2, 2]
    for i in range(state.shape[0]):
        for a in (0, 3, 6):
            x[i, a] = state[i, a] + t * state[i, a + 1] + f * state[i, a + 2]
            share = vertical if a == 6 else 1.0
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
def _gate(x: Floats, P: Floats, measured: tuple[Floats, Floats, float], gate: float, cost: Floats) -> None:
    """Write the cost of each pairing; the box around the gate's ellipsoid settles it for most."""
    z, R, time_variance = measured
    S, V = np.empty((3, 3)), np.empty((3, 3))
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
                if d2 <= gate:
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
    """Write the inverse of the symmetric positive S (3, 3) into V and return its determinant."""
    V[0, 0] = S[1, 1] * S[2, 2] - S[1, 2] * S[1, 2]
    V[0, 1] = S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
    V[0, 2] = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]
    V[1, 1] = S[0, 0] * S[2, 2] - S[0, 2] * S[0, 2]
    V[1, 2] = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2]
    V[2, 2] = S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    det = S[0, 0] * V[0, 0] + S[0, 1] * V[0, 1] + S[0, 2] * V[0, 2]
    for a in range(3):
        for b in range(a, 3):
            V[a, b] /= det
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
def _update(state: Floats, covariance: Floats, took: Ints, measured: tuple[Floats, Floats, float], nis: Floats) -> None:
    """Write the measurement update (fig 6.9) of every track that took a segment into its arrays, and its NIS.

    took (N,): index of the segment, -1 for none; measured: positions, R, variance of the time.
    """
    room = _room()
    for i in range(took.size):
        j, nis[i] = took[i], np.nan
        if j >= 0:
            nis[i], _ = _correct(state[i], covariance[i], measured[0][j], measured[1][j], measured[2], room)


@njit(cache=True, nogil=True)
def _room() -> tuple[Floats, Floats, Floats, Floats]:
    """Return what `_correct` computes in: made once, because making it takes as long as an update."""
    return np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 3)), np.empty((9, 3))


@njit(cache=True, nogil=True)
def _correct(
    x: Floats, P: Floats, z: Floats, R: Floats, time_variance: float, room: tuple[Floats, Floats, Floats, Floats]
) -> tuple[float, float]:
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
    old: tuple[Ints, Ints, Ints, Ints],
    covariance: Floats,
    rules: Floats,
    new: Ints,
) -> int:
    """Write the new status (`GONE` for the end), age, hits and misses; return how many tracks end."""
    confirm_hits, confirm_frames, max_misses, max_variance = rules[0], rules[1], rules[2], rules[3]
    gone = 0
    for i in range(took.size):
        hit = 1 if took[i] >= 0 else 0
        age, hits, misses = old[1][i] + 1, old[2][i] + hit, 0 if hit else old[3][i] + 1
        if old[0][i] != _TENTATIVE:
            fate = _CONFIRMED if hit else _COASTING if misses <= max_misses else GONE
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
def _reshape(
    took: Ints,
    old: tuple[Floats, Floats, Floats],
    seen: tuple[Ints, Floats, Floats, Floats, Ints],
    weight: float,
    new: tuple[Ints, Floats, Floats, Floats],
) -> None:
    """Write the label of the segment each track took, and the running means of size, nearest point and pixels."""
    label, position, size, near, pixels = seen
    new_label, new_size, new_offset, new_pixels = new
    for i in range(took.size):
        j = took[i]
        new_label[i], new_offset[i], new_pixels[i] = 0, old[1][i], old[2][i]
        for a in range(3):
            new_size[i, a] = old[0][i, a]
        if j >= 0:
            new_label[i] = label[j]
            new_offset[i] += weight * (position[j, 0] - near[j] - old[1][i])
            new_pixels[i] += weight * (pixels[j] - old[2][i])
            for a in range(3):
                new_size[i, a] += weight * (size[j, a] - old[0][i, a])


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
