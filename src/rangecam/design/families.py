"""What a design must know of each camera family: which noise can be switched off, what a signal is in electrons."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from rangecam.cw import CwCamera
from rangecam.cw.effects import Multipath, Scattering
from rangecam.cw.sequence import fastest_frame_rate_hz
from rangecam.errors import UsageError
from rangecam.processed import ProcessedCamera
from rangecam.pulsed import PulsedCamera
from rangecam.pulsed.crosstalk import Crosstalk
from rangecam.pulsed.feasible import max_frame_rate_hz, warnings_of
from rangecam.pulsed.laser import beam_profile
from rangecam.pulsed.pixel import ELEMENTARY_CHARGE_C, volts_per_coulomb

AnyCamera = PulsedCamera | CwCamera | ProcessedCamera
_NO_FLOOR_M = 1e-9


@dataclass(frozen=True)
class Family:
    """How a family answers.

    noise: the camera without each part of its noise, by name. alike: the camera whose pixels all are as that in a
    column. electrons: per unit of amplitude, None where unknown. fastest_hz: the most images a second, None where the
    camera does not say. warnings: of what works but should not be built so.
    """

    noise: Callable[[Any], dict[str, Any]]
    alike: Callable[[Any, int], Any]
    electrons: Callable[[Any], float | None]
    fastest_hz: Callable[[Any], float | None]
    warnings: Callable[[Any], list[str]]


def _pulsed_noise(camera: PulsedCamera) -> dict[str, PulsedCamera]:
    if camera.readout == "three_tap":
        taps = camera.taps
        return {
            "read-out noise": replace(camera, taps=replace(taps, read_noise_counts=0.0)),
            "shot noise": replace(camera, taps=replace(taps, shot_noise_counts2_per_count=0.0)),
        }
    pixel, laser = camera.pixel, camera.laser
    even: dict[str, Any] = {
        name: 0.0 for name in vars(pixel) if name.startswith("fixed_pattern_") and not name.endswith("seed")
    }
    return {
        "sensor noise": replace(camera, pixel=replace(pixel, sensor_noise_v=0.0)),
        "read-out noise": replace(camera, pixel=replace(pixel, readout_noise_v=0.0)),
        "shot noise": replace(camera, pixel=replace(pixel, photon_noise=False)),
        "rounding": replace(camera, pixel=replace(pixel, adc_bits=0)),
        "fixed pattern": replace(camera, pixel=replace(pixel, **even)),
        "laser jitter": replace(camera, laser=replace(laser, trigger_jitter_s=0.0, amplitude_jitter=0.0)),
        "changing ambient light": replace(camera, background=replace(camera.background, fluctuation=0.0)),
    }


def _cw_noise(camera: CwCamera) -> dict[str, CwCamera]:
    return {
        "read-out noise": replace(camera, read_noise_lsb=0.0),
        "shot noise": replace(camera, shot_noise_lsb2_per_lsb=0.0),
        "rounding": replace(camera, quantisation_lsb=0.0),
        "fixed pattern": replace(
            camera,
            fixed_pattern=replace(camera.fixed_pattern, range_sigma_m=0.0, gain_sigma=0.0, offset_sigma_lsb=0.0),
        ),
        "interference": replace(camera, interference=replace(camera.interference, strength=0.0)),
    }


def _processed_noise(camera: ProcessedCamera) -> dict[str, ProcessedCamera]:
    return {
        "noise floor": replace(camera, noise_floor_m=_NO_FLOOR_M),
        "noise that grows with the range": replace(camera, noise_relative=0.0),
        "noise of weak light": replace(camera, noise_amplitude_m=0.0),
    }


def _pulsed_electrons(camera: PulsedCamera) -> float | None:
    if camera.readout == "three_tap":
        shot = camera.taps.shot_noise_counts2_per_count
        return 1 / shot if shot else None
    return 1 / (ELEMENTARY_CHARGE_C * volts_per_coulomb(camera.pixel))


def _cw_electrons(camera: CwCamera) -> float | None:
    shot = camera.shot_noise_lsb2_per_lsb / camera.binning**2
    return 1 / (shot * camera.demodulation_contrast) if shot else None


def _pulsed_alike(camera: PulsedCamera, column: int) -> PulsedCamera:
    """Return the camera with an even beam, as bright as its own is in a column, and as warm.

    It has no crosstalk, which changes nothing where all pixels see the same, but would from the border of an image.
    """
    laser = camera.laser
    factor = float(beam_profile(laser, camera.columns)[column])
    if factor == 0:
        raise UsageError(f"camera.laser.beams: no light falls into column {column}, which the design looks at")
    even = replace(
        laser,
        beams=((-1.0, 1.0),),
        peak_power_w=factor * laser.peak_power_w,
        loss_per_w=laser.loss_per_w / factor,
    )
    return replace(camera, laser=even, crosstalk=Crosstalk())


def _cw_alike(camera: CwCamera, column: int) -> CwCamera:
    """Return the camera with light in every pixel: without rows of data, and no light of others."""
    return replace(camera, pseudo_rows=0, region_of_interest=None, multipath=Multipath(), scattering=Scattering())


DESIGNED: dict[str, Family] = {
    "pulsed": Family(_pulsed_noise, _pulsed_alike, _pulsed_electrons, max_frame_rate_hz, warnings_of),
    "cw": Family(_cw_noise, _cw_alike, _cw_electrons, fastest_frame_rate_hz, lambda camera: []),
    "processed": Family(
        _processed_noise, lambda camera, column: camera, lambda camera: None, lambda camera: None, lambda camera: []
    ),
}
"""Families by the `kind` of their settings."""


@lru_cache(maxsize=16)
def quiet(camera: AnyCamera) -> AnyCamera:
    """Return the camera with every part of its noise switched off."""
    silent: AnyCamera = camera
    for name in DESIGNED[camera.kind].noise(camera):
        silent = DESIGNED[camera.kind].noise(silent)[name]
    return silent


def finite(value: float | None) -> float | None:
    """Return a number that JSON knows: None for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)
