"""What a design must know of each camera family: which noise can be switched off, what a signal is in electrons."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rangecam.cw import CwCamera
from rangecam.processed import ProcessedCamera
from rangecam.pulsed import PulsedCamera
from rangecam.pulsed.camera import max_frame_rate_hz
from rangecam.pulsed.pixel import ELEMENTARY_CHARGE_C, volts_per_coulomb

AnyCamera = PulsedCamera | CwCamera | ProcessedCamera
_NO_FLOOR_M = 1e-9


@dataclass(frozen=True)
class Family:
    """How a family answers.

    noise: the parts of the noise by name, and what switches each off. electrons: per unit of amplitude, None where
    unknown. fastest_hz: the most images a second, None where the camera does not say.
    """

    noise: Callable[[Any], dict[str, Any]]
    electrons: Callable[[Any], float | None]
    fastest_hz: Callable[[Any], float | None]
    counted: str


def _pulsed_noise(camera: PulsedCamera) -> dict[str, PulsedCamera]:
    if camera.readout == "three_tap":
        taps = camera.taps
        return {
            "read-out noise": replace(camera, taps=replace(taps, read_noise_counts=0.0)),
            "shot noise": replace(camera, taps=replace(taps, shot_noise_counts2_per_count=0.0)),
        }
    pixel = camera.pixel
    without: dict[str, dict[str, Any]] = {
        "sensor noise": {"sensor_noise_v": 0.0},
        "read-out noise": {"readout_noise_v": 0.0},
        "shot noise": {"photon_noise": False},
        "rounding": {"adc_bits": 0},
        "fixed pattern": {"fixed_pattern_v": 0.0, "fixed_pattern_per_pulse_v": 0.0},
    }
    return {name: replace(camera, pixel=replace(pixel, **changes)) for name, changes in without.items()}


def _cw_noise(camera: CwCamera) -> dict[str, CwCamera]:
    return {
        "read-out noise": replace(camera, read_noise_lsb=0.0),
        "shot noise": replace(camera, shot_noise_lsb2_per_lsb=0.0),
        "rounding": replace(camera, quantisation_lsb=0.0),
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
    shot = camera.shot_noise_lsb2_per_lsb
    return 1 / (shot * camera.demodulation_contrast) if shot else None


def _cw_fastest_hz(camera: CwCamera) -> float:
    return 1 / (4 * (camera.illumination_time_s + camera.readout_time_s))


DESIGNED: dict[str, Family] = {
    "pulsed": Family(_pulsed_noise, _pulsed_electrons, max_frame_rate_hz, "of one pulse"),
    "cw": Family(_cw_noise, _cw_electrons, _cw_fastest_hz, "of one phase image"),
    "processed": Family(_processed_noise, lambda camera: None, lambda camera: None, ""),
}
"""Families by the `kind` of their settings."""


def quiet(camera: AnyCamera) -> AnyCamera:
    """Return the camera with every part of its noise switched off."""
    silent: AnyCamera = camera
    for name in DESIGNED[camera.kind].noise(camera):
        silent = DESIGNED[camera.kind].noise(silent)[name]
    return silent


def finite(value: float | None) -> float | None:
    """Return a number that JSON knows: None for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)
