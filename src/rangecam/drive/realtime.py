"""A drive in real time: processes, the watchdog beside them, what goes wrong on purpose, and what was measured."""

import math
import multiprocessing
import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Self

import numpy as np

from rangecam.brake.machine import CarState, Inputs, Mode, Perception
from rangecam.brake.rule import GRAVITY_MPS2
from rangecam.brake.unit import BrakeSettings, Unit, step
from rangecam.can.bus import Bus
from rangecam.can.codec import CarStatus1
from rangecam.config import Config
from rangecam.drive.contact import nearest
from rangecam.drive.mind import at_work, brake_settings
from rangecam.drive.roles import ROLES, Job, arrived, listening
from rangecam.drive.settings import DriveSettings
from rangecam.errors import DataError
from rangecam.io.udp.address import LOOPBACK
from rangecam.scene.paths import Pose
from rangecam.scene.scenario import Scenario
from rangecam.vehicle.unit import Control

READY_S = 120.0
"""So long processes may take to start, and to recover: kernels may have to be compiled."""
_STANDS_MPS = 0.02


@dataclass(frozen=True)
class Upset:
    """What was done to a process, and how the car stopped: speed then, time until standstill, and the time stated."""

    role: str
    action: str
    speed_mps: float
    stopped_s: float
    stated_s: float
    recovered: bool


