"""A design judged: every target of the plan simulated, the limits found, the numbers put together."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rangecam.cameras.simulated import SIMULATE
from rangecam.config import Config
from rangecam.design.experiment import Point, Region, expected_sigma_m, observe, reach_m, regions
from rangecam.design.facts import facts
from rangecam.design.families import DESIGNED, finite
from rangecam.design.limits import Limits, find_limits, saturated_below_m
from rangecam.design.settings import Plan
from rangecam.scene.view import View
from rangecam.types import Floats

_CURVE = 120
_NEAR_STEPS = (1 / 100, 1 / 60, 1 / 40, 1 / 30)
_STEPS = 20


@dataclass(frozen=True, eq=False)
class Design:
    """What is known of a camera before it is built.

    points: of every target and region. limits: of every reflectivity and region. saturated_m: range below which a
    target of that reflectivity saturates the centre. curves: by reflectivity, ranges and the expected sigma, m, in the
    centre. numbers: see `facts`. warnings: of a design that works but should not be built so.
    """

    name: str
    config: Config
    plan: Plan
    points: tuple[Point, ...]
    limits: tuple[Limits, ...]
    saturated_m: dict[float, float]
    curves: dict[float, tuple[Floats, Floats]]
    numbers: dict[str, Any]
    warnings: tuple[str, ...]


def judge(name: str, config: Config, plan: Plan, seed: int = 0) -> Design:
    """Return the design of a configuration, judged by a plan; the same for the same seed.

    Raises UsageError for a camera that cannot be built so (see the cameras).
    """
    camera = config.camera
    one = np.ones((1, camera.rows, camera.columns))
    raw = SIMULATE[camera.kind](lambda _: View(one, one, one), camera, 0.0, np.random.default_rng(seed))
    reach = reach_m(config, plan)
    centre, corners = regions(camera, plan)
    at_m = distances_m(plan, reach)
    points, limits = [], []
    for number, (region, rho) in enumerate(_each(centre, corners, plan)):
        rng = np.random.default_rng([seed, number])
        seen = [observe(config, region, (float(range_m), rho), plan, rng) for range_m in at_m]
        points += seen
        limits.append(find_limits(config, region, seen, plan, rng))
    curve_m = np.linspace(at_m[0], at_m[-1], _CURVE)
    return Design(
        name,
        config,
        plan,
        tuple(points),
        tuple(limits),
        {rho: saturated_below_m(config, centre, rho, reach, plan) for rho in plan.reflectivities},
        {rho: (curve_m, expected_sigma_m(config, centre, curve_m, rho, plan)) for rho in plan.reflectivities},
        facts(config, plan, reach, raw),
        tuple(DESIGNED[camera.kind].warnings(camera)),
    )


def distances_m(plan: Plan, reach: tuple[float, float]) -> Floats:
    """Return the ranges of the targets, in order, m: those of the plan, else spread over the measurement range."""
    if plan.distances_m:
        return np.unique(np.array(plan.distances_m))
    near_m, far_m = reach if math.isfinite(reach[1]) else (0.1, 10.0)
    steps = far_m * np.array([*_NEAR_STEPS, *(np.arange(1, _STEPS + 1) / _STEPS)])
    return np.unique(np.maximum(steps, near_m))


def _each(centre: Region, corners: Region, plan: Plan) -> Iterator[tuple[Region, float]]:
    for region in (centre, corners):
        for rho in plan.reflectivities:
            yield region, rho


def as_json(design: Design) -> dict[str, Any]:
    """Return a design as plain values for JSON, None where a number is not known."""
    return {
        "name": design.name,
        "preset": design.config.preset,
        "plan": asdict(design.plan),
        "numbers": design.numbers,
        "warnings": list(design.warnings),
        "limits": [_plain(asdict(one)) for one in design.limits],
        "saturated_below": [{"reflectivity": rho, "range_m": at_m} for rho, at_m in design.saturated_m.items()],
        "points": [_plain(asdict(point)) for point in design.points],
    }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return finite(value) if isinstance(value, float) else value
