"""What could have been done: the drive without brakes, and the drive braked as soon as what can be seen demands it.

A collision counts as avoidable if an ideal system avoids it. It sees what the camera, with its field of view, light
and noise, shows of the target: enough right pixels, also beside the area of interest. Of what it sees it knows at once
where it is and how it moves, which of what crosses no real one does, but not how it will move. It obeys the brake rule,
told the truth, and so it brakes on the first image

- that shows enough of the target, seen before in as many images as the tracker confirms a track with: nobody may brake
  for what is beside the way and out of sight;
- in which the target, if it goes straight on as it moves now, will touch us: who waits beside the way may as well stay;
- and in which the rule demands braking: who comes towards the way may as well stop, as long as there is time for that.

From then on it needs the latency of the real one, and brakes fully, on the true road, with the true brakes.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from rangecam.brake.rule import RULES, Threat, is_object
from rangecam.cameras.simulated import SIMULATE, look
from rangecam.clean import clean
from rangecam.config import Config
from rangecam.drive.contact import impact_speed, nearest
from rangecam.drive.eye import sequence_s
from rangecam.drive.journey import between, hand_of, pose_of
from rangecam.drive.settings import DriveSettings
from rangecam.hdr import ranged
from rangecam.pipeline import RANGING
from rangecam.scene.paths import OwnMotion, Path, Pose, place_and_velocity
from rangecam.scene.render import ray_bundle, truth
from rangecam.scene.scenario import Scenario
from rangecam.types import Floats
from rangecam.values import changed
from rangecam.vehicle.dynamics import Command, Road, VehicleState, move, standing
from rangecam.vehicle.remote import command_of

HARMLESS_MPS = 1 / 3.6
"""An impact below it counts as none."""
_STEP_S = 0.01
_LOOKS_HZ = 10.0
_GROSS_M = 0.3
_TOUCHES_M = 0.01
_LONGEST_S = 12.0  # of braking, and until a contact that counts


class Roll(NamedTuple):
    """How a drive went without any camera: what was hit first, when and how fast, the least gap, the way."""

    hit: int
    """i + 1 of the scenario's objects, 0 for none."""
    hit_s: float
    impact_mps: float
    least_gap_m: float
    own: OwnMotion


def starting(scenario: Scenario, settings: DriveSettings, time_s: float = 0.0) -> VehicleState:
    """Return the vehicle as the scenario starts, or before on a straight way."""
    state = standing(settings.vehicle, time_s, scenario.ego.speed_mps)
    state.motion[0] = scenario.ego.speed_mps * time_s
    return state


def roll(scenario: Scenario, settings: DriveSettings, brake_from_s: float = math.inf) -> Roll:
    """Return how the drive goes if the driver drives as the scenario says, and brakes fully from `brake_from_s` on."""
    car, road = starting(scenario, settings), Road(settings.friction)
    poses: list[Pose] = [pose_of(car)]
    own = between(poses, 0.0, _STEP_S)
    least = math.inf
    count = math.ceil((scenario.duration_s + (_LONGEST_S if math.isfinite(brake_from_s) else 0.0)) / _STEP_S)
    for k in range(1, count + 1):
        time_s = (k - 1) * _STEP_S
        braking = time_s >= brake_from_s
        hand = hand_of(scenario, time_s, car, settings.vehicle, braking)
        command = command_of(hand)
        car = move(car, Command(0.0, 1.0, command.steer) if braking else command, _STEP_S, settings.vehicle, road)
        poses.append(pose_of(car))
        near = nearest(scenario, k * _STEP_S, poses[-1], settings.vehicle, settings.harmless)
        least = min(least, near.gap_m)
        if near.gap_m <= 0:
            return _hit(scenario, settings, near.number, own, k * _STEP_S, _STEP_S)
        if braking and car.speed_mps == 0.0:
            break
    return Roll(0, math.inf, 0.0, least, own)


def _hit(
    scenario: Scenario, settings: DriveSettings, number: int, own: OwnMotion, touches_s: float, within_s: float
) -> Roll:
    """Return the contact, whose time lies within a step before `touches_s`; found to a thousandth of the step."""
    free_s = touches_s - within_s
    for _ in range(10):
        middle_s = (free_s + touches_s) / 2
        near = nearest(scenario, middle_s, own(middle_s), settings.vehicle, settings.harmless)
        if near.gap_m > 0:
            free_s = middle_s
        else:
            touches_s, number = middle_s, near.number
    return Roll(number, touches_s, impact_speed(scenario, touches_s, own(touches_s), number), 0.0, own)


contact = _hit


def first_sight(scenario: Scenario, config: Config, free: Roll, seed: int) -> int | None:
    """Return the number of the first frame that shows enough of what the drive without brakes hits; None if none does.

    Enough: as many pixels that the chain keeps, with a range that is right, as the brake rule asks for.
    """
    frames, stride = _frames(config, free), max(round(config.camera.frame_rate_hz / _LOOKS_HZ), 1)
    for k in range(stride - 1, frames + stride, stride):
        if _shows(scenario, config, free, k, seed):
            return next((n for n in range(max(k - stride + 1, 0), k) if _shows(scenario, config, free, n, seed)), k)
    return None


def first_demand(
    scenario: Scenario, config: Config, settings: DriveSettings, free: Roll, first: int, seed: int
) -> int | None:
    """Return the number of the first frame that lets the ideal system brake; None if none does.

    first: number of the first frame that shows enough.
    """
    sure = first + config.tracking.confirm_hits - 1
    for k in range(sure, _frames(config, free)):
        if _is_due(scenario, config, settings, free, k) and _shows(scenario, config, free, k, seed):
            return k
    return None


