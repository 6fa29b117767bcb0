"""The guard that switches the laser off while the vehicle stands (K-ILL-11): nobody looks into it for long."""

import math
from dataclasses import dataclass

from rangecam.settings import NonNegative, Positive, settings
from rangecam.types import Ego


@settings
class LaserGuard:
    """When the laser may be on."""

    standing_mps: NonNegative = 0.5
    """At or below this speed the vehicle stands ..."""
    moving_mps: Positive = 0.8
    """... and at this it moves again; between them it does what it did."""
    off_after_s: NonNegative = 1.0
    """It may be on so long after the vehicle has come to a stop: an emergency brake sees to the end of its braking."""
    max_age_s: Positive = 0.2
    """A speed measured longer ago is not known."""


@dataclass(frozen=True)
class LaserState:
    """on: the laser may be on. moved_s: when the vehicle was last known to move."""

    on: bool = False
    moved_s: float = -math.inf
    moving: bool = False


def guard_laser(ego: Ego, time_s: float, state: LaserState, settings: LaserGuard) -> LaserState:
    """Return whether the laser may be on at `time_s`. A speed that nobody knows, or an old one, is standing."""
    speed = ego.speed_mps
    known = speed is not None and math.isfinite(speed) and 0 <= time_s - ego.time_s <= settings.max_age_s
    moving = known and speed is not None and speed > (settings.standing_mps if state.moving else settings.moving_mps)
    moved_s = time_s if moving else state.moved_s
    return LaserState(time_s - moved_s <= settings.off_after_s, moved_s, moving)
