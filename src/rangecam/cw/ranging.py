"""Ranging from correlation samples: raw phase images in, range with its standard deviation out."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeGuard

import numpy as np

from rangecam.compiled import kernel
from rangecam.cw.decoding import decode
from rangecam.cw.phasor import turns as turns_of
from rangecam.cw.sequence import plane_names
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.cw.unwrapping import combine
from rangecam.cw.wraps import order_of, plan_of
from rangecam.errors import UsageError
from rangecam.planes import plane_of
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

PLANES = ("phase_0", "phase_90", "phase_180", "phase_270")

_VALID, _NO_SIGNAL, _NOT_FINITE = np.uint8(Why.VALID), np.uint8(Why.NO_SIGNAL), np.uint8(Why.NOT_FINITE)
_LOW_AMPLITUDE, _SATURATED = np.uint8(Why.LOW_AMPLITUDE), np.uint8(Why.SATURATED)
_SENSOR_FLAG, _ZERO, _ONE = np.uint8(Why.SENSOR_FLAG), np.float32(0), np.float32(1)
_LARGEST = np.float32(1e30)
_NAN, _TWO, _HALF, _QUARTER = np.float32(np.nan), np.float32(2), np.float32(0.5), np.float32(0.25)
_TWO_PI = np.float32(2 * math.pi)


def cw_four_phase(raw: RawFrame, camera: CwCamera) -> RangeImage:
    """Return range, standard deviation and amplitude from four correlation samples a quarter period apart.

    Planes phase_0, phase_90, phase_180, phase_270 (H, W) of any number type, each taken by its phase whatever the order
    of capture (E-S-13). Range from Steinbäck 2016, eqs 2.2 (as atan2, E-S-30), 2.3 and 3.11-3.14; offset and shift into
    the unambiguous range on the phase. Amplitude from alg 4.1. sigma_m is the noise of a sample propagated through the
    arctangent: sigma_phase = sigma / (sqrt(2) A) (N-S-051). Why is NOT_FINITE, NO_SIGNAL (four equal samples),
    SATURATED, LOW_AMPLITUDE or, in `pseudo_rows`, SENSOR_FLAG. With a `phasor_filter` it is `cw_phases`.
    Raises DataError for a missing or misshapen plane.
    """
    if camera.phasor_filter != "off":
        return cw_phases(raw, camera)
    planes = _samples(raw, PLANES)
    shape = planes[0].shape
    images, why = np.empty((3, *shape), np.float32), np.empty(shape, np.uint8)
    limits, settings = _known(camera, planes[0].dtype)
    c0, c90, c180, c270 = planes  # one by one: a tuple would take longer to be handed over
    _four_phase(c0, c90, c180, c270, limits, settings, images, why)
    if camera.pseudo_rows:
        why[: camera.pseudo_rows] = _SENSOR_FLAG
    return RangeImage(raw.time_s, images[0], images[1], images[2], why)


@lru_cache(maxsize=16)
def _known(camera: CwCamera, kind: np.dtype[Any]) -> tuple[Image, Floats]:
    """Return what the kernel needs of the camera, found at one go: limits of samples of a number type, and settings."""
    return _sample_limits(camera, kind), _kernel_settings(camera)


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
            camera.offset_m / (2 * math.pi * metres_per_rad) % 1.0,
            metres_per_rad,
            max(floor_variance, 1e-12),
            per_light * (1.0 if single_ended else 0.0),
            per_light * (0.0 if single_ended else 1 / camera.demodulation_contrast),
            camera.black_level_lsb,
            camera.min_amplitude,
            camera.max_phase_sigma_rad**2,
        ],
        np.float32,
    )


def _sample_limits(camera: CwCamera, kind: np.dtype[Any]) -> Image:
    """Return the least and the greatest sample, of its own number type, that is within the converter's limits."""
    low, high = camera.lower_limit_lsb, camera.full_scale_lsb
    if kind == _UINT16:
        least = 0 if low is None else math.floor(low) + 1
        most = 65535 if high is None else math.ceil(high) - 1
        return np.clip([least, most], 0, 65535).astype(np.uint16)
    least_float = -_LARGEST if low is None else np.nextafter(np.float32(low), _LARGEST)
    most_float = _LARGEST if high is None else np.nextafter(np.float32(high), -_LARGEST)
    return np.array([least_float, most_float], np.float32)


