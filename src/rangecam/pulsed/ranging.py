"""Ranging from shutter and tap samples: raw planes in, range with its standard deviation out."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.errors import UsageError
from rangecam.planes import plane_of
from rangecam.pulsed.pixel import damping, noise_variance, photon_noise, step_v
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.pulsed.signal import gate_windows, shutter_windows
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

_VALID, _NO_SIGNAL, _NOT_FINITE = np.uint8(Why.VALID), np.uint8(Why.NO_SIGNAL), np.uint8(Why.NOT_FINITE)
_LOW_AMPLITUDE, _SATURATED = np.uint8(Why.LOW_AMPLITUDE), np.uint8(Why.SATURATED)
_OUT_OF_RANGE, _SENSOR_FLAG = np.uint8(Why.OUT_OF_RANGE), np.uint8(Why.SENSOR_FLAG)
_MOST_ACCUMULATIONS = 255
_COMPILED = (np.dtype(np.float32), np.dtype(np.uint8))
_LARGEST = 1e30


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
    part, other, n_acc = [image_plane(raw, name, names) for name in names]
    ambient = image_plane(raw, "ambient", names) if "ambient" in raw.planes else np.zeros(part.shape, np.float32)
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
            *range_limits(camera, start_s + first * pulse_s, start_s + last * pulse_s),
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
    """Return by number of accumulations: damping d, dark variance (V2, at the output), d2 n and 1 / (d n): (256, 4)."""
    n = np.arange(_MOST_ACCUMULATIONS + 1)
    n[0] = 1  # never used: such pixels are NO_SIGNAL
    d = damping(n, pixel)
    dark = noise_variance(0.0, n, 0.0, pixel) + step_v(pixel) ** 2 / 12
    return np.stack([d, dark, d**2 * n, 1 / (d * n)], axis=-1)


@njit(cache=True, nogil=True, error_model="numpy")
def _shutter_quotient(
    part: Any,
    other: Any,
    n_acc: Any,
    ambient: Any,
    tables: Any,
    settings: Any,
    falling: Any,
    summed: Any,
    range_m: Any,
    sigma_m: Any,
    amplitude: Any,
    why: Any,
) -> Any:
    """Fill the four output images; `summed`: the whole is part + other, else it is other.

    The first loop looks the tables up; the second has selects instead of branches, and becomes vector instructions.
    """
    part, other, n_acc, ambient = part.reshape(-1), other.reshape(-1), n_acc.reshape(-1), ambient.reshape(-1)
    range_m, sigma_m, amplitude, why = range_m.reshape(-1), sigma_m.reshape(-1), amplitude.reshape(-1), why.reshape(-1)
    scale_m, zero_m, low_m, high_m, end_m, margin, saturation_v, min_snr2 = settings[:8]
    threshold_v, volts_per_electron, part_s, other_s, share = settings[8:]
    rows = np.empty((4, part.size))
    damping_of, dark_of, d2n_of, per_pulse_of = rows[0], rows[1], rows[2], rows[3]
    for i in range(part.size):
        n = n_acc[i]
        known = 1 <= n < len(tables)
        k = np.intp(n) if known else 0
        damping_of[i], dark_of[i], d2n_of[i], per_pulse_of[i] = tables[k, 0], tables[k, 1], tables[k, 2], tables[k, 3]
        why[i] = _VALID if known else _NO_SIGNAL if n < 1 else _SENSOR_FLAG if n >= len(tables) else _NOT_FINITE
    start_m, slope_m = (zero_m + scale_m, -scale_m) if falling else (zero_m, scale_m)
    with_part = 1.0 if summed else 0.0
    for i in range(part.size):
        finite = abs(part[i]) + abs(other[i]) + abs(ambient[i]) < _LARGEST
        x, y = np.float64(part[i] if finite else 0), np.float64(other[i] if finite else 0)
        ambient_vps = np.float64(ambient[i] if finite and ambient[i] > 0 else 0)
        d, dark, d2n = damping_of[i], dark_of[i], d2n_of[i]
        variance_x = share * (dark + volts_per_electron * (d * (x if x > 0 else 0.0) + d2n * part_s * ambient_vps))
        variance_y = share * (dark + volts_per_electron * (d * (y if y > 0 else 0.0) + d2n * other_s * ambient_vps))
        whole, whole_variance = with_part * x + y, with_part * variance_x + variance_y
        inverse = 1 / (whole if whole > 0 else 1.0)
        quotient = x * inverse
        by_x = 1 - with_part * quotient
        distance_m = start_m + slope_m * quotient  # eqs 3.18-3.21
        deviation_m = scale_m * inverse * np.sqrt(by_x**2 * variance_x + quotient**2 * variance_y)  # eqs 5.4-5.7
        inside = (low_m <= distance_m) & (distance_m <= high_m) & (distance_m + margin * deviation_m <= end_m)
        enough = (whole > 0) & (whole >= threshold_v) & (whole * whole >= min_snr2 * whole_variance)
        reason = _VALID if inside else _OUT_OF_RANGE
        reason = reason if enough else _LOW_AMPLITUDE
        reason = _SATURATED if (x >= saturation_v) | (y >= saturation_v) else reason
        reason = reason if finite else _NOT_FINITE
        known = why[i] == _VALID
        read = finite & known
        usable = read & (whole > 0)
        range_m[i] = distance_m if usable else np.nan
        sigma_m[i] = deviation_m if usable else np.nan
        amplitude[i] = whole * per_pulse_of[i] if read else np.nan
        why[i] = reason if known else why[i]


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
    t1, t2, t3 = (image_plane(raw, name, names) for name in names)
    none = np.zeros(t1.shape, np.float32)
    dark, std = (f"{kind}_1" in raw.planes for kind in ("dark", "tap_std"))
    d1, d2, d3 = (image_plane(raw, f"dark_{i}", names) if dark else none for i in (1, 2, 3))
    s1, s2, s3 = (image_plane(raw, f"tap_std_{i}", names) if std else none for i in (1, 2, 3))
    early, images = camera.pulse_lead_s > 0, _empty_images(t1.shape)
    _gate_quotient(t1, t2, t3, d1, d2, d3, s1, s2, s3, _gate_settings(camera, dark), early, std, *images)
    return RangeImage(raw.time_s, *images)


@lru_cache(maxsize=8)
def _gate_settings(camera: PulsedCamera, dark: bool) -> Floats:
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
            *range_limits(camera, camera.pulse_lead_s + nearest_s, camera.pulse_lead_s + farthest_s),
            camera.far_margin_sigmas,
            noise.saturation_counts,
            camera.min_snr**2,
            noise.noise_threshold_counts,
            noise.black_level_counts,
            noise.read_noise_counts**2 + 1 / 12,
            noise.shot_noise_counts2_per_count,
            1 / noise.dark_frames if dark else 0.0,
            1 / camera.averages,
        ]
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _gate_quotient(
    t1: Any,
    t2: Any,
    t3: Any,
    d1: Any,
    d2: Any,
    d3: Any,
    s1: Any,
    s2: Any,
    s3: Any,
    settings: Any,
    early: Any,
    measured: Any,
    range_m: Any,
    sigma_m: Any,
    amplitude: Any,
    why: Any,
) -> Any:
    """Fill the four output images; `early`: tap 1 holds light of the pulse; `measured`: s1..3 are standard deviations.

    Selects instead of branches, so that the loop becomes vector instructions.
    """
    t1, t2, t3 = t1.reshape(-1), t2.reshape(-1), t3.reshape(-1)
    d1, d2, d3 = d1.reshape(-1), d2.reshape(-1), d3.reshape(-1)
    s1, s2, s3 = s1.reshape(-1), s2.reshape(-1), s3.reshape(-1)
    range_m, sigma_m, amplitude, why = range_m.reshape(-1), sigma_m.reshape(-1), amplitude.reshape(-1), why.reshape(-1)
    scale_m, zero_m, gate_minus_one, low_m, high_m, end_m, margin = settings[:7]
    saturation, min_snr2, threshold, black, read_variance, per_count, dark_share, share = settings[7:]
    ambient_share = 0.0 if early else 1.0
    for i in range(t1.size):
        finite = abs(t1[i]) + abs(t2[i]) + abs(t3[i]) + abs(d1[i]) + abs(d2[i]) + abs(d3[i]) < _LARGEST
        finite = finite & (abs(s1[i]) + abs(s2[i]) + abs(s3[i]) < _LARGEST)
        a1, a2, a3 = np.float64(t1[i]), np.float64(t2[i]), np.float64(t3[i])
        b1, b2, b3 = np.float64(d1[i]), np.float64(d2[i]), np.float64(d3[i])
        if measured:
            v1, v2, v3 = _squared(s1[i]), _squared(s2[i]), _squared(s3[i])
        else:
            v1 = share * _modelled(a1 - black, read_variance, per_count)
            v2 = share * _modelled(a2 - black, read_variance, per_count)
            v3 = share * _modelled(a3 - black, read_variance, per_count)
        v1 += dark_share * _modelled(b1 - black, read_variance, per_count)
        v2 += dark_share * _modelled(b2 - black, read_variance, per_count)
        v3 += dark_share * _modelled(b3 - black, read_variance, per_count)
        n1, n2, n3 = a1 - b1, a2 - b2, a3 - b3
        # Tap 1 is light of the pulse, or the background that the others hold as well.
        first = early & (n1 > n3)
        from_1, from_3 = (1.0 if first else ambient_share), (0.0 if first else 1.0)
        by_tap_1 = 1 - 3 * ambient_share
        whole, variance = n2 + n3 + by_tap_1 * n1, v2 + v3 + by_tap_1**2 * v1
        inverse = 1 / (whole if whole > 0 else 1.0)
        quotient = (from_3 * n3 - from_1 * n1) * inverse
        by_1, by_2, by_3 = -from_1 - by_tap_1 * quotient, -quotient, from_3 - quotient
        distance_m = zero_m + scale_m * (quotient + (0.0 if first else gate_minus_one))
        deviation_m = scale_m * inverse * np.sqrt(by_1**2 * v1 + by_2**2 * v2 + by_3**2 * v3)
        usable = finite & (whole > 0)
        inside = (low_m <= distance_m) & (distance_m <= high_m) & (distance_m + margin * deviation_m <= end_m)
        enough = (whole > 0) & (whole >= threshold) & (whole * whole >= min_snr2 * variance)
        reason = _VALID if inside else _OUT_OF_RANGE
        reason = reason if enough else _LOW_AMPLITUDE
        reason = _SATURATED if (a1 >= saturation) | (a2 >= saturation) | (a3 >= saturation) else reason
        reason = _NO_SIGNAL if (a1 == 0) & (a2 == 0) & (a3 == 0) else reason
        range_m[i] = distance_m if usable else np.nan
        sigma_m[i] = deviation_m if usable else np.nan
        amplitude[i] = whole if finite else np.nan
        why[i] = reason if finite else _NOT_FINITE


@njit(cache=True, nogil=True, inline="always")
def _modelled(light: Any, read_variance: Any, per_count: Any) -> Any:
    """Return the variance of a tap by the light in it."""
    return read_variance + per_count * (light if light > 0 else 0.0)


@njit(cache=True, nogil=True, inline="always")
def _squared(sigma: Any) -> Any:
    """Return a measured variance; a converter that always shows the same code still rounds."""
    return np.float64(sigma) ** 2 + 1 / 12


def image_plane(raw: RawFrame, name: str, needed: tuple[str, ...]) -> Image:
    """Return a contiguous plane of a type that the kernels are compiled for (see `plane_of`)."""
    plane = plane_of(raw, name, needed)
    return np.ascontiguousarray(plane, None if plane.dtype in _COMPILED else np.float64)


def range_limits(camera: PulsedCamera, nearest_s: float, farthest_s: float) -> tuple[float, float, float]:
    """Return the interval of valid ranges and the end of the method's own, m, from its times of flight."""
    low_m, end_m = (camera.speed_of_light_mps / 2 * s + camera.offset_m for s in (nearest_s, farthest_s))
    high_m = end_m if camera.max_range_m is None else min(end_m, camera.max_range_m)
    return max(low_m, camera.min_range_m), high_m, end_m


def _empty_images(shape: tuple[int, ...]) -> tuple[Floats, Floats, Floats, NDArray[np.uint8]]:
    single = np.float32
    return np.empty(shape, single), np.empty(shape, single), np.empty(shape, single), np.empty(shape, np.uint8)


RANGING: dict[str, Callable[[RawFrame, PulsedCamera], RangeImage]] = {
    "mdsi1": mdsi1,
    "mdsi2": mdsi2,
    "mdsi3": mdsi3,
    "mdsi4": mdsi4,
    "three_tap": three_tap,
}
"""Ranging methods of pulsed cameras by name."""
