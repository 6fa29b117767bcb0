"""Targets before a simulated camera: what its ranges are worth, with intervals, and what its chain says of them.

Not the whole image is simulated: all pixels see the same target squarely, and differ only by what the lens does to
them. The centre stands for pixels on the optical axis, the corners for the four outermost pixels, which get the least
light.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rangecam.cameras.simulated import SIMULATE
from rangecam.clean import CleanSettings, clean
from rangecam.config import Config
from rangecam.design.families import DESIGNED, AnyCamera, quiet
from rangecam.design.settings import Plan
from rangecam.design.statistics import Estimate, error_estimates, share_estimate
from rangecam.geometry import Lens
from rangecam.pipeline import RANGING
from rangecam.scene.view import View
from rangecam.types import Floats, Image, RangeImage, RawFrame, Why

_ON_AXIS = Lens(horizontal_fov_deg=1e-3, vertical_fov_deg=1e-3)
_CORNER_FRAMES = 2
_TRIED_TO_M = 300.0
_A_LITTLE = 0.01
_BRIGHTNESS = np.geomspace(1e-5, 1e2, 24)
_ALIKE = 3


TRIED_FROM_M = 0.02
"""Nearest range at which a measurement range is tried."""


@dataclass(frozen=True)
class Region:
    """Pixels of a camera that are simulated in place of its image."""

    name: str
    camera: AnyCamera
    few_pixels: bool
    frames: int


@dataclass(frozen=True)
class Point:
    """What became of one target.

    valid: share of the pixels. bias, spread and error (m) of the valid ones: mean, standard deviation about it, root
    mean square about the truth. sigma_m: what the chain says of its own noise, root mean square. expected_m: the same
    of samples without noise, the closed form of the method. electrons: of the light of the target. refused: the reason
    of most invalid pixels, empty without any.
    """

    region: str
    range_m: float
    reflectivity: float
    samples: int
    valid: Estimate
    bias: Estimate
    spread: Estimate
    error: Estimate
    sigma_m: float
    expected_m: float
    electrons: float | None
    n_acc: float | None
    refused: str


def regions(camera: AnyCamera, plan: Plan) -> tuple[Region, Region]:
    """Return the pixels on the axis and those in the four corners of the image."""
    family = DESIGNED[camera.kind]
    axis = replace(family.alike(camera, camera.columns // 2), rows=plan.side, columns=plan.side, lens=_ON_AXIS)
    corners = replace(family.alike(camera, 0), rows=2, columns=2, lens=corner_lens(camera))
    return (
        Region("centre", axis, False, plan.frames),
        Region("corners", corners, True, _CORNER_FRAMES * plan.frames),
    )


def corner_lens(camera: AnyCamera) -> Lens:
    """Return the lens with which an image of 2 x 2 pixels looks where the corner pixels of the camera look."""
    lens, rows, columns = camera.lens, camera.rows, camera.columns
    perspective = lens.projection == "perspective"
    half_h = math.radians(lens.horizontal_fov_deg / 2)
    across = math.tan(half_h) if perspective else half_h
    down = across * rows / columns
    if lens.vertical_fov_deg is not None:
        half_v = math.radians(lens.vertical_fov_deg / 2)
        down = math.tan(half_v) if perspective else half_v
    # the centres of 2 x 2 pixels lie at half of the opening, those of the corner pixels at (n - 1) / n of it
    outer = (2 * (1 - 1 / columns) * across, 2 * (1 - 1 / rows) * down)
    horizontal, vertical = (2 * math.degrees(math.atan(part) if perspective else part) for part in outer)
    return replace(lens, horizontal_fov_deg=horizontal, vertical_fov_deg=vertical)


def observe(config: Config, region: Region, target: tuple[float, float], plan: Plan, rng: np.random.Generator) -> Point:
    """Return what became of a target: (range, m; reflectivity), seen by the pixels of a region."""
    range_m, reflectivity = target
    images, n_acc = measure(config, region, target, plan, rng)
    why = _stack(images, "why")
    inner = np.ones(why.shape[1], bool) if region.few_pixels else (why != Why.BORDER).any(axis=0)
    why, valid = why[:, inner], why[:, inner] == Why.VALID  # the simulated centre has no border
    found, sigma = (_stack(images, name)[:, inner] for name in ("range_m", "sigma_m"))
    error_m = np.where(valid, found.astype(np.float64) - range_m, 0.0)
    bias, spread, error = error_estimates(error_m, valid, plan.confidence, region.few_pixels)
    clear = without_noise(config, region, target, plan)
    sigma_m = math.sqrt(float(np.mean(sigma[valid].astype(np.float64) ** 2))) if valid.any() else math.nan
    electrons = DESIGNED[region.camera.kind].electrons(region.camera)
    return Point(
        region.name,
        range_m,
        reflectivity,
        valid.size,
        share_estimate(valid, plan.confidence, region.few_pixels),
        bias,
        spread,
        error,
        sigma_m,
        float(clear.sigma_m.flat[0]),
        None if electrons is None else electrons * float(clear.amplitude.flat[0]) * (n_acc or 1),
        n_acc,
        _reason(why),
    )


def measure(
    config: Config,
    region: Region,
    target: tuple[float, float],
    plan: Plan,
    rng: np.random.Generator,
    simulated: AnyCamera | None = None,
) -> tuple[list[RangeImage], float | None]:
    """Return the range images of a target and the mean number of accumulations, None for cameras without.

    simulated: the camera that takes the images, if it is another than the one that ranges them.
    """
    view = _squarely(np.full((region.camera.rows, region.camera.columns), target[0]), target[1], plan)
    raws = [_take(simulated or region.camera, view, k, rng) for k in range(region.frames)]
    counts = [float(np.mean(raw.planes["n_acc"])) for raw in raws if "n_acc" in raw.planes]
    return [_ranged(raw, config, region, plan) for raw in raws], float(np.mean(counts)) if counts else None


def without_noise(config: Config, region: Region, target: tuple[float, float], plan: Plan) -> RangeImage:
    """Return the range image of a target whose samples have no noise; its sigma is the closed form of the method."""
    view = _squarely(np.full((region.camera.rows, region.camera.columns), target[0]), target[1], plan)
    return RANGING[config.ranging](_take(quiet(region.camera), view, 0, np.random.default_rng(0)), region.camera)


def expected_sigma_m(config: Config, region: Region, range_m: Floats, reflectivity: float, plan: Plan) -> Floats:
    """Return what the chain says of its noise where the samples have none, m (N,); NaN where it gives no range.

    range_m (N,): of targets of one reflectivity.
    """
    images = (without_noise(config, region, (float(at_m), reflectivity), plan) for at_m in range_m)
    return np.array([image.sigma_m.flat[0] for image in images])


def reach_m(config: Config, plan: Plan) -> tuple[float, float]:
    """Return nearest and farthest range that the method can measure, given light enough and not too much, m.

    Found by trial, of every method alike: samples without noise of targets whose brightness does not fall with the
    range, in many brightnesses. NaN if there is no such range.
    """
    low, high = TRIED_FROM_M, _TRIED_TO_M
    steps = np.geomspace(low, high, 500)
    for _ in range(2):
        good = _measurable(config, steps, plan)
        if not good.any():
            return math.nan, math.nan
        first = int(good.argmax())
        last = first + int(np.argmin(good[first:])) - 1 if not good[first:].all() else len(good) - 1
        low, high = float(steps[first]), float(steps[last])
        ends = [(steps[max(first - 1, 0)], low), (high, steps[min(last + 1, len(steps) - 1)])]
        steps = np.unique(np.concatenate([np.linspace(*end, 200) for end in ends] + [np.geomspace(low, high, 50)]))
    return low, high


def _measurable(config: Config, range_m: Floats, plan: Plan) -> Any:
    """Return at which ranges (N,) some brightness gives a valid range that grows with the truth.

    It may be off, as that of a camera with soft edges is without calibration, but not by as much as a wrapped one.
    """
    both_m = np.concatenate([(1 - _A_LITTLE) * range_m, range_m])
    both_m = np.repeat(np.broadcast_to(both_m, (len(_BRIGHTNESS), len(both_m))), _ALIKE, axis=1).repeat(_ALIKE, axis=0)
    bright = np.repeat(_BRIGHTNESS, _ALIKE)[:, None] * both_m**2
    ranging = DESIGNED[config.camera.kind].alike(config.camera, config.camera.columns // 2)
    ranging = replace(ranging, rows=both_m.shape[0], columns=both_m.shape[1], lens=_ON_AXIS)
    view = View(both_m[None], bright[None], np.ones((1, *both_m.shape)))
    image = RANGING[config.ranging](_take(quiet(ranging), view, 0, np.random.default_rng(0)), ranging)
    middles = slice(_ALIKE // 2, None, _ALIKE)  # methods that look at the neighbours find them alike
    valid = image.valid[middles, middles][:, len(range_m) :]
    nearer_m, found_m = np.split(image.range_m[middles, middles].astype(np.float64), 2, axis=1)
    grown = found_m - nearer_m > _A_LITTLE * range_m / 5  # not so where the method is at its limit
    close = (found_m - range_m > -0.6 * range_m - 0.1) & (found_m - range_m < 0.6 * range_m + 1.0)  # not wrapped
    return (valid & grown & close).any(axis=0)


def _squarely(range_m: Image, reflectivity: float, plan: Plan) -> View:
    """Return the view of a surface that every pixel sees squarely."""
    one = np.ones((1, *range_m.shape))
    return View(range_m[None], reflectivity * one, one, plan.ambient_wpm2)


def _take(camera: AnyCamera, view: View, number: int, rng: np.random.Generator) -> RawFrame:
    return SIMULATE[camera.kind](lambda _: view, camera, number / camera.frame_rate_hz, rng)


def _ranged(raw: RawFrame, config: Config, region: Region, plan: Plan) -> RangeImage:
    image = RANGING[config.ranging](raw, region.camera)
    if not plan.clean:
        return image
    return clean(image, region.camera.lens, config.mounting, _everywhere(config.clean))


def _everywhere(settings: CleanSettings) -> CleanSettings:
    """Return the cleaning without what depends on where a target stands, or on the border of the image."""
    box: dict[str, Any] = dict.fromkeys(("x_min_m", "x_max_m", "width_m", "z_min_m", "z_max_m"))
    return replace(settings, floor="off", discard_border=False, **box)


def _stack(images: Sequence[RangeImage], name: str) -> Any:
    return np.array([getattr(image, name).ravel() for image in images])


def _reason(why: Any) -> str:
    counts = np.bincount(why.ravel(), minlength=len(Why))
    counts[Why.VALID] = 0
    return Why(int(counts.argmax())).name if counts.any() else ""
