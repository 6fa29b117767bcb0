"""The pulsed camera family."""

from rangecam.pulsed.ranging import RANGING
from rangecam.pulsed.settings import PulsedCamera

__all__ = ["RANGING", "PulsedCamera"]
