"""The filters beside each other: noise, sigma, bias at edges and pixels lost, on simulated phase images."""

from typing import Any

import numpy as np

from rangecam.clean import FILTERS, CleanSettings, clean
from rangecam.cw.camera import simulate
from rangecam.cw.ranging import cw_four_phase
from rangecam.cw.settings import CwCamera
from rangecam.geometry import Lens, Mounting
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats, RangeImage

_SHAPE, _FINE = (120, 240), 3
_LENS = Lens(horizontal_fov_deg=1.0)
_CAMERA = CwCamera(
    rows=_SHAPE[0], columns=_SHAPE[1], lens=_LENS, modulation_hz=20e6, read_noise_lsb=2.0, shot_noise_lsb2_per_lsb=0.0
)
_AMPLITUDE_LSB = 300.0
_SLOPES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
_STEP_M, _PERIOD = 0.6, 30
_CHOICES = ("off", *FILTERS)
_GROSS_M = 0.03


def filters(rng: np.random.Generator) -> Study:
    """The filters beside each other: noise left on inclines, sigma, bias at edges, flying pixels.

    rng: of the simulated images.
    """
    sigma_m = float(np.median(_seen(_incline(0.0), rng).sigma_m))
    planes = [_centre(_incline(slope * sigma_m)) for slope in _SLOPES]
    inclines = [_seen(_incline(slope * sigma_m), rng) for slope in _SLOPES]
    claims, left = [], {}
    for name in _CHOICES:
        scores = [_score(_cleaned(each, name), plane) for each, plane in zip(inclines, planes, strict=True)]
        left[name] = [score[0] / sigma_m for score in scores]
        claims += _noise_claims(name, sigma_m, scores)
    steps = _steps()
    seen = _seen(steps, rng)
    profiles = {name: _profile(_cleaned(seen, name, reject_flying=True), steps) for name in _CHOICES}
    claims += [_edge_claim(name, profile) for name, profile in profiles.items()]
    claims += _flying_claims(seen, steps)
    noise = Panel(
        "Inclined planes",
        "slope (standard deviations a pixel)",
        "noise left (of one pixel's)",
        [Series(name, _SLOPES, values) for name, values in left.items()],
    )
    edge = Panel(
        f"Beside edges of {_STEP_M:g} m, flying pixels rejected",
        "distance from the edge (pixels), nearer surface to the left",
        "mean error (mm)",
        [Series(name, *profile) for name, profile in profiles.items()],
    )
    return Study("filters", "Steinbäck 2016, 2.3", claims, [noise, edge])


def _places() -> Floats:
    """Return the column of each ray of each pixel, in pixels: (K, H, W); rows lean by a tenth of a pixel each."""
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    down, right = (each.reshape(-1, 1, 1) for each in np.meshgrid(offsets, offsets, indexing="ij"))
    rows, columns = np.mgrid[: _SHAPE[0], : _SHAPE[1]]
    place: Floats = columns + right + 0.1 * (rows + down)
    return place


def _incline(slope_m: float) -> Floats:
    return 3.7 + slope_m * (_places() - _SHAPE[1] / 2)


def _steps() -> Floats:
    """Return walls that alternate between two distances: (K, H, W) m."""
    return 3.7 + _STEP_M * (_places() // _PERIOD % 2)


def _centre(rays_m: Floats) -> Floats:
    middle: Floats = rays_m[len(rays_m) // 2]
    return middle


def _seen(rays_m: Floats, rng: np.random.Generator) -> RangeImage:
    """Return the range image of surfaces so bright that all send the same light."""
    gain = _CAMERA.reference_amplitude_lsb
    view = View(rays_m, _AMPLITUDE_LSB / gain * rays_m**2, np.ones_like(rays_m))
    return cw_four_phase(simulate(lambda _: view, _CAMERA, 0.0, rng), _CAMERA)


def _cleaned(image: RangeImage, name: str, reject_flying: bool = False) -> RangeImage:
    changes: dict[str, Any] = {"filter": name, "reject_flying": reject_flying}
    return clean(image, _LENS, Mounting(), CleanSettings(**changes))


def _score(image: RangeImage, truth: Floats) -> tuple[float, float]:
    """Return the noise (m) and the part of the truth within one sigma."""
    inner = np.s_[3:-3, 3:-3]
    error = (image.range_m - truth)[inner][image.valid[inner]]
    inside = np.abs(error) < image.sigma_m[inner][image.valid[inner]]
    return float(error.std()), float(inside.mean())


def _noise_claims(name: str, sigma_m: float, scores: list[tuple[float, float]]) -> list[Claim]:
    """Return what is left of the noise squarely and on the incline, and how far sigma is from true at worst."""
    worst = max((score[1] - 0.6827 for score in scores), key=abs)
    steep = _SLOPES.index(2.0)
    why = "68 % within 5 points on every incline"
    return [
        derived("S-PRE-09", f"{name}: noise left on a wall seen squarely", scores[0][0] / sigma_m, "sigma"),
        derived("S-PRE-09", f"{name}: noise left at a slope of 2 sigma/pixel", scores[steep][0] / sigma_m, "sigma"),
        judged("S-PRE-09", f"{name}: pixels within one sigma beyond 68.3 %, at worst", None, 100 * worst, "points",
               abs(worst) < 0.05, why),
    ]  # fmt: skip


def _profile(image: RangeImage, rays_m: Floats) -> tuple[Floats, Floats]:
    """Return distances from the edge (pixels) and the mean error there (mm)."""
    place = _centre(_places())
    period = 2 * _PERIOD
    from_edge = (place - _PERIOD + period / 2) % period - period / 2  # the edges from near to far, at odd multiples
    pure = (rays_m.max(axis=0) == rays_m.min(axis=0)) & image.valid & (np.abs(from_edge) < 7)
    error = (image.range_m - _centre(rays_m))[pure] * 1e3
    bins = np.round(from_edge[pure]).astype(int) + 7
    distance = np.unique(bins)
    return distance - 7.0, np.array([error[bins == k].mean() for k in distance])


def _edge_claim(name: str, profile: tuple[Floats, Floats]) -> Claim:
    worst = float(profile[1][np.argmax(np.abs(profile[1]))])
    text = f"{name}: mean error within 7 pixels of an edge of {_STEP_M:g} m, at worst"
    return judged("S-PRE-09", text, None, worst, "mm", abs(worst) < 5, "below 5 mm")


def _flying_claims(seen: RangeImage, rays_m: Floats) -> list[Claim]:
    """Return how many gross flying pixels are left, and how many good ones are lost."""
    mixed = rays_m.max(axis=0) > rays_m.min(axis=0)
    claims = []
    for reject in (False, True):
        image = _cleaned(seen, "median", reject)
        gross = mixed & image.valid & (np.abs(image.range_m - rays_m).min(axis=0) > _GROSS_M + 2 * seen.sigma_m)
        lost = np.mean(~image.valid[~mixed])
        how = "with" if reject else "without"
        text = f"flying pixels left of {mixed.sum()} mixed ones, {how} rejection"
        why = "over 30 mm and two sigma from both surfaces"
        part = 100 * gross.sum() / mixed.sum()
        claims.append(judged("S-PRE-09", text, None, part, "%", part < 1, why) if reject
                      else derived("S-PRE-09", text, part, "%", why))  # fmt: skip
        text = f"good pixels lost, {how} rejection"
        claims.append(judged("S-PRE-09", text, None, 100 * lost, "%", lost < 0.03, "at most 3 %"))
    return claims
