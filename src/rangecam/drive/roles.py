"""Camera, perception and vehicle as processes of their own, in real time: the same parts as in `loop`, other wires.

    camera --UDP stream--> perception --CAN--> car --pose, by UDP--> camera

What a role needs is in a `Job`; it runs until `over` is set, and may be killed or frozen at any moment. Everybody
counts seconds on one monotonic clock from `epoch_s` on. Until `go_s` the driver waits at the start and the scene stands
still.
"""

import json
import math
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rangecam.brake.gate import CanFrame
from rangecam.cameras.simulated import SIMULATE, look
from rangecam.can.bus import Bus
from rangecam.config import Config
from rangecam.drive.bound import starting
from rangecam.drive.eye import sequence_s
from rangecam.drive.journey import hand_of, pose_of
from rangecam.drive.mind import Mind
from rangecam.drive.settings import DriveSettings
from rangecam.io.udp.address import LOOPBACK, Address
from rangecam.io.udp.modes import capture_of
from rangecam.io.udp.packets import read_text
from rangecam.io.udp.receiver import Receiver
from rangecam.io.udp.sender import Stream
from rangecam.pipeline import warm_up
from rangecam.scene.paths import Pose
from rangecam.scene.render import ray_bundle
from rangecam.scene.scenario import Scenario
from rangecam.types import Capture
from rangecam.vehicle.dynamics import DIRECTION, SPEED, WHEEL, Command, Road, move
from rangecam.vehicle.remote import Hand
from rangecam.vehicle.sensors import discharged
from rangecam.vehicle.unit import Control, UnitState, advance_unit

LINK_MBIT = 400.0
"""Of the stream: a frame is on its way for some milliseconds, and small buffers hold it."""
SIGN_S = 0.02
"""The perception says so often that it lives."""
START_THROTTLE = 0.4
"""The driver gives no more: the wheel tells no speed before its second hole, and a brisk start from rest looks to the
brake like a speed that jumps."""
_FOREVER_S = 1e9
_BRAKED = Hand(-1.0)


@dataclass(frozen=True)
class Job:
    """What all roles share.

    Ports are on this machine: of the stream, of poses for the camera, of reports; `channel` is that of the bus. over
    and go_s are shared memory: not 0 when all is over; when the driver starts, inf before.
    """

    scenario: Scenario
    config: Config
    settings: DriveSettings
    seed: int
    epoch_s: float
    stream_port: int
    pose_port: int
    report_port: int
    channel: str
    over: Any
    go_s: Any
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep

    def now_s(self) -> float:
        """Return the time of everybody."""
        return self.clock() - self.epoch_s

    def scene_s(self, time_s: float) -> float:
        """Return the time in the scene, 0 before the driver starts."""
        return max(0.0, time_s - float(self.go_s.value))


def camera(job: Job) -> None:
    """Take an image each frame period from where the car is, and stream it when it is read out; skip late ones."""
    config, period_s = job.config, 1 / job.config.camera.frame_rate_hz
    bundle = ray_bundle(
        config.camera.lens, config.mounting, (config.camera.rows, config.camera.columns), job.scenario.subpixels
    )
    half_s, at = sequence_s(config.camera) / 2, (0.0, pose_of(starting(job.scenario, job.settings)))
    with ExitStack() as stack:
        poses = listening(stack, job.pose_port)
        stream = stack.enter_context(Stream(f"udp://{LOOPBACK}:{job.stream_port}", config, link_mbit=LINK_MBIT))
        while not job.over.value:
            k = math.ceil((job.now_s() - half_s) / period_s)
            middle_s = k * period_s
            job.sleep(max(0.0, middle_s + half_s - job.now_s()))
            for text in arrived(poses):
                at = text["time_s"], Pose(*text["pose"])

            def own(
                scene_s: float, at: tuple[float, Pose] = at, offset_s: float = middle_s - job.scene_s(middle_s)
            ) -> Pose:
                return _moved_on(*at, scene_s + offset_s)

            scene_s, seeds = job.scene_s(middle_s), [job.seed, max(k, 0)]
            looks = look(job.scenario, config, bundle, scene_s, np.random.default_rng([*seeds, 1]), own)
            raw = SIMULATE[config.camera.kind](looks, config.camera, scene_s, np.random.default_rng(seeds))
            stream.write(Capture(replace(raw, time_s=middle_s, frame_id=k)))


def _moved_on(known_s: float, pose: Pose, time_s: float) -> Pose:
    """Return where a car is that went straight on since it was last heard of; not for longer than a second."""
    way = pose.speed_mps * min(max(time_s - known_s, -1.0), 1.0)
    x, y = pose.x_m + way * math.cos(pose.heading_rad), pose.y_m + way * math.sin(pose.heading_rad)
    return pose._replace(x_m=x, y_m=y)


