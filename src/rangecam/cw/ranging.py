"""Ranging from correlation samples: raw phase images in, range with its standard deviation out."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.planes import plane_of
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

PLANES = ("phase_0", "phase_90", "phase_180", "phase_270")

_VALID, _NO_SIGNAL, _NOT_FINITE = np.uint8(Why.VALID), np.uint8(Why.NO_SIGNAL), np.uint8(Why.NOT_FINITE)
_LOW_AMPLITUDE, _SATURATED = np.uint8(Why.LOW_AMPLITUDE), np.uint8(Why.SATURATED)
_SENSOR_FLAG = np.uint8(Why.SENSOR_FLAG)
_LARGEST = np.float32(1e30)
_PI, _TWO_PI = np.float32(math.pi), np.float32(2 * math.pi)
_TURNS_PER_RAD = np.float32(0.5 / math.pi)
# Minimax polynomial of arctan on 0..1 in odd powers, error 2.5e-7 rad (least squares with Lawson's weights).
_A1, _A3, _A5, _A7, _A9, _A11, _A13 = (
    np.float32(a)
    for a in (0.9999961115, -0.3331736805, 0.1980781549, -0.1323334184, 0.07962366797, -0.03360421694, 0.006811792148)
)


def cw_four_phase(raw: RawFrame, camera: CwCamera) -> RangeImage:
    """Return range, standard deviation and amplitude from four correlation samples a quarter period apart.

    Planes phase_0, phase_90, phase_180, phase_270 (H, W) of any number type, each taken by its phase whatever the order
    of capture (E-S-13). Range from Steinbäck 2016, eqs 2.2 (as atan2, E-S-30), 2.3 and 3.11-3.14; offset and shift into
    the unambiguous range on the phase. Amplitude from alg 4.1. sigma_m is the noise of a sample propagated through the
    arctangent: sigma_phase = sigma / (sqrt(2) A) (N-S-051). Why is NOT_FINITE, NO_SIGNAL (four equal samples),
    SATURATED, LOW_AMPLITUDE or, in `pseudo_rows`, SENSOR_FLAG.
    Raises DataError for a missing or misshapen plane.
    """
    c0, c90, c180, c270 = [_samples(raw, name) for name in PLANES]
    shape, why = c0.shape, np.empty(c0.shape, np.uint8)
    range_m, sigma_m, amplitude = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
    _four_phase(c0, c90, c180, c270, _kernel_settings(camera), range_m, sigma_m, amplitude, why)
    if camera.pseudo_rows:
        why[: camera.pseudo_rows] = _SENSOR_FLAG
    return RangeImage(raw.time_s, range_m, sigma_m, amplitude, why)


@lru_cache(maxsize=8)
def _kernel_settings(camera: CwCamera) -> Floats:
    """Return what the kernel needs of the camera, in its order."""
    metres_per_rad = metres_per_radian(camera)
    single_ended = camera.pixel == "single_ended"
    known_light = 0.0 if single_ended else camera.ambient_lsb
    per_light = float(sample_variance(1.0, camera) - sample_variance(0.0, camera))
    floor_variance = float(sample_variance(known_light, camera)) + camera.quantisation_lsb**2 / 12
    return np.array(
        [
            camera.phase_sign,
            camera.offset_m / metres_per_rad,
            metres_per_rad,
            max(floor_variance, 1e-12),
            per_light * (1.0 if single_ended else 0.0),
            per_light * (0.0 if single_ended else 1 / camera.demodulation_contrast),
            camera.black_level_lsb,
            -_LARGEST if camera.lower_limit_lsb is None else camera.lower_limit_lsb,
            _LARGEST if camera.full_scale_lsb is None else camera.full_scale_lsb,
            camera.min_amplitude,
            camera.max_phase_sigma_rad**2,
        ],
        np.float32,
    )


def _samples(raw: RawFrame, name: str) -> Image:
    """Return a plane as contiguous uint16 or float32: the kernel is compiled for these two."""
    plane = plane_of(raw, name, PLANES)
    return np.ascontiguousarray(plane, _UINT16 if plane.dtype == _UINT16 else _FLOAT32)


_UINT16, _FLOAT32 = np.dtype(np.uint16), np.dtype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _four_phase(
    c0: Any, c90: Any, c180: Any, c270: Any, settings: Any, range_m: Any, sigma_m: Any, amplitude: Any, why: Any
) -> Any:
    """Fill the four output images; everything is a select, so that the loop becomes vector instructions."""
    c0, c90, c180, c270 = c0.reshape(-1), c90.reshape(-1), c180.reshape(-1), c270.reshape(-1)
    range_m, sigma_m, amplitude, why = range_m.reshape(-1), sigma_m.reshape(-1), amplitude.reshape(-1), why.reshape(-1)
    sign, offset, metres_per_rad = settings[0], settings[1], settings[2]
    floor_variance, shot_per_level, shot_per_amplitude = settings[3], settings[4], settings[5]
    black, low, high, min_amplitude, max_variance = settings[6], settings[7], settings[8], settings[9], settings[10]
    two, half, quarter, tiny = np.float32(2), np.float32(0.5), np.float32(0.25), np.float32(1e-30)
    zero, nan = np.float32(0), np.float32(np.nan)
    for i in range(c0.size):
        s0, s90, s180, s270 = np.float32(c0[i]), np.float32(c90[i]), np.float32(c180[i]), np.float32(c270[i])
        real, imaginary = s0 - s180, s270 - s90
        square = real * real + imaginary * imaginary
        magnitude = np.sqrt(square)
        phase = sign * _atan2(imaginary, real) + offset  # Steinbäck 2016, eqs 2.2 and 3.13
        phase -= _TWO_PI * np.floor(phase * _TURNS_PER_RAD)  # eq 3.14
        phase = zero if phase >= _TWO_PI else phase
        level = quarter * (s0 + s90 + s180 + s270) - black
        level = level if level > zero else zero
        variance = floor_variance + shot_per_level * level + shot_per_amplitude * half * magnitude
        # d phase = (Re dIm - Im dRe) / (Re^2 + Im^2), and Re and Im each are the difference of two samples
        doubled, bounded = two * variance, (square if square > tiny else tiny)
        largest, smallest = (
            _larger(_larger(s0, s90), _larger(s180, s270)),
            _smaller(_smaller(s0, s90), _smaller(s180, s270)),
        )
        finite = abs(s0) + abs(s90) + abs(s180) + abs(s270) < _LARGEST
        reason = _LOW_AMPLITUDE if doubled > max_variance * bounded or half * magnitude < min_amplitude else _VALID
        reason = _SATURATED if largest >= high or smallest <= low else reason
        reason = _NO_SIGNAL if largest == smallest and largest < high else reason
        usable = finite and square > zero
        range_m[i] = metres_per_rad * phase if usable else nan  # eq 3.11
        sigma_m[i] = metres_per_rad * np.sqrt(doubled / bounded) if usable else nan
        amplitude[i] = half * magnitude if finite else nan
        why[i] = reason if finite else _NOT_FINITE


@njit(cache=True, nogil=True, inline="always")
def _atan2(y: Any, x: Any) -> Any:
    """Return the angle of (x, y) in -pi..pi, in float32 to 3e-7 rad: a minimax polynomial in the first octant."""
    ax, ay = abs(x), abs(y)
    t = _smaller(ax, ay) / _larger(_larger(ax, ay), np.float32(1e-30))
    u = t * t
    v = u * u
    angle = t * ((_A1 + u * _A3) + v * ((_A5 + u * _A7) + v * ((_A9 + u * _A11) + v * _A13)))
    angle = np.float32(math.pi / 2) - angle if ay > ax else angle
    angle = _PI - angle if x < 0 else angle
    return -angle if y < 0 else angle


@njit(cache=True, nogil=True, inline="always")
def _larger(a: Any, b: Any) -> Any:
    """Return the larger one; unlike `max` without a case for NaN, which would cost the vector instructions."""
    return a if a > b else b


@njit(cache=True, nogil=True, inline="always")
def _smaller(a: Any, b: Any) -> Any:
    return a if a < b else b


RANGING: dict[str, Callable[[RawFrame, CwCamera], RangeImage]] = {"cw_four_phase": cw_four_phase}
"""Ranging methods of continuous-wave cameras by name."""
