"""The closed loop in simulated time: scene, camera, perception, brake, bus, vehicle, and the scene again.

Read `drive` and you have read it. Every step of `step_s`: what the camera has read out by now is perceived; what was
put on the bus a step before arrives; the state machine thinks; the control unit reports and obeys; the vehicle moves.
The same arguments give the same drive, bit for bit: nothing asks for the time of day, and noise comes from `seed`.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from rangecam.brake.friction import after_stop
from rangecam.brake.gate import CanFrame
from rangecam.brake.machine import Mode
from rangecam.can.layout import MAGIC, MASTER_ID
from rangecam.config import Config
from rangecam.drive.bound import contact, starting
from rangecam.drive.contact import nearest
from rangecam.drive.eye import Eye, sequence_s
from rangecam.drive.faults import active
from rangecam.drive.journey import between, hand_of, pose_of
from rangecam.drive.mind import Mind, latency_s
from rangecam.drive.result import COLUMNS, Drive, Latency
from rangecam.drive.settings import DriveSettings, Fault
from rangecam.pipeline import Sink
from rangecam.scene.paths import Pose
from rangecam.scene.scenario import Scenario
from rangecam.types import Floats
from rangecam.values import changed
from rangecam.vehicle.dynamics import BRAKE, HOLE_S, PERIOD_S, WHEEL, Road, VehicleState, move
from rangecam.vehicle.sensors import discharged, measured_speed
from rangecam.vehicle.unit import Control, UnitState, advance_unit

_LONGEST_BRAKING_S = 15.0
_LOOK_EVERY = 2  # steps from row to row of the timeline, and from one search for contacts to the next


def drive(
    scenario: Scenario, config: Config, settings: DriveSettings, seed: int = 0, sinks: Sequence[Sink] = ()
) -> Drive:
    """Return how a vehicle with this camera and brake drives through a scene.

    The scenario says how fast its driver drives and where it bends; what perception and brake make of it is up to
    them. It ends with a contact, at standstill after a take-over, or when the scenario does. sinks: get each frame that
    was perceived, as of `pipeline.run`; captures then carry the truth.
    """
    dt, vehicle, road = settings.step_s, settings.vehicle, Road(settings.friction)
    start_s = -settings.run_in_s
    car, unit = starting(scenario, settings, start_s), UnitState()
    poses: list[Pose] = [pose_of(car)]
    own = between(poses, start_s, dt)
    eye = Eye(scenario, config, settings, seed, own, bool(sinks))
    mind = Mind(config, settings, start_s, sinks)
    to_mind: list[CanFrame] = []
    to_unit: list[CanFrame] = []
    log = _Log(scenario)
    for k in range(math.ceil((scenario.duration_s + settings.run_in_s + _LONGEST_BRAKING_S) / dt)):
        time_s = start_s + k * dt
        for received_s, capture in eye.arrived(time_s):
            mind.see(capture, received_s)
        for frame in to_mind:
            mind.hear(frame, time_s)
        sent = mind.think(time_s)
        hand = hand_of(scenario, time_s, car, vehicle, settings.driver == "lets_go" and math.isfinite(log.braked_s))
        told = _reported(car, time_s, settings.faults, log)
        unit, command, status = advance_unit(unit, time_s, to_unit, hand, told, vehicle)
        log.follow(time_s, car, mind, unit, sent, status)
        if k % _LOOK_EVERY == 0:
            near = nearest(scenario, time_s, poses[-1], vehicle, settings.harmless)
            log.note(time_s, car, near.gap_m, measured_speed(told, vehicle), mind, unit)
            if near.gap_m <= 0:
                hit = contact(scenario, settings, near.number, own, time_s, _LOOK_EVERY * dt)
                name = scenario.objects[hit.hit - 1].name
                return log.finished(mind, config, settings, name, hit.impact_mps, hit.hit_s)
        if _over(time_s, scenario, settings, car, log):
            break
        to_mind, to_unit = _through_bus(status, sent, time_s, settings.faults)
        slippery = active(settings.faults, time_s, "slippery") if settings.faults else None
        car = move(car, command, dt, vehicle, road if slippery is None else Road(slippery.value))
        if k % _LOOK_EVERY == 0:
            car = discharged(car, vehicle, _LOOK_EVERY * dt)
        poses.append(pose_of(car))
    return log.finished(mind, config, settings)


def _over(time_s: float, scenario: Scenario, settings: DriveSettings, car: VehicleState, log: "_Log") -> bool:
    if not math.isfinite(log.braked_s):
        return time_s >= scenario.duration_s
    stands = time_s - log.stood_s >= settings.stop_after_s
    return stands and (settings.driver == "lets_go" or time_s >= scenario.duration_s)


def _through_bus(
    status: list[CanFrame], sent: list[CanFrame], time_s: float, faults: Sequence[Fault]
) -> tuple[list[CanFrame], list[CanFrame]]:
    """Return what arrives at the perception and at the control unit a step later."""
    if faults:
        if active(faults, time_s, "status_silence"):
            status = []
        if active(faults, time_s, "command_silence"):
            sent = []
        if active(faults, time_s, "wrong_magic"):
            sent = [CanFrame(frame.can_id, frame.data[:-2] + b"\0\0") for frame in sent]
    return sorted(status, key=lambda frame: frame.can_id), sent


def _reported(car: VehicleState, time_s: float, faults: Sequence[Fault], log: "_Log") -> VehicleState:
    """Return the vehicle as its sensors see it: with a stuck one, as if the wheels turned as they did before."""
    if not (faults and active(faults, time_s, "speed_stuck")):
        log.period_s = float(car.motion[PERIOD_S])
        return car
    motion = car.motion.copy()
    motion[PERIOD_S], motion[HOLE_S] = log.period_s, time_s
    return changed(car, motion=motion)


class _Log:
    """What has happened so far."""

    def __init__(self, scenario: Scenario) -> None:
        self._name = scenario.name
        self._rows: list[tuple[float, ...]] = []
        self._bus: Counter[int] = Counter()
        self._take_overs = 0
        self.braked_s = self.stood_s = math.inf
        self.least_gap_m = math.inf
        self.reason, self.by_fault = "", False
        self.period_s = math.inf
        self._exposed_s = self._obeyed_s = self._bites_s = self._full_s = math.nan

    def follow(
        self,
        time_s: float,
        car: VehicleState,
        mind: Mind,
        unit: UnitState,
        sent: list[CanFrame],
        status: list[CanFrame],
    ) -> None:
        """Take in what was sent in a step, and how the brakes come on."""
        takes = False
        for frame in (*sent, *status):
            self._bus[frame.can_id] += 1
            takes |= frame.can_id == MASTER_ID and frame.data[-2:] == MAGIC
        self._take_overs += takes
        if takes and not math.isfinite(self.braked_s):
            self._first_take_over(time_s, mind)
        if not math.isfinite(self.braked_s):
            return
        braking = float(car.motion[BRAKE])
        if math.isnan(self._obeyed_s) and unit.control is Control.BUS:
            self._obeyed_s = time_s
        if math.isnan(self._bites_s) and braking > 0:
            self._bites_s = time_s
        if math.isnan(self._full_s) and braking >= 1:
            self._full_s = time_s
        if car.speed_mps > 0:
            self.stood_s = math.inf
        elif not math.isfinite(self.stood_s):
            self.stood_s = time_s

    def _first_take_over(self, time_s: float, mind: Mind) -> None:
        self.braked_s = time_s
        self.by_fault = mind.unit.state.mode is Mode.FAULT
        self.reason = mind.unit.state.cause.reason
        if not self.by_fault and mind.frame is not None:
            self._exposed_s = mind.frame.raw.time_s

    def note(
        self, time_s: float, car: VehicleState, gap_m: float, measured_mps: float, mind: Mind, unit: UnitState
    ) -> None:
        """Add a row to the timeline."""
        self.least_gap_m = min(self.least_gap_m, gap_m)
        decision = mind.frame.decision if mind.frame is not None else None
        x, y, _ = car.pose
        row = (
            time_s,
            x,
            y,
            car.speed_mps,
            float(car.motion[WHEEL]),
            measured_mps,
            gap_m,
            decision.distance_m if decision is not None else math.nan,
            float(decision is not None and decision.brake),
            float(mind.unit.state.mode),
            float(unit.control),
            float(car.motion[BRAKE]),
            float(self._take_overs),
        )
        self._rows.append(row)

    def finished(
        self,
        mind: Mind,
        config: Config,
        settings: DriveSettings,
        hit: str = "",
        impact_mps: float = 0.0,
        hit_s: float = math.inf,
    ) -> Drive:
        """Return the drive as it came out."""
        half_s = sequence_s(config.camera) / 2
        latency = Latency(
            self._exposed_s - half_s,
            self._exposed_s + half_s,
            self._exposed_s + half_s + latency_s(config, settings),
            self._obeyed_s,
            # the brakes begin `brake_delay_s` after the command, between two looks
            self._obeyed_s + settings.vehicle.brake_delay_s if math.isfinite(self._bites_s) else math.nan,
            self._full_s,
        )
        known = after_stop(mind.unit.friction, settings.brake.friction)
        columns: dict[str, Floats] = dict(zip(COLUMNS, np.array(self._rows).T, strict=True))
        more: dict[str, Any] = {
            "hit": hit,
            "impact_mps": impact_mps,
            "hit_s": hit_s,
            "least_gap_m": 0.0 if hit else self.least_gap_m,
            "braked_s": self.braked_s,
            "reason": self.reason,
            "by_fault": self.by_fault,
            "stood_s": self.stood_s,
            "frames": mind.frames,
            "duration_s": float(columns["time_s"][-1]),
            "refused": {str(why): count for why, count in mind.unit.gate.refused.items()},
            "frames_on_bus": dict(self._bus),
            "friction": known.mu if math.isfinite(known.sigma) else math.nan,
            "friction_sigma": known.sigma if math.isfinite(known.sigma) else math.nan,
        }
        return Drive(self._name, columns, latency, **more)
