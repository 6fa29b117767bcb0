"""Stray light of the lens: what it does to a dark wall behind something bright, and what is left of it corrected."""

from dataclasses import replace

import numpy as np

from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.effects import STRAY_FRACTION, Scattering
from rangecam.cw.imperfections import ideal
from rangecam.cw.scattering_fit import fit_scattering
from rangecam.studies.plates import looking_at, plate, thesis_cw_camera, wall
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats

_WALL_M, _TARGET_M = 3.0, 0.5
_FRACTIONS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
_GUESSES = np.linspace(0.5, 1.5, 11)
_FRAMES = 16
_TRUE = Scattering(stray_fraction=STRAY_FRACTION)


def cw_scattering(rng: np.random.Generator) -> Study:
    """Stray light: error of a dark wall behind a bright target, before and after correction, also with wrong guesses.

    rng: of the noise of the recordings that the lens is fitted to.
    """
    camera = thesis_cw_camera(illumination_time_s=4e-3, frame_rate_hz=10.0)
    fitted = _fitted(replace(camera, scattering=_TRUE), rng)
    caused, left, by_fit = (_mean_mm(camera, _TRUE, known) for known in (Scattering(), _TRUE, fitted))
    claims = [
        derived("S-EFF-04", "mean error of the wall by 1 % of stray light", caused, "mm", _why()),
        _fivefold("left with the true lens", left, caused),
        _fivefold("left with the lens fitted to recordings", by_fit, caused),
        judged("S-EFF-04", "stray light, fitted", None, fitted.stray_fraction, "",
               abs(fitted.stray_fraction / STRAY_FRACTION - 1) < 0.02, "true within 2 %; the rest by noise"),
        judged("S-EFF-04", "width of it, fitted", None, fitted.width, "image",
               abs(fitted.width / _TRUE.width - 1) < 0.02, "true within 2 %"),
        *_noise_claims(camera, rng),
    ]  # fmt: skip
    by_fraction = [(_mean_mm(camera, s, Scattering()), _mean_mm(camera, s, s)) for s in map(_lens, _FRACTIONS)]
    by_guess = [_mean_mm(camera, _TRUE, _lens(STRAY_FRACTION * guess)) for guess in _GUESSES]
    by_width = [
        _mean_mm(camera, _TRUE, Scattering(stray_fraction=STRAY_FRACTION, width=0.25 * guess)) for guess in _GUESSES
    ]
    claims += [
        derived("S-EFF-04", f"left with {what} guessed {change:+.0f} % wrong", values[k], "mm", "what is left grows so")
        for what, values in (("stray fraction", by_guess), ("width", by_width))
        for k, change in ((3, -20), (7, 20))
    ]
    columns = np.arange(camera.columns)
    row = camera.rows // 2
    panels = [
        Panel(
            "a row of the image, white plate at 0.5 m", "column", "error (mm)",
            [Series(name, columns, 1e3 * _error(camera, _TRUE, known)[row])
             for name, known in (("uncorrected", Scattering()), ("corrected", _TRUE), ("lens fitted", fitted))],
        ),
        Panel(
            "more and less stray light", "stray part of the light", "mean error of the wall (mm)",
            [Series("uncorrected", _FRACTIONS, [a for a, _ in by_fraction], line="-o"),
             Series("corrected", _FRACTIONS, [max(b, 1e-3) for _, b in by_fraction], line="-o")], "xy",
        ),
        Panel(
            "wrong guesses, 1 % of stray light", "guessed over true", "mean error of the wall (mm)",
            [Series("stray fraction", _GUESSES, by_guess, line="-o"), Series("width", _GUESSES, by_width, line="-o"),
             Series("uncorrected", _GUESSES, np.full(len(_GUESSES), caused), line="--")],
        ),
    ]  # fmt: skip
    return Study("cw-scattering", "Steinbäck 2016, 2.2.2", claims, panels)


def _lens(fraction: float) -> Scattering:
    return Scattering(stray_fraction=fraction)


def _why() -> str:
    return f"wall of 40 % at {_WALL_M:g} m beside a white plate of 0.3 m at {_TARGET_M:g} m, without noise"


def _error(camera: CwCamera, true: Scattering, known: Scattering) -> Floats:
    """Return by how much the range of each pixel is wrong without noise, m; NaN on the plate."""
    quiet = replace(ideal(camera), scattering=true, stray_light=known)
    view = looking_at(quiet, plate((_TARGET_M, 0.1, 0.0), (0.3, 0.3), 0.9), wall(_WALL_M, 0.4), subpixels=1)
    range_m = view(0.0).range_m[0]
    found = RANGING["cw_four_phase"](simulate(view, quiet, 0.0, np.random.default_rng(0)), quiet).range_m
    result: Floats = np.where(range_m > 2 * _TARGET_M, found - range_m, np.nan)
    return result


def _mean_mm(camera: CwCamera, true: Scattering, known: Scattering) -> float:
    return float(1e3 * np.nanmean(np.abs(_error(camera, true, known))))


def _fivefold(text: str, left_mm: float, caused_mm: float) -> Claim:
    return judged("S-EFF-04", text, None, left_mm, "mm", left_mm < caused_mm / 5, "less than a fifth of what it caused")


def _fitted(camera: CwCamera, rng: np.random.Generator) -> Scattering:
    """Return the lens that the camera's recordings tell: a small white plate before a grey wall, and the wall alone."""
    target = plate((0.4, 0.1, 0.05), (0.2, 0.2), 0.9)
    recordings = [
        [simulate(view, camera, 0.0, rng) for _ in range(_FRAMES)]
        for view in (looking_at(camera, target, wall(2.0, 0.5)), looking_at(camera, wall(2.0, 0.5)))
    ]
    return fit_scattering(recordings[0], camera, recordings[1])


def _noise_claims(camera: CwCamera, rng: np.random.Generator) -> list[Claim]:
    """Return whether sigma holds the truth of a corrected image with noise; its wall is so bright that all of it is."""
    noisy = replace(camera, scattering=_TRUE, stray_light=_TRUE)
    view = looking_at(noisy, plate((_TARGET_M, 0.1, 0.0), (0.3, 0.3), 0.9), wall(2.0, 0.8), subpixels=1)
    range_m, errors = view(0.0).range_m[0], []
    for _ in range(4):
        image = RANGING["cw_four_phase"](simulate(view, noisy, 0.0, rng), noisy)
        seen = image.valid & (range_m > 2 * _TARGET_M) & (image.amplitude > 15)
        errors.append(((image.range_m - range_m) / image.sigma_m)[seen])
    inside = float(np.mean(np.abs(np.concatenate(errors)) < 1))
    return [
        judged("S-EFF-04", "pixels of a wall within one sigma, corrected", None, inside, "",
               abs(inside - 0.6827) < 0.02, "68.3 % within 2 points"),
    ]  # fmt: skip
