"""One step of all tracks (König 2008, section 6.4.3) as loops over arrays that the caller made.

Kernels that call each other are in one file because Numba's cache on disk notices changes of the file that a kernel
is in, not of others.
"""

import math

import numpy as np
from numba import njit

from rangecam.tracking.association import NO_PAIR
from rangecam.types import Cut, Floats, Ints

WHOLE, PAIRING, PAIRED = 0, 1, 2
"""What to do of a step: all, if nothing competes; up to the costs; all, with the pairing given."""

RULES = (
    *("gate", "common", "extent", "time_variance", "weight", "vertical", "confirm_hits", "confirm_frames"),
    *("max_misses", "max_misses_vru", "max_misses_vehicle", "max_misses_obstacle", "max_variance"),
    *("euclidean", "adapt_s", "adapt_limit", "cut", "max_parts", "outline", "lasts_s"),
)
"""What the kernels are told by the settings, as one array: largest squared distance, variance of every position, of the
centroid as a share of the squared size, of the time, weight of new shapes, share of the vertical Q, rules of life,
largest variance of a position; variance of a Euclidean distance, 0 for Mahalanobis'; adaptive process noise;
variance of the centroid of what is cut short, as a share of the squared size; frames in parts after which they are no
longer one; variance of the centroid as a share of that of the size."""
_SPREAD, _NOISE = 3, 7  # columns of MEMORY
_Measured = tuple[Floats, Floats, float, Ints, Floats]
"""Positions and R of the segments, variance of the time, their pixels; `wander` of the tracks."""

Seen = tuple[Ints, Floats, Floats, Floats, Floats, Ints, Ints, Floats, Floats, Floats, Ints]
"""label, position_m, covariance_m2, size_m, near_m, n_pixels, box, range_m, amplitude, sigma_range_m and cut of
`Segments`: int64 and float64. One of no pixels is no segment, but what `groups` makes of one: it teaches neither shape
nor NIS."""
ACROSS, UP = int(Cut.LEFT | Cut.RIGHT | Cut.OCCLUDED), int(Cut.TOP | Cut.BOTTOM | Cut.OCCLUDED)
"""What cuts an object short beside it, and above or below it."""
_Room = tuple[Floats, Floats, Floats]
_Turning = tuple[Floats, Floats, Floats, Floats, Floats]


@njit(cache=True, nogil=True)
def advance(
    state: Floats,
    covariance: Floats,
    memory: Floats,
    position: Floats,
    position_covariance: Floats,
    size: Floats,
    pixels: Ints,
    cut: Ints,
    model: Floats,
    rules: Floats,
    own: Floats | None,
    x: Floats,
    P: Floats,
    nis: Floats,
    cost: Floats,
    took: Ints,
    weights: Floats | None,
    stage: int,
) -> bool:
    """Predict, gate, associate and update; return whether that is done, or tracks or segments compete.

    Given one by one, as a tuple of arrays costs a call more than what is done with them: fields of the tracks and of
    the segments, F and Q of one axis (2, 3, 3), `RULES`; own velocity (2,) if the model turns. None is a type of its
    own, for which Numba leaves out what is not needed: so the first use comes sooner.

    Written: x (N, 9), P (N, 9, 9), nis (N,); took (N,): index of the segment, -1 for none. Where tracks or segments
    compete, x and P are the prediction, and the cost (N, M) of each pairing is written: fill in took, and weights (N,
    M) if tracks take several by their probabilities, and call once more: `PAIRED`.
    """
    R = np.empty_like(position_covariance)
    complete(position_covariance, size, cut, rules, R)
    if stage != PAIRED:
        drift = _drift(model[0, 0, 1], rules)
        if own is not None:
            room = _turning_room()
            for i in range(len(x)):
                _predict_turning(state[i], covariance[i], model, rules[5], memory[i, _NOISE], own, x[i], P[i], room)
        else:
            for i in range(len(x)):
                _predict(state[i], covariance[i], model, rules[5], memory[i, _NOISE], x[i], P[i])
        for i in range(len(x) if drift > 0 else 0):
            for a in (0, 3, 6):
                P[i, a, a] += drift
    z = np.empty_like(position)
    unseen(x, P, memory, (position, size, cut), rules, R, z)
    measured = z, R, rules[3], pixels, wander(memory, rules[18])
    if stage != PAIRED:
        _gate(x, P, measured, rules[0], rules[13], cost)
        if not take_only_candidates(cost, took) or stage == PAIRING:
            return False
    _update(x, P, took, weights, measured, nis)
    return True


