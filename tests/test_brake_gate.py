"""The gate: closed until armed, and nothing passes but a fresh, caused, bounded braking."""

import ast
import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest

from rangecam.brake.gate import CanFrame, Gate, GateSettings, Refusal, arm, disarm, let_pass
from rangecam.brake.machine import Action, CarState, Cause, Fault, Inputs, Perception, Request
from rangecam.brake.unit import BrakeSettings, Unit, step
from rangecam.can.codec import DriveMode, GiveBack, TakeOver, decode, encode

SETTINGS = GateSettings(request_age_s=0.25, cause_age_s=0.5)
OPEN = arm(Gate())
CAUSE = Cause(None, "box at 2 m", 9.0, 9.875)
REQUEST = Request(10.0, 7, Action.BRAKE, 0.7654, CAUSE)


def passed(time_s: float = 10.0, gate: Gate = OPEN, **changes: Any) -> tuple[Gate, CanFrame | None]:
    cause = {key.removeprefix("cause_"): changes.pop(key) for key in list(changes) if key.startswith("cause_")}
    if cause:
        changes["cause"] = dataclasses.replace(CAUSE, **cause)
    return let_pass(gate, dataclasses.replace(REQUEST, **changes), time_s, SETTINGS)


def test_a_braking_with_a_fresh_cause_passes_as_the_bytes_of_table_a5() -> None:
    gate, frame = passed()
    assert frame == CanFrame(0x50, bytes.fromhex("03 fd 02 00 00 00 ca fe"))  # 765 = 0x02FD thousandths
    assert gate == Gate(armed=True, number=7)
    assert frame == CanFrame(*encode(TakeOver(DriveMode.BRAKE, 0.765)))


def test_full_braking_is_a_thousand_thousandths() -> None:
    assert passed(brake=1.0)[1] == CanFrame(0x50, bytes.fromhex("03 e8 03 00 00 00 ca fe"))
    assert passed(brake=0.001)[1] == CanFrame(0x50, bytes.fromhex("03 01 00 00 00 00 ca fe"))


