"""The forward model of a continuous-wave pixel: from what the rays meet to the mean and the noise of a sample."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.settings import CwCamera
from rangecam.geometry import rays
from rangecam.optics import natural_vignetting
from rangecam.scene.view import View
from rangecam.types import Floats

_REFERENCE_TIME_S = 2e-3


def metres_per_radian(camera: CwCamera) -> float:
    """Return the range that one radian of phase stands for (Steinbäck 2016, eq 3.12)."""
    return camera.speed_of_light_mps / (4 * math.pi * camera.modulation_hz)


def sample_variance(light_lsb: Floats | float, camera: CwCamera) -> Floats:
    """Return the variance, LSB2, of a sample for which `light_lsb` was collected, before rounding.

    A sample is the mean of `binning` squared pixels, whose noise is independent (N-S-042).
    """
    of_one = camera.read_noise_lsb**2 + camera.shot_noise_lsb2_per_lsb * np.asarray(light_lsb)
    return np.asarray(of_one / camera.binning**2)


def correlate(view: View, camera: CwCamera, step: float) -> tuple[Floats, Floats]:
    """Return the mean sample and the light collected for it, each (H, W) float32 in LSB, at one phase step.

    The sample is black level + amplitude cos(phase + step), with which atan2(C270 - C90, C0 - C180) is +phase
    (N-S-045); a single-ended pixel has the light level on top. The rays of a pixel add as phasors, so that a pixel at
    an edge mixes two ranges (K-OPT-13). The amplitude of a ray goes with reflectivity cos(incidence) / range^2
    (Steinbäck 2016, eq 2.5), and so that a white plane 1 m before the camera makes `reference_amplitude`. The light,
    whose shot noise a sample has, is amplitude / contrast plus the ambient light.
    """
    gain, vignetting = _gains(camera, view.range_m.shape[1:])
    signal, active, reflected = (np.empty(gain.shape, np.float32) for _ in range(3))
    turn = camera.phase_sign / metres_per_radian(camera)
    range_m, reflectivity, cos_incidence = (
        np.ascontiguousarray(a, np.float32).reshape(len(a), -1)
        for a in (view.range_m, view.reflectivity, view.cos_incidence)
    )
    phase_at_zero = np.float32(math.radians(step) - turn * camera.offset_m)
    _sum_rays(
        range_m,
        reflectivity,
        cos_incidence,
        np.float32(turn),
        phase_at_zero,
        signal.ravel(),
        active.ravel(),
        reflected.ravel(),
    )
    ambient = np.float32(camera.ambient_lsb_per_wpm2 * view.ambient_wpm2) * vignetting * reflected
    sample = np.float32(camera.black_level_lsb) + gain * signal
    level = gain * active / np.float32(camera.demodulation_contrast) + ambient
    if camera.pixel == "single_ended":
        return sample + level, gain * signal + level
    return sample, level


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
def _gains(camera: CwCamera, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return LSB of amplitude per reflectivity cos(incidence) / range^2, and what vignetting leaves of ambient light.

    The reference was taken on a plane (E-S-22), where cos(incidence) / range^2 is cos^3(angle to the axis) / depth^2.
    Both are (H, W) float32 and grow with the exposure.
    """
    cos_axis, exposure = rays(camera.lens, shape)[..., 0], camera.illumination_time_s / _REFERENCE_TIME_S
    gain = reference_amplitude(camera, shape) / cos_axis**3 * exposure
    return gain.astype(np.float32), (natural_vignetting(cos_axis) * exposure).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_rays(
    range_m: Any,
    reflectivity: Any,
    cos_incidence: Any,
    turn: Any,
    phase_at_zero: Any,
    signal: Any,
    active: Any,
    reflected: Any,
) -> Any:
    """Average over the rays of each pixel: strength cos(phase + step), strength, and reflectivity."""
    n_rays, n_pixels = range_m.shape
    share = np.float32(1) / np.float32(n_rays)
    for i in range(n_pixels):
        s, a, r = np.float32(0), np.float32(0), np.float32(0)
        for k in range(n_rays):
            distance = range_m[k, i]
            if distance < np.inf:
                strength = reflectivity[k, i] * cos_incidence[k, i] / (distance * distance)
                s += strength * np.cos(turn * distance + phase_at_zero)
                a += strength
                r += reflectivity[k, i]
        signal[i], active[i], reflected[i] = s * share, a * share, r * share
