"""Camera, perception and car as processes, and the watchdog beside them, as one resource."""

import math
import multiprocessing
import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from rangecam.brake.gate import disarm
from rangecam.brake.machine import CarState, Inputs, Mode, Perception
from rangecam.brake.unit import BrakeSettings, step
from rangecam.can.bus import Bus
from rangecam.can.codec import CarStatus1
from rangecam.config import Config
from rangecam.drive.mind import brake_settings, restarted
from rangecam.drive.prompt import prompt, relaxed
from rangecam.drive.roles import LEVELS, ROLES, Job, arrived, at_once, listening
from rangecam.drive.settings import DriveSettings
from rangecam.errors import DataError
from rangecam.io.udp.address import LOOPBACK
from rangecam.scene.scenario import Scenario
from rangecam.vehicle.unit import Control

READY_S = 900.0
"""So long processes may take to start: the first time kernels are compiled, which takes minutes."""
STANDS_MPS = 0.02
"""At or below this true speed the car stands."""
_STEADY_S = 0.3


class Rig:
    """The three processes and a watchdog, as a resource.

    The watchdog is a second decision unit with its own gate, which hears the car and the perception's signs of life:
    where these cease it brakes to a stop, and gives control back when they are there again. Like the perception it
    starts as a fault: the car is held until all have been seen to work.
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
        self._context: Any = multiprocessing.get_context(_start_method())
        if _start_method() == "forkserver":
            self._context.set_forkserver_preload(["rangecam.drive.roles"])  # who is restarted is there at once
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
        brake, vehicle = brake_settings(config, at_once(settings)), settings.vehicle
        # wheels lock when the perception brakes, of which the watchdog knows nothing
        locks_mps2 = max(brake.machine.max_deceleration_mps2, vehicle.brake_mps2 / vehicle.wheel_inertia)
        self.brake: BrakeSettings = replace(brake, machine=replace(brake.machine, max_deceleration_mps2=locks_mps2))
        self._watchdog, self._inputs = restarted(), Inputs(0.0)
        self._processes: dict[str, Any] = {}
        self.priority = "usual"
        self.car: dict[str, Any] = {"time_s": -math.inf, "speed_mps": 0.0, "control": int(Control.BUS)}
        self.mode, self.sign_s = Mode.FAULT, -math.inf
        self.cars: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        for role in ROLES:
            self.start(role)

    @property
    def guard(self) -> Mode:
        """The mode of the watchdog."""
        return self._watchdog.state.mode

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
                    came_s = self.job.came_s(heard.time_s)
                    self._inputs = replace(self._inputs, car=CarState(heard.message.speed_mps, came_s))
            self._guard(self.job.now_s())
            for role, process in self._processes.items():
                if process.exitcode not in (None, -signal.SIGKILL):
                    raise DataError(f"the process of the {role} has ended by itself (exit code {process.exitcode})")
            if until():
                return True
            self._sleep(max(0.0, now_s + self.job.settings.step_s - self.job.now_s()))
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
            number = round(1e6 * report["time_s"])
            sign = Perception(number, report["time_s"], now_s, brake=False, reason="")
            self._inputs = replace(self._inputs, perception=sign)

    def _guard(self, now_s: float) -> None:
        self._inputs = replace(self._inputs, time_s=now_s)
        before = self.guard
        self._watchdog, _, frame = step(self._watchdog, self._inputs, self.brake)
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
        obeys = self.car["control"] == int(Control.REMOTE) and self.job.now_s() - self.car["time_s"] < 1.0
        return fresh and obeys and self.guard is Mode.USER_CONTROL and self.mode is Mode.USER_CONTROL

    def await_ready(self) -> None:
        """Wait until everybody works and has done so for a while; raises DataError if that does not come."""
        if not self.watch(READY_S, self._steady):
            raise DataError(f"camera, perception and car do not work together after {READY_S:g} s")

    def _steady(self) -> bool:
        return self.ready and not self.watch(_STEADY_S, lambda: not self.ready)

    def hurry(self) -> None:
        """Let the watchdog run before other processes, as the roles do; `priority` says what was permitted."""
        self.priority = prompt(LEVELS["watchdog"])
        self._stack.callback(relaxed)

    def go(self) -> None:
        """Let the driver start."""
        self.job.go_s.value = self.job.now_s()

    def put_back(self) -> None:
        """Put the car back to where it started from."""
        self.job.go_s.value = math.inf

    def close(self) -> None:
        """End all processes; the watchdog gives control back."""
        self.job.over.value = 1
        _, last = disarm(self._watchdog.gate)
        self._bus.send_frame(last.can_id, last.data)
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


def _start_method() -> str:
    return "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port
