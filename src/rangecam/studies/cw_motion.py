"""Motion artefacts: phase images that were exposed one after the other contradict each other where something moves."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rangecam.clean import CleanSettings, clean
from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.sequence import exposure_times_s
from rangecam.geometry import Mounting
from rangecam.scene.shapes import SceneObject
from rangecam.scene.view import View
from rangecam.studies.plates import looking_at, plate, thesis_cw_camera, wall
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats, RangeImage, RawFrame

_GROSS_M, _SIGMAS = 0.05, 3.0
_AT_S = 0.1
_SIZE = (0.6, 0.8)
_SCENES: dict[str, tuple[SceneObject, SceneObject]] = {
    "1 m/s across at 2 m, wall at 4 m": (plate((2.0, 0.3, 0.0), _SIZE, 0.5, (0.0, -1.0, 0.0)), wall(4.0, 0.5)),
    "2 m/s across at 3 m, wall at 4.5 m": (plate((3.0, 0.3, 0.0), _SIZE, 0.5, (0.0, -2.0, 0.0)), wall(4.5, 0.8)),
    "2 m/s across at 2 m, wall at 3 m": (plate((2.0, 0.3, 0.0), _SIZE, 0.5, (0.0, -2.0, 0.0)), wall(3.0, 0.8)),
    "5 m/s towards us at 2 m, wall at 6 m": (plate((2.5, 0.3, 0.0), _SIZE, 0.5, (-5.0, 0.0, 0.0)), wall(6.0, 0.8)),
}
_BRIGHT: dict[str, Any] = {
    "reference_amplitude_lsb": 600.0, "reference_floor_lsb": 40.0, "lower_limit_lsb": None, "full_scale_lsb": None,
}  # fmt: skip
_CAMERAS: dict[str, dict[str, Any]] = {
    "differential, 0 90 180 270": {"capture_order": [0, 90, 180, 270]},
    "differential, 0 180 90 270": {},
    "single-ended, 0 90 180 270": {"capture_order": [0, 90, 180, 270], "pixel": "single_ended"},
}
_CLEANING = CleanSettings(filter="off")


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Of one scene: how far pixels are off every surface they saw (H, W), what is left of them, good pixels lost."""

    off_m: Floats
    gross: NDArray[np.bool_]
    plain: RangeImage
    tested: RangeImage
    left: tuple[float, float, float, float]
    lost: float
    face_m: float


def cw_motion(rng: np.random.Generator) -> Study:
    """Motion artefacts at the edges of things that move: what they are, what the contradiction of the phases rejects.

    rng: of the noise. The camera has four times the thesis' light: with less, noise hides most of them.
    """
    seed = int(rng.integers(1 << 31))
    found = {
        name: {
            scene: _outcome(thesis_cw_camera(**_BRIGHT, **changes), things, seed) for scene, things in _SCENES.items()
        }
        for name, changes in _CAMERAS.items()
    }
    claims = [claim for name, outcomes in found.items() for claim in _claims(name, outcomes)]
    one = found["differential, 0 90 180 270"]["2 m/s across at 3 m, wall at 4.5 m"]
    row, columns = one.plain.shape[0] // 2, np.arange(one.plain.shape[1])
    near = slice(50, 100)
    panels = [
        Panel(
            "2 m/s across at 3 m, a row of the image", "column", "range (m)",
            [Series("four phases", columns[near], _shown(one.plain)[row, near], line="o"),
             Series("without MOTION", columns[near], _shown(one.tested)[row, near], line=".")],
        ),
        Panel(
            "gross errors; solid: MOTION refused", "distance to the nearest surface (m)", "pixels with more",
            [_survivors(name, outcomes, tested, k)
             for k, (name, outcomes) in enumerate(found.items()) for tested in (False, True)], "xy",
        ),
    ]  # fmt: skip
    return Study("cw-motion", "Steinbäck 2016, 2.2.2 and fig 4.7", claims, panels)


