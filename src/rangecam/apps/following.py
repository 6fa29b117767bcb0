"""Following one object (S-FUT-06): choose it once, stay with it, keep a distance, and stop when it is lost."""

import math
from dataclasses import dataclass

from rangecam.settings import NonNegative, Positive, settings
from rangecam.types import Ego, Frame, Track, TrackStatus


@settings
class Following:
    """Whom to follow, and how."""

    keep_m: Positive = 1.0
    """Free way to its nearest surface."""
    max_speed_mps: Positive = 2.0
    gain_hz: Positive = 0.8
    """Speed for each metre too far."""
    first_within_m: Positive = 4.0
    """It is chosen among confirmed tracks that are nearer than this and not farther beside than ahead."""
    lost_after_s: NonNegative = 0.5
    """Not seen for longer than this it is lost: the vehicle stops, and chooses anew when something is near again."""
    max_curvature_per_m: Positive = 0.5


@dataclass(frozen=True)
class FollowState:
    """Which track is followed (0: none), and when it was seen last. speed_mps, curvature_per_m: what to drive."""

    track_id: int = 0
    seen_s: float = -math.inf
    speed_mps: float = 0.0
    curvature_per_m: float = 0.0


def follow(frame: Frame, ego: Ego, state: FollowState, settings: Following) -> FollowState:
    """Return what to drive now: a speed, never backwards, and the curvature of the arc through the object.

    The arc from the origin along x to (x, y) has the curvature 2 y / (x^2 + y^2), left positive.
    """
    time_s = frame.decision.time_s
    target = _followed(frame, state) or _chosen(frame, state, settings)
    if target is None:
        lost = time_s - state.seen_s > settings.lost_after_s
        return FollowState() if lost else FollowState(state.track_id, state.seen_s, 0.0, state.curvature_per_m)
    seen_s = state.seen_s if target.status == TrackStatus.COASTING else time_s
    if time_s - seen_s > settings.lost_after_s:
        return FollowState()
    x, y, _ = (float(v) for v in target.position_m)
    own_mps = ego.speed_mps or 0.0
    wanted = own_mps + float(target.velocity_mps[0]) + settings.gain_hz * (x - target.near_offset_m - settings.keep_m)
    curvature = 2 * y / max(x * x + y * y, 1e-6)
    bend = settings.max_curvature_per_m
    speed = min(max(wanted, 0.0), settings.max_speed_mps)
    return FollowState(target.track_id, seen_s, speed, min(max(curvature, -bend), bend))


def _followed(frame: Frame, state: FollowState) -> Track | None:
    return next((track for track in frame.tracks if track.track_id == state.track_id), None)


def _chosen(frame: Frame, state: FollowState, settings: Following) -> Track | None:
    """Return the nearest track that may be followed, unless one that was followed is not yet given up."""
    if state.track_id and frame.decision.time_s - state.seen_s <= settings.lost_after_s:
        return None
    near = [
        track
        for track in frame.tracks
        if track.status == TrackStatus.CONFIRMED and abs(track.position_m[1]) <= track.position_m[0]
    ]
    near.sort(key=lambda track: float(track.position_m[0]))
    return near[0] if near and near[0].position_m[0] <= settings.first_within_m else None
