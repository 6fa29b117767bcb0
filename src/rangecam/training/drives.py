"""Random drives: scenes of things whose class is known, at 2 to 15 m, seen from a vehicle that stands or drives."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rangecam.scene.paths import EgoMotion, Path, Vector
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, Cylinder, SceneObject
from rangecam.scene.weather import Weather
from rangecam.settings import NonNegative, Positive, PositiveInt, settings
from rangecam.types import CLASSES

Rng = np.random.Generator
Place = tuple[float, float]
VRU, VEHICLE, OBSTACLE = (CLASSES.index(name) for name in ("vru", "vehicle", "obstacle"))


@settings
class DriveSettings:
    """What is drawn for a drive."""

    duration_s: Positive = 1.2
    """How long it lasts."""
    frame_rate_hz: Positive = 10.0
    """Images a second."""
    things: PositiveInt = 6
    """How many things there are; a buggy and who pushes it are one."""
    nearest_m: Positive = 2.0
    """The nearest place of a thing."""
    farthest_m: Positive = 15.0
    """The farthest."""
    field_deg: Positive = 40.0
    """Things are spread over this angle."""
    person_scale: tuple[Positive, Positive] = (0.88, 1.12)
    """Size of an adult, as a share of 1.75 m."""
    child_scale: tuple[Positive, Positive] = (0.6, 0.8)
    """Size of a child, which each third person is."""
    vehicle_scale: tuple[Positive, Positive] = (0.9, 1.15)
    """Size of a vehicle."""
    reflectivity: tuple[Positive, Positive] = (0.4, 1.8)
    """Factor of the reflectivity of a thing."""
    rain_mm_per_h: NonNegative = 0.0
    """Rain."""
    ambient_wpm2: NonNegative = 0.0
    """Ambient light in the camera's band."""


class Drive(NamedTuple):
    """A scenario, the class of each of its objects (an index of `CLASSES`), and what each is, in a word."""

    scenario: Scenario
    classes: tuple[int, ...]
    kinds: tuple[str, ...]


def random_drive(preset: str, given: DriveSettings, rng: Rng) -> Drive:
    """Return a drive in which every kind of thing comes as often, apart in direction; half of the vehicles stand."""
    kinds = [KINDS[k] for k in rng.integers(len(KINDS), size=given.things)]
    places = _places(given, rng)
    own_mps = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.5, 5.0))
    objects: list[SceneObject] = []
    classes, names = [], []
    for number, (kind, place) in enumerate(zip(kinds, places, strict=True)):
        made = kind.make(f"{kind.name} {number}", place, given, rng)
        objects += made
        classes += [kind.class_] * len(made)
        names += [kind.name] * len(made)
    scenario = Scenario(
        name="drive",
        description="A random drive",
        preset=preset,
        duration_s=given.duration_s,
        frame_rate_hz=given.frame_rate_hz,
        ground_reflectivity=float(rng.uniform(0.08, 0.4)),
        ambient_wpm2=given.ambient_wpm2,
        weather=Weather(rain_mm_per_h=given.rain_mm_per_h),
        ego=EgoMotion(speed_mps=own_mps),
        objects=tuple(objects),
    )
    return Drive(scenario, tuple(classes), tuple(names))


def _places(given: DriveSettings, rng: Rng) -> list[Place]:
    """Return places (x, y) at any range, one in each sector of the field."""
    sector = math.radians(given.field_deg) / given.things
    places = []
    for k in rng.permutation(given.things):
        angle = -math.radians(given.field_deg) / 2 + sector * (k + rng.uniform(0.2, 0.8))
        away = rng.uniform(given.nearest_m, given.farthest_m)
        places.append((float(away * math.cos(angle)), float(away * math.sin(angle))))
    return places


def _thing(name: str, place: Place, given: DriveSettings, rng: Rng, **more: object) -> SceneObject:
    factor = math.exp(rng.uniform(*np.log(given.reflectivity)))
    path = more.pop("path", None) or Path(start_m=(*place, 0.0))
    return SceneObject(name=name, path=path, reflectivity_factor=factor, **more)  # type: ignore[arg-type]  # its fields


def _moving(place: Place, speed_mps: float, direction_rad: float, given: DriveSettings) -> Path:
    """Return a straight path that is at `place` in the middle of the drive."""
    vx, vy = speed_mps * math.cos(direction_rad), speed_mps * math.sin(direction_rad)
    half = given.duration_s / 2
    return Path(start_m=(place[0] - vx * half, place[1] - vy * half, 0.0), velocity_mps=(vx, vy, 0.0))


def _person_scale(given: DriveSettings, rng: Rng) -> float:
    return float(rng.uniform(*(given.child_scale if rng.random() < 1 / 3 else given.person_scale)))


