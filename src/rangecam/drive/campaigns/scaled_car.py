"""The campaign `scaled-car`: the 1/5-scale car of Steinbäck 2016 indoors, on floors of different grip (S-RES-03)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rangecam.brake.rule import stopping_distance
from rangecam.drive.campaigns.trial import Drawn, Trial, a_fault, configured, one_of, scene, uniform
from rangecam.drive.settings import DriveSettings
from rangecam.scene.paths import EgoMotion, Path
from rangecam.scene.shapes import Box, SceneObject
from rangecam.vehicle.settings import VEHICLES

PRESET = "scaled_car"


def draw(rng: np.random.Generator, seed: int, layers: Mapping[str, Any]) -> Trial:
    """Return one drive towards a box, a person or something that crosses; of ten one has a fault in it."""
    config, vehicle = configured(PRESET, layers), VEHICLES["scaled_car"]
    speed, friction, rho = uniform(rng, 0.7, 5.0), uniform(rng, 0.3, 0.7), uniform(rng, 0.1, 0.9)
    target = one_of(rng, "box", "box", "box", "box", "person", "child", "crossing box", "slow car")
    trigger_m = config.decision.margin * stopping_distance(speed, 0.0, config.decision)
    away_m = round(min(max(trigger_m + 1.2 * speed, 3.0), 12.0), 3)
    thing, target_mps, offset, width = _target(rng, target, away_m, speed, rho, vehicle.width_m)
    hits_s = away_m / (speed - target_mps) if target == "slow car" else away_m / speed
    fault = a_fault(rng, hits_s) if rng.random() < 0.1 else None
    objects = (thing, *_room(rng, away_m + target_mps * hits_s + 3.0 + width))
    scenario = scene(
        f"scaled-car {target}",
        round(hits_s + 1.5, 2),
        objects,
        PRESET,
        ground_reflectivity=uniform(rng, 0.1, 0.5),
        ego=EgoMotion(speed_mps=speed),
    )
    drawn = Drawn(
        group=target,
        camera=PRESET,
        speed_mps=speed,
        target=target,
        target_mps=target_mps,
        offset_m=offset,
        reflectivity=rho,
        friction=friction,
        fault="" if fault is None else fault.kind,
    )
    settings = DriveSettings(vehicle=vehicle, friction=friction, faults=() if fault is None else (fault,))
    return Trial(drawn, scenario, config, settings, seed)


def _target(
    rng: np.random.Generator, target: str, away_m: float, speed: float, rho: float, own_width: float
) -> tuple[SceneObject, float, float, float]:
    """Return the thing that is in the way, its speed, its lateral offset and its size along the way."""
    size = [uniform(rng, 0.1, 0.6), uniform(rng, 0.2, 0.7), uniform(rng, 0.2, 0.6)]
    half = (own_width + (size[1] if "box" in target else 0.3)) / 2
    offset = uniform(rng, -0.8 * half, 0.8 * half)
    box = Box(center_m=(size[0] / 2, 0.0, size[2] / 2), size_m=(size[0], size[1], size[2]), reflectivity=rho)
    if target == "box":
        return SceneObject(name="box", boxes=(box,), path=Path(start_m=(away_m, offset, 0.0))), 0.0, offset, size[0]
    if target == "crossing box":
        side, pace = one_of(rng, -1.0, 1.0), uniform(rng, 0.3, 1.0)
        path = Path(start_m=(away_m, offset - side * pace * away_m / speed, 0.0), velocity_mps=(0.0, side * pace, 0.0))
        return SceneObject(name="box", boxes=(box,), path=path), pace, offset, size[0]
    if target == "slow car":
        pace = round(uniform(rng, 0.1, 0.5) * speed, 3)
        path = Path(start_m=(away_m + 0.43, offset, 0.0), velocity_mps=(pace, 0.0, 0.0))
        thing = SceneObject(name="car", body="car", scale=0.2, reflectivity_factor=rho / 0.4, path=path)
        return thing, pace, offset, 0.9
    path = Path(start_m=(away_m + 0.2, offset, 0.0))
    heading = uniform(rng, 0.0, 360.0)
    scale = 1.0 if target == "person" else 0.68
    thing = SceneObject(
        name=target, body="person", scale=scale, heading_deg=heading, reflectivity_factor=rho / 0.5, path=path
    )
    return thing, 0.0, offset, 0.4


def _room(rng: np.random.Generator, far_m: float) -> tuple[SceneObject, ...]:
    """Return the walls of a room: one behind everything, and sometimes one along the way."""
    walls = [Box(center_m=(far_m, 0.0, 1.25), size_m=(0.1, 20.0, 2.5), reflectivity=uniform(rng, 0.2, 0.8))]
    if rng.random() < 0.5:
        side = one_of(rng, -1.0, 1.0) * uniform(rng, 1.0, 2.5)
        walls.append(Box(center_m=(far_m / 2, side, 1.25), size_m=(far_m + 4, 0.1, 2.5), reflectivity=0.6))
    return (SceneObject(name="walls", boxes=tuple(walls)),)
