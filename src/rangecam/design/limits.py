"""From where to where a design keeps what is asked of it, and what ends it there: found by trial, not by guess."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rangecam.config import Config
from rangecam.design.experiment import TRIED_FROM_M, Point, Region, measure, observe
from rangecam.design.families import DESIGNED, AnyCamera
from rangecam.design.settings import Plan
from rangecam.types import Why

_HALVINGS = 6
_SATURATED_FRAMES = 4
_WORTH_NAMING = 0.05

_MEANING = {
    Why.SATURATED: "too much light",
    Why.LOW_AMPLITUDE: "too little light",
    Why.OUT_OF_RANGE: "outside of the range that the method measures",
    Why.WRAPPED: "beyond the unambiguous range",
    Why.NO_SIGNAL: "no light",
}


@dataclass(frozen=True)
class Limits:
    """Where one reflectivity is measured as well as asked, in one region of the image.

    nearest_m, farthest_m: ends of it, NaN if it is nowhere; complete: no target between them fails. near, far: a
    sentence on what ends it. near_shares, far_shares: of the mean square error there, by part.
    """

    region: str
    reflectivity: float
    nearest_m: float
    farthest_m: float
    complete: bool
    near: str
    far: str
    near_shares: dict[str, float]
    far_shares: dict[str, float]


def passes(point: Point, plan: Plan) -> bool:
    """Return whether enough pixels are valid and their error is small enough."""
    return point.valid.value >= plan.valid and point.error.value <= plan.accuracy * point.range_m


def find_limits(
    config: Config, region: Region, points: Sequence[Point], plan: Plan, rng: np.random.Generator
) -> Limits:
    """Return the limits of one reflectivity from its points in order of range, refined by halving between them."""
    rho = points[0].reflectivity
    good = [passes(point, plan) for point in points]
    if not any(good):
        best = max(points, key=lambda point: (round(point.valid.value, 2), -point.error.value / point.range_m))
        nowhere = f"nowhere; at best, at {best.range_m:.3g} m, {_failure(best, plan)}"
        shares = _shares(config, region, best, plan, rng)
        nowhere += _of_what(best, shares, plan)
        return Limits(region.name, rho, math.nan, math.nan, False, nowhere, nowhere, shares, shares)
    first, last = good.index(True), len(good) - 1 - good[::-1].index(True)
    ends = []
    for inner, outer in ((first, first - 1), (last, last + 1)):
        beyond = points[outer] if 0 <= outer < len(points) else None
        ends.append(_end(config, region, points[inner], beyond, plan, rng))
    (near_m, near, near_shares), (far_m, far, far_shares) = ends
    return Limits(region.name, rho, near_m, far_m, all(good[first : last + 1]), near, far, near_shares, far_shares)


def _end(
    config: Config, region: Region, inner: Point, outer: Point | None, plan: Plan, rng: np.random.Generator
) -> tuple[float, str, dict[str, float]]:
    """Return where the good ranges end, what ends them, and the shares of the error there."""
    if outer is None:
        return inner.range_m, "not reached within the simulated ranges", {}
    for _ in range(_HALVINGS):
        middle = observe(config, region, ((inner.range_m + outer.range_m) / 2, inner.reflectivity), plan, rng)
        inner, outer = (middle, outer) if passes(middle, plan) else (inner, middle)
    shares = _shares(config, region, inner, plan, rng)
    return inner.range_m, _failure(outer, plan) + _of_what(outer, shares, plan), shares


def _failure(point: Point, plan: Plan) -> str:
    if point.valid.value < plan.valid:
        why = Why[point.refused]
        return (
            f"{100 * (1 - point.valid.value):.0f} % of the pixels are refused, most as {why.name}: "
            f"{_MEANING.get(why, 'refused by cleaning')}"
        )
    return f"the error exceeds {100 * plan.accuracy:g} % of the range"


def _of_what(failed: Point, shares: dict[str, float], plan: Plan) -> str:
    """Return the parts of the error worth naming, the largest first, where they are what makes the design fail."""
    if failed.valid.value < plan.valid and failed.refused != Why.LOW_AMPLITUDE.name:
        return ""
    named = sorted(((share, name) for name, share in shares.items() if share >= _WORTH_NAMING), reverse=True)
    return "; " + ", ".join(f"{name} {100 * share:.0f} %" for share, name in named) if named else ""


def _shares(config: Config, region: Region, point: Point, plan: Plan, rng: np.random.Generator) -> dict[str, float]:
    """Return by how much the mean square error falls when a part is switched off, as a part of it.

    Every part is taken off with the same random numbers. The ambient light's part lies within that of the shot noise.
    """
    seed = int(rng.integers(2**32))

    def square_and_bias(camera: AnyCamera, planned: Plan) -> tuple[float, float]:
        target = (point.range_m, point.reflectivity)
        images, _ = measure(config, region, target, planned, np.random.default_rng(seed), camera)
        found = np.concatenate([image.range_m[image.valid] for image in images]).astype(np.float64) - point.range_m
        return (float(np.mean(found**2)), float(np.mean(found))) if found.size else (math.nan, math.nan)

    whole, bias = square_and_bias(region.camera, plan)
    if not whole > 0:
        return {}
    without = {name: (camera, plan) for name, camera in DESIGNED[region.camera.kind].noise(region.camera).items()}
    if plan.ambient_wpm2:
        without["ambient light"] = (region.camera, replace(plan, ambient_wpm2=0.0))
    shares = {
        name: max(1 - square_and_bias(*switched)[0] / whole, 0.0) if switched != (region.camera, plan) else 0.0
        for name, switched in without.items()
    }
    return {**shares, "bias": bias**2 / whole}


def saturated_below_m(
    config: Config, region: Region, reflectivity: float, reach: tuple[float, float], plan: Plan
) -> float:
    """Return the range below which most pixels are SATURATED by a target, m; 0 if there is none."""
    few = replace(region, frames=_SATURATED_FRAMES)

    def saturated(range_m: float) -> bool:
        images, _ = measure(config, few, (range_m, reflectivity), plan, np.random.default_rng(0))
        return float(np.mean([image.why == Why.SATURATED for image in images])) > 0.5

    steps = np.geomspace(max(reach[0], TRIED_FROM_M), reach[1], 30)
    full = [saturated(float(range_m)) for range_m in steps]
    if not any(full):
        return 0.0
    last = len(full) - 1 - full[::-1].index(True)
    low, high = float(steps[last]), float(steps[min(last + 1, len(steps) - 1)])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if saturated(middle) else (low, middle)
    return low