def _outcome(camera: CwCamera, things: tuple[SceneObject, SceneObject], seed: int) -> _Outcome:
    view = looking_at(camera, *things)
    raw = simulate(view, camera, _AT_S, np.random.default_rng(seed))
    plain = RANGING["cw_four_phase"](raw, camera)
    tested = RANGING["cw_four_phase"](raw, replace(camera, motion_sigmas=_SIGMAS))
    surfaces = np.concatenate([view(each).range_m for each in exposure_times_s(camera, _AT_S)])
    off_m = np.abs(plain.range_m - surfaces).min(axis=0)
    frozen_m = RANGING["cw_four_phase"](_frozen(view, camera, seed), camera).range_m
    limit_m = _GROSS_M + _SIGMAS * plain.sigma_m
    gross = plain.valid & (off_m > limit_m) & (np.abs(plain.range_m - frozen_m) > limit_m)
    images = [plain, tested, *(_cleaned(each, camera) for each in (plain, tested))]
    left = [float(off_m[gross & each.valid].sum()) for each in images]
    pure = np.ptp(surfaces, axis=0) < 3 * _GROSS_M
    good = plain.valid & pure
    middle_m = view(_AT_S).range_m[0]
    face = good & (middle_m < surfaces.max() - 0.5)
    lost = float(np.mean(~tested.valid[good]))
    return _Outcome(off_m, gross, plain, tested, (left[0], left[1], left[2], left[3]), lost,
                    float(np.mean((plain.range_m - middle_m)[face])))  # fmt: skip


def _frozen(view: Callable[[float], View], camera: CwCamera, seed: int) -> RawFrame:
    return simulate(view, replace(camera, freeze_motion=True), _AT_S, np.random.default_rng(seed))


def _cleaned(image: RangeImage, camera: CwCamera) -> RangeImage:
    """Return the image after the rejection of flying pixels and the test for common neighbours."""
    return clean(image, camera.lens, Mounting(), replace(_CLEANING, reject_flying=True))


def _claims(name: str, outcomes: dict[str, _Outcome]) -> list[Claim]:
    before, after, cleaned, both = np.sum([each.left for each in outcomes.values()], axis=0)
    lost = float(np.mean([each.lost for each in outcomes.values()]))
    gross = sum(int(each.gross.sum()) for each in outcomes.values())
    text, why = f"{name}: gross errors left, of their sum", "50 mm and 3 sigma off every surface that the pixel saw"
    # a differential pixel that exposes opposite phases one after the other contradicts itself a quarter as much
    adjacent = not name.endswith(" 0 180 90 270")
    claims = [
        derived("S-EFF-06", f"{name}: pixels with gross errors", gross, "", why),
        derived("S-EFF-06", f"{name}: mean of the gross errors", 1e3 * before / gross, "mm", why),
        judged("S-EFF-06", f"{text}, MOTION refused", None, 100 * after / before, "%", after < before / 10,
               "reduced tenfold") if adjacent else
        derived("S-EFF-06", f"{text}, MOTION refused", 100 * after / before, "%",
                "this order contradicts itself a quarter as much for the same error"),
        derived("S-EFF-06", f"{text}, by the cleaning alone", 100 * cleaned / before, "%",
                "flying pixels and those without neighbours"),
        judged("S-EFF-06", f"{text}, MOTION refused and cleaned", None, 100 * both / before, "%", both < before / 10,
               "reduced tenfold"),
        judged("S-EFF-06", f"{name}: good pixels lost by MOTION", None, 100 * lost, "%", lost < 0.03, "a few percent"),
    ]  # fmt: skip
    face_m = outcomes["5 m/s towards us at 2 m, wall at 6 m"].face_m
    why = "a bias of the whole face, which no pixel can tell; it falls with the exposures' period"
    return [*claims, derived("S-EFF-06", f"{name}: bias of the face at 5 m/s towards us", 1e3 * face_m, "mm", why)]


def _shown(image: RangeImage) -> Floats:
    return np.where(image.valid, image.range_m, np.nan)


def _survivors(name: str, outcomes: dict[str, _Outcome], tested: bool, colour: int) -> Series:
    limits = np.geomspace(_GROSS_M, 2.0, 40)
    images = [(each.off_m, each.gross & (each.tested if tested else each.plain).valid) for each in outcomes.values()]
    off_m = np.concatenate([off[kept] for off, kept in images])
    counts = np.array([np.sum(off_m > limit) for limit in limits], float)
    counts[counts == 0] = np.nan
    return Series("" if tested else name, limits, counts, line="-" if tested else "--", colour=colour)
