"""Start inhibit for the blind spots of a truck (K-GEN-03): it must not start while somebody is there, or comes."""

import math
from dataclasses import dataclass

import numpy as np

from rangecam.settings import Fraction, NonNegative, Positive, settings
from rangecam.types import Ego, Floats, Frame, TrackStatus, Why


@settings
class BlindSpot:
    """The area, in vehicle axes, and how careful to be."""

    x_min_m: float = -4.0
    x_max_m: float = 4.0
    y_min_m: float = -4.0
    y_max_m: float = -1.3
    """The area beside (or before) the vehicle that the driver does not see: K-GEN-03 asks for up to 4 to 8 m."""
    horizon_s: NonNegative = 1.5
    """Whoever will be in it within this time counts as there."""
    hold_s: NonNegative = 1.0
    """So long after the last one was seen the vehicle must still wait."""
    standing_mps: NonNegative = 0.3
    """Up to this speed the vehicle is taken to stand: above, there is nothing to inhibit."""
    min_seen: Fraction = 0.1
    """With a smaller share of pixels that measure something, be it floor, nobody knows who is there: no start."""
    min_pixels: Positive = 20.0
    """What is seen with fewer is no one."""


@dataclass(frozen=True)
class BlindSpotState:
    """inhibit: the vehicle must not start. reason: for people. seen_s: when somebody was there last."""

    inhibit: bool = True
    reason: str = "nothing seen yet"
    seen_s: float = -math.inf


def may_start(frame: Frame, ego: Ego, state: BlindSpotState, settings: BlindSpot) -> BlindSpotState:
    """Return whether a standing vehicle must not start.

    Segments of this image count at once, without waiting for their track to be confirmed; confirmed tracks also where
    they will be. A speed that nobody knows is taken for standing.
    """
    time_s = frame.decision.time_s
    if ego.speed_mps is not None and ego.speed_mps > settings.standing_mps:
        return BlindSpotState(False, "driving", state.seen_s)
    if float(np.isin(frame.image.why, _MEASURED).mean()) < settings.min_seen:
        return BlindSpotState(True, "the camera sees too little", state.seen_s)
    name = _somebody(frame, settings)
    if name:
        return BlindSpotState(True, name, time_s)
    if time_s - state.seen_s < settings.hold_s:
        return BlindSpotState(True, "somebody was there a moment ago", state.seen_s)
    return BlindSpotState(False, "free", state.seen_s)


_MEASURED = (Why.VALID, Why.FLOOR, Why.OUTSIDE_AREA, Why.FLYING, Why.ISOLATED, Why.BORDER)


def _somebody(frame: Frame, settings: BlindSpot) -> str:
    """Return who is in the area or comes, empty for nobody."""
    for segment in frame.segments:
        if segment.n_pixels >= settings.min_pixels and _inside(segment.position_m, segment.size_m, settings):
            return f"object at {segment.position_m[0]:.1f}, {segment.position_m[1]:.1f} m"
    steps = 8
    for track in frame.tracks:
        if track.status == TrackStatus.TENTATIVE or track.n_pixels < settings.min_pixels:
            continue
        for k in range(steps + 1):
            at_s = settings.horizon_s * k / steps
            if _inside(track.position_m + at_s * track.velocity_mps, track.size_m, settings):
                return f"{track.class_name} there in {at_s:.1f} s"
    return ""


def _inside(position_m: Floats, size_m: Floats, settings: BlindSpot) -> bool:
    """Return whether any of a box lies in the area."""
    low = np.array([settings.x_min_m, settings.y_min_m]) - size_m[:2] / 2
    high = np.array([settings.x_max_m, settings.y_max_m]) + size_m[:2] / 2
    return bool(np.all((position_m[:2] >= low) & (position_m[:2] <= high)))
