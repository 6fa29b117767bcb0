"""Crosstalk: light and signals that reach pixels for which they are not meant (König 2008, 4.2.1.4).

Each part can be switched on by itself; the thesis could not tell them apart, so that their sizes are *open* but for
the blur, which follows from the lens. Optical parts move light, the electrical one adds to all signals.
"""

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from rangecam.optics import blur_radius_m
from rangecam.settings import Fraction, NonNegative, Positive, settings
from rangecam.types import Floats

if TYPE_CHECKING:
    from rangecam.pulsed.settings import PulsedCamera

_NEAREST_FOCAL_LENGTHS = 2.0
_BOUNCES = 3
_ROUNDS = 12
_STEPS_ON_RADIUS, _STEPS_ON_ANGLE = 8, 12


@settings
class Crosstalk:
    """What of the light and the signal of a pixel reaches others (König 2008, 4.2.1.4; simulation, but `correct`)."""

    blur: bool = False
    """The image of what is near is a disc, because the lens is focused at infinity (eq 4.19; K-OPT-09)."""
    stray_fraction: Fraction = 0.0
    """Part of all light that the objective spreads over the whole sensor; 0.005-0.04 in 4.2.1.4 (K-OPT-11)."""
    cover_glass_fraction: Fraction = 0.0
    """Part of the light that sensor and cover glass reflect back onto the sensor (K-OPT-12). *open*"""
    cover_glass_gap_m: Positive = 0.5e-3
    """Distance of the reflecting face of the cover glass from the sensor. *open*"""
    electrical_fraction: NonNegative = 0.0
    """Part of the mean signal of all pixels that references couple into each (K-PIX-17). *open*"""
    correct: bool = False
    """Take off, before ranging, what stray light, cover glass and references have brought from other pixels; their
    sizes are those above. Blur stays: it depends on the range."""


def optical(light: Floats, depth_m: Floats, camera: "PulsedCamera") -> Floats:
    """Return what light makes of the pixels, (H, W) of the same unit: the mean over the rays, with optical crosstalk.

    light, depth_m (K, H, W): exposure by each ray, and how far its source is along the axis.
    """
    if not camera.crosstalk.blur:
        return _scattered(light[0] if len(light) == 1 else light.mean(axis=0), camera)
    objective, pixel = camera.objective, camera.pixel
    radius_m = blur_radius_m(np.maximum(depth_m, _NEAREST_FOCAL_LENGTHS * objective.focal_length_m), objective)
    blurred = np.zeros(light.shape[1:])
    down, right = radius_m / pixel.pitch_vertical_m, radius_m / pixel.pitch_horizontal_m
    _blur(np.asarray(light, np.float64), down, right, *_quarter_disc(), blurred)
    return _scattered(blurred, camera)


def electrical(signal: Floats, crosstalk: Crosstalk) -> Floats:
    """Return signals (..., H, W) with what the common references couple into each from all (K-PIX-17)."""
    if not crosstalk.electrical_fraction:
        return signal
    coupled: Floats = signal + crosstalk.electrical_fraction * signal.mean(axis=(-2, -1), keepdims=True)
    return coupled


def foreign_light(signal: Floats, camera: "PulsedCamera") -> Floats:
    """Return what of signals (H, W) came from other pixels by the parts that are linear and known: all but the blur.

    Solves signal = F(light) for the light, whose own share a pixel keeps, by going round.
    """
    keep = (1 - camera.crosstalk.stray_fraction) * (1 - camera.crosstalk.cover_glass_fraction)
    foreign = np.zeros_like(signal)
    if keep <= 0:
        return foreign
    for _ in range(_ROUNDS):
        light = (signal - foreign) / keep
        foreign = electrical(_scattered(light, camera), camera.crosstalk) - keep * light
    return foreign


def _scattered(light: Floats, camera: "PulsedCamera") -> Floats:
    """Return light (H, W) after stray light in the objective and reflections of the cover glass; its sum stays."""
    crosstalk = camera.crosstalk
    if crosstalk.stray_fraction:
        light = light + crosstalk.stray_fraction * (light.mean() - light)
    if crosstalk.cover_glass_fraction:
        reflected, padded = _glass(light.shape, camera)
        through = np.fft.irfft2(np.fft.rfft2(light, padded) * reflected, padded)
        top, left = (padded[0] - light.shape[0]) // 2, (padded[1] - light.shape[1]) // 2
        light = through[top : top + light.shape[0], left : left + light.shape[1]]
    return light


