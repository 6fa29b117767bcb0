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
    height, columns = light.shape[-2:]
    (out_down, in_down), (out_across, in_across) = (_spread(n, scattering.width * columns) for n in (height, columns))
    stray = light.dtype.type(scattering.stray_fraction)
    spread = out_down @ (in_down @ light @ in_across.T) @ out_across.T
    result: Floats = light * (1 - stray) + spread * stray
    return result


@lru_cache(maxsize=16)
def _spread(count: int, sigma: float) -> tuple[Floats, Floats]:
    """Return the matrix that spreads a line of `count` pixels by a Gaussian, as the product of two float32 matrices.

    A wide Gaussian is smooth, so that a few of the components of its singular value decomposition are all of it.
    """
    offsets = np.subtract.outer(np.arange(count), np.arange(count))
    falls = np.exp(-0.5 * (offsets / sigma) ** 2)
    u, size, v = np.linalg.svd(falls / falls.sum(axis=0))  # of what each pixel sends, all arrives
    kept = size > 1e-8 * size[0]
    return (u[:, kept] * size[kept]).astype(np.float32), v[kept].astype(np.float32)
