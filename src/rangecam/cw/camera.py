"""The simulated continuous-wave camera: phase images of a moving scene, with noise, in the sensor's numbers."""

from collections.abc import Callable

import numpy as np

from rangecam.cw.sequence import exposure_times_s, exposures, fastest_frame_rate_hz, plane_names
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
    Raises UsageError if `cw.sequence.exposures` does, or if the camera cannot be that fast.
    """
    fastest_hz = fastest_frame_rate_hz(camera)
    if camera.frame_rate_hz > fastest_hz:
        raise UsageError(
            f"camera.frame_rate_hz = {camera.frame_rate_hz:g}: {len(exposures(camera))} exposures and read-outs leave "
            f"no more than {fastest_hz:.4g} Hz; shorten illumination_time_s"
        )
    planes: dict[str, Image] = {}
    for exposure, at_s in zip(exposures(camera), exposure_times_s(camera, time_s), strict=True):
        mean, light = correlate(view(at_s), exposure.camera, exposure.step_deg)
        noise = rng.standard_normal(mean.shape, np.float32) * np.sqrt(sample_variance(light, camera))
        planes[exposure.plane] = _convert(mean + noise, camera)
    return RawFrame(time_s, {name: planes[name] for name in plane_names(camera)})


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
