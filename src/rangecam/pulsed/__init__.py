"""The pulsed family: short light pulses, integrated in shutter windows or gates (König 2008)."""

from rangecam.pulsed import delays, ranging
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.settings import PulsedCamera

RANGING = {**ranging.RANGING, **delays.RANGING}
"""Ranging methods of pulsed cameras by name."""

__all__ = ["RANGING", "PulsedCamera", "simulate"]
