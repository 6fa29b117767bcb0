"""Where a pixel looks and where its range lies: pixel -> ray -> camera -> vehicle, with covariances."""

import math
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from rangecam.settings import settings
from rangecam.types import Floats


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


def _tan_half(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg / 2))
