"""Ranging from windows or pulses that known delays shift: gradient methods, CSI and DCSI (König 2008, 3.4.2, 3.4.3).

The simulated camera takes their planes with `camera.shutters` = aa, bb, a_delayed, ab_delayed. `n_acc` and `ambient`
are as in `ranging`; so is why: NOT_FINITE, NO_SIGNAL, SENSOR_FLAG, SATURATED, LOW_AMPLITUDE or OUT_OF_RANGE.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rangecam.errors import UsageError
from rangecam.pulsed.pixel import damping, noise_variance, step_v
from rangecam.pulsed.ranging import image_plane, range_limits
from rangecam.pulsed.settings import PulsedCamera
from rangecam.pulsed.signal import correlation_curve, gradient_windows, laser_delays, shutter_windows
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

_APEX_STEPS = 101


class Samples(NamedTuple):
    """Shutter values and their variances, V and V2 (S, H, W); what one pulse of them is (H, W); why refused (H, W)."""

    value_v: Floats
    variance_v2: Floats
    per_pulse: Floats
    why: NDArray[np.uint8]


def gradient1(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from two windows that open together, the second closing earlier (König 2008, eq 3.23).

    Planes shutter_a1, shutter_a2. sigma_m: see `_gradient`. Behind the end of window a2 the quotient keeps its limit.
    """
    (opens, closes), second = gradient_windows(camera, "a")
    step_s = closes - second[1]
    nearest_s = max(opens, closes - camera.pulse_width_s) - camera.laser_delay_s
    limits_m = range_limits(camera, nearest_s, second[1] - camera.laser_delay_s)
    samples = read_samples(raw, camera, ("shutter_a1", "shutter_a2"), [closes - opens, second[1] - second[0]])
    return _gradient(raw, camera, samples, closes - camera.laser_delay_s, -step_s, limits_m)


