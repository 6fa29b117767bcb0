"""When an object in the path demands braking: rules by name. Numbers in, yes or no out.

- stopping_distance: Steinbäck 2016, sections 3.4.1 and 4.5.4
- collision_probability: from the distribution of distance and speed (`brake.probability`)
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from rangecam.brake.probability import p_too_late
from rangecam.brake.settings import GRAVITY_MPS2, DecisionSettings, full_deceleration

__all__ = ["GRAVITY_MPS2", "RULES", "DecisionSettings", "Threat", "full_deceleration", "must_brake"]


class Threat(NamedTuple):
    """What the rules need to know of one object in the path."""

    distance_m: float
    """Free way to its nearest surface."""
    closing_speed_mps: float
    """At which the gap shrinks, as far as that is certain (`decision.closing_speed`)."""
    n_pixels: float
    speed_mps: float = math.nan
    """At which the gap shrinks, by the track alone; NaN: `closing_speed_mps`."""
    distance_sigma_m: float = 0.0
    speed_sigma_mps: float = 0.0
    covariance: float = 0.0
    """Of distance and this speed, m2/s."""
    braking_mps2: float = 0.0
    """Deceleration over ground that the object surely has."""
    p_lateral: float = 1.0
    """Probability that it hits us if it gets as far as our front."""
    hits: float = math.inf
    """Frames in which it was seen."""
    age: float = 1.0
    """Frames since its first, which counts."""


def must_brake(threat: Threat, own_speed_mps: float, forward: bool, settings: DecisionSettings) -> bool:
    """Return whether an object in the path demands emergency braking (Steinbäck 2016, algorithm 4.4).

    Nothing beyond the camera's range does: there the distance can only be wrong (E-S-21, N-S-017).
    """
    object_mps = own_speed_mps - threat.closing_speed_mps
    return (
        threat.closing_speed_mps > 0
        and threat.distance_m < settings.margin * stopping_distance(own_speed_mps, object_mps, settings)
        and _may_brake(threat, own_speed_mps, forward, settings)
    )


def must_brake_surely(threat: Threat, own_speed_mps: float, forward: bool, settings: DecisionSettings) -> bool:
    """Return whether braking one frame later is too late, but for a probability of `false_brake_probability`.

    Derived in docs/decision.md. The speed is that of the track, with its covariance: a new track, which may as well
    move away, brakes for nothing.
    """
    return (
        _may_brake(threat, own_speed_mps, forward, settings)
        and too_late(threat, own_speed_mps, settings) >= 1 - settings.false_brake_probability
    )


def too_late(threat: Threat, own_speed_mps: float, settings: DecisionSettings) -> float:
    """Return the probability that braking from the next frame on leaves less than `standstill_gap_m` to an object."""
    speed = threat.closing_speed_mps if math.isnan(threat.speed_mps) else threat.speed_mps
    gap_m = threat.distance_m - settings.standstill_gap_m
    spread = threat.distance_sigma_m, threat.speed_sigma_mps, threat.covariance
    own = own_speed_mps, full_deceleration(settings), settings.deceleration_sigma * full_deceleration(settings)
    delay_s = settings.reaction_time_s + settings.frame_period_s
    return threat.p_lateral * p_too_late(gap_m, speed, spread, threat.braking_mps2, own, delay_s)


Rule = Callable[[Threat, float, bool, DecisionSettings], bool]
RULES: dict[str, Rule] = {"stopping_distance": must_brake, "collision_probability": must_brake_surely}
"""Brake rules by name: (object in the path, own speed, driving forward, settings) -> brake."""


def keeps_braking(threat: Threat, settings: DecisionSettings) -> bool:
    """Return whether braking that has begun goes on: hysteresis, so that a demand does not flicker at its limit.

    It does while ending closing in within the way that is left needs more than `release_share` of full braking. The
    brakes bite already, so there is no reaction time.
    """
    return _ending(threat.distance_m, threat.closing_speed_mps) > settings.release_share * full_deceleration(settings)


def stopping_distance(speed_mps: float, object_mps: float, settings: DecisionSettings) -> float:
    """Return the free way in m, from the exposure of an image on, that stopping before an object takes.

    For a standing object that is reaction and braking (eq 3.1 to 3.3, 4.2). One that drives ahead at `object_mps`
    may begin to brake as hard as we do; while we are the faster one, the gap shrinks until both stand, so that no
    moment on the way is worse than the end. One that comes towards us (negative) is expected to come on.
    """
    deceleration = full_deceleration(settings)
    own_m = speed_mps * settings.reaction_time_s + speed_mps**2 / (2 * deceleration)
    if object_mps >= 0:
        return own_m - object_mps**2 / (2 * deceleration)
    return own_m - object_mps * (settings.reaction_time_s + speed_mps / deceleration)


def needed_deceleration(distance_m: float, speed_mps: float, settings: DecisionSettings) -> float:
    """Return the deceleration in m/s2 that ends closing in at this speed within the distance; inf if none does.

    It begins after the reaction time; the object keeps its speed.
    """
    return _ending(distance_m - speed_mps * settings.reaction_time_s, speed_mps)


def _ending(way_m: float, speed_mps: float) -> float:
    if speed_mps <= 0:
        return 0.0
    return speed_mps**2 / (2 * way_m) if way_m > 0 else math.inf


def is_object(threat: Threat, settings: DecisionSettings) -> bool:
    """Return whether an object is seen with enough pixels not to be noise (the area conditions of algorithm 4.4)."""
    pitch_m = threat.distance_m * math.radians(settings.pixel_pitch_deg)
    min_area_px = (settings.min_object_m / pitch_m) ** 2 if pitch_m > 0 else math.inf
    large = threat.n_pixels > min_area_px or threat.n_pixels > settings.large_object_px
    return large and threat.n_pixels > settings.min_object_px


def is_seen(threat: Threat, settings: DecisionSettings) -> bool:
    """Return whether an object was seen often enough to be one: most of the time, or for long."""
    return threat.hits >= settings.sure_hits or threat.hits >= settings.min_seen * threat.age


def is_in_range(threat: Threat, settings: DecisionSettings) -> bool:
    """Return whether the camera can measure as far as the object is said to be."""
    return settings.range_m is None or threat.distance_m < settings.range_m


def _may_brake(threat: Threat, own_speed_mps: float, forward: bool, settings: DecisionSettings) -> bool:
    """Return whether nothing but distance and speed is left to speak against braking (algorithm 4.4)."""
    return (
        is_in_range(threat, settings)
        and is_object(threat, settings)
        and is_seen(threat, settings)
        and own_speed_mps > settings.min_speed_mps
        and forward
    )
