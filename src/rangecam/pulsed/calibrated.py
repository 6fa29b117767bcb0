"""Pulsed ranging with the calibration of a camera: offsets off before it, curve and the line of each pixel after."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, wraps
from typing import Any

import numpy as np

from rangecam.calibration.distance import Line, apply_curve
from rangecam.errors import DataError, UsageError
from rangecam.pulsed.settings import PulsedCamera
from rangecam.types import Floats, RangeImage, RawFrame, Why

Method = Callable[[RawFrame, PulsedCamera], RangeImage]

_MADE_FOR = (
    "kind", "readout", "shutters", "rows", "columns", "pulse_width_s", "laser_delay_s", "shutter_delay_s",
    "shutter_a_width_s", "shutter_b_width_s", "gradient_step_s", "gating_s", "delay_first_s", "delay_step_s",
    "delay_count", "gate_width_s", "pulse_lead_s", "speed_of_light_mps",
)  # fmt: skip
SLOPE, INTERCEPT = "range_slope", "range_intercept_m"
PLANES = ("offset_", SLOPE, INTERCEPT)
"""Beginnings of the names of planes that a calibration lays beside the samples."""


def made_for(camera: PulsedCamera, method: str) -> dict[str, Any]:
    """Return the facts by which a calibration is known to be one of this camera with this ranging method (K-CAL-05)."""
    return {**{name: getattr(camera, name) for name in _MADE_FOR}, "method": method}


def calibrated(method: Method) -> Method:
    """Return the ranging method with calibration, if the frame has its planes or the camera a `range_curve_m`.

    offset_* are taken off shutter_* (König 2008, 4.3.1), but saturated samples stay as they are. The range goes through
    the curve, then range_slope range + range_intercept_m (4.3.2), then gets `offset_m`; sigma_m grows with the slopes.
    The limits of the method hold before, `min_range_m` and `max_range_m` after. Raises DataError for a plane that does
    not fit and UsageError for a curve that does not rise, beside what the method raises.
    """

    @wraps(method)
    def with_calibration(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
        if not (camera.range_curve_m or _has_calibration(tuple(raw.planes))):
            return method(raw, camera)
        bare, points = _before(camera)
        image = method(_without_offset(raw, camera), bare)
        if SLOPE in raw.planes or INTERCEPT in raw.planes:
            line = Line(_fitting(raw, SLOPE), _fitting(raw, INTERCEPT) + camera.offset_m)
        else:
            line = Line(np.ones(raw.shape), np.full(raw.shape, camera.offset_m))
        return _limited(apply_curve(image, points, line, camera.far_margin_sigmas), camera)

    return with_calibration


@lru_cache(maxsize=64)
def _has_calibration(names: tuple[str, ...]) -> bool:
    return any(name.startswith(PLANES) for name in names)


@lru_cache(maxsize=8)
def _before(camera: PulsedCamera) -> tuple[PulsedCamera, Floats]:
    """Return the camera whose ranges are calibrated, without what belongs after that, and the points of its curve."""
    points = np.array(camera.range_curve_m, np.float64).reshape(-1, 2)
    if len(points) == 1 or (np.diff(points, axis=0) <= 0).any():
        raise UsageError(
            "camera.range_curve_m: needs two or more points (measured, true), and both must increase from each to the "
            "next"
        )
    # low and high of the true range mean nothing for the measured one
    return replace(camera, offset_m=0.0, min_range_m=-np.inf, max_range_m=None), points


def _limited(image: RangeImage, camera: PulsedCamera) -> RangeImage:
    """Return the image with what the user does not want marked OUT_OF_RANGE."""
    high_m = np.inf if camera.max_range_m is None else camera.max_range_m
    outside = (image.why == Why.VALID) & ((image.range_m < camera.min_range_m) | (image.range_m > high_m))
    return replace(image, why=np.where(outside, np.uint8(Why.OUT_OF_RANGE), image.why))


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
