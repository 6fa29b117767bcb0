"""What a drive came to: a timeline, its outcome, and the way from light to brake."""

import math
from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from rangecam.types import Floats
from rangecam.values import value

COLUMNS = (
    "time_s",
    "x_m",
    "y_m",
    "speed_mps",
    "wheel_mps",
    "measured_mps",
    "gap_m",
    "seen_m",
    "demand",
    "mode",
    "bus_control",
    "brake",
    "take_overs",
)
"""Columns of a timeline: time; true position, speed, speed of the wheels; speed as reported on the bus; true gap to the
nearest thing that counts; free way that the newest decision saw (NaN: none); whether it demands braking; mode of the
state machine; whether the vehicle obeys the bus; how far the brakes are applied; take-overs sent so far."""


@value
class Latency:
    """The way from light to brake of the first take-over, seconds of simulated time; NaN where it did not come so far.

    exposed_s: start of the exposure whose decision it was (of a fault: NaN); read_s: its last read-out; decided_s: the
    decision was made; obeyed_s: the control unit had it; bites_s: first effect of the brakes; full_s: they are fully
    applied.
    """

    exposed_s: float = math.nan
    read_s: float = math.nan
    decided_s: float = math.nan
    obeyed_s: float = math.nan
    bites_s: float = math.nan
    full_s: float = math.nan

    @property
    def total_s(self) -> float:
        """From the start of the exposure to the first effect."""
        return self.bites_s - self.exposed_s


@value
class Drive:
    """One drive.

    timeline: arrays (N,) by the names of `COLUMNS`. hit, impact_mps, hit_s: name of what was hit ("" for nothing), how
    fast, when. least_gap_m: smallest true gap, 0 after a contact. braked_s: first take-over (inf: never), for `reason`;
    by_fault: that was a fault of the system and no object. stood_s: standstill after it. frames: that were perceived.
    refused: take-overs that the gate refused, by reason. frames_on_bus: by identifier.
    friction, friction_sigma: what the stops have shown of it and its standard deviation, NaN where they showed nothing.
    """

    scenario: str
    timeline: Mapping[str, Floats]
    latency: Latency
    hit: str = ""
    impact_mps: float = 0.0
    hit_s: float = math.inf
    least_gap_m: float = math.inf
    braked_s: float = math.inf
    reason: str = ""
    by_fault: bool = False
    stood_s: float = math.inf
    frames: int = 0
    duration_s: float = 0.0
    refused: Mapping[str, int] = field(default_factory=dict)
    frames_on_bus: Mapping[int, int] = field(default_factory=dict)
    friction: float = math.nan
    friction_sigma: float = math.nan


def as_json(drive: Drive) -> dict[str, Any]:
    """Return a drive with its timeline as JSON values; None where a number is not known."""
    latency = {name: plain(number) for name, number in vars(drive.latency).items()}
    return {
        "scenario": drive.scenario,
        "duration_s": plain(drive.duration_s),
        "frames": drive.frames,
        "braked_s": plain(drive.braked_s),
        "reason": drive.reason,
        "by_fault": drive.by_fault,
        "stood_s": plain(drive.stood_s),
        "hit": drive.hit or None,
        "impact_kmh": plain(3.6 * drive.impact_mps),
        "least_gap_m": plain(drive.least_gap_m),
        "latency": {**latency, "total_s": plain(drive.latency.total_s)},
        "friction": plain(drive.friction),
        "friction_sigma": plain(drive.friction_sigma),
        "refused": dict(drive.refused),
        "bus": {f"0x{number:02X}": count for number, count in sorted(drive.frames_on_bus.items())},
        "timeline": {name: [plain(float(v)) for v in column] for name, column in drive.timeline.items()},
    }


def plain(number: float) -> float | None:
    """Return a number as JSON has it: six digits, None for what is no number."""
    return round(float(number), 6) if np.isfinite(number) else None


def describe(drive: Drive) -> str:
    """Return the outcome as lines for people."""
    t = drive.timeline
    lines = [
        f"drive      {drive.scenario}, {drive.duration_s:.2f} s, {drive.frames} frames",
        f"speed      {3.6 * float(t['speed_mps'][0]):.1f} km/h at the start, "
        f"{3.6 * float(t['speed_mps'][-1]):.1f} km/h at the end",
    ]
    if math.isfinite(drive.braked_s):
        lines.append(f"take-over  at {drive.braked_s:.3f} s: {drive.reason}")
    else:
        lines.append("take-over  none")
    if math.isfinite(drive.latency.total_s):
        lines.append(f"latency    {1000 * drive.latency.total_s:.0f} ms from exposure to first effect of the brakes")
    if math.isfinite(drive.stood_s):
        lines.append(f"standstill at {drive.stood_s:.3f} s")
    if math.isfinite(drive.friction):
        lines.append(f"friction   {drive.friction:.2f} +- {drive.friction_sigma:.2f}, by how it stopped")
    if drive.hit:
        lines.append(f"collision  with {drive.hit} at {drive.hit_s:.3f} s, {3.6 * drive.impact_mps:.1f} km/h")
    else:
        lines.append(f"collision  none, least gap {drive.least_gap_m:.2f} m")
    lines += [f"refused    {count} take-overs: {why}" for why, count in drive.refused.items()]
    return "\n".join(lines)
