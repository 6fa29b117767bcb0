"""Continuous-wave ranging with what a calibration corrects: wiggling, fixed pattern, drift with the temperature."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any

import numpy as np

from rangecam.cw.settings import CwCamera
from rangecam.cw.unwrapping import combine
from rangecam.cw.wiggling import straightened, turned_back, unambiguous_m
from rangecam.errors import DataError
from rangecam.types import Floats, RangeImage, RawFrame

Method = Callable[[RawFrame, CwCamera], RangeImage]

_MADE_FOR = (
    "kind", "pixel", "rows", "columns", "modulation_hz", "modulations_hz", "phase_steps_deg", "phase_sign",
    "speed_of_light_mps",
)  # fmt: skip
PATTERN, TEMPERATURE = "range_offset_m", "temperature_c"
PLANES = (PATTERN,)
"""Beginnings of the names of planes that a calibration lays beside the samples."""


def made_for(camera: CwCamera, method: str) -> dict[str, Any]:
    """Return the facts by which a calibration is known to be one of this camera with this ranging method."""
    return {**{name: getattr(camera, name) for name in _MADE_FOR}, "method": method}


def calibrated(method: Method) -> Method:
    """Return the ranging method with the corrections that the settings and the planes of a frame ask for.

    Wiggling by `wiggling_table_m` or `wiggling_harmonics_m` comes first, on the phase before `offset_m`, of several
    frequencies before they are unwrapped; sigma_m goes with its slope. Then range_offset_m (H, W) is taken off each
    pixel, and `drift_m_per_k` for each kelvin over `drift_reference_c`: of the plane temperature_c if the frame has
    one, else of the camera. The range stays in the unambiguous interval.
    Raises DataError for a plane that does not fit and UsageError for an impossible wiggling, beside what the method
    raises.
    """

    @wraps(method)
    def with_calibration(raw: RawFrame, camera: CwCamera) -> RangeImage:
        wiggles = bool(camera.wiggling_table_m or camera.wiggling_harmonics_m)
        if wiggles and camera.modulations_hz:
            raw, slope = turned_back(raw, camera)
            image = method(raw, camera)
            image = replace(image, sigma_m=image.sigma_m * slope)
        else:
            image = method(raw, camera)
            if wiggles:
                image = straightened(image, camera)
        for name, correct in CORRECTIONS.items():
            if name in raw.planes:
                plane = np.asarray(raw.planes[name])
                if plane.shape != image.shape:
                    raise DataError(
                        f"frame {raw.frame_id}: plane '{name}' has shape {plane.shape}; calibration needs {image.shape}"
                    )
                image = correct(image, plane, camera)
        if camera.drift_m_per_k and TEMPERATURE not in raw.planes:
            image = _without_drift(image, np.float32(camera.temperature_c), camera)
        return image

    return with_calibration


def _without_pattern(image: RangeImage, offset_m: Floats, camera: CwCamera) -> RangeImage:
    """Return the ranges less the offset of each pixel."""
    return replace(image, range_m=_wrapped(image.range_m - offset_m, camera))


def _without_drift(image: RangeImage, temperature_c: Any, camera: CwCamera) -> RangeImage:
    """Return the ranges less the drift at this temperature, a number or (H, W)."""
    if not camera.drift_m_per_k:
        return image
    drift_m = camera.drift_m_per_k * (temperature_c - camera.drift_reference_c)
    return replace(image, range_m=_wrapped(image.range_m - drift_m, camera))


def _wrapped(range_m: Floats, camera: CwCamera) -> Floats:
    """Return ranges (H, W) float32 in the unambiguous interval."""
    if camera.modulations_hz:
        period_m = combine(camera.modulations_hz, camera.speed_of_light_mps).unambiguous_m
    else:
        period_m = unambiguous_m(camera)
    wrapped = np.mod(range_m, period_m).astype(np.float32)
    result: Floats = np.where(wrapped >= np.float32(period_m), np.float32(0), wrapped)
    return result


CORRECTIONS: dict[str, Callable[[RangeImage, Floats, CwCamera], RangeImage]] = {
    PATTERN: _without_pattern,
    TEMPERATURE: _without_drift,
}
"""What planes beside the samples correct, by name and in this order: (image, plane, camera) -> image."""
