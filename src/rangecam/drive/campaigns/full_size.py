"""The campaign `full-size`: the scenarios of Euro NCAP with a passenger car and three cameras (S-REQ-09, K-GEN-01).

Speeds, overlaps and run-ups are those of the published protocols for cars, pedestrians and cyclists.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from rangecam.drive.campaigns.trial import Drawn, Trial, configured, one_of, scene, uniform
from rangecam.drive.opening import drive_settings
from rangecam.scene.paths import EgoMotion, Path, Phase
from rangecam.scene.shapes import SceneObject
from rangecam.vehicle.settings import VEHICLES

CAMERAS = ("usercams", "scaled_car", "road_cw_20m")
"""The pulsed camera of König, the camera of Steinbäck on a car, and one of several frequencies as of today."""
FRICTION = 0.9
_CAR = VEHICLES["passenger_car"]
_HALF_CAR_M = 2.15
_HITS_S = 4.0  # a crossing is timed so that it is hit then
_BRAKES_S = 0.1 + 0.3 / 2  # of a car: the delay, and half of the rise to full force
ON_A_CAR: dict[str, dict[str, Any]] = {
    # behind the windscreen it would look over the bumper of a car that is near: 8.8 degrees are not much
    "usercams": {
        "mounting": {"z_m": 0.7},
        "decision": {"friction": FRICTION, "reaction_time_s": 4 / 50 + _BRAKES_S, "corridor": {"width_m": 2.0}},
    },
    "scaled_car": {
        "mounting": {"z_m": 0.6},
        "clean": {"x_max_m": 8.0, "width_m": 4.0, "z_max_m": 2.0, "floor_margin_m": 0.12},
        "decision": {
            "friction": FRICTION,
            "reaction_time_s": 4 / 30 + _BRAKES_S,
            "min_object_m": 0.2,
            "corridor": {"width_m": 2.0},
        },
    },
    "road_cw_20m": {"decision": {"friction": FRICTION, "reaction_time_s": 4 / 30 + _BRAKES_S}},
}
"""What a camera's preset is told when it sits at the front of a passenger car on dry asphalt."""


class Target(NamedTuple):
    """What is in the way, its speed over ground, where along our width it would be hit (0 the middle), and when."""

    objects: tuple[SceneObject, ...]
    speed_mps: float
    offset_m: float
    hits_s: float


def draw(rng: np.random.Generator, seed: int, layers: Mapping[str, Any]) -> Trial:
    """Return one drive of one of the protocols, with one of the cameras, by night or in the sun."""
    name = one_of(rng, *PROTOCOLS)
    speeds_kmh, target_of = PROTOCOLS[name]
    camera, light = one_of(rng, *CAMERAS), one_of(rng, "none", "none", "headlights", "sun")
    speed = one_of(rng, *speeds_kmh) / 3.6
    target = target_of(rng, speed)
    scenario = scene(
        f"full-size {name}",
        round(target.hits_s + 3.0, 2),
        target.objects,
        camera,
        ground_reflectivity=uniform(rng, 0.08, 0.25),
        ambient_light=light,
        ego=EgoMotion(speed_mps=speed),
    )
    drawn = Drawn(
        group=name,
        camera=camera,
        speed_mps=speed,
        target=target.objects[0].body,
        target_mps=target.speed_mps,
        offset_m=target.offset_m,
        reflectivity=target.objects[0].reflectivity_factor,
        friction=FRICTION,
        light=light,
    )
    config = configured(camera, layers, ON_A_CAR[camera])
    return Trial(drawn, scenario, config, drive_settings(config, {"vehicle": "passenger_car"}), seed)


def _stationary(rng: np.random.Generator, speed: float) -> Target:
    """CCRs: a car stands in the way, seen from its rear, with half, three quarters or all of our width."""
    offset = (1 - one_of(rng, 0.5, 0.75, 1.0)) * _CAR.width_m * one_of(rng, -1.0, 1.0)
    return Target((_car(rng, speed * _HITS_S, offset, 0.0),), 0.0, offset, _HITS_S)


def _slower(rng: np.random.Generator, speed: float) -> Target:
    """CCRm: a car drives ahead at 20 km/h, reached after five seconds."""
    pace = 20 / 3.6
    offset = (1 - one_of(rng, 0.5, 0.75, 1.0)) * _CAR.width_m * one_of(rng, -1.0, 1.0)
    return Target((_car(rng, (speed - pace) * 5.0, offset, pace),), pace, offset, 5.0)


def _braking(rng: np.random.Generator, speed: float) -> Target:
    """CCRb: a car ahead at our speed, 12 or 40 m away, brakes with 2 or 6 m/s2 to 2 km/h after a second."""
    gap_m, a = one_of(rng, 12.0, 40.0), one_of(rng, 2.0, 6.0)
    falls_s = (speed - 2 / 3.6) / a
    phases = (Phase(duration_s=1.0), Phase(duration_s=falls_s, acceleration_mps2=(-a, 0.0, 0.0)))
    thing = _car(rng, gap_m, 0.0, speed, phases)
    meets_s = math.sqrt(2 * gap_m / a)
    if meets_s > falls_s:  # it creeps by then
        meets_s = falls_s + (gap_m - a * falls_s**2 / 2) / (a * falls_s)
    return Target((thing,), speed, 0.0, 1.0 + meets_s)


