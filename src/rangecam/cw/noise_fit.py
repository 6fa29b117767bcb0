"""The noise of the samples of a continuous-wave camera, from frames in which nothing changes."""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from rangecam.calibration import Recording, estimate_dark
from rangecam.calibration.noise import NoiseFit, fit_noise
from rangecam.cw.phasor import harmonic_weights
from rangecam.cw.sequence import plane_name, single_frequencies
from rangecam.cw.settings import CwCamera
from rangecam.errors import DataError
from rangecam.types import Floats

_FAR_FROM_LIMITS = 0.05


def still_samples(
    recordings: Sequence[Recording], camera: CwCamera
) -> tuple[dict[str, Floats], dict[str, Floats], int]:
    """Return mean and variance of the samples over frames that saw the same, without pseudo rows, and how many."""
    frames = chain.from_iterable(each.frames for each in recordings)
    still = estimate_dark(frames, "f" if camera.modulations_hz else "phase_")
    if still.frames[0] < 2:
        raise DataError("one frame has no variance; take two or more of the same scene")
    mean, variance = (
        {name: stack[0, camera.pseudo_rows :] for name, stack in each.items()} for each in (still.mean, still.variance)
    )
    return mean, variance, int(still.frames[0])


def fit_sample_noise(
    mean: Mapping[str, Floats], variance: Mapping[str, Floats], frames: int, camera: CwCamera
) -> NoiseFit:
    """Return the line of the variance of the samples over the light in them, from `still_samples`.

    Samples near the limits of the converter do not count. The light in a differential pixel shows in the amplitude
    alone: beside `ambient_lsb`, it is taken for amplitude / contrast. Raises DataError as `fit_noise` does.
    """
    light, inside = _light(mean, camera), _far_from_limits(mean, camera)
    x, y = (np.stack([each[name][inside] for name in mean]).ravel() for each in (light, variance))
    return fit_noise(x, y, frames, camera.quantisation_lsb**2 / 12)


def _light(mean: Mapping[str, Floats], camera: CwCamera) -> dict[str, Floats]:
    """Return how much light there was in each mean sample, LSB."""
    if camera.pixel == "single_ended":
        return {name: level - camera.black_level_lsb for name, level in mean.items()}
    weights = harmonic_weights(camera.phase_steps_deg)
    result: dict[str, Floats] = {}
    for k in range(len(single_frequencies(camera))):
        names = [plane_name(step, k if camera.modulations_hz else None) for step in camera.phase_steps_deg]
        phasor = np.tensordot(weights, np.stack([mean[name] for name in names]), 1)
        light = np.hypot(*phasor) / camera.demodulation_contrast + camera.ambient_lsb
        result |= dict.fromkeys(names, light)
    return result


def _far_from_limits(mean: Mapping[str, Floats], camera: CwCamera) -> Any:
    """Return the pixels (H, W) of which no sample is within a twentieth of the limits of the converter."""
    low, high = camera.lower_limit_lsb, camera.full_scale_lsb
    margin = _FAR_FROM_LIMITS * (high - (low or 0.0)) if high is not None else 0.0
    level = np.stack([*mean.values()])
    least = -np.inf if low is None else low + margin if camera.pixel == "differential" else low
    return ((level >= least) & (level <= (np.inf if high is None else high - margin))).all(axis=0)
