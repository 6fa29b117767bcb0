"""Scenes that trouble the pulsed camera: a bright neighbour, an edge within a pixel, motion; and plain walls."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed import RANGING, simulate
from rangecam.pulsed.camera import max_frame_rate_hz
from rangecam.pulsed.settings import Crosstalk, PulsedCamera
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import Ranged, looking_at, quiet, ranged
from rangecam.types import Floats

NEAR_M, FAR_M = 3.0, 10.0
BRIGHT, DARK = 0.9, 0.05
SPEED_MPS = 15.0
SPEC = 0.03
_BRIGHT_COLUMNS = 16
_ROW, _COLUMN = 5, 31
_PITCHES = (1, 2, 4, 8, 16, 32)
_AT_M = np.arange(2.0, 20.5, 1.0)
_REPEATS = 1000
_FRAMES = 200
PARTS = {
    "blur": Crosstalk(blur=True),
    "stray light, 1 %": Crosstalk(stray_fraction=0.01),
    "cover glass, 2 %": Crosstalk(cover_glass_fraction=0.02),
    "references, 1 %": Crosstalk(electrical_fraction=0.01),
    "all, corrected": Crosstalk(blur=True, stray_fraction=0.01, electrical_fraction=0.01, correct=True),
    "all": Crosstalk(blur=True, stray_fraction=0.01, electrical_fraction=0.01),
}
"""Sizes are *open*; stray light of 0.5 to 4 % is usual (4.2.1.4)."""


def pulsed_scenes(rng: np.random.Generator) -> Study:
    """Bright neighbours, edges, motion, and the range of one pixel of plain walls: what the whole camera measures.

    rng: of the noise of the images of walls.
    """
    camera = PulsedCamera(speed_of_light_mps=3e8)
    errors = {name: _crosstalk(camera, part) for name, part in PARTS.items()}
    mixed = _edge(camera)
    moved = {order: _motion(camera, order) for order in ("sequential", "alternating")}
    walls = {
        (rho, n_av): ranged(_AT_M, rho, replace(camera, averages=n_av), "mdsi3", _REPEATS, rng)
        for rho in (0.05, 0.8)
        for n_av in (1, 4)
    }
    claims = [*_troubled(errors), *_mixed(mixed), *_corrupted(moved), *_walls(walls), *_one_pixel(camera, rng)]
    panels = [_crosstalk_panel(errors), _edge_panel(mixed), _motion_panel(moved), _wall_panel(walls)]
    return Study("pulsed-scenes", "König 2008, 4.2.1.4, 4.2.3.3 and 4.2.3.4", claims, panels)


def _ranges(camera: PulsedCamera, view: View) -> Floats:
    raw = simulate(looking_at(view), camera, 0.0, np.random.default_rng(0))
    return np.asarray(RANGING["mdsi3"](raw, camera).range_m, np.float64)


def _crosstalk(camera: PulsedCamera, parts: Crosstalk) -> Floats:
    """Return the errors of dark pixels at 10 m by their pitch from a bright wall at 3 m, m (N,) (K-CHR-12)."""
    still = quiet(replace(camera, crosstalk=parts))
    bright = np.arange(camera.columns) < _BRIGHT_COLUMNS
    one = np.ones((1, camera.rows, camera.columns))
    view = View(np.where(bright, NEAR_M, FAR_M) * one, np.where(bright, BRIGHT, DARK) * one, one)
    off_m = _ranges(still, view)[camera.rows // 2] - FAR_M
    return np.asarray(off_m[[_BRIGHT_COLUMNS - 1 + pitch for pitch in _PITCHES]])


def _troubled(errors: dict[str, Floats]) -> list[Claim]:
    claims = []
    for name, off_m in errors.items():
        for pitch, value in zip(_PITCHES, off_m, strict=True):
            if pitch in (1, 2, 16):
                text = f"error of a dark pixel {pitch} from a bright wall, {name}"
                claims.append(derived("K-CHR-12", text, 100 * value, "cm"))
    whole, blur = np.abs(errors["all"]), np.abs(errors["blur"])
    near = "its strength depends on the pitch from the bright region, as 4.2.1.4 says"
    direct = "blur reaches direct neighbours only (N-K-013)"
    text = "crosstalk next to the bright wall over that 32 pixels away"
    ratio = float(whole[0] / whole[-1])
    return [
        *claims,
        judged("K-CHR-12", text, None, ratio, "", ratio > 1.5, near),
        judged("K-CHR-12", "blur two pixels away", 0, 100 * float(blur[1]), "cm", blur[1] < 1e-3 < blur[0], direct),
    ]


def _edge(camera: PulsedCamera) -> Floats:
    """Return ranges of a pixel by the part of it that sees a near wall of the same reflectivity, m (N,) (K-CHR-13)."""
    rays = 16
    still = quiet(replace(camera, rows=1, columns=rays + 1))
    near = np.arange(rays)[:, None, None] < np.arange(rays + 1)
    one = np.ones(near.shape)
    return np.asarray(_ranges(still, View(np.where(near, NEAR_M, FAR_M), 0.5 * one, one))[0])


def _mixed(mixed_m: Floats) -> list[Claim]:
    half = (NEAR_M / NEAR_M**2 + FAR_M / FAR_M**2) / (1 / NEAR_M**2 + 1 / FAR_M**2)
    found = float(mixed_m[len(mixed_m) // 2])
    why = f"the mean of both ranges by their light, {half:.3f} m"
    between = bool(np.all((mixed_m[1:-1] > NEAR_M) & (mixed_m[1:-1] < FAR_M)))
    return [
        judged(
            "K-CHR-13", "range of a pixel half on 3 m, half on 10 m", None, found, "m", abs(found - half) < 5e-3, why
        ),
        judged("K-CHR-13", "ranges at the edge lie between both walls", None, float(between), "", between, "all"),
    ]


def _motion(camera: PulsedCamera, order: str) -> Floats:
    """Return errors of the range of a wall that comes at some speeds, m (N,) (K-CHR-13)."""
    still = quiet(replace(camera, shutter_order="alternating" if order == "alternating" else "sequential"))
    still = replace(still, frame_rate_hz=max_frame_rate_hz(still))
    one = np.ones((1, still.rows, still.columns))
    errors = []
    for speed_mps in _speeds():

        def view(time_s: float, speed_mps: float = float(speed_mps)) -> View:
            return View((FAR_M - speed_mps * time_s) * one, 0.5 * one, one)

        raw = simulate(view, still, 0.0, np.random.default_rng(0))
        errors.append(RANGING["mdsi3"](raw, still).range_m[0, 0] - FAR_M)
    return np.array(errors, np.float64)


def _speeds() -> Floats:
    return np.linspace(0.0, 30.0, 13)


def _corrupted(moved: dict[str, Floats]) -> list[Claim]:
    at = int(np.flatnonzero(_speeds() == SPEED_MPS)[0])
    slow, fast = (abs(float(moved[order][at])) for order in ("sequential", "alternating"))
    better = "alternating shutters see nearly the same scene; 100 pulses lie between sequential ones (N-K-050)"
    text = "error by 15 m/s with sequential shutters over that with alternating ones"
    return [
        derived("K-CHR-13", "error of a wall that comes with 15 m/s, sequential shutters", 100 * slow, "cm"),
        derived("K-CHR-13", "the same with alternating shutters", 100 * fast, "cm"),
        judged("K-CHR-13", text, None, slow / fast, "", slow > 20 * fast, better),
    ]


def _walls(walls: dict[tuple[float, int], Ranged]) -> list[Claim]:
    """Return what fig 4.18 shows (K-CHR-10): accuracy of 5 % and 80 % targets at 2-20 m, and the accumulations."""
    share = {key: one.sigma_m / _AT_M for key, one in walls.items()}
    crossed_m = float(_AT_M[share[0.05, 1] > SPEC][0])
    best, bright = 100 * float(share[0.05, 4].max()), 100 * float(share[0.8, 1].max())
    rises = all(bool(np.all(np.diff(one.n_acc) >= 0)) for one in walls.values())
    weak = (
        "one 2 kW module at kappa = 1 is too weak for it by a third (N-K-043); the camera full at 2 m on white meets it"
    )
    near = "within 1 m of the measured one"
    fine = "below 3 % everywhere"
    last = float(walls[0.05, 1].n_acc[-1])
    return [
        judged("F-K-11", "5 % target, n_av 1: exceeds 3 % from", 8, crossed_m, "m", abs(crossed_m - 8) <= 1, near),
        judged("F-K-11", "5 % target, n_av 4: largest sigma_d / d to 20 m", 3, best, "%", best <= 3, weak),
        judged("F-K-11", "80 % target, n_av 1: largest sigma_d / d to 20 m", 3, bright, "%", bright <= 3, fine),
        judged("F-K-11", "accumulations of the 5 % target at 20 m", 100, last, "", rises, "grow with the distance"),
    ]


def _one_pixel(camera: PulsedCamera, rng: np.random.Generator) -> list[Claim]:
    """Return mean and linearity of the pixel of the thesis on a plywood wall, with the real lens (K-CHR-11)."""
    at_m, rows = np.arange(3.0, 21.5, 3.0), []
    one = np.ones((1, camera.rows, camera.columns))
    fewer = replace(camera, pixel=replace(camera.pixel, accumulations=(1, 4, 16, 64)))
    for range_m in at_m:
        view = looking_at(View(range_m * one, 0.5 * one, one))
        images = [RANGING["mdsi3"](simulate(view, fewer, 0.0, rng), fewer) for _ in range(_FRAMES)]
        values = np.array([image.range_m[_ROW, _COLUMN] for image in images], np.float64)
        rows.append((values.mean() - range_m, values.std() / np.sqrt(_FRAMES)))
    off_m, error_m = np.array(rows).T
    agrees = bool(np.all(np.abs(off_m) < 4 * error_m + 1e-3))
    text = "pixel 32 of line 6, plywood, 3-21 m: largest deviation of the mean from the bisecting line"
    worst_cm = 100 * float(np.abs(off_m).max())
    return [judged("F-K-12", text, 0, worst_cm, "cm", agrees, f"within four standard errors of {_FRAMES} images")]


def _crosstalk_panel(errors: dict[str, Floats]) -> Panel:
    series = [Series(name, _PITCHES, 100 * off_m, line="o-") for name, off_m in errors.items()]
    title = f"Target of {DARK:g} at {FAR_M:g} m beside one of {BRIGHT:g} at {NEAR_M:g} m"
    return Panel(title, "pixels from the bright target", "error of the range (cm)", series, "x")


def _edge_panel(mixed_m: Floats) -> Panel:
    part = np.linspace(0, 100, len(mixed_m))
    return Panel("Edge within a pixel", "part that sees 3 m (%)", "range (m)", [Series("MDSI3", part, mixed_m)])


def _motion_panel(moved: dict[str, Floats]) -> Panel:
    series = [Series(f"{order} shutters", _speeds(), 100 * off_m) for order, off_m in moved.items()]
    return Panel("Wall at 10 m that comes nearer", "speed (m/s)", "error of the range (cm)", series)


def _wall_panel(walls: dict[tuple[float, int], Ranged]) -> Panel:
    series = []
    for (rho, n_av), one in walls.items():
        share = 100 * one.sigma_m / _AT_M
        series.append(Series(f"{100 * rho:g} %, n_av {n_av}", _AT_M, share, share / np.sqrt(2 * (_REPEATS - 1))))
    series.append(Series("specification", _AT_M, np.full(_AT_M.shape, 100 * SPEC), line="--", colour=4))
    return Panel("One 2 kW module, ±2σ", "range (m)", "standard deviation over range (%)", series)
