"""The continuous-wave family: modulated light, correlation samples at four phase steps (Steinbäck 2016)."""

from rangecam.cw import ranging
from rangecam.cw.calibrated import PLANES, calibrated, made_for
from rangecam.cw.camera import simulate
from rangecam.cw.settings import CwCamera

RANGING = {name: calibrated(method) for name, method in ranging.RANGING.items()}
"""Ranging methods of continuous-wave cameras by name; they apply the calibration that a frame carries."""

__all__ = ["PLANES", "RANGING", "CwCamera", "made_for", "simulate"]
