"""The cw camera family."""

from rangecam.cw.ranging import RANGING
from rangecam.cw.settings import CwCamera

__all__ = ["RANGING", "CwCamera"]
