"""How a camera is mounted, from what it sees of the floor: height, pitch and roll with their standard deviations."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rangecam.calibration.distance import mean_plane
from rangecam.errors import DataError
from rangecam.geometry import Lens, Mounting, rays, rotation
from rangecam.types import Floats, RangeImage

_TRIALS, _SCORED = 400, 3000
_BAND_SIGMAS, _BAND_M = 4.0, 0.01
_BELOW = 3.0  # a point below a plane says more against it than one above, on which something may stand
_LEAST = 30


@dataclass(frozen=True)
class FloorFit:
    """A mounting (x, y and yaw as they were: a floor does not show them), and how sure it is.

    sigma_height_m, sigma_pitch_deg, sigma_roll_deg: one standard deviation of z_m, pitch_deg, roll_deg. pixels: of the
    floor, of `seen` pixels with a range. residual_m: root mean square of their heights above the floor.
    """

    mounting: Mounting
    sigma_height_m: float
    sigma_pitch_deg: float
    sigma_roll_deg: float
    pixels: int
    seen: int
    residual_m: float


def fit_mounting(
    images: Iterable[RangeImage], lens: Lens, about: Mounting, rng: np.random.Generator, max_tilt_deg: float = 30.0
) -> FloorFit:
    """Return the mounting of a camera that looks at a floor, from images of a scene at rest.

    about: the mounting as far as it is known; the floor leans at most `max_tilt_deg` away from it. Things may stand on
    the floor: planes through three random pixels each propose it (RANSAC; Fischler and Bolles, 1981), the one near most
    pixels and with least below it is refined by least squares of the heights, weighted by their standard deviation
    (that of the mean range times the sine of the ray's depression). The stated deviations grow with what the noise
    does not explain. Raises DataError if no image shows a floor.
    """
    plane = mean_plane(images, 0.0)
    used = (plane.weight > 0) & (plane.measured_m > 0)
    ray = rays(lens, (used.shape[0], used.shape[1]))[used]
    points, sigma_m = ray * plane.measured_m[used][:, None], plane.weight[used] ** -0.5
    if len(points) >= _LEAST:
        normal, height = _proposed(points, ray, sigma_m, rotation(about)[2], max_tilt_deg, rng)
        near = _near(points @ normal + height, sigma_m * np.abs(ray @ normal))
        if near.sum() >= _LEAST:
            return _refined(points, ray, sigma_m, (normal, height), about)
    raise DataError(
        f"no floor among {len(points)} pixels with a range; it must fill a good part of the image, and lean less than "
        f"{max_tilt_deg:g} degrees away from the mounting that is set"
    )


def _near(height_m: Floats, sigma_m: Floats) -> NDArray[np.bool_]:
    """Return which points (bool) lie on the floor, as far as their noise lets that be said."""
    near: NDArray[np.bool_] = np.abs(height_m) < _BAND_SIGMAS * sigma_m + _BAND_M
    return near


def _proposed(
    points: Floats, ray: Floats, sigma_m: Floats, up: Floats, max_tilt_deg: float, rng: np.random.Generator
) -> tuple[Floats, float]:
    """Return the best of many planes: its unit normal upwards, and the height of the camera above it, m."""
    chosen = rng.permutation(len(points))[:_SCORED]
    best, least = (up, 0.0), math.inf
    for triple in rng.integers(len(points), size=(_TRIALS, 3)):
        a, b, c = points[triple]
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal)
        if size == 0:
            continue
        normal *= np.sign(normal @ up) / size
        height = -float(normal @ a)
        if normal @ up < math.cos(math.radians(max_tilt_deg)) or height <= 0:
            continue
        band = _BAND_SIGMAS * sigma_m[chosen] * np.abs(ray[chosen] @ normal) + _BAND_M
        off = (points[chosen] @ normal + height) / band
        cost = float(np.where(off < -1, _BELOW, np.minimum(off**2, 1.0)).sum())
        if cost < least:
            best, least = (normal, height), cost
    return best


def _refined(points: Floats, ray: Floats, sigma_m: Floats, start: tuple[Floats, float], about: Mounting) -> FloorFit:
    """Return the fit by Gauss-Newton steps in height, pitch and roll over the pixels near the floor of the step."""
    normal, height = start
    pitch, roll = -math.asin(normal[0]), math.atan2(normal[1], normal[2])  # the third row of R_y(pitch) R_x(roll)
    for _ in range(_STEPS):
        (sp, cp), (sr, cr) = (math.sin(pitch), math.cos(pitch)), (math.sin(roll), math.cos(roll))
        normal = np.array([-sp, cp * sr, cp * cr])
        above, spread = points @ normal + height, sigma_m * np.abs(ray @ normal)
        near = _near(above, spread)
        by_pitch, by_roll = points @ np.array([-cp, -sp * sr, -sp * cr]), points @ np.array([0.0, cp * cr, -cp * sr])
        jacobian = np.stack([np.ones(len(points)), by_pitch, by_roll], axis=1)[near] / spread[near, None]
        residual = above[near] / spread[near]
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        step = covariance @ jacobian.T @ residual
        height, pitch, roll = height - step[0], pitch - step[1], roll - step[2]
    excess = max(1.0, float(residual @ residual) / max(len(residual) - 3, 1))
    sigma = np.sqrt(np.diag(covariance) * excess)
    found = replace(about, z_m=float(height), pitch_deg=math.degrees(pitch), roll_deg=math.degrees(roll))
    rms = math.sqrt(float(np.mean(above[near] ** 2)))
    height_m, pitch_deg, roll_deg = float(sigma[0]), math.degrees(sigma[1]), math.degrees(sigma[2])
    return FloorFit(found, height_m, pitch_deg, roll_deg, int(near.sum()), len(points), rms)


_STEPS = 8
