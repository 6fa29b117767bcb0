"""Driving in real time: what is stated of stops, and what the command line refuses."""

from dataclasses import replace

import pytest

from rangecam.cli import main
from rangecam.drive.opening import opened
from rangecam.drive.realtime import describe, stated_stop_s


def test_a_stop_takes_timeout_brakes_and_friction() -> None:
    _, config, settings = opened("approach-box", None, [])
    still, fast = stated_stop_s(0.0, config, settings), stated_stop_s(2.0, config, settings)
    assert fast - still == pytest.approx(2.0 / (0.9 * 0.3 * 9.81))
    assert still > 0.1 + settings.vehicle.brake_delay_s
    slippery = replace(settings, friction=0.15)
    assert stated_stop_s(2.0, config, slippery) > fast


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["approach-box", "--real-time", "--duration", "0"], "--duration above zero"),
        (["approach-box", "--real-time", "--upsets", "-1"], "--upsets of at least 0"),
        (["approach-box", "--real-time", "--record", "a.mcap"], "--record is not for real time"),
    ],
)
def test_calls_that_cannot_be_are_named(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_collision_and_what_did_not_recover_are_shouted() -> None:
    quantiles = {"p50": 1.0, "p99": 2.0, "max": 3.0}
    each = {"role": "camera", "action": "kill", "speed_mps": 1.0, "stopped_s": 0.5, "stated_s": 0.9, "recovered": False}
    result = {
        "scenario": "x", "duration_s": 1.0, "frames": 3, "processing_ms": quantiles, "photon_to_decision_ms": quantiles,
        "late_frames": 0, "deadline_ms": 33.3, "photon_to_brake_ms": 150.0, "least_gap_m": 0.0, "collision": True,
        "top_speed_mps": 1.0, "upsets": [each],
        "events": [{"time_s": 0.5, "who": "perception", "mode": "FAULT", "reason": "no new image"}],
    }  # fmt: skip
    text = describe(result)
    assert "COLLISION" in text
    assert "LOST" in text
    assert "perception fault: no new image" in text
