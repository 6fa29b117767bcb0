"""Machine and gate, explored exhaustively: every reachable state with every class of input keeps the invariants.

Beside the pair runs a model of the world that knows the truth: how fast the car really is, when the last good image and
car state came, and whether the last good image demanded braking. The invariants speak of that truth alone. Times are
whole ticks and are stored as ages, so that the states are finitely many; the search ends when there is no new one.
"""

import itertools
import math
from dataclasses import dataclass, replace
from functools import cache

from rangecam.brake.gate import CanFrame, Gate, GateSettings, arm, let_pass
from rangecam.brake.machine import (
    Action,
    BrakeState,
    CarState,
    Cause,
    Fault,
    Inputs,
    MachineSettings,
    Mode,
    Perception,
    Request,
    advance,
)

TICK_S = 0.0625
SETTINGS = MachineSettings(
    image_timeout_s=TICK_S,
    car_timeout_s=TICK_S,
    standstill_mps=0.0,
    standstill_time_s=TICK_S,
    recovery_images=2,
    give_back_time_s=TICK_S,
    max_speed_mps=2.0,
    max_acceleration_mps2=16.0,
    max_deceleration_mps2=16.0,
    sure_deceleration_mps2=16.0,
    speed_step_mps=0.0,
    scene_speed_mps=1.0,
)
GATE = GateSettings(request_age_s=TICK_S / 2, cause_age_s=1.5 * TICK_S)
OLD = 2
"""Ages in ticks beyond which nothing makes a difference: all timeouts are shorter."""
ARMED = arm(Gate())
IMAGES = ("none", "free", "brake", "repeated", "older", "future", "sick")
"""What the camera does in a tick; only `free` and `brake` are good images, and all bad ones demand braking."""
CARS = ("none", "true", "locked", "not a number", "older")
"""What the car reports in a tick; `locked` is a speed of zero while the car brakes, `true` is the true speed."""
MOTIONS = ("hold", "faster", "slower")
"""What the car does in a tick: keep its speed, gain or lose 1 m/s (the most that it can)."""
STEPS = (1, 2, -100)
"""How many ticks the clock of the decision unit moves on: 2 exceeds the timeouts, -100 is a clock that was set back."""
# Wheels lock while the car brakes, and it does so at least as hard as the settings promise.
REPORTS = [
    *itertools.product(("none", "true"), MOTIONS),
    ("locked", "slower"),
    *((car, "hold") for car in CARS[3:]),
]
INPUTS = [
    *itertools.product(IMAGES, REPORTS, STEPS[:1]),
    *itertools.product(IMAGES[:3], [("none", "hold"), ("true", "hold")], STEPS[1:]),
]


@dataclass(frozen=True)
class World:
    """The truth: speed of the car, now and when last heard; ages of the last good image and car state, to OLD."""

    speed: int = 0
    image_age: int = OLD
    car_age: int = OLD
    demands: bool = False
    heard: int = 0


Node = tuple[BrakeState, World]


def test_every_reachable_state_keeps_the_invariants_under_every_input() -> None:
    start: Node = (rebased(BrakeState(), 0.0), World())
    known = {start}
    frontier = [start]
    depth = transitions = 0
    while frontier:
        depth += 1
        found: set[Node] = set()
        for node in frontier:
            for after in successors(node):
                transitions += 1
                if after not in known:
                    known.add(after)
                    found.add(after)
        frontier = list(found)
    modes = {state.mode for state, _ in known}
    assert modes == set(Mode)
    assert depth >= 6
    assert transitions > 50_000
    for node in known:
        assert_control_comes_back(node)


def successors(node: Node) -> list[Node]:
    """Return the states after every class of input, once the invariants of each step have been checked."""
    state, world = node
    after = []
    for image, (car, motion), ticks in INPUTS:
        if motion == "faster" and state.mode is not Mode.USER_CONTROL:
            continue  # the brakes hold
        if car == "locked" and world.car_age > 0:
            continue  # nobody knows how fast the car was before its wheels locked
        after.append(taken(state, world, image, car, motion, ticks))
    return list(dict.fromkeys(after))


def taken(state: BrakeState, world: World, image: str, car: str, motion: str, ticks: int) -> Node:
    """Return the state after one step, and check it against the truth."""
    now_s = ticks * TICK_S
    speed = max(0, min(1, world.speed + {"hold": 0, "faster": 1, "slower": -1}[motion]))
    inputs = Inputs(now_s, perceived(image, now_s), reported(car, speed, now_s))
    next_state, request = advance(state, inputs, SETTINGS)
    good_image = image in ("free", "brake") and ticks > 0
    good_car = car in ("true", "locked") and ticks > 0
    truth = World(
        speed=speed,
        image_age=0 if good_image else min(OLD, world.image_age + abs(ticks)),
        car_age=0 if good_car else min(OLD, world.car_age + abs(ticks)),
        demands=image == "brake" if good_image else world.demands,
        heard=speed if good_car else world.heard,
    )
    check(state, world, next_state, truth, request, ticks)
    return rebased(next_state, now_s), truth


