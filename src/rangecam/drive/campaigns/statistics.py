"""What the rows of a campaign come to: shares and rates with exact intervals, by group and by speed."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import beta, chi2

from rangecam.drive.campaigns.row import badness, failed
from rangecam.drive.result import plain
from rangecam.types import Floats

Rows = Sequence[Mapping[str, Any]]
_WORST = 20


class Interval(NamedTuple):
    """A value and the ends of its confidence interval."""

    value: float
    low: float
    high: float


def rate(count: int, amount: float, confidence: float = 0.95) -> Interval:
    """Return events for each unit of `amount` with the exact interval of a Poisson process (Garwood 1936)."""
    if amount <= 0:
        return Interval(math.nan, math.nan, math.nan)
    tail = (1 - confidence) / 2
    low = float(chi2.ppf(tail, 2 * count)) / 2 if count else 0.0
    return Interval(count / amount, low / amount, float(chi2.ppf(1 - tail, 2 * count + 2)) / 2 / amount)


def share(count: int, of: int, confidence: float = 0.95) -> Interval:
    """Return a share with the exact interval of Clopper and Pearson (1934)."""
    if not of:
        return Interval(math.nan, math.nan, math.nan)
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(1 - tail, count + 1, of - count)) if count < of else 1.0
    return Interval(count / of, low, high)


class Group(NamedTuple):
    """What the drives of one group came to; speeds avoided are means over its threats, of those possible."""

    name: str
    runs: int
    threats: int
    avoidable: int
    avoided_of_avoidable: int
    avoided: int
    false_brakes: int
    hours: float
    speed_taken: float
    """Speed of impact taken away, over that without brakes, in the mean."""
    speed_possible: float
    """The same of the ideal system."""


def group_of(name: str, rows: Rows) -> Group:
    """Return what these rows come to."""
    threats = [row for row in rows if row["threat"]]
    avoidable = [row for row in threats if row["avoidable"]]
    taken = [1 - min(row["impact_mps"] / row["unbraked_mps"], 1.0) for row in threats]
    possible = [1 - min(row["bound_mps"] / row["unbraked_mps"], 1.0) for row in threats]
    return Group(
        name,
        len(rows),
        len(threats),
        len(avoidable),
        sum(bool(row["avoided"]) for row in avoidable),
        sum(bool(row["avoided"]) for row in threats),
        sum(bool(row["false_brake"]) for row in rows),
        sum(float(row["driven_s"]) for row in rows) / 3600,
        float(np.mean(taken)) if taken else math.nan,
        float(np.mean(possible)) if possible else math.nan,
    )


def groups(rows: Rows, *keys: str) -> list[Group]:
    """Return the groups of rows that agree in `keys`, by name."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(", ".join(str(row[key]) for key in keys), []).append(row)
    return [group_of(name, found[name]) for name in sorted(found)]


def worst(rows: Rows, most: int = _WORST) -> list[Mapping[str, Any]]:
    """Return the drives that failed, the worst first."""
    return sorted((row for row in rows if failed(row)), key=lambda row: (-badness(row), row["number"]))[:most]


def summary(rows: Rows) -> dict[str, Any]:
    """Return the numbers of `rangecam drive CAMPAIGN --json`.

    collisions: impacts of 1 km/h or more; hours: of simulated driving; false_brakes_per_hour with its interval of 95 %.
    """
    all_ = group_of("all", rows)
    false_rate = rate(all_.false_brakes, all_.hours)
    return {
        "runs": all_.runs,
        "threats": all_.threats,
        "avoidable": all_.avoidable,
        "avoided": all_.avoided_of_avoidable,
        "avoided_beyond": all_.avoided - all_.avoided_of_avoidable,
        "collisions": all_.threats - all_.avoided,
        "false_brakes": all_.false_brakes,
        "hours": round(all_.hours, 6),
        "false_brakes_per_hour": [plain(v) for v in false_rate],
        "worst": [_told(row) for row in worst(rows)],
    }


_TOLD = ("number", "group", "camera", "speed_mps", "impact_mps", "bound_mps", "false_brake", "fault", "reason")


def _told(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: plain(row[key]) if isinstance(row[key], float) else row[key] for key in _TOLD}


def finite(rows: Iterable[Mapping[str, Any]], one: str, other: str) -> Floats:
    """Return the differences other - one of two columns where both are known."""
    values = np.array([float(row[other]) - float(row[one]) for row in rows])
    known: Floats = values[np.isfinite(values)]
    return known
