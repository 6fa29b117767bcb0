"""What the redundancy of the samples tells: phase steps that contradict each other, frequencies that do."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rangecam.cw.phasor import harmonic_weights
from rangecam.cw.sequence import single_frequencies
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.errors import UsageError
from rangecam.types import Floats

Mask = NDArray[np.bool_]


def moved(samples: Floats, steps_deg: tuple[float, ...], camera: CwCamera) -> Mask:
    """Return where the phase steps contradict each other: something moved between their exposures (S-EFF-06).

    samples (F, N, H, W) LSB without black level, of F frequencies at N steps; the result is (H, W). A level and a
    phasor are three numbers; what N - 3 combinations of the samples say beside them is noise. Of four steps that is
    C0 + C180 - C90 - C270 (Schmidt 2011), whatever gain, offset and odd harmonics are; of taps that are read alone it
    sees the brightness change, too. A pixel is refused, not repaired: unless it moves by more than
    its width, it is a mixture of two surfaces even when it stands still.
    One combination cannot see both parts of a phasor: with four steps, a change along one direction of the plane of
    phasors is not seen, and of the others the part across it.
    Raises UsageError for fewer than four steps.
    """
    rest = _redundant(steps_deg)
    weights = harmonic_weights(steps_deg)
    contradicts = np.zeros(samples.shape[-2:], bool)
    for of_one in samples:
        amplitude = np.hypot(*np.tensordot(weights, of_one, 1))
        surplus = np.sqrt((np.tensordot(rest, of_one, 1) ** 2).sum(axis=0))
        noise = np.sqrt(noise_of(light_level(of_one, amplitude, camera), camera))
        contradicts |= surplus > camera.motion_sigmas * noise + camera.motion_tolerance * amplitude
    return contradicts


@lru_cache(maxsize=16)
def _redundant(steps_deg: tuple[float, ...]) -> Floats:
    """Return the combinations (N - 3, N) of samples that no level and no phasor changes, orthonormal."""
    if len(steps_deg) < 4:
        raise UsageError(
            f"camera.motion_sigmas: {len(steps_deg)} phase steps cannot contradict each other; it needs four or more"
        )
    steps = np.radians(steps_deg)
    design = np.stack([np.ones(steps.shape), np.cos(steps), np.sin(steps)])
    result: Floats = np.linalg.svd(design)[2][3:].astype(np.float32)
    return result


def several_ways(samples: Floats, range_m: Floats, camera: CwCamera) -> Mask:
    """Return where frequencies contradict each other at the range that they gave: multipath (S-EFF-09).

    samples (F, N, H, W) as in `moved`, range_m (H, W) as unwrapped; `unwrap_phase_error_rad` is allowed beside noise.
    The sum of two phasors is a phasor, so that one frequency cannot tell; and a way that is longer by much less than
    the shortest wavelength delays all frequencies alike and is not seen.
    """
    weights = harmonic_weights(camera.phase_steps_deg)
    across = float((weights.astype(np.float64) ** 2).sum() / 2)
    surplus = np.zeros(range_m.shape, np.float32)
    for of_one, single in zip(samples, single_frequencies(camera), strict=True):
        real, imaginary = np.tensordot(weights, of_one, 1)
        turned = np.exp(-1j * camera.phase_sign * (range_m - camera.offset_m) / metres_per_radian(single))
        square = real**2 + imaginary**2
        with np.errstate(divide="ignore", invalid="ignore"):  # of pixels without light, which are refused anyway
            noise = noise_of(light_level(of_one, np.sqrt(square), camera), camera)
            variance = across * noise / square + camera.unwrap_phase_error_rad**2
            surplus += np.angle((real + 1j * imaginary) * turned) ** 2 / variance
    return np.asarray(surplus > camera.multipath_sigmas**2)


def noise_of(light_lsb: Floats, camera: CwCamera) -> Floats:
    """Return the variance of a sample for which `light_lsb` was collected, LSB2, as ranging reckons with it."""
    return np.asarray(np.maximum(sample_variance(light_lsb, camera) + camera.quantisation_lsb**2 / 12, 1e-12))


def light_level(samples: Floats, amplitude: Floats, camera: CwCamera) -> Floats:
    """Return the light collected for a sample of each pixel, LSB: its mean, or what a difference of taps lets guess."""
    if camera.pixel == "single_ended":
        return np.asarray(np.maximum(samples.mean(axis=0), 0))
    return camera.ambient_lsb + amplitude / np.float32(camera.demodulation_contrast)
