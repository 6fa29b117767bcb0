"""Ranging from shutter and tap samples: raw planes in, range with its standard deviation out."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.errors import DataError, UsageError
from rangecam.pulsed.pixel import damping, noise_variance, photon_noise, step_v
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.pulsed.signal import gate_windows, shutter_windows
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

_VALID, _NO_SIGNAL, _NOT_FINITE = np.uint8(Why.VALID), np.uint8(Why.NO_SIGNAL), np.uint8(Why.NOT_FINITE)
_LOW_AMPLITUDE, _SATURATED = np.uint8(Why.LOW_AMPLITUDE), np.uint8(Why.SATURATED)
_OUT_OF_RANGE, _SENSOR_FLAG = np.uint8(Why.OUT_OF_RANGE), np.uint8(Why.SENSOR_FLAG)
_MOST_ACCUMULATIONS = 255
_COMPILED = (np.float32, np.uint8)
_NONE = np.zeros((0, 0), np.float32)


def mdsi1(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from window a over window c: see `_mdsi` (König 2008, eqs 3.18, 5.4; E-K-03)."""
    return _mdsi(raw, camera, "ac", falling=True)


def mdsi2(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from window b over window c: see `_mdsi` (König 2008, eqs 3.19, 5.5; E-K-02)."""
    return _mdsi(raw, camera, "bc", falling=False)


def mdsi3(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from window a over the sum of a and b: see `_mdsi` (König 2008, eqs 3.20, 5.6; E-K-03)."""
    return _mdsi(raw, camera, "ab", falling=True)


def mdsi4(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from window b over the sum of a and b: see `_mdsi` (König 2008, eqs 3.21, 5.7; E-K-02)."""
    return _mdsi(raw, camera, "ba", falling=False)


def _mdsi(raw: RawFrame, camera: PulsedCamera, windows: str, falling: bool) -> RangeImage:
    """Return the range from the quotient of one shutter value and the whole signal.

    Planes: the two shutter_* (H, W) named by `windows`, V after correlated double sampling, and n_acc (H, W), the
    accumulations of both; `ambient` (H, W), V/s, the rate of the background signal, if the camera tells it.
    amplitude is the whole signal of one pulse, V: shutter values over n_acc and their damping. sigma_m propagates
    `pixel.noise_variance` of both values and their rounding. why is NOT_FINITE, NO_SIGNAL (n_acc 0), SENSOR_FLAG (n_acc
    above 255), SATURATED, LOW_AMPLITUDE or OUT_OF_RANGE. Raises DataError for a missing or misshapen plane.
    """
    names = (f"shutter_{windows[0]}", f"shutter_{windows[1]}", "n_acc")
    part, other, n_acc = (_plane(raw, name, names) for name in names)
    ambient = _plane(raw, "ambient", names) if "ambient" in raw.planes else _NONE
    tables, settings = _shutter_settings(camera, windows)
    images = _empty_images(part.shape)
    _shutter_quotient(part, other, n_acc, ambient, tables, settings, falling, "c" not in windows, *images)
    return RangeImage(raw.time_s, *images)


@lru_cache(maxsize=8)
def _shutter_settings(camera: PulsedCamera, windows: str) -> tuple[Floats, Floats]:
    """Return the tables of noise and what else the kernel needs of the camera, in its order."""
    opened = shutter_windows(camera)
    width_s = {name: closes - opens for name, (opens, closes) in opened.items()}
    pulse_s = camera.pulse_width_s
    # The time of flight at quotient 0 of a type b window, which is quotient 1 of a type a window (eqs 3.18-3.21 in the
    # general form of E-K-03): the pulse then ends as b opens.
    start_s = width_s["a"] - pulse_s - (camera.laser_delay_s - opened["a"][0])
    # Windows shorter than the pulse leave a part of the quotients out (eq 3.22; E-K-15).
    first, last = max(0.0, 1 - width_s["a"] / pulse_s), min(1.0, width_s["b"] / pulse_s)
    settings = np.array(
        [
            camera.speed_of_light_mps / 2 * pulse_s,
            camera.speed_of_light_mps / 2 * start_s + camera.offset_m,
            *_limits(camera, start_s + first * pulse_s, start_s + last * pulse_s),
            camera.far_margin_sigmas,
            camera.pixel.saturation_v * (1 - 1e-6),  # a float32 of the full scale counts as full
            camera.min_snr**2,
            camera.pixel.noise_threshold_v,
            float(photon_noise(1.0, camera.pixel)) ** 2,
            2 * width_s[windows[0]],
            2 * width_s[windows[1]],
            1 / camera.averages,
        ]
    )
    return _noise_tables(camera.pixel), settings


def _noise_tables(pixel: Pixel) -> Floats:
    """Return damping, dark variance (V2, at the output) and d2 n by number of accumulations: (256, 3)."""
    n = np.arange(_MOST_ACCUMULATIONS + 1)
    n[0] = 1  # never used: such pixels are NO_SIGNAL
    d = damping(n, pixel)
    return np.stack([d, noise_variance(0.0, n, 0.0, pixel) + step_v(pixel) ** 2 / 12, d**2 * n], axis=-1)


@njit(cache=True, nogil=True, error_model="numpy")
def _shutter_quotient(  # type: ignore[no-untyped-def]
    part, other, n_acc, ambient, tables, settings, falling, summed, range_m, sigma_m, amplitude, why
):
    """Fill the four output images; `summed`: the whole is part + other, else it is other."""
    part, other, n_acc, ambient = part.reshape(-1), other.reshape(-1), n_acc.reshape(-1), ambient.reshape(-1)
    range_m, sigma_m, amplitude, why = range_m.reshape(-1), sigma_m.reshape(-1), amplitude.reshape(-1), why.reshape(-1)
    scale_m, zero_m, low_m, high_m, end_m, margin, saturation_v, min_snr2 = settings[:8]
    threshold_v, volts_per_electron, part_s, other_s, share = settings[8:]
    for i in range(part.size):
        x, y, n = np.float64(part[i]), np.float64(other[i]), n_acc[i]
        background = max(np.float64(ambient[i]), 0.0) if ambient.size else 0.0
        range_m[i] = sigma_m[i] = amplitude[i] = np.nan
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(n) and np.isfinite(background)):
            why[i] = _NOT_FINITE
            continue
        if not 1 <= n < len(tables):
            why[i] = _NO_SIGNAL if n < 1 else _SENSOR_FLAG
            continue
        k = int(n)
        d, dark, d2n = tables[k, 0], tables[k, 1], tables[k, 2]
        variance_x = share * (dark + volts_per_electron * (d * max(x, 0.0) + d2n * part_s * background))
        variance_y = share * (dark + volts_per_electron * (d * max(y, 0.0) + d2n * other_s * background))
        whole, whole_variance = (x + y, variance_x + variance_y) if summed else (y, variance_y)
        amplitude[i] = whole / (d * n)
        if whole > 0:
            quotient = x / whole
            by_x = 1 - quotient if summed else 1.0
            range_m[i] = zero_m + scale_m * (1 - quotient if falling else quotient)  # eqs 3.18-3.21
            sigma_m[i] = scale_m / whole * np.sqrt(by_x**2 * variance_x + quotient**2 * variance_y)  # eqs 5.4-5.7
        if max(x, y) >= saturation_v:
            why[i] = _SATURATED
        elif not (whole > 0 and whole >= threshold_v and whole * whole >= min_snr2 * whole_variance):
            why[i] = _LOW_AMPLITUDE
        else:
            inside = low_m <= range_m[i] <= high_m and range_m[i] + margin * sigma_m[i] <= end_m
            why[i] = _VALID if inside else _OUT_OF_RANGE


def three_tap(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from three gates that follow each other, the second opening as the pulse leaves (or later).

    Planes tap_1..3 (H, W), counts; dark_1..3 are taken off where there are any; tap_std_1..3, standard deviations of
    the taps, replace the noise model of `camera.taps`. With n_i = tap_i - dark_i:
    - `pulse_lead_s` = 0: tap 1 sees background only, which leaves the others, and the pulse is shared by taps 2 and 3:
      range = c Tp/2 (n3 - n1) / (n2 + n3 - 2 n1), less c/2 (Tp - gate width).
    - otherwise near light falls into tap 1, too, and the dark images must hold all of the background: the pulse begins
      in gate 1 if n1 > n3 (so early is -Tp n1 / (n1 + n2 + n3)), else it ends in gate 3 as above with n1 counted in.
    amplitude is the light of the pulse, counts. why is NOT_FINITE, NO_SIGNAL (all taps zero), SATURATED, LOW_AMPLITUDE
    or OUT_OF_RANGE. Raises DataError for a missing or misshapen plane.
    """
    names = ("tap_1", "tap_2", "tap_3")
    t1, t2, t3 = (_plane(raw, name, names) for name in names)
    (d1, d2, d3), (s1, s2, s3) = (
        [_plane(raw, f"{kind}_{i}", names) if f"{kind}_1" in raw.planes else _NONE for i in (1, 2, 3)]
        for kind in ("dark", "tap_std")
    )
    early, settings, images = camera.pulse_lead_s > 0, _gate_settings(camera), _empty_images(t1.shape)
    _gate_quotient(t1, t2, t3, d1, d2, d3, s1, s2, s3, settings, early, *images)
    return RangeImage(raw.time_s, *images)


@lru_cache(maxsize=8)
def _gate_settings(camera: PulsedCamera) -> Floats:
    """Return what the kernel needs of the camera, in its order; raises UsageError for gates that lose near light."""
    pulse_s, closes_s = camera.pulse_width_s, gate_windows(camera)["2"][1]
    if camera.pulse_lead_s > 0 and closes_s > pulse_s:
        raise UsageError(
            f"camera.gate_width_s = {closes_s:g}: with camera.pulse_lead_s > 0 it must not exceed "
            f"camera.pulse_width_s = {pulse_s:g}, or pulses that lie within gate 2 all look alike"
        )
    nearest_s = max(closes_s - pulse_s, 0.0) if camera.pulse_lead_s == 0 else -closes_s
    farthest_s = closes_s + min(closes_s - pulse_s, 0.0)
    noise = camera.taps
    return np.array(
        [
            camera.speed_of_light_mps / 2 * pulse_s,
            camera.speed_of_light_mps / 2 * camera.pulse_lead_s + camera.offset_m,
            closes_s / pulse_s - 1,
            *_limits(camera, camera.pulse_lead_s + nearest_s, camera.pulse_lead_s + farthest_s),
            camera.far_margin_sigmas,
            noise.saturation_counts,
            camera.min_snr**2,
            noise.noise_threshold_counts,
            noise.black_level_counts,
            noise.read_noise_counts**2 + 1 / 12,
            noise.shot_noise_counts2_per_count,
            1 / noise.dark_frames,
            1 / camera.averages,
        ]
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _gate_quotient(  # type: ignore[no-untyped-def]
    t1, t2, t3, d1, d2, d3, s1, s2, s3, settings, early, range_m, sigma_m, amplitude, why
):
    """Fill the four output images; `early`: tap 1 holds light of the pulse."""
    t1, t2, t3 = t1.reshape(-1), t2.reshape(-1), t3.reshape(-1)
    d1, d2, d3 = d1.reshape(-1), d2.reshape(-1), d3.reshape(-1)
    s1, s2, s3 = s1.reshape(-1), s2.reshape(-1), s3.reshape(-1)
    range_m, sigma_m, amplitude, why = range_m.reshape(-1), sigma_m.reshape(-1), amplitude.reshape(-1), why.reshape(-1)
    scale_m, zero_m, gate_minus_one, low_m, high_m, end_m, margin = settings[:7]
    saturation, min_snr2, threshold, black, read_variance, per_count, dark_share, share = settings[7:]
    noise = (black, read_variance, per_count, dark_share, share)
    for i in range(t1.size):
        range_m[i] = sigma_m[i] = amplitude[i] = np.nan
        n1, v1 = _tap(t1, d1, s1, i, noise)
        n2, v2 = _tap(t2, d2, s2, i, noise)
        n3, v3 = _tap(t3, d3, s3, i, noise)
        if not (np.isfinite(n1 + n2 + n3) and np.isfinite(v1 + v2 + v3)):
            why[i] = _NOT_FINITE
            continue
        if t1[i] == 0 and t2[i] == 0 and t3[i] == 0:
            why[i] = _NO_SIGNAL
            continue
        if early:
            whole, variance = n1 + n2 + n3, v1 + v2 + v3
            first = n1 > n3
            inverse = 1 / whole
            quotient = (-n1 if first else n3) * inverse
            by_1, by_2, by_3 = -quotient - (1 if first else 0), -quotient, (0 if first else 1) - quotient
        else:
            first = False
            whole, variance = n2 + n3 - 2 * n1, v2 + v3 + 4 * v1
            inverse = 1 / whole
            quotient = (n3 - n1) * inverse
            by_1, by_2, by_3 = 2 * quotient - 1, -quotient, 1 - quotient
        amplitude[i] = whole
        if whole > 0:
            range_m[i] = zero_m + scale_m * (quotient + (0.0 if first else gate_minus_one))
            sigma_m[i] = scale_m * inverse * np.sqrt(by_1**2 * v1 + by_2**2 * v2 + by_3**2 * v3)
        if max(t1[i], t2[i], t3[i]) >= saturation:
            why[i] = _SATURATED
        elif not (whole > 0 and whole >= threshold and whole * whole >= min_snr2 * variance):
            why[i] = _LOW_AMPLITUDE
        else:
            inside = low_m <= range_m[i] <= high_m and range_m[i] + margin * sigma_m[i] <= end_m
            why[i] = _VALID if inside else _OUT_OF_RANGE


@njit(cache=True, nogil=True, inline="always")
def _tap(tap, dark, std, i, noise):  # type: ignore[no-untyped-def]
    """Return the light of one gate, counts, and its variance."""
    black, read_variance, variance_per_count, dark_share, share = noise
    value = np.float64(tap[i])
    if std.size:
        variance = std[i] ** 2 + 1 / 12  # a converter that always shows the same code still rounds
    else:
        variance = share * (read_variance + variance_per_count * max(value - black, 0.0))
    if dark.size:
        value -= dark[i]
        variance += dark_share * (read_variance + variance_per_count * max(dark[i] - black, 0.0))
    return value, variance


def _plane(raw: RawFrame, name: str, needed: tuple[str, ...]) -> Image:
    """Return a contiguous plane of a type that the kernels are compiled for.

    Raises DataError if it is missing, does not fit the first needed one, or does not hold real numbers.
    """
    if name not in raw.planes:
        raise DataError(
            f"frame {raw.frame_id}: plane '{name}' is missing; this method needs {', '.join(needed)}, "
            f"the frame has {', '.join(sorted(raw.planes)) or 'none'}"
        )
    plane, shape = np.asarray(raw.planes[name]), np.shape(raw.planes[needed[0]])
    if plane.ndim != 2 or plane.shape != shape:
        raise DataError(
            f"frame {raw.frame_id}: plane '{name}' has shape {plane.shape}; it must be an image (rows, columns) "
            f"of the shape of '{needed[0]}', {shape}"
        )
    if plane.dtype.kind not in "uif":
        raise DataError(f"frame {raw.frame_id}: plane '{name}' holds {plane.dtype}; it must hold real numbers")
    return np.ascontiguousarray(plane, plane.dtype if plane.dtype in _COMPILED else np.float64)


def _limits(camera: PulsedCamera, nearest_s: float, farthest_s: float) -> tuple[float, float, float]:
    """Return the interval of valid ranges and the end of the method's own, m, from its times of flight."""
    low_m, end_m = (camera.speed_of_light_mps / 2 * s + camera.offset_m for s in (nearest_s, farthest_s))
    high_m = end_m if camera.max_range_m is None else min(end_m, camera.max_range_m)
    return max(low_m, camera.min_range_m), high_m, end_m


def _empty_images(shape: tuple[int, ...]) -> tuple[Floats, Floats, Floats, NDArray[np.uint8]]:
    range_m, sigma_m, amplitude = np.empty((3, *shape), np.float32)
    return range_m, sigma_m, amplitude, np.empty(shape, np.uint8)


RANGING: dict[str, Callable[[RawFrame, PulsedCamera], RangeImage]] = {
    "mdsi1": mdsi1,
    "mdsi2": mdsi2,
    "mdsi3": mdsi3,
    "mdsi4": mdsi4,
    "three_tap": three_tap,
}
"""Ranging methods of pulsed cameras by name."""
