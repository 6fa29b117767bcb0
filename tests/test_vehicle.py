"""The vehicle: its motion against closed forms, what it measures of itself, and its control unit on the bus."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangecam.brake.gate import CanFrame
from rangecam.can.codec import (
    CarStatus1,
    CarStatus2,
    DriveMode,
    GiveBack,
    RemoteValues,
    SteeringMode,
    TakeOver,
    decode,
    encode,
)
from rangecam.errors import UsageError
from rangecam.vehicle.dynamics import (
    BRAKE,
    DIRECTION,
    GRAVITY_MPS2,
    HOLE_S,
    PERIOD_S,
    PHASE,
    WAY,
    WHEEL,
    WORK,
    YAW_RATE,
    Command,
    Road,
    VehicleState,
    move,
    standing,
)
from rangecam.vehicle.remote import Hand
from rangecam.vehicle.sensors import (
    discharged,
    electricity,
    gain_of_wheels,
    measured_speed,
    open_circuit_v,
    step_of_sensor,
)
from rangecam.vehicle.settings import VEHICLES, Unit, Vehicle, vehicle_named
from rangecam.vehicle.unit import Control, UnitState, advance_unit

MODEL, CAR = VEHICLES["scaled_car"], VEHICLES["passenger_car"]
FREE = {"rolling_mps2": 0.0, "drag_per_m": 0.0}
FULL_BRAKE = Command(brake=1.0)


def braked(vehicle: Vehicle, speed: float, friction: float, dt_s: float = 0.01) -> VehicleState:
    car = standing(vehicle, 0.0, speed)
    while car.speed_mps > 0:
        car = move(car, FULL_BRAKE, dt_s, vehicle, Road(friction))
    return car


# -- along the way ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.3, 0.7, 0.9])
def test_the_way_to_a_stop_is_delay_and_rise_and_grip(friction: float) -> None:
    car, speed = replace(CAR, **FREE), 12.0
    a, jerk = friction * GRAVITY_MPS2, CAR.brake_mps2 / CAR.brake_rise_s
    rises_s = a / jerk
    after = speed - jerk * rises_s**2 / 2
    way_m = speed * (CAR.brake_delay_s + rises_s) - jerk * rises_s**3 / 6 + after**2 / (2 * a)
    assert braked(car, speed, friction).motion[WAY] == pytest.approx(way_m, abs=2e-4)


@pytest.mark.parametrize(("kmh", "way_m"), [(10, 0.562), (20, 2.247), (30, 5.056), (50, 14.046)])
def test_braking_distances_of_the_thesis_on_asphalt(kmh: float, way_m: float) -> None:
    at_once = replace(CAR, **FREE, brake_delay_s=0.0, brake_rise_s=0.0)
    assert braked(at_once, kmh / 3.6, 0.7).motion[WAY] == pytest.approx(way_m, abs=6e-4)


@pytest.mark.parametrize(("speed", "way_m"), [(1, 0.403), (2, 1.146), (3, 2.229), (4, 3.652), (20 / 3.6, 6.540)])
def test_stopping_distances_of_the_thesis_with_its_reaction_time(speed: float, way_m: float) -> None:
    car = replace(MODEL, **FREE, brake_delay_s=4 / 30 + 0.1, brake_rise_s=0.0, max_speed_mps=10.0)
    assert braked(car, speed, 0.3).motion[WAY] == pytest.approx(way_m, abs=1e-3)


def test_within_4_m_the_scaled_car_stops_from_15_km_per_h_on_pvc_and_no_faster() -> None:
    car = replace(MODEL, **FREE, brake_delay_s=4 / 30 + 0.1, brake_rise_s=0.0)
    assert braked(car, 15.1 / 3.6, 0.3).motion[WAY] < 4.0 < braked(car, 15.3 / 3.6, 0.3).motion[WAY]


def test_rolling_and_air_slow_down_as_the_integral_says() -> None:
    car, speed = replace(CAR, rolling_mps2=0.3, drag_per_m=0.01), 20.0
    r, k = 0.3, 0.01
    stops_s = math.atan(speed * math.sqrt(k / r)) / math.sqrt(r * k)
    state = standing(car, 0.0, speed)
    for _ in range(100):
        state = move(state, Command(), 0.1, car, Road(0.9))
    phase = math.atan(speed * math.sqrt(k / r)) - math.sqrt(r * k) * 10.0
    assert state.speed_mps == pytest.approx(math.sqrt(r / k) * math.tan(phase), rel=1e-6)
    while state.speed_mps > 0:
        state = move(state, Command(), 0.01, car, Road(0.9))
    assert state.time_s == pytest.approx(stops_s, abs=0.011)
    assert state.motion[WAY] == pytest.approx(math.log(1 + k / r * speed**2) / (2 * k), rel=1e-4)


def test_the_work_of_the_motor_is_kinetic_energy_and_rolling() -> None:
    car = replace(CAR, drag_per_m=0.0)
    state = standing(car)
    for _ in range(300):
        state = move(state, Command(drive=0.5), 0.01, car, Road(0.9))
    kinetic = state.speed_mps**2 / 2
    assert state.motion[WORK] == pytest.approx(kinetic + car.rolling_mps2 * state.motion[WAY], rel=1e-3)


def test_the_scaled_car_reaches_its_top_speed_and_no_more() -> None:
    state = standing(MODEL, 0.0, 5.5)
    for _ in range(3000):
        state = move(state, Command(drive=1.0), 0.01, replace(MODEL, **FREE), Road(0.7))
    assert state.speed_mps == pytest.approx(20 / 3.6, rel=1e-3)


@given(speed=st.floats(0.01, 20), friction=st.floats(0.05, 1.2), dt_s=st.floats(0.001, 0.05), anti=st.booleans())
def test_a_braked_vehicle_stands_still_and_never_goes_back(
    speed: float, friction: float, dt_s: float, anti: bool
) -> None:
    car, state = replace(CAR, antilock=anti), standing(CAR, 0.0, speed)
    for _ in range(20):
        before, state = state, move(state, FULL_BRAKE, 0.1 + dt_s, car, Road(friction))
        assert 0 <= state.speed_mps <= before.speed_mps
        assert state.motion[0] >= before.motion[0]
    if state.speed_mps == 0:
        again = move(state, FULL_BRAKE, 1.0, car, Road(friction))
        assert again.pose == state.pose


def test_the_same_way_comes_of_steps_of_any_length() -> None:
    one, other = braked(CAR, 15.0, 0.9, 0.001), braked(CAR, 15.0, 0.9, 0.04)
    assert one.motion[WAY] == pytest.approx(other.motion[WAY], abs=1e-9)


def test_rolling_resistance_holds_against_a_small_force() -> None:
    state = move(standing(MODEL), Command(drive=0.05), 1.0, MODEL, Road(0.7))
    assert state.speed_mps == 0
    assert state.motion[WAY] == 0


def test_a_locked_wheel_stands_while_the_vehicle_slides() -> None:
    state = move(standing(MODEL, 0.0, 5.0), FULL_BRAKE, 0.3, MODEL, Road(0.3))
    assert state.motion[WHEEL] == 0
    assert state.speed_mps > 4
    assert measured_speed(move(state, FULL_BRAKE, 0.2, MODEL, Road(0.3)), MODEL) == 0


def test_wheels_that_are_kept_from_locking_turn_nearly_with_the_way() -> None:
    state = move(standing(CAR, 0.0, 15.0), FULL_BRAKE, 0.6, CAR, Road(0.5))
    assert 0.85 * state.speed_mps < state.motion[WHEEL] <= state.speed_mps


def test_wheels_spin_where_the_motor_is_stronger_than_the_grip() -> None:
    strong = replace(MODEL, drive_mps2=6.0)
    state = move(standing(strong, 0.0, 1.0), Command(drive=1.0), 0.3, strong, Road(0.2))
    assert state.motion[WHEEL] > 1.5 * state.speed_mps
    kept = move(standing(strong, 0.0, 1.0), Command(drive=1.0), 0.3, replace(strong, antilock=True), Road(0.2))
    assert kept.motion[WHEEL] == kept.speed_mps


def test_released_brakes_let_a_locked_wheel_roll_again() -> None:
    state = move(standing(MODEL, 0.0, 5.0), FULL_BRAKE, 0.4, MODEL, Road(0.3))
    state = move(state, Command(), 0.5, MODEL, Road(0.3))
    assert state.motion[WHEEL] == state.speed_mps > 2
    assert state.motion[BRAKE] == 0


def test_backward_it_goes_only_from_standstill() -> None:
    state = move(standing(MODEL, 0.0, 1.0), Command(forward=False), 0.1, MODEL, Road(0.7))
    assert state.motion[DIRECTION] == 1
    state = move(standing(MODEL), Command(drive=0.5, forward=False), 1.0, MODEL, Road(0.7))
    assert state.motion[DIRECTION] == -1
    assert state.pose[0] == pytest.approx(-state.motion[WAY])
    assert measured_speed(state, MODEL) > 0


# -- bends ------------------------------------------------------------------------------------------------------------


def test_a_turned_wheel_makes_a_circle_whose_radius_the_wheelbase_says() -> None:
    car, steer = replace(CAR, **FREE), 0.3
    radius = car.wheelbase_m / math.tan(math.radians(car.max_steer_deg) * steer)
    state = standing(car, 0.0, 5.0)
    around_s = 2 * math.pi * radius / 5.0
    state = move(state, Command(steer=steer), around_s / 2, car, Road(0.9))
    assert state.pose[:2] == pytest.approx((0.0, 2 * radius), abs=1e-2)
    state = move(state, Command(steer=steer), around_s / 2, car, Road(0.9))
    assert state.pose[:2] == pytest.approx((0.0, 0.0), abs=1e-2)


def test_a_bend_is_no_sharper_than_the_grip_allows_and_leaves_none_for_the_brakes() -> None:
    state = move(standing(CAR, 0.0, 20.0), Command(steer=1.0), 0.001, CAR, Road(0.4))
    assert state.motion[YAW_RATE] == pytest.approx(0.4 * GRAVITY_MPS2 / 20.0, rel=1e-6)
    car, v, a, yaw = replace(CAR, **FREE, brake_delay_s=0.0, brake_rise_s=0.0), 10.0, 0.5 * GRAVITY_MPS2, 0.3
    steer = math.degrees(math.atan(yaw * car.wheelbase_m / v)) / car.max_steer_deg
    state = move(standing(car, 0.0, v), Command(brake=1.0, steer=steer), 0.001, car, Road(0.5))
    assert (v - state.speed_mps) / 0.001 == pytest.approx(math.sqrt(a**2 - (v * yaw) ** 2), rel=1e-3)


# -- what it measures -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.3, 1.0, 3.0, 5.5])
def test_the_speed_is_known_to_the_step_of_the_timer(speed: float) -> None:
    car = replace(MODEL, **FREE)
    state = move(standing(car, 0.0, speed), Command(), 0.5, car, Road(0.7))
    step = speed**2 * car.sensor.tick_s / car.sensor.hole_m
    assert measured_speed(state, car) == pytest.approx(speed, abs=step + 1e-9)


def test_a_timer_without_steps_knows_it_exactly_and_one_without_holes_says_standstill() -> None:
    car = replace(MODEL, **FREE, sensor=replace(MODEL.sensor, tick_s=0.0))
    state = move(standing(car, 0.0, 2.0), Command(), 0.3, car, Road(0.7))
    assert measured_speed(state, car) == pytest.approx(2.0, rel=1e-9)
    assert measured_speed(standing(car), car) == 0


@pytest.mark.parametrize(("friction", "gain_mps2"), [(0.3, 20.57), (0.9, 2.5)])
def test_wheels_gain_speed_no_faster_than_motor_grip_and_inertia_say(friction: float, gain_mps2: float) -> None:
    vehicle, dt = replace(MODEL, rolling_mps2=0.0), 1e-3
    assert gain_of_wheels(vehicle, friction * GRAVITY_MPS2) == pytest.approx(gain_mps2, abs=0.01)
    state = standing(vehicle)
    wheels = [0.0]
    for _ in range(20):
        state = move(state, Command(drive=1.0), dt, vehicle, Road(friction))
        wheels.append(float(state.motion[WHEEL]))
    assert np.diff(wheels).max() == pytest.approx(gain_mps2 * dt, rel=0.05)
    assert gain_of_wheels(VEHICLES["passenger_car"], 0.1) == VEHICLES["passenger_car"].drive_mps2


@pytest.mark.parametrize("friction", [0.3, 0.9])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.6, 0.999])
def test_the_measured_speed_jumps_from_rest_by_no_more_than_two_roots_of_gain_and_hole(
    friction: float, phase: float
) -> None:
    dt = 1e-3
    gain_mps2 = gain_of_wheels(MODEL, friction * GRAVITY_MPS2)
    state = standing(MODEL)
    state.motion[HOLE_S] = -1.0  # it has stood for longer than the sensor waits for a hole
    state.motion[PERIOD_S], state.motion[PHASE] = math.inf, phase * MODEL.sensor.hole_m
    told = []
    for _ in range(600):
        state = move(state, Command(drive=1.0), dt, MODEL, Road(friction))
        told.append(measured_speed(state, MODEL))
    largest = np.diff(told).max()
    most = step_of_sensor(MODEL, gain_mps2)
    assert 0.1 * most < largest < most + gain_mps2 * dt


def test_the_battery_falls_from_7_5_to_6_volts_and_gives_what_is_taken() -> None:
    full = replace(standing(MODEL), charge_as=0.0)
    empty = replace(full, charge_as=MODEL.battery.capacity_ah * 3600)
    assert (open_circuit_v(full, MODEL), open_circuit_v(empty, MODEL)) == pytest.approx((7.5, 6.0))
    driving = replace(full, command=Command(drive=1.0))
    now = electricity(driving, MODEL)
    current_a = (7.5 - now.battery_v) / MODEL.battery.inner_ohm
    assert now.battery_v * current_a == pytest.approx(now.power_w)
    assert now.power_w == pytest.approx(now.motor_v * now.motor_a + MODEL.standby_w)
    ideal = replace(MODEL, battery=replace(MODEL.battery, inner_ohm=0.0))
    assert electricity(driving, ideal).battery_v == 7.5


def test_what_drives_grows_warm_and_takes_charge() -> None:
    state = replace(standing(MODEL), command=Command(drive=1.0))
    later = discharged(state, MODEL, 60.0)
    assert later.charge_as > state.charge_as
    assert later.heat_c[0] > 30 > later.heat_c[4] == 20.0


def test_an_unknown_vehicle_is_refused_with_those_that_are() -> None:
    with pytest.raises(UsageError, match="scaled_car, passenger_car"):
        vehicle_named("scaled_bus")


# -- the control unit -------------------------------------------------------------------------------------------------


def take_over(value: float = 1.0, mode: DriveMode = DriveMode.BRAKE, **steering: object) -> CanFrame:
    return CanFrame(*encode(TakeOver(mode, value, **steering)))  # type: ignore[arg-type]


def advanced(*frames: CanFrame, state: UnitState | None = None, time_s: float = 1.0) -> tuple[UnitState, Command]:
    state, command, _ = advance_unit(state or UnitState(), time_s, frames, Hand(0.4, 0.2), standing(MODEL), MODEL)
    return state, command


def test_without_a_take_over_the_remote_control_drives() -> None:
    assert advanced() == (advanced()[0], Command(0.4, 0.0, 0.2))


def test_a_take_over_brakes_whatever_the_remote_control_says() -> None:
    state, command = advanced(take_over(0.7))
    assert state.control is Control.BUS
    assert command == Command(brake=pytest.approx(0.7))


def test_a_take_over_may_drive_and_steer() -> None:
    left = {"steering": SteeringMode.LEFT, "steering_value": 0.5}
    assert advanced(take_over(0.3, DriveMode.FORWARD, **left))[1] == Command(0.3, 0.0, 0.5)
    right = {"steering": SteeringMode.RIGHT, "steering_value": 0.5}
    assert advanced(take_over(0.3, DriveMode.BACKWARD, **right))[1] == Command(0.3, 0.0, -0.5, forward=False)


@pytest.mark.parametrize("data", [bytes(8), take_over().data[:6] + b"\xca\x00"])
def test_the_master_without_the_magic_number_gives_control_back(data: bytes) -> None:
    taken, _ = advanced(take_over())
    state, command = advanced(CanFrame(0x50, data), state=taken)
    assert state.control is Control.REMOTE
    assert command.drive == 0.4
    assert isinstance(decode(0x50, data), GiveBack)


def test_without_further_take_overs_the_control_ends_after_its_timeout() -> None:
    taken, _ = advanced(take_over(), time_s=1.0)
    timeout_s = MODEL.unit.timeout_s
    assert advanced(state=taken, time_s=1.0 + 0.99 * timeout_s)[0].control is Control.BUS
    assert advanced(state=taken, time_s=1.0 + 1.01 * timeout_s)[0].control is Control.REMOTE


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_no_frame_disturbs_the_unit(can_id: int, data: bytes) -> None:
    state, command = advanced(CanFrame(can_id, data))
    assert state.control is Control.REMOTE or can_id == 0x50
    assert 0 <= command.brake <= 1


def test_what_the_vehicle_itself_sends_is_no_order() -> None:
    status = CanFrame(*encode(CarStatus1(0.0, 7.2, 0.0, 1.0)))
    state, command = advanced(status)
    assert state.ignored == 1
    assert command == Command(0.4, 0.0, 0.2)


def test_status_comes_at_its_period_and_remote_values_when_they_are_new() -> None:
    state, ids, car = UnitState(), [], standing(MODEL, 0.0, 2.0)
    for k in range(200):
        hand = Hand(0.5 if k < 100 else 0.0)
        state, _, sent = advance_unit(state, k * 0.005, [], hand, car, MODEL)
        ids += [frame.can_id for frame in sent]
    periods = round(1.0 / Unit().status_period_s)
    assert (ids.count(0xA0), ids.count(0xA1), ids.count(0xDB)) == (periods, periods, 2)


def test_status_tells_speed_and_the_power_that_two_bytes_hold() -> None:
    driving = replace(standing(CAR, 0.0, 20.0), command=Command(drive=1.0))
    _, _, sent = advance_unit(UnitState(), 0.0, [], Hand(1.0, -0.3), driving, CAR)
    first, second, remote = (decode(frame.can_id, frame.data) for frame in sent)
    assert isinstance(first, CarStatus1)
    assert isinstance(second, CarStatus2)
    assert isinstance(remote, RemoteValues)
    assert first.speed_mps == pytest.approx(20.0, abs=0.02)
    assert first.power_w == pytest.approx(65.535)
    assert remote.steering == pytest.approx(-0.3, abs=1e-3)
    assert np.isfinite(second.temperature_1_c)