@njit(cache=True, nogil=True)
def advance_modes(
    old: tuple[Floats, Floats, Floats, Floats],
    seen: tuple[Floats, Floats, Floats, Ints, Ints],
    motion: tuple[Floats, Floats, Floats],
    rules: Floats,
    own: Floats | None,
    new: tuple[Floats, Floats, Floats, Floats, Floats, Floats],
    cost: Floats,
    took: Ints,
    weights: Floats | None,
    stage: int,
) -> bool:
    """Do what `advance` does for an interacting multiple model (Blom and Bar-Shalom 1988; K-FUT-09).

    old: mode_probability (N, K), mode_state (N, K, 9), mode_covariance (N, K, 9, 9), memory; seen: position,
    covariance, size, pixels, cut; motion: F and Q of each mode (K, 2, 3, 3), probabilities of switching (K, K), whether
    it turns (K,). Written, in `new`: the modes as in `old`, x and P, which are their mean, and NIS.
    """
    memory, (position, covariance, size, pixels, cut) = old[3], seen
    mu, modes, spreads, x, P, nis = new
    R = np.empty_like(covariance)
    complete(covariance, size, cut, rules, R)
    if stage != PAIRED:
        _predict_modes((old[0], old[1], old[2]), motion, (rules[5], memory), own, (mu, modes, spreads))
        drift = _drift(motion[0][0, 0, 0, 1], rules)
        for i in range(len(x)):
            for k in range(mu.shape[1] if drift > 0 else 0):
                for a in (0, 3, 6):
                    spreads[i, k, a, a] += drift
            _moments(mu[i], modes[i], spreads[i], x[i], P[i])
    z = np.empty_like(position)
    unseen(x, P, memory, (position, size, cut), rules, R, z)
    measured = z, R, rules[3], pixels, wander(memory, rules[18])
    if stage != PAIRED:
        _gate(x, P, measured, rules[0], rules[13], cost)
        if not take_only_candidates(cost, took) or stage == PAIRING:
            return False
    _update_modes((mu, modes, spreads), (x, P), took, weights, measured, nis)
    return True


@njit(cache=True, nogil=True)
def _predict_modes(
    old: tuple[Floats, Floats, Floats],
    motion: tuple[Floats, Floats, Floats],
    noise: tuple[float, Floats],
    own: Floats | None,
    new: tuple[Floats, Floats, Floats],
) -> None:
    """Write the predicted probability and state of each mode, which starts from the mean over where it may come from.

    noise: the vertical share, and the memory, which holds the factor of each track's Q.
    """
    (vertical, memory), (models, switching, turns), (mu, modes, spreads) = noise, motion, new
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
            _moments(share, old[1][i], old[2][i], before, spread)
            scale = memory[i, _NOISE]
            if own is not None:
                if turns[k] > 0:
                    room = _turning_room()
                    to, P = modes[i, k], spreads[i, k]
                    _predict_turning(before, spread, models[k], vertical, scale, own, to, P, room)
                else:
                    _predict(before, spread, models[k], vertical, scale, modes[i, k], spreads[i, k])
            else:
                _predict(before, spread, models[k], vertical, scale, modes[i, k], spreads[i, k])


@njit(cache=True, nogil=True)
def _moments(mu: Floats, modes: Floats, spreads: Floats, x: Floats, P: Floats) -> None:
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


