"""The state machine of the brake, transition by transition, each limit from both sides."""

import dataclasses
import math
from typing import Any

import pytest

from rangecam.brake.machine import (
    Action,
    BrakeState,
    CarState,
    Fault,
    Inputs,
    MachineSettings,
    Mode,
    Perception,
    Request,
    advance,
)
from rangecam.config import load_config
from rangecam.errors import UsageError

# Times are multiples of 1/64 s, which binary numbers hold exactly, so that "at the limit" means just that.
TICK_S = 1 / 64
SETTINGS = MachineSettings(
    image_timeout_s=6 * TICK_S,
    car_timeout_s=4 * TICK_S,
    standstill_time_s=8 * TICK_S,
    recovery_images=3,
    give_back_time_s=4 * TICK_S,
    standstill_mps=0.0625,
    max_acceleration_mps2=16.0,
    max_deceleration_mps2=16.0,
    sure_deceleration_mps2=4.0,
    speed_step_mps=0.25,
    brake=0.75,
)


class Drive:
    """A machine that is called every 1/64 s, with a good image and car state each time unless told otherwise."""

    def __init__(self, speed_mps: float = 3.0, **settings: Any) -> None:
        self.settings = dataclasses.replace(SETTINGS, **settings)
        self.state = BrakeState()
        self.now = self.frame = 0
        self.request = Request(0.0, 0, Action.NONE)
        self.seen = Perception(0, 0.0, 0.0, False, "")
        self.car = CarState(0.0, 0.0)
        for _ in range(20):
            self.step()
        for _ in range(16):
            self.step(speed_mps=min(speed_mps, self.car.speed_mps + 0.25))
        assert self.state.mode is Mode.USER_CONTROL
        assert self.request.action is Action.NONE

    def step(self, image: bool = True, car: bool = True, ticks: int = 1, **changes: Any) -> Mode:
        """Take one step; changes are fields of Perception and CarState (car_received_s for its arrival)."""
        self.now += ticks
        self.frame += 1
        now_s = self.now * TICK_S
        of_car = {k: changes.pop(k) for k in ("speed_mps", "forward") if k in changes}
        arrived = changes.pop("car_received_s", now_s)
        if image:
            self.seen = Perception(
                **{
                    "frame_id": self.frame,
                    "time_s": now_s - 100.0,
                    "received_s": now_s,
                    "brake": False,
                    "reason": "free",
                    **changes,
                }
            )
        if car:
            self.car = CarState(
                of_car.get("speed_mps", self.car.speed_mps), arrived, of_car.get("forward", self.car.forward)
            )
        self.state, self.request = advance(self.state, Inputs(now_s, self.seen, self.car), self.settings)
        assert (self.request.action is Action.BRAKE) == (self.state.mode is not Mode.USER_CONTROL)
        assert self.request.number == self.state.number
        assert self.request.time_s == now_s
        return self.state.mode

    def steps(self, n: int, **changes: Any) -> list[Mode]:
        return [self.step(**changes) for _ in range(n)]

    @property
    def fault(self) -> Fault | None:
        return self.state.cause.fault if self.state.mode is Mode.FAULT else None


def stopping(**settings: Any) -> Drive:
    drive = Drive(**settings)
    assert drive.step(brake=True, reason="box at 2 m") is Mode.STOPPING
    return drive


# -- user control -----------------------------------------------------------------------------------------------------


def test_while_nothing_is_in_the_way_nothing_is_sent() -> None:
    drive = Drive()
    assert set(drive.steps(100)) == {Mode.USER_CONTROL}
    assert drive.request == Request(drive.now * TICK_S, 136, Action.NONE)


def test_an_image_that_demands_braking_stops_the_car_and_says_why() -> None:
    drive = stopping()
    cause = drive.request.cause
    now_s = drive.now * TICK_S
    assert cause is not None
    assert (cause.fault, cause.reason, cause.since_s, cause.time_s) == (None, "box at 2 m", now_s, now_s)
    assert drive.request.action is Action.BRAKE
    assert drive.request.brake == 0.75


def test_the_cause_dates_from_the_image_not_from_the_step() -> None:
    drive = Drive()
    drive.step(brake=True, received_s=(drive.now - 1) * TICK_S)
    cause = drive.request.cause
    assert cause is not None
    assert (cause.since_s - cause.time_s) / TICK_S == 2


