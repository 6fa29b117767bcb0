"""Camera, perception and vehicle as processes of their own, in real time: the same parts as in `loop`, other wires.

    camera --UDP stream--> perception --CAN--> car --pose, by UDP--> camera

What a role needs is in a `Job`; it runs until `over` is set, and may be killed or frozen at any moment. Everybody
counts seconds on one monotonic clock from `epoch_s` on. Until `go_s` the driver waits at the start and the scene stands
still. What comes in is stamped by the kernel where it can: that a process gets to it late does not make it late.
"""

import json
import math
import signal
import socket
import sys
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
from rangecam.drive.mind import Mind, restarted
from rangecam.drive.prompt import end_with_parent, keep_memory, prompt, sooner
from rangecam.drive.settings import DriveSettings
from rangecam.errors import DataError
from rangecam.io.udp.address import LOOPBACK, Address
from rangecam.io.udp.modes import capture_of
from rangecam.io.udp.packets import read_text
from rangecam.io.udp.receiver import Receiver
from rangecam.io.udp.sender import Stream
from rangecam.pipeline import warm_up
from rangecam.scene.paths import Pose
from rangecam.scene.render import RayBundle, ray_bundle
from rangecam.scene.scenario import Scenario
from rangecam.types import Capture, Frame
from rangecam.vehicle.dynamics import DIRECTION, PERIOD_S, SPEED, WHEEL, Command, Road, VehicleState, move
from rangecam.vehicle.remote import Hand
from rangecam.vehicle.sensors import discharged
from rangecam.vehicle.unit import Control, UnitState, advance_unit

LINK_MBIT = 400.0
"""Of the stream: a frame is on its way for some milliseconds, and small buffers hold it."""
SIGN_S = 0.02
"""The perception says so often that it lives."""
AHEAD_S = 0.022
"""The camera computes an image so long before its read-out ends, as a sensor would have it for nothing then: of a car
that drives on evenly, which at 8 m/s2 is 3 mm beside the truth, and a frame late behind one that begins to brake."""
LEVELS = {"camera": 10, "perception": 20, "car": 30, "watchdog": 30}
"""Who runs before whom (`prompt`)."""
_FOREVER_S = 1e9
_SWITCH_S = 5e-4  # for so long may a thread keep the one that takes packets in from going on
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
    wall: Callable[[], float] = time.time

    def now_s(self) -> float:
        """Return the time of everybody."""
        return self.clock() - self.epoch_s

    def came_s(self, stamp_s: float) -> float:
        """Return when a frame of the bus came that the kernel stamped by the time of day; now if that was set back."""
        return self.now_s() - max(0.0, self.wall() - stamp_s)

    def scene_s(self, time_s: float) -> float:
        """Return the time in the scene, 0 before the driver starts."""
        return max(0.0, time_s - float(self.go_s.value))


def camera(job: Job) -> None:
    """Stream an image each frame period when it is read out, seen from where the car is; skip those missed."""
    _settle()
    config, period_s = job.config, 1 / job.config.camera.frame_rate_hz
    bundle = ray_bundle(
        config.camera.lens, config.mounting, (config.camera.rows, config.camera.columns), job.scenario.subpixels
    )
    half_s, at, k = sequence_s(config.camera) / 2, (0.0, pose_of(_at_start(job, 0.0))), -1
    with ExitStack() as stack:
        poses = listening(stack, job.pose_port)
        stream = stack.enter_context(Stream(f"udp://{LOOPBACK}:{job.stream_port}", config, link_mbit=LINK_MBIT))
        _image(job, bundle, 0, 0.0, at)  # compiled
        prompt(LEVELS["camera"])
        while not job.over.value:
            k = max(k + 1, math.ceil((job.now_s() + AHEAD_S / 2 - half_s) / period_s))
            read_s = k * period_s + half_s
            job.sleep(max(0.0, read_s - AHEAD_S - job.now_s()))
            for text in arrived(poses):
                at = text["time_s"], Pose(*text["pose"])
            capture = _image(job, bundle, k, k * period_s, at)
            job.sleep(max(0.0, read_s - job.now_s()))
            stream.write(capture)


def _image(job: Job, bundle: RayBundle, number: int, middle_s: float, at: tuple[float, Pose]) -> Capture:
    """Return image `number` with its exposures around `middle_s`, from a car whose pose `at` was that at its time."""
    offset_s = middle_s - job.scene_s(middle_s)

    def own(scene_s: float) -> Pose:
        return _moved_on(*at, scene_s + offset_s)

    scene_s, seeds = job.scene_s(middle_s), (job.seed, number)
    looks = look(job.scenario, job.config, bundle, scene_s, (*seeds, 1), own)
    raw = SIMULATE[job.config.camera.kind](looks, job.config.camera, scene_s, np.random.default_rng(seeds))
    return Capture(replace(raw, time_s=middle_s, frame_id=number))


def _moved_on(known_s: float, pose: Pose, time_s: float) -> Pose:
    """Return where a car is that went straight on since it was last heard of; not for longer than a second."""
    way = pose.speed_mps * min(max(time_s - known_s, -1.0), 1.0)
    x, y = pose.x_m + way * math.cos(pose.heading_rad), pose.y_m + way * math.sin(pose.heading_rad)
    return pose._replace(x_m=x, y_m=y)


