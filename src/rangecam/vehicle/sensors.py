"""What a vehicle measures of itself: speed by the holes of a disc, voltages, currents, heat (S-VEH-02, S-VEH-03)."""

import math
from functools import lru_cache
from typing import NamedTuple

from rangecam.values import changed
from rangecam.vehicle.dynamics import HOLE_S, PERIOD_S, WHEEL, VehicleState
from rangecam.vehicle.settings import Vehicle


def measured_speed(state: VehicleState, vehicle: Vehicle) -> float:
    """Return the speed in m/s by the time between the last two holes.

    It has no sign, lags by half that time, knows of no slip, and is bounded by the time since the last hole: zero
    after `timeout_s`.
    """
    sensor, period_s = vehicle.sensor, float(state.motion[PERIOD_S])
    since_s = state.time_s - float(state.motion[HOLE_S])
    if since_s >= sensor.timeout_s or not math.isfinite(period_s):
        return 0.0
    if sensor.tick_s > 0:
        period_s = max(round(period_s / sensor.tick_s), 1) * sensor.tick_s
    return sensor.hole_m / max(period_s, since_s)


def gain_of_wheels(vehicle: Vehicle, grip_mps2: float) -> float:
    """Return how fast wheels can gain speed in m/s2 on a road with grip mu g.

    By full throttle, with the vehicle while they hold. Where the motor is stronger than the grip of its axle they spin,
    and what is left accelerates their own inertia: (drive - grip share) / inertia, many times as much.
    """
    left_mps2 = vehicle.drive_mps2 - grip_mps2 * vehicle.driven_load
    if vehicle.antilock or left_mps2 <= 0:
        return vehicle.drive_mps2
    return max(vehicle.drive_mps2, left_mps2 / vehicle.wheel_inertia)


def step_of_sensor(vehicle: Vehicle, gain_mps2: float) -> float:
    """Return the largest step in m/s of the measured speed beyond what the wheels gain between two messages.

    From rest nothing is known before the second hole. It comes after at most twice the way h from hole to hole, when
    the wheels turn no faster than v = sqrt(2 a 2 h) = 2 sqrt(a h). Later the speed lags by half the time between two
    holes, which is less: a h / (2 v) < sqrt(a h) / 4.
    """
    return 2 * math.sqrt(gain_mps2 * vehicle.sensor.hole_m)


class Power(NamedTuple):
    """What the vehicle measures of its electricity."""

    motor_v: float
    motor_a: float
    battery_v: float
    power_w: float


def electricity(state: VehicleState, vehicle: Vehicle) -> Power:
    """Return voltages, current and power: a direct-current motor behind a control that takes what it needs.

    The motor's constant k follows from its top speed: k = full_v / max_speed, so that U = k w + I R and F = k I.
    """
    battery = vehicle.battery
    open_v = open_circuit_v(state, vehicle)
    k = battery.full_v / vehicle.max_speed_mps
    wheel = float(state.motion[WHEEL])
    force_n = vehicle.mass_kg * vehicle.drive_mps2 * state.command.drive * max(1 - wheel / vehicle.max_speed_mps, 0.0)
    motor_a = force_n / k
    motor_v = k * wheel + motor_a * vehicle.motor_ohm if motor_a > 0 else 0.0
    wanted_w = motor_v * motor_a + vehicle.standby_w
    # U I = P with U = open - I R; no more than what the battery can give
    most_w = open_v**2 / (4 * battery.inner_ohm) if battery.inner_ohm > 0 else math.inf
    power_w = min(wanted_w, most_w)
    if battery.inner_ohm > 0:
        root = math.sqrt(max(open_v**2 - 4 * battery.inner_ohm * power_w, 0.0))
        battery_v = (open_v + root) / 2
    else:
        battery_v = open_v
    return Power(motor_v, motor_a, battery_v, power_w)


def open_circuit_v(state: VehicleState, vehicle: Vehicle) -> float:
    """Return the voltage of the battery without load: from full to empty in proportion to the charge taken."""
    battery = vehicle.battery
    used = min(state.charge_as / (battery.capacity_ah * 3600), 1.0)
    return battery.full_v + used * (battery.empty_v - battery.full_v)


@lru_cache(maxsize=16)
def _warmed(dt_s: float) -> list[float]:
    """Return how much of the way to its last temperature each part has gone after `dt_s`."""
    return [1 - math.exp(-dt_s / tau_s) for tau_s in _HEATING_S]


_HEATING_S = (60.0, 20.0, 300.0, 120.0)
_CONTROL_LOSS = 0.05  # of what passes the motor control; *open*


def discharged(state: VehicleState, vehicle: Vehicle, dt_s: float) -> VehicleState:
    """Return the state after `dt_s` of taking what `electricity` says: charge, and warmth of the first order.

    Motor, control, battery and electronics are warmed by their losses towards so many kelvin a watt (*open*).
    """
    now = electricity(state, vehicle)
    battery_a = now.power_w / now.battery_v
    losses_w = (
        now.motor_a**2 * vehicle.motor_ohm,
        _CONTROL_LOSS * now.motor_v * now.motor_a,
        battery_a**2 * vehicle.battery.inner_ohm,
        vehicle.standby_w,
    )
    outside = state.heat_c[4]
    heat = [
        warm + share * (outside + k * loss - warm)
        for warm, loss, share, k in zip(state.heat_c[:4], losses_w, _warmed(dt_s), vehicle.heating_k_per_w, strict=True)
    ]
    return changed(state, charge_as=state.charge_as + battery_a * dt_s, heat_c=(*heat, outside))