def _stander(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    heading = float(rng.uniform(-180, 180))
    return [
        _thing(name, place, given, rng, body="person", scale=_person_scale(given, rng), heading_deg=heading),
    ]


def _walker(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    path = _moving(place, float(rng.uniform(0.5, 2.0)), float(rng.uniform(-math.pi, math.pi)), given)
    return [
        _thing(name, place, given, rng, body="person", scale=_person_scale(given, rng), follow_path=True, path=path),
    ]


def _cyclist(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    direction = float(rng.choice([0, 1, 2, 3]) * math.pi / 2 + rng.uniform(-0.3, 0.3))
    path = _moving(place, float(rng.uniform(1.0, 5.0)), direction, given)
    scale = float(rng.uniform(*given.person_scale))
    return [_thing(name, place, given, rng, body="bicycle", scale=scale, follow_path=True, path=path)]


def _buggy(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    direction = float(rng.uniform(-math.pi, math.pi))
    path = _moving(place, float(rng.choice([0.0, 1.0]) * rng.uniform(0.5, 1.5)), direction, given)
    c, s = math.cos(direction), math.sin(direction)
    x, y, _ = path.start_m
    behind = Path(start_m=(x - 0.95 * c, y - 0.95 * s, 0.0), velocity_mps=path.velocity_mps)
    turned = {"heading_deg": math.degrees(direction)}
    scale = float(rng.uniform(*given.person_scale))
    return [
        _thing(name, place, given, rng, body="buggy", path=path, **turned),
        _thing(f"{name}, parent", place, given, rng, body="person", scale=scale, path=behind, **turned),
    ]


def _vehicle(body: str) -> Callable[..., list[SceneObject]]:
    def make(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
        scale = float(rng.uniform(*given.vehicle_scale))
        heading = float(rng.choice([0, 90, 180, 270], p=[0.4, 0.1, 0.4, 0.1]) + rng.uniform(-20, 20))
        moves = rng.random() < 0.5
        # a place is that of the nearest end of a vehicle
        half = scale * (4.4 if body == "truck" else 2.15) * abs(math.cos(math.radians(heading)))
        at = place[0] + half, place[1]
        path = _moving(at, float(rng.uniform(1.0, 7.0)) if moves else 0.0, math.radians(heading), given)
        return [_thing(name, at, given, rng, body=body, scale=scale, heading_deg=heading, path=path)]

    return make


def _post(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    """A post of any height, thin ones and such as thick and high as a person."""
    radius, height = float(rng.uniform(0.03, 0.22)), float(rng.uniform(0.6, 3.5))
    return [_thing(name, place, given, rng, cylinders=(_upright((0.0, 0.0, 0.0), radius, height),))]


def _upright(base_m: Vector, radius_m: float, height_m: float) -> Cylinder:
    return Cylinder(base_m=base_m, radius_m=radius_m, height_m=height_m, reflectivity=0.4)


def _tree(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    return [_thing(name, place, given, rng, body="tree", scale=float(rng.uniform(0.6, 1.6)))]


def _block(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    """A box, a bin, a cabinet, a block of concrete."""
    size = float(rng.uniform(0.2, 1.6)), float(rng.uniform(0.3, 1.6)), float(rng.uniform(0.3, 1.8))
    box = Box(center_m=(size[0] / 2, 0.0, size[2] / 2), size_m=size, yaw_deg=float(rng.uniform(-45, 45)))
    return [_thing(name, place, given, rng, boxes=(box,))]


def _barrier(name: str, place: Place, given: DriveSettings, rng: Rng) -> list[SceneObject]:
    """A wall, a hedge, a fence or a guard rail across or beside the way."""
    heading = float(rng.choice([0.0, 90.0]) + rng.uniform(-25, 25))
    if rng.random() < 0.4:
        return [_thing(name, place, given, rng, body="guard_rail", heading_deg=heading)]
    length, height = float(rng.uniform(2.0, 9.0)), float(rng.uniform(0.6, 3.0))
    box = Box(center_m=(0.0, 0.0, height / 2), size_m=(length, float(rng.uniform(0.1, 0.8)), height))
    return [_thing(name, place, given, rng, boxes=(box,), heading_deg=heading)]


class Kind(NamedTuple):
    """A kind of thing: its name, its class and how one is made (name, place, settings, rng)."""

    name: str
    class_: int
    make: Callable[..., list[SceneObject]]


KINDS = (
    Kind("standing person", VRU, _stander),
    Kind("walking person", VRU, _walker),
    Kind("cyclist", VRU, _cyclist),
    Kind("buggy", VRU, _buggy),
    Kind("car", VEHICLE, _vehicle("car")),
    Kind("car", VEHICLE, _vehicle("car")),
    Kind("truck", VEHICLE, _vehicle("truck")),
    Kind("post", OBSTACLE, _post),
    Kind("tree", OBSTACLE, _tree),
    Kind("block", OBSTACLE, _block),
    Kind("barrier", OBSTACLE, _barrier),
)
"""What there is; drawn alike, so that cars are as frequent as two other kinds."""
