"""What things are made of: oriented boxes and upright cylinders, alone or put together to bodies."""

from typing import Literal

from rangecam.scene.paths import Path, Vector
from rangecam.settings import NonNegative, Positive, settings


@settings
class Box:
    """A cuboid; a thin one is a plate, a wall or a piece of floor."""

    center_m: Vector
    """Its centre, from the object's own position: x forward, y left, z up."""
    size_m: tuple[Positive, Positive, Positive]
    """Whole length along x, y, z."""
    yaw_deg: float = 0.0
    """Turned about the upright axis, to the left."""
    reflectivity: NonNegative = 0.5
    """Lambertian reflectivity in the camera's band; retro-reflectors have more than 1."""


@settings
class Cylinder:
    """An upright circular cylinder with flat ends."""

    base_m: Vector
    """Centre of its lower end, from the object's own position."""
    radius_m: Positive
    """Radius."""
    height_m: Positive
    """Length along z."""
    reflectivity: NonNegative = 0.5
    """Lambertian reflectivity in the camera's band."""


@settings
class SceneObject:
    """One thing, of any number of shapes that move together and share its name."""

    name: str
    """What the truth calls it."""
    body: Literal["shapes", "person", "car"] = "shapes"
    """A body from `BODIES` to which `boxes` and `cylinders` are added; shapes: those alone."""
    boxes: tuple[Box, ...] = ()
    """Its boxes."""
    cylinders: tuple[Cylinder, ...] = ()
    """Its cylinders."""
    heading_deg: float = 0.0
    """Direction of its own x axis on the ground, to the left of forward; 180 faces us."""
    reflectivity_factor: Positive = 1.0
    """Multiplies the reflectivity of all its shapes."""
    path: Path = Path()
    """Where its own position is, over time."""


PERSON: tuple[Cylinder, ...] = (
    Cylinder(base_m=(0.0, 0.11, 0.0), radius_m=0.085, height_m=0.85, reflectivity=0.35),
    Cylinder(base_m=(0.0, -0.11, 0.0), radius_m=0.085, height_m=0.85, reflectivity=0.35),
    Cylinder(base_m=(0.0, 0.0, 0.85), radius_m=0.20, height_m=0.62, reflectivity=0.5),
    Cylinder(base_m=(0.0, 0.0, 1.47), radius_m=0.10, height_m=0.28, reflectivity=0.5),
)
"""A standing adult of 1.75 m: legs, trunk with arms, head; clothes of ordinary reflectivity at 850-905 nm."""

CAR: tuple[Box, ...] = (
    Box(center_m=(0.0, 0.0, 0.55), size_m=(4.3, 1.76, 0.60), reflectivity=0.4),
    Box(center_m=(-0.2, 0.0, 1.13), size_m=(2.3, 1.50, 0.56), reflectivity=0.15),
    Box(center_m=(1.3, 0.0, 0.15), size_m=(0.62, 1.70, 0.30), reflectivity=0.08),
    Box(center_m=(-1.3, 0.0, 0.15), size_m=(0.62, 1.70, 0.30), reflectivity=0.08),
)
"""A compact car around the middle of its wheelbase: body, cabin (mostly glass), axles with wheels."""

BODIES: dict[str, tuple[tuple[Box, ...], tuple[Cylinder, ...]]] = {
    "shapes": ((), ()),
    "person": ((), PERSON),
    "car": (CAR, ()),
}
"""Ready-made bodies: (boxes, cylinders) around the point on the ground below them, heading along x."""


def shapes_of(thing: SceneObject) -> tuple[tuple[Box, ...], tuple[Cylinder, ...]]:
    """Return all boxes and all cylinders of an object, its body's first."""
    boxes, cylinders = BODIES[thing.body]
    return boxes + thing.boxes, cylinders + thing.cylinders