def _samples(raw: RawFrame, names: Sequence[str]) -> tuple[Image, ...]:
    """Return the planes as contiguous images, all uint16 or all float32: the kernels are compiled for these two."""
    as_they_are = tuple([raw.planes.get(name) for name in names])
    if _ready(as_they_are):
        return as_they_are
    planes = [plane_of(raw, name, names) for name in names]
    kind = _UINT16 if all(plane.dtype == _UINT16 for plane in planes) else _FLOAT32
    return tuple([np.ascontiguousarray(plane, kind) for plane in planes])


def _ready(planes: tuple[Image | None, ...]) -> TypeGuard[tuple[Image, ...]]:
    """Return whether the kernels can take the planes without further ado, which most frames allow."""
    first = planes[0]
    if not isinstance(first, np.ndarray) or first.ndim != 2 or first.dtype not in (_UINT16, _FLOAT32):
        return False
    kind, shape = first.dtype, first.shape
    for plane in planes:
        if not isinstance(plane, np.ndarray) or plane.dtype != kind or plane.shape != shape:
            return False
        if not plane.flags.c_contiguous:
            return False
    return True


_UINT16, _FLOAT32 = np.dtype(np.uint16), np.dtype(np.float32)


@kernel(error_model="numpy", fastmath={"contract", "nsz"})
def _four_phase(
    c0: Any, c90: Any, c180: Any, c270: Any, limits: Any, settings: Any, images: Any, why: Any
) -> None:  # fmt: skip
    """Fill range, sigma and amplitude (3, H, W), and why.

    Everything is a choice between two values, so that the loops become vector instructions; limits are judged apart,
    because of samples in whole numbers twice as many fit into one.
    """
    c0, c90, c180, c270 = c0.reshape(-1), c90.reshape(-1), c180.reshape(-1), c270.reshape(-1)
    range_m, sigma_m, amplitude, why = (
        images[0].reshape(-1),
        images[1].reshape(-1),
        images[2].reshape(-1),
        why.reshape(-1),
    )
    _judge_limits(c0, c90, c180, c270, limits[0], limits[1], why)
    sign, offset, metres_per_rad, wrap_m = settings[0], settings[1], settings[2], _TWO_PI * settings[2]
    floor_variance, shot_per_level, shot_per_amplitude = settings[3], settings[4], settings[5]
    black, min_amplitude, max_variance = settings[6], settings[7], settings[8]
    for i in range(c0.size):
        s0, s90, s180, s270 = np.float32(c0[i]), np.float32(c90[i]), np.float32(c180[i]), np.float32(c270[i])
        real, imaginary = s0 - s180, s270 - s90
        square = real * real + imaginary * imaginary
        magnitude = np.sqrt(square)
        phase = sign * turns_of(imaginary, real) + offset  # Steinbäck 2016, eqs 2.2 and 3.13, in turns
        phase = phase + _ONE if phase < _ZERO else phase  # eq 3.14
        phase = phase - _ONE if phase >= _ONE else phase
        level = _QUARTER * ((s0 + s90) + (s180 + s270)) - black
        level = level if level > _ZERO else _ZERO
        variance = floor_variance + shot_per_level * level + shot_per_amplitude * _HALF * magnitude
        # d phase = (Re dIm - Im dRe) / (Re^2 + Im^2), and Re and Im each are the difference of two samples
        phase_variance = _TWO * variance / square
        reason = why[i]
        weak = (not phase_variance <= max_variance) | (_HALF * magnitude < min_amplitude)
        reason = _LOW_AMPLITUDE if weak & (reason == _VALID) else reason
        range_m[i] = wrap_m * phase  # eq 3.11
        sigma_m[i] = metres_per_rad * np.sqrt(phase_variance)
        amplitude[i] = _HALF * magnitude
        why[i] = reason
    if limits.itemsize > 2:
        _refuse_broken(range_m, sigma_m, amplitude, why)


@kernel
def _refuse_broken(range_m: Any, sigma_m: Any, amplitude: Any, why: Any) -> None:
    """Refuse what came from samples that are NaN or infinite, which only floating-point numbers can be."""
    for i in range(why.size):
        finite = amplitude[i] < _LARGEST
        range_m[i] = range_m[i] if finite else _NAN
        sigma_m[i] = sigma_m[i] if finite else _NAN
        amplitude[i] = amplitude[i] if finite else _NAN
        why[i] = why[i] if finite else _NOT_FINITE


