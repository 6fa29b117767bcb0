"""Measurements with the simulated camera, as the experiments of the thesis take them: many images of a target."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rangecam.pulsed import RANGING
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import targets_on_axis
from rangecam.pulsed.settings import PulsedCamera
from rangecam.scene.view import View
from rangecam.types import Floats, Why

RISE_S, FALL_S, SHUTTER_EDGE_S = 60e-9, 30e-9, 65e-9
"""Edges of pulse and shutter as the thesis measured them (4.2.1.2, 4.2.2.1)."""


class Ranged(NamedTuple):
    """Mean and standard deviation of measured ranges, accumulations, part of them that was usable: (N,) each."""

    mean_m: Floats
    sigma_m: Floats
    n_acc: Floats
    usable: Floats


def measured_edges(camera: PulsedCamera) -> PulsedCamera:
    """Return the camera with the edges of pulse and shutter that the thesis measured."""
    return replace(camera, pulse_rise_s=RISE_S, pulse_fall_s=FALL_S, shutter_edge_s=SHUTTER_EDGE_S)


def quiet(camera: PulsedCamera) -> PulsedCamera:
    """Return the camera without noise and rounding."""
    pixel = replace(camera.pixel, sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0)
    return replace(camera, pixel=pixel)


def looking_at(view: View) -> Callable[[float], View]:
    """Return what a camera sees of a scene that stands still, as a function of time."""
    return lambda _: view


def ranged(
    at_m: ArrayLike,
    reflectivity: float,
    camera: PulsedCamera,
    method: str,
    repeats: int,
    rng: np.random.Generator,
    ambient_wpm2: float = 0.0,
) -> Ranged:
    """Return what `repeats` images of targets on the axis give.

    Ranges that are OUT_OF_RANGE only because they might lie beyond the end count: without them the spread would be too
    small there.
    """
    many, view = targets_on_axis(at_m, reflectivity, camera, repeats)
    view = replace(view, ambient_wpm2=ambient_wpm2)
    raw = simulate(looking_at(view), many, 0.0, rng)
    image = RANGING[method](raw, many)
    known = (image.valid | (image.why == Why.OUT_OF_RANGE)) & np.isfinite(image.range_m)
    ranges_m = np.where(known, image.range_m, 0.0).astype(np.float64)
    count = np.maximum(known.sum(axis=0), 1)
    mean_m = ranges_m.sum(axis=0) / count
    variance = np.where(known, (ranges_m - mean_m) ** 2, 0.0).sum(axis=0) / count
    return Ranged(mean_m, np.sqrt(variance), np.median(raw.planes["n_acc"], axis=0), known.mean(axis=0))