@pytest.mark.parametrize(
    ("changes", "mode"),
    [
        ({"forward": False}, Mode.USER_CONTROL),
        ({"speed_mps": 3.0, "brake": False}, Mode.USER_CONTROL),
        ({"faults": (Fault.SATURATED,)}, Mode.USER_CONTROL),  # a bad image may not brake
        ({}, Mode.STOPPING),
    ],
)
def test_only_a_good_image_that_demands_it_stops_a_car_that_drives_forward(changes: Any, mode: Mode) -> None:
    assert Drive().step(**{"brake": True, **changes}) is mode


@pytest.mark.parametrize(("speed", "mode"), [(0.0625, Mode.USER_CONTROL), (0.0626, Mode.STOPPING)])
def test_a_standing_car_needs_no_stop(speed: float, mode: Mode) -> None:
    assert Drive(speed_mps=speed).step(brake=True) is mode


# -- stopping ---------------------------------------------------------------------------------------------------------


def test_a_stop_holds_until_the_car_has_stood_for_a_while_though_the_object_is_gone() -> None:
    drive = stopping()
    assert set(drive.steps(30, speed_mps=2.0)) == {Mode.STOPPING}
    for speed in (1.75, 1.5, 1.25, 1.0, 0.75, 0.5, 0.25, 0.125):
        assert drive.step(ticks=4, speed_mps=speed) is Mode.STOPPING
    assert set(drive.steps(8, speed_mps=0.0625)) == {Mode.STOPPING}
    assert drive.step() is Mode.USER_CONTROL


def test_moving_again_begins_the_standstill_anew() -> None:
    drive = stopping(sure_deceleration_mps2=1e3)
    drive.steps(8, speed_mps=0.0)
    drive.step(speed_mps=0.25)
    assert set(drive.steps(8, speed_mps=0.0)) == {Mode.STOPPING}
    assert drive.step() is Mode.USER_CONTROL


def test_so_does_one_car_state_that_cannot_be() -> None:
    drive = stopping(sure_deceleration_mps2=1e3)
    drive.steps(8, speed_mps=0.0)
    drive.step(speed_mps=math.nan)
    assert set(drive.steps(8, speed_mps=0.0)) == {Mode.STOPPING}
    assert drive.step() is Mode.USER_CONTROL


def test_wheels_that_lock_do_not_end_the_stop_before_the_car_must_have_stopped() -> None:
    drive = stopping(speed_mps=2.0)
    modes = drive.steps(60, speed_mps=0.0)
    # 2 m/s at 4 m/s2 take 32 steps, less 1/64 s for the last 0.0625 m/s; then 8 steps of standstill
    assert modes.index(Mode.USER_CONTROL) == 31 - 1 + 8


def test_the_cause_of_a_stop_is_affirmed_by_every_good_image_and_keeps_its_begin() -> None:
    drive = stopping()
    began_s = drive.now * TICK_S
    drive.step()
    image_s = drive.now * TICK_S
    drive.step(image=False)
    cause = drive.request.cause
    assert cause is not None
    assert (cause.reason, cause.since_s, cause.time_s) == ("box at 2 m", began_s, image_s)


def test_control_is_given_back_by_messages_for_a_while_and_then_by_silence() -> None:
    drive = stopping(sure_deceleration_mps2=1e3)
    drive.steps(9, speed_mps=0.0)
    assert drive.state.released_s == drive.now * TICK_S
    assert drive.request == Request(drive.now * TICK_S, drive.state.number, Action.GIVE_BACK)
    actions = []
    for _ in range(6):
        drive.step()
        actions.append(drive.request.action)
    assert actions == [Action.GIVE_BACK] * 4 + [Action.NONE] * 2


def test_an_image_from_before_the_give_back_cannot_stop_the_car_again() -> None:
    drive = stopping(sure_deceleration_mps2=1e3)
    drive.steps(9, speed_mps=0.0, brake=True)
    assert drive.state.mode is Mode.USER_CONTROL
    assert set(drive.steps(3, image=False, speed_mps=0.25)) == {Mode.USER_CONTROL}
    assert drive.step(brake=True) is Mode.STOPPING


def test_a_fault_takes_a_stop_over_and_counts_from_there() -> None:
    drive = stopping()
    assert drive.steps(7, image=False)[-2:] == [Mode.STOPPING, Mode.FAULT]
    assert drive.fault is Fault.NO_IMAGE
    assert drive.state.cause.since_s == drive.now * TICK_S


