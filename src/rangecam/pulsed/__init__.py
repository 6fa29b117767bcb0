"""The pulsed family: short light pulses, integrated in shutter windows or gates (König 2008)."""

from rangecam.pulsed.camera import simulate
from rangecam.pulsed.ranging import RANGING
from rangecam.pulsed.settings import PulsedCamera

__all__ = ["RANGING", "PulsedCamera", "simulate"]
