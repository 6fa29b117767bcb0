"""The only place that forms a take-over frame. It trusts nobody: everything is checked again, on its own.

The gate starts closed and must be armed. What it refuses it counts, by reason; a refusal sends nothing, and the car
ends the control by its own timeout (E-S-25). It knows no way to accelerate or to steer.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from rangecam.brake.machine import Action, Request
from rangecam.can.layout import BRAKE_MODE, GIVE_BACK_DATA, MAGIC, MASTER_ID, VALUE_PER_UNIT
from rangecam.settings import Positive, settings
from rangecam.values import changed, record


class Refusal(StrEnum):
    """Why the gate did not let a request pass."""

    NOT_ARMED = "the gate is not armed"
    OLD_REQUEST = "the request is not of now"
    REPEATED = "the request was seen before"
    NO_BRAKING = "only braking may pass"
    VALUE = "the braking is not between nothing and full"
    NO_CAUSE = "there is no cause"
    OLD_CAUSE = "the cause is not of now"


@settings
class GateSettings:
    """How old a request and its cause may be."""

    request_age_s: Positive = 0.02
    """A request older than this does not pass: between machine and gate nothing may wait."""
    cause_age_s: Positive = 0.15
    """A cause must have been affirmed within this time: the timeout of images and the time that processing takes."""


@dataclass(frozen=True)
class Gate:
    """The gate between two requests: armed or not, the number of the last request, refusals so far by reason."""

    armed: bool = False
    number: int = -1
    refused: Mapping[Refusal, int] = field(default_factory=dict)


@record
class CanFrame:
    """One frame for the bus: 11 bit identifier and up to 8 bytes."""

    can_id: int
    data: bytes


def arm(gate: Gate) -> Gate:
    """Open the gate for causes; only a person at the command line, or a test, has reason to."""
    return changed(gate, armed=True, number=-1)


def disarm(gate: Gate) -> tuple[Gate, CanFrame]:
    """Close the gate, and return the frame that gives control back at once: the operator's way out of any fault."""
    return changed(gate, armed=False), CanFrame(MASTER_ID, GIVE_BACK_DATA)


def let_pass(gate: Gate, request: Request, time_s: float, settings: GateSettings) -> tuple[Gate, CanFrame | None]:
    """Return the gate after a request, and the frame to send now, or None where there is nothing to send."""
    if request.action is Action.NONE:
        return gate, None
    refusal = _refusal(gate, request, time_s, settings)
    if refusal is not None:
        return changed(gate, refused=Counter(gate.refused) + Counter([refusal])), None
    gate = changed(gate, number=request.number)
    if request.action is Action.GIVE_BACK:
        return gate, CanFrame(MASTER_ID, GIVE_BACK_DATA)
    value = round(request.brake * VALUE_PER_UNIT)
    return gate, CanFrame(MASTER_ID, bytes([BRAKE_MODE, value & 0xFF, value >> 8, 0, 0, 0]) + MAGIC)


def _refusal(gate: Gate, request: Request, time_s: float, settings: GateSettings) -> Refusal | None:
    """Return the first reason against a request. Comparisons are written so that a NaN fails them."""
    if not gate.armed:
        return Refusal.NOT_ARMED
    if not 0 <= time_s - request.time_s <= settings.request_age_s:
        return Refusal.OLD_REQUEST
    if not request.number > gate.number:
        return Refusal.REPEATED
    if request.action is Action.GIVE_BACK:
        return None
    if request.action is not Action.BRAKE:
        return Refusal.NO_BRAKING
    if not 0 < request.brake <= 1:
        return Refusal.VALUE
    if request.cause is None or not request.cause.reason:
        return Refusal.NO_CAUSE
    if not 0 <= time_s - request.cause.time_s <= settings.cause_age_s:
        return Refusal.OLD_CAUSE
    return None
