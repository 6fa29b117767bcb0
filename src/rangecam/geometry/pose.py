"""Where the camera is, and where the points that it sees lie in vehicle axes."""

import math
from functools import lru_cache

import numpy as np
from numba import njit

from rangecam.geometry.lens import Lens, rays
from rangecam.settings import settings
from rangecam.types import Floats, RangeImage


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
