"""What a camera sees of a scene: rays cast against shapes, for the simulated cameras and for the truth."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.geometry import Lens, Mounting, position, rays, rotation
from rangecam.scene.paths import EgoMotion, Motion, ego_path, motion
from rangecam.scene.scenario import AMBIENT_WPM2, Scenario
from rangecam.scene.shapes import Box, Cylinder, SceneObject, shapes_of
from rangecam.scene.view import View
from rangecam.types import Ego, Floats, Ints, Truth

GROUND = -1
"""Object number of the ground; 0 is nothing, 1..N are the objects of the scenario."""

_RUN = 32
_GROUND_HALF_M = 1000.0


@dataclass(frozen=True, eq=False)
class RayBundle:
    """Rays of a camera in vehicle axes.

    origin_m (3,): where they start. directions (3, K H W) float32: unit vectors, component by component.
    cones (C, 5): axis and cosine and sine of the half angle of the cone around each run of 32 rays. shape: (K, H, W).
    """

    origin_m: Floats
    directions: Floats
    cones: Floats
    shape: tuple[int, int, int]


@lru_cache(maxsize=8)
def ray_bundle(lens: Lens, mounting: Mounting, shape: tuple[int, int], subpixels: int = 1) -> RayBundle:
    """Return the rays of every pixel, `subpixels` times `subpixels` of them spread evenly over its area."""
    (height, width), n = shape, subpixels
    fine = rays(lens, (height * n, width * n)) @ rotation(mounting).T
    directions = fine.reshape(height, n, width, n, 3).transpose(4, 1, 3, 0, 2).reshape(3, -1)
    directions /= np.linalg.norm(directions, axis=0)
    starts = np.arange(0, directions.shape[1], _RUN)
    axes = np.add.reduceat(directions, starts, axis=1)
    axes /= np.linalg.norm(axes, axis=0)
    cos_half = np.minimum.reduceat(
        np.einsum("ij,ij->j", directions, np.repeat(axes, _RUN, axis=1)[:, : directions.shape[1]]), starts
    )
    cos_half = np.clip(cos_half - 1e-6, -1, 1)
    cones = np.concatenate([axes, cos_half[None], np.sqrt(1 - cos_half**2)[None]]).T
    return RayBundle(
        position(mounting), np.ascontiguousarray(directions, np.float32), np.ascontiguousarray(cones), (n * n, *shape)
    )


def render(scenario: Scenario, time_s: float, bundle: RayBundle) -> View:
    """Return what the rays meet at `time_s`, in vehicle axes of the driving vehicle (arrays float32)."""
    range_m, reflectivity, cos_incidence, _ = _cast_rays(scenario, time_s, bundle)
    ambient_wpm2 = scenario.ambient_wpm2 + AMBIENT_WPM2[scenario.ambient_light]
    return View(range_m, reflectivity, cos_incidence, ambient_wpm2)


def truth(scenario: Scenario, time_s: float, lens: Lens, mounting: Mounting, shape: tuple[int, int]) -> Truth:
    """Return what the central ray of each pixel meets, and where the objects are and how they move, relative to us.

    object_id is i + 1 for names[i], 0 for nothing, `GROUND` for the ground.
    """
    range_m, reflectivity, _, object_id = _cast_rays(scenario, time_s, ray_bundle(lens, mounting, shape))
    own = motion(ego_path(scenario.ego), time_s)
    motions = [motion(thing.path, time_s) for thing in scenario.objects]
    return Truth(
        range_m[0],
        reflectivity[0],
        object_id[0],
        tuple(thing.name for thing in scenario.objects),
        np.array([m.position_m - own.position_m for m in motions]).reshape(-1, 3),
        np.array([m.velocity_mps - own.velocity_mps for m in motions]).reshape(-1, 3),
    )


def ego_at(motion_of_ego: EgoMotion, time_s: float) -> Ego:
    """Return the state of the own vehicle at `time_s`."""
    speed = float(motion(ego_path(motion_of_ego), time_s).velocity_mps[0])
    return Ego(time_s=time_s, speed_mps=max(speed, 0.0))


def _cast_rays(scenario: Scenario, time_s: float, bundle: RayBundle) -> tuple[Floats, Floats, Floats, Ints]:
    """Return range, reflectivity, cosine of incidence and object number of every ray, each (K, H, W)."""
    shapes = _placed_shapes(scenario, time_s) - np.array([0.0, *bundle.origin_m, *[0.0] * 7])
    count = bundle.directions.shape[1]
    range_m, reflectivity, cos_incidence = (np.empty(count, np.float32) for _ in range(3))
    object_id = np.empty(count, np.int32)
    _cast(bundle.directions, bundle.cones, shapes, range_m, reflectivity, cos_incidence, object_id)
    return (
        range_m.reshape(bundle.shape),
        reflectivity.reshape(bundle.shape),
        cos_incidence.reshape(bundle.shape),
        object_id.reshape(bundle.shape),
    )


def _placed_shapes(scenario: Scenario, time_s: float) -> Floats:
    """Return all shapes in vehicle axes, one a row.

    Columns: round (1 for a cylinder), centre x, y, z, cosine and sine of the yaw, half sizes x, y, z (radius, radius,
    half height), reflectivity, object number.
    """
    own = motion(ego_path(scenario.ego), time_s)
    rows = []
    if scenario.ground_reflectivity is not None:
        half = _GROUND_HALF_M
        rows.append([0.0, 0.0, 0.0, -0.5, 1.0, 0.0, half, half, 0.5, scenario.ground_reflectivity, GROUND])
    for number, thing in enumerate(scenario.objects, start=1):
        rows += _placed(thing, number, motion(thing.path, time_s), own)
    return np.array(rows).reshape(-1, 11)


def _placed(thing: SceneObject, number: int, its: Motion, own: Motion) -> list[list[float]]:
    x, y, z = its.position_m - own.position_m
    turn = math.radians(thing.heading_deg)
    rows = []
    boxes, cylinders = shapes_of(thing)
    shapes: tuple[Box | Cylinder, ...] = (*boxes, *cylinders)
    for shape in shapes:
        yaw = turn
        if isinstance(shape, Box):
            yaw += math.radians(shape.yaw_deg)
        (cx, cy, cz), half = _center_and_half_size(shape)
        cx, cy = cx * math.cos(turn) - cy * math.sin(turn), cx * math.sin(turn) + cy * math.cos(turn)
        reflectivity = shape.reflectivity * thing.reflectivity_factor
        place = [x + cx, y + cy, z + cz, math.cos(yaw), math.sin(yaw)]
        rows.append([float(isinstance(shape, Cylinder)), *place, *half, reflectivity, float(number)])
    return rows


def _center_and_half_size(shape: Box | Cylinder) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    if isinstance(shape, Box):
        length, width, height = shape.size_m
        return shape.center_m, (length / 2, width / 2, height / 2)
    x, y, z = shape.base_m
    return (x, y, z + shape.height_m / 2), (shape.radius_m, shape.radius_m, shape.height_m / 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(
    directions: Any, cones: Any, shapes: Any, range_m: Any, reflectivity: Any, cos_incidence: Any, object_id: Any
) -> Any:
    """Keep the nearest hit of each ray; a run of rays skips shapes whose bounding sphere its cone does not touch."""
    x, y, z = directions[0], directions[1], directions[2]
    range_m[:] = np.inf
    reflectivity[:] = 0
    cos_incidence[:] = 0
    object_id[:] = 0
    for run in range(cones.shape[0]):
        rays_of_run = slice(run * _RUN, (run + 1) * _RUN)
        ray = (x[rays_of_run], y[rays_of_run], z[rays_of_run])
        hit = (range_m[rays_of_run], reflectivity[rays_of_run], cos_incidence[rays_of_run], object_id[rays_of_run])
        for shape in shapes:
            if not _may_touch(cones[run], shape):
                continue
            if shape[0] == 1:
                _cast_cylinder(ray, shape, *hit)
            else:
                _cast_box(ray, shape, *hit)


@njit(cache=True, nogil=True, error_model="numpy")
def _may_touch(cone: Any, shape: Any) -> Any:
    """Return whether the cone of rays from the origin can touch the bounding sphere of a shape."""
    radius2 = shape[6] ** 2 + shape[7] ** 2 + shape[8] ** 2
    distance2 = shape[1] ** 2 + shape[2] ** 2 + shape[3] ** 2
    if distance2 <= radius2 or cone[3] <= 0:
        return True
    sin2 = radius2 / distance2
    cos_seen, sin_seen = math.sqrt(1 - sin2), math.sqrt(sin2)
    cos_limit = cos_seen * cone[3] - sin_seen * cone[4]  # cosine of half angle of the cone plus that of the sphere
    along = cone[0] * shape[1] + cone[1] * shape[2] + cone[2] * shape[3]
    return along >= cos_limit * math.sqrt(distance2)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_box(ray: Any, shape: Any, range_m: Any, reflectivity: Any, cos_incidence: Any, object_id: Any) -> Any:
    """A ray is inside a box while it is between all three pairs of faces; the last one entered is the face it hits."""
    c, s = np.float32(shape[4]), np.float32(shape[5])
    ox = np.float32(-(shape[4] * shape[1] + shape[5] * shape[2]))
    oy = np.float32(-(shape[4] * shape[2] - shape[5] * shape[1]))
    oz = np.float32(-shape[3])
    hx, hy, hz = np.float32(shape[6]), np.float32(shape[7]), np.float32(shape[8])
    rho, number = np.float32(shape[9]), np.int32(shape[10])
    for i in range(range_m.size):
        known = (range_m[i], reflectivity[i], cos_incidence[i], object_id[i])  # read first: the loop has no branch then
        east, north, up = ray[0][i], ray[1][i], ray[2][i]
        dx, dy, dz = _not_zero(c * east + s * north), _not_zero(c * north - s * east), _not_zero(up)
        in_x, out_x = _between(ox, dx, hx)
        in_y, out_y = _between(oy, dy, hy)
        in_z, out_z = _between(oz, dz, hz)
        enter = in_x if in_x > in_y else in_y
        cosine = abs(dx) if in_x > in_y else abs(dy)
        cosine = abs(dz) if in_z > enter else cosine
        enter = in_z if in_z > enter else enter
        leave = out_x if out_x < out_y else out_y
        leave = out_z if out_z < leave else leave
        hit = (enter > 0) & (enter <= leave) & (enter < known[0])
        range_m[i] = enter if hit else known[0]
        reflectivity[i] = rho if hit else known[1]
        cos_incidence[i] = cosine if hit else known[2]
        object_id[i] = number if hit else known[3]


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_cylinder(ray: Any, shape: Any, range_m: Any, reflectivity: Any, cos_incidence: Any, object_id: Any) -> Any:
    """A ray is inside a cylinder while it is inside the circle and between the ends."""
    ox, oy, oz = np.float32(-shape[1]), np.float32(-shape[2]), np.float32(-shape[3])
    radius, half = np.float32(shape[6]), np.float32(shape[8])
    rho, number = np.float32(shape[9]), np.int32(shape[10])
    zero = np.float32(0)
    for i in range(range_m.size):
        known = (range_m[i], reflectivity[i], cos_incidence[i], object_id[i])  # read first: the loop has no branch then
        dx, dy, dz = ray[0][i], ray[1][i], _not_zero(ray[2][i])
        flat2 = _not_zero(dx * dx + dy * dy)
        along = ox * dx + oy * dy
        across = ox * dy - oy * dx
        square = flat2 * radius * radius - across * across
        root = np.sqrt(square if square > zero else zero)
        in_round, out_round = (-along - root) / flat2, (-along + root) / flat2
        in_z, out_z = _between(oz, dz, half)
        side = in_round > in_z
        enter = in_round if side else in_z
        leave = out_round if out_round < out_z else out_z
        # the normal of the side is the horizontal radius at the hit: cos = -(o + t d) . d / radius = root / radius
        cosine = root / radius if side else abs(dz)
        hit = (square > zero) & (enter > zero) & (enter <= leave) & (enter < known[0])
        range_m[i] = enter if hit else known[0]
        reflectivity[i] = rho if hit else known[1]
        cos_incidence[i] = cosine if hit else known[2]
        object_id[i] = number if hit else known[3]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _between(start: Any, direction: Any, half: Any) -> Any:
    """Return where a ray enters and leaves the slab from -half to half."""
    inverse = np.float32(1) / direction
    one, other = (-half - start) * inverse, (half - start) * inverse
    return (one if one < other else other), (other if one < other else one)


@njit(cache=True, nogil=True, inline="always")
def _not_zero(x: Any) -> Any:
    """Return x, or a tiny number in its place, so that 0 / 0 cannot happen for rays along a face."""
    return x if abs(x) > np.float32(1e-9) else np.float32(1e-9)