def perception(job: Job) -> None:
    """Take the stream in, perceive, decide, and send take-overs over the bus; report each frame and a sign of life."""
    config, address = job.config, Address(LOOPBACK, job.stream_port, idle_s=_FOREVER_S)
    settings = replace(job.settings, result_after_frames=1e-9)  # processing takes the time that it takes here
    with ExitStack() as stack:
        bus = stack.enter_context(Bus("udp_multicast", job.channel))
        report = _sending(stack)
        receiver = Receiver(address, job.clock)
        stack.callback(receiver.close)
        first = None
        while first is None and not job.over.value:
            first = receiver.next_frame(0.1)
        if first is None:
            return
        warm_up(_capture(first[1], config), config)
        mind, signed_s = Mind(config, settings, job.now_s(), ()), -math.inf
        while not job.over.value:
            found = receiver.next_frame(settings.step_s)
            began_s = job.now_s()
            if found is not None:
                mind.see(_capture(found[1], config), found[0] - job.epoch_s)
            while (heard := bus.receive()) is not None:
                mind.hear(CanFrame(heard.can_id, heard.data), job.now_s())
            for frame in mind.think(job.now_s()):
                bus.send_frame(frame.can_id, frame.data)
            done_s = job.now_s()
            if found is not None and mind.frame is not None:
                raw, brake = mind.frame.raw, mind.frame.decision.brake
                times = {"exposed_s": raw.time_s, "arrived_s": found[0] - job.epoch_s, "began_s": began_s}
                _tell(report, job.report_port, {"role": "frame", **times, "done_s": done_s, "brake": brake})
            if done_s - signed_s >= SIGN_S:
                signed_s = done_s
                state = mind.unit.state
                why = {"mode": int(state.mode), "reason": state.cause.reason}
                _tell(report, job.report_port, {"role": "perception", "time_s": done_s, **why})


def _capture(received: Any, config: Config) -> Capture:
    return capture_of(read_text(received.debug[0]), read_text(received.debug[1]), received.images, config)


def car(job: Job) -> None:
    """Be the vehicle: its control unit on the bus, its driver, its motion; report where it is and who it obeys.

    What it does while its process stands still is what it was told last: the actuators know nothing of that.
    """
    scenario, settings, vehicle = job.scenario, job.settings, job.settings.vehicle
    dt, road = settings.step_s, Road(settings.friction)
    state, unit, command, taken = _at_start(job, 0.0), UnitState(), Command(0.0, 1.0), False
    hand_of(scenario, 0.0, discharged(move(state, command, dt, vehicle, road), vehicle, dt), vehicle, False)  # compiled
    with ExitStack() as stack:
        bus = stack.enter_context(Bus("udp_multicast", job.channel))
        out = _sending(stack)
        while not job.over.value:
            now_s, started = job.now_s(), math.isfinite(job.go_s.value)
            if not started:
                state, taken = _at_start(job, now_s), False
            while started and state.time_s + dt <= now_s:
                state = discharged(move(state, command, dt, vehicle, road), vehicle, dt)
            frames = []
            while (heard := bus.receive()) is not None:
                frames.append(CanFrame(heard.can_id, heard.data))
            taken = taken or unit.control is Control.BUS
            lets_go = settings.driver == "lets_go" and taken
            hand = hand_of(scenario, job.scene_s(now_s), state, vehicle, lets_go) if started else _BRAKED
            hand = hand._replace(throttle=min(hand.throttle, START_THROTTLE))
            unit, command, status = advance_unit(unit, now_s, frames, hand, state, vehicle)
            for frame in status:
                bus.send_frame(frame.can_id, frame.data)
            pose = pose_of(state)
            where = {"time_s": state.time_s, "pose": list(pose)}
            _tell(out, job.pose_port, where)
            told = {"wheel_mps": float(state.motion[WHEEL]), "control": int(unit.control), "at_start": not started}
            _tell(out, job.report_port, {"role": "car", **where, "speed_mps": state.speed_mps, **told})
            job.sleep(max(0.0, now_s + dt - job.now_s()))


def _at_start(job: Job, time_s: float) -> Any:
    """Return the vehicle standing at the beginning of its way."""
    state = replace(starting(job.scenario, job.settings, 0.0), time_s=time_s)
    state.motion[SPEED] = state.motion[WHEEL] = 0.0
    state.motion[DIRECTION] = 1.0
    return state


ROLES: dict[str, Callable[[Job], None]] = {"camera": camera, "perception": perception, "car": car}
"""Roles by name, each for a process of its own."""


def listening(stack: ExitStack, port: int) -> socket.socket:
    """Return a socket that hears a port of this machine (0: a free one) and never waits; the stack closes it."""
    found = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    found.bind((LOOPBACK, port))
    found.setblocking(False)
    return found


def _sending(stack: ExitStack) -> socket.socket:
    return stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))


def _tell(out: socket.socket, port: int, values: dict[str, Any]) -> None:
    out.sendto(json.dumps(values).encode(), (LOOPBACK, port))


def arrived(waiting: socket.socket) -> list[dict[str, Any]]:
    """Return what has come since the last call; it comes from our own processes."""
    found = []
    while True:
        try:
            found.append(json.loads(waiting.recv(2000)))
        except BlockingIOError:
            return found
