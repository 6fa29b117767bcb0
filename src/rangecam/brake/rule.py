"""When an object in the path demands braking: Steinbäck 2016, sections 3.4.1 and 4.5.4. Numbers in, yes or no out."""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

from rangecam.collision import CorridorSettings
from rangecam.settings import Fraction, NonNegative, Positive, settings

GRAVITY_MPS2 = 9.81


@settings
class DecisionSettings:
    """When to brake."""

    corridor: CorridorSettings = CorridorSettings()
    rule: Literal["stopping_distance"] = "stopping_distance"
    """What demands braking, a key of `brake.rule.RULES`."""
    reaction_time_s: NonNegative = 4 / 30 + 0.1
    """From exposure to the brakes biting: four frame periods and 0.1 s (eq 4.1 corrected by E-S-06, 30 frames/s)."""
    friction: Positive = 0.3
    """Between tyre and ground (mu of eq 3.3): 0.3 PVC floor, 0.7 dry asphalt."""
    deceleration_mps2: Positive | None = None
    """Of full braking; none: friction times g."""
    margin: Positive = 1.5
    """Braking begins at this multiple of the stopping distance."""
    min_speed_mps: NonNegative = 0.5
    """At or below this speed there is no emergency braking."""
    min_object_m: Positive = 0.1
    """An object must be seen with the pixels of a square with this side (min_area of algorithm 4.4) ..."""
    large_object_px: NonNegative = 750.0
    """... or with more pixels than this ..."""
    min_object_px: NonNegative = 10.0
    """... and always with more than this."""
    pixel_pitch_deg: Positive = 0.5
    """Angle between neighbouring pixels (geometric mean of both directions); a loaded configuration takes it from the
    camera's lens and size."""
    min_probability: Fraction = 0.5
    """An object beside the corridor counts if it will collide with at least this probability."""
    speed_sigmas: NonNegative = 2.0
    """A closing speed counts if it exceeds zero by this many standard deviations; one that differs by less from the
    own speed is that of a standing object."""


class Threat(NamedTuple):
    """What the rule needs to know of one object in the path."""

    distance_m: float
    """Free way to its nearest surface."""
    closing_speed_mps: float
    n_pixels: float


def must_brake(threat: Threat, own_speed_mps: float, forward: bool, settings: DecisionSettings) -> bool:
    """Return whether an object in the path demands emergency braking (Steinbäck 2016, algorithm 4.4)."""
    object_mps = own_speed_mps - threat.closing_speed_mps
    return (
        threat.closing_speed_mps > 0
        and threat.distance_m < settings.margin * stopping_distance(own_speed_mps, object_mps, settings)
        and is_object(threat, settings)
        and own_speed_mps > settings.min_speed_mps
        and forward
    )


RULES: dict[str, Callable[[Threat, float, bool, DecisionSettings], bool]] = {"stopping_distance": must_brake}
"""Brake rules by name: (object in the path, own speed, driving forward, settings) -> brake."""


def stopping_distance(speed_mps: float, object_mps: float, settings: DecisionSettings) -> float:
    """Return the free way in m, from the exposure of an image on, that stopping before an object takes.

    For a standing object that is reaction and braking (eq 3.1 to 3.3, 4.2). One that drives ahead at `object_mps`
    may begin to brake as hard as we do; one that comes towards us (negative) is expected to come on.
    """
    deceleration = full_deceleration(settings)
    own_m = speed_mps * settings.reaction_time_s + speed_mps**2 / (2 * deceleration)
    if object_mps >= 0:
        return own_m - object_mps**2 / (2 * deceleration)
    return own_m - object_mps * (settings.reaction_time_s + speed_mps / deceleration)


def full_deceleration(settings: DecisionSettings) -> float:
    """Return the deceleration of full braking in m/s2: as set, else mu g."""
    return settings.friction * GRAVITY_MPS2 if settings.deceleration_mps2 is None else settings.deceleration_mps2


def needed_deceleration(distance_m: float, speed_mps: float, settings: DecisionSettings) -> float:
    """Return the deceleration in m/s2 that ends closing in at this speed within the distance; inf if none does.

    It begins after the reaction time; the object keeps its speed.
    """
    way_m = distance_m - speed_mps * settings.reaction_time_s
    if speed_mps <= 0:
        return 0.0
    return speed_mps**2 / (2 * way_m) if way_m > 0 else math.inf


def is_object(threat: Threat, settings: DecisionSettings) -> bool:
    """Return whether an object is seen with enough pixels not to be noise (the area conditions of algorithm 4.4)."""
    pitch_m = threat.distance_m * math.radians(settings.pixel_pitch_deg)
    min_area_px = (settings.min_object_m / pitch_m) ** 2 if pitch_m > 0 else math.inf
    large = threat.n_pixels > min_area_px or threat.n_pixels > settings.large_object_px
    return large and threat.n_pixels > settings.min_object_px
