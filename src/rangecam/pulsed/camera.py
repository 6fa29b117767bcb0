"""The simulated pulsed camera: what its sensor delivers when it looks at a scene."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from rangecam.errors import DataError, UsageError
from rangecam.geometry import rays
from rangecam.optics import ambient_on_sensor, irradiance_on_sensor
from rangecam.pulsed.pixel import read_adaptively, responsivity
from rangecam.pulsed.settings import PulsedCamera, Taps
from rangecam.pulsed.signal import Window, collected_s, exposures, gate_windows
from rangecam.scene.view import View
from rangecam.types import Floats, RawFrame

_NEAREST_M = 1e-3


def simulate(view: Callable[[float], View], camera: PulsedCamera, time_s: float, rng: np.random.Generator) -> RawFrame:
    """Return the raw frame of an image whose exposure has its middle at `time_s`.

    `view(time_s)` says what the camera sees at a moment. The rays of a pixel add up as light, so that an edge in it
    gives a mixed range. Shutter windows are taken one after the other, each at its own time (König 2008, 4.2.3.4);
    the gates of a three-tap sensor at the same. Planes: see `RawFrame`.
    Raises UsageError if the camera cannot be that fast, DataError if the view is not of its size.
    """
    if camera.frame_rate_hz > max_frame_rate_hz(camera) * (1 + 1e-9):
        raise UsageError(
            f"camera.frame_rate_hz = {camera.frame_rate_hz:g}: exposure leaves no more than "
            f"{max_frame_rate_hz(camera):.4g} Hz; take fewer pulses, windows or averages, or a higher repetition rate"
        )
    planes = _shutter_planes if camera.readout == "shutters" else _tap_planes
    return RawFrame(time_s, planes(view, camera, time_s, rng))


def max_frame_rate_hz(camera: PulsedCamera) -> float:
    """Return the images a second that the exposure allows (König 2008, eq 4.48, for any number of windows)."""
    return camera.laser.repetition_hz / (_pulses(camera) * camera.averages)


def _pulses(camera: PulsedCamera) -> int:
    """Return the pulses of one image, before averaging."""
    if camera.readout == "three_tap":
        return camera.taps.pulses
    return len(exposures(camera)) * max(camera.pixel.accumulations)


def _shutter_planes(
    view: Callable[[float], View], camera: PulsedCamera, time_s: float, rng: np.random.Generator
) -> dict[str, Floats]:
    """Return the shutter values, V, their common n_acc, and the rate of the background signal, V/s.

    With averaging, every window is taken at the mean of its times.
    """
    taken, apart_s = exposures(camera), max(camera.pixel.accumulations) / camera.laser.repetition_hz
    volts, count = responsivity(camera.pixel), len(taken)
    single_v, ambient_vps = (np.empty((count, camera.rows, camera.columns)) for _ in range(2))
    widths_s = np.empty((count, 1, 1))
    for i, (window, delay_s) in enumerate(taken.values()):
        seen = _look(view, time_s + (i - (count - 1) / 2) * apart_s, camera)
        widths_s[i] = window[1] - window[0]
        single_v[i] = volts * laser_exposure(seen, window, delay_s, camera)  # eq 4.13
        ambient_vps[i] = volts * ambient_irradiance(seen, camera)
    values_v, n_acc = read_adaptively(single_v, ambient_vps * widths_s, camera.pixel, camera.averages, rng)
    planes = {name: values_v[i].astype(np.float32) for i, name in enumerate(taken)}
    return planes | {"n_acc": n_acc, "ambient": ambient_vps.mean(axis=0).astype(np.float32)}


def _tap_planes(
    view: Callable[[float], View], camera: PulsedCamera, time_s: float, rng: np.random.Generator
) -> dict[str, Floats]:
    """Return the three taps and their dark images (the laser off, the background not), in counts."""
    seen, taps, shape = _look(view, time_s, camera), camera.taps, (camera.rows, camera.columns)
    to_counts = taps.counts_per_jpm2 * taps.pulses
    planes = {}
    for name, window in gate_windows(camera).items():
        dark = taps.black_level_counts + to_counts * ambient_irradiance(seen, camera) * (window[1] - window[0])
        lit = dark + to_counts * laser_exposure(seen, window, -camera.pulse_lead_s, camera)
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

    delay_s: of the pulse when it leaves. König 2008, eqs 3.11 and 3.16.
    """
    range_m = np.maximum(view.range_m, _NEAREST_M)
    flight_s = 2 / camera.speed_of_light_mps * range_m
    irradiance = view.reflectivity * view.cos_incidence / range_m**2 * _light(camera)[0]
    exposure: Floats = (irradiance * collected_s(delay_s + flight_s, window, camera)).mean(axis=0)
    return exposure


def ambient_irradiance(view: View, camera: PulsedCamera) -> Floats:
    """Return the irradiance of the sensor by ambient light, W/m2 (H, W): the mean over the rays of each pixel."""
    irradiance: Floats = view.ambient_wpm2 * view.reflectivity.mean(axis=0) * _light(camera)[1]
    return irradiance


@lru_cache(maxsize=8)
def _light(camera: PulsedCamera) -> tuple[Floats, Floats]:
    """Return the irradiance of the sensor, W/m2 (H, W), by the laser off a white surface at 1 m, and by ambient light.

    Both across the ray; ambient light of 1 W/m2.
    """
    cos_axis = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    one, power_w = np.ones_like(cos_axis), camera.laser.peak_power_w * camera.laser.modules
    laser = irradiance_on_sensor(power_w, one, one, one, cos_axis, camera.objective)
    return laser, ambient_on_sensor(1.0, one, cos_axis, camera.objective)
