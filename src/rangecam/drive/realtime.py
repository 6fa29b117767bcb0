"""A drive in real time: approach after approach with processes that keep time, then upsets, and what was measured."""

import math
import os
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from rangecam.brake.machine import Mode
from rangecam.config import Config
from rangecam.drive.contact import nearest
from rangecam.drive.rig import STANDS_MPS, Rig
from rangecam.drive.settings import DriveSettings
from rangecam.drive.upsets import upsets
from rangecam.errors import DataError
from rangecam.scene.paths import Pose
from rangecam.scene.scenario import Scenario
from rangecam.vehicle.unit import Control

_LONGER_S = 10.0
"""Of an approach, which begins at standstill, than of the scenario, which may begin at speed."""
_BINS_MS = np.arange(0.0, 405.0, 5.0)


def drive_in_real_time(
    scenario: Scenario,
    config: Config,
    settings: DriveSettings,
    seed: int,
    duration_s: float,
    disturbances: int,
    heard: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Drive a scene in real time again and again for so long, from standstill to the stop, then upset it so often.

    An approach that has begun within `duration_s` is driven to its end. heard: is told of each approach and each upset
    in a line, as it ends. Returns JSON values: the deadline and latencies of all frames, each approach, the latencies
    from light to brake, the upsets; `cut_off` says what ended it all too soon, an interrupt or processes that no longer
    work together: what was measured until then is there. Raises DataError if they never come to work together.
    """
    rng = np.random.default_rng(seed)
    approaches: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    cut_off, last = None, None
    with Rig(scenario, config, settings, seed) as rig:
        rig.await_ready()
        rig.hurry()
        first, begun_s = len(rig.frames), rig.job.now_s()
        try:
            while not approaches or rig.job.now_s() < begun_s + duration_s:
                approaches.append(_approach(rig))
                heard(_approach_line(approaches[-1]))
            last, took_s = len(rig.frames), rig.job.now_s() - begun_s
            for each in upsets(rig, disturbances, rng):
                found.append({**asdict(each), "held": each.held})
                heard(_upset_line(found[-1]))
        except KeyboardInterrupt:
            cut_off = "interrupted"
        except DataError as error:
            cut_off = str(error)
        if last is None:
            last, took_s = len(rig.frames), rig.job.now_s() - begun_s
        frames, events, priority = rig.frames[first:last], _since(rig.events, begun_s), rig.priority
    return {
        "scenario": scenario.name,
        "cut_off": cut_off,
        "duration_s": round(took_s, 3),
        "priority": priority,
        "load_average": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        **_deadline(config, frames),
        **_light_to_brake(approaches),
        "approaches": approaches,
        "collision": any(each["collision"] for each in approaches),
        "events": events,
        "upsets": found,
    }


def _approach(rig: Rig) -> dict[str, Any]:
    """Drive once from standstill until the car stands after a take-over, or for long enough; return what came of it."""
    rig.put_back()
    rig.await_ready()
    first = len(rig.cars), len(rig.frames), len(rig.events)
    rig.go()
    rig.watch(rig.job.scenario.duration_s + _LONGER_S, lambda: _stands_again(rig))
    return _outcome(rig, rig.cars[first[0] :], rig.frames[first[1] :], rig.events[first[2] :])


def _stands_again(rig: Rig) -> bool:
    """Return whether the bus has taken over since the driver started, and the car stands."""
    taken = rig.car["control"] == int(Control.BUS) and rig.car["time_s"] > rig.job.go_s.value
    return bool(taken and rig.car["speed_mps"] < STANDS_MPS)


def _since(events: list[dict[str, Any]], begun_s: float) -> list[dict[str, Any]]:
    return [{**each, "time_s": round(each["time_s"] - begun_s, 3)} for each in events if each["time_s"] >= begun_s]


def _outcome(
    rig: Rig, cars: list[dict[str, Any]], frames: list[dict[str, Any]], events: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return how an approach went, and when what came between light and brake."""
    scenario, settings, go_s = rig.job.scenario, rig.job.settings, rig.job.go_s.value
    driven = [each for each in cars if each["time_s"] > go_s]
    gaps = [
        nearest(scenario, each["time_s"] - go_s, Pose(*each["pose"]), settings.vehicle, settings.harmless).gap_m
        for each in [*driven[::10], *driven[-1:]]
    ]
    obeys = next((each for each in driven if each["control"] == int(Control.BUS)), None)
    first = next((each for each in events if each["mode"] != Mode.USER_CONTROL.name), None)
    fault = first["reason"] if first is not None and first["mode"] == Mode.FAULT.name else ""
    cause = None if obeys is None or fault else next((f for f in frames if f["brake"]), None)
    least_m = min(gaps, default=math.inf)
    found: dict[str, Any] = {
        "top_speed_mps": round(max((each["speed_mps"] for each in driven), default=0.0), 3),
        "stopped_by": "nothing" if obeys is None else (fault or "object"),
        "stands": bool(driven) and driven[-1]["speed_mps"] < STANDS_MPS,
        "least_gap_m": round(least_m, 3) if math.isfinite(least_m) else None,
        "collision": least_m <= 0,
    }
    if cause is not None and obeys is not None:
        exposed_s, bites_s = cause["exposed_s"], obeys["obeyed_s"] + settings.vehicle.brake_delay_s
        ends_s = {"decision": cause["done_s"], "command": obeys["obeyed_s"], "brake": bites_s}
        found |= {f"photon_to_{name}_ms": round(1e3 * (end_s - exposed_s), 2) for name, end_s in ends_s.items()}
    return found


def _deadline(config: Config, frames: list[dict[str, Any]]) -> dict[str, Any]:
    """Return processing times beside their deadline, a frame period, and from light to decision, of all frames."""
    period_ms = 1e3 / config.camera.frame_rate_hz
    took = np.array([1e3 * (each["done_s"] - each["arrived_s"]) for each in frames])
    light = np.array([1e3 * (each["done_s"] - each["exposed_s"]) for each in frames])
    numbers = [each["number"] for each in frames]
    return {
        "frames": len(frames),
        "missing_frames": max(numbers) - min(numbers) + 1 - len(set(numbers)) if numbers else 0,
        "deadline_ms": round(period_ms, 3),
        "late_frames": int(np.count_nonzero(took > period_ms)),
        "processing_ms": _quantiles(took),
        "photon_to_decision_ms": _quantiles(light),
        "photon_to_decision_histogram": _histogram(light),
    }


def _light_to_brake(approaches: list[dict[str, Any]]) -> dict[str, Any]:
    """Return, of all stops for an object, the times from the start of the exposure to command and brake."""
    found: dict[str, Any] = {}
    for name in ("photon_to_command", "photon_to_brake"):
        times = np.array([each[f"{name}_ms"] for each in approaches if f"{name}_ms" in each])
        found |= {f"{name}_ms": _quantiles(times), f"{name}_histogram": _histogram(times)}
    return found


def _histogram(values: Any) -> dict[str, Any]:
    """Return bins of 5 ms; what is beyond the last counts there."""
    counts, edges = np.histogram(np.minimum(values, _BINS_MS[-1]), _BINS_MS)
    return {"edges_ms": edges.tolist(), "count": counts.tolist()}


_QUANTILES = {"p50": 50, "p99": 99, "p99.9": 99.9, "max": 100}


def _quantiles(values: Any) -> dict[str, float] | None:
    if not len(values):
        return None
    return {name: round(float(np.percentile(values, q)), 3) for name, q in _QUANTILES.items()}


def describe(result: dict[str, Any]) -> str:
    """Return a drive in real time as lines for people."""
    lines = [
        f"{result['scenario']}: {result['duration_s']:.1f} s in real time, {len(result['approaches'])} approaches, "
        f"{result['frames']} frames perceived, {result['missing_frames']} missing",
        f"processes  {_PRIORITIES[result['priority']]}",
    ]
    if result["processing_ms"] is not None:
        deadline = f"{result['late_frames']} later than their deadline of {result['deadline_ms']:.1f} ms"
        lines.append(f"processing {_line(result['processing_ms'])}, {deadline}")
        lines.append(f"decision   {_line(result['photon_to_decision_ms'])} after the light")
    if result["photon_to_brake_ms"] is not None:
        lines.append(f"command    {_line(result['photon_to_command_ms'])} after the light")
        lines.append(f"brake      {_line(result['photon_to_brake_ms'])} after the light")
    lines += [_approach_line(each) for each in result["approaches"]]
    lines += [_upset_line(each) for each in result["upsets"]]
    if result["upsets"]:
        held = sum(each["held"] for each in result["upsets"])
        lines.append(f"upsets     {held} of {len(result['upsets'])} as stated")
    if result["cut_off"] is not None:
        lines.append(f"CUT OFF    {result['cut_off']}")
    return "\n".join(lines)


_PRIORITIES = {
    "real-time": "run before all others",
    "priority": "have a larger share of the processors",
    "usual": "run like all others: more is not permitted to this user, and images may come late",
}


def _line(quantiles: dict[str, float]) -> str:
    return f"{quantiles['p50']:.1f} ms (99 %: {quantiles['p99']:.1f} ms, max {quantiles['max']:.1f} ms)"


def _approach_line(each: dict[str, Any]) -> str:
    gap = "nothing near" if each["least_gap_m"] is None else f"least gap {each['least_gap_m']:.2f} m"
    hit = ", COLLISION" if each["collision"] else ""
    return f"approach   up to {each['top_speed_mps']:.2f} m/s, stopped by {each['stopped_by']}, {gap}{hit}"


def _upset_line(each: dict[str, Any]) -> str:
    took = "NEVER" if each["took_s"] is None else f"{each['took_s']:.2f} s"
    late = "" if each["took_s"] is None or each["took_s"] <= each["stated_s"] else " LATE"
    back = "LOST" if each["recovered_s"] is None else f"recovered after {each['recovered_s']:.1f} s"
    what = f"{each['role']} {each['action']} at {each['speed_mps']:.2f} m/s"
    return f"upset      {what}: {each['claim']} after {took}{late} (stated {each['stated_s']:.2f} s), {back}"
