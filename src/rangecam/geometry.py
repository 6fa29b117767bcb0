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
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    ray.setflags(write=False)
    return ray


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
    matrix = r_z @ r_y @ r_x
    matrix.setflags(write=False)
    return matrix


def position(mounting: Mounting) -> Floats:
    """Return the camera centre in vehicle axes: (3,) m."""
    return np.array([mounting.x_m, mounting.y_m, mounting.z_m])


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
    _points(image.range_m, vehicle_rays(lens, mounting, image.shape), position(mounting).astype(np.float32), points)
    return points


@njit(cache=True, nogil=True)
def _points(range_m: Floats, ray: Floats, centre: Floats, points: Floats) -> None:
    for row in range(range_m.shape[0]):
        for column in range(range_m.shape[1]):
            for axis in range(3):
                points[row, column, axis] = range_m[row, column] * ray[row, column, axis] + centre[axis]


def to_camera(points_m: Floats, mounting: Mounting) -> Floats:
    """Return points given in vehicle axes in camera axes: (..., 3) m, the inverse of the turn and shift of `to_world`.

    P_C = R (P_W - C_W) (König 2008, eq 6.6 corrected, E-K-18, E-K-19).
    """
    turned: Floats = (points_m - position(mounting)) @ rotation(mounting)
    return turned


def polar(points_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return azimuth (left positive), elevation (up positive) and range of points in camera axes (..., 3): rad, rad, m.

    Elevation is the angle above the xy-plane (König 2008, eq 6.3 corrected, E-K-17), so that eq 6.5 inverts it.
    """
    x, y, z = points_m[..., 0], points_m[..., 1], points_m[..., 2]
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.linalg.norm(points_m, axis=-1)


def cartesian(azimuth_rad: Floats, elevation_rad: Floats, range_m: Floats) -> Floats:
    """Return the points (..., 3) in camera axes of azimuth, elevation and range (König 2008, eq 6.5)."""
    level = np.cos(elevation_rad)
    direction = [level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)]
    points: Floats = np.stack(direction, axis=-1) * np.asarray(range_m)[..., None]
    return points


def angle_sigmas(points_m: Floats, sigma_px: Floats, lens: Lens, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return the standard deviations of azimuth and elevation (rad) that uncertain image positions cause.

    points_m (N, 3) in camera axes; sigma_px (N, 2): standard deviation across columns and rows, in pixels.
    Perspective: the derivatives of azimuth and of the corrected elevation by the position on the sensor (König 2008,
    eqs 6.38-6.39, E-K-17), the other coordinate held; equiangular: a pixel is the same angle everywhere.
    """
    pitch_h, pitch_v = pixel_pitch(lens, shape)
    if lens.projection == "equiangular":
        return sigma_px[:, 0] * pitch_h, sigma_px[:, 1] * pitch_v
    tan_h, tan_v = points_m[:, 1] / points_m[:, 0], points_m[:, 2] / points_m[:, 0]
    level2 = 1 + tan_h**2
    return sigma_px[:, 0] * pitch_h / level2, sigma_px[:, 1] * pitch_v * np.sqrt(level2) / (level2 + tan_v**2)


def pixel_pitch(lens: Lens, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the step from column to column and from row to row: rad (equiangular) or of the tangent (perspective)."""
    height, width = shape
    half_h = math.radians(lens.horizontal_fov_deg / 2)
    half_v = None if lens.vertical_fov_deg is None else math.radians(lens.vertical_fov_deg / 2)
    if lens.projection == "perspective":
        half_h, half_v = math.tan(half_h), None if half_v is None else math.tan(half_v)
    pitch_h = 2 * half_h / width
    return pitch_h, pitch_h if half_v is None else 2 * half_v / height


def polar_covariance(
    azimuth_rad: Floats, elevation_rad: Floats, range_m: Floats, sigmas: tuple[Floats, Floats, Floats]
) -> Floats:
    """Return the covariance in camera axes of points known in polar coordinates: (N, 3, 3) m2.

    azimuth, elevation, range (N,); sigmas: their standard deviations (rad, rad, m), independent of each other
    (König 2008, eqs 6.34-6.37; the Jacobian with its signs, E-K-22).
    """
    (cos_a, sin_a), (cos_e, sin_e) = ((np.cos(a), np.sin(a)) for a in (azimuth_rad, elevation_rad))
    jacobian = np.zeros((len(cos_a), 3, 3))
    jacobian[:, 0] = np.stack([-range_m * sin_a * cos_e, -range_m * cos_a * sin_e, cos_a * cos_e], axis=-1)
    jacobian[:, 1] = np.stack([range_m * cos_a * cos_e, -range_m * sin_a * sin_e, sin_a * cos_e], axis=-1)
    jacobian[:, 2] = np.stack([np.zeros_like(sin_e), range_m * cos_e, sin_e], axis=-1)
    scaled = jacobian * np.stack(sigmas, axis=-1)[:, None, :]
    covariance: Floats = scaled @ scaled.transpose(0, 2, 1)
    return covariance


def turn_covariance(covariance_m2: Floats, mounting: Mounting) -> Floats:
    """Return covariances (N, 3, 3) given in camera axes in vehicle axes: R^T C R (König 2008, 6.4.3.3, E-K-22)."""
    matrix = rotation(mounting)
    turned: Floats = matrix @ covariance_m2 @ matrix.T
    return turned


def _tan_half(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg / 2))
