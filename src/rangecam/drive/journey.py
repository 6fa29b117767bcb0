"""Where the vehicle has been: its poses at even times, asked for by camera and scene at any time between them."""

import math
from bisect import bisect_right
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from rangecam.scene.paths import EgoMotion, Pose, ego_pose
from rangecam.scene.scenario import Scenario
from rangecam.vehicle.dynamics import DIRECTION, HEADING, SPEED, WAY, YAW_RATE, VehicleState, X, Y
from rangecam.vehicle.remote import Hand
from rangecam.vehicle.settings import Vehicle


def pose_of(state: VehicleState) -> Pose:
    """Return the pose of a vehicle as the scene takes it."""
    now = state.motion.tolist()
    return Pose(now[X], now[Y], now[HEADING], now[SPEED] * now[DIRECTION], now[YAW_RATE])


def between(poses: list[Pose], start_s: float, step_s: float) -> Callable[[float], Pose]:
    """Return the own motion through poses `step_s` apart, the first at `start_s`; the list may grow meanwhile.

    Between two of them it goes evenly, which is 1/8 a step^2 beside the truth: 0.03 mm at 9 m/s2 and 5 ms. Before the
    first it comes straight, after the last it goes on straight.
    """

    def own(time_s: float) -> Pose:
        at = (time_s - start_s) / step_s
        k = math.floor(at)
        if k < 0 or k >= len(poses) - 1:
            known, away_s = (poses[0], at * step_s) if k < 0 else (poses[-1], (at - len(poses) + 1) * step_s)
            way = known.speed_mps * away_s
            x, y = known.x_m + way * math.cos(known.heading_rad), known.y_m + way * math.sin(known.heading_rad)
            return Pose(x, y, known.heading_rad, known.speed_mps, 0.0)
        share, one, other = at - k, poses[k], poses[k + 1]
        (x, y, heading, speed, yaw), (x1, y1, heading1, speed1, yaw1) = one, other
        return Pose(
            x + share * (x1 - x),
            y + share * (y1 - y),
            heading + share * (heading1 - heading),
            speed + share * (speed1 - speed),
            yaw + share * (yaw1 - yaw),
        )

    return own


@lru_cache(maxsize=64)
def _course(ego: EgoMotion, duration_s: float) -> tuple[list[float], list[float], list[float], list[float]]:
    """Return times, speeds, ways and curvatures of a scenario's own motion every 20 ms; no curvatures if straight."""
    times = np.arange(0.0, duration_s + 0.02, 0.02)
    poses = [ego_pose(ego, float(t)) for t in times]
    speeds = np.array([pose.speed_mps for pose in poses])
    ways = np.concatenate([[0.0], np.cumsum((speeds[1:] + speeds[:-1]) / 2 * 0.02)])
    yaw = np.array([pose.yaw_rate_radps for pose in poses])
    curvatures = np.divide(yaw, speeds, out=np.zeros_like(yaw), where=np.abs(speeds) > 1e-6)
    bends = curvatures.tolist() if curvatures.any() else []
    return times.tolist(), speeds.tolist(), ways.tolist(), bends


def hand_of(scenario: Scenario, time_s: float, state: VehicleState, vehicle: Vehicle, lets_go: bool) -> Hand:
    """Return where the driver holds the remote control: for the speed of the scenario, and its bends where they are.

    lets_go: the driver leaves throttle and brake alone, and steers.
    """
    times, speeds, ways, curvatures = _course(scenario.ego, scenario.duration_s)
    steer = 0.0
    if curvatures:
        curvature = _interpolated(float(state.motion[WAY]), ways, curvatures)
        steer = math.degrees(math.atan(curvature * vehicle.wheelbase_m)) / vehicle.max_steer_deg
    if lets_go:
        return Hand(0.0, steer, True)
    wanted = _interpolated(time_s, times, speeds)
    soon = _interpolated(time_s + _AHEAD_S, times, speeds) - wanted
    return Hand(_throttle(wanted, soon / _AHEAD_S, state.speed_mps, vehicle), steer, True)


def _interpolated(at: float, places: list[float], values: list[float]) -> float:
    """Return what `np.interp` does of one number, without its calls."""
    k = bisect_right(places, at) - 1
    if k < 0 or k == len(places) - 1:
        return values[max(k, 0)]
    return (values[k + 1] - values[k]) / (places[k + 1] - places[k]) * (at - places[k]) + values[k]


_AHEAD_S = 0.05
_GAIN_HZ = 5.0


def _throttle(wanted_mps: float, wanted_mps2: float, speed: float, vehicle: Vehicle) -> float:
    """Return throttle (positive) or brake (negative) that keeps a speed against rolling and air."""
    if wanted_mps <= 0 and speed < 0.05:
        return -1.0
    needs = vehicle.rolling_mps2 + vehicle.drag_per_m * speed**2 + wanted_mps2 + _GAIN_HZ * (wanted_mps - speed)
    if needs < 0:
        return max(needs / vehicle.brake_mps2, -1.0)
    gives = vehicle.drive_mps2 * max(1 - speed / vehicle.max_speed_mps, 1e-3)
    return min(needs / gives, 1.0)
