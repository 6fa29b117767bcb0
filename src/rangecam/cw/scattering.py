"""Light scattering in the lens: a small part of the light of each pixel is spread over the image (S-EFF-04)."""

from functools import lru_cache

import numpy as np

from rangecam.cw.effects import Scattering
from rangecam.types import Floats


def scatter(light: Floats, scattering: Scattering) -> Floats:
    """Return images of light (..., H, W), real or complex, with the stray part of each pixel spread over the image.

    Light adds linearly, so this holds for phasors and for samples before saturation alike (Mure-Dubois and Hügli 2007).
    All of it lands on the sensor: the sum over the image stays.
    """
    if not scattering.stray_fraction:
        return light
    down, across = scattering_matrices(scattering.width, light.shape[-2:])
    stray = light.dtype.type(scattering.stray_fraction)
    result: Floats = light * (1 - stray) + (down @ light @ across.T) * stray
    return result


@lru_cache(maxsize=8)
def scattering_matrices(width: float, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return the matrices (H, H) and (W, W) float32 that spread each column and each row: down @ image @ across.T."""
    height, columns = shape
    return _gaussian(height, width * columns), _gaussian(columns, width * columns)


def _gaussian(count: int, sigma: float) -> Floats:
    """Return the part of the light of each pixel (second axis) that lands on each pixel (first axis) of a line."""
    offsets = np.subtract.outer(np.arange(count), np.arange(count))
    falls = np.exp(-0.5 * (offsets / sigma) ** 2)
    result: Floats = (falls / falls.sum(axis=0)).astype(np.float32)
    result.setflags(write=False)
    return result
