"""The continuous-wave family: modulated light, correlation samples at four phase steps (Steinbäck 2016)."""

from rangecam.cw import ranging
from rangecam.cw.calibrated import PLANES, calibrated, made_for
from rangecam.cw.camera import simulate
from rangecam.cw.fixed_point import cw_emulation
from rangecam.cw.settings import CwCamera

_METHODS = {**ranging.RANGING, "cw_emulation": cw_emulation}
RANGING = {name: calibrated(method) for name, method in _METHODS.items()}
"""Ranging methods of continuous-wave cameras by name; they apply the calibration that a frame carries."""

__all__ = ["PLANES", "RANGING", "CwCamera", "made_for", "simulate"]