@kernel
def _judge_limits(c0: Any, c90: Any, c180: Any, c270: Any, least: Any, most: Any, why: Any) -> None:
    for i in range(why.size):
        s0, s90, s180, s270 = c0[i], c90[i], c180[i], c270[i]
        largest, smallest = (
            _larger(_larger(s0, s90), _larger(s180, s270)),
            _smaller(_smaller(s0, s90), _smaller(s180, s270)),
        )
        reason = _NO_SIGNAL if largest == smallest else _VALID
        reason = _SATURATED if largest > most else reason
        why[i] = _SATURATED if (smallest < least) & (reason == _VALID) else reason


@kernel(inline="always")
def _larger(a: Any, b: Any) -> Any:
    """Return the larger one; unlike `max` without a case for NaN, which would cost the vector instructions."""
    return a if a > b else b


@kernel(inline="always")
def _smaller(a: Any, b: Any) -> Any:
    return a if a < b else b


def cw_phases(raw: RawFrame, camera: CwCamera) -> RangeImage:
    """Return range, standard deviation and amplitude from any number of phase steps at one modulation frequency.

    Planes phase_<step> (H, W) for each of `camera.phase_steps_deg`, whatever their order, spacing and number from three
    on: the phasor is their least-squares fit (`cw.phasor`), averaged over neighbours of the same surface if
    `phasor_filter` says so. sigma_m is the noise of every sample, propagated through fit, average and arctangent. Why
    is as in `cw_four_phase`, and FLYING for what no neighbour supports.
    Raises DataError for a missing or misshapen plane, UsageError for steps that do not make a phasor or several
    frequencies.
    """
    if camera.modulations_hz:
        raise UsageError(
            f"camera.modulations_hz = {[*camera.modulations_hz]}: ranging 'cw_phases' takes one frequency; use "
            "ranging = 'cw_multi_frequency'"
        )
    wavelength_m = 2 * math.pi * metres_per_radian(camera)
    return _decoded(raw, camera, (wavelength_m,), (0,), np.zeros(7, np.float32))


def cw_multi_frequency(raw: RawFrame, camera: CwCamera) -> RangeImage:
    """Return range, standard deviation and amplitude from two to four modulation frequencies, unwrapped (S-EFF-08).

    Planes f<k>_phase_<step> (H, W) for number k of `camera.modulations_hz` and each of `camera.phase_steps_deg`.
    Phasors as in `cw_phases`, all frequencies filtered together; then the likeliest number of wraps of all, refused
    (WRAPPED) where `unwrap_residual_sigmas` or `unwrap_error` are exceeded (`cw.unwrapping`). range_m lies within the
    unambiguous range of the combination, each frequency weighted by one over its variance; amplitude is the mean.
    Raises DataError for a missing or misshapen plane, UsageError for frequencies that cannot be combined.
    """
    together = combine(camera.modulations_hz, camera.speed_of_light_mps)
    wavelengths_m = tuple(together.unambiguous_m / p for p in together.wraps)
    return _decoded(raw, camera, wavelengths_m, order_of(together), plan_of(together, camera))


def _decoded(
    raw: RawFrame, camera: CwCamera, wavelengths_m: tuple[float, ...], order: Sequence[int], plan: Floats
) -> RangeImage:
    """Return the range image of frequencies whose phases repeat after `wavelengths_m`, taken in an order."""
    names, n_steps = plane_names(camera), len(camera.phase_steps_deg)
    planes = _samples(raw, [name for k in order for name in names[k * n_steps : (k + 1) * n_steps]])
    images, why = decode(planes, camera, tuple(wavelengths_m[k] for k in order), plan)
    if camera.pseudo_rows:
        why[: camera.pseudo_rows] = _SENSOR_FLAG
    return RangeImage(raw.time_s, images[0], images[1], images[2], why)


RANGING: dict[str, Callable[[RawFrame, CwCamera], RangeImage]] = {
    "cw_four_phase": cw_four_phase,
    "cw_phases": cw_phases,
    "cw_multi_frequency": cw_multi_frequency,
}
"""Ranging methods of continuous-wave cameras by name."""
