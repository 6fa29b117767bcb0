"""The pulsed family: short light pulses, integrated in shutter windows or gates (König 2008)."""

from rangecam.pulsed import delays, ranging
from rangecam.pulsed.calibrated import PLANES, calibrated, made_for
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.settings import PulsedCamera

RANGING = {name: calibrated(method) for name, method in {**ranging.RANGING, **delays.RANGING}.items()}
"""Ranging methods of pulsed cameras by name; they apply the calibration that a frame carries."""

__all__ = ["PLANES", "RANGING", "PulsedCamera", "made_for", "simulate"]
