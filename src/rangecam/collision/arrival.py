"""When an object gets somewhere along one axis, and how sure that is. Loops over arrays that the caller made."""

import math

import numpy as np

from rangecam.collision.gaussian import cholesky, normal
from rangecam.compiled import kernel
from rangecam.types import Floats

_NEVER = 1e-9  # closing rate, 1/s: what takes decades to come does not come


@kernel
def time_to_reach(distance_m: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Return the smallest t >= 0 with distance + speed t + acceleration t^2 / 2 <= 0, inf if there is none (E-K-24)."""
    if distance_m <= 0:
        return 0.0
    discriminant = speed_mps * speed_mps - 2 * acceleration_mps2 * distance_m
    if not discriminant >= 0:
        return math.inf
    denominator = math.sqrt(discriminant) - speed_mps  # this form of the root needs no case for acceleration 0
    return 2 * distance_m / denominator if denominator > _NEVER * distance_m else math.inf


@kernel
def moved(x: float, v: float, a: float, t: float) -> float:
    """Return where something is after t, with steady acceleration."""
    return x + v * t + a * t * t / 2


@kernel
def axis_variance(P: Floats, base: int, t: float, limits: Floats) -> tuple[float, float, float]:
    """Return the variances of distance, of both, of speed; base: 0 along, 3 across.

    What the speed drifts until t moves the object by a variance of q t^3 / 3 (`motion.constant_velocity`), as if the
    speed were so much less certain now.
    """
    fixed = limits[7] if base == 0 else limits[8] ** 2 / 4
    dd, vv = max(P[base, base] + fixed, 0.0), max(P[base + 1, base + 1] + limits[6] * t / 3, 0.0)
    most = math.sqrt(dd * vv)
    return dd, min(max(P[base, base + 1], -most), most), vv


@kernel
def time_sigma(
    variance: tuple[float, float, float], P: Floats, base: int, t: float, v: float, a: float, use_a: float
) -> float:
    """Return the standard deviation of the time by error propagation: from d + v t + a t^2/2 = 0."""
    slope = v + a * t
    c = use_a * t * t / 2
    total = variance[0] + 2 * t * variance[1] + t * t * variance[2]
    total += 2 * c * (P[base, base + 2] + t * P[base + 1, base + 2]) + c * c * P[base + 2, base + 2]
    return math.sqrt(max(total, 0.0)) / abs(slope) if slope != 0 else math.inf


@kernel
def quantiles(
    motion: tuple[float, float, float],
    variance: tuple[float, float, float],
    source: tuple[Floats, int, float],
    comes: bool,
    points: Floats,
    z: Floats,
    lag: float,
    new: Floats,
) -> None:
    """Write the quantiles of the time in which d + v t + a t^2/2 reaches 0; motion: d, v, a; z: in ascending order."""
    d, v, a = motion
    if not comes:
        new[:] = math.inf
    elif a == 0 and source[2] == 0:
        before = 0.0
        for k in range(z.size):  # in order, where rounding takes one root for the other
            new[k] = max(arrival_quantile(d, v, variance, z[k]) - lag, before)
            before = new[k]
    else:
        _sampled_quantiles(motion, variance, source, points, z, lag, new)


@kernel
def arrival_quantile(d: float, v: float, variance: tuple[float, float, float], z: float) -> float:
    """Return t with Phi(-(d + v t) / s(t)) = Phi(z), s(t)^2 the variance of d + v t; inf where it never gets there.

    d + v t = -z s(t), squared, is a quadratic equation; of its roots, that with the sign of -z on the left counts. Its
    discriminant is written so that what b^2 and a c have in common, almost all where s is small, is not subtracted.
    """
    dd, dv, vv = variance
    if d + z * math.sqrt(max(dd, 0.0)) <= 0:  # already here
        return 0.0
    a, b, c = v * v - z * z * vv, d * v - z * z * dv, d * d - z * z * dd
    if z == 0:
        return -d / v if v < -_NEVER * d else math.inf
    discriminant = z * z * (v * v * dd + d * d * vv - 2 * d * v * dv - z * z * max(dd * vv - dv * dv, 0.0))
    if discriminant < 0:
        return math.inf
    root = math.sqrt(discriminant)
    q = -b - root if b > 0 else -b + root  # both roots without cancellation
    best = math.inf
    for t in (q / a if a != 0 else math.inf, c / q if q != 0 else math.inf):
        rounding = 1e-12 * abs(z) * (abs(d) + abs(v * t))
        if 0 <= t < best and (d + v * t) * z <= rounding and t < 1 / _NEVER:
            best = t
    return best


@kernel
def _sampled_quantiles(
    motion: tuple[float, float, float],
    variance: tuple[float, float, float],
    source: tuple[Floats, int, float],
    points: Floats,
    z: Floats,
    lag: float,
    new: Floats,
) -> None:
    P, base, use_a = source
    block = np.zeros((3, 3))
    block[0, 0], block[1, 0], block[1, 1] = variance[0], variance[1], variance[2]
    if use_a != 0:
        block[2, 0], block[2, 1], block[2, 2] = P[base, base + 2], P[base + 1, base + 2], P[base + 2, base + 2]
    cholesky(block)
    n = points.shape[0]
    times = np.empty(n)
    for k in range(n):
        e = points[k]
        d = motion[0] + block[0, 0] * e[0]
        v = motion[1] + block[1, 0] * e[0] + block[1, 1] * e[1]
        a = motion[2] + block[2, 0] * e[0] + block[2, 1] * e[1] + block[2, 2] * e[2]
        times[k] = time_to_reach(d, v, a)
    times.sort()
    for k in range(z.size):
        place = min(max(normal(z[k]) * n - 0.5, 0.0), n - 1.0)
        low = int(place)
        high, part = min(low + 1, n - 1), place - low
        if math.isfinite(times[high]):
            new[k] = max(times[low] + part * (times[high] - times[low]) - lag, 0.0)
        else:
            new[k] = max(times[low if part < 0.5 else high] - lag, 0.0)