# -- faults of the image ----------------------------------------------------------------------------------------------


def test_without_images_the_car_is_stopped_one_step_after_the_timeout() -> None:
    drive = Drive()
    assert drive.steps(7, image=False) == [Mode.USER_CONTROL] * 6 + [Mode.FAULT]
    assert drive.fault is Fault.NO_IMAGE
    began_s = drive.now * TICK_S
    drive.step(image=False)
    cause = drive.request.cause
    assert cause is not None
    assert cause.reason == "no new image"
    assert (cause.since_s, cause.time_s) == (began_s, drive.now * TICK_S)


def test_the_age_of_an_image_counts_from_its_arrival() -> None:
    drive = Drive()
    assert drive.step(received_s=(drive.now - 5) * TICK_S) is Mode.USER_CONTROL
    assert drive.step(received_s=(drive.now - 6) * TICK_S) is Mode.FAULT


BAD_IMAGES: dict[str, tuple[dict[str, Any], Fault]] = {
    "the same number": ({"frame_id": 36}, Fault.REPEATED),
    "the same camera time": ({"time_s": 36 * TICK_S - 100.0}, Fault.REPEATED),
    "an older number": ({"frame_id": 35}, Fault.OUT_OF_ORDER),
    "an older camera time": ({"time_s": 35 * TICK_S - 100.0}, Fault.OUT_OF_ORDER),
    "camera time not a number": ({"time_s": math.nan}, Fault.CLOCK),
    "camera time without end": ({"time_s": math.inf}, Fault.CLOCK),
    "arrival not a number": ({"received_s": math.nan}, Fault.CLOCK),
    "arrival in the future": ({"received_s": 1e9}, Fault.CLOCK),
    **{fault.name: ({"faults": (fault, Fault.LATE)}, fault) for fault in Fault if fault is not Fault.LATE},
}


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_bad_images_are_no_images_and_the_fault_says_which(name: str) -> None:
    changes, fault = BAD_IMAGES[name]
    drive = Drive()
    assert drive.frame == 36
    assert drive.steps(7, brake=True, **changes) == [Mode.USER_CONTROL] * 6 + [Mode.FAULT]
    assert drive.fault is fault
    assert drive.request.cause is not None
    assert drive.request.cause.reason == fault.value


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_a_few_bad_images_among_good_ones_are_passed_over(name: str) -> None:
    drive = Drive()
    assert set(drive.steps(5, **BAD_IMAGES[name][0])) == {Mode.USER_CONTROL}
    assert set(drive.steps(7)) == {Mode.USER_CONTROL}
    assert drive.steps(7, image=False)[-1] is Mode.FAULT
    assert drive.fault is Fault.NO_IMAGE  # what was wrong before is forgotten


def test_an_image_that_arrives_now_is_not_in_the_future() -> None:
    drive = Drive()
    drive.steps(5, image=False)
    assert drive.step(received_s=(drive.now + 1) * TICK_S) is Mode.USER_CONTROL
    assert drive.state.image_s == drive.now * TICK_S


def test_a_clock_that_jumps_back_is_a_fault_and_then_the_new_time_counts() -> None:
    drive = Drive(speed_mps=0.0)
    drive.now -= 1000
    assert drive.step() is Mode.FAULT
    assert drive.steps(30)[-1] is Mode.USER_CONTROL


def test_a_clock_that_is_not_a_number_brakes() -> None:
    drive = Drive()
    _, request = advance(drive.state, Inputs(math.nan, drive.seen, drive.car), SETTINGS)
    assert request.action is Action.BRAKE


# -- faults of the car state ------------------------------------------------------------------------------------------


def test_without_car_states_the_car_is_stopped_one_step_after_the_timeout() -> None:
    drive = Drive()
    assert drive.steps(5, car=False) == [Mode.USER_CONTROL] * 4 + [Mode.FAULT]
    assert drive.fault is Fault.NO_CAR_STATE


