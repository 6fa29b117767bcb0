"""The simulated continuous-wave camera: phase images of a moving scene, with noise, in the sensor's numbers."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.light import collect
from rangecam.cw.link import transfer
from rangecam.cw.pixel import respond, temperature_c
from rangecam.cw.scattering import scatter
from rangecam.cw.sequence import (
    Exposure,
    exposure_times_s,
    exposures,
    fastest_frame_rate_hz,
    plane_names,
    sequence_times_s,
    single_exposures,
)
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import noise_of
from rangecam.errors import UsageError
from rangecam.hdr import exposure_plane
from rangecam.scene.view import View
from rangecam.types import Floats, Image, RawFrame


def simulate(view: Callable[[float], View], camera: CwCamera, time_s: float, rng: np.random.Generator) -> RawFrame:
    """Return the raw frame of the scene `view(time)` whose exposure sequence has its middle at `time_s`.

    Each phase image is exposed at its own time (Steinbäck 2016, fig 4.7), so that moving edges show motion artefacts;
    with several `exposure_samples` what moves within one exposure is blurred. With several `illumination_times_s` the
    planes are named as `hdr` says. Noise is Gaussian with `sample_variance`;
    then rounding and limits of the converter, and the way over the interface. The planes are uint16 where the
    converter's limits and step allow, else float32. Noise is drawn first and is the same whatever imperfection is on.
    Plane temperature_c, degrees Celsius, is there if the camera measures it.
    Raises UsageError if `cw.sequence.exposures` does, if the camera cannot be that fast, or if the region of
    interest leaves the image.
    """
    fastest_hz = fastest_frame_rate_hz(camera)
    if camera.frame_rate_hz > fastest_hz:
        count = len(exposures(camera)) * max(1, len(camera.illumination_times_s))
        raise UsageError(
            f"camera.frame_rate_hz = {camera.frame_rate_hz:g}: {count} exposures and read-outs leave no more than "
            f"{fastest_hz:.4g} Hz; shorten illumination_time_s"
        )
    if camera.illumination_times_s:
        return _of_several_exposures(view, camera, time_s, rng)
    planes: dict[str, Image] = {}
    seen = _seen_at(view, time_s) if camera.freeze_motion else view
    for exposure, middle_s in zip(exposures(camera), exposure_times_s(camera, time_s), strict=True):
        sample, light = respond(_expose(seen, exposure, middle_s), exposure.camera)
        planes[exposure.plane] = _read_out(sample, light, rng.standard_normal(sample.shape, np.float32), camera)
    planes = {name: transfer(planes[name], camera.link, rng) for name in plane_names(camera)}
    if camera.temperature.measured:
        first = next(iter(planes.values()))
        planes["temperature_c"] = np.full(first.shape, temperature_c(camera, time_s), np.float32)
    return RawFrame(time_s, planes)


def _of_several_exposures(
    view: Callable[[float], View], camera: CwCamera, time_s: float, rng: np.random.Generator
) -> RawFrame:
    """Return the frame of all `illumination_times_s`, one sequence after the other, as `hdr` takes it."""
    if camera.freeze_motion:
        view = _seen_at(view, time_s)
    planes: dict[str, Image] = {}
    for single, middle_s in zip(single_exposures(camera), sequence_times_s(camera, time_s), strict=True):
        part = simulate(view, single, middle_s, rng)
        planes |= {exposure_plane(single.illumination_time_s, name): plane for name, plane in part.planes.items()}
    return RawFrame(time_s, planes)


def _seen_at(view: Callable[[float], View], time_s: float) -> Callable[[float], View]:
    still = view(time_s)
    return lambda _: still


def _expose(view: Callable[[float], View], exposure: Exposure, middle_s: float) -> Floats:
    """Return the light (2, H, W) of one exposure: the mean of its moments, which divide it evenly."""
    camera, count = exposure.camera, exposure.camera.exposure_samples
    times_s = [middle_s + camera.illumination_time_s * ((k + 0.5) / count - 0.5) for k in range(count)]
    light = collect(view(times_s[0]), camera, exposure.step_deg, times_s[0])
    for at_s in times_s[1:]:
        light += collect(view(at_s), camera, exposure.step_deg, at_s)
    if count > 1:
        light /= np.float32(count)
    return scatter(light, camera.scattering)


def _read_out(samples: Floats, light: Floats, deviates: Floats, camera: CwCamera) -> Image:
    """Return samples as the converter gives them, each (H, W): noisy, rounded to its step and kept within its limits.

    light: all that was collected for the sample, which makes its noise (`sample_variance`). deviates: standard normal.
    Only what is read is more than the black level, and pseudo rows are zero.
    """
    step, low, high = camera.quantisation_lsb, camera.lower_limit_lsb, camera.full_scale_lsb
    whole = step >= 1 and step == int(step) and low is not None and low >= 0 and high is not None and high <= 65535
    result = np.empty(samples.shape, np.uint16 if whole else np.float32)
    limits = -np.inf if low is None else low, np.inf if high is None else high
    region = _region(camera, samples.shape[0], samples.shape[1])
    numbers = np.array([step, *limits, camera.black_level_lsb, *noise_of(camera)], np.float32)
    _convert(samples, light, deviates, numbers, region, result)
    result[: camera.pseudo_rows] = 0
    return result


@njit(cache=True, nogil=True)
def _convert(samples: Any, light: Any, deviates: Any, numbers: Any, region: Any, result: Any) -> Any:
    """Fill what the converter gives."""
    step, low, high, black, read_variance, per_light, averaged = numbers
    row, column, rows, columns = region
    zero, one = np.float32(0), np.float32(1)
    for r in range(result.shape[0]):
        inside = row <= r < row + rows
        for c in range(result.shape[1]):
            variance = (read_variance + per_light * light[r, c]) / averaged
            value = samples[r, c] + deviates[r, c] * np.sqrt(variance)
            value = value if inside and column <= c < column + columns else black
            value = np.rint(value / (step if step > zero else one)) * step if step > zero else value
            result[r, c] = min(max(value, low), high)


def _region(camera: CwCamera, height: int, width: int) -> tuple[int, int, int, int]:
    """Return first row, first column, rows and columns that are read; raises UsageError if they leave the image."""
    region = (0, 0, height, width) if camera.region_of_interest is None else camera.region_of_interest
    row, column, rows, columns = region
    if row + rows > height or column + columns > width:
        raise UsageError(
            f"camera.region_of_interest = {list(region)}: first row and column, rows and columns must lie within the "
            f"image of {height} rows and {width} columns"
        )
    return region
