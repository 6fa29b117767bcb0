"""What a camera sees of a scene: rays cast against shapes, for the simulated cameras and for the truth."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.geometry import Lens, Mounting, position, rays, rotation
from rangecam.scene.paths import EgoMotion, OwnMotion, Pose, ego_pose, motion
from rangecam.scene.placed import CYLINDER, GROUND, PLANE, ROD, placed
from rangecam.scene.scenario import AMBIENT_WPM2, Scenario
from rangecam.scene.view import View
from rangecam.types import Ego, Floats, Ints, Truth

__all__ = ["GROUND", "RayBundle", "ego_at", "ego_of", "own_pose", "ray_bundle", "render", "truth"]

_RUN = 256


@dataclass(frozen=True, eq=False)
class RayBundle:
    """Rays of a camera in vehicle axes, those of neighbouring pixels together: in runs of up to 256.

    origin_m (3,): where they start. directions (3, R) float32: unit vectors, component by component.
    place (R,) int32: where the result of each ray belongs, in an image of shape (K, H, W).
    cones (C, 5): axis and cosine and sine of the half angle of the cone around each run.
    runs (C, 3) int32: first and last + 1 of its rays, and how many of them at a time are neighbours in a row.
    """

    origin_m: Floats
    directions: Floats
    place: Ints
    cones: Floats
    runs: Ints
    shape: tuple[int, int, int]


@lru_cache(maxsize=8)
def ray_bundle(lens: Lens, mounting: Mounting, shape: tuple[int, int], subpixels: int = 1) -> RayBundle:
    """Return the rays of every pixel, `subpixels` times `subpixels` of them spread evenly over its area."""
    (height, width), n = shape, subpixels
    fine = rays(lens, (height * n, width * n)) @ rotation(mounting).T
    directions = fine.reshape(height, n, width, n, 3).transpose(4, 1, 3, 0, 2).reshape(3, -1)
    place, runs = _tile_by_tile(shape, n)
    directions = directions[:, place] / np.linalg.norm(directions[:, place], axis=0)
    starts = runs[:, 0]
    axes = np.add.reduceat(directions, starts, axis=1)
    axes /= np.linalg.norm(axes, axis=0)
    from_axis = np.einsum("ij,ij->j", directions, np.repeat(axes, runs[:, 1] - starts, axis=1))
    cos_half = np.clip(np.minimum.reduceat(from_axis, starts) - 1e-6, -1, 1)
    cones = np.concatenate([axes, cos_half[None], np.sqrt(1 - cos_half**2)[None]]).T
    return RayBundle(
        position(mounting),
        np.ascontiguousarray(directions, np.float32),
        place.astype(np.int32),
        np.ascontiguousarray(cones),
        runs.astype(np.int32),
        (n * n, *shape),
    )


def _tile_by_tile(shape: tuple[int, int], subpixels: int) -> tuple[Ints, Ints]:
    """Return the order of the rays (K, H, W), tile by tile of the image, and the runs of a `RayBundle`.

    The rays of a tile look in nearly the same direction; those of a row of it are neighbours in the image as well.
    """
    k, row, column = (index.ravel() for index in np.indices((subpixels**2, *shape)))
    pixels = max(_RUN // subpixels**2, 1)
    across = 2 ** math.ceil(math.log2(pixels) / 2)
    down = max(pixels // across, 1)
    order: Ints = np.lexsort((column, row, k, column // across, row // down))
    tile = (row // down * shape[1] + column // across)[order]
    starts = np.flatnonzero(np.diff(tile, prepend=-1))
    in_row = np.minimum(across, shape[1] - column[order[starts]])
    return order, np.stack([starts, [*starts[1:], len(order)], in_row], axis=1)


def own_pose(scenario: Scenario, time_s: float, own: OwnMotion | None = None) -> Pose:
    """Return where the own vehicle is: as `own` decides, or as the scenario says if that is none."""
    return ego_pose(scenario.ego, time_s) if own is None else own(time_s)


def render(scenario: Scenario, time_s: float, bundle: RayBundle, own: OwnMotion | None = None) -> View:
    """Return what the rays meet at `time_s`, in vehicle axes of the driving vehicle (arrays float32)."""
    range_m, reflectivity, cos_incidence, _ = _cast_rays(scenario, time_s, bundle, own, False)
    ambient_wpm2 = scenario.ambient_wpm2 + AMBIENT_WPM2[scenario.ambient_light]
    return View(range_m, reflectivity, cos_incidence, ambient_wpm2)


def truth(
    scenario: Scenario,
    time_s: float,
    lens: Lens,
    mounting: Mounting,
    shape: tuple[int, int],
    own: OwnMotion | None = None,
) -> Truth:
    """Return what the central ray of each pixel meets, and where the objects are and how they move, relative to us.

    object_id is i + 1 for names[i], 0 for nothing, `GROUND` for the ground.
    Positions p are in axes of the vehicle at that time. Velocities are those over ground less that of the vehicle,
    along the same axes, as tracks hold them. With the vehicle at P, of heading h, speed v and yaw rate w, an object at
    G that moves with V over ground has p = R(-h) (G - P) and u = R(-h) V - (v, 0, 0). Its coordinates change by dp/dt =
    u - (0, 0, w) x p: where we turn, what stands still goes across the image without a velocity of its own.
    """
    range_m, reflectivity, _, object_id = _cast_rays(scenario, time_s, ray_bundle(lens, mounting, shape), own, True)
    pose = own_pose(scenario, time_s, own)
    motions = [motion(thing.path, time_s) for thing in scenario.objects]
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    into = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # R(-h)
    away = np.array([m.position_m for m in motions]).reshape(-1, 3) - (pose.x_m, pose.y_m, 0.0)
    positions = away @ into.T
    velocities = np.array([m.velocity_mps for m in motions]).reshape(-1, 3) @ into.T
    return Truth(
        range_m[0],
        reflectivity[0],
        object_id[0],
        tuple(thing.name for thing in scenario.objects),
        positions,
        velocities - (pose.speed_mps, 0.0, 0.0),
    )


def ego_at(motion_of_ego: EgoMotion, time_s: float) -> Ego:
    """Return the state of the own vehicle at `time_s`."""
    return ego_of(ego_pose(motion_of_ego, time_s), time_s)


def ego_of(pose: Pose, time_s: float) -> Ego:
    """Return what the own vehicle measures of itself."""
    return Ego(
        time_s=time_s,
        speed_mps=abs(pose.speed_mps),
        yaw_rate_radps=pose.yaw_rate_radps,
        forward=pose.speed_mps >= 0,
    )


def _cast_rays(
    scenario: Scenario, time_s: float, bundle: RayBundle, own: OwnMotion | None, numbered: bool
) -> tuple[Floats, Floats, Floats, Ints]:
    """Return range, reflectivity, cosine of incidence and, if `numbered`, object of every ray, each (K, H, W)."""
    pose = own_pose(scenario, time_s, own)
    shapes, balls = placed(scenario.objects, time_s, pose, bundle.origin_m, scenario.ground_reflectivity)
    # rays keep one number of what they hit: its reflectivity, or which shape it is
    mark = np.arange(1, len(shapes) + 1) if numbered else shapes[:, 9]
    seen = np.empty((3, math.prod(bundle.shape)), np.float32)
    range_m, marked, cos_incidence = seen.reshape(3, *bundle.shape)
    _cast(bundle.directions, bundle.place, bundle.cones, bundle.runs, shapes, mark.astype(np.float32), balls, *seen)
    if not numbered:
        return range_m, marked, cos_incidence, np.empty(0, np.int32)
    shape = marked.astype(np.intp)
    reflectivity, object_id = (np.append(0, shapes[:, column])[shape] for column in (9, 10))
    return range_m, reflectivity.astype(np.float32), cos_incidence, object_id.astype(np.int32)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(
    directions: Any,
    place: Any,
    cones: Any,
    runs: Any,
    shapes: Any,
    mark: Any,
    balls: Any,
    range_m: Any,
    marked: Any,
    cos_incidence: Any,
) -> Any:
    """Keep the nearest hit of each ray; a run of rays skips objects and shapes whose ball its cone does not touch."""
    of_objects, of_shapes = _seen_from_origin(balls, 0, 3), _seen_from_origin(shapes, 1, 11)
    nearest, cosine, what = np.empty(_RUN, np.float32), np.empty(_RUN, np.float32), np.empty(_RUN, np.float32)
    for run in range(len(runs)):
        cone, first, last, in_row = cones[run], runs[run, 0], runs[run, 1], runs[run, 2]
        ray = (directions[0, first:last], directions[1, first:last], directions[2, first:last])
        hit = (nearest[: last - first], cosine[: last - first], what[: last - first])
        hit[0][:], hit[1][:], hit[2][:] = np.inf, 0, 0
        for i in range(len(balls)):
            begin, end = int(balls[i, 4]), int(balls[i, 5])
            if begin == end or not _may_touch(cone, of_objects, i):
                continue
            for k in range(begin, end):
                if end == begin + 1 or _may_touch(cone, of_shapes, k):
                    _cast_shape(ray, cone, shapes[k], mark[k], hit)
        _keep(hit[0], place[first:last], in_row, range_m)
        _keep(hit[1], place[first:last], in_row, cos_incidence)
        _keep(hit[2], place[first:last], in_row, marked)


@njit(cache=True, nogil=True, error_model="numpy")
def _keep(found: Any, place: Any, in_row: Any, image: Any) -> Any:
    """Fill a tile of an image, row by row; indices without a sign need no check whether they count from the end."""
    in_row = np.uintp(in_row)
    if in_row % np.uintp(8) == np.uintp(0):
        for start in range(np.uintp(0), np.uintp(len(place)), np.uintp(8)):
            _keep_eight(found, start, image, np.uintp(place[start]))
    else:
        for start in range(np.uintp(0), np.uintp(len(place)), in_row):
            to = np.uintp(place[start])
            for i in range(np.uintp(0), in_row):
                image[to + i] = found[start + i]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _keep_eight(found: Any, at: Any, image: Any, to: Any) -> Any:
    """Fill eight values, which become one vector as all of them are read before the first is written."""
    pair, four = (found[at], found[at + np.uintp(1)]), (found[at + np.uintp(2)], found[at + np.uintp(3)])
    six, eight = (found[at + np.uintp(4)], found[at + np.uintp(5)]), (found[at + np.uintp(6)], found[at + np.uintp(7)])
    values = pair + four + six + eight
    for i in range(8):
        image[to + np.uintp(i)] = values[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _seen_from_origin(table: Any, at: Any, of_radius2: Any) -> Any:
    """Return how balls are seen (N, 5): direction of the centre, cosine and sine of half the angle that they fill.

    table (N, ..): the centre from column `at` on, the squared radius. Around the origin it is all directions.
    """
    seen = np.zeros((len(table), 5))
    for i in range(len(table)):
        x, y, z, radius2 = table[i, at], table[i, at + 1], table[i, at + 2], table[i, of_radius2]
        distance2 = x * x + y * y + z * z
        if distance2 <= radius2:
            seen[i, 3] = -1.0
            continue
        away, sin2 = math.sqrt(distance2), radius2 / distance2
        seen[i, 0], seen[i, 1], seen[i, 2] = x / away, y / away, z / away
        seen[i, 3], seen[i, 4] = math.sqrt(1 - sin2), math.sqrt(sin2)
    return seen


@njit(cache=True, nogil=True, error_model="numpy")
def _may_touch(cone: Any, seen: Any, i: Any) -> Any:
    """Return whether a cone of rays from the origin can touch ball i: half its angle and that of the ball together."""
    if cone[3] <= 0:
        return True
    cos_limit = seen[i, 3] * cone[3] - seen[i, 4] * cone[4]  # cosine of the sum
    return cone[0] * seen[i, 0] + cone[1] * seen[i, 1] + cone[2] * seen[i, 2] >= cos_limit - 1e-12


@njit(cache=True, nogil=True, error_model="numpy")
def _may_enter(cone: Any, box: Any) -> Any:
    """Return whether a ray of a cone from the origin can be between all three pairs of faces of a box at once.

    A long box fills little of the ball around it. Seen along the box, the cone has directions from `low` to `high` on
    each axis: the first of them that is there between the faces, and the last that still is, are bounds for them all.
    Margins are many times the rounding of float32, so that no hit is lost.
    """
    if cone[3] <= 0:
        return True
    c, s = box[4], box[5]
    axis = (c * cone[0] + s * cone[1], c * cone[1] - s * cone[0], cone[2])
    start = (-(c * box[1] + s * box[2]), -(c * box[2] - s * box[1]), -box[3])
    enter, leave = 0.0, np.inf
    for i in range(3):
        along, aside = axis[i] * cone[3], math.sqrt(max(1 - axis[i] * axis[i], 0.0)) * cone[4]
        low = (along - aside if axis[i] > -cone[3] else -1.0) - 1e-6
        high = (along + aside if axis[i] < cone[3] else 1.0) + 1e-6
        if start[i] > 0:  # look at it from the other side
            low, high = -high, -low
        before = abs(start[i])
        half = box[6 + i] + 1e-6 * (before + box[6 + i])
        if before > half:
            if high <= 0:
                return False
            enter = max(enter, (before - half) / high)
        if low > 0:
            leave = min(leave, (before + half) / low)
        elif high < 0:
            leave = min(leave, (before - half) / high)
    return enter <= leave * (1 + 1e-5)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_shape(ray: Any, cone: Any, shape: Any, mark: Any, hit: Any) -> Any:
    if shape[0] == ROD:
        _cast_rod(ray, shape, mark, hit[0], hit[1], hit[2])
    elif shape[0] == CYLINDER:
        _cast_cylinder(ray, shape, mark, hit[0], hit[1], hit[2])
    elif shape[0] != PLANE:
        if _may_enter(cone, shape):
            _cast_box(ray, shape, mark, hit[0], hit[1], hit[2])
    elif cone[2] < cone[4] or cone[3] <= 0:  # else all of its rays go up
        _cast_plane(ray, shape, mark, hit[0], hit[1], hit[2])


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_box(ray: Any, shape: Any, mark: Any, range_m: Any, cos_incidence: Any, marked: Any) -> Any:
    """A ray is inside a box while it is between all three pairs of faces; the last one entered is the face it hits."""
    c, s = np.float32(shape[4]), np.float32(shape[5])
    ox = np.float32(-(shape[4] * shape[1] + shape[5] * shape[2]))
    oy = np.float32(-(shape[4] * shape[2] - shape[5] * shape[1]))
    oz = np.float32(-shape[3])
    hx, hy, hz = np.float32(shape[6]), np.float32(shape[7]), np.float32(shape[8])
    for i in range(range_m.size):
        known = (range_m[i], cos_incidence[i], marked[i])  # read first: the loop has no branch then
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
        cos_incidence[i] = cosine if hit else known[1]
        marked[i] = mark if hit else known[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_cylinder(ray: Any, shape: Any, mark: Any, range_m: Any, cos_incidence: Any, marked: Any) -> Any:
    """A ray is inside a cylinder while it is inside the circle and between the ends."""
    ox, oy, oz = np.float32(-shape[1]), np.float32(-shape[2]), np.float32(-shape[3])
    radius, half = np.float32(shape[6]), np.float32(shape[8])
    zero = np.float32(0)
    for i in range(range_m.size):
        known = (range_m[i], cos_incidence[i], marked[i])  # read first: the loop has no branch then
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
        cos_incidence[i] = cosine if hit else known[1]
        marked[i] = mark if hit else known[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_plane(ray: Any, shape: Any, mark: Any, range_m: Any, cos_incidence: Any, marked: Any) -> Any:
    """Light from above reaches a level plane along every ray that goes down."""
    height, farthest = np.float32(-shape[3]), np.float32(shape[6])
    for i in range(range_m.size):
        known = (range_m[i], cos_incidence[i], marked[i])  # read first: the loop has no branch then
        down = _not_zero(-ray[2][i])
        enter = height / down
        hit = (enter > np.float32(0)) & (down > np.float32(0)) & (enter < farthest) & (enter < known[0])
        range_m[i] = enter if hit else known[0]
        cos_incidence[i] = down if hit else known[1]
        marked[i] = mark if hit else known[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_rod(ray: Any, shape: Any, mark: Any, range_m: Any, cos_incidence: Any, marked: Any) -> Any:
    """A rod is the union of a side without ends and a ball at each end; the nearest of the three is what a ray hits.

    With m from its middle to the origin, u its direction and d that of the ray: the discriminant of the side is
    (1 - (d u)^2) r^2 - (d (u x m))^2, that of a ball around q is r^2 - |q x d|^2. Both keep their digits far away.
    """
    mx, my, mz = np.float32(-shape[1]), np.float32(-shape[2]), np.float32(-shape[3])
    ux, uy, uz = np.float32(shape[4]), np.float32(shape[5]), np.float32(shape[6])
    half, radius = np.float32(shape[7]), np.float32(shape[8])
    gx, gy, gz = uy * mz - uz * my, uz * mx - ux * mz, ux * my - uy * mx
    along_m = ux * mx + uy * my + uz * mz
    zero, infinite, steep, inverse = np.float32(0), np.float32(np.inf), np.float32(1e-5), np.float32(1) / radius
    for i in range(range_m.size):
        known = (range_m[i], cos_incidence[i], marked[i])  # read first: the loop has no branch then
        dx, dy, dz = ray[0][i], ray[1][i], ray[2][i]
        along_d = ux * dx + uy * dy + uz * dz
        open_ = np.float32(1) - along_d * along_d
        open_ = open_ if open_ > steep else steep  # along the rod only the balls count
        across = gx * dx + gy * dy + gz * dz
        square = open_ * radius * radius - across * across
        root = np.sqrt(square if square > zero else zero)
        side = (along_m * along_d - (mx * dx + my * dy + mz * dz) - root) / open_
        beyond = abs(along_m + side * along_d)
        side = side if (square > zero) & (beyond <= half) & (side > zero) else infinite
        one, one_root = _ball(mx - half * ux, my - half * uy, mz - half * uz, dx, dy, dz, radius)
        other, other_root = _ball(mx + half * ux, my + half * uy, mz + half * uz, dx, dy, dz, radius)
        enter = one if one < other else other
        cosine = one_root if one < other else other_root
        cosine = root if side < enter else cosine
        enter = side if side < enter else enter
        hit = enter < known[0]
        range_m[i] = enter if hit else known[0]
        cos_incidence[i] = cosine * inverse if hit else known[1]
        marked[i] = mark if hit else known[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ball(qx: Any, qy: Any, qz: Any, dx: Any, dy: Any, dz: Any, radius: Any) -> Any:
    """Return where a ray enters a ball, and the root of its discriminant; q goes from its centre to the origin."""
    cx, cy, cz = qy * dz - qz * dy, qz * dx - qx * dz, qx * dy - qy * dx
    square = radius * radius - (cx * cx + cy * cy + cz * cz)
    root = np.sqrt(square if square > np.float32(0) else np.float32(0))
    enter = -(qx * dx + qy * dy + qz * dz) - root
    return (enter if (square > np.float32(0)) & (enter > np.float32(0)) else np.float32(np.inf)), root


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
