"""Where the shapes of a scene are at one moment, seen from the own vehicle: rows of numbers for the rays to meet."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.scene.bodies import BODIES, shapes_of
from rangecam.scene.paths import Pose, direction_rad, place, place_and_velocity, stands, travelled_m
from rangecam.scene.shapes import Box, Cylinder, Rod, SceneObject, Swing
from rangecam.types import Floats, Ints

BOX, CYLINDER, ROD, PLANE = 0.0, 1.0, 2.0, 3.0
"""Kinds of shapes, the first column of their rows."""
GROUND = -1
"""Object number of the ground; 0 is nothing, 1..N are the objects of the scenario."""
_GROUND_HALF_M = 1000.0


def placed(
    objects: tuple[SceneObject, ...], time_s: float, own: Pose, origin_m: Floats, ground_reflectivity: float | None
) -> tuple[Floats, Floats]:
    """Return the shapes (S, 12) of all objects in axes of the vehicle around `origin_m` (3,), and a ball around each.

    Columns of a shape: kind; centre x, y, z; of a box and a cylinder cosine and sine of the yaw, half sizes x, y, z
    (radius, radius, half height; the ground is a plane that reaches so far), of a rod its direction x, y, z, half its
    length, radius; reflectivity; object number; squared radius of the ball around it.
    Columns of the balls (N or N + 1, 6): centre x, y, z; squared radius; first shape, last shape + 1. An object without
    shapes has a ball of radius zero and no shapes.
    """
    template, starts, still, moving = _known(objects, ground_reflectivity)
    now = still.copy() if moving else still
    for i, thing, swings in moving:
        now[i] = _now(thing, time_s, swings)
    shapes, balls = np.empty((len(template), 12)), np.empty((len(starts) - 1, 6))
    at = float(own.x_m), float(own.y_m), float(own.heading_rad)
    _place(template, starts, now, at, origin_m, shapes, balls)
    return shapes, balls


@lru_cache(maxsize=64)
def _known(
    objects: tuple[SceneObject, ...], ground_reflectivity: float | None
) -> tuple[Floats, Ints, Floats, list[tuple[int, SceneObject, bool]]]:
    """Return `_templates`, what `_now` says of those that stay where they are (N or N + 1, 6), and who does not.

    Of these also whether they swing their limbs.
    """
    template, starts = _templates(objects, ground_reflectivity)
    rows, moving = np.zeros((len(starts) - 1, 6)), []
    for i, thing in enumerate(objects):
        if stands(thing.path):
            rows[i] = _now(thing, 0.0, _swings(thing))
        else:
            moving.append((i, thing, _swings(thing)))
    return template, starts, rows, moving


def _now(thing: SceneObject, time_s: float, swings: bool) -> tuple[float, float, float, float, float, float]:
    """Return x, y, z, heading, phase of the stride and how far it swings, 0..1."""
    heading = math.radians(thing.heading_deg)
    if not (swings or thing.follow_path):
        return *place(thing.path, time_s), heading, 0.0, 0.0
    (x, y, z), velocity_mps = place_and_velocity(thing.path, time_s)
    if thing.follow_path:
        heading += direction_rad(thing.path, time_s)
    if not swings:
        return x, y, z, heading, 0.0, 0.0
    body = BODIES[thing.body]
    phase = 2 * math.pi * travelled_m(thing.path, time_s) / (body.stride_m * thing.scale)
    speed, full = math.hypot(*velocity_mps), body.full_speed_mps
    return x, y, z, heading, phase, min(speed / full, 1.0) if full else 1.0


def _swings(thing: SceneObject) -> bool:
    rods = [shape for shape in shapes_of(thing) if isinstance(shape, Rod)]
    return any(swing != Swing() for rod in rods for swing in (rod.start_swing, rod.end_swing))


def _templates(objects: tuple[SceneObject, ...], ground_reflectivity: float | None) -> tuple[Floats, Ints]:
    """Return the shapes in axes of their objects (S, 18), and where those of each object start (N + 1,).

    Columns: kind; centre or start; half sizes or end; yaw or radius; reflectivity; object number; along, up, phase and
    lead of the swing of the start and of that of the end.
    """
    rows = [[_row(shape, thing, number) for shape in shapes_of(thing)] for number, thing in enumerate(objects, start=1)]
    if ground_reflectivity is not None:
        half = _GROUND_HALF_M
        rows.append([[PLANE, 0.0, 0.0, 0.0, half, half, 0.0, 0.0, ground_reflectivity, GROUND, *[0.0] * 8]])
    starts = np.cumsum([0, *(len(of_one) for of_one in rows)])
    return np.array([row for of_one in rows for row in of_one], float).reshape(-1, 18), starts


def _row(shape: Box | Cylinder | Rod, thing: SceneObject, number: int) -> list[float]:
    k, still = thing.scale, [0.0] * 8
    last = [shape.reflectivity * thing.reflectivity_factor, float(number)]
    if isinstance(shape, Box):
        centre, half = [k * v for v in shape.center_m], [k * v / 2 for v in shape.size_m]
        return [BOX, *centre, *half, math.radians(shape.yaw_deg), *last, *still]
    if isinstance(shape, Cylinder):
        x, y, z = shape.base_m
        centre = [k * x, k * y, k * (z + shape.height_m / 2)]
        return [CYLINDER, *centre, k * shape.radius_m, k * shape.radius_m, k * shape.height_m / 2, 0.0, *last, *still]
    ends = [k * v for v in (*shape.start_m, *shape.end_m)]
    return [ROD, *ends, k * shape.radius_m, *last, *_swing(shape.start_swing, k), *_swing(shape.end_swing, k)]


def _swing(swing: Swing, scale: float) -> list[float]:
    return [
        scale * swing.along_m,
        scale * swing.up_m,
        math.radians(swing.phase_deg),
        math.radians(swing.phase_deg + swing.up_lead_deg),
    ]


@njit(cache=True, nogil=True)
def _place(template: Any, starts: Any, now: Any, own: Any, origin: Any, shapes: Any, balls: Any) -> None:
    """Turn and move the shapes of each object to where it is, relative to the vehicle, and put a ball around them."""
    cos_own, sin_own = math.cos(own[2]), math.sin(own[2])
    for i in range(len(balls)):
        east, north = now[i, 0] - own[0], now[i, 1] - own[1]
        x = cos_own * east + sin_own * north - origin[0]
        y = cos_own * north - sin_own * east - origin[1]
        z, turn = now[i, 2] - origin[2], now[i, 3] - own[2]
        if starts[i] < starts[i + 1] and template[starts[i], 0] == PLANE:
            x, y, turn = -origin[0], -origin[1], 0.0  # the ground is under us wherever we are
        c, s = math.cos(turn), math.sin(turn)
        for k in range(starts[i], starts[i + 1]):
            of, to = template[k], shapes[k]
            to[0], to[9], to[10] = of[0], of[8], of[9]
            if of[0] == ROD:
                _place_rod(of, now[i, 4], now[i, 5], to)
                to[4], to[5] = c * to[4] - s * to[5], s * to[4] + c * to[5]
                to[11] = (to[7] + to[8]) ** 2
            else:
                to[1], to[2], to[3] = of[1], of[2], of[3]
                to[4], to[5] = math.cos(turn + of[7]), math.sin(turn + of[7])
                to[6], to[7], to[8] = of[4], of[5], of[6]
                to[11] = of[4] ** 2 + of[6] ** 2 + (0.0 if of[0] == CYLINDER else of[5] ** 2)
            to[1], to[2], to[3] = x + c * to[1] - s * to[2], y + s * to[1] + c * to[2], z + to[3]
        _ball(shapes, starts[i], starts[i + 1], balls[i])


@njit(cache=True, nogil=True)
def _place_rod(of: Any, phase: float, share: float, to: Any) -> None:
    """Fill centre, direction, half length and radius of a rod in axes of its object."""
    a0, a1 = of[10] * share * math.sin(phase + of[12]), of[14] * share * math.sin(phase + of[16])
    u0, u1 = of[11] * share * math.sin(phase + of[13]), of[15] * share * math.sin(phase + of[17])
    dx, dy, dz = (of[4] + a1) - (of[1] + a0), of[5] - of[2], (of[6] + u1) - (of[3] + u0)
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    to[1], to[2], to[3] = of[1] + a0 + dx / 2, of[2] + dy / 2, of[3] + u0 + dz / 2
    to[4], to[5], to[6] = 0.0, 0.0, 1.0
    if length > 0:
        to[4], to[5], to[6] = dx / length, dy / length, dz / length
    to[7], to[8] = length / 2, of[7]


@njit(cache=True, nogil=True)
def _ball(shapes: Any, first: int, last: int, ball: Any) -> None:
    """Put a ball around the balls of some shapes: around the middle of the box that holds them."""
    ball[:] = 0.0
    ball[4], ball[5] = first, last
    for axis in range(3):
        low, high = math.inf, -math.inf
        for k in range(first, last):
            radius = math.sqrt(shapes[k, 11])
            low, high = min(low, shapes[k, 1 + axis] - radius), max(high, shapes[k, 1 + axis] + radius)
        ball[axis] = (low + high) / 2 if last > first else 0.0
    for k in range(first, last):
        away2 = (shapes[k, 1] - ball[0]) ** 2 + (shapes[k, 2] - ball[1]) ** 2 + (shapes[k, 3] - ball[2]) ** 2
        ball[3] = max(ball[3], (math.sqrt(away2) + math.sqrt(shapes[k, 11])) ** 2)
