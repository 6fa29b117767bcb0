"""How the states of the tracks move on from one frame to the next, as loops over arrays that the caller made."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.types import Floats

Turning = tuple[Floats, Floats, Floats, Floats, Floats]
"""F, dF, J, a product and a slope, to compute in."""
Shares = tuple[float, float]
"""Of Q along our way, which the lateral and the vertical axis have."""


@kernel
def drift(T: float, rules: Floats) -> float:
    """Return the variance by which an error of the position that lasts, but not forever, changes within T."""
    return -2 * rules[1] * math.expm1(-T / rules[19]) if rules[19] > 0 else 0.0


@kernel
def predict(
    state: Floats, covariance: Floats, model: Floats, shares: Shares, scale: float, x: Floats, P: Floats
) -> None:
    """Write F x and F P F' + Q (König 2008, fig 6.8) into x and P, block by block; all of F is upper triangular.

    shares: see `Shares`; scale: factor of the track's Q.
    """
    F, Q = model[0], model[1]
    f = F[0, 1], F[0, 2], F[1, 2], F[2, 2]
    for a in (0, 3, 6):
        x[a], x[a + 1], x[a + 2] = _moved(f, state[a], state[a + 1], state[a + 2])
        share = scale * (1.0 if a == 0 else shares[0] if a == 3 else shares[1])
        for b in range(a, 9, 3):  # numbers in registers: through arrays it would take longer
            p00, p10, p20 = _moved(f, covariance[a, b], covariance[a + 1, b], covariance[a + 2, b])
            p01, p11, p21 = _moved(f, covariance[a, b + 1], covariance[a + 1, b + 1], covariance[a + 2, b + 1])
            p02, p12, p22 = _moved(f, covariance[a, b + 2], covariance[a + 1, b + 2], covariance[a + 2, b + 2])
            p00, p01, p02 = _moved(f, p00, p01, p02)
            p10, p11, p12 = _moved(f, p10, p11, p12)
            p20, p21, p22 = _moved(f, p20, p21, p22)
            if a == b:
                p00, p01, p02 = p00 + share * Q[0, 0], p01 + share * Q[0, 1], p02 + share * Q[0, 2]
                p11, p12, p22 = p11 + share * Q[1, 1], p12 + share * Q[1, 2], p22 + share * Q[2, 2]
                p10, p20, p21 = p01, p02, p12
            P[a, b], P[a, b + 1], P[a, b + 2] = p00, p01, p02
            P[a + 1, b], P[a + 1, b + 1], P[a + 1, b + 2] = p10, p11, p12
            P[a + 2, b], P[a + 2, b + 1], P[a + 2, b + 2] = p20, p21, p22
    for a in range(3, 9):
        for b in range(a):
            P[a, b] = P[b, a]


@kernel
def _moved(f: tuple[float, float, float, float], p: float, v: float, a: float) -> tuple[float, float, float]:
    """Return F (p, v, a), given what of F is neither 0 nor 1."""
    return p + f[0] * v + f[1] * a, v + f[2] * a, f[3] * a


@kernel
def predict_turning(
    state: Floats,
    covariance: Floats,
    model: Floats,
    shares: Shares,
    scale: float,
    own: Floats,
    x: Floats,
    P: Floats,
    room: Turning,
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
                total += scale * (1.0 if a < 3 else shares[0] if a < 6 else shares[1]) * model[1, a % 3, b % 3]
            P[a, b], P[b, a] = total, total


@kernel
def turning_room() -> Turning:
    """Return what `predict_turning` computes in."""
    return np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 9)), np.empty(9)


@kernel
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