@lru_cache(maxsize=4)
def _glass(shape: tuple[int, int], camera: "PulsedCamera") -> tuple[Any, tuple[int, int]]:
    """Return the spectrum of what a lit pixel becomes under the cover glass, and the padded size of its image.

    At each bounce the fraction g goes on, and the cone of light from the lens widens: its rays, evenly spread over the
    aperture, land on a disc of radius 2 gap tan = gap / f# more. What falls beside the sensor is lost.
    """
    g, pixel = camera.crosstalk.cover_glass_fraction, camera.pixel
    radius_m = camera.crosstalk.cover_glass_gap_m / camera.objective.f_number
    reach = [
        min(size - 1, math.ceil(_BOUNCES * radius_m / pitch) + 1)
        for size, pitch in zip(shape, (pixel.pitch_vertical_m, pixel.pitch_horizontal_m), strict=True)
    ]
    spread = np.zeros((2 * reach[0] + 1, 2 * reach[1] + 1))
    for bounce in range(_BOUNCES + 1):
        disc = disc_weights(
            bounce * radius_m / pixel.pitch_vertical_m, bounce * radius_m / pixel.pitch_horizontal_m, spread.shape
        )
        spread += (1 - g) * g**bounce * disc
    padded = shape[0] + 2 * reach[0], shape[1] + 2 * reach[1]
    return np.fft.rfft2(spread, padded), padded


def disc_weights(down: float, right: float, shape: tuple[int, int]) -> Floats:
    """Return how an evenly lit pixel spreads over itself, in the middle, and its neighbours when points become discs.

    down, right: radius of the disc in pixels of each direction. shape: odd sizes of the returned image; what falls
    beyond it is left out.
    """
    one, weights = np.ones((1, 1, 1)), np.zeros(shape)
    middle = np.zeros((1, *shape))
    middle[0, shape[0] // 2, shape[1] // 2] = 1.0
    _blur(middle, one * down * np.ones(shape), one * right * np.ones(shape), *_quarter_disc(), weights)
    return weights


@lru_cache(maxsize=1)
def _quarter_disc() -> tuple[Floats, Floats, Floats]:
    """Return y, x and weights of points that stand for a quarter of the unit disc; the weights add up to 1/4."""
    u, weight_u = np.polynomial.legendre.leggauss(_STEPS_ON_RADIUS)
    v, weight_v = np.polynomial.legendre.leggauss(_STEPS_ON_ANGLE)
    radius = np.sqrt((u + 1) / 2)[:, None]
    angle = (v + 1) * math.pi / 4
    weights = np.outer(weight_u, weight_v) / 16
    return (radius * np.sin(angle)).ravel(), (radius * np.cos(angle)).ravel(), weights.ravel()


@njit(cache=True, nogil=True)
def _blur(light: Any, down: Any, right: Any, points_y: Any, points_x: Any, weights: Any, out: Any) -> Any:
    """Add the light of every ray and pixel (K, H, W) to `out` (H, W), their mean over the rays spread over discs.

    down, right (K, H, W): radius of the disc, pixels. Shifted by less than a pixel, an evenly lit pixel covers its
    neighbour in proportion to the shift, so that discs smaller than a pixel need the means over the disc only:
    4r/(3 pi) of a coordinate, r2/(2 pi) of the product of both.
    """
    count, rows, columns = light.shape
    for k in range(count):
        for r in range(rows):
            for c in range(columns):
                share, y, x = light[k, r, c] / count, down[k, r, c], right[k, r, c]
                if share == 0:
                    continue
                if y <= 1 and x <= 1:
                    _add(share, 0, 0, 4 * y / (3 * np.pi), 4 * x / (3 * np.pi), y * x / (2 * np.pi), r, c, out)
                    continue
                for q in range(weights.size):
                    dy, dx = y * points_y[q], x * points_x[q]
                    i, j = int(dy), int(dx)
                    fy, fx = dy - i, dx - j
                    _add(share * 4 * weights[q], i, j, fy, fx, fy * fx, r, c, out)


@njit(cache=True, nogil=True, inline="always")
def _add(share: Any, i: Any, j: Any, fy: Any, fx: Any, fyx: Any, r: Any, c: Any, out: Any) -> Any:
    """Add light that is shifted by (i + fy, j + fx) pixels in all four directions; fyx: mean of the product."""
    rows, columns = out.shape
    for down in range(2):
        for right in range(2):
            part = fyx if down and right else (fy - fyx if down else (fx - fyx if right else 1 - fy - fx + fyx))
            for side_y in (-1, 1):
                for side_x in (-1, 1):
                    row, column = r + side_y * (i + down), c + side_x * (j + right)
                    if 0 <= row < rows and 0 <= column < columns:
                        out[row, column] += share * part / 4
