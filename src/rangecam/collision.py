"""Which tracks will hit us, when, and how sure that is."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from rangecam.settings import Positive, settings
from rangecam.types import Collisions, Ego, Floats, Ints, Tracks, TrackStatus

_TENTATIVE = int(TrackStatus.TENTATIVE)


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


class InPath(NamedTuple):
    """A confirmed track that is in the corridor or will be when it reaches us."""

    distance_m: float
    """Free way to its nearest surface."""
    speed_x_mps: float
    """Relative to us."""
    speed_sigma_mps: float
    n_pixels: float
    track_id: float
    class_index: float
    """Of the most probable of `CLASSES`."""
    ttc_s: float
    ttc_sigma_s: float
    p_collision: float


_COLUMNS = len(InPath._fields)


def look_ahead(
    tracks: Tracks, ego: Ego, settings: CorridorSettings, min_probability: float
) -> tuple[Collisions, list[InPath]]:
    """Return the collision of every track with us (K-CLS-03, K-CLS-04), and the tracks in the path, nearest first.

    The nearest surface of the object lies d = x - near_offset_m - front_m ahead. It reaches us at the smallest
    positive root t of d + v t + a t^2 / 2 (König 2008, eq 6.49 corrected by E-K-24; the tracks' axes are fixed to the
    vehicle, so v and a are relative already). Its sigma comes from the track's covariance by error propagation. An
    object that overlaps our front now collides at t = 0; one that lies behind it never.

    p_collision: probability that the surface arrives within the horizon times that of the object then overlapping the
    corridor. In a turn the corridor bends with the yaw rate; where the own speed is unknown, as for a standing object.

    In the path: confirmed tracks, also while they coast through missed frames, that overlap the corridor now or will
    collide with at least `min_probability`, and are not behind our front.
    """
    n = tracks.status.size
    new, path = np.empty((4, n)), np.empty((n, _COLUMNS))
    turning = float(ego.yaw_rate_radps), math.nan if ego.speed_mps is None else float(ego.speed_mps)
    # fmt: off
    found = _look_ahead(
        tracks.status, tracks.state, tracks.covariance, tracks.size_m, tracks.near_offset_m,
        tracks.n_pixels, tracks.track_id, tracks.class_probability,
        _limits(settings), float(min_probability), *turning, new, path,
    )
    # fmt: on
    return Collisions(new[0], new[1], new[2], new[3]), [InPath(*row) for row in path[:found].tolist()]


@lru_cache(maxsize=16)
def _limits(settings: CorridorSettings) -> Floats:
    """Return what `_look_ahead` is told by the settings, as one array: each further argument costs every frame."""
    return np.array([settings.width_m, settings.front_m, settings.horizon_s, float(settings.use_acceleration)])


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
def _look_ahead(
    status: Ints,
    state: Floats,
    covariance: Floats,
    size: Floats,
    near_offset: Floats,
    n_pixels: Floats,
    track_id: Ints,
    class_probability: Floats,
    limits: Floats,
    min_probability: float,
    yaw_rate: float,
    speed: float,
    new: Floats,
    path: Floats,
) -> int:
    """Write the collisions (4, N), and those in the path into the first rows of path; return how many these are."""
    width, front, horizon, use_a = limits[0], limits[1], limits[2], limits[3]
    found = 0
    for i in range(status.size):
        x, P = state[i], covariance[i]
        distance = x[0] - near_offset[i] - front
        behind = distance + max(size[i, 0], near_offset[i]) <= 0
        half = (width + size[i, 1]) / 2
        bend = _bend(x[1], yaw_rate, speed)
        t, t_sigma, y, p = _collision(x, P, distance, behind, half, horizon, use_a, bend)
        new[0, i], new[1, i], new[2, i], new[3, i] = t, t_sigma, y, p
        inside = abs(x[3]) <= half or p >= min_probability
        if inside and not behind and distance < math.inf and status[i] != _TENTATIVE:
            at = found
            while at > 0 and path[at - 1, 0] > distance:  # keeps the nearest first
                path[at] = path[at - 1]
                at -= 1
            row, sigma = path[at], math.sqrt(P[1, 1])
            row[0], row[1], row[2], row[3], row[4] = distance, x[1], sigma, n_pixels[i], track_id[i]
            row[5], row[6], row[7], row[8] = np.argmax(class_probability[i]), t, t_sigma, p
            found += 1
    return found


@njit(cache=True, nogil=True)
def _collision(
    x: Floats, P: Floats, distance: float, behind: bool, half: float, horizon: float, use_a: float, bend: float
) -> tuple[float, float, float, float]:
    """Return time, its sigma, lateral position and probability of the collision of one track."""
    v, a, a_y = x[1], use_a * x[2], use_a * x[5] + bend
    t = math.inf if behind else time_to_reach(distance, v, a)
    t_sigma = lateral = math.nan
    t_x = t_v = t_a = 0.0  # derivatives of t: from d + v t + a t^2/2 = 0
    if 0 < t < math.inf:
        slope = v + a * t
        t_x, t_v, t_a = -1 / slope, -t / slope, -use_a * t * t / 2 / slope
        t_sigma = _sigma(P, (t_x, t_v, t_a), (0.0, 0.0, 0.0))
    if t < math.inf:
        lateral = _at(x[3], x[4], a_y, t)
    if behind:
        return t, t_sigma, lateral, 0.0
    arrives = 1.0 if t == 0 else _p_arrival(x, P, distance, a, horizon, use_a)
    at = min(t, horizon)
    y, v_y = _at(x[3], x[4], a_y, at), x[4] + a_y * at
    later = v_y if t <= horizon else 0.0  # a later arrival shifts it sideways
    sigma = _sigma(P, (later * t_x, later * t_v, later * t_a), (1.0, at, use_a * at * at / 2))
    return t, t_sigma, lateral, arrives * (_normal((half - y) / sigma) - _normal((-half - y) / sigma))


@njit(cache=True, nogil=True)
def _at(x: float, v: float, a: float, t: float) -> float:
    return x + v * t + a * t * t / 2


@njit(cache=True, nogil=True)
def _bend(v: float, yaw_rate: float, speed: float) -> float:
    """Return the lateral acceleration, in turning axes, of an object that moves straight on: Coriolis minus our own."""
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
