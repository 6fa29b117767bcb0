"""The Kalman filter of all tracks at once (König 2008, section 6.4.3): kernels on arrays that the caller made."""

import math

import numpy as np
from numba import njit

from rangecam.tracking.association import NO_PAIR
from rangecam.types import Floats, Ints


@njit(cache=True, nogil=True)
def predict_and_gate(
    old: tuple[Floats, Floats],
    model: tuple[Floats, Floats],
    seen: tuple[Floats, Floats, Floats],
    noise: tuple[float, float, float],
    gate: float,
    new: tuple[Floats, Floats, Floats, Floats],
) -> None:
    """Predict tracks, complete the covariances of what was measured, and say which belongs to which at what cost.

    old: states (N, 9) and covariances (N, 9, 9); model: F and Q of one axis (3, 3); seen: positions (M, 3), their
    covariances (M, 3, 3) and the sizes of the objects (M, 3); noise: variance of every position, of the centroid as a
    share of the squared size, of the time. gate: largest squared Mahalanobis distance.
    Written into new: predicted states and covariances, R (M, 3, 3), and the cost of each pairing (N, M).
    """
    x, P, R, cost = new
    z, covariance, size = seen
    common, extent, time_variance = noise
    for j in range(size.shape[0]):
        for a in range(3):
            for b in range(3):
                R[j, a, b] = covariance[j, a, b]
            R[j, a, a] += common + extent * size[j, a] ** 2
    _predict(old[0], old[1], model, x, P)
    _gate(x, P, (z, R, time_variance), gate, cost)


@njit(cache=True, nogil=True)
def _predict(state: Floats, covariance: Floats, model: tuple[Floats, Floats], x: Floats, P: Floats) -> None:
    """Write F x and F P F' + Q (König 2008, fig 6.8) into x and P, block by block; all of F is upper triangular."""
    F, Q = model
    t, f, r = F[0, 1], F[0, 2], F[1, 2]
    d = F[2, 2]
    for i in range(state.shape[0]):
        for a in (0, 3, 6):
            x[i, a] = state[i, a] + t * state[i, a + 1] + f * state[i, a + 2]
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
                    P[i, a + b, a + c] += Q[b, c]
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
def update(state: Floats, covariance: Floats, took: Ints, measured: tuple[Floats, Floats, float], nis: Floats) -> None:
    """Write the measurement update (fig 6.9) of every track that took a segment into its arrays, and its NIS.

    took (N,): index of the segment, -1 for none; measured: positions, R, variance of the time.
    """
    S, V, W, K = np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 3)), np.empty((9, 3))
    for i in range(took.size):
        nis[i] = np.nan
        if took[i] < 0:
            continue
        x, P, z = state[i], covariance[i], measured[0][took[i]]
        _innovation_covariance(x, P, measured[1][took[i]], measured[2], S)
        _invert(S, V)
        nis[i] = _squared_distance(x, V, z)
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
