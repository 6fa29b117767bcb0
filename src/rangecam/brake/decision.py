"""From tracks to the decision: which object is in the way, and does it demand braking."""

import math

from rangecam.brake.rule import (
    RULES,
    DecisionSettings,
    Threat,
    is_object,
    needed_deceleration,
    stopping_distance,
)
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
    collisions, in_path = look_ahead(tracks, ego, settings.corridor, settings.min_probability)
    known = ego.speed_mps if ego.speed_mps is not None and math.isfinite(ego.speed_mps) else None
    chosen: tuple[InPath, Threat, float] | None = None
    brake, must_brake = False, RULES[settings.rule]
    for each in in_path:
        closing = closing_speed(each.speed_x_mps, each.speed_sigma_mps, known, settings)
        threat = Threat(each.distance_m, closing, each.n_pixels)
        own_speed = closing if known is None else known
        brake = must_brake(threat, own_speed, ego.forward, settings)
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
    if not is_object(threat, settings):
        return f"{phrase}, but it is seen with {threat.n_pixels:.0f} pixels only"
    if not forward:
        return f"{phrase}, but we drive backwards"
    return phrase if own_speed_mps > settings.min_speed_mps else f"{phrase}, but we are slow"
