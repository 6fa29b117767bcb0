"""Which tracks will hit us, when, and how sure that is."""

import math

import numpy as np
from numba import njit

from rangecam.settings import Positive, settings
from rangecam.types import Collisions, Ego, Floats, Tracks


@settings
class CorridorSettings:
    """The space that the vehicle is going to need, in vehicle axes."""

    width_m: Positive = 0.6
    """Width of the vehicle's path, with a margin."""
    front_m: float = 0.0
    """x of the vehicle's foremost point."""
    horizon_s: Positive = 5.0
    """How far ahead collisions are predicted."""
    use_acceleration: bool = False
    """Whether objects are expected to keep their estimated acceleration. It is noisy: at 30 frames a second it takes
    half a second to tell 3 m/s2 from nothing, and meanwhile cries wolf."""


def predict_collisions(tracks: Tracks, ego: Ego, settings: CorridorSettings) -> Collisions:
    """Return time to collision, lateral position then, and collision probability of every track (K-CLS-03, K-CLS-04).

    The nearest surface of the object lies d = x - near_offset_m - front_m ahead. It reaches us at the smallest
    positive root t of d + v t + a t^2 / 2 (König 2008, eq 6.49 corrected by E-K-24; the tracks' axes are fixed to the
    vehicle, so v and a are relative already). Its sigma comes from the track's covariance by error propagation. An
    object that overlaps our front now collides at t = 0; one that lies behind it never.

    p_collision: probability that the surface arrives within the horizon times that of the object then overlapping the
    corridor. In a turn the corridor bends with the yaw rate; where the own speed is unknown, as for a standing object.
    """
    n = len(tracks)
    new = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    shape = tracks.near_offset_m, tracks.size_m
    limits = settings.width_m, settings.front_m, settings.horizon_s, 1.0 if settings.use_acceleration else 0.0
    turning = ego.yaw_rate_radps, math.nan if ego.speed_mps is None else ego.speed_mps
    _predict(tracks.state, tracks.covariance, shape, limits, turning, new)
    return Collisions(*new)


_NEVER = 1e-9  # closing rate, 1/s: what takes decades to come does not come


@njit(cache=True, nogil=True)
def time_to_reach(distance_m: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Return the smallest t >= 0 with distance + speed t + acceleration t^2 / 2 <= 0, inf if there is none (E-K-24)."""
    if distance_m <= 0:
        return 0.0
    discriminant = speed_mps * speed_mps - 2 * acceleration_mps2 * distance_m
    if discriminant < 0:
        return math.inf
    denominator = math.sqrt(discriminant) - speed_mps  # this form of the root needs no case for acceleration 0
    return 2 * distance_m / denominator if denominator > _NEVER * distance_m else math.inf


@njit(cache=True, nogil=True)
def _predict(
    state: Floats,
    covariance: Floats,
    shape: tuple[Floats, Floats],
    limits: tuple[float, float, float, float],
    turning: tuple[float, float],
    new: tuple[Floats, Floats, Floats, Floats],
) -> None:
    ttc, ttc_sigma, lateral, probability = new
    width, front, horizon, use_a = limits
    for i in range(ttc.size):
        x, P, near_offset, size = state[i], covariance[i], shape[0][i], shape[1][i]
        distance, v, a = x[0] - near_offset - front, x[1], use_a * x[2]
        behind = distance + max(size[0], near_offset) <= 0
        t = math.inf if behind else time_to_reach(distance, v, a)
        bend = _bend(v, turning)
        ttc[i], ttc_sigma[i], lateral[i] = t, math.nan, math.nan
        t_x = t_v = t_a = 0.0  # derivatives of t: from d + v t + a t^2/2 = 0
        if 0 < t < math.inf:
            slope = v + a * t
            t_x, t_v, t_a = -1 / slope, -t / slope, -use_a * t * t / 2 / slope
            ttc_sigma[i] = _sigma(P, (t_x, t_v, t_a), (0.0, 0.0, 0.0))
        if t < math.inf:
            lateral[i] = _at(x[3], x[4], use_a * x[5] + bend, t)
        if behind:
            probability[i] = 0.0
            continue
        arrives = 1.0 if t == 0 else _p_arrival(x, P, distance, a, horizon, use_a)
        at = min(t, horizon)
        y, v_y = _at(x[3], x[4], use_a * x[5] + bend, at), x[4] + (use_a * x[5] + bend) * at
        later = v_y if t <= horizon else 0.0  # a later arrival shifts it sideways
        sigma = _sigma(P, (later * t_x, later * t_v, later * t_a), (1.0, at, use_a * at * at / 2))
        half = (width + size[1]) / 2
        probability[i] = arrives * (_normal((half - y) / sigma) - _normal((-half - y) / sigma))


@njit(cache=True, nogil=True)
def _at(x: float, v: float, a: float, t: float) -> float:
    return x + v * t + a * t * t / 2


@njit(cache=True, nogil=True)
def _bend(v: float, turning: tuple[float, float]) -> float:
    """Return the lateral acceleration, in turning axes, of an object that moves straight on: Coriolis minus our own."""
    yaw_rate, speed = turning
    return -2 * yaw_rate * v - yaw_rate * (speed if math.isfinite(speed) else -v)


@njit(cache=True, nogil=True)
def _p_arrival(x: Floats, P: Floats, distance: float, a: float, horizon: float, use_a: float) -> float:
    """Return the probability that the surface has come to us by the horizon, or where it turns back by then."""
    at = min(horizon, -x[1] / a) if a > 0 and x[1] < 0 else horizon
    sigma = _sigma(P, (1.0, at, use_a * at * at / 2), (0.0, 0.0, 0.0))
    return _normal(-_at(distance, x[1], a, at) / sigma)


@njit(cache=True, nogil=True)
def _sigma(P: Floats, g_x: tuple[float, float, float], g_y: tuple[float, float, float]) -> float:
    """Return the standard deviation of a quantity with these derivatives to x, vx, ax and to y, vy, ay."""
    variance = 0.0
    for a in range(3):
        for b in range(3):
            variance += (
                g_x[a] * P[a, b] * g_x[b] + 2 * g_x[a] * P[a, 3 + b] * g_y[b] + g_y[a] * P[3 + a, 3 + b] * g_y[b]
            )
    return max(math.sqrt(max(variance, 0.0)), 1e-12)


@njit(cache=True, nogil=True)
def _normal(u: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-u / math.sqrt(2.0))
