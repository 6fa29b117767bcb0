"""What a campaign says: lines for people, and one HTML page that opens offline."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from rangecam.drive.campaigns import figures
from rangecam.drive.campaigns.statistics import Group, Rows, finite, groups, rate, share, summary, worst
from rangecam.report.template import page, section

LEADS = {
    "scaled-car": "The 1/5-scale car indoors, towards boxes, people, slow cars and things that cross, on floors of "
    "different grip; in one drive of ten something goes wrong. The brake reckons with a friction of 0.3.",
    "full-size": "A passenger car on dry asphalt in the scenarios of Euro NCAP, with the pulsed camera of König, the "
    "camera of Steinbäck, and one of four modulation frequencies, lit for 20 m, as of today.",
    "false-positives": "Driving past what nobody needs to brake for: bridges, parked cars, bends, rain, leaves, dust, "
    "a car ahead as fast as we are, reflectors beyond the unambiguous range.",
}


def describe(campaign: str, rows: Rows) -> str:
    """Return the numbers of a campaign as lines."""
    n = summary(rows)
    low, high = n["false_brakes_per_hour"][1:]
    lines = [
        f"campaign   {campaign}: {n['runs']} drives, {n['hours']:.3g} hours of driving",
        f"threats    {n['threats']}, of which {n['avoidable']} could be avoided",
        f"avoided    {n['avoided']} of those{_interval(n['avoided'], n['avoidable'])}, "
        f"{n['avoided_beyond']} beyond; {n['collisions']} collisions",
        f"false      {n['false_brakes']} brakes without a threat; {_or(low)} to {_or(high)} an hour (95 %)",
    ]
    return "\n".join([*lines, *(_worst(row) for row in worst(rows, 5))])


def _or(value: float | None) -> str:
    return "?" if value is None else f"{value:.3g}"


def _interval(count: int, of: int) -> str:
    found = share(count, of)
    return f" ({100 * found.value:.4g} %, interval {100 * found.low:.4g} to {100 * found.high:.4g} %)" if of else ""


def _worst(row: Mapping[str, Any]) -> str:
    what = "brakes without a threat" if row["false_brake"] else f"impact {3.6 * row['impact_mps']:.1f} km/h"
    fault = f", fault {row['fault']}" if row["fault"] else ""
    return (
        f"drive {row['number']:6}: {row['group']}, {row['camera']}, {3.6 * row['speed_mps']:.1f} km/h: {what}{fault}"
        + (f"; {row['reason']}" if row["reason"] else "")
    )


def html(campaign: str, rows: Rows, recordings: Sequence[str]) -> bytes:
    """Return the page of a campaign; recordings: files of the drives that failed, beside the page."""
    parts = []
    if any(row["threat"] for row in rows):
        parts.append(
            section(
                "Speed of impact",
                "Each dot is a drive. Physically possible: braking fully when the brake rule, told the truth, demands "
                "it for a target that the camera shows, with the latency of the system, on the true road. Beyond: "
                "avoided although that would not do.",
                figures.avoided(rows),
                "\n".join(_table(groups(rows, "group", "camera"))),
            )
        )
    if campaign == "full-size":
        parts.append(_words("A full-size car: what was concluded then, and what these drives say", _full_size(rows)))
    parts.append(
        section(
            "False brakes",
            "A take-over without a threat and without an injected fault; the intervals are those of a Poisson process.",
            figures.false_brakes(rows),
            "\n".join(_false(groups(rows, "group", "camera"))),
        )
    )
    if any(np.isfinite(row["exposed_s"]) for row in rows):
        parts.append(
            section(
                "From light to brake",
                "Of the first take-over of each drive; thin lines hold 90 %.",
                figures.latency(rows),
                "\n".join(_budget(rows)),
            )
        )
    failures = [_worst(row) for row in worst(rows, len(rows))] or ["none"]
    parts.append(
        _words(
            "Drives that failed",
            "Collisions that could have been avoided, and brakes without a reason. Those recorded open with "
            "rangecam run; rangecam drive repeats any of them by its number.",
            [*failures, *(f"recording {name}" for name in recordings)],
        )
    )
    return page(f"Campaign: {campaign}", LEADS[campaign], describe(campaign, rows), parts).encode("utf-8")


def _words(title: str, text: str, lines: Sequence[str] = ()) -> str:
    below = f"<pre>{escape(chr(10).join(lines))}</pre>" if lines else ""
    return f"<section><h2>{escape(title)}</h2><p>{escape(text)}</p>{below}</section>"


def _table(found: Sequence[Group]) -> list[str]:
    head = f"{'group':34} {'runs':>5} {'threats':>7} {'could be':>8} {'avoided':>7} {'share %':>8} {'beyond':>6} "
    lines = [head + f"{'speed taken %':>13} {'possible %':>10}"]
    for g in found:
        part = f"{100 * g.avoided_of_avoidable / g.avoidable:8.2f}" if g.avoidable else f"{'-':>8}"
        lines.append(
            f"{g.name:34} {g.runs:5} {g.threats:7} {g.avoidable:8} {g.avoided_of_avoidable:7} {part} "
            f"{g.avoided - g.avoided_of_avoidable:6} {100 * g.speed_taken:13.1f} {100 * g.speed_possible:10.1f}"
        )
    return lines


def _false(found: Sequence[Group]) -> list[str]:
    lines = [f"{'group':34} {'hours':>8} {'false':>6} {'an hour':>9} {'from':>9} {'to':>9}"]
    for g in found:
        r = rate(g.false_brakes, g.hours)
        lines.append(f"{g.name:34} {g.hours:8.3f} {g.false_brakes:6} {r.value:9.3g} {r.low:9.3g} {r.high:9.3g}")
    return lines


def _budget(rows: Rows) -> list[str]:
    lines = [f"{'step':34} {'mean ms':>8} {'5 %':>8} {'95 %':>8} {'most':>8}"]
    for one, other, name in (*figures.STAGES, ("exposed_s", "bites_s", "light to first effect")):
        took = 1000 * finite(rows, one, other)
        if took.size:
            low, high = np.percentile(took, [5, 95])
            lines.append(f"{name:34} {took.mean():8.1f} {low:8.1f} {high:8.1f} {took.max():8.1f}")
    return lines


def _full_size(rows: Rows) -> str:
    """Return the conclusion of the thesis beside ours, in numbers."""
    then = (
        "Steinbäck (2016, 6.1) found his camera good for about 5 m, enough for a slow model car and by far not for a "
        "real one at speed; direct sunlight drowned its light, so that it could not be used outdoors; he left it low "
        "speeds, such as reversing or parking, and hoped for sensors with more range and less trouble with the sun. "
    )
    return then + " ".join(_of_camera(camera, rows) for camera in sorted({row["camera"] for row in rows}))


def _of_camera(camera: str, rows: Rows) -> str:
    own = [row for row in rows if row["camera"] == camera and row["threat"]]
    if not own:
        return f"{camera}: no threat was driven."
    sunny = [row for row in own if row["light"] == "sun"]
    parts = [
        f"{camera}: of {len(own)} threats physics and camera allow {sum(r['avoidable'] for r in own)} to be avoided"
    ]
    parts.append(f"{sum(r['avoided'] for r in own)} were")
    if sunny:
        parts.append(f"in the sun {sum(r['avoidable'] for r in sunny)} of {len(sunny)} could be")
    still = [3.6 * row["speed_mps"] for row in own if row["avoided"] and row["target_mps"] == 0]
    if still:
        parts.append(f"before a standing car up to {max(still):.0f} km/h")
    return ", ".join(parts) + "."
