"""Continuous-wave ranging with what a calibration corrects: wiggling, fixed pattern, drift with the temperature."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any

import numpy as np

from rangecam.cw.settings import CwCamera
from rangecam.cw.unwrapping import combine
from rangecam.cw.wiggling import straightened, taken_off, turned_back, unambiguous_m
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
        off_m = _offsets_m(raw, image.shape, camera)
        return image if off_m is None else replace(image, range_m=taken_off(image.range_m, off_m, interval_m(camera)))

    return with_calibration


def _offsets_m(raw: RawFrame, shape: tuple[int, int], camera: CwCamera) -> Floats | None:
    """Return what is to be taken off the ranges, a number or (H, W), m; None for nothing."""
    off_m: Floats | None = None
    if PATTERN in raw.planes:
        off_m = _fitting(raw, PATTERN, shape)
    if camera.drift_m_per_k:
        known_c = _fitting(raw, TEMPERATURE, shape) if TEMPERATURE in raw.planes else np.float32(camera.temperature_c)
        drift_m = np.float32(camera.drift_m_per_k) * (known_c - np.float32(camera.drift_reference_c))
        off_m = np.asarray(drift_m if off_m is None else off_m + drift_m)
    return off_m


def _fitting(raw: RawFrame, name: str, shape: tuple[int, int]) -> Floats:
    plane = np.asarray(raw.planes[name])
    if plane.shape != shape:
        raise DataError(f"frame {raw.frame_id}: plane '{name}' has shape {plane.shape}; calibration needs {shape}")
    result: Floats = plane.astype(np.float32, copy=False)
    return result


def interval_m(camera: CwCamera) -> float:
    """Return the unambiguous range of a camera, of all its modulation frequencies together."""
    if camera.modulations_hz:
        return combine(camera.modulations_hz, camera.speed_of_light_mps).unambiguous_m
    return unambiguous_m(camera)
