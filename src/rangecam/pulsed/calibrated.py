"""Pulsed ranging with the calibration that a frame carries: offsets off before it, the line of each pixel after it."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any

import numpy as np

from rangecam.errors import DataError
from rangecam.pulsed.settings import PulsedCamera
from rangecam.types import RangeImage, RawFrame

Method = Callable[[RawFrame, PulsedCamera], RangeImage]

_MADE_FOR = (
    "readout", "shutters", "rows", "columns", "pulse_width_s", "laser_delay_s", "shutter_delay_s", "shutter_a_width_s",
    "shutter_b_width_s", "gradient_step_s", "gating_s", "delay_first_s", "delay_step_s", "delay_count", "offset_m",
)  # fmt: skip


def made_for(camera: PulsedCamera, method: str) -> dict[str, Any]:
    """Return the facts by which a calibration is known to be one of this camera with this ranging method (K-CAL-05)."""
    return {"method": method, **{name: getattr(camera, name) for name in _MADE_FOR}}


def calibrated(method: Method) -> Method:
    """Return the ranging method with calibration, if the frame has its planes (`rangecam.calibration.attach`).

    offset_* are taken off shutter_* (König 2008, 4.3.1), but saturated samples stay as they are. range_m becomes
    range_slope range_m + range_intercept_m, and sigma_m grows with the slope (4.3.2); the reasons are those of the
    method, whose limits are of the range before. Raises DataError for a plane that does not fit, beside what it raises.
    """

    @wraps(method)
    def with_calibration(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
        if "range_slope" not in raw.planes:
            return method(raw, camera)
        image = method(_without_offset(raw, camera), camera)
        slope, intercept_m = (_fitting(raw, name) for name in ("range_slope", "range_intercept_m"))
        range_m = (slope * image.range_m + intercept_m).astype(np.float32)
        return replace(image, range_m=range_m, sigma_m=(slope * image.sigma_m).astype(np.float32))

    return with_calibration


def _without_offset(raw: RawFrame, camera: PulsedCamera) -> RawFrame:
    planes, full_v = dict(raw.planes), camera.pixel.saturation_v * (1 - 1e-6)
    for name in raw.planes:
        shutter = name.replace("offset_", "shutter_")
        if name.startswith("offset_") and shutter in planes:
            value_v, offset_v = _fitting(raw, shutter), _fitting(raw, name)
            planes[shutter] = np.where(value_v < full_v, value_v - offset_v, value_v)
    return replace(raw, planes=planes)


def _fitting(raw: RawFrame, name: str) -> Any:
    """Return a plane; raises DataError if it is missing or not of the shape of the frame."""
    plane = np.asarray(raw.planes[name]) if name in raw.planes else np.empty(0)
    if plane.shape != raw.shape:
        raise DataError(f"frame {raw.frame_id}: plane '{name}' has shape {plane.shape}; calibration needs {raw.shape}")
    return plane
