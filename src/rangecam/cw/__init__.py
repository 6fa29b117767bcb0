"""The continuous-wave family: modulated light, correlation samples at four phase steps (Steinbäck 2016)."""

from rangecam.cw import ranging
from rangecam.cw.calibrate import CALIBRATE
from rangecam.cw.calibrated import PLANES, calibrated, interval_m, made_for
from rangecam.cw.camera import simulate
from rangecam.cw.corrected import corrected
from rangecam.cw.fixed_point import cw_emulation
from rangecam.cw.phasor import shared_noise_pixels
from rangecam.cw.settings import CwCamera

_METHODS = {**{name: corrected(method) for name, method in ranging.RANGING.items()}, "cw_emulation": cw_emulation}
RANGING = {name: calibrated(method) for name, method in _METHODS.items()}
"""Ranging methods of continuous-wave cameras by name; they apply `corrected` and the calibration of the frame."""

__all__ = ["CALIBRATE", "PLANES", "RANGING", "CwCamera", "interval_m", "made_for", "shared_noise_pixels", "simulate"]
