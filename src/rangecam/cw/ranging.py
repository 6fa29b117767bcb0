"""Ranging from correlation samples: raw phase images in, range with its standard deviation out."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.phasor import average, demodulate, filter_rule, harmonic_weights, keep, noise_model
from rangecam.cw.phasor import turns as turns_of
from rangecam.cw.sequence import plane_names
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.cw.unwrapping import combine, order_of, plan_of, unwrap, unwrap_by_neighbours
from rangecam.errors import UsageError
from rangecam.planes import plane_of
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

PLANES = ("phase_0", "phase_90", "phase_180", "phase_270")

_VALID, _NO_SIGNAL, _NOT_FINITE = np.uint8(Why.VALID), np.uint8(Why.NO_SIGNAL), np.uint8(Why.NOT_FINITE)
_LOW_AMPLITUDE, _SATURATED = np.uint8(Why.LOW_AMPLITUDE), np.uint8(Why.SATURATED)
_SENSOR_FLAG, _ZERO, _ONE = np.uint8(Why.SENSOR_FLAG), np.float32(0), np.float32(1)
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
    SATURATED, LOW_AMPLITUDE or, in `pseudo_rows`, SENSOR_FLAG. With a `phasor_filter` it is `cw_phases`.
    Raises DataError for a missing or misshapen plane.
    """
    if camera.phasor_filter != "off":
        return cw_phases(raw, camera)
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
    return _decode(raw, camera, (wavelength_m,), (0,), np.zeros(0, np.float32))


def cw_multi_frequency(raw: RawFrame, camera: CwCamera) -> RangeImage:
    """Return range, standard deviation and amplitude from two or three modulation frequencies, unwrapped (S-EFF-08).

    Planes f<k>_phase_<step> (H, W) for number k of `camera.modulations_hz` and each of `camera.phase_steps_deg`.
    Phasors as in `cw_phases`, all frequencies filtered together; then the likeliest number of wraps of all, refused
    (WRAPPED) where `unwrap_residual_sigmas` or `unwrap_error` are exceeded (`cw.unwrapping`). range_m lies within the
    unambiguous range of the combination, each frequency weighted by one over its variance; amplitude is the mean.
    Raises DataError for a missing or misshapen plane, UsageError for frequencies that cannot be combined.
    """
    together = combine(camera.modulations_hz, camera.speed_of_light_mps)
    wavelengths_m = tuple(together.unambiguous_m / p for p in together.wraps)
    return _decode(raw, camera, wavelengths_m, tuple(order_of(together)), plan_of(together, camera))


def _decode(
    raw: RawFrame, camera: CwCamera, wavelengths_m: tuple[float, ...], order: tuple[int, ...], plan: Floats
) -> RangeImage:
    """Return the range image of one or several frequencies whose phases repeat after `wavelengths_m`."""
    weights, names = harmonic_weights(camera.phase_steps_deg), plane_names(camera)
    planes = [plane_of(raw, name, names) for name in names]
    kind = _UINT16 if all(plane.dtype == _UINT16 for plane in planes) else _FLOAT32
    shape, why = planes[0].shape, np.empty(planes[0].shape, np.uint8)
    images = np.empty((3, *shape), np.float32)
    spatially = len(order) > 1 and camera.unwrap_spatially
    turns = np.empty((2, len(order), shape[0] if spatially else 1, shape[1]), np.float32)
    reach, rule = filter_rule(camera)
    limits = [camera.phase_sign, camera.min_amplitude, camera.max_phase_sigma_rad**2, wavelengths_m[0]]
    limits += [camera.offset_m / wavelengths_m[k] for k in order]
    _decode_rows(
        tuple(np.ascontiguousarray(plane, kind) for plane in planes),
        (weights, noise_model(camera), rule, np.array(limits, np.float32), plan),
        (reach, camera.pseudo_rows),
        np.array(order),
        turns,
        images,
        why,
    )
    if spatially:
        given = np.empty(shape, bool)
        while unwrap_by_neighbours(turns[0], turns[1], plan, images[0], images[1], why, given):
            pass
    if camera.pseudo_rows:
        why[: camera.pseudo_rows] = _SENSOR_FLAG
    return RangeImage(raw.time_s, images[0], images[1], images[2], why)


