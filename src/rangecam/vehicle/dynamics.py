"""How a vehicle moves: forces at its tyres, wheels that may slip, brakes that take their time.

Along the way, for each unit of mass (m/s2): dv/dt = T - r - k v^2 with the force T of the tyres, rolling r and air k.
The wheels give the net force N of motor and brakes. While they roll, T = N, up to the grip mu g; beyond it they slip,
T = mu g towards the wheels' speed, and with the inertia i of the wheels over the mass i dw/dt = N - T. In a bend the
grip is shared with the lateral acceleration (circle of friction).

Steps of `STEP_S` with the force of the middle of the step. A brake force that rises, holds or locks the wheels is
integrated to within its jump over a step (v to 5e-3 m/s of 8 m/s2 x 1 ms / 2), air to second order; the end at
standstill is found within the step, exactly for constant force, and a vehicle that stands stays.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from rangecam.types import Floats
from rangecam.values import changed, value
from rangecam.vehicle.settings import Vehicle

GRAVITY_MPS2 = 9.81
STEP_S = 1e-3
"""Longest step of the integration."""


class Command(NamedTuple):
    """What the actuators are told: parts of full throttle and brakes (0..1), of full lock to the left (-1..1)."""

    drive: float = 0.0
    brake: float = 0.0
    steer: float = 0.0
    forward: bool = True


class Road(NamedTuple):
    """What the tyres roll on."""

    friction: float = 0.7
    """mu of eq 3.3: 0.3 PVC floor, 0.7 dry asphalt for the tyres of a model, 0.9 for those of a car."""


# columns of VehicleState.motion
X, Y, HEADING, SPEED, WHEEL, BRAKE, DIRECTION, WAY, PHASE, HOLE_S, PERIOD_S, ACCELERATION, YAW_RATE, WORK = range(14)


@value
class VehicleState:
    """A vehicle at one moment.

    motion (14,): x, y (m) and heading (rad) of its reference point on the ground; speed, that of its wheels (m/s, in
    the direction of travel); brake (0..1); direction (1 forward, -1 backward); way (m); way since the last hole of the
    speed sensor (m), its time, and the time between the last two (s); acceleration (m/s2); yaw rate (rad/s); work of
    the motor for each kilogram (J/kg).
    command: what the actuators do now. pending: commands on their way to them, with the time of their arrival.
    charge_as: taken from the battery. heat_c (5,): motor, its control, battery, electronics, outside, degrees Celsius.
    """

    time_s: float
    motion: Floats
    command: Command = Command()
    pending: tuple[tuple[float, Command], ...] = ()
    charge_as: float = 0.0
    heat_c: tuple[float, ...] = (20.0,) * 5

    @property
    def speed_mps(self) -> float:
        """True speed over ground, not negative."""
        return float(self.motion[SPEED])

    @property
    def pose(self) -> tuple[float, float, float]:
        """X and y in metres, heading in rad to the left of the x axis."""
        x, y, heading = self.motion[:3].tolist()
        return x, y, heading


def standing(vehicle: Vehicle, time_s: float = 0.0, speed_mps: float = 0.0) -> VehicleState:
    """Return the state of a vehicle at the origin that looks along x, rolling at a speed that it has had for long."""
    motion = np.zeros(14)
    motion[SPEED] = motion[WHEEL] = speed_mps
    motion[DIRECTION] = 1.0
    period_s = vehicle.sensor.hole_m / speed_mps if speed_mps > 0 else math.inf
    motion[HOLE_S], motion[PERIOD_S] = time_s, period_s
    battery = vehicle.battery
    return VehicleState(time_s, motion, charge_as=battery.used * battery.capacity_ah * 3600)


def move(state: VehicleState, command: Command, dt_s: float, vehicle: Vehicle, road: Road) -> VehicleState:
    """Return the state `dt_s` later, the actuators being told `command` from now on.

    Motor and steering follow at once, the brakes begin after `brake_delay_s` and reach full force `brake_rise_s` later.
    """
    latest = state.pending[-1][1] if state.pending else state.command
    pending = state.pending if command == latest else (*state.pending, (state.time_s + vehicle.brake_delay_s, command))
    applied = Command(command.drive, state.command.brake, command.steer, command.forward)
    motion, at_s, end_s = state.motion, state.time_s, state.time_s + dt_s
    while pending and pending[0][0] <= end_s:
        (arrival_s, arrived), *rest = pending
        motion = _moved(motion, at_s, arrival_s - at_s, applied, vehicle, road)
        applied, at_s, pending = applied._replace(brake=arrived.brake), max(arrival_s, at_s), tuple(rest)
    motion = _moved(motion, at_s, end_s - at_s, applied, vehicle, road)
    return changed(state, time_s=end_s, motion=motion, command=applied, pending=pending)


def _moved(motion: Floats, start_s: float, dt_s: float, command: Command, vehicle: Vehicle, road: Road) -> Floats:
    if dt_s <= 0:
        return motion
    new = motion.copy()
    told = (command.drive, command.brake, math.radians(vehicle.max_steer_deg) * command.steer, float(command.forward))
    _integrate(new, start_s, dt_s, told, _facts(vehicle), road.friction * GRAVITY_MPS2)
    return new


@lru_cache(maxsize=16)
def _facts(vehicle: Vehicle) -> Floats:
    """Return what `_integrate` is told of the vehicle."""
    facts = (
        vehicle.drive_mps2,
        vehicle.max_speed_mps,
        vehicle.brake_mps2,
        1 / vehicle.brake_rise_s if vehicle.brake_rise_s > 0 else math.inf,
        float(vehicle.antilock),
        vehicle.driven_load,
        vehicle.wheel_inertia,
        vehicle.rolling_mps2,
        vehicle.drag_per_m,
        vehicle.wheelbase_m,
        vehicle.sensor.hole_m,
    )
    return np.array(facts)


@njit(cache=True, nogil=True)
def _integrate(m: Any, start_s: float, dt_s: float, told: Any, facts: Any, grip: float) -> None:
    """Move `m` on in place."""
    drive, brake, steer, forward = told
    full_drive, top_speed, full_brake, rise, antilock, driven, inertia, rolling, drag, wheelbase, hole = facts
    steps = max(1, math.ceil(dt_s / STEP_S - 1e-9))
    h = dt_s / steps
    for step in range(steps):
        if m[SPEED] == 0.0:
            m[DIRECTION] = 1.0 if forward > 0 else -1.0
        v, w, b0 = m[SPEED], m[WHEEL], m[BRAKE]
        change = rise * h if math.isfinite(rise) else 1.0
        b = min(b0 + change, brake) if brake > b0 else max(b0 - change, brake)
        m[BRAKE] = b
        yaw = v * math.tan(steer) / wheelbase
        yaw = max(min(yaw, grip / v), -grip / v) if v > 0 else 0.0
        left = math.sqrt(max(grip * grip - (v * yaw) ** 2, 0.0))
        motor = drive * full_drive * max(1 - w / top_speed, 0.0)
        holds = full_brake * ((b0 + b) / 2 if math.isfinite(rise) else b)
        force, w = _tyre(motor, holds, v, w, left, driven, inertia, antilock, h)
        v1 = _slower(v, force, rolling, drag, h)
        used = h
        if v1 <= 0.0:
            v1 = 0.0
            slows = rolling + drag * v * v / 3 - force
            used = min(h, v / slows) if v > 0 else 0.0
        way = (v + v1) / 2 * used
        m[ACCELERATION] = m[DIRECTION] * (v1 - v) / h
        m[YAW_RATE] = m[DIRECTION] * yaw if v1 > 0 else 0.0
        middle = m[HEADING] + m[DIRECTION] * yaw * used / 2
        m[X] += m[DIRECTION] * way * math.cos(middle)
        m[Y] += m[DIRECTION] * way * math.sin(middle)
        m[HEADING] += m[DIRECTION] * yaw * used
        m[WAY] += way
        m[WORK] += motor * way
        rolls = w == m[WHEEL] == v  # without slip the wheels go with the vehicle
        _count_holes(m, start_s + step * h, h, way if rolls or w == v else (m[WHEEL] + w) / 2 * h, hole)
        m[WHEEL] = v1 if w == v or (antilock > 0 and v1 == 0) else w
        m[SPEED] = v1


@njit(cache=True, nogil=True)
def _tyre(
    motor: float,
    holds: float,
    v: float,
    w: float,
    grip: float,
    driven: float,
    inertia: float,
    antilock: float,
    h: float,
) -> tuple[float, float]:
    """Return the force of the tyres and the speed of the wheels after the step; v itself where they roll."""
    net = motor - holds if w > 0 or v > 0 else max(motor - holds, 0.0)
    limit = grip * driven if net > 0 else grip
    if antilock > 0:
        kept = max(min(net, limit), -limit)
        # what keeps the wheels from locking lets them turn a tenth slower than the way: that is where tyres grip best
        return kept, v if kept == net else v * (0.9 if net < 0 else 1.0)
    if w == v and abs(net) <= limit:
        return net, v
    towards = 1.0 if (w > v or (w == v and net > 0)) else -1.0
    force = towards * (grip * driven if towards > 0 else grip)
    after = w + h * (net - force) / inertia
    after = max(after, 0.0)
    if (after - v) * towards <= 0 and abs(net) <= limit:
        return net, v
    return force, after


@njit(cache=True, nogil=True)
def _slower(v: float, force: float, rolling: float, drag: float, h: float) -> float:
    """Return the speed after a step; at standstill only a force beyond the rolling resistance moves."""
    if v == 0.0 and force <= rolling:
        return 0.0
    middle = v + h / 2 * (force - rolling - drag * v * v)
    return v + h * (force - rolling - drag * middle * middle)


@njit(cache=True, nogil=True)
def _count_holes(m: Any, start_s: float, h: float, way: float, hole: float) -> None:
    """Note the times at which holes pass, taking the way of a step to be even."""
    before = m[PHASE]
    m[PHASE] = before + way
    while m[PHASE] >= hole:
        m[PHASE] -= hole
        at_s = start_s + h * (1 - m[PHASE] / way)
        m[PERIOD_S] = at_s - m[HOLE_S]
        m[HOLE_S] = at_s