@njit(cache=True, nogil=True)
def _update_modes(
    predicted: tuple[Floats, Floats, Floats],
    mean: tuple[Floats, Floats],
    took: Ints,
    weights: Floats | None,
    measured: _Measured,
    nis: Floats,
) -> None:
    """Update every mode of the tracks that took a segment, its probability by its likelihood, and their mean.

    Without a measurement the probabilities stay as the switching left them: nothing was seen that speaks for a mode.
    """
    (mu, modes, spreads), (x, P) = predicted, mean
    room, likelihood = _room(), np.empty(mu.shape[1])
    S, V = room[0], room[1]
    for i in range(took.size):
        nis[i] = np.nan
        several = False
        if weights is not None:
            several = _any(weights[i])
            if several:
                _blend_modes(mu[i], modes[i], spreads[i], weights[i], measured, measured[4][i])
        if took[i] >= 0 and not several:
            z, R = measured[0][took[i]], measured[1][took[i]]
            if measured[3][took[i]] > 0:
                _innovation_covariance(x[i], P[i], R, measured[2], measured[4][i], S)
                _invert(S, V)
                nis[i] = _squared_distance(x[i], V, z)
            _correct_modes(mu[i], modes[i], spreads[i], z, R, measured[2], measured[4][i], room, likelihood)
        if several or took[i] >= 0:
            _moments(mu[i], modes[i], spreads[i], x[i], P[i])


@njit(cache=True, nogil=True)
def _correct_modes(
    mu: Floats,
    modes: Floats,
    spreads: Floats,
    z: Floats,
    R: Floats,
    time_variance: float,
    wander: Floats,
    room: _Room,
    likelihood: Floats,
) -> None:
    """Update the modes (K,), (K, 9), (K, 9, 9) of one track and their probabilities by one measurement in place."""
    for k in range(mu.size):
        squared, determinant = _correct(modes[k], spreads[k], z, R, time_variance, wander, room)
        likelihood[k] = -0.5 * (squared + math.log(determinant))
    best, total = likelihood[largest(likelihood)], 0.0
    for k in range(mu.size):
        mu[k] = max(mu[k] * math.exp(likelihood[k] - best), _LEAST_PROBABLE)
        total += mu[k]
    for k in range(mu.size):
        mu[k] /= total