BAD_CARS: dict[str, tuple[dict[str, Any], Fault]] = {
    "not a number": ({"speed_mps": math.nan}, Fault.SPEED_IMPOSSIBLE),
    "negative": ({"speed_mps": -0.001}, Fault.SPEED_IMPOSSIBLE),
    "faster than the car can": ({"speed_mps": 6.001}, Fault.SPEED_IMPOSSIBLE),
    "jump up": ({"speed_mps": 6.0}, Fault.SPEED_JUMP),
    "jump down": ({"speed_mps": 0.0}, Fault.SPEED_JUMP),
    "arrived in the future": ({"car_received_s": 1e9}, Fault.CLOCK),
    "arrived long ago": ({"car_received_s": 0.25}, Fault.CLOCK),
    "arrival not a number": ({"car_received_s": math.nan}, Fault.CLOCK),
}


@pytest.mark.parametrize("name", BAD_CARS)
def test_bad_car_states_are_none_and_the_fault_says_which(name: str) -> None:
    changes, fault = BAD_CARS[name]
    drive = Drive()
    assert drive.steps(5, **changes) == [Mode.USER_CONTROL] * 4 + [Mode.FAULT]
    assert drive.fault is fault


@pytest.mark.parametrize("name", BAD_CARS)
def test_a_few_bad_car_states_among_good_ones_are_passed_over(name: str) -> None:
    drive = Drive()
    assert set(drive.steps(3, **BAD_CARS[name][0])) == {Mode.USER_CONTROL}
    assert set(drive.steps(5, speed_mps=3.0)) == {Mode.USER_CONTROL}
    assert drive.steps(5, car=False)[-1] is Mode.FAULT
    assert drive.fault is Fault.NO_CAR_STATE


@pytest.mark.parametrize("speed", [0.0, 6.0])
def test_standstill_and_the_greatest_speed_are_possible(speed: float) -> None:
    drive = Drive(speed_mps=speed, max_acceleration_mps2=1e6, max_deceleration_mps2=1e6)
    assert set(drive.steps(9, speed_mps=speed)) == {Mode.USER_CONTROL}
    assert drive.state.car_s == drive.now * TICK_S


@pytest.mark.parametrize("ticks", [1, 2])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("excess", "taken"), [(0.0, True), (2.0**-20, False)])
def test_the_speed_changes_no_faster_than_a_car_can(ticks: int, sign: int, excess: float, taken: bool) -> None:
    drive = Drive()
    allowed = 16.0 * ticks * TICK_S + 0.25
    drive.step(ticks=ticks, speed_mps=3.0 + sign * (allowed + excess))
    assert (drive.state.car_s == drive.now * TICK_S) == taken
    assert drive.state.car_fault is (Fault.NO_CAR_STATE if taken else Fault.SPEED_JUMP)


def test_in_a_stop_wheels_may_lock_but_not_race() -> None:
    drive = stopping()
    drive.step(speed_mps=0.0)
    assert drive.state.car_fault is Fault.NO_CAR_STATE
    drive.step(speed_mps=6.0)
    assert drive.state.car_fault is Fault.SPEED_JUMP


@pytest.mark.parametrize(
    ("speed", "scene", "contradicted"),
    [(0.0, 1.01, True), (0.0625, 1.01, True), (0.063, 1.01, False), (0.0, 1.0, False), (0.0, None, False)],
)
def test_a_scene_that_comes_closer_contradicts_standstill(
    speed: float, scene: float | None, contradicted: bool
) -> None:
    drive = Drive(speed_mps=speed)
    modes = drive.steps(5, scene_speed_mps=scene)
    assert modes[-1] is (Mode.FAULT if contradicted else Mode.USER_CONTROL)
    assert drive.fault is (Fault.SPEED_CONTRADICTED if contradicted else None)


# -- the end of a fault -----------------------------------------------------------------------------------------------


def faulty(**settings: Any) -> Drive:
    drive = Drive(speed_mps=0.0, **{"standstill_time_s": 0.0, **settings})
    drive.steps(7, image=False)
    assert drive.state.mode is Mode.FAULT
    return drive


def test_a_fault_ends_after_enough_good_images_at_standstill() -> None:
    drive = faulty()
    assert drive.steps(3) == [Mode.FAULT, Mode.FAULT, Mode.USER_CONTROL]
    assert drive.request.action is Action.GIVE_BACK


def test_a_bad_image_begins_the_count_anew() -> None:
    drive = faulty()
    drive.steps(2)
    assert drive.step(faults=(Fault.BLOCKED,)) is Mode.FAULT
    assert drive.steps(3) == [Mode.FAULT, Mode.FAULT, Mode.USER_CONTROL]


