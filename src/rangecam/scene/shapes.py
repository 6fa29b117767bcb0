"""What things are made of: boxes, upright cylinders and rods that may swing; objects put them together."""

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
class Swing:
    """How the end of a rod goes with the phase p of a stride: along_m sin p forward, up_m sin(p + up_lead_deg) up."""

    along_m: float = 0.0
    """How far to and fro."""
    up_m: float = 0.0
    """How far up and down."""
    phase_deg: float = 0.0
    """Phase at the start of the way."""
    up_lead_deg: float = 90.0
    """How far up runs before along: 90 makes an ellipse that goes forward above and back below, 0 a slanted line."""


@settings
class Rod:
    """A round rod with round ends, in any direction: a limb, a tube; without length a ball."""

    start_m: Vector
    """Middle of the one end, from the object's own position."""
    end_m: Vector
    """Middle of the other end."""
    radius_m: Positive
    """Of the rod and the balls at its ends, which stick out by it."""
    reflectivity: NonNegative = 0.5
    """Lambertian reflectivity in the camera's band."""
    start_swing: Swing = Swing()
    """How the one end moves with the way that the object has gone."""
    end_swing: Swing = Swing()
    """How the other end does."""


@settings
class SceneObject:
    """One thing, of any number of shapes that move together and share its name."""

    name: str
    """What the truth calls it."""
    body: Literal[
        "shapes", "person", "bicycle", "buggy", "car", "truck", "pole", "tree", "wall", "guard_rail", "bridge", "box"
    ] = "shapes"
    """A body of `bodies.BODIES` to which the shapes below are added; shapes: those alone."""
    boxes: tuple[Box, ...] = ()
    """Its boxes."""
    cylinders: tuple[Cylinder, ...] = ()
    """Its cylinders."""
    rods: tuple[Rod, ...] = ()
    """Its rods."""
    scale: Positive = 1.0
    """Multiplies all its sizes: a child is a person of 0.6 to 0.8."""
    heading_deg: float = 0.0
    """Direction of its own x axis on the ground, to the left of forward; 180 faces us."""
    follow_path: bool = False
    """It turns with its path: `heading_deg` then counts from the direction in which it moves or last moved."""
    reflectivity_factor: Positive = 1.0
    """Multiplies the reflectivity of all its shapes."""
    path: Path = Path()
    """Where its own position is, over time."""
