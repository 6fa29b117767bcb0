"""The campaign `false-positives`: driving past what nobody needs to brake for (S-RES-04, and phantom braking)."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from rangecam.drive.campaigns.full_size import ON_A_CAR
from rangecam.drive.campaigns.trial import Drawn, Trial, configured, one_of, scene, uniform
from rangecam.drive.opening import drive_settings
from rangecam.scene.paths import EgoMotion, EgoPhase, Path
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, Cylinder, SceneObject
from rangecam.scene.weather import Cloud, Weather
from rangecam.vehicle.settings import VEHICLES, Vehicle

_LASTS_S = 8.0
HARMLESS = ("leaf",)
"""Names of things that are driven through: nobody calls it a collision."""


class Sight(NamedTuple):
    """What there is, our own motion and the weather; what is beside the way stays beside it."""

    objects: tuple[SceneObject, ...]
    ego: EgoMotion
    weather: Weather = Weather()


def draw(rng: np.random.Generator, seed: int, layers: Mapping[str, Any]) -> Trial:
    """Return one drive without danger, of the passenger car with a pulsed camera or of the scaled car.

    The scaled car has two modulation frequencies: with 17 MHz alone a reflector beyond 8.8 m cannot be told from a near
    thing, and the car brakes for it (Steinbäck 2016, 5.3.3).
    """
    camera = one_of(rng, "usercams", "usercams", "scaled_car_unwrapped")
    on_road = camera == "usercams"
    sights = ROAD if on_road else FLOOR
    name = one_of(rng, *sights)
    vehicle = VEHICLES["passenger_car" if on_road else "scaled_car"]
    speed = uniform(rng, 3.0, 16.0) if on_road else uniform(rng, 0.7, 3.0)
    sight = sights[name](rng, speed, vehicle)
    friction = 0.9 if on_road else uniform(rng, 0.3, 0.7)
    light = one_of(rng, "none", "none", "headlights", "sun") if on_road else "none"
    scenario = _scene(rng, f"false-positives {name}", camera, sight, light)
    drawn = Drawn(
        group=name,
        camera=camera,
        speed_mps=speed,
        target=sight.objects[0].name if sight.objects else "",
        friction=friction,
        light=light,
        weather=name if name in ("rain", "dust", "leaves") else "",
    )
    layer = ON_A_CAR[camera] if on_road else {}
    config = configured(camera, layers, layer)
    told = {"vehicle": "passenger_car" if on_road else "scaled_car", "friction": friction, "harmless": HARMLESS}
    return Trial(drawn, scenario, config, drive_settings(config, told), seed)


def _scene(rng: np.random.Generator, name: str, camera: str, sight: Sight, light: Any) -> Scenario:
    ground = uniform(rng, 0.08, 0.4)
    return scene(
        name,
        _LASTS_S,
        sight.objects,
        camera,
        ego=sight.ego,
        weather=sight.weather,
        ambient_light=light,
        ground_reflectivity=ground,
    )


def _straight(speed: float) -> EgoMotion:
    return EgoMotion(speed_mps=speed)


def _thing(
    name: str, body: Any, x: float, y: float, heading: float = 0.0, rho: float = 1.0, **more: Any
) -> SceneObject:
    return SceneObject(
        name=name,
        body=body,
        heading_deg=heading,
        reflectivity_factor=rho,
        path=Path(start_m=(round(x, 3), round(y, 3), 0.0)),
    )


def _bridge(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """A bridge across the way, no lower than 2.5 m."""
    low_m, x = uniform(rng, 2.5, 4.5), speed * uniform(rng, 2.0, 5.0) + 10
    deck = Box(center_m=(4.0, 0.0, low_m + 0.5), size_m=(8.0, 16.0, 1.0), reflectivity=uniform(rng, 0.2, 0.6))
    piers = [
        Box(center_m=(4.0, side * 5.0, low_m / 2), size_m=(8.0, 0.6, low_m), reflectivity=0.4) for side in (-1.0, 1.0)
    ]
    thing = SceneObject(name="bridge", boxes=(deck, *piers), path=Path(start_m=(x, 0.0, 0.0)))
    return Sight((thing,), _straight(speed))


def _parked(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """Cars parked on both sides, 0.8 to 2 m beside our own sides."""
    cars: list[SceneObject] = []
    x = uniform(rng, 8.0, 20.0)
    while x < 12 + speed * _LASTS_S:
        side = one_of(rng, -1.0, 1.0)
        y = side * (vehicle.width_m / 2 + uniform(rng, 0.8, 2.0) + 0.88)
        cars.append(_thing(f"parked car {len(cars)}", "car", x, y, one_of(rng, 0.0, 180.0), uniform(rng, 0.3, 1.5)))
        x += uniform(rng, 4.8, 12.0)
    return Sight(tuple(cars), _straight(speed))


def _bend(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """A bend with posts or a rail outside of it, 2.5 to 4 m beside the middle of our way."""
    side, begins_s = one_of(rng, -1.0, 1.0), uniform(rng, 1.0, 2.5)
    # no sharper than what 3 m/s2 to the side allow
    radius = max(uniform(rng, 25.0, 120.0), speed**2 / 3.0)
    yaw = side * speed / radius
    aside = uniform(rng, 2.5, 4.0)
    boxes, posts, way = [], [], 0.0
    straight_m = speed * begins_s
    while way < speed * _LASTS_S + 25:
        x, y, heading = _on_bend(way, straight_m, radius, side)
        x, y = x + side * aside * math.sin(heading), y - side * aside * math.cos(heading)
        length_m = 4.2 * (1 + aside / radius)
        boxes.append(
            Box(
                center_m=(x, y, 0.6),
                size_m=(length_m, 0.06, 0.31),
                yaw_deg=math.degrees(heading),
                reflectivity=0.5,
            )
        )
        posts.append(Cylinder(base_m=(x, y, 0.0), radius_m=0.05, height_m=0.75, reflectivity=0.4))
        way += 4.0
    rail = SceneObject(name="rail", boxes=tuple(boxes), cylinders=tuple(posts))
    phases = (EgoPhase(duration_s=begins_s), EgoPhase(duration_s=_LASTS_S, yaw_rate_radps=yaw))
    return Sight((rail,), EgoMotion(speed_mps=speed, phases=phases))


def _on_bend(way: float, straight_m: float, radius: float, side: float) -> tuple[float, float, float]:
    """Return place and heading after so much of a way that is straight first and then an arc to `side`."""
    if way <= straight_m:
        return way, 0.0, 0.0
    turn = (way - straight_m) / radius
    return straight_m + radius * math.sin(turn), side * radius * (1 - math.cos(turn)), side * turn


def _rain(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """Rain of up to 60 mm an hour, with poles beside the road."""
    weather = Weather(rain_mm_per_h=uniform(rng, 2.0, 60.0))
    return Sight(_poles(rng, speed, vehicle), _straight(speed), weather)


def _poles(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> tuple[SceneObject, ...]:
    place = vehicle.width_m / 2 + uniform(rng, 1.0, 2.5)
    return tuple(
        _thing(f"pole {k}", "pole", 15.0 + 20.0 * k, place * (1 if k % 2 else -1)) for k in range(2 + int(speed / 3))
    )


def _dust(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """A few clouds of dust that drift across the road, in which one still sees through."""
    clouds = tuple(
        Cloud(
            position_m=(uniform(rng, 8.0, 8.0 + speed * 6), uniform(rng, -2.0, 2.0), uniform(rng, 0.5, 1.5)),
            velocity_mps=(uniform(rng, -1.0, 1.0), uniform(rng, -1.0, 1.0), 0.0),
            radius_m=uniform(rng, 0.5, 1.2),
            grains=int(rng.integers(3000, 15000)),
        )
        for _ in range(int(rng.integers(1, 4)))
    )
    return Sight(_poles(rng, speed, vehicle), _straight(speed), Weather(clouds=clouds))


def _leaves(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """Leaves that the wind blows across the road."""
    wind = uniform(rng, 0.5, 3.0) * one_of(rng, -1.0, 1.0)
    leaves = []
    for k in range(int(rng.integers(8, 30))):
        size = uniform(rng, 0.05, 0.15)
        start = (uniform(rng, 4.0, 10.0 + speed * _LASTS_S), uniform(rng, -8.0, 8.0), uniform(rng, 0.05, 2.0))
        blown = (uniform(rng, -1.0, 1.0), wind + uniform(rng, -0.5, 0.5), uniform(rng, -0.2, 0.1))
        leaf = Box(center_m=(0.0, 0.0, 0.0), size_m=(0.01, size, round(0.8 * size, 4)), reflectivity=0.5)
        path = Path(start_m=start, velocity_mps=blown)
        leaves.append(SceneObject(name=f"leaf {k}", boxes=(leaf,), heading_deg=uniform(rng, 0, 90), path=path))
    return Sight(tuple(leaves), _straight(speed))


def _ahead(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """A car ahead at our own speed, half a second to a second and a half away."""
    scale = vehicle.width_m / 1.8
    gap_m = speed * uniform(rng, 0.7, 1.6) + (2.0 if scale > 0.9 else 0.3)
    path = Path(start_m=(round(gap_m + 2.15 * scale, 3), uniform(rng, -0.2, 0.2) * scale, 0.0))
    path = Path(start_m=path.start_m, velocity_mps=(speed, 0.0, 0.0))
    thing = SceneObject(
        name="car ahead", body="car", scale=scale, reflectivity_factor=uniform(rng, 0.5, 1.5), path=path
    )
    return Sight((thing,), _straight(speed))


def _reflector(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """A retro-reflector in the way beyond the unambiguous range of 8.8 m, which we do not reach."""
    far_m = 9.0 + speed * _LASTS_S + uniform(rng, 0.0, 4.0)
    plate = Box(
        center_m=(0.05, 0.0, uniform(rng, 0.1, 0.5)),
        size_m=(0.05, uniform(rng, 0.05, 0.4), uniform(rng, 0.05, 0.4)),
        reflectivity=uniform(rng, 2.0, 60.0),
    )
    thing = SceneObject(name="reflector", boxes=(plate,), path=Path(start_m=(round(far_m, 3), 0.0, 0.0)))
    return Sight((thing,), _straight(speed))


def _beside(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """Boxes beside the way of the scaled car, 0.25 to 0.8 m beside its sides, and a gate above it."""
    boxes: list[SceneObject] = []
    x = uniform(rng, 2.0, 4.0)
    while x < 4 + speed * _LASTS_S:
        width, height = uniform(rng, 0.2, 0.5), uniform(rng, 0.2, 0.6)
        y = one_of(rng, -1.0, 1.0) * (vehicle.width_m / 2 + uniform(rng, 0.25, 0.8) + width / 2)
        box = Box(center_m=(0.0, 0.0, height / 2), size_m=(0.3, width, height), reflectivity=uniform(rng, 0.1, 0.9))
        boxes.append(SceneObject(name=f"box {len(boxes)}", boxes=(box,), path=Path(start_m=(x, y, 0.0))))
        x += uniform(rng, 0.8, 3.0)
    return Sight(tuple(boxes), _straight(speed))


def _gate(rng: np.random.Generator, speed: float, vehicle: Vehicle) -> Sight:
    """A gate above the way of the scaled car, no lower than 0.75 m."""
    low_m = uniform(rng, 0.75, 1.2)
    beam = Box(center_m=(0.0, 0.0, low_m + 0.1), size_m=(0.2, 2.0, 0.2), reflectivity=uniform(rng, 0.3, 0.9))
    posts = [Box(center_m=(0.0, y, low_m / 2), size_m=(0.1, 0.1, low_m), reflectivity=0.5) for y in (-0.9, 0.9)]
    x = 4.0 + speed * uniform(rng, 1.0, 3.0)
    return Sight((SceneObject(name="gate", boxes=(beam, *posts), path=Path(start_m=(x, 0.0, 0.0))),), _straight(speed))


Sights = Mapping[str, Callable[[np.random.Generator, float, Vehicle], Sight]]
ROAD: Sights = {
    "bridge": _bridge,
    "parked cars": _parked,
    "bend": _bend,
    "rain": _rain,
    "leaves": _leaves,
    "dust": _dust,
    "car ahead": _ahead,
}
"""What the passenger car drives past, by name: (rng, speed, vehicle) -> Sight."""
FLOOR: Sights = {
    "boxes beside": _beside,
    "gate": _gate,
    "car ahead": _ahead,
    "reflector": _reflector,
    "leaves": _leaves,
}
"""What the scaled car drives past."""