REFUSED: dict[str, tuple[dict[str, Any], Refusal]] = {
    "not armed": ({"gate": Gate()}, Refusal.NOT_ARMED),
    "request too old": ({"time_s": 10.2501, "cause_time_s": 10.2}, Refusal.OLD_REQUEST),
    "request of the future": ({"time_s": 9.9999}, Refusal.OLD_REQUEST),
    "request without time": ({"time_s": math.nan}, Refusal.OLD_REQUEST),
    "the same number": ({"gate": Gate(armed=True, number=7)}, Refusal.REPEATED),
    "an older number": ({"gate": Gate(armed=True, number=8)}, Refusal.REPEATED),
    "no action that brakes": ({"action": 3}, Refusal.NO_BRAKING),
    "no braking": ({"brake": 0.0}, Refusal.VALUE),
    "negative braking": ({"brake": -0.5}, Refusal.VALUE),
    "more than full": ({"brake": 1.0001}, Refusal.VALUE),
    "not a number": ({"brake": math.nan}, Refusal.VALUE),
    "no cause": ({"cause": None}, Refusal.NO_CAUSE),
    "a cause without words": ({"cause_reason": ""}, Refusal.NO_CAUSE),
    "an old cause": ({"cause_time_s": 9.4999}, Refusal.OLD_CAUSE),
    "a cause of the future": ({"cause_time_s": 10.0001}, Refusal.OLD_CAUSE),
    "a cause without time": ({"cause_time_s": math.nan}, Refusal.OLD_CAUSE),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_counted_by_reason_and_sends_nothing(name: str) -> None:
    changes, reason = REFUSED[name]
    before = changes.get("gate", OPEN)
    gate, frame = passed(**changes)
    assert frame is None
    assert gate == dataclasses.replace(before, refused={reason: 1})
    again, _ = passed(**{**changes, "gate": gate})
    assert again.refused == {reason: 2}


def test_every_reason_is_given_somewhere() -> None:
    assert {reason for _, reason in REFUSED.values()} == set(Refusal)


@pytest.mark.parametrize(
    "changes",
    [
        {"time_s": 10.25, "cause_time_s": 10.0},
        {"time_s": 10.0, "cause_time_s": 9.5},
        {"cause_time_s": 10.0},
        {"gate": Gate(armed=True, number=6)},
        {"cause": Cause(Fault.BLOCKED, "lens", 0.0, 10.0)},
    ],
)
def test_limits_themselves_pass(changes: dict[str, Any]) -> None:
    assert passed(**changes)[1] is not None


def test_giving_back_needs_neither_cause_nor_value_but_the_rest() -> None:
    back = {"action": Action.GIVE_BACK, "brake": 0.0, "cause": None}
    gate, frame = passed(**back)
    assert frame == CanFrame(0x50, bytes(8))
    assert decode(0x50, bytes(8)) == GiveBack()
    assert gate.number == 7
    assert passed(gate=gate, **back)[0].refused == {Refusal.REPEATED: 1}


def test_no_request_is_no_frame_and_no_refusal() -> None:
    for gate in (Gate(), OPEN):
        assert passed(gate=gate, action=Action.NONE) == (gate, None)


def test_disarming_gives_back_at_once_and_arming_counts_anew() -> None:
    gate, frame = disarm(passed()[0])
    assert frame == CanFrame(0x50, bytes(8))
    assert not gate.armed
    assert passed(gate=gate)[1] is None
    assert passed(gate=arm(gate), number=0)[1] is not None


def test_the_first_request_after_arming_is_any_that_was_numbered() -> None:
    assert passed(number=0)[1] is not None
    assert passed(number=-1)[0].refused == {Refusal.REPEATED: 1}
    assert Gate() == disarm(arm(Gate()))[0]


def test_a_frame_once_formed_cannot_be_changed() -> None:
    _, frame = passed()
    with pytest.raises(dataclasses.FrozenInstanceError):
        frame.data = bytes(8)  # type: ignore[misc, union-attr]


def test_only_the_gate_forms_a_take_over_in_the_package() -> None:
    package = Path(__file__).parent.parent / "src" / "rangecam"
    forming = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = ("TakeOver", "MAGIC", "CanFrame")
            if isinstance(node, ast.Name) and node.id in names and isinstance(node.ctx, ast.Load):
                forming.add(path.relative_to(package).as_posix())
    # the codec and its tools know the message: to send it by hand, `rangecam can send` wants --arm
    assert forming <= {"brake/gate.py", "brake/unit.py", "can/codec.py", "can/monitor.py", "cli/can.py"} | RECEIVERS


RECEIVERS = {"vehicle/unit.py", "drive/mind.py", "drive/loop.py", "drive/roles.py"}
"""Modules that take a take-over apart or carry it, as the car and its bus do; what they form themselves is status."""


# -- the unit ---------------------------------------------------------------------------------------------------------


def test_the_unit_brakes_for_a_box_and_says_nothing_while_it_is_not_armed() -> None:
    settings = BrakeSettings()
    for unit, sends in ((Unit(), False), (Unit(gate=arm(Gate())), True)):
        for i in range(1, 60):
            seen = Perception(i, i * 0.02, i * 0.02, brake=i >= 50, reason="box")
            car = CarState(0.0 if i < 30 else (i - 30) * 0.1, i * 0.02)
            unit, request, frame = step(unit, Inputs(i * 0.02, seen, car), settings)
            assert (request.action is Action.BRAKE) == (i < 16 or i >= 50)
            assert (frame is not None) == (sends and (i < 27 or i >= 50))
        assert dict(unit.gate.refused) == ({} if sends else {Refusal.NOT_ARMED: 15 + 11 + 10})
        assert unit.friction.braking == sends
