"""Where things are: position, velocity and acceleration as exact functions of time."""

import cmath
import math
from bisect import bisect_right
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rangecam.errors import UsageError
from rangecam.settings import NonNegative, Positive, settings
from rangecam.types import Floats

Vector = tuple[float, float, float]


@settings
class Phase:
    """A time of constant acceleration."""

    duration_s: Positive
    """How long it lasts."""
    acceleration_mps2: Vector = (0.0, 0.0, 0.0)
    """Acceleration along the axes of the ground; zero: keeps its velocity."""


@settings
class WayPoint:
    """A place that is passed at a time with a velocity; two at one place without velocity are a stop."""

    time_s: float
    """When."""
    position_m: Vector
    """Where: x, y, z on the ground's axes."""
    velocity_mps: Vector = (0.0, 0.0, 0.0)
    """How fast, and in which direction."""


@settings
class Path:
    """A motion, told in one of two ways: a start with phases of constant acceleration, or way-points.

    Before its first and after its last moment the velocity stays as it is there.
    """

    start_m: Vector = (0.0, 0.0, 0.0)
    """Position at time 0."""
    velocity_mps: Vector = (0.0, 0.0, 0.0)
    """Velocity at time 0."""
    phases: tuple[Phase, ...] = ()
    """Accelerations, one after the other from time 0."""
    waypoints: tuple[WayPoint, ...] = ()
    """Instead of the three above: places with times, at rising times; between them position is a cubic of time."""


class Motion(NamedTuple):
    """Position m, velocity m/s and acceleration m/s2, each (3,), at one moment."""

    position_m: Floats
    velocity_mps: Floats
    acceleration_mps2: Floats


def motion(path: Path, time_s: float) -> Motion:
    """Return where something on `path` is at `time_s`, and how it moves.

    Between way-points it follows the cubic through both places with both velocities (Hermite), which is the straight
    line at constant velocity or acceleration where the way-points agree with that. Raises UsageError for a path that
    is told both ways or whose times do not rise.
    """
    t, axes = _piece(path, time_s)
    position_m, velocity_mps = place_and_velocity(path, time_s)
    return Motion(np.array(position_m), np.array(velocity_mps), np.array([2 * a + t * 6 * b for _, _, a, b in axes]))


def place(path: Path, time_s: float) -> Vector:
    """Return position m at `time_s`, as `place_and_velocity` does, for what asks for nothing else."""
    return _place(*_piece(path, time_s))


def _place(t: float, axes: "tuple[Cubic, Cubic, Cubic]") -> Vector:
    (x, vx, ax, bx), (y, vy, ay, by), (z, vz, az, bz) = axes
    return x + t * (vx + t * (ax + t * bx)), y + t * (vy + t * (ay + t * by)), z + t * (vz + t * (az + t * bz))


def place_and_velocity(path: Path, time_s: float) -> tuple[Vector, Vector]:
    """Return position m and velocity m/s at `time_s`, as `motion` does, as plain numbers for what asks often."""
    t, axes = _piece(path, time_s)
    (_, vx, ax, bx), (_, vy, ay, by), (_, vz, az, bz) = axes
    velocity_mps = vx + t * (2 * ax + t * 3 * bx), vy + t * (2 * ay + t * 3 * by), vz + t * (2 * az + t * 3 * bz)
    return _place(t, axes), velocity_mps


Cubic = tuple[float, float, float, float]
"""p, v, a, b of p + v t + a t^2 + b t^3."""


def _piece(path: Path, time_s: float) -> tuple[float, tuple[Cubic, Cubic, Cubic]]:
    """Return the time since a piece of the path began, and its cubic along each axis."""
    times, pieces = _pieces(path)
    k = bisect_right(times, time_s)
    return time_s - times[max(k - 1, 0)], pieces[k]


