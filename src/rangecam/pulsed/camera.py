"""The simulated pulsed camera: what its sensor delivers when it looks at a scene."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.errors import DataError, UsageError
from rangecam.geometry import rays
from rangecam.optics import ambient_on_sensor, irradiance_on_sensor
from rangecam.pulsed.crosstalk import electrical, optical
from rangecam.pulsed.feasible import check, max_frame_rate_hz, window_step_s
from rangecam.pulsed.laser import beam_profile, power_w
from rangecam.pulsed.pixel import offsets, read_out, responsivity
from rangecam.pulsed.pulses import differ, mean_of_pulses
from rangecam.pulsed.settings import PulsedCamera, Taps
from rangecam.pulsed.signal import Window, correlation_curve, exposures, gate_windows
from rangecam.scene.view import View
from rangecam.types import Floats, RawFrame

__all__ = ["ambient_irradiance", "laser_exposure", "max_frame_rate_hz", "simulate"]

_NEAREST_M = 1e-3


def simulate(view: Callable[[float], View], camera: PulsedCamera, time_s: float, rng: np.random.Generator) -> RawFrame:
    """Return the raw frame of an image whose exposure has its middle at `time_s`.

    `view(time_s)` says what the camera sees at a moment. The rays of a pixel add up as light, so that an edge in it
    gives a mixed range. Shutter windows are taken one after the other, each at its own time (König 2008, 4.2.3.4), or
    in turns with each pulse; the gates of a three-tap sensor at the same. Planes: see `RawFrame`.
    Raises UsageError if the camera is impossible or cannot be that fast, DataError if the view is.
    """
    check(camera)
    if camera.frame_rate_hz > max_frame_rate_hz(camera) * (1 + 1e-9):
        raise UsageError(
            f"camera.frame_rate_hz = {camera.frame_rate_hz:g}: exposure and read-out leave no more than "
            f"{max_frame_rate_hz(camera):.4g} Hz; take fewer pulses, windows or averages, or a higher repetition rate"
        )
    planes = _shutter_planes if camera.readout == "shutters" else _tap_planes
    return RawFrame(time_s, planes(view, camera, time_s, rng))


def _shutter_planes(
    view: Callable[[float], View], camera: PulsedCamera, time_s: float, rng: np.random.Generator
) -> dict[str, Floats]:
    """Return the shutter values, V, their common n_acc, and the rate of the background signal, V/s.

    With averaging, every window is taken at the mean of its times.
    """
    taken, apart_s = exposures(camera), window_step_s(camera)
    volts, count = responsivity(camera.pixel), len(taken)
    shape, jitter_s = (count, camera.rows, camera.columns), camera.laser.trigger_jitter_s
    light_jpm2, ambient_wpm2 = np.empty((2, *shape))
    slope_wpm2 = np.zeros(shape if differ(camera) else 0)
    widths_s, open_s = _open_s(camera)
    for i, (window, delay_s) in enumerate(taken.values()):
        seen = _look(view, time_s + (i - (count - 1) / 2) * apart_s, camera)
        light_jpm2[i] = laser_exposure(seen, window, delay_s, camera)
        if jitter_s:
            early, late = (laser_exposure(seen, window, delay_s + at_s, camera) for at_s in (-jitter_s, jitter_s))
            slope_wpm2[i] = (late - early) / (2 * jitter_s)
        ambient_wpm2[i] = ambient_irradiance(seen, camera)
    single_v = volts * electrical(light_jpm2, camera.crosstalk)  # eq 4.13
    ambient_vps = volts * ambient_wpm2
    ambient_v = ambient_vps * open_s
    if differ(camera):
        slope_vps = volts * electrical(slope_wpm2, camera.crosstalk)
        single_v = mean_of_pulses(single_v, slope_vps, ambient_v, camera, rng)
    offset_v = offsets(shape, widths_s, camera.temperature_c, camera.pixel)
    values_v, n_acc = read_out(single_v, ambient_v, offset_v, camera.pixel, camera.averages, rng)
    planes: dict[str, Any] = dict(zip(taken, values_v.astype(np.float32), strict=True))
    return planes | {"n_acc": n_acc, "ambient": (np.add.reduce(ambient_vps) / count).astype(np.float32)}


@lru_cache(maxsize=8)
def _open_s(camera: PulsedCamera) -> tuple[tuple[float, ...], Floats]:
    """Return how long the shutter of each plane is open, as numbers and to multiply images (S, H, W) with."""
    widths_s = tuple([window[1] - window[0] for window, _ in exposures(camera).values()])
    return widths_s, np.array(widths_s)[:, None, None]


def _tap_planes(
    view: Callable[[float], View], camera: PulsedCamera, time_s: float, rng: np.random.Generator
) -> dict[str, Floats]:
    """Return the three taps and their dark images (the laser off, the background not), in counts."""
    seen, taps, shape = _look(view, time_s, camera), camera.taps, (camera.rows, camera.columns)
    to_counts = taps.counts_per_jpm2 * taps.pulses
    planes = {}
    for name, window in gate_windows(camera).items():
        dark = taps.black_level_counts + to_counts * ambient_irradiance(seen, camera) * (window[1] - window[0])
        pulse = laser_exposure(seen, window, -camera.pulse_lead_s, camera)
        lit = dark + to_counts * electrical(pulse, camera.crosstalk)
        counts = np.zeros(shape)
        for _ in range(camera.averages):
            noisy = lit + np.sqrt(_tap_variance(lit, taps)) * rng.standard_normal(shape)
            counts += np.minimum(np.round(noisy), taps.saturation_counts)
        dark_sigma = np.sqrt((_tap_variance(dark, taps) + 1 / 12) / taps.dark_frames)
        averaged = np.minimum(dark + dark_sigma * rng.standard_normal(shape), taps.saturation_counts)
        planes[f"tap_{name}"] = (counts / camera.averages).astype(np.float32)
        planes[f"dark_{name}"] = averaged.astype(np.float32)
    return planes


def _tap_variance(level: Floats, taps: Taps) -> Floats:
    light = np.maximum(level - taps.black_level_counts, 0.0)
    variance: Floats = taps.read_noise_counts**2 + taps.shot_noise_counts2_per_count * light
    return variance


def _look(view: Callable[[float], View], time_s: float, camera: PulsedCamera) -> View:
    seen = view(time_s)
    if seen.range_m.ndim != 3 or seen.range_m.shape[1:] != (camera.rows, camera.columns):
        raise DataError(
            f"view of shape {seen.range_m.shape}: the camera needs (rays, {camera.rows}, {camera.columns}), "
            "its rows and columns"
        )
    return seen


def laser_exposure(view: View, window: Window, delay_s: float, camera: PulsedCamera) -> Floats:
    """Return the exposure of one pulse within a window, J/m2 (H, W): the mean over the rays of each pixel.

    delay_s: of the pulse when it leaves. Blur, stray light and cover glass are in it (`camera.crosstalk`).
    König 2008, eqs 3.11 and 3.16. Raises DataError for a negative reflectivity.
    """
    laser, _, cos_axis = _light(camera)
    met: tuple[Floats, ...] = (view.range_m, view.reflectivity, view.cos_incidence)
    if not met[0].dtype == met[1].dtype == met[2].dtype:
        met = tuple(each.astype(np.result_type(*met)) for each in met)
    range_m, reflectivity, cos_incidence = map(np.ascontiguousarray, met)
    delays_s, collected_s = correlation_curve(window, camera)
    apart, seconds_per_metre = camera.crosstalk.blur, 2 / camera.speed_of_light_mps
    light = np.empty(range_m.shape if apart else (1, *range_m.shape[1:]))
    rays = range_m, reflectivity, cos_incidence
    darkest = _expose(*rays, laser, delays_s, collected_s, delay_s, seconds_per_metre, light)
    if darkest < 0:
        raise DataError(f"view with a reflectivity of {darkest:g}: it must be 0 or more")
    return optical(light, view.range_m * cos_axis if apart else light, camera)


@njit(cache=True, nogil=True)
def _expose(
    range_m: Any,
    reflectivity: Any,
    cos_incidence: Any,
    laser: Any,
    delays_s: Any,
    collected_s: Any,
    delay_s: Any,
    seconds_per_metre: Any,
    light: Any,
) -> Any:
    """Write the exposure by each ray (K, H, W), or the mean over all of a pixel (1, H, W).

    Between the points of the correlation it is interpolated. Return the smallest reflectivity, inf without a ray.
    """
    (count, rows, columns), layers = range_m.shape, len(light)
    light[:] = 0.0
    last, darkest, i = len(delays_s) - 1, np.inf, 1
    for k in range(count):
        for r in range(rows):
            for c in range(columns):
                darkest = min(darkest, np.float64(reflectivity[k, r, c]))
                away_m = max(np.float64(range_m[k, r, c]), _NEAREST_M)
                at_s = delay_s + seconds_per_metre * away_m
                if delays_s[0] < at_s < delays_s[last]:
                    if not delays_s[i - 1] < at_s <= delays_s[i]:  # not where the pixel before was
                        low, i = 0, last
                        while i - low > 1:
                            middle = (low + i) // 2
                            low, i = (middle, i) if delays_s[middle] < at_s else (low, middle)
                    part = (at_s - delays_s[i - 1]) / (delays_s[i] - delays_s[i - 1])
                    met_s = collected_s[i - 1] + part * (collected_s[i] - collected_s[i - 1])
                    bright = laser[r, c] * np.float64(reflectivity[k, r, c]) * np.float64(cos_incidence[k, r, c])
                    light[min(k, layers - 1), r, c] += bright / away_m**2 * met_s
    for r in range(rows if count > layers else 0):
        for c in range(columns):
            light[0, r, c] /= count
    return darkest


def ambient_irradiance(view: View, camera: PulsedCamera) -> Floats:
    """Return the irradiance of the sensor by ambient light, W/m2 (H, W): as `laser_exposure`."""
    _, ambient, cos_axis = _light(camera)
    if view.ambient_wpm2 == 0:
        return np.zeros(ambient.shape)
    light = view.ambient_wpm2 * view.reflectivity * ambient
    return optical(light, view.range_m * cos_axis if camera.crosstalk.blur else light, camera)


@lru_cache(maxsize=8)
def _light(camera: PulsedCamera) -> tuple[Floats, Floats, Floats]:
    """Return the irradiance of the sensor, W/m2 (H, W), by the laser off a white surface at 1 m, and by ambient light.

    Both across the ray; ambient light of 1 W/m2. The third image is the cosine between ray and optical axis.
    """
    cos_axis = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    one = np.ones_like(cos_axis)
    peak_w = power_w(camera.laser, camera.pulse_width_s, camera.temperature_c) * beam_profile(
        camera.laser, camera.columns
    )
    laser = irradiance_on_sensor(peak_w, one, one, one, cos_axis, camera.objective)
    return laser, ambient_on_sensor(1.0, one, cos_axis, camera.objective), cos_axis
