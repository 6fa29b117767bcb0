"""Pulsed ranging without the crosstalk that is linear and known: what came from other pixels is taken off before it."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps

import numpy as np

from rangecam.pulsed.crosstalk import foreign_light
from rangecam.pulsed.pixel import accumulated
from rangecam.pulsed.settings import Crosstalk, PulsedCamera
from rangecam.types import Image, RangeImage, RawFrame

Method = Callable[[RawFrame, PulsedCamera], RangeImage]


def without_crosstalk(method: Method) -> Method:
    """Return the ranging method that takes off what came from other pixels, with `camera.crosstalk.correct` (K-FUT-01).

    The part of its own light that a pixel keeps stays as it is, so that sigma stays true. Of shutters it takes the
    signal of one pulse, of taps what is above their dark image; a full sample stays full, and as it gave more than is
    known of it, its neighbours keep the rest.
    """

    @wraps(method)
    def corrected(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
        if not (camera.crosstalk.correct and _is_known(camera.crosstalk)):
            return method(raw, camera)
        return method(_taken_off(raw, camera), camera)

    return corrected


def _taken_off(raw: RawFrame, camera: PulsedCamera) -> RawFrame:
    planes = dict(raw.planes)
    n_acc = np.asarray(planes.get("n_acc", np.ones(raw.shape)), np.float64)
    per_pulse = np.where(n_acc >= 1, accumulated(1.0, np.maximum(n_acc, 1), camera.pixel), 0.0)
    zero: Image | float
    for name, plane in raw.planes.items():
        if name.startswith("shutter_"):
            zero, gain, full = 0.0, per_pulse, camera.pixel.saturation_v * (1 - 1e-6)
        elif name in ("tap_1", "tap_2", "tap_3"):
            zero = planes.get(name.replace("tap_", "dark_"), camera.taps.black_level_counts)
            gain, full = np.ones(raw.shape), camera.taps.saturation_counts
        else:
            continue
        value = np.asarray(plane, np.float64)
        usable = np.isfinite(value - zero) & (gain > 0)
        signal = np.where(usable, value - zero, 0.0) / np.where(usable, gain, 1.0)
        planes[name] = np.where(value < full, value - gain * foreign_light(signal, camera), value)
    return replace(raw, planes=planes)


def _is_known(crosstalk: Crosstalk) -> bool:
    return max(crosstalk.stray_fraction, crosstalk.cover_glass_fraction, crosstalk.electrical_fraction) > 0