@lru_cache(maxsize=256)
def _pieces(path: Path) -> tuple[list[float], list[tuple[Cubic, Cubic, Cubic]]]:
    """Return the times of the way-points, and the cubics before the first, between each two, and after the last."""
    times, positions, velocities = _knots(path)
    ends = [np.stack([positions[k], velocities[k], np.zeros(3), np.zeros(3)]) for k in (0, -1)]
    between = []
    for k, length in enumerate(np.diff(times)):
        mean = (positions[k + 1] - positions[k]) / length
        # meets place and velocity at both ends
        a = (3 * mean - 2 * velocities[k] - velocities[k + 1]) / length
        b = (velocities[k] + velocities[k + 1] - 2 * mean) / length**2
        between.append(np.stack([positions[k], velocities[k], a, b]))
    rows = [[tuple(axis) for axis in piece.T.tolist()] for piece in (ends[0], *between, ends[1])]
    return times.tolist(), [(x, y, z) for x, y, z in rows]


def stands(path: Path) -> bool:
    """Return whether something on `path` stays where it is for ever."""
    times, _, velocities = _knots(path)
    return len(times) == 1 and not velocities.any()


@lru_cache(maxsize=256)
def _knots(path: Path) -> tuple[Floats, Floats, Floats]:
    """Return times (N,), positions (N, 3) and velocities (N, 3) of the way-points that a path amounts to."""
    if path.waypoints:
        if path != Path(waypoints=path.waypoints):
            raise UsageError("path: way-points stand alone; leave out start_m, velocity_mps and phases")
        times = np.array([w.time_s for w in path.waypoints])
        if np.any(np.diff(times) <= 0):
            raise UsageError(f"path: the times of way-points must rise, they are {', '.join(f'{t:g}' for t in times)}")
        return (
            times,
            np.array([w.position_m for w in path.waypoints]),
            np.array([w.velocity_mps for w in path.waypoints]),
        )
    knots = [(0.0, np.array(path.start_m), np.array(path.velocity_mps))]
    for phase in path.phases:
        time_s, position, velocity = knots[-1]
        dt, a = phase.duration_s, np.array(phase.acceleration_mps2)
        knots.append((time_s + dt, position + velocity * dt + a * dt**2 / 2, velocity + a * dt))
    times, positions, velocities = (np.array(column) for column in zip(*knots, strict=True))
    return times, positions, velocities


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_STANDS_MPS = 1e-6


def travelled_m(path: Path, time_s: float) -> float:
    """Return the length of the way along `path` from its first moment to `time_s`; negative before it.

    The speed is integrated piece by piece with eight Gauss-Legendre nodes: exact while the direction stays.
    """
    times, ways = _ways(path)
    k = max(int(np.searchsorted(times, time_s, side="right")) - 1, 0)
    return float(ways[k] + _way_m(path, times[k], time_s))


@lru_cache(maxsize=256)
def _ways(path: Path) -> tuple[Floats, Floats]:
    times = _knots(path)[0]
    pieces = [_way_m(path, a, b) for a, b in pairwise(times)]
    return times, np.cumsum([0.0, *pieces])


def _way_m(path: Path, from_s: float, to_s: float) -> float:
    half = (to_s - from_s) / 2
    if half == 0 or len(_knots(path)[0]) == 1:
        return 2 * half * math.hypot(*place_and_velocity(path, to_s)[1])
    speeds = [math.hypot(*place_and_velocity(path, from_s + half * (1 + node))[1]) for node in _NODES.tolist()]
    return half * float(_WEIGHTS @ speeds)


def direction_rad(path: Path, time_s: float) -> float:
    """Return the heading of the motion at `time_s`, to the left of x; where it stands, that of the last motion before.

    Before it first moves it is that of the first motion, and 0 if it never moves.
    """
    x, y, _ = place_and_velocity(path, time_s)[1]
    if math.hypot(x, y) > _STANDS_MPS:
        return math.atan2(y, x)
    times, _, _ = _knots(path)
    short = 1e-4 * np.diff(times)
    before = [t for t in np.column_stack([times[:-1] + short, times[1:] - short]).ravel() if t <= time_s]
    after = [t for t in np.column_stack([times[:-1] + short, times[1:] - short]).ravel() if t > time_s]
    for moment in (*before[::-1], *after, times[-1] + 1):
        x, y, _ = place_and_velocity(path, float(moment))[1]
        if math.hypot(x, y) > _STANDS_MPS:
            return math.atan2(y, x)
    return 0.0


