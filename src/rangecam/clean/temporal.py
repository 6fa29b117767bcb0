"""Averaging over time where nothing moves."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter

from rangecam.clean.filters import shared_noise_pixels
from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints, RangeImage

_WINDOW = 7
"""Rows and columns over which motion is looked for."""


def settle(
    range_m: Floats, sigma_m: Floats, why: Ints, before: RangeImage, settings: CleanSettings
) -> tuple[Floats, Floats]:
    """Return range and sigma of each pixel averaged with `before`, the result of the last frame: (H, W) float32 m each.

    A Kalman filter for each pixel, which trusts the past less the more the changes around the pixel exceed the noise:
    the square of the mean change of 7x7 pixels, less what noise would make it, is added to the variance of the past.
    So motion that no single pixel shows ends the averaging, and what of it stays unseen is in sigma. A pixel that
    changed by more than the gate, or that is new, begins anew. Gain at least 1 / `temporal_frames`.
    Successive images share noise then, which a tracker must know: `shared_noise_pixels` tells it.
    """
    shared = shared_noise_pixels(replace(settings, temporal_frames=1.0))
    both = (why == 0) & (before.why == 0)
    with np.errstate(invalid="ignore"):  # whatever stands in pixels that are invalid
        change = np.where(both, range_m - before.range_m, 0.0)
        past, now = np.where(both, before.sigma_m, 1.0) ** 2, np.where(both, sigma_m, 1.0) ** 2
    variance = past + now
    number = np.maximum(uniform_filter(both.astype(float), _WINDOW, mode="constant") * _WINDOW**2, 1.0)
    mean = uniform_filter(change / np.sqrt(variance), _WINDOW, mode="constant") * _WINDOW**2 / number
    past = past + np.maximum(mean**2 - np.minimum(shared / number, 1.0), 0.0) * variance
    gain = np.maximum(past / (past + now), 1 / settings.temporal_frames)
    kept = both & (change**2 <= settings.temporal_gate_sigmas**2 * variance)
    settled = np.where(kept, before.range_m + gain * change, range_m)
    sigma = np.where(kept, np.sqrt((1 - gain) ** 2 * past + gain**2 * now), sigma_m)
    return settled.astype(np.float32), sigma.astype(np.float32)
