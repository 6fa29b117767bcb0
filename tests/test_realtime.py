"""Driving in real time: what is stated of stops, processes that are killed and frozen, and what is refused."""

import gc
import itertools
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rangecam.can.bus import Bus
from rangecam.can.codec import GiveBack
from rangecam.cli import main
from rangecam.config import Config, load_config
from rangecam.drive import realtime
from rangecam.drive.opening import opened
from rangecam.drive.prompt import prompt, relaxed
from rangecam.drive.realtime import describe
from rangecam.drive.rig import Rig
from rangecam.drive.settings import DriveSettings
from rangecam.drive.upsets import Upset, noticed_s, stated_stop_s, upset
from rangecam.errors import DataError
from rangecam.scene.scenario import Scenario

# -- what is stated ---------------------------------------------------------------------------------------------------


def test_a_stop_takes_timeout_brakes_and_friction() -> None:
    _, config, settings = opened("approach-box", None, [])
    still, fast = stated_stop_s(0.0, config, settings), stated_stop_s(2.0, config, settings)
    assert fast - still == pytest.approx(2.0 / (0.9 * 0.3 * 9.81))
    assert still > noticed_s(config, settings) + settings.vehicle.brake_delay_s > 0.1
    slippery = replace(settings, friction=0.15)
    assert stated_stop_s(2.0, config, slippery) > fast


def test_what_is_stated_did_not_hold_if_it_came_late_never_or_nobody_recovered() -> None:
    good = Upset("camera", "kill", 1.0, "stops", 0.9, 0.5, 2.0, 1)
    assert good.held
    assert not replace(good, took_s=0.95).held
    assert not replace(good, took_s=None).held
    assert not replace(good, recovered_s=None).held


def test_a_prompt_process_is_a_usual_one_again_afterwards() -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else 0
    assert prompt(1) in {"real-time", "priority", "usual"}
    assert gc.get_freeze_count() > 0
    relaxed()
    assert gc.get_freeze_count() == 0
    if hasattr(os, "sched_getscheduler"):
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
        assert os.getpriority(os.PRIO_PROCESS, 0) == before


_PARENT = """
import multiprocessing, os, time
from rangecam.drive.prompt import end_with_parent

def stay():
    end_with_parent()
    print(os.getpid(), flush=True)
    time.sleep(60)

if __name__ == "__main__":
    process = multiprocessing.get_context("forkserver").Process(target=stay)
    process.start()
    process.join()
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_process_of_a_drive_ends_when_who_started_it_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(_PARENT)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        os.kill(child, 0)
        parent.kill()
        parent.wait()
        deadline_s = time.monotonic() + 20
        while _lives(child) and time.monotonic() < deadline_s:
            time.sleep(0.02)
    assert not _lives(child)


def _lives(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


# -- processes --------------------------------------------------------------------------------------------------------


def _coarse() -> tuple[Scenario, Config, DriveSettings]:
    """The scaled car's camera with few pixels, so that machines with little time to spare keep up with it."""
    scenario, _, settings = opened("approach-box", None, [])
    few = {"min_object_px": 2.0, "large_object_px": 30.0, "min_object_m": 0.01}
    camera = {"rows": 24, "columns": 32, "pseudo_rows": 0, "read_noise_lsb": 0.5}
    config = load_config("scaled_car", {"camera": camera, "decision": few, "segments": {"min_pixels": 3}})
    return scenario, config, replace(settings, missed_frames=9.0)


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    """Three processes that work together; skips where there is no multicast, or no signal to freeze a process."""
    if not hasattr(os, "fork"):
        pytest.skip("needs the signals of POSIX")
    try:
        with Bus("udp_multicast", "239.74.163.9") as one:
            one.send(GiveBack())
            if one.receive(1.0) is None:
                pytest.skip("no multicast on this machine's loopback")
    except DataError as error:
        pytest.skip(f"no CAN over multicast here: {error}")
    with Rig(*_coarse()) as found:
        found.await_ready()
        found.hurry()
        yield found


@pytest.mark.parametrize(("role", "action"), [("camera", "freeze"), ("perception", "kill"), ("car", "restart")])
def test_a_process_that_ceases_stops_the_car_in_the_time_stated_and_all_recover(
    rig: Rig, role: str, action: str
) -> None:
    found = upset(rig, role, action, np.random.default_rng(1))
    assert found.speed_mps > 0.3
    assert found.held, f"{found} {rig.events[-4:]}"


@pytest.mark.parametrize("error", [KeyboardInterrupt(), DataError("the camera has ended by itself")])
def test_what_was_measured_before_it_was_cut_off_is_kept_and_told_as_it_came(
    error: BaseException, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    good = Upset("camera", "kill", 1.0, "stops", 0.9, 0.5, 2.0, 1)

    def some(rig: object, count: int, rng: np.random.Generator) -> Iterator[Upset]:
        yield good
        raise error

    clock = itertools.count().__next__
    still = SimpleNamespace(frames=[], events=[], priority="usual", job=SimpleNamespace(now_s=clock))
    still.await_ready = still.hurry = lambda: None
    approach = {"top_speed_mps": 1.0, "stopped_by": "object", "least_gap_m": 0.1, "collision": False}
    monkeypatch.setattr(realtime, "Rig", lambda *_: nullcontext(still))
    monkeypatch.setattr(realtime, "_approach", lambda rig: approach)
    monkeypatch.setattr(realtime, "upsets", some)
    assert main(["drive", "approach-box", "--real-time", "--duration", "1", "--upsets", "3"]) == 1
    out, told = capsys.readouterr()
    assert "1 of 1 as stated" in out
    assert f"CUT OFF    {str(error) or 'interrupted'}" in out
    assert "after 1 upsets of 3" in told
    assert told.startswith("approach   up to 1.00 m/s, stopped by object, least gap 0.10 m\nupset      camera kill")


# -- the command line -------------------------------------------------------------------------------------------------


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
    quantiles = {"p50": 1.0, "p99": 2.0, "p99.9": 2.5, "max": 3.0}
    each = {"role": "camera", "action": "kill", "speed_mps": 1.0, "claim": "stops", "stated_s": 0.9}
    upsets = [
        {**each, "took_s": 0.5, "recovered_s": None},
        {**each, "took_s": 1.5, "recovered_s": 1.0},
        {**each, "took_s": None, "recovered_s": 1.0},
    ]
    approach = {"top_speed_mps": 1.0, "stopped_by": "object", "least_gap_m": -0.1, "collision": True}
    times = {"processing_ms": quantiles, "photon_to_decision_ms": quantiles, "photon_to_command_ms": quantiles}
    result = {
        "scenario": "x", "duration_s": 1.0, "frames": 3, "missing_frames": 0, "priority": "usual", **times,
        "photon_to_brake_ms": quantiles, "late_frames": 0, "deadline_ms": 33.3, "approaches": [approach],
        "upsets": [{**each, "held": False} for each in upsets], "cut_off": "interrupted",
    }  # fmt: skip
    text = describe(result)
    assert "not permitted" in text
    assert all(word in text for word in ("COLLISION", "LOST", "LATE", "NEVER", "0 of 3", "CUT OFF    interrupted"))
