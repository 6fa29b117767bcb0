"""Several exposures: a scene of which no single illumination time shows both the near and bright, the far and dark."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.effects import Taps
from rangecam.cw.imperfections import ground_truth
from rangecam.hdr import ranged
from rangecam.scene.view import View
from rangecam.studies.plates import looking_at, plate, thesis_cw_camera, wall
from rangecam.studies.study import Claim, Panel, Picture, Series, Study, derived, judged
from rangecam.types import Floats, RangeImage, Why

_SHORT_S, _LONG_S = 2e-4, 16e-3
_TIMES_S = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3)
_NEAR_M, _FAR_M = 0.3, 3.5
_PIECES = {"near and bright": (0.2, 0.5), "in between": (1.0, 2.0), "far and dark": (3.0, 6.0)}


def cw_hdr(rng: np.random.Generator) -> Study:
    """Several exposures of one frame: valid pixels and errors of near bright and far dark surfaces, alone and merged.

    rng: of the noise.
    """
    camera = thesis_cw_camera(frame_rate_hz=5.0, taps=Taps(full_well_lsb=2500.0))
    single = {time_s: _image(replace(camera, illumination_time_s=time_s), rng) for time_s in _TIMES_S}
    merged = _image(replace(camera, illumination_times_s=(_SHORT_S, _LONG_S)), rng)
    truth_m = ground_truth(_view(camera)(0.0), camera).range_m
    shown = {"0.2 ms": single[_SHORT_S], "16 ms": single[_LONG_S], "0.2 and 16 ms": merged}
    claims = [claim for name, image in shown.items() for claim in _claims(name, image, truth_m)]
    best = max(float(image.valid.mean()) for image in single.values())
    gained = float(merged.valid.mean())
    claims += [
        derived("S-EFF-12", "valid pixels by the best single illumination time", 100 * best, "%", "of eight times"),
        judged(
            "S-EFF-12", "valid pixels by two", None, 100 * gained, "%", gained > best + 0.05, "more than by any one"
        ),
        _coverage(merged, truth_m),
    ]
    times_ms = [1e3 * time_s for time_s in _TIMES_S]
    panels = [
        Panel(
            "valid pixels; dashed: 0.2 and 16 ms", "illumination time (ms)", "part of the surface",
            [Series(piece, times_ms, [_valid(image, truth_m, piece) for image in single.values()],
                    line="-o", colour=k) for k, piece in enumerate(_PIECES)]
            + [Series("", times_ms, [_valid(merged, truth_m, piece)] * len(times_ms),
                      line="--", colour=k) for k, piece in enumerate(_PIECES)], "x",
        ),
        *(Panel(name, "column", "row", [], picture=Picture(np.where(image.valid, image.range_m, np.nan), "range (m)",
                                                           (0.3, 4.5))) for name, image in shown.items()),
    ]  # fmt: skip
    return Study("cw-hdr", "Steinbäck 2016, 5.2.1", claims, panels)


def _view(camera: CwCamera) -> Callable[[float], View]:
    """Return a scene of white plates at 0.3 m and 1.3 m before a wall of 40 % at 3.5 m."""
    near, middle = plate((_NEAR_M, 0.12, 0.0), (0.2, 0.25), 0.9), plate((1.3, -0.4, 0.0), (0.5, 0.8), 0.5)
    return looking_at(camera, near, middle, wall(_FAR_M, 0.4), subpixels=1)


def _image(camera: CwCamera, rng: np.random.Generator) -> RangeImage:
    """Return what ranging makes of one frame, however many exposures it has."""
    return ranged(RANGING["cw_four_phase"], simulate(_view(camera), camera, 0.0, rng), camera)


def _valid(image: RangeImage, truth_m: Floats, piece: str) -> float:
    low, high = _PIECES[piece]
    return float(image.valid[(truth_m > low) & (truth_m < high)].mean())


def _claims(name: str, image: RangeImage, truth_m: Floats) -> list[Claim]:
    claims = []
    for piece, (low, high) in _PIECES.items():
        inside = (truth_m > low) & (truth_m < high)
        saturated = 100 * float(np.mean(image.why[inside] == Why.SATURATED))
        claims.append(derived("S-EFF-12", f"{name}: valid pixels, {piece}", 100 * _valid(image, truth_m, piece), "%",
                              f"{saturated:.3g} % are saturated"))  # fmt: skip
        seen = inside & image.valid
        if seen.sum() > 20:
            error_mm = 1e3 * float(np.sqrt(np.mean((image.range_m - truth_m)[seen] ** 2)))
            claims.append(
                derived("S-EFF-12", f"{name}: error of the valid ones, {piece}", error_mm, "mm", "root mean square")
            )
    return claims


def _coverage(image: RangeImage, truth_m: Floats) -> Claim:
    seen = image.valid
    inside = float(np.mean(np.abs(image.range_m - truth_m)[seen] < image.sigma_m[seen]))
    return judged("S-EFF-12", "merged pixels within one sigma", None, inside, "", abs(inside - 0.6827) < 0.04,
                  "68.3 % within 4 points; of the weakest, noise chooses who is valid")  # fmt: skip
