"""What light and electronics make of a phase: metres a radian, noise of a sample, and how strong the light is."""

import math
from functools import lru_cache

import numpy as np

from rangecam.cw.settings import CwCamera
from rangecam.geometry import rays
from rangecam.optics import natural_vignetting
from rangecam.types import Floats

_REFERENCE_TIME_S = 2e-3


def metres_per_radian(camera: CwCamera) -> float:
    """Return the range that one radian of phase stands for (Steinbäck 2016, eq 3.12)."""
    return camera.speed_of_light_mps / (4 * math.pi * camera.modulation_hz)


def sample_variance(light_lsb: Floats | float, camera: CwCamera) -> Floats:
    """Return the variance, LSB2, of a sample for which `light_lsb` was collected, before rounding.

    A sample is the mean of `binning` squared pixels, whose noise is independent (N-S-042).
    """
    read_variance, per_light, averaged = noise_of(camera)
    return np.asarray((read_variance + per_light * np.asarray(light_lsb)) / averaged)


def noise_of(camera: CwCamera) -> tuple[float, float, int]:
    """Return the variance of a pixel without light, LSB2, that for each LSB of light, and how many pixels a sample is.

    See `sample_variance`.
    """
    return camera.read_noise_lsb**2, camera.shot_noise_lsb2_per_lsb, camera.binning**2


def reference_amplitude(camera: CwCamera, shape: tuple[int, int]) -> Floats:
    """Return the amplitude image (H, W) of a white plane 1 m before the camera, lit for 2 ms (S-PRE-05, N-S-028).

    Floor + rest cos^n(azimuth) cos^n(elevation), Steinbäck 2016, A.5, with the angles of the lens (E-S-02).
    """
    ray = rays(camera.lens, shape)
    cos_elevation = np.hypot(ray[..., 0], ray[..., 1])
    cos_azimuth = ray[..., 0] / cos_elevation
    rest = camera.reference_amplitude_lsb - camera.reference_floor_lsb
    result: Floats = camera.reference_floor_lsb + rest * (cos_azimuth * cos_elevation) ** camera.reference_exponent
    return result


@lru_cache(maxsize=8)
def gains(camera: CwCamera, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return LSB of amplitude per reflectivity cos(incidence) / range^2, and what vignetting leaves of ambient light.

    The reference was taken on a plane (E-S-22), where cos(incidence) / range^2 is cos^3(angle to the axis) / depth^2.
    Both are (H, W) float32 and grow with the exposure.
    """
    cos_axis, exposure = rays(camera.lens, shape)[..., 0], camera.illumination_time_s / _REFERENCE_TIME_S
    gain = reference_amplitude(camera, shape) / cos_axis**3 * exposure
    return gain.astype(np.float32), (natural_vignetting(cos_axis) * exposure).astype(np.float32)
