"""What differs from pulse to pulse: jitter of the laser, and ambient light that changes while it is subtracted."""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.pulsed.feasible import cycles
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.types import Floats


def differ(camera: PulsedCamera) -> bool:
    """Return whether anything differs from pulse to pulse."""
    laser = camera.laser
    return max(laser.amplitude_jitter, laser.trigger_jitter_s, camera.background.fluctuation) > 0


def mean_of_pulses(
    single_v: Floats, slope_vps: Floats, ambient_v: Floats, camera: PulsedCamera, rng: np.random.Generator
) -> Floats:
    """Return the mean signal of a pulse at each read-out, (averages, K, S, H, W) V (K-ILL-07, K-PIX-07).

    single_v, ambient_v (S, H, W): what laser and background make in one exposure on average. slope_vps: how the first
    grows with the delay of the laser; linear within the jitter. Background changes between the exposures with the laser
    on and off, whose distance is that of the bit pattern. What of earlier pulses is lost (eq 4.17) counts less.
    """
    laser, background = camera.laser, camera.background
    pulses, shape = max(camera.pixel.accumulations), (camera.averages, len(single_v))
    strength = 1 + laser.amplitude_jitter * rng.standard_normal((*shape, pulses))
    late_s = laser.trigger_jitter_s * rng.standard_normal((*shape, pulses))
    gaps_s = np.array([cycle.off_after_s for cycle in cycles(camera)])
    apart_s = (len(single_v) if camera.shutter_order == "alternating" else 1) / laser.repetition_hz
    change = np.empty((*shape, pulses))
    deviates = rng.standard_normal((*shape, pulses, 2))
    _change_of_background(deviates, gaps_s / background.correlation_s, apart_s / background.correlation_s, change)
    weights = _weights(camera.pixel)
    by_read_out = [np.moveaxis(each @ weights.T, 2, 1)[..., None, None] for each in (strength, late_s, change)]
    mean_v: Floats = (
        by_read_out[0] * single_v + by_read_out[1] * slope_vps + background.fluctuation * by_read_out[2] * ambient_v
    )
    return mean_v


@lru_cache(maxsize=8)
def _weights(pixel: Pixel) -> Floats:
    """Return the weight of each pulse in each read-out, (K, pulses): the last count most, and a sum of 1."""
    steps, pulse = np.array(sorted(pixel.accumulations))[:, None], np.arange(1, max(pixel.accumulations) + 1)
    weights = np.where(pulse <= steps, np.exp(-pixel.damping * np.maximum(steps - pulse, 0)), 0.0)
    result: Floats = weights / weights.sum(axis=1, keepdims=True)
    return result


@njit(cache=True, nogil=True)
def _change_of_background(deviates: Any, gaps: Any, apart: Any, change: Any) -> Any:
    """Fill the difference of a random walk with a mean (Ornstein-Uhlenbeck, variance 1) before and after each gap.

    Times in units of the correlation time; apart: from pulse to pulse.
    """
    averages, windows, pulses = change.shape
    for a in range(averages):
        for s in range(windows):
            level = deviates[a, s, 0, 0]
            within, between = np.exp(-gaps[s]), np.exp(-max(apart - gaps[s], 0.0))
            for i in range(pulses):
                if i > 0:
                    level = between * level + np.sqrt(1 - between**2) * deviates[a, s, i, 0]
                after = within * level + np.sqrt(1 - within**2) * deviates[a, s, i, 1]
                change[a, s, i] = level - after
                level = after