def _crossing(
    body: str, kmh: float, start_m: float, run_up_m: float, points: tuple[float, ...], scale: float = 1.0
) -> Callable[[np.random.Generator, float], Target]:
    """Return what walks or rides across from `start_m` aside (left positive), and is hit at one of the points."""

    def target(rng: np.random.Generator, speed: float) -> Target:
        side = 1.0 if start_m > 0 else -1.0
        point = one_of(rng, *points)  # from the side that it comes from
        offset = side * (0.5 - point) * _CAR.width_m
        pace, way_m = kmh / 3.6, abs(start_m - offset)
        phases = []
        if run_up_m > 0:
            a = pace**2 / (2 * run_up_m)
            waits_s = _HITS_S - pace / a - (way_m - run_up_m) / pace
            phases += [Phase(duration_s=waits_s)] if waits_s > 0 else []
            phases += [Phase(duration_s=pace / a, acceleration_mps2=(0.0, -side * a, 0.0))]
            first = Path(start_m=(speed * _HITS_S, start_m, 0.0), phases=tuple(phases))
        else:
            first = Path(
                start_m=(speed * _HITS_S, offset + side * pace * _HITS_S, 0.0), velocity_mps=(0.0, -side * pace, 0.0)
            )
        thing = SceneObject(
            name=body,
            body="person" if body == "child" else body,  # type: ignore[arg-type]  # one of its bodies
            scale=scale,
            heading_deg=-90.0 * side,
            reflectivity_factor=uniform(rng, 0.3, 1.5),
            path=first,
        )
        return Target((thing,), pace, offset, _HITS_S)

    return target


def _hidden_child(rng: np.random.Generator, speed: float) -> Target:
    """CPNCO: a child comes out from behind two parked cars, whose sides are 1 m beside our way."""
    crossing = _crossing("child", 5.0, -4.0, 1.0, (0.5,), 0.68)(rng, speed)
    y, ahead = -(_CAR.width_m / 2 + 1.0 + 0.88), speed * _HITS_S
    parked = tuple(
        SceneObject(
            name=f"parked car {k}",
            body="car",
            path=Path(start_m=(ahead - 0.6 - _HALF_CAR_M - k * 5.0, y, 0.0)),
            reflectivity_factor=uniform(rng, 0.3, 1.5),
        )
        for k in range(2)
    )
    return crossing._replace(objects=(*crossing.objects, *parked))


def _along(body: str, kmh: float, points: tuple[float, ...]) -> Callable[[np.random.Generator, float], Target]:
    """Return what moves along our way, slower than us, reached after five seconds."""

    def target(rng: np.random.Generator, speed: float) -> Target:
        pace = kmh / 3.6
        offset = -(0.5 - one_of(rng, *points)) * _CAR.width_m
        half_m = 0.85 if body == "bicycle" else 0.25
        path = Path(start_m=((speed - pace) * 5.0 + half_m, offset, 0.0), velocity_mps=(pace, 0.0, 0.0))
        thing = SceneObject(
            name=body,
            body=body,  # type: ignore[arg-type]  # one of its bodies
            reflectivity_factor=uniform(rng, 0.3, 1.5),
            path=path,
        )
        return Target((thing,), pace, offset, 5.0)

    return target


def _car(
    rng: np.random.Generator, away_m: float, offset_m: float, speed: float, phases: tuple[Phase, ...] = ()
) -> SceneObject:
    path = Path(start_m=(away_m + _HALF_CAR_M, offset_m, 0.0), velocity_mps=(speed, 0.0, 0.0), phases=phases)
    return SceneObject(name="car", body="car", reflectivity_factor=uniform(rng, 0.3, 1.5), path=path)


def _kmh(low: int, high: int) -> tuple[int, ...]:
    return tuple(range(low, high + 1, 5))


PROTOCOLS: dict[str, tuple[tuple[int, ...], Callable[[np.random.Generator, float], Target]]] = {
    "CCRs": (_kmh(10, 50), _stationary),
    "CCRm": (_kmh(30, 80), _slower),
    "CCRb": ((50,), _braking),
    "CPFA-50": (_kmh(10, 60), _crossing("person", 8.0, 6.0, 1.5, (0.5,))),
    "CPNA": (_kmh(10, 60), _crossing("person", 5.0, -4.0, 1.0, (0.25, 0.75))),
    "CPNCO-50": (_kmh(10, 60), _hidden_child),
    "CPLA-50": (_kmh(20, 60), _along("person", 5.0, (0.5,))),
    "CPLA-25": (_kmh(50, 80), _along("person", 5.0, (0.25,))),
    "CBNA-50": (_kmh(10, 60), _crossing("bicycle", 15.0, -17.0, 0.0, (0.5,))),
    "CBLA-50": (_kmh(25, 60), _along("bicycle", 15.0, (0.5,))),
    "CBLA-25": (_kmh(50, 80), _along("bicycle", 20.0, (0.25,))),
}
"""Own speeds in km/h and targets by the name of the protocol: (rng, own speed) -> Target."""
