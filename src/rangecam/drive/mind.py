"""The system under test: perception, the health of its input, the state machine of the brake, the gate, on the bus."""

import heapq
import math
from collections.abc import Sequence
from dataclasses import replace

from rangecam.brake.gate import CanFrame, Gate, GateSettings, arm, let_pass
from rangecam.brake.machine import (
    BrakeState,
    CarState,
    Inputs,
    MachineSettings,
    Mode,
    Perception,
    advance,
)
from rangecam.can.codec import CarStatus1, CodecError, RemoteValues, decode
from rangecam.config import Config
from rangecam.drive.eye import sequence_s
from rangecam.drive.settings import DriveSettings
from rangecam.pipeline import Sink, process_frame
from rangecam.types import Capture, Ego, Frame, RangeImage, Tracks


def machine_settings(config: Config, settings: DriveSettings) -> tuple[MachineSettings, GateSettings]:
    """Return state machine and gate for the latency of this drive: images are missed after `missed_frames` more."""
    period_s = 1 / config.camera.frame_rate_hz
    timeout_s = latency_s(config, settings) + settings.missed_frames * period_s
    machine = replace(settings.machine, image_timeout_s=timeout_s, max_speed_mps=1.1 * settings.vehicle.max_speed_mps)
    return machine, replace(settings.gate, cause_age_s=timeout_s + settings.step_s)


def latency_s(config: Config, settings: DriveSettings) -> float:
    """Return the time from the end of the read-out of a frame to what was decided of it."""
    return max(settings.result_after_frames / config.camera.frame_rate_hz - sequence_s(config.camera), 0.0)


class Mind:
    """Takes frames of camera and bus, and says what to send; all of its time comes from the caller.

    It begins at work, as after a start at standstill: `start_s` is when image and car state were last good.
    """

    def __init__(self, config: Config, settings: DriveSettings, start_s: float, sinks: Sequence[Sink]) -> None:
        self._config, self._settings, self._sinks = config, settings, sinks
        self._machine, self._gate_settings = machine_settings(config, settings)
        self._latency_s = latency_s(config, settings)
        self._tracks, self._image = Tracks.empty(), _no_image()
        self._waiting: list[tuple[float, int, Perception, Frame]] = []
        self._results = 0
        self._steer, self._forward = 0.0, True
        self._ego: Ego = Ego()
        self._inputs = Inputs(start_s)
        self.frame: Frame | None = None
        self.state = at_work(start_s, self._machine)
        self.gate: Gate = arm(Gate())

    def see(self, capture: Capture, received_s: float) -> None:
        """Process a frame that has arrived; its result is there after the latency of the processors."""
        capture = replace(capture, ego=self._ego)
        frame = process_frame(capture.raw, self._tracks, capture.ego, self._config, before=self._image)
        self._tracks, self._image = frame.tracks, frame.image
        for sink in self._sinks:
            sink.write(capture, frame)
        found = perceived(capture, frame, received_s)
        heapq.heappush(self._waiting, (received_s + self._latency_s, self._results, found, frame))
        self._results += 1

    def hear(self, frame: CanFrame, time_s: float) -> None:
        """Take in a frame of the bus."""
        try:
            message = decode(frame.can_id, frame.data)
        except CodecError:
            return
        if isinstance(message, RemoteValues):
            self._steer, self._forward = message.steering, message.direction >= 0
        elif isinstance(message, CarStatus1):
            car = CarState(message.speed_mps, time_s, self._forward)
            self._inputs = replace(self._inputs, car=car)

    def think(self, time_s: float) -> list[CanFrame]:
        """Return what is to be sent now."""
        request = None
        while self._waiting and self._waiting[0][0] <= time_s:
            _, _, found, self.frame = heapq.heappop(self._waiting)
            self._inputs = replace(self._inputs, time_s=time_s, perception=found)
            self.state, request = advance(self.state, self._inputs, self._machine)
        self._inputs = replace(self._inputs, time_s=time_s)
        self.state, request = advance(self.state, self._inputs, self._machine)
        self._ego = self._measured(time_s)
        self.gate, frame = let_pass(self.gate, request, time_s, self._gate_settings)
        return [] if frame is None else [frame]

    def _measured(self, time_s: float) -> Ego:
        """Return what is known of the own vehicle: the speed that the machine believes, the yaw rate by the wheel."""
        car, vehicle = self._inputs.car, self._settings.vehicle
        if car is None:
            return Ego(time_s)
        speed = self.state.speed_mps
        steer = math.radians(vehicle.max_steer_deg) * self._steer
        return Ego(time_s, speed, speed * math.tan(steer) / vehicle.wheelbase_m, car.forward)
