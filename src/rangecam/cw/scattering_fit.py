"""How strongly and how widely a lens scatters light, from a recording of something small and bright before darkness."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from itertools import chain

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import least_squares

from rangecam.calibration import Calibration, Recording, begun
from rangecam.cw.calibrated import made_for
from rangecam.cw.effects import Scattering
from rangecam.cw.phasor import harmonic_weights
from rangecam.cw.scattering import Light, stray_light
from rangecam.cw.sequence import plane_name
from rangecam.cw.settings import CwCamera
from rangecam.errors import DataError
from rangecam.planes import plane_of
from rangecam.types import RawFrame

_BRIGHT = 0.1
_RIM_PIXELS = 3
_START = (0.01, 0.25)
_NARROWEST, _WIDEST = 0.02, 5.0


def scattering(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Return the calibration with `stray_light`: the first recording is of the target, the others without it.

    As `fit_scattering`, which says what they must show and what is raised.
    """
    camera: CwCamera = recordings[0].camera
    begin = begun(recordings, start, camera, made_for)
    without = list(chain.from_iterable(each.frames for each in recordings[1:]))
    if len(recordings) > 1 and not without:
        raise DataError(f"{recordings[1].name}: there are no frames of the scene without the target")
    found = asdict(fit_scattering(recordings[0].frames, camera, without))
    about = {**found, "without_target": [each.name for each in recordings[1:]]}
    return replace(begin, settings={**start.settings, "stray_light": found}, taken={**start.taken, "scattering": about})


def fit_scattering(frames: Iterable[RawFrame], camera: CwCamera, without: Iterable[RawFrame] = ()) -> Scattering:
    """Return the stray light that best explains what a bright target makes beside itself.

    frames: of a target that fills a small part of the image, before darkness or before anything that stays. without:
    the same without the target, whose light is subtracted as phasors; none for darkness. Their means are used. Outside
    of the target and a rim of 3 pixels all light is stray light, so that `stray_light` must leave nothing there; by
    least squares. With several modulation frequencies the first counts.
    Raises DataError for no frames, a missing plane, a saturated pixel, no light, or a target that leaves less than half
    of the image.
    """
    phasor = _mean_phasor(frames, camera, "the target")
    others = list(without)
    if others:
        phasor = phasor - _mean_phasor(others, camera, "the scene without the target")
    amplitude = np.abs(phasor)
    target = amplitude >= _BRIGHT * amplitude.max(initial=0.0)
    beside = ~binary_dilation(target, np.ones((3, 3), bool), iterations=_RIM_PIXELS)
    beside[: camera.pseudo_rows] = False
    if not amplitude.max(initial=0.0) > 0 or beside.mean() < 0.5:
        raise DataError(
            f"{100 * target.mean():.3g} % of the image are at least {_BRIGHT:g} as bright as its brightest pixel; "
            "stray light is seen beside a target that fills a small part of a dark image"
        )
    scale = 1 / amplitude.max()

    def left(x: np.ndarray) -> np.ndarray:
        rest = ((phasor - stray_light(phasor, Scattering(stray_fraction=x[0], width=x[1]))) * scale)[beside]
        return np.concatenate([rest.real, rest.imag])

    found = least_squares(
        left, _START, bounds=([0.0, _NARROWEST], [0.5, _WIDEST]), x_scale=_START, diff_step=np.full(2, 1e-3)
    )
    return Scattering(stray_fraction=float(found.x[0]), width=float(found.x[1]))


def _mean_phasor(frames: Iterable[RawFrame], camera: CwCamera, what: str) -> Light:
    """Return the mean phasor (H, W) of frames at the first frequency, with the sensor's own rows as darkness."""
    weights = harmonic_weights(camera.phase_steps_deg)
    names = [plane_name(step, 0 if camera.modulations_hz else None) for step in camera.phase_steps_deg]
    count, total = 0, None
    for raw in frames:
        samples = np.stack([plane_of(raw, name, names) for name in names]).astype(np.float32)
        lit = samples[:, camera.pseudo_rows :]
        high, low = camera.full_scale_lsb, camera.lower_limit_lsb
        if (high is not None and (lit >= high).any()) or (low is not None and (lit <= low).any()):
            raise DataError(f"frame {raw.frame_id} of {what}: a pixel is saturated; illuminate it for a shorter time")
        total = samples if total is None else total + samples
        count += 1
    if total is None:
        raise DataError(f"there are no frames of {what}")
    real, imaginary = np.tensordot(weights, total / np.float32(count), 1)
    phasor: Light = (real + 1j * imaginary).astype(np.complex64)
    phasor[: camera.pseudo_rows] = 0
    return phasor
