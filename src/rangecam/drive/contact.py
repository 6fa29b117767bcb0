"""How near the vehicle is to things: distances on the ground between its outline and theirs, exact."""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.scene.paths import Pose, motion
from rangecam.scene.placed import BOX, CYLINDER, ROD, placed
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import SceneObject
from rangecam.vehicle.settings import Vehicle


class Nearest(NamedTuple):
    """The thing whose outline on the ground is nearest to that of the vehicle."""

    gap_m: float
    """Distance of the outlines, 0 where they touch or overlap; inf without anything."""
    number: int
    """i + 1 of the scenario's objects, 0 for none."""


_ORIGIN = np.zeros(3)


def nearest(scenario: Scenario, time_s: float, pose: Pose, vehicle: Vehicle, harmless: tuple[str, ...] = ()) -> Nearest:
    """Return what is nearest to the vehicle, of all that is neither below its clearance nor above its height.

    harmless: things whose names begin so do not count.
    """
    shapes, _ = placed(scenario.objects, time_s, pose, _ORIGIN, None)
    if harmless:
        shapes = shapes[_counts(scenario.objects, harmless)[shapes[:, 10].astype(int) - 1]]
    if not len(shapes):
        return Nearest(math.inf, 0)
    rear_m = vehicle.front_m - vehicle.length_m
    outline = (rear_m, vehicle.front_m, vehicle.width_m / 2, vehicle.clearance_m, vehicle.height_m)
    gap_m, number = _nearest(shapes, outline)
    return Nearest(gap_m, int(number))


@lru_cache(maxsize=64)
def _counts(objects: tuple[SceneObject, ...], harmless: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return of each object whether driving into it counts."""
    return np.array([not thing.name.startswith(harmless) for thing in objects], bool)


def impact_speed(scenario: Scenario, time_s: float, pose: Pose, number: int) -> float:
    """Return how fast the vehicle drives into object `number`, along its own heading; 0 if it stands."""
    if pose.speed_mps <= 0:
        return 0.0
    velocity = motion(scenario.objects[number - 1].path, time_s).velocity_mps
    away = math.cos(pose.heading_rad) * velocity[0] + math.sin(pose.heading_rad) * velocity[1]
    return float(max(pose.speed_mps - away, 0.0))


@njit(cache=True, nogil=True)
def _nearest(shapes: Any, outline: Any) -> Any:
    rear, front, half_width, low, high = outline
    least, number = np.inf, 0.0
    points = np.empty((4, 2))
    for shape in shapes:
        count, radius = _outline(shape, low, high, points)
        if count == 0:
            continue
        gap = max(_gap(points, count, rear, front, half_width) - radius, 0.0)
        if gap < least:
            least, number = gap, shape[10]
    return least, number


@njit(cache=True, nogil=True)
def _outline(shape: Any, low: float, high: float, points: Any) -> Any:
    """Fill the corners of a shape's outline between two heights, to be widened by a radius; 0 corners: not there."""
    x, y, z = shape[1], shape[2], shape[3]
    if shape[0] == BOX or shape[0] == CYLINDER:
        if z + shape[8] <= low or z - shape[8] >= high:
            return 0, 0.0
        if shape[0] == CYLINDER:
            points[0, 0], points[0, 1] = x, y
            return 1, shape[6]
        c, s, a, b = shape[4], shape[5], shape[6], shape[7]
        for k in range(4):
            u, w = (a if k in (0, 3) else -a), (b if k < 2 else -b)
            points[k, 0], points[k, 1] = x + c * u - s * w, y + s * u + c * w
        return 4, 0.0
    if shape[0] == ROD:
        half, radius = shape[7], shape[8]
        first, last = -half, half  # the part of its axis that is between the heights, widened by its radius
        if abs(shape[6]) > 1e-9:
            t0, t1 = (low - radius - z) / shape[6], (high + radius - z) / shape[6]
            first, last = max(first, min(t0, t1)), min(last, max(t0, t1))
        elif z + radius <= low or z - radius >= high:
            return 0, 0.0
        if first > last:
            return 0, 0.0
        points[0, 0], points[0, 1] = x + first * shape[4], y + first * shape[5]
        points[1, 0], points[1, 1] = x + last * shape[4], y + last * shape[5]
        return 2, radius
    return 0, 0.0


@njit(cache=True, nogil=True)
def _gap(points: Any, count: int, rear: float, front: float, half: float) -> float:
    """Return the distance between a rectangle along the axes and a convex polygon, a line or a point."""
    least = np.inf
    for k in range(count):
        x, y = points[k, 0], points[k, 1]
        dx, dy = max(rear - x, 0.0, x - front), max(-half - y, 0.0, y - half)
        least = min(least, math.sqrt(dx * dx + dy * dy))
    edges = count if count > 2 else count - 1
    inside = count > 2
    for k in range(edges):
        a, b = points[k], points[(k + 1) % count]
        if _crosses(a, b, rear, front, half):
            return 0.0
        for i in range(4):
            cx, cy = (rear if i % 2 == 0 else front), (half if i < 2 else -half)
            least = min(least, _to_line(cx, cy, a, b))
        # corners run counter-clockwise: the rectangle's middle is inside if it is left of every edge
        mx = (rear + front) / 2
        inside = inside and (b[0] - a[0]) * (0.0 - a[1]) - (b[1] - a[1]) * (mx - a[0]) >= 0
    return 0.0 if inside else least


@njit(cache=True, nogil=True)
def _to_line(x: float, y: float, a: Any, b: Any) -> float:
    ux, uy = b[0] - a[0], b[1] - a[1]
    square = ux * ux + uy * uy
    t = max(0.0, min(1.0, ((x - a[0]) * ux + (y - a[1]) * uy) / square)) if square > 0 else 0.0
    return math.hypot(x - a[0] - t * ux, y - a[1] - t * uy)


@njit(cache=True, nogil=True)
def _crosses(a: Any, b: Any, rear: float, front: float, half: float) -> bool:
    """Return whether the line from a to b has a point in the rectangle (Liang and Barsky 1984)."""
    first, last = 0.0, 1.0
    dx, dy = b[0] - a[0], b[1] - a[1]
    for p, q in ((-dx, a[0] - rear), (dx, front - a[0]), (-dy, a[1] + half), (dy, half - a[1])):
        if p == 0.0:
            if q < 0:
                return False
        elif p < 0:
            first = max(first, q / p)
        else:
            last = min(last, q / p)
    return first <= last
