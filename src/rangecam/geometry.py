"""Where a pixel looks and where its range lies: pixel -> ray -> camera -> vehicle, with covariances."""

import math
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval
from numba import njit

from rangecam.settings import settings
from rangecam.types import Floats, RangeImage


@settings
class Lens:
    """How the sensor sees: opening angles and projection; the optical axis passes through the image centre."""

    horizontal_fov_deg: Annotated[float, Interval(gt=0, lt=175)] = 60.0
    """Opening angle over the whole width, outer edge to outer edge."""
    vertical_fov_deg: Annotated[float, Interval(gt=0, lt=175)] | None = None
    """The same over the height; none: square pixels."""
    projection: Literal["perspective", "equiangular"] = "perspective"
    """perspective: tan(angle) grows with the pixel offset; equiangular: the angle itself does (f-theta lens)."""


@settings
class Mounting:
    """Pose of the camera in vehicle axes: position of its centre, then roll, pitch, yaw about x, y, z."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    """Positive tilts the view downwards: 90 looks at the floor."""
    yaw_deg: float = 0.0
    """Positive turns the view to the left."""


@lru_cache(maxsize=16)
def rays(lens: Lens, shape: tuple[int, int]) -> Floats:
    """Return the unit direction of every pixel's centre in camera axes (x forward, y left, z up): (H, W, 3) float64.

    Perspective pixels are equal steps of the tangent, equiangular ones equal steps of the angle (Steinbäck eq 3.16
    with rows and columns the right way round, E-S-02); the vertical angle is the elevation above the plane of the
    horizontal angle (E-K-17). The array is shared and read-only.
    """
    height, width = shape
    half_h = np.radians(lens.horizontal_fov_deg / 2)
    across = 1 - (2 * np.arange(width) + 1) / width  # +1 left .. -1 right
    up = 1 - (2 * np.arange(height) + 1) / height
    if lens.projection == "perspective":
        tan_h = np.tan(half_h)
        tan_v = tan_h * height / width if lens.vertical_fov_deg is None else _tan_half(lens.vertical_fov_deg)
        y, z = np.meshgrid(across * tan_h, up * tan_v)
        ray = np.stack([np.ones_like(y), y, z], axis=-1)
    else:
        half_v = half_h * height / width if lens.vertical_fov_deg is None else np.radians(lens.vertical_fov_deg / 2)
        azimuth, elevation = np.meshgrid(across * half_h, up * half_v)
        ray = np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
        )
    unit: Floats = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    unit.setflags(write=False)
    return unit


@lru_cache(maxsize=16)
def rotation(mounting: Mounting) -> Floats:
    """Return the matrix (3, 3) that turns camera axes into vehicle axes: Rz(yaw) Ry(pitch) Rx(roll).

    It is the transpose of the thesis' R (corrected, E-K-18), which turns vehicle into camera axes.
    """
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(math.radians(a)), math.sin(math.radians(a)))
        for a in (mounting.roll_deg, mounting.pitch_deg, mounting.yaw_deg)
    )
    r_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    r_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    r_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    matrix: Floats = r_z @ r_y @ r_x
    matrix.setflags(write=False)
    return matrix


@lru_cache(maxsize=16)
def position(mounting: Mounting) -> Floats:
    """Return the camera centre in vehicle axes: (3,) m, shared and read-only."""
    centre = np.array([mounting.x_m, mounting.y_m, mounting.z_m])
    centre.setflags(write=False)
    return centre


@lru_cache(maxsize=16)
def vehicle_rays(lens: Lens, mounting: Mounting, shape: tuple[int, int]) -> Floats:
    """Return the unit direction of every pixel's centre in vehicle axes: (H, W, 3) float32, shared and read-only."""
    turned: Floats = np.ascontiguousarray(rays(lens, shape) @ rotation(mounting).T, dtype=np.float32)
    turned.setflags(write=False)
    return turned


def to_world(image: RangeImage, lens: Lens, mounting: Mounting) -> Floats:
    """Return the point that each pixel sees, in vehicle axes: (H, W, 3) float32 m.

    P_W = R^T P_C + C_W with C_W the camera centre (König 2008, eq 6.10 corrected, E-K-19). NaN where the range is NaN;
    points of invalid pixels mean nothing.
    """
    points = np.empty((*image.shape, 3), np.float32)
    range_m = np.ascontiguousarray(image.range_m, np.float32)
    _points(range_m, vehicle_rays(lens, mounting, image.shape), position(mounting), points)
    return points


