"""Continuous-wave ranging with the corrections that need no calibration of each pixel."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache, wraps

import numpy as np
from numpy.typing import NDArray

from rangecam.cw.contradictions import light_level, moved, noise_of, several_ways
from rangecam.cw.ranging import PLANES, cw_four_phase
from rangecam.cw.scattering import scatter, stray_light
from rangecam.cw.sequence import plane_names
from rangecam.cw.settings import CwCamera
from rangecam.errors import UsageError
from rangecam.hdr import SHORTEST, SHORTEST_SHARE
from rangecam.planes import plane_of
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

Method = Callable[[RawFrame, CwCamera], RangeImage]


def corrected(method: Method) -> Method:
    """Return the ranging method with what `stray_light`, `motion_sigmas` and `multipath_sigmas` of the camera ask for.

    Stray light is taken out of the samples, and its shot noise stays in sigma_m; where something moved a pixel is
    MOTION, where frequencies contradict each other MULTIPATH. Limits of the converter are judged before. A saturated
    pixel is taken for as bright as it reads, which underestimates its stray light, unless a shorter exposure tells.
    Raises UsageError for a test that the camera's steps or frequencies do not allow, DataError for a missing or
    misshapen plane, and what the method raises.
    """

    @wraps(method)
    def with_corrections(raw: RawFrame, camera: CwCamera) -> RangeImage:
        if not (camera.stray_light.stray_fraction or camera.motion_sigmas or camera.multipath_sigmas):
            return method(raw, camera)
        alone = method is cw_four_phase
        return _ranged(raw, camera, method, PLANES if alone else plane_names(camera), alone)

    return with_corrections


def _ranged(raw: RawFrame, camera: CwCamera, method: Method, names: tuple[str, ...], alone: bool) -> RangeImage:
    """Return the image of a method that reads the planes `names`; alone: a quarter period apart, at one frequency."""
    steps_deg = (0.0, 90.0, 180.0, 270.0) if alone else camera.phase_steps_deg
    if camera.multipath_sigmas and (alone or len(camera.modulations_hz) < 2):
        raise UsageError(
            "camera.multipath_sigmas: one modulation frequency cannot tell multipath; it needs camera.modulations_hz "
            "and ranging = 'cw_multi_frequency'"
        )
    samples = np.stack([plane_of(raw, name, names) for name in names]).astype(np.float32)
    why = _refused(samples, camera)
    samples[:, why == Why.NOT_FINITE] = np.nan  # infinite minus infinite would warn
    samples -= np.float32(camera.black_level_lsb)
    stray = _stray(raw, names, samples, why, camera) if camera.stray_light.stray_fraction else None
    if stray is not None:
        samples -= stray
    by_frequency = samples.reshape(-1, len(steps_deg), *why.shape)
    if camera.motion_sigmas:
        why[moved(by_frequency, steps_deg, camera) & (why == Why.VALID)] = Why.MOTION
    if camera.phasor_filter != "off":
        samples[:, why != Why.VALID] = np.nan  # not to be averaged with its neighbours
    planes = dict(zip(names, samples + np.float32(camera.black_level_lsb), strict=True))
    image = method(_with(raw, planes), _without_limits(camera))
    if camera.multipath_sigmas:
        why[several_ways(by_frequency, image.range_m, camera) & (image.why == Why.VALID) & (why == Why.VALID)] = (
            Why.MULTIPATH
        )
    why = np.where(why == Why.VALID, image.why, why)
    why[: camera.pseudo_rows] = Why.SENSOR_FLAG
    if stray is None:
        return replace(image, why=why)
    sigma_m = image.sigma_m * _more_noise(samples, stray, image.amplitude, camera)
    return replace(image, sigma_m=sigma_m.astype(np.float32), why=why)


def _refused(samples: Floats, camera: CwCamera) -> NDArray[np.uint8]:
    """Return why (H, W) a pixel cannot be used, as the methods find it, of samples (K, H, W) as they came."""
    smallest, largest = samples.min(axis=0), samples.max(axis=0)
    why = np.where(smallest == largest, Why.NO_SIGNAL, Why.VALID).astype(np.uint8)
    if camera.full_scale_lsb is not None:
        why[largest >= camera.full_scale_lsb] = Why.SATURATED
    if camera.lower_limit_lsb is not None:
        why[(smallest <= camera.lower_limit_lsb) & (why == Why.VALID)] = Why.SATURATED
    why[~(np.isfinite(smallest) & np.isfinite(largest))] = Why.NOT_FINITE
    return why


def _stray(raw: RawFrame, names: tuple[str, ...], samples: Floats, why: NDArray[np.uint8], camera: CwCamera) -> Floats:
    """Return the stray light in samples without black level; rows of the sensor's own data and NaN are no light.

    Of a frame of several exposures a saturated pixel is as bright as the shortest one says.
    """
    light = np.where(why != Why.NOT_FINITE, samples, np.float32(0))
    if SHORTEST_SHARE in raw.planes:
        saturated = why == Why.SATURATED
        for plane, name in zip(light, names, strict=True):
            shortest = plane_of(raw, SHORTEST + name, names)[saturated] - np.float32(camera.black_level_lsb)
            plane[saturated] = np.nan_to_num(shortest / raw.planes[SHORTEST_SHARE][saturated])
    light[:, : camera.pseudo_rows] = 0
    return stray_light(light, camera.stray_light)


def _more_noise(samples: Floats, stray: Floats, amplitude: Floats, camera: CwCamera) -> Floats:
    """Return by what factor the shot noise of stray light, which is not taken out, raises the noise of a pixel."""
    level = light_level(samples, amplitude, camera)
    if camera.pixel == "single_ended":
        more = stray.mean(axis=0)
    else:
        own, straight = np.nan_to_num(amplitude), np.float32(1 - camera.stray_light.stray_fraction)
        more = (scatter(own, camera.stray_light) - own * straight) / np.float32(camera.demodulation_contrast)
    before, after = (noise_of(each, camera) for each in (level, level + np.maximum(more, 0)))
    return np.asarray(np.sqrt(after / before))


@lru_cache(maxsize=16)
def _without_limits(camera: CwCamera) -> CwCamera:
    """Return the camera for samples that have been judged by its limits already."""
    return replace(camera, full_scale_lsb=None, lower_limit_lsb=None)


def _with(raw: RawFrame, planes: Mapping[str, Image]) -> RawFrame:
    return RawFrame(raw.time_s, {**raw.planes, **planes}, raw.frame_id)
