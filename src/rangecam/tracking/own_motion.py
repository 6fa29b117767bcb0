"""What the own motion does to tracks whose objects keep their motion over the ground."""

import math
from dataclasses import replace

import numpy as np

from rangecam.types import ACCELERATION, Ego, Floats, Tracks

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def carried(tracks: Tracks, ego: Ego, dt_s: float, rear_axle_m: float) -> tuple[Tracks, Floats]:
    """Return the tracks such that the usual prediction over `dt_s` leads into the present axes, and the own velocity.

    A state holds position and velocity relative to the vehicle in its axes, and the acceleration over the ground:
    nobody measures ours. Let R turn by the own yaw, d be the own way and v0, v1 the own velocities, all in the axes
    before, but v1 in those after. With F of one axis, alike on x and y, the object comes to R' (F (p, v + v0, a)) - (R'
    d, v1, 0). F commutes with R' and leaves (R' d - v1 T, v1, 0) at (R' d, v1, 0), so that all of it can be done before
    F: rotate (p, v + v0, a), and subtract that. Whatever the model, one or several, nothing else changes.

    The own speed is that of the rear axle, straight ahead, and goes with the yaw rate evenly from the old to the new
    value. Where nobody measures the speed, the tracks stay as they are: objects then keep their motion relative to us.
    """
    none = np.zeros(2)
    if ego.speed_mps is None or not math.isfinite(ego.speed_mps):
        return tracks, none
    before = tracks.ego if tracks.ego is not None and tracks.ego.speed_mps is not None else ego
    v1, w1 = _motion(ego)
    v0, w0 = _motion(before)
    ahead_m = -rear_axle_m
    own0, own1 = np.array([v0, w0 * ahead_m]), np.array([v1, w1 * ahead_m])
    if dt_s == 0 or not len(tracks.age):
        return tracks, own1
    yaw = (w0 + w1) / 2 * dt_s
    share = (1 + _NODES) / 2
    angle = dt_s * share * (w0 + (w1 - w0) * share / 2)
    step = _WEIGHTS / 2 * dt_s * (v0 + (v1 - v0) * share)
    way = np.array([step @ np.cos(angle), step @ np.sin(angle)])
    way += ahead_m * np.array([math.cos(yaw) - 1, math.sin(yaw)])
    turn = _turned(-yaw)
    back = turn[::3, ::3][:2, :2] @ way - own1 * dt_s

    def moved(state: Floats) -> Floats:
        over_ground = state.copy()
        over_ground[..., 1:5:3] += own0
        new: Floats = over_ground @ turn.T
        new[..., 0:4:3] -= back
        new[..., 1:5:3] -= own1
        return new

    return replace(
        tracks,
        state=moved(tracks.state),
        covariance=turn @ tracks.covariance @ turn.T,
        mode_state=moved(tracks.mode_state),
        mode_covariance=turn @ tracks.mode_covariance @ turn.T,
    ), own1


def turned(tracks: Tracks, ego: Ego) -> Tracks:
    """Return the tracks with velocities in axes that turn as fast as the vehicle does now, not as a frame ago.

    In axes that turn by w the velocity of anything at r is less by w x r. Where the wheel is turned, what is 15 m ahead
    moves across by metres a second from one frame to the next, which no model of its motion expects. Nothing changes
    where nobody measured the own motion in one of both frames.
    """
    if tracks.ego is None or tracks.ego.speed_mps is None or ego.speed_mps is None or not len(tracks.age):
        return tracks
    change = _motion(ego)[1] - _motion(tracks.ego)[1]
    if change == 0:
        return tracks
    J = np.eye(9)
    J[1, 3], J[4, 0] = change, -change
    return replace(
        tracks,
        state=tracks.state @ J.T,
        covariance=J @ tracks.covariance @ J.T,
        mode_state=tracks.mode_state @ J.T,
        mode_covariance=J @ tracks.mode_covariance @ J.T,
    )


def braked(tracks: Tracks, variance: float) -> Tracks:
    """Return the tracks with so much more variance (m2/s4) of the acceleration along our way: ours has changed."""
    covariance, modes = tracks.covariance.copy(), tracks.mode_covariance.copy()
    for each in (covariance, modes):
        each[..., ACCELERATION[0], ACCELERATION[0]] += variance
    return replace(tracks, covariance=covariance, mode_covariance=modes)


def _motion(ego: Ego) -> tuple[float, float]:
    """Return speed, negative backwards, and yaw rate."""
    speed = ego.speed_mps if ego.speed_mps is not None else math.nan
    yaw_rate = ego.yaw_rate_radps if math.isfinite(ego.yaw_rate_radps) else 0.0
    return speed if ego.forward else -speed, yaw_rate


def _turned(angle: float) -> Floats:
    """Return (9, 9): the rotation of a whole state about the vertical axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.kron(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.eye(3))