def gradient2(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from two windows as b, the second opening later (König 2008, eq 3.24 corrected: E-K-04).

    Planes shutter_b1, shutter_b2. With `camera.gating_s` what is near is not seen (5.2.1.3); before window b2 sees the
    object the quotient stays at its limit: see `gating_ranges_m`. sigma_m: see `_gradient`.
    """
    first, second = gradient_windows(camera, "b")
    per_second = camera.speed_of_light_mps / 2
    gated_m, full_m, farthest_m = gating_ranges_m(camera)
    limits_m = range_limits(camera, full_m / per_second, farthest_m / per_second)
    samples = read_samples(raw, camera, ("shutter_b1", "shutter_b2"), [first[1] - first[0], second[1] - second[0]])
    return _gradient(raw, camera, samples, gated_m / per_second, second[0] - first[0], limits_m)


def gating_ranges_m(camera: PulsedCamera) -> tuple[float, float, float]:
    """Return d_G, up to which gradient2 sees nothing, d_T, from which on it measures, and its end d_max, m.

    König 2008, eqs 5.11-5.13; the end is given by the shorter of window and pulse (E-K-15).
    """
    (opens, closes), _ = gradient_windows(camera, "b")
    gated_s = opens - camera.pulse_width_s - camera.laser_delay_s  # eq 5.11
    full_s = gated_s + camera.gradient_step_s  # eq 5.12
    farthest_s = gated_s + min(closes - opens, camera.pulse_width_s)  # eq 5.13
    per_second = camera.speed_of_light_mps / 2
    return per_second * gated_s, per_second * full_s, per_second * farthest_s


def _gradient(
    raw: RawFrame,
    camera: PulsedCamera,
    samples: Samples,
    start_s: float,
    step_s: float,
    limits_m: tuple[float, float, float],
) -> RangeImage:
    """Return the range where the first signal is U1 / (U1 - U2) steps from where it vanishes, at `start_s` of flight.

    step_s: by how much the second signal vanishes later; negative if earlier. sigma_m is that of eqs 5.8 and 5.9 with
    the difference, not the sum, below the line, and each derivative with the other signal (E-K-12). amplitude is the
    whole signal of one pulse, V.
    """
    (first_v, second_v), (first_v2, second_v2) = samples.value_v, samples.variance_v2
    apart_v, apart_v2 = first_v - second_v, first_v2 + second_v2
    start_m, scale_m = (camera.speed_of_light_mps / 2 * time_s for time_s in (start_s, step_s))
    inverse = 1 / np.where(apart_v > 0, apart_v, np.inf)
    distance_m = start_m + scale_m * first_v * inverse + camera.offset_m  # eqs 3.23, 3.24
    sigma_m = abs(scale_m) * inverse**2 * np.sqrt(second_v**2 * first_v2 + first_v**2 * second_v2)  # eqs 5.8, 5.9
    low_m, high_m, end_m = limits_m
    margin_m = camera.far_margin_sigmas * sigma_m
    clear = distance_m + margin_m <= end_m if step_s < 0 else distance_m - margin_m >= low_m
    inside = (low_m <= distance_m) & (distance_m <= high_m) & clear
    whole_v = apart_v * (camera.pulse_width_s / abs(step_s))
    enough = strong_enough(whole_v, apart_v, apart_v2, camera)
    return compose(raw, samples, distance_m, sigma_m, whole_v, enough, inside)


def csi(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from the laser delay at which window a collects most (König 2008, eq 3.25).

    Planes shutter_a_0.. of window a, one for each of `laser_delays`. The maximum is interpolated: two lines of opposite
    slopes through the largest value and its neighbours, which is exact for an ideal pulse as long as its window.
    Other shapes have a rounder or flatter top; the error of that (root mean square over all places of the maximum
    between two delays) is part of sigma_m, besides the noise. amplitude is the largest value of one pulse, V.
    """
    (opens, closes), delays_s = shutter_windows(camera)["a"], laser_delays(camera)
    count, step_s = camera.delay_count, camera.delay_step_s
    names = tuple(f"shutter_a_{i}" for i in range(count))
    samples = read_samples(raw, camera, names, [closes - opens] * count)
    at = samples.value_v.argmax(axis=0)
    middle = np.clip(at, 1, count - 2)
    (left_v, left_v2), (top_v, top_v2), (right_v, right_v2) = (
        (pick(samples.value_v, middle + k), pick(samples.variance_v2, middle + k)) for k in (-1, 0, 1)
    )
    fall_v = top_v - np.minimum(left_v, right_v)
    fall_v2 = top_v2 + np.where(left_v < right_v, left_v2, right_v2)
    inverse = 1 / np.where(fall_v > 0, fall_v, np.inf)
    shift = _apex_shift(left_v, top_v, right_v)
    by_top, by_low, by_high = np.abs(shift), 0.5 - np.abs(shift), 0.5
    low_v2, high_v2 = np.where(left_v < right_v, (left_v2, right_v2), (right_v2, left_v2))
    noise_s = step_s * inverse * np.sqrt(by_top**2 * top_v2 + by_low**2 * low_v2 + by_high**2 * high_v2)
    base_s = opens + (closes - opens - camera.pulse_width_s) / 2
    per_second = camera.speed_of_light_mps / 2
    distance_m = per_second * (base_s - (delays_s[middle] + step_s * shift)) + camera.offset_m  # eq 3.25
    sigma_m = per_second * np.hypot(noise_s, _apex_error_s(camera))
    low_m, high_m, _ = range_limits(camera, base_s - delays_s[-2] - step_s / 2, base_s - delays_s[1] + step_s / 2)
    inside = (at == middle) & (low_m <= distance_m) & (distance_m <= high_m)
    most_v = top_v + np.abs(shift) * fall_v
    return compose(raw, samples, distance_m, sigma_m, most_v, strong_enough(most_v, fall_v, fall_v2, camera), inside)


def _apex_shift(left: Floats, top: Floats, right: Floats) -> Floats:
    """Return where two lines of opposite slopes meet, in steps from the middle one of three samples, -1/2..1/2."""
    fall = top - np.minimum(left, right)
    shift: Floats = np.where(fall > 0, (right - left) / (2 * np.where(fall > 0, fall, 1.0)), 0.0)
    return shift


@lru_cache(maxsize=8)
def _apex_error_s(camera: PulsedCamera) -> float:
    """Return the root mean square error, s, of the maximum of CSI by the shapes of pulse and window, without noise."""
    window, step_s = shutter_windows(camera)["a"], camera.delay_step_s
    base_s = window[0] + (window[1] - window[0] - camera.pulse_width_s) / 2
    delays_s = step_s * np.arange(-camera.delay_count, camera.delay_count + 1)[:, None]
    true_s = base_s + step_s * np.linspace(-0.5, 0.5, _APEX_STEPS)
    values = np.interp(delays_s + true_s, *correlation_curve(window, camera))
    middle = np.clip(values.argmax(axis=0), 1, len(values) - 2)
    left, top, right = (pick(values, middle + k) for k in (-1, 0, 1))
    found_s = base_s - (delays_s[middle, 0] + step_s * _apex_shift(left, top, right))
    return float(np.sqrt(np.mean((found_s - true_s) ** 2)))


def dcsi(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from the laser delay at which windows a and b collect alike (König 2008, eq 3.26; E-K-05).

    Planes shutter_a_0.. and shutter_b_0.., one of each for each of `laser_delays`. A line is fitted to the middle part
    of their difference (annex C): to as many delays as lie in `camera.linear_part_s`, those nearest to the change of
    sign. sigma_m: eq 5.10 with `zero_crossing`. amplitude is the whole signal of one pulse, V, by the slope.
    Raises UsageError unless 2 to delay_count delays lie in the linear part.
    """
    windows, count, step_s = shutter_windows(camera), camera.delay_count, camera.delay_step_s
    used = _points_of_line(camera)
    names = tuple(f"shutter_{name}_{i}" for name in "ab" for i in range(count))
    widths_s = [closes - opens for name in "ab" for opens, closes in [windows[name]] * count]
    samples = read_samples(raw, camera, names, widths_s)
    apart_v = samples.value_v[:count] - samples.value_v[count:]
    apart_v2 = samples.variance_v2[:count] + samples.variance_v2[count:]
    found, crossing = _change_of_sign(apart_v)
    start = np.round(crossing - (used - 1) / 2).astype(np.intp)
    inside = found & (start >= 0) & (start <= count - used)
    start = np.clip(start, 0, count - used)
    x_s = step_s * np.arange(used)
    y_v, y_v2 = (np.stack([pick(plane, start + i) for i in range(used)]) for plane in (apart_v, apart_v2))
    zero_s, by_y, slope = zero_crossing(x_s, y_v)
    weight = (x_s - x_s.mean()) / ((x_s - x_s.mean()) ** 2).sum()
    slope_variance = np.tensordot(weight**2, y_v2, axes=1)
    # Half of the sum of both openings, and half of what a window is longer than the pulse (eq 3.26; E-K-05).
    base_s = windows["a"][1] - camera.pulse_width_s / 2
    delays_s, per_second = laser_delays(camera), camera.speed_of_light_mps / 2
    distance_m = per_second * (base_s - (delays_s[start] + zero_s)) + camera.offset_m  # eq 3.26
    sigma_m = per_second * np.sqrt((by_y**2 * y_v2).sum(axis=0))  # eq 5.10
    edge_s = (used - 1) / 2 * step_s
    low_m, high_m, _ = range_limits(camera, base_s - delays_s[-1] + edge_s, base_s - delays_s[0] - edge_s)
    inside &= (low_m <= distance_m) & (distance_m <= high_m)
    whole_v = -slope * camera.pulse_width_s / 2
    top = samples.value_v.argmax(axis=0)
    top_v, top_v2 = pick(samples.value_v, top), pick(samples.variance_v2, top)
    seen = strong_enough(top_v, top_v, top_v2, camera)  # of light whose change of sign lies outside of the delays
    enough = np.where(found, strong_enough(whole_v, -slope, slope_variance, camera), seen)
    return compose(raw, samples, distance_m, sigma_m, whole_v, enough, inside)


def zero_crossing(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Return where the line fitted to points is zero, its derivatives by each y, and the slope of the line.

    x (N,), y (N, ...): returns (...), (N, ...), (...). König 2008, eqs C.6 and C.8; the latter with the means as E-K-27
    has them. Where the slope is not below zero, the crossing is 0 with derivatives 0. (Eq C.7, which the thesis gives
    as an equal, is so only as E-K-26 has it.)
    """
    n, columns = len(x), x.reshape(-1, *[1] * (y.ndim - 1))
    mean_x, mean_xx, mean_y, mean_xy = x.mean(), (x**2).mean(), y.mean(axis=0), (columns * y).mean(axis=0)
    top, bottom = mean_x * mean_xy - mean_xx * mean_y, mean_xy - mean_x * mean_y
    inverse = 1 / np.where(bottom < 0, bottom, -np.inf)
    crossing: Floats = top * inverse  # eq C.6
    by_top, by_bottom = (mean_x * columns - mean_xx) / n, (columns - mean_x) / n
    by_y: Floats = (by_top - crossing * by_bottom) * inverse  # eq C.8
    slope: Floats = bottom / (mean_xx - mean_x**2)  # eq C.2
    return crossing, by_y, slope


def _points_of_line(camera: PulsedCamera) -> int:
    used = int(camera.linear_part_s / camera.delay_step_s + 1e-9)
    if not 2 <= used <= camera.delay_count:
        raise UsageError(
            f"camera.linear_part_s = {camera.linear_part_s:g}: must hold 2 to camera.delay_count = "
            f"{camera.delay_count} steps of camera.delay_step_s = {camera.delay_step_s:g}, it holds {used}"
        )
    return used


def _change_of_sign(values: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Return whether values (N, H, W) fall through zero after their maximum, and at which index, between two."""
    index = np.arange(len(values))[:, None, None]
    after = (values <= 0) & (index > values.argmax(axis=0))
    second = np.maximum(after.argmax(axis=0), 1)
    above, below = pick(values, second - 1), pick(values, second)
    found: NDArray[np.bool_] = after.any(axis=0) & (above > below)
    return found, second - np.where(found, below / np.where(found, below - above, 1.0), 0.0)


def pick(values: Floats, index: NDArray[np.intp]) -> Floats:
    """Return the values (N, ...) at `index` (...) of their first axis."""
    picked: Floats = np.take_along_axis(values, index[None], axis=0)[0]
    return picked


def read_samples(raw: RawFrame, camera: PulsedCamera, names: tuple[str, ...], widths_s: list[float]) -> Samples:
    """Return the planes of these names and their noise; widths_s: of the windows. Pixels refused already are 0."""
    needed = (*names, "n_acc")
    value_v = np.stack([image_plane(raw, name, needed) for name in names]).astype(np.float64)
    n_acc = image_plane(raw, "n_acc", needed)
    ambient_vps: Image = image_plane(raw, "ambient", needed) if "ambient" in raw.planes else np.zeros(n_acc.shape)
    pixel = camera.pixel
    finite = np.isfinite(value_v).all(axis=0) & np.isfinite(ambient_vps)
    full = (np.where(finite, value_v, 0.0) >= pixel.saturation_v * (1 - 1e-6)).any(axis=0)
    why = np.select(
        [np.isnan(n_acc), n_acc < 1, n_acc > 255, ~finite, full],
        [Why.NOT_FINITE, Why.NO_SIGNAL, Why.SENSOR_FLAG, Why.NOT_FINITE, Why.SATURATED],
        Why.VALID,
    ).astype(np.uint8)
    known = (why == Why.VALID) | (why == Why.SATURATED)
    value_v, n = np.where(known, value_v, 0.0), np.where(known, n_acc, 1).astype(np.float64)
    ambient_v = np.where(known, np.maximum(ambient_vps, 0.0), 0.0) * np.reshape(widths_s, (-1, 1, 1))
    variance_v2 = (noise_variance(value_v, n, ambient_v, pixel) + step_v(pixel) ** 2 / 12) / camera.averages
    return Samples(value_v, variance_v2, 1 / (damping(n, pixel) * n), why)


def strong_enough(whole_v: Floats, measured: Floats, variance: Floats, camera: PulsedCamera) -> NDArray[np.bool_]:
    """Return where the whole signal exceeds its threshold, and the difference that it comes from its noise."""
    enough: NDArray[np.bool_] = (
        (measured > 0) & (whole_v >= camera.pixel.noise_threshold_v) & (measured**2 >= camera.min_snr**2 * variance)
    )
    return enough


def compose(
    raw: RawFrame,
    samples: Samples,
    distance_m: Floats,
    sigma_m: Floats,
    whole_v: Floats,
    enough: NDArray[np.bool_],
    inside: NDArray[np.bool_],
) -> RangeImage:
    """Put an image together: the first reason counts; NaN where there is no estimate."""
    why = np.select([samples.why != Why.VALID, ~enough, ~inside], [samples.why, Why.LOW_AMPLITUDE, Why.OUT_OF_RANGE], 0)
    read = (samples.why == Why.VALID) | (samples.why == Why.SATURATED)
    usable = read & (whole_v > 0)
    return RangeImage(
        raw.time_s,
        np.where(usable, distance_m, np.nan).astype(np.float32),
        np.where(usable, sigma_m, np.nan).astype(np.float32),
        np.where(read, whole_v * samples.per_pulse, np.nan).astype(np.float32),
        why.astype(np.uint8),
    )


RANGING: dict[str, Callable[[RawFrame, PulsedCamera], RangeImage]] = {
    "gradient1": gradient1,
    "gradient2": gradient2,
    "csi": csi,
    "dcsi": dcsi,
}
"""Ranging methods of pulsed cameras that shift windows or pulses, by name."""
