"""The simulated continuous-wave camera: four phase images of a moving scene, with noise, in the sensor's numbers."""

from collections.abc import Callable

import numpy as np

from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import correlate, sample_variance
from rangecam.errors import UsageError
from rangecam.scene.view import View
from rangecam.types import Floats, Image, RawFrame


def simulate(view: Callable[[float], View], camera: CwCamera, time_s: float, rng: np.random.Generator) -> RawFrame:
    """Return the raw frame of the scene `view(time)` whose exposure sequence has its middle at `time_s`.

    Each phase image is exposed at its own time (Steinbäck 2016, fig 4.7), so that moving edges show motion artefacts;
    motion within one exposure is not modelled. Noise is Gaussian with `sample_variance`; then rounding and limits of
    the converter. The planes are uint16 where the converter's limits and step allow, else float32.
    Raises UsageError if `capture_order` is not an order of the four steps, or the camera cannot be that fast.
    """
    if sorted(camera.capture_order) != [0, 90, 180, 270]:
        raise UsageError(f"camera.capture_order = {list(camera.capture_order)}: expected 0, 90, 180, 270 in some order")
    fastest_hz = 1 / (4 * (camera.illumination_time_s + camera.readout_time_s))
    if camera.frame_rate_hz > fastest_hz:
        raise UsageError(
            f"camera.frame_rate_hz = {camera.frame_rate_hz:g}: four exposures and read-outs leave no more than "
            f"{fastest_hz:.4g} Hz; shorten illumination_time_s"
        )
    planes: dict[str, Image] = {}
    for step, start_s in zip(camera.capture_order, exposure_times_s(camera, time_s), strict=True):
        mean, light = correlate(view(start_s), camera, step)
        noise = rng.standard_normal(mean.shape, np.float32) * np.sqrt(sample_variance(light, camera))
        planes[f"phase_{step}"] = _convert(mean + noise, camera)
    return RawFrame(time_s, dict(sorted(planes.items(), key=lambda plane: int(plane[0][6:]))))


def exposure_times_s(camera: CwCamera, time_s: float) -> list[float]:
    """Return the middle of each of the four exposures, in order of capture, of the sequence centred on `time_s`."""
    period_s = camera.illumination_time_s + camera.readout_time_s
    return [time_s + (k - 1.5) * period_s for k in range(4)]


def _convert(samples: Floats, camera: CwCamera) -> Image:
    """Return samples as the converter gives them: rounded to its step and kept within its limits."""
    step, low, high = camera.quantisation_lsb, camera.lower_limit_lsb, camera.full_scale_lsb
    if step > 0:
        samples = np.round(samples / step) * step
    if low is not None:
        samples = np.maximum(samples, low)
    if high is not None:
        samples = np.minimum(samples, high)
    samples[: camera.pseudo_rows] = 0
    whole = step >= 1 and step == int(step) and low is not None and low >= 0 and high is not None and high <= 65535
    return samples.astype(np.uint16 if whole else np.float32)
