"""The chain as a whole: pure, deterministic, the same with and without compiled kernels, for both families."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

import rangecam
from rangecam.config import load_config
from rangecam.pipeline import process_frame, run
from rangecam.types import Capture, Frame, RawFrame, Tracks

SMALL = {"camera": {"rows": 24, "columns": 32}}
SCENARIOS = ("test-scene", "approach-box", "braking-car", "crossing-person")


def captures(scenario: str, count: int, *layers: dict[str, Any]) -> tuple[list[Capture], Any]:
    source = rangecam.open_source(f"scenario:{scenario}", layers=list(layers))
    return [capture for capture, _ in zip(source.captures, range(count), strict=False)], source.config


def arrays(value: Any) -> list[np.ndarray]:
    """Return every array inside a frame or a part of it."""
    if isinstance(value, np.ndarray):
        return [value]
    if is_dataclass(value):
        return [a for field in fields(value) for a in arrays(getattr(value, field.name))]
    if isinstance(value, dict):
        return [a for v in value.values() for a in arrays(v)]
    return []


def same(first: Frame, second: Frame) -> bool:
    pairs = zip(arrays(first), arrays(second), strict=True)
    return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs) and str(
        first.decision.reason
    ) == str(second.decision.reason)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_same_arguments_give_the_same_frame_bit_for_bit(scenario: str) -> None:
    given, config = captures(scenario, 12)
    first, second = list(run(given, config)), list(run(given, config))
    assert len(first) == 12
    assert all(same(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_no_stage_changes_what_it_was_given(scenario: str) -> None:
    given, config = captures(scenario, 8)
    *before, last = run(given, config)

    def guarded(stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        copies = [array.copy() for argument in arguments for array in arrays(argument)]
        result = function(*arguments)
        for copy, array in zip(copies, [a for argument in arguments for a in arrays(argument)], strict=True):
            assert np.array_equal(copy, array, equal_nan=copy.dtype.kind == "f"), f"{stage} changed its input"
        return result

    guarded_frame = process_frame(given[-1].raw, before[-1].tracks, given[-1].ego, config, guarded)
    assert same(guarded_frame, last)


def test_the_tracks_of_a_frame_are_the_whole_memory() -> None:
    given, config = captures("approach-box", 20)
    straight = list(run(given, config))
    resumed = process_frame(given[-1].raw, straight[-2].tracks, given[-1].ego, config)
    assert same(resumed, straight[-1])


@pytest.mark.parametrize("preset", ["scaled_car", "usercams", "vl53l5cx"])
def test_a_frame_without_any_light_gives_no_object_and_no_brake(preset: str) -> None:
    config = load_config(preset)
    raw, _ = captures("test-scene", 1, {"preset": preset})
    dark = RawFrame(0.0, {name: np.zeros_like(plane) for name, plane in raw[0].raw.planes.items()})
    frame = process_frame(dark, Tracks.empty(), raw[0].ego, config)
    assert not frame.image.valid.any()
    assert len(frame.segments) == 0
    assert len(frame.tracks) == 0
    assert not frame.decision.brake


@pytest.mark.parametrize("scenario", ["approach-box", "test-scene", "crossing-person"])
def test_after_warming_up_no_frame_compiles_anything(scenario: str) -> None:
    code = f"""
import sys, rangecam
from rangecam.pipeline import run, warm_up
from numba.core.registry import CPUDispatcher
def compiled():
    modules = [m for name, m in list(sys.modules.items()) if name.startswith("rangecam")]
    kernels = {{id(k): k for m in modules for k in vars(m).values() if isinstance(k, CPUDispatcher)}}
    return {{k.__name__: len(k.overloads) for k in kernels.values()}}
source = rangecam.open_source("scenario:{scenario}")
captures = [capture for capture, _ in zip(source.captures, range(90))]
warm_up(captures[0], source.config)
before = compiled()
frames = list(run(captures, source.config))
assert max(len(frame.tracks) for frame in frames) > 0
assert sum(before.values()) > 5
assert compiled() == before, (before, compiled())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def test_sinks_get_every_frame_with_its_capture() -> None:
    class Keep:
        def __init__(self) -> None:
            self.seen: list[tuple[Capture, Frame]] = []

        def write(self, capture: Capture, frame: Frame) -> None:
            self.seen.append((capture, frame))

        def close(self) -> None:
            """Nothing to finish."""

    given, config = captures("test-scene", 3)
    sink = Keep()
    frames = list(run(given, config, [sink]))
    assert [capture for capture, _ in sink.seen] == given
    assert [frame for _, frame in sink.seen] == frames


@pytest.mark.parametrize("ranging", ["cw_four_phase", "mdsi3"])
def test_kernels_give_the_same_without_compilation(ranging: str) -> None:
    scenario, layers = ("test-scene", SMALL) if ranging == "cw_four_phase" else ("braking-car", {})
    code = f"""
import json, numpy as np, rangecam
source = rangecam.open_source("scenario:{scenario}", layers=[{layers!r}])
frames = [f for f, _ in zip(rangecam.run(source.captures, source.config), range(4), strict=False)]
f = frames[-1]
parts = [f.image.range_m, f.image.sigma_m, f.labels, f.segments.position_m, f.segments.covariance_m2, f.tracks.state]
print(json.dumps([np.nan_to_num(np.asarray(p, dtype=float)).ravel().tolist() for p in parts]))
"""
    outputs = []
    for disabled in ("0", "1"):
        # kernels divide by zero where no light is and select afterwards; compiled, that is silent
        silent = "ignore:invalid value:RuntimeWarning,ignore:divide by zero:RuntimeWarning"
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disabled, "PYTHONWARNINGS": f"error,{silent}"}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False
        )
        assert done.returncode == 0, done.stderr[-2000:]
        outputs.append(json.loads(done.stdout))
    for with_jit, without in zip(*outputs, strict=True):
        np.testing.assert_allclose(with_jit, without, atol=2e-3)


@pytest.mark.parametrize("scenario", ["approach-box", "braking-car"])
def test_the_brake_comes_while_there_is_still_room_to_stop(scenario: str) -> None:
    source = rangecam.open_source(f"scenario:{scenario}")
    frame = next(frame for frame in rangecam.run(source.captures, source.config) if frame.decision.brake)
    decision = frame.decision
    assert decision.distance_m > decision.stopping_distance_m
    assert decision.ttc_s > source.config.decision.reaction_time_s


def test_nothing_brakes_in_the_standing_test_scene() -> None:
    source = rangecam.open_source("scenario:test-scene")
    assert not any(frame.decision.brake for frame in rangecam.run(source.captures, source.config))