def _frames(config: Config, free: Roll) -> int:
    """Return how many frames there are until the contact."""
    return math.ceil(free.hit_s * config.camera.frame_rate_hz)


def _is_due(scenario: Scenario, config: Config, settings: DriveSettings, free: Roll, number: int) -> bool:
    """Return whether the brake rule demands braking for what is hit, if it goes on as it does in frame `number`.

    Gap and closing speed are true; where it would come to us from a side, the gap is the way until then.
    """
    time_s, thing = _time_s(config, number), scenario.objects[free.hit - 1]
    position, velocity = place_and_velocity(thing.path, time_s)
    (x, y, z), (vx, vy, vz) = position, velocity
    start_m = x - vx * time_s, y - vy * time_s, z - vz * time_s
    straight_on = changed(thing, path=Path(start_m=start_m, velocity_mps=velocity))
    alone = dataclasses.replace(scenario, objects=(straight_on,))
    comes_s = _comes_s(alone, settings, free.own, time_s)
    pose = free.own(time_s)
    closing = pose.speed_mps - math.cos(pose.heading_rad) * vx - math.sin(pose.heading_rad) * vy
    threat = Threat(closing * comes_s, closing, math.inf)
    return comes_s < math.inf and RULES[config.decision.rule](threat, pose.speed_mps, True, config.decision)


def _comes_s(scenario: Scenario, settings: DriveSettings, own: OwnMotion, time_s: float) -> float:
    """Return after how long the vehicle on its way touches the first thing, to 1 cm or 5 ms; inf if not soon.

    No point of either outline is faster than these speeds, so that the gap is not crossed sooner.
    """
    vehicle, later_s = settings.vehicle, 0.0
    fastest = math.hypot(*place_and_velocity(scenario.objects[0].path, time_s)[1])
    while later_s < _LONGEST_S:
        pose = own(time_s + later_s)
        gap_m = nearest(scenario, time_s + later_s, pose, vehicle).gap_m
        if gap_m < _TOUCHES_M:
            return later_s
        together = fastest + abs(pose.speed_mps) + abs(pose.yaw_rate_radps) * vehicle.length_m
        later_s += max(gap_m / together, _STEP_S / 2) if together > 0 else _LONGEST_S
    return math.inf


def _shows(scenario: Scenario, config: Config, free: Roll, number: int, seed: int) -> bool:
    """Return whether frame `number` shows enough of what is hit."""
    camera, shape, time_s = config.camera, (config.camera.rows, config.camera.columns), _time_s(config, number)
    seen = truth(scenario, time_s, camera.lens, config.mounting, shape, free.own)
    target = seen.object_id == free.hit
    if not _enough(seen.range_m[target], config):
        return False
    bundle = ray_bundle(camera.lens, config.mounting, shape, scenario.subpixels)
    looks = look(scenario, config, bundle, time_s, (seed, number, 3), free.own)
    raw = SIMULATE[camera.kind](looks, camera, time_s, np.random.default_rng([seed, number, 2]))
    wide = changed(config.clean, width_m=None)  # how far aside one looks is a choice, not physics
    image = clean(ranged(RANGING[config.ranging], raw, camera), camera.lens, config.mounting, wide, None)
    right = target & image.valid & (np.abs(image.range_m - seen.range_m) < _GROSS_M + 3 * image.sigma_m)
    return _enough(seen.range_m[right], config)


def _time_s(config: Config, number: int) -> float:
    return number / config.camera.frame_rate_hz


def _exposed_s(config: Config, number: int) -> float:
    return _time_s(config, number) - sequence_s(config.camera) / 2


def _enough(ranges_m: Floats, config: Config) -> bool:
    if not ranges_m.size:
        return False
    threat = Threat(float(np.min(ranges_m)), 1.0, float(ranges_m.size))
    return is_object(threat, config.decision) and ranges_m.size >= config.segments.min_pixels


class Bound(NamedTuple):
    """What an ideal system makes of a drive."""

    threat: bool
    """Without brakes something is hit, not more slowly than `HARMLESS_MPS`."""
    unbraked_mps: float
    """How fast."""
    seen_s: float
    """When the exposure begins that first shows enough of it; inf if none does."""
    braked_mps: float
    """How fast the ideal system still hits something."""
    avoidable: bool


def bound_of(scenario: Scenario, config: Config, settings: DriveSettings, seed: int) -> Bound:
    """Return what could have been done; see above."""
    free = roll(scenario, settings)
    if not free.hit or free.impact_mps < HARMLESS_MPS:
        return Bound(False, free.impact_mps, math.inf, 0.0, False)
    first = first_sight(scenario, config, free, seed)
    if first is None:
        return Bound(True, free.impact_mps, math.inf, free.impact_mps, False)
    seen_s = _exposed_s(config, first)
    demand = first_demand(scenario, config, settings, free, first, seed)
    takes_s = settings.result_after_frames / config.camera.frame_rate_hz + 2 * settings.step_s
    braked_s = math.inf if demand is None else _exposed_s(config, demand) + takes_s
    if braked_s >= free.hit_s:
        return Bound(True, free.impact_mps, seen_s, free.impact_mps, False)
    braked = roll(scenario, settings, braked_s)
    return Bound(True, free.impact_mps, seen_s, braked.impact_mps, braked.impact_mps < HARMLESS_MPS)
