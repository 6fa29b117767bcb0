"""When to brake: the stopping distance and the rule of Steinbäck 2016, sections 3.4.1 and 4.5.4."""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from rangecam.collision import CorridorSettings, predict_collisions
from rangecam.settings import Fraction, NonNegative, Positive, settings
from rangecam.types import CLASSES, Collisions, Decision, Ego, Floats, Ints, Tracks, TrackStatus

GRAVITY_MPS2 = 9.81
_TENTATIVE = int(TrackStatus.TENTATIVE)


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
    """Angle between neighbouring pixels (geometric mean of both directions)."""
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
    return (
        threat.distance_m < settings.margin * stopping_distance(threat.closing_speed_mps, settings)
        and is_object(threat, settings)
        and own_speed_mps > settings.min_speed_mps
        and forward
    )


RULES: dict[str, Callable[[Threat, float, bool, DecisionSettings], bool]] = {"stopping_distance": must_brake}
"""Brake rules by name: (object in the path, own speed, driving forward, settings) -> brake."""


def stopping_distance(speed_mps: float, settings: DecisionSettings) -> float:
    """Return the way in m from the exposure of an image to standstill: reaction and braking (eq 3.1 to 3.3, 4.2)."""
    return speed_mps * settings.reaction_time_s + speed_mps**2 / (2 * full_deceleration(settings))


def full_deceleration(settings: DecisionSettings) -> float:
    """Return the deceleration of full braking in m/s2: as set, else mu g."""
    return settings.friction * GRAVITY_MPS2 if settings.deceleration_mps2 is None else settings.deceleration_mps2


def needed_deceleration(distance_m: float, speed_mps: float, settings: DecisionSettings) -> float:
    """Return the deceleration in m/s2 that stops within the distance after the reaction time; inf if none does."""
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


def closing_speed(speed_x_mps: float, sigma_mps: float, ego: Ego, settings: DecisionSettings) -> float:
    """Return the speed in m/s at which the gap to a track shrinks, 0 where it does not or where that is not certain.

    speed_x_mps, sigma_mps: estimate of the track relative to us. With the own speed known, a track whose estimate
    agrees with that of a standing object closes at the own speed, which is better known: so the thesis treats all
    objects. Other than there, one that drives away closes more slowly, one that comes towards us faster.
    """
    closing, tolerance = -speed_x_mps, settings.speed_sigmas * sigma_mps
    if ego.speed_mps is not None and abs(closing - ego.speed_mps) <= tolerance:
        return ego.speed_mps
    return closing if closing > tolerance else 0.0


def decide(tracks: Tracks, ego: Ego, settings: DecisionSettings) -> Decision:
    """Return whether to brake now, for which track, and why (S-DEC-01, S-DEC-02).

    Confirmed tracks count, also while they coast through missed frames, if they are in the path now or will be when
    they reach us. The nearest that demands braking decides, else the nearest. Where the own speed is unknown it is
    taken to be the closing speed.
    """
    collisions = predict_collisions(tracks, ego, settings.corridor)
    distance_m = _free_way(tracks, collisions, settings)
    chosen, brake, threat = -1, False, Threat(math.nan, math.nan, 0.0)
    for i in distance_m.argsort():
        if not distance_m[i] < math.inf:
            break
        sigma_mps = math.sqrt(tracks.covariance[i, 1, 1])
        closing = closing_speed(float(tracks.state[i, 1]), sigma_mps, ego, settings)
        this = Threat(float(distance_m[i]), closing, float(tracks.n_pixels[i]))
        own_speed = closing if ego.speed_mps is None else abs(ego.speed_mps)
        brake = RULES[settings.rule](this, own_speed, ego.forward, settings)
        if brake or chosen < 0:
            chosen, threat = int(i), this
        if brake:
            break
    if chosen < 0:
        return Decision(time_s=tracks.time_s, brake=False, reason="no object in the path", collisions=collisions)
    stopping_m = stopping_distance(threat.closing_speed_mps, settings)
    return Decision(
        time_s=tracks.time_s,
        brake=brake,
        reason=_reason(tracks, chosen, threat, stopping_m),
        collisions=collisions,
        track_id=int(tracks.track_id[chosen]),
        distance_m=threat.distance_m,
        closing_speed_mps=threat.closing_speed_mps,
        stopping_distance_m=stopping_m,
        needed_deceleration_mps2=needed_deceleration(threat.distance_m, threat.closing_speed_mps, settings),
        ttc_s=float(collisions.ttc_s[chosen]),
        ttc_sigma_s=float(collisions.ttc_sigma_s[chosen]),
        p_collision=float(collisions.p_collision[chosen]),
    )


def _free_way(tracks: Tracks, collisions: Collisions, settings: DecisionSettings) -> Floats:
    """Return the way in m to the nearest surface of each track (N,), inf for those that do not count."""
    distance_m = np.empty(len(tracks.status))
    limits = settings.corridor.width_m, settings.corridor.front_m, settings.min_probability
    shapes = tracks.near_offset_m, tracks.size_m
    _free_ways(tracks.status, tracks.state, shapes, collisions.p_collision, limits, distance_m)
    return distance_m


@njit(cache=True, nogil=True)
def _free_ways(
    status: Ints,
    state: Floats,
    shapes: tuple[Floats, Floats],
    p_collision: Floats,
    limits: tuple[float, float, float],
    distance: Floats,
) -> None:
    width, front, min_probability = limits
    for i in range(status.size):
        inside = abs(state[i, 3]) <= (width + shapes[1][i, 1]) / 2 and p_collision[i] > 0
        counts = status[i] != _TENTATIVE and (inside or p_collision[i] >= min_probability)
        distance[i] = state[i, 0] - shapes[0][i] - front if counts else math.inf


def _reason(tracks: Tracks, i: int, threat: Threat, stopping_m: float) -> str:
    """Return one phrase for people."""
    name = CLASSES[int(tracks.class_probability[i].argmax())]
    name = "object" if name == "unknown" else name
    if threat.closing_speed_mps <= 0:
        return f"{name} at {threat.distance_m:.1f} m, not closing"
    return (
        f"{name} at {threat.distance_m:.1f} m closing at {threat.closing_speed_mps:.1f} m/s: "
        f"stopping needs {stopping_m:.1f} m"
    )
