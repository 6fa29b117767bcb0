"""The state machine of the emergency brake (S-DEC-04, Steinbäck 2016, section 3.5.4 and figure 3.21). Pure.

    USER_CONTROL --an object demands braking--> STOPPING --standstill--> USER_CONTROL
    any state ----the system does not work----> FAULT ----works again, at standstill--> USER_CONTROL

One rule covers every way in which input can go wrong: a bad image is no image, and a bad car state is none. What is not
followed by a good one within its timeout is a fault, and a fault brakes to a stop. `advance` is to be called for every
new image, every new car state and at least every 20 ms: the timeouts are exact to within that time.
"""

import math
from enum import Enum, IntEnum
from typing import Annotated

from annotated_types import Interval

from rangecam.settings import NonNegative, Positive, PositiveInt, settings
from rangecam.values import changed, record


class Mode(IntEnum):
    """Who drives; the names of figure 3.21 are User Control, Stop via CAN, System Not Working."""

    USER_CONTROL = 0
    STOPPING = 1
    FAULT = 2


class Fault(Enum):
    """What does not work; the value is what people read."""

    STARTING = "not yet seen to work"
    NO_IMAGE = "no new image"
    CLOCK = "stamped with a time that has not come"
    REPEATED = "the same image again"
    OUT_OF_ORDER = "an image older than the last"
    FROZEN = "the same samples again"
    LATE = "images come late"
    SATURATED = "too much light"
    BLOCKED = "lens blocked or blind"
    NO_CAR_STATE = "no new car state"
    SPEED_IMPOSSIBLE = "a speed that the car cannot have"
    SPEED_JUMP = "the speed changed faster than a car can"
    SPEED_CONTRADICTED = "the scene moves although the car says that it stands"


class Action(IntEnum):
    """What the machine asks the gate to send."""

    NONE = 0
    BRAKE = 1
    GIVE_BACK = 2


@settings
class MachineSettings:
    """When input counts as lost, when the car stands, and how a fault ends."""

    image_timeout_s: Positive = 0.1
    """Without a good image for longer than this the system does not work: three frame periods at 30 frames/s."""
    car_timeout_s: Positive = 0.1
    """Without a good car state for longer than this likewise: five periods of the status message."""
    standstill_mps: NonNegative = 0.05
    """At or below this speed the car stands."""
    standstill_time_s: NonNegative = 0.3
    """It must stand for so long before control is given back."""
    recovery_images: PositiveInt = 10
    """Good images in a row that end a fault, at standstill, while nothing else is wrong."""
    give_back_time_s: Positive = 0.2
    """The give-back message is repeated for so long; then silence, which ends the control as well (E-S-25)."""
    brake: Annotated[float, Interval(gt=0, le=1)] = 1.0
    """Share of full braking."""
    max_speed_mps: Positive = 6.0
    """A higher speed is impossible; the scaled car reaches 20 km/h = 5.56 m/s (N-S-040)."""
    max_acceleration_mps2: Positive = 10.0
    """No car gains speed faster ..."""
    max_deceleration_mps2: Positive = 10.0
    """... or loses it faster, unless its wheels lock."""
    sure_deceleration_mps2: Positive = 2.9
    """While we brake the car loses speed at least so fast (mu 0.3). Wheels that stop sooner may have locked: before the
    car itself must have stopped, it does not count as standing."""
    slide_mps: NonNegative = 0.1
    """Nor does it while what is in front is seen to come closer faster than this: it may slide on locked wheels ..."""
    max_slide_s: NonNegative = 3.0
    """... but for no longer than this: it may as well be somebody who walks up to a car that stands."""
    speed_step_mps: NonNegative = 0.3
    """Allowance of both for noise and for messages that come bunched."""
    scene_speed_mps: Positive = 1.0
    """A scene that comes closer faster than this contradicts a car state that says standstill."""


@record
class Perception:
    """The newest result of perception.

    frame_id, time_s: of the raw frame, on the camera's clock. received_s: arrival of the raw frame on the clock of
    the decision unit, so that its age counts the processing. brake, reason: of the decision.
    faults: what `health.judge` found. scene_speed_mps: speed at which the scene comes closer, None where unknown.
    track_id, distance_m, closing_mps: what the decision is about, 0 for nothing, the free way to it, and how fast that
        shrinks, as far as that is certain.
    """

    frame_id: int
    time_s: float
    received_s: float
    brake: bool
    reason: str
    faults: tuple[Fault, ...] = ()
    scene_speed_mps: float | None = None
    track_id: int = 0
    distance_m: float = math.inf
    closing_mps: float = 0.0


