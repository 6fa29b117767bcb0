"""Automatic distance control (S-FUT-04): as fast as set, but never nearer to the car ahead than a gap in time."""

import math
from typing import NamedTuple

from rangecam.collision import CorridorSettings, look_ahead
from rangecam.settings import Fraction, NonNegative, Positive, settings
from rangecam.types import Ego, Frame


@settings
class DistanceControl:
    """How to follow."""

    set_speed_mps: NonNegative
    """Never driven faster."""
    corridor: CorridorSettings = CorridorSettings()
    """Where the car ahead is looked for."""
    min_probability: Fraction = 0.5
    """One beside the corridor counts if it will be in the way with at least this probability."""
    time_gap_s: Positive = 1.8
    """The car ahead passes a place so long before us ..."""
    standstill_m: NonNegative = 2.0
    """... with this much between us when both stand."""
    gap_gain_hz2: Positive = 0.25
    """Acceleration for each metre of gap that is too much."""
    speed_gain_hz: Positive = 0.9
    """Acceleration for each m/s of difference in speed; with the gain above 0.25 the gap settles without overshoot."""
    max_acceleration_mps2: Positive = 1.5
    max_deceleration_mps2: Positive = 3.0
    """Comfortable; what needs more is the emergency brake's."""
    jerk_mps3: Positive = 3.0
    """How fast the acceleration may rise; it may fall at once."""


class Wish(NamedTuple):
    """What distance control wants: acceleration, and of which track (0: none ahead), with the gap to it."""

    acceleration_mps2: float
    track_id: int
    gap_m: float


def keep_distance(frame: Frame, ego: Ego, before: Wish | None, elapsed_s: float, settings: DistanceControl) -> Wish:
    """Return the acceleration that keeps speed and distance: the smaller of the one for each.

    For the gap g, the speeds v of us and u of the car ahead: k (g - g0 - T v) + c (u - v). ego: with its speed;
    without, nothing but slowing down is asked for. before, elapsed_s: the last wish and the time since.
    """
    speed = ego.speed_mps if ego.speed_mps is not None and math.isfinite(ego.speed_mps) else None
    if speed is None:
        return Wish(-settings.max_deceleration_mps2, 0, math.inf)
    free = settings.speed_gain_hz * (settings.set_speed_mps - speed)
    wanted, track_id, gap_m = free, 0, math.inf
    _, in_path = look_ahead(frame.tracks, ego, settings.corridor, settings.min_probability)
    for each in in_path:
        gap = each.distance_m - settings.standstill_m - settings.time_gap_s * speed
        following = settings.gap_gain_hz2 * gap + settings.speed_gain_hz * each.speed_x_mps
        if following < wanted or track_id == 0:
            track_id, gap_m = int(each.track_id), each.distance_m
        wanted = min(wanted, following)
    last = 0.0 if before is None else before.acceleration_mps2
    smooth = min(wanted, last + settings.jerk_mps3 * elapsed_s, settings.max_acceleration_mps2)
    return Wish(max(smooth, -settings.max_deceleration_mps2), track_id, gap_m)