@njit(cache=True, nogil=True)
def _blend_modes(
    mu: Floats, modes: Floats, spreads: Floats, weights: Floats, measured: _Measured, wander: Floats
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
    each, one, its, likelihood = np.empty(K), np.empty((K, 9)), np.empty((K, 9, 9)), np.empty(K)
    at = 0
    for j in range(-1, n):
        if j >= 0 and not weights[j] > 0:
            continue
        for k in range(K):
            each[k] = mu[k]
            _copy(modes[k], spreads[k], one[k], its[k])
        if j >= 0:
            _correct_modes(each, one, its, measured[0][j], measured[1][j], measured[2], wander, room, likelihood)
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
    for k in range(K):
        _moments(share[k], states[k], covariances[k], modes[k], spreads[k])


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
def _drift(T: float, rules: Floats) -> float:
    """Return the variance by which an error of the position that lasts, but not forever, changes within T."""
    return -2 * rules[1] * math.expm1(-T / rules[19]) if rules[19] > 0 else 0.0


@njit(cache=True, nogil=True)
def complete(covariance: Floats, size: Floats, cut: Ints, rules: Floats, R: Floats) -> None:
    """Write the covariances of the positions, errors that the camera cannot know of included."""
    common, extent, unseen = rules[1] if rules[19] == 0 else 0.0, rules[2], rules[16]
    for j in range(size.shape[0]):
        across, up = cut[j] & ACROSS != 0, cut[j] & UP != 0
        for a in range(3):
            for b in range(3):
                R[j, a, b] = covariance[j, a, b]
            R[j, a, a] += common + extent * size[j, a] ** 2
            if (a == 2 and up) or (a < 2 and across):
                R[j, a, a] += unseen * size[j, a] ** 2


@njit(cache=True, nogil=True)
def unseen(
    x: Floats, P: Floats, memory: Floats, seen: tuple[Floats, Floats, Ints], rules: Floats, R: Floats, z: Floats | None
) -> None:
    """Raise the covariances of what is cut short and may be part of a larger track, in place.

    seen: position, size, cut of the segments. Seen is w of a width W: the centre lies anywhere within (W - w) / 2 of
    what is seen. If z (M, 3) is given, it becomes the positions, and of what is cut at one side the centre of the
    whole: half of W from the end that is seen, as surely as W is known.
    """
    position, size, cut = seen
    if z is not None:
        for j in range(cut.size):
            for a in range(3):
                z[j, a] = position[j, a]
    for j in range(cut.size):
        for a in range(1, 3):
            if cut[j] & (ACROSS if a == 1 else UP) == 0:
                continue
            missing, spread = _missing(x, P, memory, position[j], R[j], size[j], a)
            if z is not None:  # noqa: SIM102 - Numba leaves it out where there is none
                if a == 1 and one_sided(cut[j]):
                    z[j, 1] += missing / 2 if cut[j] & LEFT != 0 else -missing / 2
                    R[j, 1, 1] += spread / 4 - (rules[16] * size[j, 1] ** 2 if spread > 0 else 0.0)
                    continue
            R[j, a, a] += rules[16] * missing**2


@njit(cache=True, nogil=True)
def one_sided(cut: int) -> bool:
    """Return whether one side of a segment is cut by the image or by something nearer, and the other is its own."""
    return bool((cut & LEFT != 0) != (cut & RIGHT != 0))


LEFT, RIGHT = int(Cut.LEFT | Cut.HIDDEN_LEFT), int(Cut.RIGHT | Cut.HIDDEN_RIGHT)


@njit(cache=True, nogil=True)
def _missing(
    x: Floats, P: Floats, memory: Floats, position: Floats, R: Floats, size: Floats, a: int
) -> tuple[float, float]:
    """Return how much wider (a = 1) or higher (2) than a segment the widest track is that it may be part of.

    And the variance of that track's own width or height.
    """
    missing, spread = 0.0, 0.0
    for i in range(len(x)):
        whole = math.exp(memory[i, a - 1])
        reach = (whole + size[a]) / 2 + 2 * math.sqrt(P[i, 3 * a, 3 * a] + R[a, a])
        beside = abs(x[i, 3 * a] - position[a]) <= reach
        ahead = abs(x[i, 0] - position[0]) <= 0.5 + 2 * math.sqrt(P[i, 0, 0] + R[0, 0])
        if beside and ahead and whole - size[a] > missing:
            missing, spread = whole - size[a], whole**2 * memory[i, _SPREAD + a - 1]
    return missing, spread


@njit(cache=True, nogil=True)
def _predict(
    state: Floats, covariance: Floats, model: Floats, vertical: float, scale: float, x: Floats, P: Floats
) -> None:
    """Write F x and F P F' + Q (König 2008, fig 6.8) into x and P, block by block; all of F is upper triangular.

    vertical: share of Q that the vertical axis has; scale: factor of the track's Q.
    """
    F, Q = model[0], model[1]
    t, f, r = F[0, 1], F[0, 2], F[1, 2]
    d = F[2, 2]
    for a in (0, 3, 6):
        x[a] = state[a] + t * state[a + 1] + f * state[a + 2]
        share = scale * (vertical if a == 6 else 1.0)
        x[a + 1] = state[a + 1] + r * state[a + 2]
        x[a + 2] = d * state[a + 2]
        for b in range(a, 9, 3):
            for c in range(b, b + 3):
                p0, p1, p2 = covariance[a, c], covariance[a + 1, c], covariance[a + 2, c]
                P[a, c], P[a + 1, c], P[a + 2, c] = p0 + t * p1 + f * p2, p1 + r * p2, d * p2
            for c in range(a, a + 3):
                p0, p1, p2 = P[c, b], P[c, b + 1], P[c, b + 2]
                P[c, b], P[c, b + 1], P[c, b + 2] = p0 + t * p1 + f * p2, p1 + r * p2, d * p2
        for b in range(3):
            for c in range(3):
                P[a + b, a + c] += share * Q[b, c]
    for a in range(9):
        for b in range(a):
            P[a, b] = P[b, a]


@njit(cache=True, nogil=True)
def _predict_turning(
    state: Floats,
    covariance: Floats,
    model: Floats,
    vertical: float,
    scale: float,
    own: Floats,
    x: Floats,
    P: Floats,
    room: _Turning,
) -> None:
    """Write f(x) and J P J' + Q of the coordinated turn: F of `turning` at each track's own turn rate.

    w = (vx ay - vy ax) / (v^2 + var vx + var vy), the velocities over the ground: the variance is what v^2 of the
    estimate exceeds that of the truth by, and keeps w small where hardly anything is known of the direction. J is F
    plus dF/dw x times dw/dx, the denominator's variance held constant. own (2,): velocity of the vehicle at the end, by
    which the states, relative to it, are over the ground.
    """
    T = model[0, 0, 1]
    F, dF, J, W, slope = room
    vx, vy, ax, ay = state[1] + own[0], state[4] + own[1], state[2], state[5]
    square = vx * vx + vy * vy + covariance[1, 1] + covariance[4, 4]
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
        p, v, acceleration = state[a], state[a + 1] + v_own, state[a + 2]
        for b in range(3):
            x[a + b] = 0.0
            for c in range(3):
                J[a + b, a + c] = F[b, c] if level else model[0, b, c]
                x[a + b] += J[a + b, a + c] * (p if c == 0 else v if c == 1 else acceleration)
            if level:
                with_w = dF[b, 1] * v + dF[b, 2] * acceleration
                for c in range(6):
                    J[a + b, c] += with_w * slope[c]
        x[a] -= T * v_own
        x[a + 1] -= v_own
    for a in range(9):
        for b in range(9):
            W[a, b] = 0.0
            for c in range(9):
                W[a, b] += J[a, c] * covariance[c, b]
    for a in range(9):
        for b in range(a, 9):
            total = 0.0
            for c in range(9):
                total += W[a, c] * J[b, c]
            if a // 3 == b // 3:
                total += scale * (vertical if a >= 6 else 1.0) * model[1, a % 3, b % 3]
            P[a, b], P[b, a] = total, total


@njit(cache=True, nogil=True)
def _turning_room() -> _Turning:
    return np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 9)), np.empty(9)


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
def _gate(x: Floats, P: Floats, measured: _Measured, gate: float, euclidean: float, cost: Floats) -> None:
    """Write the cost of each pairing; the box around the gate's ellipsoid settles it for most.

    euclidean: variance of each axis in place of the innovation covariance (eq 6.13), 0 for Mahalanobis' distance.
    """
    z, R, time_variance, _, wander = measured
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
                variance = P[i, 3 * a, 3 * a] + R[j, a, a] + time_variance * x[i, 3 * a + 1] ** 2 + wander[i, a]
                if not (z[j, a] - x[i, 3 * a]) ** 2 <= gate * variance < math.inf:  # or not a number
                    break
            else:
                _innovation_covariance(x[i], P[i], R[j], time_variance, wander[i], S)
                det = _invert(S, V)
                d2 = _squared_distance(x[i], V, z[j])
                if det > 0 and d2 <= gate:
                    cost[i, j] = d2 + math.log(det)