@record
class CarState:
    """The newest state of the car: speed >= 0 by the wheels, direction, arrival on the decision unit's clock."""

    speed_mps: float
    received_s: float
    forward: bool = True


@record
class Inputs:
    """What the machine sees at `time_s` (monotonic clock of the decision unit): the newest of each, None before it."""

    time_s: float
    perception: Perception | None = None
    car: CarState | None = None


@record
class Cause:
    """Why to brake: a fault, or (None) an object; since when, and when this was last affirmed by evidence."""

    fault: Fault | None
    reason: str
    since_s: float
    time_s: float


@record
class Request:
    """What the machine asks for: number counts the calls, brake is the share of full braking, cause says why."""

    time_s: float
    number: int
    action: Action
    brake: float = 0.0
    cause: Cause | None = None


NOTHING_SEEN = Perception(-1, -math.inf, -math.inf, brake=False, reason="")
NOTHING_HEARD = CarState(0.0, -math.inf)


@record
class BrakeState:
    """The memory of the machine. It starts as a fault, which ends as every fault does.

    cause: of the braking, or of the last one. number: calls so far.
    perception, car: the last good ones (in a fault the last ones, so that a restarted camera is taken up again).
    image_s, car_s: arrival of the last good one. image_fault, car_fault: what was wrong with the last bad one since.
    good_images: in a row without a fault, up to as many as are needed.
    speed_mps: of the car, which may exceed that of its wheels.
    wheels_s: arrival of the first good car state in a row that says standstill, inf where it does not; standing_s: of
        the first of these that the images do not contradict.
    released_s: when control was given back last.
    """

    mode: Mode = Mode.FAULT
    cause: Cause = Cause(Fault.STARTING, Fault.STARTING.value, -math.inf, -math.inf)
    number: int = 0
    perception: Perception = NOTHING_SEEN
    image_s: float = -math.inf
    image_fault: Fault = Fault.NO_IMAGE
    good_images: int = 0
    car: CarState = NOTHING_HEARD
    car_s: float = -math.inf
    car_fault: Fault = Fault.NO_CAR_STATE
    speed_mps: float = 0.0
    wheels_s: float = math.inf
    standing_s: float = math.inf
    released_s: float = -math.inf


def advance(state: BrakeState, inputs: Inputs, settings: MachineSettings) -> tuple[BrakeState, Request]:
    """Return the next state and what to send. The same arguments give the same answer; nothing is raised."""
    state = _take_car(_take_image(state, inputs, settings), inputs, settings)
    state = changed(_change_mode(state, inputs.time_s, settings), number=state.number + 1)
    if state.mode is not Mode.USER_CONTROL:
        return state, Request(inputs.time_s, state.number, Action.BRAKE, settings.brake, state.cause)
    giving_back = inputs.time_s - state.released_s <= settings.give_back_time_s
    return state, Request(inputs.time_s, state.number, Action.GIVE_BACK if giving_back else Action.NONE)


def _change_mode(state: BrakeState, time_s: float, settings: MachineSettings) -> BrakeState:
    """Return the state after the transition of figure 3.21 that is due, if there is one."""
    fault = _fault(state, time_s, settings)
    if fault is not None:
        since_s = state.cause.since_s if state.mode is Mode.FAULT else time_s
        cause = Cause(fault, fault.value, since_s, time_s)
        return changed(state, mode=Mode.FAULT, cause=cause, good_images=0, standing_s=math.inf)
    if state.mode is Mode.USER_CONTROL:
        if not _must_stop(state, settings):
            return state
        return changed(state, mode=Mode.STOPPING, cause=Cause(None, state.perception.reason, time_s, state.image_s))
    stands = state.car_s - state.standing_s >= settings.standstill_time_s
    works = state.mode is Mode.STOPPING or state.good_images >= settings.recovery_images
    if stands and works:
        return changed(state, mode=Mode.USER_CONTROL, released_s=time_s)
    affirmed_s = state.image_s if state.mode is Mode.STOPPING else time_s
    return changed(state, cause=changed(state.cause, time_s=affirmed_s))


def _fault(state: BrakeState, time_s: float, settings: MachineSettings) -> Fault | None:
    """Return what does not work now. With a clock that runs backwards an age is negative, which is no good age."""
    if not 0 <= time_s - state.image_s <= settings.image_timeout_s:
        return state.image_fault
    if not 0 <= time_s - state.car_s <= settings.car_timeout_s:
        return state.car_fault
    return None


