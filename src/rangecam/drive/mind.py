"""The system under test: perception, the health of its input, the state machine of the brake, the gate, on the bus."""

import heapq
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from rangecam.brake.friction import cautious
from rangecam.brake.gate import CanFrame, Gate, arm, disarm
from rangecam.brake.health import Health, judge, perceived
from rangecam.brake.machine import BrakeState, CarState, Inputs, Mode, Perception
from rangecam.brake.settings import full_deceleration, on_ground
from rangecam.brake.unit import BrakeSettings, Unit, step
from rangecam.can.codec import CarStatus1, CodecError, RemoteValues, decode
from rangecam.config import Config
from rangecam.drive.eye import sequence_s
from rangecam.drive.settings import DriveSettings
from rangecam.pipeline import Sink, process_frame
from rangecam.types import Capture, Ego, Frame, RangeImage, Tracks
from rangecam.values import changed
from rangecam.vehicle.sensors import gain_of_wheels, step_of_sensor


@lru_cache(maxsize=16)
def brake_settings(config: Config, settings: DriveSettings, friction: float | None = None) -> BrakeSettings:
    """Return the brake's settings for this camera and vehicle, and the friction that stops have shown, if they have.

    An image is missed `missed_frames` periods after it should have been processed; a cause may be as old. No speed is
    possible that the vehicle cannot reach. A vehicle whose wheels have locked slides on: it is believed to slow down no
    faster than on the road that the decision reckons with, or that it was seen on, else control is given back before it
    stands. Its wheels may gain speed as fast as they can spin on that road, and the measured speed may jump by what its
    sensor does from rest.
    """
    timeout_s = latency_s(config, settings) + settings.missed_frames / config.camera.frame_rate_hz
    brake, vehicle = settings.brake, settings.vehicle
    grip_mps2 = min(full_deceleration(on_ground(config.decision, each)) for each in (None, friction))
    gain_mps2 = gain_of_wheels(vehicle, grip_mps2)
    machine = replace(
        brake.machine,
        image_timeout_s=timeout_s,
        max_speed_mps=1.1 * vehicle.max_speed_mps,
        max_acceleration_mps2=max(brake.machine.max_acceleration_mps2, gain_mps2),
        speed_step_mps=brake.machine.speed_step_mps + step_of_sensor(vehicle, gain_mps2),
        sure_deceleration_mps2=grip_mps2,
    )
    return replace(brake, machine=machine, gate=replace(brake.gate, cause_age_s=timeout_s + settings.step_s))


def latency_s(config: Config, settings: DriveSettings) -> float:
    """Return the time from the end of the read-out of a frame to what was decided of it."""
    return max(settings.result_after_frames / config.camera.frame_rate_hz - sequence_s(config.camera), 0.0)


def at_work(start_s: float) -> Unit:
    """Return the decision unit as it is after a start at standstill: armed, and nothing is wrong up to `start_s`."""
    return Unit(BrakeState(mode=Mode.USER_CONTROL, image_s=start_s, car_s=start_s), arm(Gate()))


def restarted() -> Unit:
    """Return the decision unit as it is after a start at any moment: armed, and not yet seen to work, so it brakes."""
    return Unit(BrakeState(), arm(Gate()))


class Mind:
    """Takes frames of camera and bus, and says what to send; all of its time comes from the caller.

    It begins at work, as after a start at standstill: `start_s` is when image and car state were last good. Or it
    begins with `unit`.
    """

    def __init__(
        self,
        config: Config,
        settings: DriveSettings,
        start_s: float,
        sinks: Sequence[Sink] = (),
        unit: Unit | None = None,
    ) -> None:
        self._config, self._settings, self._sinks = config, settings, sinks
        self._brake = brake_settings(config, settings)
        self._latency_s = latency_s(config, settings)
        self._tracks = Tracks.empty()
        self._image: RangeImage | None = None
        self._health: Health | None = None
        self._waiting: list[tuple[float, int, Perception, Frame]] = []
        self._steer, self._forward = 0.0, True
        self._inputs = Inputs(start_s)
        self._friction: float | None = None
        self._thought: tuple[float, CarState | None, float] | None = None
        self.unit, self.frames = at_work(start_s) if unit is None else unit, 0
        self.frame: Frame | None = None

    def see(self, capture: Capture, received_s: float) -> None:
        """Process a frame that has arrived; its result is there after the latency of the processors."""
        capture = changed(capture, ego=self._measured())
        frame = process_frame(capture.raw, self._tracks, capture.ego, self._config, before=self._image)
        self._tracks, self._image = frame.tracks, frame.image
        for sink in self._sinks:
            sink.write(capture, frame)
        self._health = judge(frame, received_s, self._health, self._brake.health)
        found = perceived(frame, self._health)
        heapq.heappush(self._waiting, (received_s + self._latency_s, self.frames, found, frame))
        self.frames += 1

    def hear(self, frame: CanFrame, time_s: float) -> None:
        """Take in a frame of the bus."""
        try:
            message = decode(frame.can_id, frame.data)
        except CodecError:
            return
        if isinstance(message, RemoteValues):
            self._steer, self._forward = message.steering, message.direction >= 0
        elif isinstance(message, CarStatus1):
            self._inputs = changed(self._inputs, car=CarState(message.speed_mps, time_s, self._forward))

    def think(self, time_s: float) -> list[CanFrame]:
        """Return what is to be sent now."""
        found, car = self._inputs.perception, self._inputs.car
        while self._waiting and self._waiting[0][0] <= time_s:
            _, _, found, self.frame = heapq.heappop(self._waiting)
        known = self.unit.friction.mu
        self._inputs = Inputs(time_s, found, car)
        self.unit, _, frame = step(self.unit, self._inputs, self._brake)
        self._thought = time_s, self._inputs.car, self._steer
        if self.unit.friction.mu != known:
            self._friction = cautious(self.unit.friction, self._brake.friction)
            self._brake = brake_settings(self._config, self._settings, self._friction)
        return [] if frame is None else [frame]

    def leave(self) -> CanFrame:
        """Return the frame that gives control back now; nothing passes the gate after it."""
        gate, frame = disarm(self.unit.gate)
        self.unit = replace(self.unit, gate=gate)
        return frame

    def _measured(self) -> Ego:
        """Return what was known of the own vehicle at the last thought.

        The speed is that which the machine believes, the yaw rate by the wheel.
        """
        if self._thought is None:
            return Ego()
        (time_s, car, steer), vehicle = self._thought, self._settings.vehicle
        if car is None:
            return Ego(time_s)
        speed = self.unit.state.speed_mps
        steer = math.radians(vehicle.max_steer_deg) * steer
        yaw_rate_radps = speed * math.tan(steer) / vehicle.wheelbase_m
        stops = self.unit.state.mode is Mode.STOPPING
        return Ego(time_s, speed, yaw_rate_radps, car.forward, stops, self._friction)