def test_a_fault_does_not_end_while_the_car_moves() -> None:
    drive = Drive()
    drive.steps(7, image=False)
    assert set(drive.steps(100)) == {Mode.FAULT}
    affirmed = drive.request.cause
    assert affirmed is not None
    assert affirmed.time_s == drive.now * TICK_S
    assert affirmed.fault is Fault.NO_IMAGE


def test_a_fault_does_not_end_without_car_states() -> None:
    drive = faulty(car_timeout_s=3 * TICK_S)
    assert set(drive.steps(1)) == {Mode.FAULT}
    assert set(drive.steps(3, image=False, car=False)) == {Mode.FAULT}
    assert set(drive.steps(20, car=False)) == {Mode.FAULT}
    assert drive.fault is Fault.NO_CAR_STATE
    assert drive.steps(3) == [Mode.FAULT, Mode.FAULT, Mode.USER_CONTROL]


def test_standstill_counts_only_since_nothing_is_wrong() -> None:
    drive = faulty(standstill_time_s=8 * TICK_S)
    assert drive.steps(9) == [Mode.FAULT] * 8 + [Mode.USER_CONTROL]


def test_a_camera_that_begins_anew_is_taken_up_in_a_fault() -> None:
    drive = Drive(speed_mps=0.0, standstill_time_s=0.0)
    drive.frame = 0
    assert drive.steps(7)[-1] is Mode.FAULT
    assert drive.fault is Fault.OUT_OF_ORDER
    assert drive.steps(4) == [Mode.FAULT] * 3 + [Mode.USER_CONTROL]


def test_a_car_that_begins_anew_is_taken_up_in_a_fault() -> None:
    drive = Drive(speed_mps=0.0)
    assert drive.steps(5, speed_mps=5.0)[-1] is Mode.FAULT
    assert drive.fault is Fault.SPEED_JUMP
    drive.step(speed_mps=5.0)
    assert drive.state.speed_mps == 5.0
    drive.steps(7, speed_mps=-1.0)
    assert drive.fault is Fault.SPEED_IMPOSSIBLE
    assert drive.state.speed_mps == 5.0
    assert drive.steps(100, speed_mps=0.0)[-1] is Mode.USER_CONTROL


def test_speeds_in_a_fault_count_as_they_do_in_a_stop() -> None:
    drive = Drive(speed_mps=2.0)
    drive.steps(7, image=False)
    assert drive.steps(60, speed_mps=0.0).index(Mode.USER_CONTROL) == 31 - 1 + 8


def test_the_machine_starts_as_a_fault_that_ends_like_any_other() -> None:
    state, request = advance(BrakeState(), Inputs(5.0), SETTINGS)
    assert state.cause.fault is Fault.NO_IMAGE
    assert state.cause.since_s == -math.inf
    assert (request.action, request.number) == (Action.BRAKE, 1)
    state, _ = advance(BrakeState(), Inputs(5.0, Perception(0, 0.0, 5.0, False, "")), SETTINGS)
    assert state.cause.fault is Fault.NO_CAR_STATE
    assert BrakeState().cause.fault is Fault.STARTING
    assert BrakeState().mode is Mode.FAULT


def test_the_first_car_state_may_have_any_speed() -> None:
    state, _ = advance(BrakeState(), Inputs(5.0, None, CarState(5.5, 5.0)), SETTINGS)
    assert (state.speed_mps, state.car_s) == (5.5, 5.0)


def test_a_machine_that_has_not_begun_has_seen_and_heard_nothing_and_asks_for_nothing() -> None:
    state = BrakeState()
    assert (state.image_s, state.car_s, state.released_s) == (-math.inf,) * 3
    assert (state.wheels_s, state.standing_s) == (math.inf, math.inf)
    assert (state.number, state.good_images, state.speed_mps) == (0, 0, 0.0)
    assert (state.perception.received_s, state.perception.time_s, state.car.received_s) == (-math.inf,) * 3
    assert (state.cause.since_s, state.cause.time_s) == (-math.inf, -math.inf)
    seen = state.perception
    assert (seen.track_id, seen.distance_m, seen.closing_mps) == (0, math.inf, 0.0)
    assert Request(0.0, 0, Action.NONE).brake == 0.0


