"""The vehicle's control unit: remote control or control by the bus, and what it reports (Steinbäck 2016, 4.3.1, A.4).

    REMOTE --take-over--> BUS --give-back, or no take-over for `timeout_s`--> REMOTE

Frames in, frames out, as bytes. What is no message of the car's is ignored and counted, as is whatever the unit sent
itself. A give-back is any frame of the master without the magic number (E-S-25: both ways end the control).
"""

from collections.abc import Sequence
from enum import IntEnum

from rangecam.brake.gate import CanFrame
from rangecam.can.codec import (
    CarStatus1,
    CarStatus2,
    CodecError,
    DriveMode,
    GiveBack,
    Message,
    RemoteValues,
    SteeringMode,
    TakeOver,
    decode,
    encode,
)
from rangecam.values import changed, record
from rangecam.vehicle.dynamics import Command, VehicleState
from rangecam.vehicle.remote import Hand, command_of
from rangecam.vehicle.sensors import electricity, measured_speed
from rangecam.vehicle.settings import Unit, Vehicle


class Control(IntEnum):
    """Who the vehicle obeys (fig 4.6)."""

    REMOTE = 0
    BUS = 1


@record
class UnitState:
    """The memory of the unit.

    taken: the last take-over, at `taken_s`. status_s, remote_s: when status and remote values were last sent; hand: the
    remote values that were. ignored: frames that were no message for the vehicle.
    """

    control: Control = Control.REMOTE
    taken: TakeOver | None = None
    taken_s: float = float("-inf")
    status_s: float = float("-inf")
    remote_s: float = float("-inf")
    hand: Hand | None = None
    ignored: int = 0


def advance_unit(
    state: UnitState, time_s: float, frames: Sequence[CanFrame], hand: Hand, car: VehicleState, vehicle: Vehicle
) -> tuple[UnitState, Command, list[CanFrame]]:
    """Return the state after `frames` that came since the last call, what the actuators are told, and what is sent.

    Both status messages are sent each `status_period_s`, the remote values when new ones come from the radio. The same
    arguments give the same answer; nothing is raised.
    """
    for frame in frames:
        state = _heard(state, time_s, frame)
    if state.control is Control.BUS and time_s - state.taken_s > vehicle.unit.timeout_s:
        state = changed(state, control=Control.REMOTE, taken=None)
    command = command_of(hand) if state.taken is None else _obeyed(state.taken)
    state, due = _due(state, time_s, hand, vehicle.unit)
    sent = [CanFrame(*encode(message)) for kind in due for message in _messages(kind, hand, car, vehicle)]
    return state, command, sent


def _heard(state: UnitState, time_s: float, frame: CanFrame) -> UnitState:
    try:
        message = decode(frame.can_id, frame.data)
    except CodecError:
        return changed(state, ignored=state.ignored + 1)
    if isinstance(message, TakeOver):
        return changed(state, control=Control.BUS, taken=message, taken_s=time_s)
    if isinstance(message, GiveBack):
        return changed(state, control=Control.REMOTE, taken=None)
    return changed(state, ignored=state.ignored + 1)


def _obeyed(taken: TakeOver) -> Command:
    """Return what a take-over demands of the actuators."""
    left = {SteeringMode.LEFT: 1.0, SteeringMode.RIGHT: -1.0}.get(taken.steering, 0.0)
    drives = taken.mode in (DriveMode.FORWARD, DriveMode.BACKWARD)
    return Command(
        drive=taken.value if drives else 0.0,
        brake=taken.value if taken.mode is DriveMode.BRAKE else 0.0,
        steer=left * taken.steering_value,
        forward=taken.mode is not DriveMode.BACKWARD,
    )


_JITTER_S = 1e-9  # of sums of many steps


def _due(state: UnitState, time_s: float, hand: Hand, unit: Unit) -> tuple[UnitState, list[str]]:
    due = []
    if time_s - state.status_s >= unit.status_period_s - _JITTER_S:
        state, due = changed(state, status_s=time_s), ["status"]
    if time_s - state.remote_s >= unit.remote_period_s - _JITTER_S and hand != state.hand:
        state, due = changed(state, remote_s=time_s, hand=hand), [*due, "remote"]
    return state, due


def _messages(kind: str, hand: Hand, car: VehicleState, vehicle: Vehicle) -> list[Message]:
    if kind == "remote":
        return [RemoteValues(_unit(hand.throttle), _unit(hand.steer), 1.0 if hand.forward else -1.0)]
    now = electricity(car, vehicle)
    return [
        CarStatus1(
            motor_current_a=min(now.motor_a, _MOST),
            battery_voltage_v=min(now.battery_v, _MOST),
            power_w=min(now.power_w, _MOST),
            speed_mps=min(measured_speed(car, vehicle), _MOST),
        ),
        CarStatus2(min(now.motor_v, _MOST), *(min(max(heat, -40.0), 120.0) for heat in car.heat_c)),
    ]


_MOST = 65.535
"""What two bytes of thousandths hold: more reads as this (E-S-31)."""


def _unit(value: float) -> float:
    return max(-1.0, min(1.0, value))
