"""Where things are: position, velocity and acceleration as exact functions of time."""

from functools import lru_cache
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
    times, positions, velocities = _knots(path)
    k = int(np.searchsorted(times, time_s, side="right")) - 1
    if k < 0 or k == len(times) - 1:
        k = max(k, 0)
        return Motion(positions[k] + velocities[k] * (time_s - times[k]), velocities[k], np.zeros(3))
    length = times[k + 1] - times[k]
    t = time_s - times[k]
    mean = (positions[k + 1] - positions[k]) / length
    # p + v t + a t^2 + b t^3 that meets place and velocity at both ends
    a = (3 * mean - 2 * velocities[k] - velocities[k + 1]) / length
    b = (velocities[k] + velocities[k + 1] - 2 * mean) / length**2
    return Motion(
        positions[k] + t * (velocities[k] + t * (a + t * b)),
        velocities[k] + t * (2 * a + t * 3 * b),
        2 * a + t * 6 * b,
    )


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


@settings
class EgoPhase:
    """A time of constant acceleration of the own vehicle."""

    duration_s: Positive
    """How long it lasts."""
    acceleration_mps2: float = 0.0
    """Forward; negative brakes, down to standstill and no further."""


@settings
class EgoMotion:
    """How the own vehicle drives: straight along x, from x = 0 at time 0."""

    speed_mps: NonNegative = 0.0
    """Speed at time 0."""
    phases: tuple[EgoPhase, ...] = ()
    """Accelerations, one after the other; the speed stays as it is afterwards."""


@lru_cache(maxsize=64)
def ego_path(ego: EgoMotion) -> Path:
    """Return the path of the own vehicle: as its phases say, but it stops when its speed reaches zero."""
    speed, phases = ego.speed_mps, []
    for phase in ego.phases:
        a, duration = phase.acceleration_mps2, phase.duration_s
        moving = min(duration, -speed / a) if a < 0 else duration
        if moving > 0:
            phases.append(Phase(duration_s=moving, acceleration_mps2=(a, 0.0, 0.0)))
        if moving < duration:
            phases.append(Phase(duration_s=duration - moving))
        speed = max(speed + a * moving, 0.0) if moving == duration else 0.0
    return Path(velocity_mps=(ego.speed_mps, 0.0, 0.0), phases=tuple(phases))