def _must_stop(state: BrakeState, settings: MachineSettings) -> bool:
    """Return whether the newest image, taken since control was given back, demands braking of a car that moves on."""
    return (
        state.perception.brake
        and state.image_s > state.released_s
        and state.car.forward
        and state.speed_mps > settings.standstill_mps
    )


def _take_image(state: BrakeState, inputs: Inputs, settings: MachineSettings) -> BrakeState:
    """Return the state after a look at the newest image, which may be that of the last call.

    A good one must follow the last good one; in a fault, the last one.
    """
    new = inputs.perception
    if new is None or new == state.perception:
        return state
    fault = _image_fault(new, state.perception, inputs.time_s)
    if fault is None:
        good = min(state.good_images + 1, settings.recovery_images)
        return changed(state, perception=new, image_s=new.received_s, image_fault=Fault.NO_IMAGE, good_images=good)
    last = new if state.mode is Mode.FAULT else state.perception
    return changed(state, perception=last, image_fault=fault, good_images=0)


def _image_fault(new: Perception, last: Perception, time_s: float) -> Fault | None:
    """Return what is wrong with an image: its stamps, or what its health says."""
    if not new.received_s <= time_s or not math.isfinite(new.time_s):
        return Fault.CLOCK
    if new.frame_id == last.frame_id or new.time_s == last.time_s:
        return Fault.REPEATED
    if new.frame_id < last.frame_id or new.time_s < last.time_s:
        return Fault.OUT_OF_ORDER
    return new.faults[0] if new.faults else None


def _take_car(state: BrakeState, inputs: Inputs, settings: MachineSettings) -> BrakeState:
    """Return the state after a look at the newest car state, in the same way."""
    new = inputs.car
    if new is None or new == state.car:
        return state
    fault = _car_fault(new, state, inputs, settings)
    if fault is not None and state.mode is not Mode.FAULT:
        return changed(state, car_fault=fault, wheels_s=math.inf, standing_s=math.inf)
    speed_mps = _own_speed(new, state, settings)
    if fault is not None:
        return changed(state, car=new, car_fault=fault, speed_mps=speed_mps, wheels_s=math.inf, standing_s=math.inf)
    wheels_s = min(state.wheels_s, new.received_s) if speed_mps <= settings.standstill_mps else math.inf
    slides = state.perception.closing_mps > settings.slide_mps and new.received_s - wheels_s <= settings.max_slide_s
    stands = math.isfinite(wheels_s) and not slides
    return changed(
        state,
        car=new,
        car_s=new.received_s,
        car_fault=Fault.NO_CAR_STATE,
        speed_mps=speed_mps,
        wheels_s=wheels_s,
        standing_s=min(state.standing_s, new.received_s) if stands else math.inf,
    )


def _own_speed(new: CarState, state: BrakeState, settings: MachineSettings) -> float:
    """Return the speed in m/s of the car: that of its wheels, but while we brake no less than it must still have."""
    if not 0 <= new.speed_mps <= settings.max_speed_mps:
        return state.speed_mps
    if state.mode is Mode.USER_CONTROL:
        return new.speed_mps
    seconds = max(0.0, new.received_s - state.car.received_s)
    return max(new.speed_mps, state.speed_mps - settings.sure_deceleration_mps2 * seconds)


def _car_fault(new: CarState, state: BrakeState, inputs: Inputs, settings: MachineSettings) -> Fault | None:
    """Return what is wrong with a car state: its stamp, or its speed beside the last one and beside the scene."""
    if not state.car.received_s < new.received_s <= inputs.time_s:
        return Fault.CLOCK
    if not 0 <= new.speed_mps <= settings.max_speed_mps:
        return Fault.SPEED_IMPOSSIBLE
    seconds = new.received_s - state.car.received_s
    gain_mps = new.speed_mps - state.speed_mps
    if gain_mps > settings.max_acceleration_mps2 * seconds + settings.speed_step_mps:
        return Fault.SPEED_JUMP
    braking = state.mode is not Mode.USER_CONTROL  # then wheels may lock
    if not braking and -gain_mps > settings.max_deceleration_mps2 * seconds + settings.speed_step_mps:
        return Fault.SPEED_JUMP
    scene_mps = inputs.perception.scene_speed_mps if inputs.perception is not None else None
    if scene_mps is not None and new.speed_mps <= settings.standstill_mps and scene_mps > settings.scene_speed_mps:
        return Fault.SPEED_CONTRADICTED
    return None
