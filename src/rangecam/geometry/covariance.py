"""How surely a point is known whose pixel and range are."""

import math

import numpy as np
from numba import njit

from rangecam.geometry.lens import Lens, is_plain, pixel_of, pixel_pitch, pixel_steps
from rangecam.geometry.pose import Mounting, position, rotation
from rangecam.types import Floats


def point_covariance(
    points_m: Floats, sigmas: Floats, lens: Lens, mounting: Mounting, shape: tuple[int, int]
) -> Floats:
    """Return the covariance in vehicle axes of points that a camera measured: (N, 3, 3) m2.

    points_m (N, 3) in vehicle axes; sigmas (N, 3): standard deviations across columns (pixels), across rows (pixels)
    and of the range (m), independent of each other; shape of the image. The angles follow from the pixels by the
    derivatives of azimuth and of the corrected elevation at the point, the other coordinate held (König 2008,
    eqs 6.38-6.39, E-K-17); the covariance in camera axes is turned into vehicle axes (E-K-22). Of a lens that distorts,
    or a table, they follow from the steps between the rays around the point's pixel.
    """
    if not is_plain(lens):
        return _by_steps(points_m, sigmas, lens, mounting, shape)
    covariance = np.empty((len(points_m), 3, 3))
    perspective = lens.projection == "perspective"
    pose = rotation(mounting), position(mounting)
    _point_covariance(points_m, sigmas, pixel_pitch(lens, shape), perspective, pose, covariance)
    return covariance


def _by_steps(points_m: Floats, sigmas: Floats, lens: Lens, mounting: Mounting, shape: tuple[int, int]) -> Floats:
    """Return the covariances with the steps of the nearest pixel; a point that no pixel sees takes the outermost."""
    seen = (points_m - position(mounting)) @ rotation(mounting)
    range_m = np.linalg.norm(seen, axis=-1)
    row, column = (
        np.rint(np.nan_to_num(place, nan=last / 2)).clip(0, last).astype(int)
        for place, last in zip(pixel_of(seen, lens, shape), (shape[0] - 1, shape[1] - 1), strict=True)
    )
    steps = pixel_steps(lens, shape)[row, column]
    moved = np.concatenate(  # of the point, by one standard deviation of column, row and range
        [steps * (range_m[:, None] * sigmas[:, :2])[..., None], (seen * (sigmas[:, 2] / range_m)[:, None])[:, None]],
        axis=1,
    )
    moved = moved @ rotation(mounting).T
    covariance: Floats = moved.transpose(0, 2, 1) @ moved
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
