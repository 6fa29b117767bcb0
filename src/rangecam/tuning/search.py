"""The search for the most likely values."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from rangecam.config import tree
from rangecam.errors import DataError, UsageError
from rangecam.tracking import TrackingSettings
from rangecam.tuning.names import process_noise, value_of, with_values
from rangecam.tuning.paths import Likelihood, Paths, follow, likelihood
from rangecam.types import Floats
from rangecam.values import value
from rangecam.workers import Mapper

_GRID = {1: 13, 2: 9}  # points along each parameter, by how many there are
_ROUNDS = {1: 1, 2: 4}  # of the search along each of them
_CLOSE = 0.01  # of the natural logarithm of a parameter: where the search ends


@value
class Tuned:
    """What a search found.

    parameters: names; before, best: as they were (NaN where sources differ) and as they are most likely; sigma: one
    standard deviation of each value as a share of it, NaN at the edge; at_edge: whether it lies at the end of the
    range searched. old, new: the likelihood before and now. grid: values and log-likelihood where the search began.
    settings: the tracking of the first source with the values put in.
    """

    parameters: tuple[str, ...]
    before: tuple[float, ...]
    best: tuple[float, ...]
    sigma: tuple[float, ...]
    at_edge: tuple[bool, ...]
    old: Likelihood
    new: Likelihood
    grid: Sequence[tuple[tuple[float, ...], float]]
    settings: TrackingSettings


def follow_all(
    urls: Sequence[str],
    preset: str | None = None,
    layers: Sequence[Mapping[str, Any]] = (),
    seed: int = 0,
    mapper: Mapper = map,
) -> list[Paths]:
    """Return the paths of several sources; see `follow`."""
    return list(mapper(partial(follow, preset=preset, layers=layers, seed=seed), urls))


def tune(
    paths: Sequence[Paths],
    parameters: Sequence[str] = (),
    low: float = 0.01,
    high: float = 100.0,
    mapper: Mapper = map,
) -> Tuned:
    """Return the values of one or two parameters that make the measurements of all paths most likely.

    A grid in the logarithm from `low` to `high` first, so that no second maximum is taken for the first; then golden
    section and parabolas between its neighbours (Brent), of two parameters in turn. parameters: names as of
    `with_values`; none: `process_noise` of the motion models. The standard deviations are from the curvature of the
    likelihood: they hold if the motion model does.
    Raises UsageError for a number of parameters or a range that cannot be, or a parameter without effect, DataError
    where nothing was followed or no value explains it.
    """
    names = tuple(parameters) or tuple(sorted({process_noise(one.tracking) for one in paths}))
    if len(names) not in _GRID or len(set(names)) < len(names):
        raise UsageError(f"{', '.join(names)}: expected one parameter, or two that differ")
    if not 0 < low < high < math.inf:
        raise UsageError(f"search from {low} to {high}: expected 0 < low < high")
    befores = [tuple(value_of(one.tracking, name) for name in names) for one in paths]
    old = _sum(mapper(_score, [(one, one.tracking) for one in paths]))
    if not old.measurements:
        raise DataError("no confirmed track was seen twice: there is nothing to tune with; try another source")
    search = _Search(paths, names, mapper)
    bounds = math.log(low), math.log(high)
    axis = np.linspace(*bounds, _GRID[len(names)])
    points = [np.array(point) for point in product(axis, repeat=len(names))]
    best, grid = search.best_of(points)
    for _ in range(_ROUNDS[len(names)]):
        last = best
        for k in range(len(names)):
            best = search.along(best, k, axis[1] - axis[0], bounds)
        if np.abs(best - last).max() < _CLOSE:
            break
    new = search.at(best)
    edge = tuple(bool(min(x - bounds[0], bounds[1] - x) < 3 * _CLOSE) for x in best)
    sigma = tuple(math.nan if edge[k] else search.sigma(best, k) for k in range(len(names)))
    before = tuple(one[0] if len(set(one)) == 1 else math.nan for one in zip(*befores, strict=True))
    values = tuple(float(f"{math.exp(x):.3g}") for x in best)
    settings = with_values(paths[0].tracking, dict(zip(names, values, strict=True)))
    return Tuned(names, before, values, sigma, edge, old, new, grid, settings)


class _Search(NamedTuple):
    """Where the likelihood has been asked for: logarithms of the parameters in, likelihoods out."""

    paths: Sequence[Paths]
    names: tuple[str, ...]
    mapper: Mapper

    def ask(self, points: Sequence[Floats]) -> list[Likelihood]:
        """Return the likelihood at each point, the sum over the sources; all of them are one batch of work."""
        values = [dict(zip(self.names, np.exp(point).tolist(), strict=True)) for point in points]
        work = [(one, with_values(one.tracking, each)) for each in values for one in self.paths]
        scores, n = list(self.mapper(_score, work)), len(self.paths)
        return [_sum(scores[k * n : (k + 1) * n]) for k in range(len(points))]

    def at(self, point: Floats) -> Likelihood:
        """Return the likelihood at one point."""
        return self.ask([point])[0]

    def best_of(self, points: Sequence[Floats]) -> tuple[Floats, list[tuple[tuple[float, ...], float]]]:
        """Return the best of the points, and the values and log-likelihood of all of them."""
        totals = np.array([one.total for one in self.ask(points)])
        finite = totals[np.isfinite(totals)]
        if not len(finite):
            raise DataError("no value in the range explains the measurements; search another range")
        if len(finite) == len(totals) and np.ptp(totals) < 1e-9 * np.abs(totals).max():
            raise UsageError(f"{', '.join(self.names)}: without effect on these tracks with these settings")
        values = (tuple(np.exp(point).tolist()) for point in points)
        return points[int(np.argmax(totals))], list(zip(values, totals.tolist(), strict=True))

    def along(self, best: Floats, k: int, step: float, bounds: tuple[float, float]) -> Floats:
        """Return the best point along parameter `k`, at most a step from `best`."""

        def cost(x: float) -> float:
            return -self.at(_moved(best, k, x)).total

        ends = max(best[k] - step, bounds[0]), min(best[k] + step, bounds[1])
        found = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": _CLOSE})
        return _moved(best, k, float(found.x))

    def sigma(self, best: Floats, k: int, step: float = 0.1) -> float:
        """Return one standard deviation of the logarithm of parameter `k`, NaN where the likelihood is no hill."""
        below, here, above = (one.total for one in self.ask([_moved(best, k, best[k] + d) for d in (-step, 0, step)]))
        curvature = (below - 2 * here + above) / step**2
        return 1 / math.sqrt(-curvature) if curvature < 0 else math.nan


def _moved(point: Floats, k: int, x: float) -> Floats:
    moved = point.copy()
    moved[k] = x
    return moved


def _score(work: tuple[Paths, TrackingSettings]) -> Likelihood:
    return likelihood(*work)


def _sum(scores: Iterable[Likelihood]) -> Likelihood:
    return sum(scores, Likelihood(0.0, 0.0, 0))


def toml_of(tuned: Tuned) -> str:
    """Return the tuned values as lines of a TOML file; modes of an interacting model as a whole."""
    lines = []
    for name, number in zip(tuned.parameters, tuned.best, strict=True):
        if ".modes." not in name:
            lines.append(f"{name} = {number:g}")
    if len(lines) < len(tuned.parameters):
        modes = tree(tuned.settings)["motion"]["modes"]
        rows = ("    { " + ", ".join(f"{key} = {_toml(one)}" for key, one in mode.items()) + " }," for mode in modes)
        lines += ["tracking.motion.modes = [", *rows, "]"]
    return "\n".join(lines)


def _toml(one: Any) -> str:
    return f'"{one}"' if isinstance(one, str) else repr(one)
