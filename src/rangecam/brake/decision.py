"""From tracks to the decision: which object is in the way, and does it demand braking."""

import math

from rangecam.brake.rule import (
    RULES,
    Threat,
    is_in_range,
    is_object,
    is_seen,
    keeps_braking,
    needed_deceleration,
    stopping_distance,
)
from rangecam.brake.settings import DecisionSettings, full_deceleration, on_ground
from rangecam.collision import InPath, look_ahead
from rangecam.types import CLASSES, Decision, Ego, Tracks

_NAMES = [name.replace("unknown", "object") for name in CLASSES]


def closing_speed(
    speed_x_mps: float, sigma_mps: float, own_speed_mps: float | None, settings: DecisionSettings
) -> float:
    """Return the speed in m/s at which the gap to a track shrinks, 0 where it does not or where that is not certain.

    speed_x_mps, sigma_mps: estimate of the track relative to us. With the own speed known, a track whose estimate
    agrees with that of a standing object closes at the own speed, which is better known: so the thesis treats all
    objects. Unlike there, one that drives ahead of us closes at the difference of the speeds, one that comes towards
    us at their sum; and an estimate that agrees with an object as fast as we, too, is no closing speed yet. So the
    velocity that a track has before it was seen to move does not brake, nor does a car ahead.
    """
    closing, tolerance = -speed_x_mps, settings.speed_sigmas * sigma_mps
    if not closing > tolerance:
        return 0.0
    return own_speed_mps if own_speed_mps is not None and abs(closing - own_speed_mps) <= tolerance else closing


def decide(tracks: Tracks, ego: Ego, settings: DecisionSettings) -> Decision:
    """Return whether to brake now, for which track, and why (S-DEC-01, S-DEC-02).

    Confirmed tracks count, also while they coast through missed frames, if they are in the path now or will be when
    they reach us. The nearest that demands braking decides, else the nearest. Where the own speed is unknown it is
    taken to be the closing speed; where our friction is known, it replaces that of the settings. While we brake, the
    demand goes on as `keeps_braking` says.
    """
    settings = on_ground(settings, ego.friction)
    collisions, in_path = look_ahead(tracks, ego, settings.corridor, settings.min_probability)
    known = ego.speed_mps if ego.speed_mps is not None and math.isfinite(ego.speed_mps) else None
    chosen: tuple[InPath, Threat, float] | None = None
    brake, must_brake = False, RULES[settings.rule]
    for each in in_path:
        threat = _threat(each, known, settings)
        own_speed = threat.closing_speed_mps if known is None else known
        brake = must_brake(threat, own_speed, ego.forward, settings)
        brake = brake or (ego.braking and own_speed > 0 and keeps_braking(threat, settings))
        if brake or chosen is None:
            chosen = each, threat, own_speed
        if brake:
            break
    if chosen is None:
        return Decision(time_s=tracks.time_s, brake=False, reason="no object in the path", collisions=collisions)
    track, threat, own_speed = chosen
    stopping_m = stopping_distance(own_speed, own_speed - threat.closing_speed_mps, settings)
    return Decision(
        time_s=tracks.time_s,
        brake=brake,
        reason=_reason(_NAMES[int(track.class_index)], threat, stopping_m, own_speed, ego.forward, settings),
        collisions=collisions,
        track_id=int(track.track_id),
        distance_m=threat.distance_m,
        closing_speed_mps=threat.closing_speed_mps,
        stopping_distance_m=stopping_m,
        needed_deceleration_mps2=needed_deceleration(threat.distance_m, threat.closing_speed_mps, settings),
        ttc_s=track.ttc_s,
        ttc_sigma_s=track.ttc_sigma_s,
        p_collision=track.p_collision,
    )


def _threat(track: InPath, own_speed_mps: float | None, settings: DecisionSettings) -> Threat:
    """Return what the rules are told of a track.

    Its acceleration counts as braking only as far as it is certain, and never by itself: a gap that does not shrink
    loses nothing by it.
    """
    closing = closing_speed(track.speed_x_mps, track.speed_sigma_mps, own_speed_mps, settings)
    braking = -track.acceleration_mps2 - settings.speed_sigmas * track.acceleration_sigma_mps2
    return Threat(
        track.distance_m,
        closing,
        track.n_pixels,
        -track.speed_x_mps,
        track.distance_sigma_m,
        track.speed_sigma_mps,
        -track.covariance,
        min(max(braking, 0.0), full_deceleration(settings)) if closing > 0 else 0.0,
        track.p_lateral,
        track.hits,
        track.age,
    )


def _reason(
    name: str, threat: Threat, stopping_m: float, own_speed_mps: float, forward: bool, settings: DecisionSettings
) -> str:
    """Return one phrase for people: the numbers, and what speaks against braking although there is too little way."""
    closing = threat.closing_speed_mps
    if closing <= 0:
        return f"{name} at {threat.distance_m:.1f} m, not closing"
    phrase = f"{name} at {threat.distance_m:.1f} m closing at {closing:.1f} m/s: stopping needs {stopping_m:.1f} m"
    if threat.distance_m >= settings.margin * stopping_m:
        return phrase
    if not is_in_range(threat, settings):
        return f"{phrase}, but the camera cannot see so far"
    if not is_object(threat, settings):
        return f"{phrase}, but it is seen with {threat.n_pixels:.0f} pixels only"
    if not is_seen(threat, settings):
        return f"{phrase}, but it was seen in {threat.hits:.0f} of {threat.age:.0f} frames only"
    if not forward:
        return f"{phrase}, but we drive backwards"
    return phrase if own_speed_mps > settings.min_speed_mps else f"{phrase}, but we are slow"