@njit(cache=True, nogil=True)
def _points(range_m: Floats, ray: Floats, centre: Floats, points: Floats) -> None:
    """Work on rows of coordinates: the range of each pixel three times, so that vectors need no shuffling."""
    height, width = range_m.shape
    rays_of, points_of = ray.reshape(height, 3 * width), points.reshape(height, 3 * width)
    thrice, origin = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32)
    for i in range(width):
        origin[3 * i], origin[3 * i + 1], origin[3 * i + 2] = centre[0], centre[1], centre[2]
    for row in range(height):
        for i in range(width):
            value = range_m[row, i]
            thrice[3 * i], thrice[3 * i + 1], thrice[3 * i + 2] = value, value, value
        for i in range(3 * width):
            points_of[row, i] = thrice[i] * rays_of[row, i] + origin[i]


def polar(points_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return azimuth (left positive), elevation (up positive) and range of points in camera axes (..., 3): rad, rad, m.

    Elevation is the angle above the xy-plane (König 2008, eq 6.3 corrected, E-K-17), as in eq 6.5.
    """
    x, y, z = points_m[..., 0], points_m[..., 1], points_m[..., 2]
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.linalg.norm(points_m, axis=-1)


@lru_cache(maxsize=16)
def pixel_pitch(lens: Lens, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the step from column to column and from row to row: rad (equiangular) or of the tangent (perspective)."""
    height, width = shape
    half_h = math.radians(lens.horizontal_fov_deg / 2)
    half_v = None if lens.vertical_fov_deg is None else math.radians(lens.vertical_fov_deg / 2)
    if lens.projection == "perspective":
        half_h, half_v = math.tan(half_h), None if half_v is None else math.tan(half_v)
    pitch_h = 2 * half_h / width
    return pitch_h, pitch_h if half_v is None else 2 * half_v / height


def point_covariance(
    points_m: Floats, sigmas: Floats, lens: Lens, mounting: Mounting, shape: tuple[int, int]
) -> Floats:
    """Return the covariance in vehicle axes of points that a camera measured: (N, 3, 3) m2.

    points_m (N, 3) in vehicle axes; sigmas (N, 3): standard deviations across columns (pixels), across rows (pixels)
    and of the range (m), independent of each other; shape of the image. The angles follow from the pixels by the
    derivatives of azimuth and of the corrected elevation at the point, the other coordinate held (König 2008,
    eqs 6.38-6.39, E-K-17); the covariance in camera axes is turned into vehicle axes (E-K-22).
    """
    covariance = np.empty((len(points_m), 3, 3))
    perspective = lens.projection == "perspective"
    pose = rotation(mounting), position(mounting)
    _point_covariance(points_m, sigmas, pixel_pitch(lens, shape), perspective, pose, covariance)
    return covariance


@njit(cache=True, nogil=True, error_model="numpy")
def _point_covariance(
    points_m: Floats,
    sigmas: Floats,
    pitch: tuple[float, float],
    perspective: bool,
    pose: tuple[Floats, Floats],
    covariance: Floats,
) -> None:
    turn, centre = pose
    polar_m, spread, in_camera = np.empty(3), np.empty(3), np.empty((3, 3))
    for row in range(len(points_m)):
        x, y, z = 0.0, 0.0, 0.0  # in camera axes
        for axis in range(3):
            away = points_m[row, axis] - centre[axis]
            x, y, z = x + away * turn[axis, 0], y + away * turn[axis, 1], z + away * turn[axis, 2]
        level = math.hypot(x, y)
        polar_m[0], polar_m[1], polar_m[2] = math.atan2(y, x), math.atan2(z, level), math.hypot(level, z)
        # perspective: y/x and z/x change by one pitch from pixel to pixel; equiangular: the angles themselves do
        spread[0] = sigmas[row, 0] * pitch[0] * ((x / level) ** 2 if perspective else 1.0)
        spread[1] = sigmas[row, 1] * pitch[1] * (x * level / (level**2 + z**2) if perspective else 1.0)
        spread[2] = sigmas[row, 2]
        _polar_covariance(polar_m, spread, in_camera)
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    for m in range(3):
                        total += turn[i, k] * in_camera[k, m] * turn[j, m]
                covariance[row, i, j] = total


@njit(cache=True, nogil=True)
def _polar_covariance(polar_m: Floats, sigmas: Floats, covariance: Floats) -> None:
    """Propagate azimuth, elevation and range to camera axes (König 2008, eqs 6.34-6.37; signs: E-K-22)."""
    azimuth, elevation, range_m = polar_m
    cos_a, sin_a, cos_e, sin_e = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    jacobian = np.array(  # of eq 6.5 by azimuth, elevation, range
        [
            [-range_m * sin_a * cos_e, -range_m * cos_a * sin_e, cos_a * cos_e],
            [range_m * cos_a * cos_e, -range_m * sin_a * sin_e, sin_a * cos_e],
            [0.0, range_m * cos_e, sin_e],
        ]
    )
    for i in range(3):
        for j in range(3):
            covariance[i, j] = 0.0
            for k in range(3):
                covariance[i, j] += jacobian[i, k] * jacobian[j, k] * sigmas[k] ** 2


def _tan_half(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg / 2))