def test_without_brakes_the_speed_is_that_of_the_wheels_however_fast_it_falls() -> None:
    drive = Drive(speed_mps=3.0)
    drive.step(speed_mps=2.75)  # 16 m/s2, four times what is sure under our brakes
    assert drive.state.speed_mps == 2.75


@pytest.mark.parametrize("speed_mps", [0.0, 4.25])
def test_the_least_and_the_greatest_possible_speed_are_believed(speed_mps: float) -> None:
    drive = Drive(speed_mps=4.0 if speed_mps else 0.0, max_speed_mps=4.25)
    drive.step(speed_mps=speed_mps)
    assert (drive.state.car.speed_mps, drive.state.speed_mps) == (speed_mps, speed_mps)
    stops = stopping(speed_mps=4.0, max_speed_mps=4.25)
    stops.step(speed_mps=speed_mps)
    assert stops.state.speed_mps == pytest.approx(speed_mps or 4.0 - 4.0 * TICK_S)


def test_a_car_that_is_seen_to_slide_on_locked_wheels_does_not_stand() -> None:
    drive = stopping(speed_mps=1.0)
    drive.steps(16, speed_mps=0.0, track_id=3, closing_mps=0.5)
    assert drive.state.speed_mps == 0.0  # it must stand by now on the road that is reckoned with
    assert set(drive.steps(60, speed_mps=0.0, track_id=3, closing_mps=0.2)) == {Mode.STOPPING}
    modes = drive.steps(40, speed_mps=0.0, track_id=3, closing_mps=0.1)
    assert modes.index(Mode.USER_CONTROL) == math.ceil(SETTINGS.standstill_time_s / TICK_S)


def test_somebody_who_walks_up_to_a_standing_car_holds_it_for_some_seconds_only() -> None:
    drive = stopping(speed_mps=0.25, max_slide_s=1.0)
    modes = drive.steps(200, speed_mps=0.0, track_id=3, closing_mps=1.0)
    stands_s = 1.0 + TICK_S + SETTINGS.standstill_time_s
    assert modes.index(Mode.USER_CONTROL) == pytest.approx(stands_s / TICK_S + 0.25 / 4.0 / TICK_S, abs=2)


def test_the_cause_of_a_fault_is_affirmed_by_every_step_until_it_is_over() -> None:
    drive = Drive()
    drive.steps(7, image=False)
    drive.steps(2)
    drive.step(image=False)
    cause = drive.request.cause
    assert cause is not None
    assert (drive.state.mode, cause.time_s) == (Mode.FAULT, drive.now * TICK_S)


def test_of_two_car_states_that_arrived_at_once_the_first_counts() -> None:
    drive = Drive()
    drive.step(image=False, speed_mps=2.9, car_received_s=drive.car.received_s)
    assert drive.state.car_fault is Fault.CLOCK
    assert drive.state.car.speed_mps == 3.0


def test_a_bad_car_state_in_a_fault_begins_the_standstill_anew() -> None:
    drive = Drive(speed_mps=0.0)
    drive.steps(7, image=False)
    drive.steps(3)
    assert drive.state.mode is Mode.FAULT
    assert math.isfinite(drive.state.standing_s)
    drive.step(speed_mps=5.0)
    assert (drive.state.mode, drive.state.standing_s) == (Mode.FAULT, math.inf)


# -- settings ---------------------------------------------------------------------------------------------------------


def test_the_least_that_must_pass_for_a_silent_sensor_to_stop_the_car_is_a_tenth_of_a_second() -> None:
    assert (MachineSettings().image_timeout_s, MachineSettings().car_timeout_s) == (0.1, 0.1)
    assert MachineSettings().max_speed_mps > 20 / 3.6


@pytest.mark.parametrize("value", [0, 1.1])
def test_a_brake_that_does_not_brake_cannot_be_set(value: float) -> None:
    with pytest.raises(UsageError, match=r"brake.machine.brake"):
        load_config("scaled_car", {"brake": {"machine": {"brake": value}}})


def test_a_gate_that_would_fall_silent_in_a_stop_cannot_be_set() -> None:
    with pytest.raises(UsageError, match=r"cause_age_s = 0.15: must exceed machine.image_timeout_s = 0.15"):
        load_config("scaled_car", {"brake": {"machine": {"image_timeout_s": 0.15}}})