@njit(cache=True, nogil=True, error_model="numpy")
def _decode_rows(
    planes: Any, model: Any, extent: tuple[int, int], order: Any, turns: Any, images: Any, why: Any
) -> None:
    """Decode row by row; of the phasors only as many rows are kept as the filter looks at."""
    weights, noise, rule, limits, plan = model
    reach, pseudo_rows = extent
    height, width = why.shape
    n_frequencies, n_rows = len(order), 2 * reach + 1
    padded = width + 2 * reach
    units = np.zeros((n_rows, 2 * n_frequencies, padded), np.float32)
    sizes = np.zeros((n_rows, 2 * n_frequencies, padded), np.float32)
    spread = np.full((n_rows, 2, padded), np.float32(np.nan))
    mean, variance = np.empty((2 * n_frequencies, width), np.float32), np.empty((n_frequencies, width), np.float32)
    scratch = np.empty((7, width), np.float32)
    rows = np.empty(n_rows, np.int64)
    inner = slice(reach, reach + width)
    for step in range(height + reach):
        slot, y = step % n_rows, step - reach
        if step < height:
            samples = (scratch, units[slot, :, inner], sizes[slot, :, inner], spread[slot, :, inner], why[step])
            demodulate(planes, step, weights, noise, *samples)
        if step < pseudo_rows or step >= height:
            spread[slot] = np.float32(np.nan)
        if y < 0:
            continue
        if reach == 0:
            keep(units[slot], sizes[slot], mean, variance)
        else:
            for j in range(n_rows):
                rows[j] = (step - n_rows + 1 + j) % n_rows
            inside = min(y, reach) + min(height - 1 - y, reach) + 1
            average(rows, units, sizes, spread, rule, inside, scratch, mean, variance, why[y])
        row = y if turns.shape[2] > 1 else 0
        cycles, certainty = turns[0, :, row], turns[1, :, row]
        _phases(mean, variance, order, limits, plan, cycles, certainty, images[2, y], why[y])
        if n_frequencies == 1:
            _single(cycles[0], certainty[0], limits[3], images[0, y], images[1, y])
        else:
            unwrap(cycles, certainty, plan, scratch, images[0, y], images[1, y], why[y])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _phases(
    mean: Any, variance: Any, order: Any, limits: Any, plan: Any, cycles: Any, certainty: Any, amplitude: Any, why: Any
) -> None:
    """Fill the phases of a row in turns, one over their variance, and the mean amplitude; refuse weak pixels."""
    sign, least, most = limits[0], limits[1], limits[2]
    error = plan[6] if plan.size else _ZERO
    share, per_turn = _ONE / np.float32(len(order)), np.float32(0.25 / math.pi**2)
    amplitude[:] = _ZERO
    for j in range(len(order)):
        real, imaginary, across = mean[2 * order[j]], mean[2 * order[j] + 1], variance[order[j]]
        offset, u, weight = limits[4 + j], cycles[j], certainty[j]
        for i in range(amplitude.size):
            phase = sign * turns_of(imaginary[i], real[i]) + offset
            phase -= np.floor(phase)
            u[i] = _ZERO if phase >= _ONE else phase
            square = real[i] * real[i] + imaginary[i] * imaginary[i]
            size, squared_sigma = np.sqrt(square), across[i] / square
            weight[i] = _ONE / (squared_sigma * per_turn + error)
            amplitude[i] += share * size
            weak = (not squared_sigma <= most) | (size < least)
            why[i] = _LOW_AMPLITUDE if weak & (why[i] == _VALID) else why[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _single(cycles: Any, certainty: Any, wavelength_m: Any, range_m: Any, sigma_m: Any) -> None:
    for i in range(range_m.size):
        range_m[i] = wavelength_m * cycles[i]
        sigma_m[i] = wavelength_m / np.sqrt(certainty[i])


RANGING: dict[str, Callable[[RawFrame, CwCamera], RangeImage]] = {
    "cw_four_phase": cw_four_phase,
    "cw_phases": cw_phases,
    "cw_multi_frequency": cw_multi_frequency,
}
"""Ranging methods of continuous-wave cameras by name."""
