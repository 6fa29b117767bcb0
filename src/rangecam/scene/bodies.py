"""Ready-made bodies: what stands and moves in traffic, around the point on the ground below it, heading along x.

Sizes are common ones, reflectivities ordinary ones at 850 to 905 nm. What a coarse camera cannot see is left out.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from rangecam.scene.paths import Vector
from rangecam.scene.shapes import Box, Cylinder, Rod, SceneObject, Swing

Shapes = tuple[Box | Cylinder | Rod, ...]


@dataclass(frozen=True)
class Body:
    """Shapes, and how their rods swing: once to and fro on each `stride_m`, fully from `full_speed_mps` on."""

    shapes: Shapes = ()
    stride_m: float = 1.4
    full_speed_mps: float = 0.0


def _both(left: Rod) -> tuple[Rod, Rod]:
    """Return a limb of the left and its like of the right, half a stride later."""

    def there(point_m: Vector) -> Vector:
        return point_m[0], -point_m[1], point_m[2]

    def later(swing: Swing) -> Swing:
        return Swing(
            along_m=swing.along_m, up_m=swing.up_m, phase_deg=swing.phase_deg + 180, up_lead_deg=swing.up_lead_deg
        )

    right = Rod(
        start_m=there(left.start_m),
        end_m=there(left.end_m),
        radius_m=left.radius_m,
        reflectivity=left.reflectivity,
        start_swing=later(left.start_swing),
        end_swing=later(left.end_swing),
    )
    return left, right


def _tube(start_m: Vector, end_m: Vector, radius_m: float, reflectivity: float = 0.4) -> Rod:
    return Rod(start_m=start_m, end_m=end_m, radius_m=radius_m, reflectivity=reflectivity)


def _trunk(hip_m: Vector, shoulder_m: Vector) -> tuple[Rod, ...]:
    """Return two rods side by side: a trunk is wider than deep."""
    return _both(Rod(start_m=hip_m, end_m=shoulder_m, radius_m=0.115, reflectivity=0.5))


_FOOT, _KNEE = Swing(along_m=0.30, up_m=0.03), Swing(along_m=0.17, up_m=0.02, phase_deg=35.0)
_ELBOW, _HAND = Swing(along_m=0.10, phase_deg=180.0), Swing(along_m=0.25, phase_deg=180.0)

PERSON: tuple[Rod, ...] = (
    *_trunk((0.0, 0.07, 0.94), (0.0, 0.08, 1.40)),
    _tube((0.01, 0.0, 1.60), (0.01, 0.0, 1.645), 0.105, 0.5),
    *_both(
        Rod(start_m=(0.0, 0.09, 0.88), end_m=(0.02, 0.09, 0.49), radius_m=0.075, reflectivity=0.35, end_swing=_KNEE)
    ),
    *_both(
        Rod(
            start_m=(0.02, 0.09, 0.49),
            end_m=(0.0, 0.09, 0.11),
            radius_m=0.055,
            reflectivity=0.35,
            start_swing=_KNEE,
            end_swing=_FOOT,
        )
    ),
    *_both(
        Rod(
            start_m=(-0.02, 0.09, 0.07),
            end_m=(0.15, 0.09, 0.07),
            radius_m=0.04,
            reflectivity=0.2,
            start_swing=_FOOT,
            end_swing=_FOOT,
        )
    ),
    *_both(Rod(start_m=(0.0, 0.19, 1.40), end_m=(-0.02, 0.195, 1.12), radius_m=0.045, end_swing=_ELBOW)),
    *_both(
        Rod(
            start_m=(-0.02, 0.195, 1.12),
            end_m=(0.04, 0.195, 0.86),
            radius_m=0.04,
            start_swing=_ELBOW,
            end_swing=_HAND,
        )
    ),
)
"""An adult of 1.75 m, upright: trunk, head, legs of thigh, shank and foot, arms."""


def _wheel(x_m: float, radius_m: float, pieces: int) -> tuple[Rod, ...]:
    """Return the tyre of a bicycle's wheel; between its spokes one looks through it."""
    places = [
        (x_m + radius_m * math.cos(angle), 0.0, radius_m + 0.02 + radius_m * math.sin(angle))
        for angle in (2 * math.pi * k / pieces for k in range(pieces + 1))
    ]
    return tuple(_tube(a, b, 0.022, 0.1) for a, b in pairwise(places))


