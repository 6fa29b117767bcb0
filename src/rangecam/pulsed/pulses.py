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
    deviates = rng.standard_normal((4, *shape, pulses))
    gaps_s = np.array([cycle.off_after_s for cycle in cycles(camera)])
    apart_s = (len(single_v) if camera.shutter_order == "alternating" else 1) / laser.repetition_hz
    correlation_s = background.correlation_s
    _change_of_background(deviates[2], deviates[3], gaps_s / correlation_s, apart_s / correlation_s)
    by_read_out = (deviates[:3] @ _weights(camera.pixel).T).swapaxes(2, 3)[..., None, None]
    stronger, late_s, change = (
        size * mean
        for size, mean in zip(
            (laser.amplitude_jitter, laser.trigger_jitter_s, background.fluctuation), by_read_out, strict=True
        )
    )
    mean_v: Floats = (1 + stronger) * single_v + late_s * slope_vps + change * ambient_v
    return mean_v


@lru_cache(maxsize=8)
def _weights(pixel: Pixel) -> Floats:
    """Return the weight of each pulse in each read-out, (K, pulses): the last count most, and a sum of 1."""
    steps, pulse = np.array(sorted(pixel.accumulations))[:, None], np.arange(1, max(pixel.accumulations) + 1)
    weights = np.where(pulse <= steps, np.exp(-pixel.damping * np.maximum(steps - pulse, 0)), 0.0)
    result: Floats = weights / weights.sum(axis=1, keepdims=True)
    return result


@njit(cache=True, nogil=True)
def _change_of_background(first: Any, second: Any, gaps: Any, apart: Any) -> Any:
    """Turn deviates (averages, S, pulses) into the fall of a random walk with a mean within each gap, in `first`.

    It is that of Ornstein and Uhlenbeck, with variance 1. Times in units of its correlation time; apart: from pulse to
    pulse.
    """
    averages, windows, pulses = first.shape
    for a in range(averages):
        for s in range(windows):
            within, between = np.exp(-gaps[s]), np.exp(-max(apart - gaps[s], 0.0))
            after = 0.0
            for i in range(pulses):
                z = first[a, s, i]
                before = z if i == 0 else between * after + np.sqrt(1 - between**2) * z
                after = within * before + np.sqrt(1 - within**2) * second[a, s, i]
                first[a, s, i] = before - after
