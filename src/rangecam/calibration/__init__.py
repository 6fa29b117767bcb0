"""Calibration: what is known of one camera beyond its settings, as a file, for all families.

- file: `Calibration` = settings of the camera that it determines + images of every pixel; saved, loaded, attached
- dark: what a camera reads in darkness, for each number of accumulations
- distance: the curve of a camera and the line of each pixel, from measured to true range
- noise: variance over light, as a line
- mounting: height, pitch and roll from the floor
- recording: what all of it is estimated from
What an image corrects, and when, is the business of the family (its `calibrated.py`), as are the steps of a calibration
(its `CALIBRATE`).
"""

from rangecam.calibration.dark import Still, estimate_dark
from rangecam.calibration.distance import Line, Plane, apply_curve, fit_curve, fit_range, mean_plane
from rangecam.calibration.file import Calibration, attach, check_made_for, load_calibration, save_calibration
from rangecam.calibration.mounting import FloorFit, fit_mounting
from rangecam.calibration.recording import Recording, begun, known_of

__all__ = [
    "Calibration",
    "FloorFit",
    "Line",
    "Plane",
    "Recording",
    "Still",
    "apply_curve",
    "attach",
    "begun",
    "check_made_for",
    "estimate_dark",
    "fit_curve",
    "fit_mounting",
    "fit_range",
    "known_of",
    "load_calibration",
    "mean_plane",
    "save_calibration",
]