@njit(cache=True, nogil=True)
def wander(memory: Floats, share: float) -> Floats:
    """Return the variances (N, 3) by which each track's centroid wanders as its outline changes, along each axis.

    The ends of an outline that err on their own by s each move the middle by s / sqrt(2) and change the width by
    s sqrt(2): the middle by half as much as the width. share: the square of that half.
    """
    variance = np.zeros((len(memory), 3))
    for i in range(len(memory) if share > 0 else 0):
        for a in range(2):
            variance[i, a + 1] = share * math.exp(2 * memory[i, a]) * memory[i, _SPREAD + a]
    return variance


@njit(cache=True, nogil=True)
def _innovation_covariance(
    x: Floats, P: Floats, R: Floats, time_variance: float, wander: Floats, S: Floats
) -> None:  # fmt: skip
    """Write S = H P H' + R; H picks x, y, z (E-K-21). A wrong time shifts a moving object along its way."""
    for a in range(3):
        for b in range(3):
            S[a, b] = P[3 * a, 3 * b] + R[a, b] + time_variance * x[3 * a + 1] * x[3 * b + 1]
        S[a, a] += wander[a]


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
    scale = 1 / det if det > 0 else 0.0
    for a in range(3):
        for b in range(a, 3):
            V[a, b] *= scale
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
    weights: Floats | None,
    measured: _Measured,
    nis: Floats,
) -> None:
    """Write the measurement update (fig 6.9) of every track that took a segment into its arrays, and its NIS.

    took (N,): index of the segment, -1 for none; weights (N, M): probability of each segment for the tracks that take
    several.
    """
    room = _room()
    for i in range(took.size):
        j, nis[i] = took[i], np.nan
        if weights is not None and _any(weights[i]):
            _blend(state[i], covariance[i], weights[i], measured, measured[4][i])
            continue
        if j >= 0:
            z, R, wander = measured[0][j], measured[1][j], measured[4][i]
            squared, _ = _correct(state[i], covariance[i], z, R, measured[2], wander, room)
            if measured[3][j] > 0:
                nis[i] = squared