class Rig:
    """The three processes and a watchdog, as a resource.

    The watchdog is a second decision unit with its own gate, which hears the car and the perception's signs of life:
    where these cease it brakes to a stop, and gives control back when they are there again.
    """

    def __init__(
        self,
        scenario: Scenario,
        config: Config,
        settings: DriveSettings,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._stack = ExitStack()
        ports = _free_port(), _free_port()
        self._reports = listening(self._stack, 0)
        channel = f"239.{ports[0] % 200 + 20}.{ports[1] // 256}.{ports[1] % 256}"  # none of another rig's
        self.job = Job(
            scenario,
            config,
            settings,
            seed,
            clock(),
            ports[0],
            ports[1],
            self._reports.getsockname()[1],
            channel,
            self._context.Value("i", 0, lock=False),
            self._context.Value("d", math.inf, lock=False),
            clock,
            sleep,
        )
        self._bus = self._stack.enter_context(Bus("udp_multicast", channel))
        self._sleep = sleep
        self._brake: BrakeSettings = brake_settings(config, replace(settings, result_after_frames=1e-9))
        self._watchdog: Unit | None = None
        self._inputs = Inputs(0.0)
        self._processes: dict[str, Any] = {}
        self.car: dict[str, Any] = {}
        self.mode, self.sign_s = Mode.FAULT, -math.inf
        self.cars: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        for role in ROLES:
            self.start(role)

    def start(self, role: str) -> None:
        """Start the process of a role."""
        process = self._context.Process(target=ROLES[role], args=(self.job,), name=f"rangecam-{role}", daemon=True)
        process.start()
        self._processes[role] = process

    def send(self, role: str, number: signal.Signals) -> None:
        """Send a signal to the process of a role: SIGKILL, SIGSTOP, SIGCONT."""
        os.kill(self._processes[role].pid, number)
        if number is signal.SIGKILL:
            self._processes[role].join()

    def watch(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Take reports in and let the watchdog work until `until`, or for so long; return whether it came true.

        Raises DataError if a process has ended by itself.
        """
        end_s = self.job.now_s() + seconds
        while (now_s := self.job.now_s()) < end_s:
            for report in arrived(self._reports):
                self._take(report, now_s)
            while (heard := self._bus.receive()) is not None:
                if isinstance(heard.message, CarStatus1):
                    self._inputs = replace(self._inputs, car=CarState(heard.message.speed_mps, now_s))
            self._guard(now_s)
            for role, process in self._processes.items():
                if process.exitcode not in (None, -signal.SIGKILL):
                    raise DataError(f"the process of the {role} has ended by itself (exit code {process.exitcode})")
            if until():
                return True
            self._sleep(self.job.settings.step_s)
        return False

    def _take(self, report: dict[str, Any], now_s: float) -> None:
        if report["role"] == "car":
            self.car = report
            self.cars.append(report)
        elif report["role"] == "frame":
            self.frames.append(report)
        else:
            if report["mode"] != self.mode:
                why = report["reason"] if report["mode"] != Mode.USER_CONTROL else ""
                self._note("perception", Mode(report["mode"]), why)
            self.mode, self.sign_s = Mode(report["mode"]), now_s
            number = round(1e3 * report["time_s"])
            sign = Perception(number, report["time_s"], now_s, brake=False, reason="")
            self._inputs = replace(self._inputs, perception=sign)

    def _guard(self, now_s: float) -> None:
        if self._watchdog is None and self._inputs.perception is not None and self._inputs.car is not None:
            self._watchdog = at_work(now_s)
        if self._watchdog is not None:
            self._inputs = replace(self._inputs, time_s=now_s)
            before = self._watchdog.state.mode
            self._watchdog, _, frame = step(self._watchdog, self._inputs, self._brake)
            state = self._watchdog.state
            if state.mode is not before:
                self._note("watchdog", state.mode, "" if state.mode is Mode.USER_CONTROL else state.cause.reason)
            if frame is not None:
                self._bus.send_frame(frame.can_id, frame.data)

    def _note(self, who: str, mode: Mode, why: str) -> None:
        self.events.append({"time_s": round(self.job.now_s(), 3), "who": who, "mode": mode.name, "reason": why})

    @property
    def ready(self) -> bool:
        """Whether everybody works, and the car obeys its driver."""
        fresh = self.job.now_s() - self.sign_s < 10 * self.job.settings.step_s
        obeys = self.car.get("control") == int(Control.REMOTE) and self.job.now_s() - self.car["time_s"] < 1.0
        guarded = self._watchdog is not None and self._watchdog.state.mode is Mode.USER_CONTROL
        return fresh and obeys and guarded and self.mode is Mode.USER_CONTROL

    def await_ready(self) -> None:
        """Wait until everybody works and has done so for a while; raises DataError if that does not come."""
        if not self.watch(READY_S, lambda: self.ready and not self.watch(0.3, lambda: not self.ready)):
            raise DataError(f"camera, perception and car do not work together after {READY_S:g} s")

    def go(self) -> None:
        """Let the driver start."""
        self.job.go_s.value = self.job.now_s()

    def put_back(self) -> None:
        """Put the car back to where it started from."""
        self.job.go_s.value = math.inf

    def close(self) -> None:
        """End all processes."""
        self.job.over.value = 1
        for process in self._processes.values():
            if process.is_alive():
                os.kill(process.pid, signal.SIGCONT)
            process.join(3.0)
            if process.is_alive():
                process.kill()
                process.join()
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def stated_stop_s(speed_mps: float, config: Config, settings: DriveSettings) -> float:
    """Return within what time the car stands after camera or perception have ceased, or the car's unit goes on.

    The timeout of images (or of the car's state) runs out, two looks and the way over the bus pass, the brakes begin
    and rise, and friction does the rest, with the speed that the car may have gained until then.
    """
    vehicle, machine = settings.vehicle, brake_settings(config, replace(settings, result_after_frames=1e-9)).machine
    waits_s = (
        max(machine.image_timeout_s, machine.car_timeout_s) + 4 * settings.step_s + 2 / config.camera.frame_rate_hz
    )
    acts_s = vehicle.brake_delay_s + vehicle.brake_rise_s
    gained_mps = speed_mps + vehicle.drive_mps2 * (waits_s + vehicle.brake_delay_s)
    return waits_s + acts_s + min(gained_mps, vehicle.max_speed_mps) / (0.9 * settings.friction * GRAVITY_MPS2)


def upset(rig: Rig, rng: np.random.Generator) -> Upset:
    """Do something to a process while the car drives, see it stop, help the process up, and see all recover.

    camera and perception are killed or frozen, the car's own process is frozen for a while; at a random moment.
    """
    rig.put_back()
    rig.await_ready()
    rig.go()
    rig.watch(float(rng.uniform(0.4, 1.2)))
    role, action = _CHOICES[int(rng.integers(len(_CHOICES)))]
    rig.send(role, signal.SIGKILL if action == "kill" else signal.SIGSTOP)
    began_s, speed = rig.job.now_s(), float(rig.car["speed_mps"])
    stated_s = stated_stop_s(speed, rig.job.config, rig.job.settings)
    if role == "car":
        frozen_s = float(rng.uniform(0.3, 0.6))
        rig.watch(frozen_s)
        rig.send(role, signal.SIGCONT)
        stated_s += frozen_s
    rig.watch(3 * stated_s, lambda: rig.car["time_s"] > began_s and rig.car["speed_mps"] < _STANDS_MPS)
    stopped_s = rig.car["time_s"] - began_s if rig.car["speed_mps"] < _STANDS_MPS else math.inf
    rig.put_back()
    if action == "kill":
        rig.start(role)
    elif role != "car":
        rig.send(role, signal.SIGCONT)
    recovered = rig.watch(READY_S, lambda: rig.ready)
    return Upset(role, action, speed, stopped_s, stated_s, recovered)


_CHOICES = (
    ("camera", "kill"),
    ("camera", "freeze"),
    ("perception", "kill"),
    ("perception", "freeze"),
    ("car", "freeze"),
)


def drive_in_real_time(
    scenario: Scenario, config: Config, settings: DriveSettings, seed: int, duration_s: float, upsets: int
) -> dict[str, Any]:
    """Drive a scene in real time for so long, or until the car stands after a take-over, then upset it so often.

    Returns JSON values: what happened, the latencies of every frame and of the take-over, the upsets. Raises DataError
    if the processes do not come to work together.
    """
    rng = np.random.default_rng(seed)
    with Rig(scenario, config, settings, seed) as rig:
        rig.await_ready()
        first = len(rig.cars), len(rig.frames), len(rig.events)
        rig.go()
        go_s = rig.job.go_s.value
        rig.watch(duration_s, lambda: _stands_again(rig))
        cars, frames = rig.cars[first[0] :], rig.frames[first[1] :]
        events = [{**each, "time_s": round(each["time_s"] - go_s, 3)} for each in rig.events[first[2] :]]
        found = [upset(rig, rng) for _ in range(upsets)]
        last = [{**each, "time_s": round(each["time_s"] - go_s, 3)} for each in rig.events[-12:]]
    return {
        "scenario": scenario.name,
        "duration_s": round(cars[-1]["time_s"] - go_s, 3) if cars else 0.0,
        **_outcome(scenario, settings, cars, go_s),
        **_latencies(config, settings, cars, frames),
        "events": events,
        "last_events": last,
        "upsets": [vars(each) for each in found],
    }


def _stands_again(rig: Rig) -> bool:
    """Return whether the bus has taken over since the driver started, and the car stands."""
    go_s = rig.job.go_s.value
    taken = any(report["control"] == int(Control.BUS) for report in rig.cars[-1000:] if report["time_s"] > go_s)
    return taken and rig.car["speed_mps"] < _STANDS_MPS


def _outcome(scenario: Scenario, settings: DriveSettings, cars: list[dict[str, Any]], go_s: float) -> dict[str, Any]:
    gaps = [
        nearest(scenario, max(0.0, r["time_s"] - go_s), Pose(*r["pose"]), settings.vehicle, settings.harmless).gap_m
        for r in cars[::10]
    ]
    return {
        "least_gap_m": round(min(gaps, default=math.inf), 4) if gaps and math.isfinite(min(gaps)) else None,
        "collision": bool(gaps) and min(gaps) <= 0,
        "top_speed_mps": round(max((r["speed_mps"] for r in cars), default=0.0), 4),
        "stands": bool(cars) and cars[-1]["speed_mps"] < _STANDS_MPS,
    }


def _latencies(
    config: Config, settings: DriveSettings, cars: list[dict[str, Any]], frames: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return processing times beside their deadline, a frame period, and the times from light to decision and brake."""
    period_ms = 1e3 / config.camera.frame_rate_hz
    took = np.array([1e3 * (f["done_s"] - f["arrived_s"]) for f in frames])
    light = np.array([1e3 * (f["done_s"] - f["exposed_s"]) for f in frames])
    counts, edges = np.histogram(light, np.arange(0.0, 205.0, 5.0))
    cause = next((f for f in frames if f["brake"]), None)
    obeys = next((r for r in cars if cause and r["control"] and r["time_s"] >= cause["exposed_s"]), None)
    bites_s = math.nan if cause is None or obeys is None else obeys["time_s"] + settings.vehicle.brake_delay_s
    return {
        "frames": len(frames),
        "deadline_ms": round(period_ms, 3),
        "late_frames": int(np.count_nonzero(took > period_ms)),
        "processing_ms": _quantiles(took),
        "photon_to_decision_ms": _quantiles(light),
        "photon_to_decision_histogram": {"edges_ms": edges.tolist(), "frames": counts.tolist()},
        "photon_to_brake_ms": None
        if math.isnan(bites_s) or cause is None
        else round(1e3 * (bites_s - cause["exposed_s"]), 1),
    }


def _quantiles(values: Any) -> dict[str, float] | None:
    if not len(values):
        return None
    return {name: round(float(np.percentile(values, q)), 3) for name, q in (("p50", 50), ("p99", 99), ("max", 100))}


def describe(result: dict[str, Any]) -> str:
    """Return a drive in real time as lines for people."""
    took, light = result["processing_ms"], result["photon_to_decision_ms"]
    lines = [f"{result['scenario']}: {result['duration_s']:.2f} s in real time, {result['frames']} frames perceived"]
    if took is not None:
        deadline = f"{result['late_frames']} later than their deadline of {result['deadline_ms']:.1f} ms"
        lines.append(f"processing {took['p50']:.1f} ms (99 %: {took['p99']:.1f} ms), {deadline}")
        lines.append(f"latency    {light['p50']:.1f} ms from light to decision (99 %: {light['p99']:.1f} ms)")
    if result["photon_to_brake_ms"] is not None:
        lines.append(f"brake      {result['photon_to_brake_ms']:.0f} ms after the light of the image that demanded it")
    gap = "nothing near" if result["least_gap_m"] is None else f"least gap {result['least_gap_m']:.2f} m"
    lines.append(
        f"way        up to {result['top_speed_mps']:.2f} m/s, {gap}{', COLLISION' if result['collision'] else ''}"
    )
    for each in result["events"]:
        because = f": {each['reason']}" if each["reason"] else ""
        lines.append(
            f"           {each['time_s']:.2f} s {each['who']} {each['mode'].lower().replace('_', ' ')}{because}"
        )
    for each in result["upsets"]:
        stop = (
            f"stopped from {each['speed_mps']:.2f} m/s in {each['stopped_s']:.2f} s (stated {each['stated_s']:.2f} s)"
        )
        lines.append(
            f"upset      {each['role']} {each['action']}: {stop}, {'recovered' if each['recovered'] else 'LOST'}"
        )
    return "\n".join(lines)
