"""What a continuous-wave pixel makes of light: taps and their limits, fixed pattern, drift with the temperature."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.effects import FixedPattern
from rangecam.cw.settings import CwCamera
from rangecam.types import Floats


def respond(light: Floats, camera: CwCamera) -> tuple[Floats, Floats]:
    """Return what a pixel makes of its light (2, H, W): the mean sample and all the light, each (H, W) float32 in LSB.

    A sample is black level + difference of the two taps; that of a single-ended pixel black level + one tap. The
    circuit against ambient light takes the same from both taps of a differential pixel, as far as it can; then each
    tap saturates at its full well (S-EFF-02, S-EFF-03). Gain and offset of the pixel come last.
    """
    signal, total = light
    single, taps = camera.pixel == "single_ended", camera.taps
    pattern = fixed_pattern(camera, (signal.shape[0], signal.shape[1]))
    sample = np.empty_like(signal)
    collected = np.empty_like(signal) if single else total
    _respond(
        (signal.ravel(), total.ravel()),
        (pattern.gain.ravel(), pattern.offset_lsb.ravel(), np.float32(camera.black_level_lsb)),
        np.float32(np.inf if taps.full_well_lsb is None else taps.full_well_lsb),
        np.float32(taps.ambient_suppression_lsb),
        taps.saturated_reads_full_scale and camera.full_scale_lsb is not None,
        (sample.ravel(), collected.ravel()) if single else (sample.ravel(), sample[:0].ravel()),
    )
    return sample, collected


@njit(cache=True, nogil=True)
def _respond(light: Any, pattern: Any, full: Any, suppression: Any, flagged: Any, result: Any) -> Any:
    """Fill the samples and, of a single-ended pixel, all the light; infinite where a full well reads full scale."""
    (signal, total), (gain, offset_lsb, black_lsb), (sample, collected) = light, pattern, result
    single, two, infinite = len(collected) > 0, np.float32(2), np.float32(np.inf)
    for i in range(len(sample)):
        value = signal[i] + total[i] if single else signal[i]
        if single:
            collected[i] = value
        if full < infinite:
            first = value if single else (total[i] + value) / two
            second = np.float32(0) if single else (total[i] - value) / two
            if not single:
                suppressed = min(min(first, second), suppression)
                first, second = first - suppressed, second - suppressed
            value = min(first, full) - min(second, full)
            if flagged and max(first, second) > full:
                value = infinite
        sample[i] = value * gain[i] + (offset_lsb[i] + black_lsb)


@dataclass(frozen=True, eq=False)
class Pattern:
    """What is different in every pixel, (H, W) float32: added to the range, factor of a sample, added to a sample."""

    range_m: Floats
    gain: Floats
    offset_lsb: Floats


def fixed_pattern(camera: CwCamera, shape: tuple[int, int]) -> Pattern:
    """Return the fixed pattern of the sensor (S-EFF-11): the truth for its calibration."""
    return _fixed_pattern(camera.fixed_pattern, camera.binning, shape)


@lru_cache(maxsize=8)
def _fixed_pattern(settings: FixedPattern, binning: int, shape: tuple[int, int]) -> Pattern:
    rng = np.random.default_rng(settings.seed)
    sigmas = np.array([settings.range_sigma_m, settings.gain_sigma, settings.offset_sigma_lsb]) / binning
    range_m, gain, offset_lsb = (rng.standard_normal((3, *shape)) * sigmas[:, None, None]).astype(np.float32)
    return Pattern(range_m + np.float32(settings.global_offset_m), 1 + gain, offset_lsb)


def temperature_c(camera: CwCamera, time_s: float) -> float:
    """Return the temperature of the camera at `time_s` after it was switched on; a rise of first order (S-EFF-11)."""
    its = camera.temperature
    return its.temperature_c - its.self_heating_k * math.expm1(-max(time_s, 0.0) / its.heating_time_s)


def range_shift_m(camera: CwCamera, time_s: float, shape: tuple[int, int]) -> Floats:
    """Return what fixed pattern and temperature add to the range of each pixel, (H, W) float32 m: the truth for both.

    `offset_m`, which ranging adds, is not in it.
    """
    return fixed_pattern(camera, shape).range_m + drift_m(camera, time_s)


def drift_m(camera: CwCamera, time_s: float) -> np.float32:
    """Return what the temperature adds to every range, m (S-EFF-11)."""
    warmer_k = temperature_c(camera, time_s) - camera.temperature.reference_c
    return np.float32(camera.temperature.drift_m_per_k * warmer_k)