_PEDAL = Swing(along_m=0.17, up_m=0.17)
# the knee between a thigh of 0.42 m and a shank of 0.45 m, by their lengths at the highest and lowest pedal
_PEDALLING_KNEE = Swing(along_m=0.163, up_m=0.125, phase_deg=90.0, up_lead_deg=0.0)

BICYCLE: tuple[Rod, ...] = (
    *_wheel(0.525, 0.33, 8),
    *_wheel(-0.525, 0.33, 8),
    _tube((-0.08, 0.0, 0.28), (-0.20, 0.0, 0.92), 0.018),
    _tube((-0.08, 0.0, 0.28), (0.42, 0.0, 0.85), 0.02),
    _tube((-0.17, 0.0, 0.82), (0.41, 0.0, 0.88), 0.018),
    _tube((0.40, 0.0, 0.98), (0.525, 0.0, 0.35), 0.018),
    _tube((-0.08, 0.0, 0.28), (-0.525, 0.0, 0.35), 0.015),
    _tube((-0.17, 0.0, 0.82), (-0.525, 0.0, 0.35), 0.015),
    _tube((0.40, -0.25, 1.0), (0.40, 0.25, 1.0), 0.018),
    *_trunk((-0.2, 0.07, 1.0), (0.07, 0.08, 1.42)),
    _tube((0.15, 0.0, 1.62), (0.16, 0.0, 1.66), 0.105, 0.5),
    *_both(Rod(start_m=(0.07, 0.18, 1.40), end_m=(0.40, 0.23, 1.03), radius_m=0.042)),
    *_both(
        Rod(
            start_m=(-0.2, 0.09, 0.98),
            end_m=(0.022, 0.1, 0.69),
            radius_m=0.075,
            reflectivity=0.35,
            end_swing=_PEDALLING_KNEE,
        )
    ),
    *_both(
        Rod(
            start_m=(0.022, 0.1, 0.69),
            end_m=(-0.08, 0.12, 0.30),
            radius_m=0.05,
            reflectivity=0.35,
            start_swing=_PEDALLING_KNEE,
            end_swing=_PEDAL,
        )
    ),
)
"""A cyclist of 1.75 m on a bicycle of 1.8 m: tyres, frame, handle-bar; trunk, head, arms and pedalling legs."""

BUGGY: Shapes = (
    Box(center_m=(0.0, 0.0, 0.58), size_m=(0.75, 0.40, 0.28), reflectivity=0.4),
    Box(center_m=(-0.2, 0.0, 0.85), size_m=(0.35, 0.40, 0.28), reflectivity=0.4),
    *(
        Box(center_m=(x, y, 0.11), size_m=(0.22, 0.05, 0.22), reflectivity=0.1)
        for x in (-0.35, 0.35)
        for y in (-0.25, 0.25)
    ),
    _tube((-0.35, 0.22, 0.15), (0.2, 0.2, 0.5), 0.015),
    _tube((-0.35, -0.22, 0.15), (0.2, -0.2, 0.5), 0.015),
    _tube((0.35, 0.22, 0.15), (-0.65, 0.22, 1.02), 0.015),
    _tube((0.35, -0.22, 0.15), (-0.65, -0.22, 1.02), 0.015),
    _tube((-0.65, -0.22, 1.02), (-0.65, 0.22, 1.02), 0.015),
)
"""A baby buggy whose handle is 0.65 m behind its middle; who pushes it is an object of its own."""

