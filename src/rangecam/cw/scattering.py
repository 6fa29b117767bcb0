"""Light scattering in the lens: a small part of the light of each pixel is spread over the image (S-EFF-04)."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rangecam.cw.effects import Scattering
from rangecam.types import Floats

Light = NDArray[Any]
"""Images (..., H, W), real or complex: light adds linearly, phasors and samples before saturation alike."""


def scatter(light: Light, scattering: Scattering) -> Light:
    """Return images of light (..., H, W), real or complex, with the stray part of each pixel spread over the image.

    Light adds linearly, so this holds for phasors and for samples before saturation alike (Mure-Dubois and Hügli 2007).
    All of it lands on the sensor: the sum over the image stays.
    """
    if not scattering.stray_fraction:
        return light
    stray = light.dtype.type(scattering.stray_fraction)
    result = _spread(light, scattering, np.multiply.outer)
    result *= stray
    result += light * (1 - stray)
    return result


def stray_light(light: Light, scattering: Scattering) -> Light:
    """Return the part of scattered images (..., H, W) that is stray light: the inverse of `scatter`.

    With `light` = scatter(x), `light` less the result is (1 - stray fraction) x: what went straight, with the noise of
    `light`, for the stray part is an average of so many pixels that it adds none. It is exact, not a series: spreading
    multiplies each component of a wide Gaussian by a number, and so does its inverse.
    """
    f = scattering.stray_fraction

    def of_component(down: Floats, across: Floats) -> Floats:
        size = np.multiply.outer(down, across)
        result: Floats = f * size / (1 - f + f * size)
        return result

    return _spread(light, scattering, of_component) if f else np.zeros_like(light)


def _spread(light: Light, scattering: Scattering, weigh: Any) -> Light:
    """Return the images with each of their components multiplied by weigh(its sizes down and across)."""
    height, columns = light.shape[-2:]
    sigma = scattering.width * columns
    (back_down, into_down, down), (back_across, into_across, across) = (_modes(n, sigma) for n in (height, columns))
    components = into_down @ light @ into_across.T
    result: Light = back_down @ (components * weigh(down, across).astype(np.float32)) @ back_across.T
    return result


@lru_cache(maxsize=16)
def _modes(count: int, sigma: float) -> tuple[Floats, Floats, Floats]:
    """Return how a line of `count` pixels is made of the components of a Gaussian, how it is taken apart, their sizes.

    The matrix that spreads, columns of F divided by their sums D so that all the light arrives, is back sizes into with
    the symmetric D^-1/2 F D^-1/2 = Q sizes Q^T, back = D^1/2 Q and into = Q^T D^-1/2. A wide Gaussian is smooth: few
    components are all of it.
    """
    offsets = np.subtract.outer(np.arange(count), np.arange(count))
    falls = np.exp(-0.5 * (offsets / sigma) ** 2)
    root = np.sqrt(falls.sum(axis=0))
    size, q = np.linalg.eigh(falls / np.outer(root, root))
    kept = size > 1e-8 * size[-1]
    back, into = root[:, None] * q[:, kept], (q[:, kept] / root[:, None]).T
    return back.astype(np.float32), into.astype(np.float32), size[kept]
