"""One drive of a campaign as a row: what was drawn, what happened, what could have been done."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from rangecam.drive.bound import HARMLESS_MPS, bound_of
from rangecam.drive.campaigns.trial import Trial
from rangecam.drive.loop import drive
from rangecam.drive.result import Drive

COLUMNS: dict[str, type] = {
    "number": int,
    "seed": int,
    "group": str,
    "camera": str,
    "speed_mps": float,
    "target": str,
    "target_mps": float,
    "offset_m": float,
    "reflectivity": float,
    "friction": float,
    "light": str,
    "weather": str,
    "fault": str,
    "threat": bool,
    "unbraked_mps": float,
    "seen_s": float,
    "bound_mps": float,
    "avoidable": bool,
    "avoided": bool,
    "false_brake": bool,
    "braked_s": float,
    "by_fault": bool,
    "reason": str,
    "hit": str,
    "impact_mps": float,
    "least_gap_m": float,
    "stood_s": float,
    "exposed_s": float,
    "read_s": float,
    "decided_s": float,
    "obeyed_s": float,
    "bites_s": float,
    "full_s": float,
    "driven_s": float,
    "frames": int,
}
"""Columns of a campaign's table with their types.

threat: without brakes there is a collision, at `unbraked_mps`; seen_s: when the camera first shows enough of it;
bound_mps: impact of the ideal system; avoidable: below 1 km/h (`drive.bound`). avoided: no impact of 1 km/h or more.
false_brake: take-over without a threat or a fault that was injected. The times of the latency are those of
`drive.result.Latency`. NaN: does not apply; inf: never.
"""


def row_of(number: int, trial: Trial) -> dict[str, Any]:
    """Return the row of one drive; it holds no time of day, so that it is the same wherever it is driven."""
    result = drive(trial.scenario, trial.config, trial.settings, trial.seed)
    bound = bound_of(trial.scenario, trial.config, trial.settings, trial.seed)
    avoided = bound.threat and (not result.hit or result.impact_mps < HARMLESS_MPS)
    takes_over = math.isfinite(result.braked_s)
    return {
        "number": number,
        "seed": trial.seed,
        **dataclasses.asdict(trial.drawn),
        "threat": bound.threat,
        "unbraked_mps": bound.unbraked_mps,
        "seen_s": bound.seen_s,
        "bound_mps": bound.braked_mps,
        "avoidable": bound.avoidable,
        "avoided": avoided,
        "false_brake": takes_over and not bound.threat and not trial.drawn.fault,
        "braked_s": result.braked_s,
        "by_fault": result.by_fault,
        "reason": result.reason,
        "hit": result.hit,
        "impact_mps": result.impact_mps,
        "least_gap_m": result.least_gap_m,
        "stood_s": result.stood_s,
        **_latency(result),
        "driven_s": result.duration_s + trial.settings.run_in_s,
        "frames": result.frames,
    }


def _latency(result: Drive) -> dict[str, float]:
    return {name: float(number) for name, number in vars(result.latency).items()}


def failed(row: Mapping[str, Any]) -> bool:
    """Return whether a drive needs a look: a collision that could have been avoided, or braking without a reason."""
    return bool((row["avoidable"] and not row["avoided"]) or row["false_brake"])


def badness(row: Mapping[str, Any]) -> float:
    """Return by how much a drive failed: speed of the impact beyond the bound, or that of braking without a reason."""
    if row["false_brake"]:
        return float(row["speed_mps"])
    return float(row["impact_mps"] - row["bound_mps"]) if row["threat"] else 0.0
