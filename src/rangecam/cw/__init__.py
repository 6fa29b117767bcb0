"""The continuous-wave family: modulated light, correlation samples at four phase steps (Steinbäck 2016)."""

from rangecam.cw.camera import simulate
from rangecam.cw.ranging import RANGING
from rangecam.cw.settings import CwCamera

__all__ = ["RANGING", "CwCamera", "simulate"]
