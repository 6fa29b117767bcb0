"""The pulsed family: short light pulses, integrated in shutter windows or gates (König 2008)."""

from rangecam.pulsed import delays, ranging, saturation
from rangecam.pulsed.calibrate import CALIBRATE
from rangecam.pulsed.calibrated import PLANES, calibrated, made_for
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.feasible import check, warnings_of
from rangecam.pulsed.settings import PulsedCamera
from rangecam.pulsed.uncrossed import without_crosstalk

_METHODS = {**ranging.RANGING, **delays.RANGING, **saturation.RANGING}
RANGING = {name: calibrated(without_crosstalk(method)) for name, method in _METHODS.items()}
"""Ranging methods of pulsed cameras by name; with the calibration that a frame carries, and without known crosstalk."""

__all__ = ["CALIBRATE", "PLANES", "RANGING", "PulsedCamera", "check", "made_for", "simulate", "warnings_of"]
