"""Continuous-wave ranging with the calibration that a frame carries: dark images before it, ranges after it."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any

import numpy as np

from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian
from rangecam.errors import DataError
from rangecam.types import Floats, RangeImage, RawFrame

Method = Callable[[RawFrame, CwCamera], RangeImage]

_MADE_FOR = ("kind", "pixel", "rows", "columns", "modulation_hz", "modulations_hz", "phase_sign", "speed_of_light_mps")


def made_for(camera: CwCamera, method: str) -> dict[str, Any]:
    """Return the facts by which a calibration is known to be one of this camera with this ranging method."""
    return {**{name: getattr(camera, name) for name in _MADE_FOR}, "method": method}


def calibrated(method: Method) -> Method:
    """Return the ranging method with every correction for which the frame carries the image of a calibration.

    Raises DataError for a plane that does not fit, beside what the method raises.
    """

    @wraps(method)
    def with_calibration(raw: RawFrame, camera: CwCamera) -> RangeImage:
        image = method(raw, camera)
        for name, correct in CORRECTIONS.items():
            if name in raw.planes:
                plane = np.asarray(raw.planes[name])
                if plane.shape != image.shape:
                    raise DataError(
                        f"frame {raw.frame_id}: plane '{name}' has shape {plane.shape}; calibration needs {image.shape}"
                    )
                image = correct(image, plane, camera)
        return image

    return with_calibration


def _without_pattern(image: RangeImage, offset_m: Floats, camera: CwCamera) -> RangeImage:
    """Return the ranges less the offset of each pixel, of one frequency in its unambiguous interval again."""
    range_m = image.range_m - offset_m
    if not camera.modulations_hz:
        range_m = np.mod(range_m, 2 * math.pi * metres_per_radian(camera))
    return replace(image, range_m=range_m.astype(np.float32))


CORRECTIONS: dict[str, Callable[[RangeImage, Floats, CwCamera], RangeImage]] = {"range_offset_m": _without_pattern}
"""What the planes of a calibration correct, by name and in this order: (image, plane, camera) -> image."""
PLANES = tuple(CORRECTIONS)
"""Beginnings of the names of planes that a calibration lays beside the samples."""