@njit(cache=True, nogil=True)
def _blend(x: Floats, P: Floats, weights: Floats, measured: _Measured, wander: Floats) -> None:
    """Update one track (9,), (9, 9) by several segments: mean and covariance of the mixture of their updates.

    Each segment has a covariance of its own, so there is no one gain as in Bar-Shalom's form of the update, with which
    this agrees where all are alike; the spread of the innovations is that of the updated means.
    """
    n, m, room = weights.size, 1, _room()
    for j in range(n):
        m += weights[j] > 0
    share, states, covariances = np.empty(m), np.empty((m, 9)), np.empty((m, 9, 9))
    share[0], m = 1.0, 1
    _copy(x, P, states[0], covariances[0])
    for j in range(n):
        if weights[j] > 0:
            share[m] = weights[j]
            share[0] = max(share[0] - weights[j], 0.0)
            _copy(x, P, states[m], covariances[m])
            _correct(states[m], covariances[m], measured[0][j], measured[1][j], measured[2], wander, room)
            m += 1
    _moments(share, states, covariances, x, P)


@njit(cache=True, nogil=True)
def _room() -> _Room:
    """Return what `_correct` computes in: made once, because making it takes as long as an update."""
    return np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 9))


@njit(cache=True, nogil=True)
def _correct(
    x: Floats, P: Floats, z: Floats, R: Floats, time_variance: float, wander: Floats, room: _Room
) -> tuple[float, float]:
    """Update one state by one measurement in place; return the squared distance of the two and det S.

    room: (3, 3), (3, 3), (3, 9) to compute in.
    """
    S, V, W = room
    _innovation_covariance(x, P, R, time_variance, wander, S)
    determinant = _invert(S, V)
    squared = _squared_distance(x, V, z)
    u, v, w = z[0] - x[0], z[1] - x[3], z[2] - x[6]
    for b in range(9):
        W[0, b], W[1, b], W[2, b] = P[0, b], P[3, b], P[6, b]  # H P
    for a in range(9):
        p0, p1, p2 = W[0, a], W[1, a], W[2, a]
        k0 = p0 * V[0, 0] + p1 * V[1, 0] + p2 * V[2, 0]
        k1 = p0 * V[0, 1] + p1 * V[1, 1] + p2 * V[2, 1]
        k2 = p0 * V[0, 2] + p1 * V[1, 2] + p2 * V[2, 2]
        x[a] += k0 * u + k1 * v + k2 * w
        for b in range(9):  # P - K S K', whole rows: so they are computed several at once
            P[a, b] -= k0 * W[0, b] + k1 * W[1, b] + k2 * W[2, b]
    for a in range(9):
        for b in range(a):
            P[a, b] = P[b, a]
    return squared, determinant


@njit(cache=True, nogil=True)
def largest(values: Floats) -> int:
    """Return the index of the largest value, of the first of several."""
    best = 0
    for k in range(1, values.size):
        if values[k] > values[best]:
            best = k
    return best