@settings
class EgoPhase:
    """A time of constant acceleration and yaw rate of the own vehicle."""

    duration_s: Positive
    """How long it lasts."""
    acceleration_mps2: float = 0.0
    """Forward; negative brakes, down to standstill and no further."""
    yaw_rate_radps: float = 0.0
    """How fast it turns, positive to the left; it turns no more once braking has brought it to standstill."""


@settings
class EgoMotion:
    """How the own vehicle drives: from the origin of the ground's axes at time 0, first along x."""

    speed_mps: NonNegative = 0.0
    """Speed at time 0."""
    phases: tuple[EgoPhase, ...] = ()
    """Accelerations and turns, one after the other; afterwards it goes straight on with the speed that it has."""


class Pose(NamedTuple):
    """Where the own vehicle is on the ground, and how it moves: its speed is along its heading, negative backwards."""

    x_m: float
    y_m: float
    heading_rad: float
    """To the left of the x axis of the ground."""
    speed_mps: float
    yaw_rate_radps: float


OwnMotion = Callable[[float], Pose]
"""An own motion that is decided while the simulation runs: the pose at a time. It is asked for all moments of an
exposure, which lie before and after the time of its frame."""


def ego_pose(ego: EgoMotion, time_s: float) -> Pose:
    """Return where the own vehicle is at `time_s`, and how it moves, as the phases of a scenario say."""
    legs = _legs(ego)
    start_s, pose, acceleration = next(leg for leg in reversed(legs) if leg[0] <= time_s or leg is legs[0])
    if time_s < start_s:  # before time 0 it comes straight
        return _driven(pose._replace(yaw_rate_radps=0.0), 0.0, time_s - start_s)
    return _driven(pose, acceleration, time_s - start_s)


@lru_cache(maxsize=64)
def _legs(ego: EgoMotion) -> list[tuple[float, Pose, float]]:
    """Return the start, the pose there and the acceleration of each time of constant acceleration and yaw rate."""
    time_s, pose, legs = 0.0, Pose(0.0, 0.0, 0.0, ego.speed_mps, 0.0), []
    for phase in ego.phases:
        a, duration_s = phase.acceleration_mps2, phase.duration_s
        moving_s = min(duration_s, -pose.speed_mps / a) if a < 0 else duration_s
        pose = pose._replace(yaw_rate_radps=phase.yaw_rate_radps)
        legs.append((time_s, pose, a))
        pose, time_s = _driven(pose, a, moving_s), time_s + moving_s
        if moving_s < duration_s:
            pose = pose._replace(speed_mps=0.0, yaw_rate_radps=0.0)
            legs.append((time_s, pose, 0.0))
            time_s += duration_s - moving_s
    return [*legs, (time_s, pose._replace(yaw_rate_radps=0.0), 0.0)]


def _driven(pose: Pose, acceleration_mps2: float, seconds: float) -> Pose:
    """Return the pose after driving on: x + iy grows by the integral of (v + a s) exp(i (heading + w s)) over s."""
    v, a, t, turn = pose.speed_mps, acceleration_mps2, seconds, pose.yaw_rate_radps * seconds
    mean, later = _turning(turn)
    moved = cmath.exp(1j * pose.heading_rad) * (v * t * mean + a * t * t * later)
    heading = pose.heading_rad + turn
    return Pose(pose.x_m + moved.real, pose.y_m + moved.imag, heading, v + a * t, pose.yaw_rate_radps)


def _turning(turn_rad: float) -> tuple[complex, complex]:
    """Return the integrals of exp(i u s) and of s exp(i u s) over s from 0 to 1; by their series where u is small."""
    u = 1j * turn_rad
    if abs(turn_rad) < 0.1:
        terms = [u**n / math.factorial(n) for n in range(9)]
        return sum(t / (n + 1) for n, t in enumerate(terms)), sum(t / (n + 2) for n, t in enumerate(terms))
    mean = (cmath.exp(u) - 1) / u
    return mean, (cmath.exp(u) - mean) / u
