"""Multipath in a corner: the error that a second bounce makes, and how much of it several frequencies tell."""

from dataclasses import dataclass, replace

import numpy as np

from rangecam.cw import RANGING, CwCamera
from rangecam.cw.effects import Multipath
from rangecam.cw.imperfections import ground_truth, with_and_without
from rangecam.scene.paths import Path
from rangecam.scene.shapes import Box, SceneObject
from rangecam.studies.plates import looking_at, thesis_cw_camera, wall
from rangecam.studies.study import Claim, Panel, Picture, Series, Study, derived, judged
from rangecam.types import Floats, RangeImage, RawFrame, Why

_GROSS_MM, _SIGMAS = 30.0, 4.0
_THRESHOLDS = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
_FREQUENCIES_HZ = {
    "17 + 30 MHz": [17e6, 30e6],
    "60 + 80 MHz": [60e6, 80e6],
    "80 + 16 + 120 MHz": [80e6, 16e6, 120e6],
}
_SIDE = SceneObject(
    name="side",
    boxes=(Box(center_m=(0.0, 0.05, 0.0), size_m=(8.0, 0.1, 8.0), reflectivity=0.9),),
    path=Path(start_m=(0.0, 1.0, 0.0)),
)
"""A wall along the optical axis, 1 m to the left."""


@dataclass(frozen=True, eq=False)
class _Corner:
    """Two white walls as a camera sees them, with the second bounce and without: its raw frames and the truth."""

    camera: CwCamera
    raws: tuple[RawFrame, RawFrame]
    truth_m: Floats

    def images(self, sigmas: float) -> tuple[RangeImage, RangeImage]:
        """Return both images with pixels flagged from so many sigmas on."""
        camera = replace(self.camera, multipath_sigmas=sigmas)
        one, other = (RANGING["cw_multi_frequency"](raw, camera) for raw in self.raws)
        return one, other

    def rates(self, sigmas: float) -> tuple[float, float]:
        """Return which part of the gross errors is flagged, and which part of the pixels without multipath is."""
        one, other = self.images(sigmas)
        wrong = (np.abs(one.range_m - self.truth_m) > _GROSS_MM / 1e3) & np.isin(one.why, (Why.VALID, Why.MULTIPATH))
        return float(np.mean(one.why[wrong] == Why.MULTIPATH)), float(np.mean(other.why == Why.MULTIPATH))


def cw_multipath(rng: np.random.Generator) -> Study:
    """Multipath in a corner of white walls: its error, how much of it several frequencies flag, and false alarms.

    rng: of the noise.
    """
    seed = int(rng.integers(1 << 31))
    corners = {name: _corner(each, seed) for name, each in _FREQUENCIES_HZ.items()}
    claims = [claim for name, corner in corners.items() for claim in _claims(name, corner)]
    curves = []
    for name, corner in corners.items():
        told, alarms = np.transpose([corner.rates(sigmas) for sigmas in _THRESHOLDS])
        curves.append(Series(name, np.maximum(alarms, 1e-4), told, line="-o"))
    last = corners["80 + 16 + 120 MHz"]
    image = last.images(_SIGMAS)[0]
    error_mm = 1e3 * (image.range_m - last.truth_m)
    left_mm = np.where(image.valid, error_mm, np.nan)
    panels = [
        Panel("what is told", "false alarms without multipath", "part of the errors over 30 mm", curves, "x"),
        *(Panel(f"80 + 16 + 120 MHz, {what}", "column", "row", [], picture=Picture(each, "error (mm)", (-60.0, 60.0)))
          for what, each in (("all", error_mm), ("MULTIPATH refused", left_mm))),
    ]  # fmt: skip
    return Study("cw-multipath", "Steinbäck 2016, 2.2.2", claims, panels)


def _corner(modulations_hz: list[float], seed: int) -> _Corner:
    camera = thesis_cw_camera(
        rows=45, columns=60, modulations_hz=modulations_hz, frame_rate_hz=10.0, reference_amplitude_lsb=600.0,
        reference_floor_lsb=40.0, full_scale_lsb=None, lower_limit_lsb=None, unwrap_phase_error_rad=0.0,
        unwrap_residual_sigmas=8.0,
    )  # fmt: skip
    camera = replace(camera, multipath=Multipath(two_bounces=True))
    view = looking_at(camera, wall(2.5, 0.9), _SIDE, subpixels=1)
    return _Corner(
        camera, with_and_without("multipath", view, camera, 0.0, seed), ground_truth(view(0.0), camera).range_m
    )


def _claims(name: str, corner: _Corner) -> list[Claim]:
    image = corner.images(_SIGMAS)[0]
    seen = np.isin(image.why, (Why.VALID, Why.MULTIPATH))
    error_mm = 1e3 * np.abs(image.range_m - corner.truth_m)
    told, alarms = corner.rates(_SIGMAS)
    why = "a way longer by much less than a wavelength delays all frequencies alike"
    return [
        derived("S-EFF-09", f"{name}: median error by a second bounce", float(np.median(error_mm[seen])), "mm",
                "white walls at 2.5 m ahead and 1 m beside; little noise"),
        derived("S-EFF-09", f"{name}: pixels over 30 mm wrong", 100 * float(np.mean(error_mm[seen] > _GROSS_MM)), "%",
                "of all"),
        derived("S-EFF-09", f"{name}: median error of pixels not flagged",
                float(np.median(error_mm[image.valid])), "mm", "flagged from 4 sigma on, not corrected"),
        derived("S-EFF-09", f"{name}: of those over 30 mm wrong, flagged", 100 * told, "%", why),
        judged("S-EFF-09", f"{name}: false alarms", None, 100 * alarms, "%", alarms < 0.005,
               "under 0.5 % of a scene without multipath"),
    ]  # fmt: skip
