"""From tracks to the decision: which object is in the way, and does it demand braking."""

import math

import numpy as np
from numba import njit

from rangecam.brake.rule import (
    RULES,
    DecisionSettings,
    Threat,
    is_object,
    needed_deceleration,
    stopping_distance,
)
from rangecam.collision import predict_collisions
from rangecam.types import CLASSES, Collisions, Decision, Ego, Floats, Ints, Tracks, TrackStatus

_TENTATIVE = int(TrackStatus.TENTATIVE)


def closing_speed(
    speed_x_mps: float, sigma_mps: float, own_speed_mps: float | None, settings: DecisionSettings
) -> float:
    """Return the speed in m/s at which the gap to a track shrinks, 0 where it does not or where that is not certain.

    speed_x_mps, sigma_mps: estimate of the track relative to us. With the own speed known, a track whose estimate
    agrees with that of a standing object closes at the own speed, which is better known: so the thesis treats all
    objects. Unlike there, one that drives ahead of us closes at the difference of the speeds, one that comes towards
    us at their sum.
    """
    closing, tolerance = -speed_x_mps, settings.speed_sigmas * sigma_mps
    if own_speed_mps is not None and abs(closing - own_speed_mps) <= tolerance:
        return own_speed_mps
    return closing if closing > tolerance else 0.0


def decide(tracks: Tracks, ego: Ego, settings: DecisionSettings) -> Decision:
    """Return whether to brake now, for which track, and why (S-DEC-01, S-DEC-02).

    Confirmed tracks count, also while they coast through missed frames, if they are in the path now or will be when
    they reach us. The nearest that demands braking decides, else the nearest. Where the own speed is unknown it is
    taken to be the closing speed.
    """
    collisions = predict_collisions(tracks, ego, settings.corridor)
    distance_m = _free_way(tracks, collisions, settings)
    known = ego.speed_mps if ego.speed_mps is not None and math.isfinite(ego.speed_mps) else None
    chosen, brake, threat = -1, False, Threat(math.nan, math.nan, 0.0)
    for i in distance_m.argsort():
        if not distance_m[i] < math.inf:
            break
        sigma_mps = math.sqrt(tracks.covariance[i, 1, 1])
        closing = closing_speed(float(tracks.state[i, 1]), sigma_mps, known, settings)
        this = Threat(float(distance_m[i]), closing, float(tracks.n_pixels[i]))
        brake = RULES[settings.rule](this, closing if known is None else known, ego.forward, settings)
        if brake or chosen < 0:
            chosen, threat = int(i), this
        if brake:
            break
    if chosen < 0:
        return Decision(time_s=tracks.time_s, brake=False, reason="no object in the path", collisions=collisions)
    name = CLASSES[int(tracks.class_probability[chosen].argmax())].replace("unknown", "object")
    own_speed = threat.closing_speed_mps if known is None else known
    return Decision(
        time_s=tracks.time_s,
        brake=brake,
        reason=_reason(name, threat, own_speed, ego.forward, settings),
        collisions=collisions,
        track_id=int(tracks.track_id[chosen]),
        distance_m=threat.distance_m,
        closing_speed_mps=threat.closing_speed_mps,
        stopping_distance_m=stopping_distance(own_speed, own_speed - threat.closing_speed_mps, settings),
        needed_deceleration_mps2=needed_deceleration(threat.distance_m, threat.closing_speed_mps, settings),
        ttc_s=float(collisions.ttc_s[chosen]),
        ttc_sigma_s=float(collisions.ttc_sigma_s[chosen]),
        p_collision=float(collisions.p_collision[chosen]),
    )


def _free_way(tracks: Tracks, collisions: Collisions, settings: DecisionSettings) -> Floats:
    """Return the way in m to the nearest surface of each track (N,), inf for those that do not count."""
    distance_m = np.empty(len(tracks.status))
    limits = settings.corridor.width_m, settings.corridor.front_m, settings.min_probability
    shapes = tracks.size_m, tracks.near_offset_m
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
        size, near_offset = shapes[0][i], shapes[1][i]
        way = state[i, 0] - near_offset - front
        ahead = way + max(size[0], near_offset) > 0
        inside = abs(state[i, 3]) <= (width + size[1]) / 2 or p_collision[i] >= min_probability
        distance[i] = way if ahead and inside and status[i] != _TENTATIVE else math.inf


def _reason(name: str, threat: Threat, own_speed_mps: float, forward: bool, settings: DecisionSettings) -> str:
    """Return one phrase for people: the numbers, and what speaks against braking although there is too little way."""
    closing = threat.closing_speed_mps
    stopping_m = stopping_distance(own_speed_mps, own_speed_mps - closing, settings)
    if closing <= 0:
        return f"{name} at {threat.distance_m:.1f} m, not closing"
    phrase = f"{name} at {threat.distance_m:.1f} m closing at {closing:.1f} m/s: stopping needs {stopping_m:.1f} m"
    if threat.distance_m >= settings.margin * stopping_m:
        return phrase
    if not is_object(threat, settings):
        return f"{phrase}, but it is seen with {threat.n_pixels:.0f} pixels only"
    if not forward:
        return f"{phrase}, but we drive backwards"
    return phrase if own_speed_mps > settings.min_speed_mps else f"{phrase}, but we are slow"