def perception(job: Job) -> None:
    """Take the stream in, perceive, decide, and send take-overs over the bus; report each frame and a sign of life.

    It starts as a fault and brakes until it has been seen to work. When all is over it gives control back.
    """
    _settle()
    config, stale_s = job.config, job.settings.missed_frames / job.config.camera.frame_rate_hz
    sys.setswitchinterval(_SWITCH_S)
    with ExitStack() as stack:
        bus = stack.enter_context(Bus("udp_multicast", job.channel))
        report = _sending(stack)
        receiver = _receiver(job)
        stack.callback(lambda: receiver.close())
        first = None
        while first is None and not job.over.value:
            first = _next(receiver, config, 0.1)
        if first is None:
            return
        warm_up(first[1], config)
        receiver = _renewed(receiver, job)
        mind, signed_s = Mind(config, at_once(job.settings), job.now_s(), unit=restarted()), -math.inf
        while not job.over.value:
            found = _next(receiver, config, job.settings.step_s)
            if found is not None and job.clock() - found[0] > stale_s:
                receiver, found = _renewed(receiver, job), None
            if found is not None:
                mind.see(found[1], found[0] - job.epoch_s)
            while (heard := bus.receive()) is not None:
                mind.hear(CanFrame(heard.can_id, heard.data), job.came_s(heard.time_s))
            for frame in mind.think(job.now_s()):
                bus.send_frame(frame.can_id, frame.data)
            done_s = job.now_s()
            if found is not None and mind.frame is not None:
                _tell(report, job.report_port, _of_frame(mind.frame, found[0] - job.epoch_s, done_s, config))
            if done_s - signed_s >= SIGN_S:
                signed_s, state = done_s, mind.unit.state
                why = {"mode": int(state.mode), "reason": state.cause.reason}
                _tell(report, job.report_port, {"role": "perception", "time_s": done_s, **why})
        last = mind.leave()
        bus.send_frame(last.can_id, last.data)


def _receiver(job: Job) -> Receiver:
    return Receiver(Address(LOOPBACK, job.stream_port, idle_s=_FOREVER_S), job.clock, job.wall)


def _renewed(old: Receiver, job: Job) -> Receiver:
    """Return a receiver that hears what comes from now on, its thread as prompt as the others.

    A second of packets waits in the kernel for a process that was compiling or frozen. Who works through it is busy
    with the past, and may never be in time again: what is late is worthless.
    """
    old.close()
    new = _receiver(job)
    prompt(LEVELS["perception"])
    return new


def at_once(settings: DriveSettings) -> DriveSettings:
    """Return settings for a decision that takes the time that it takes here, not that of simulated processors."""
    return replace(settings, result_after_frames=1e-9)


def _next(receiver: Receiver, config: Config, timeout_s: float) -> tuple[float, Capture] | None:
    """Return the next frame and when it came; None if none comes in time, or it is not one of this camera."""
    found = receiver.next_frame(timeout_s)
    if found is None:
        return None
    came_s, received = found
    try:
        words = read_text(received.debug[0]), read_text(received.debug[1])
        return came_s, capture_of(*words, received.images, config)
    except DataError:
        receiver.unreadable += 1
        return None


def _of_frame(frame: Frame, arrived_s: float, done_s: float, config: Config) -> dict[str, Any]:
    exposed_s = frame.raw.time_s - sequence_s(config.camera) / 2
    times = {"exposed_s": exposed_s, "arrived_s": arrived_s, "done_s": done_s}
    return {"role": "frame", "number": frame.raw.frame_id, "brake": frame.decision.brake, **times}


def car(job: Job) -> None:
    """Be the vehicle: its control unit on the bus, its driver, its motion; report where it is and who it obeys.

    What it does while its process stands still is what it was told last: the actuators know nothing of that. With its
    process the vehicle itself is gone; the next one stands at the start, and stays there until it is let go.
    """
    _settle()
    scenario, settings, vehicle = job.scenario, job.settings, job.settings.vehicle
    dt, road, born_s = settings.step_s, Road(settings.friction), job.now_s()
    state, unit, command, taken = _at_start(job, born_s), UnitState(), Command(0.0, 1.0), False
    hand_of(scenario, 0.0, discharged(move(state, command, dt, vehicle, road), vehicle, dt), vehicle, False)  # compiled
    with ExitStack() as stack:
        bus = stack.enter_context(Bus("udp_multicast", job.channel))
        out = _sending(stack)
        prompt(LEVELS["car"])
        while not job.over.value:
            now_s, started = job.now_s(), born_s < job.go_s.value < math.inf
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
            unit, command, status = advance_unit(unit, now_s, frames, hand, state, vehicle)
            for frame in status:
                bus.send_frame(frame.can_id, frame.data)
            where = {"time_s": state.time_s, "pose": list(pose_of(state))}
            _tell(out, job.pose_port, where)
            obeys = {"control": int(unit.control), "obeyed_s": now_s}
            _tell(
                out, job.report_port, {"role": "car", "speed_mps": state.speed_mps, "born_s": born_s, **where, **obeys}
            )
            job.sleep(max(0.0, now_s + dt - job.now_s()))


def _settle() -> None:
    """Start sooner than others, keep the memory, and leave Ctrl-C to who started this process, and will end it."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sooner()
    keep_memory()


def _at_start(job: Job, time_s: float) -> VehicleState:
    """Return the vehicle standing at the beginning of its way."""
    state = replace(starting(job.scenario, job.settings), time_s=time_s)
    state.motion[SPEED] = state.motion[WHEEL] = 0.0
    state.motion[DIRECTION] = 1.0
    state.motion[PERIOD_S] = math.inf
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