@cache
def perceived(image: str, now_s: float) -> Perception | None:
    """Return an image of a class. The newest good one so far has number 0 and camera time 0."""
    new = Perception(1, 1.0, now_s, image == "brake", "box")
    made = {
        "none": None,
        "free": new,
        "brake": new,
        "repeated": replace(new, frame_id=0, time_s=0.0, brake=True),
        "older": replace(new, frame_id=-1, time_s=-1.0, brake=True),
        "future": replace(new, received_s=now_s + 1.0, brake=True),
        "sick": replace(new, faults=(Fault.FROZEN,), brake=True),
    }
    return made[image]


@cache
def reported(car: str, speed: int, now_s: float) -> CarState | None:
    """Return a car state of a class."""
    made = {
        "none": None,
        "true": CarState(float(speed), now_s),
        "locked": CarState(0.0, now_s),
        "not a number": CarState(math.nan, now_s),
        "older": CarState(float(speed), now_s - 10.0),
    }
    return made[car]


def check(before: BrakeState, was: World, after: BrakeState, truth: World, request: Request, ticks: int) -> None:
    """Assert what must never fail."""
    gate, frame = let_pass(ARMED, request, ticks * TICK_S, GATE)
    story = (before, was, after, truth, request)
    never_drives(frame, story)
    assert not gate.refused, story  # what the machine wants, the gate agrees with: no silence by refusal
    stale = truth.image_age > 1 or truth.car_age > 1 or ticks < 0
    takes = frame is not None and request.action is Action.BRAKE
    # No silence on stale input.
    if stale:
        assert takes, story
    # No take-over without a fresh, valid cause.
    if takes and before.mode is Mode.USER_CONTROL:
        assert request.cause is not None, story
        if request.cause.fault is None:
            assert truth.demands, story
            assert truth.image_age <= 1, story
            assert truth.car_age <= 1, story
        else:
            assert stale, story
    # A stop, and a fault, hold until standstill.
    if before.mode is not Mode.USER_CONTROL and after.mode is Mode.USER_CONTROL:
        assert truth.heard == 0, story
        assert request.action is Action.GIVE_BACK, story
        assert not stale, story
    # Where nobody brakes, nothing but the give-back is sent, and only after a stop.
    if after.mode is Mode.USER_CONTROL and request.action is Action.NONE:
        assert frame is None, story


def never_drives(frame: CanFrame | None, story: object) -> None:
    """Assert that a frame is nothing, gives back, or brakes without steering."""
    if frame is None:
        return
    assert frame.can_id == 0x50, story
    brakes = frame.data[0] == 3 and frame.data[3:] == bytes([0, 0, 0, 0xCA, 0xFE])
    assert frame.data == bytes(8) or brakes, story


def assert_control_comes_back(node: Node) -> None:
    """Assert that good input and a standing car end every stop and fault within a stated number of steps."""
    state, world = node
    for _ in range(12):
        if state.mode is Mode.USER_CONTROL:
            break
        state, world = healthy(state, world)
    assert state.mode is Mode.USER_CONTROL, node


@cache
def healthy(state: BrakeState, world: World) -> Node:
    return taken(state, world, "free", "true", "slower", 1)


def rebased(state: BrakeState, now_s: float) -> BrakeState:
    """Return the same state with times as ages, old ones all alike, numbers counted from the newest.

    What only says why, and what the next step does not look at, is made alike.
    """

    def age(time_s: float) -> float:
        ahead = time_s - now_s
        return time_s if time_s == math.inf else 1.0 if ahead > 0.5 else max(-(OLD + 1) * TICK_S, ahead)

    seen, car = state.perception, state.car
    standing_s = max(state.standing_s, state.car_s - SETTINGS.standstill_time_s)
    newest = 0 if seen.frame_id >= 0 else -1
    camera_s = float(newest) if math.isfinite(seen.time_s) else seen.time_s
    return replace(
        state,
        number=0,
        cause=CAUSES[state.cause.fault is None],
        perception=Perception(newest, camera_s, 0.0, seen.brake and state.mode is Mode.USER_CONTROL, "box"),
        image_s=age(state.image_s),
        image_fault=Fault.NO_IMAGE,
        car=CarState(0.0, age(car.received_s)),
        car_s=age(state.car_s),
        car_fault=Fault.NO_CAR_STATE,
        good_images=state.good_images if state.mode is Mode.FAULT else 0,
        standing_s=age(standing_s) if state.mode is not Mode.USER_CONTROL else math.inf,
        released_s=age(state.released_s) if state.mode is Mode.USER_CONTROL else -math.inf,
    )


CAUSES = (Cause(Fault.NO_IMAGE, "fault", 0.0, 0.0), Cause(None, "object", 0.0, 0.0))
