"""From the samples of a camera to the microcontroller's words, and from its millimetres to a range image."""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rangecam.cw.fixed_point.chain import integer_chain
from rangecam.cw.fixed_point.program import PLANES, compiled
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.geometry import rays
from rangecam.planes import plane_of
from rangecam.types import Floats, Image, Ints, RangeImage, RawFrame, Why

_SQUARED_ERROR = np.array([1, 1, 1, 0.448671, 0.448671, 0.286834, 0.286834, 0.210447, 0.210447, 0.166101])
# of the median of n = 0..9 normal values of variance 1 about their mean; the upper one of two is off that by its bias


def cw_emulation(raw: RawFrame, camera: CwCamera) -> RangeImage:
    """Return the range image that the microcontroller makes of four phase images, cleaned as it cleans.

    Planes phase_0, phase_90, phase_180, phase_270 (H, W) in the numbers of the sensor; they are rounded and cut to the
    bits of a word. The program's distance is converted to the plane (Steinbäck 2016, eq 3.15) and is turned back into
    a range along the lens' ray. sigma_m is from the camera's noise model, through the median; where the median took
    pixels of two surfaces it is too small. Why is NOT_FINITE, NO_SIGNAL (Re and Im zero), LOW_AMPLITUDE, WRAPPED,
    ISOLATED, BORDER, or SENSOR_FLAG in `pseudo_rows`; the program knows no saturation.
    Raises DataError for a missing or misshapen plane, UsageError for a camera whose samples do not fit its words.
    """
    samples = [plane_of(raw, name, PLANES) for name in PLANES]
    program = compiled(camera, samples[0].shape)
    finite = np.logical_and.reduce([np.isfinite(each) for each in samples])
    images = integer_chain(interface_words(samples, finite, camera), program)
    why, valid = images.why.astype(np.uint8), images.why == 0
    why[images.square == 0] = Why.NO_SIGNAL
    why[~finite] = Why.NOT_FINITE
    why[: camera.pseudo_rows] = Why.SENSOR_FLAG
    amplitude = np.sqrt(images.square) / 2**camera.emulation.word_shift
    cosine = rays(camera.lens, why.shape)[..., 0]
    kept = images.judged_mm < camera.emulation.marker_mm
    sigma_m = _filtered_sigma(_pixel_sigma(samples, amplitude, camera) * cosine, kept, camera)
    range_m = np.where(valid, images.distance_mm, images.converted_mm) / 1e3 / cosine
    range_m[~finite] = np.nan
    return RangeImage(
        raw.time_s,
        range_m.astype(np.float32),
        (sigma_m / cosine).astype(np.float32),
        np.where(finite, amplitude, np.nan).astype(np.float32),
        why,
    )


def interface_words(samples: list[Image], finite: Image, camera: CwCamera) -> Ints:
    """Return the words (4, H, W) uint16 as the camera interface delivers samples: at the high end of 16 bits (N-S-050).

    finite (H, W): where it is False all four words are 0.
    """
    largest = 0xFFFF >> camera.emulation.word_shift
    whole = [np.clip(np.rint(np.where(finite, each, 0)), 0, largest).astype(np.uint16) for each in samples]
    words: Ints = np.stack(whole) << np.uint16(camera.emulation.word_shift)
    return words


def _pixel_sigma(samples: list[Image], amplitude: Floats, camera: CwCamera) -> Floats:
    """Return the standard deviation of the range of each pixel before filters, m (H, W); inf without signal."""
    if camera.pixel == "single_ended":
        light = np.maximum(np.mean(samples, axis=0, dtype=float) - camera.black_level_lsb, 0)
    else:
        light = amplitude / camera.demodulation_contrast + camera.ambient_lsb
    variance = sample_variance(light, camera) + camera.quantisation_lsb**2 / 12
    with np.errstate(divide="ignore"):
        sigma: Floats = metres_per_radian(camera) * np.sqrt(variance / 2) / amplitude  # N-S-051
    return sigma


def _filtered_sigma(sigma_m: Floats, kept: Image, camera: CwCamera) -> Floats:
    """Return the standard deviation after the median and the rounding to millimetres, m (H, W).

    kept (H, W): which pixels the median takes. The deviation is that of the middle one of n normal values about their
    mean, with the harmonic mean of their sigmas; pixels that the median does not give keep theirs.
    """
    result = sigma_m.copy()
    if camera.emulation.median and min(kept.shape) > 2:
        weight = sliding_window_view(np.where(kept, 1 / sigma_m, 0.0), (3, 3)).sum(axis=(2, 3))
        number = sliding_window_view(kept, (3, 3)).sum(axis=(2, 3))
        smoothed = np.sqrt(_SQUARED_ERROR)[number] * number / np.where(number > 0, weight, 1.0)
        given = kept[1:-1, 1:-1] | (camera.emulation.fill_holes & (number > 0))
        result[1:-1, 1:-1] = np.where(given, smoothed, result[1:-1, 1:-1])
    return np.hypot(result, 1e-3 / math.sqrt(6))  # two roundings to whole millimetres