CAR: tuple[Box, ...] = (
    Box(center_m=(0.0, 0.0, 0.55), size_m=(4.3, 1.76, 0.60), reflectivity=0.4),
    Box(center_m=(-0.2, 0.0, 1.13), size_m=(2.3, 1.50, 0.56), reflectivity=0.15),
    Box(center_m=(1.3, 0.0, 0.15), size_m=(0.62, 1.70, 0.30), reflectivity=0.08),
    Box(center_m=(-1.3, 0.0, 0.15), size_m=(0.62, 1.70, 0.30), reflectivity=0.08),
)
"""A compact car around the middle of its wheelbase: body, cabin (mostly glass), axles with wheels."""

TRUCK: tuple[Box, ...] = (
    Box(center_m=(3.4, 0.0, 1.75), size_m=(2.1, 2.4, 2.5), reflectivity=0.4),
    Box(center_m=(-1.2, 0.0, 2.35), size_m=(6.6, 2.5, 2.7), reflectivity=0.6),
    Box(center_m=(0.0, 0.0, 0.80), size_m=(8.8, 1.0, 0.30), reflectivity=0.15),
    *(Box(center_m=(x, 0.0, 0.48), size_m=(0.9, 2.3, 0.96), reflectivity=0.08) for x in (3.2, -2.2, -3.4)),
)
"""A truck with a box body, 8.9 m long, 2.5 m wide and 3.7 m high, around its middle."""

TREE: Shapes = (
    Cylinder(base_m=(0.0, 0.0, 0.0), radius_m=0.16, height_m=3.0, reflectivity=0.3),
    _tube((0.0, 0.0, 3.3), (0.0, 0.0, 4.3), 1.3, 0.5),
)
"""A street tree: a trunk of 0.32 m, a crown from 2 to 5.6 m."""

POLE: Shapes = (Cylinder(base_m=(0.0, 0.0, 0.0), radius_m=0.06, height_m=3.0, reflectivity=0.4),)
"""The post of a sign or a lamp: 0.12 m thick, 3 m high."""

WALL: Shapes = (Box(center_m=(0.0, 0.0, 1.25), size_m=(10.0, 0.25, 2.5), reflectivity=0.5),)
"""A wall along its own x axis, 10 m long and 2.5 m high."""

GUARD_RAIL: Shapes = (
    Box(center_m=(0.0, 0.0, 0.6), size_m=(4.0, 0.06, 0.31), reflectivity=0.5),
    Box(center_m=(-1.0, -0.08, 0.37), size_m=(0.06, 0.1, 0.74), reflectivity=0.5),
    Box(center_m=(1.0, -0.08, 0.37), size_m=(0.06, 0.1, 0.74), reflectivity=0.5),
)
"""Four metres of guard rail along its own x axis, on two posts to the right of it."""

BRIDGE: Shapes = (
    Box(center_m=(0.0, 0.0, 5.1), size_m=(8.0, 24.0, 1.2), reflectivity=0.4),
    Box(center_m=(0.0, 7.0, 2.25), size_m=(6.0, 1.0, 4.5), reflectivity=0.4),
    Box(center_m=(0.0, -7.0, 2.25), size_m=(6.0, 1.0, 4.5), reflectivity=0.4),
)
"""A bridge over a road along x: 4.5 m above it, on walls 6.5 m beside its middle."""

BOX: Shapes = (Box(center_m=(0.0, 0.0, 0.25), size_m=(0.4, 0.6, 0.5), reflectivity=0.6),)
"""A cardboard box, 0.6 m wide and 0.5 m high."""

BODIES: dict[str, Body] = {
    "shapes": Body(),
    "person": Body(PERSON, stride_m=1.4, full_speed_mps=0.7),
    "bicycle": Body(BICYCLE, stride_m=5.0),
    "buggy": Body(BUGGY),
    "car": Body(CAR),
    "truck": Body(TRUCK),
    "pole": Body(POLE),
    "tree": Body(TREE),
    "wall": Body(WALL),
    "guard_rail": Body(GUARD_RAIL),
    "bridge": Body(BRIDGE),
    "box": Body(BOX),
}
"""Bodies by name."""


def shapes_of(thing: SceneObject) -> Shapes:
    """Return all shapes of an object, its body's first, unscaled."""
    return (*BODIES[thing.body].shapes, *thing.boxes, *thing.cylinders, *thing.rods)
