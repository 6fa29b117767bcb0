"""The pictures of a campaign; PNG bytes, no global state of Matplotlib touched."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rangecam.drive.campaigns.statistics import Rows, finite, rate
from rangecam.report.figures import INK, MUTED, PALETTE, RED, STYLE

_BINS = 10
STAGES = (
    ("exposed_s", "read_s", "exposure and read-out"),
    ("read_s", "decided_s", "processing, until the decision"),
    ("decided_s", "obeyed_s", "bus, until the vehicle obeys"),
    ("obeyed_s", "bites_s", "brakes, until the first effect"),
    ("bites_s", "full_s", "brakes, until full force"),
)
"""Steps from light to brake: columns of begin and end, and what it is."""


@matplotlib.rc_context(STYLE)
def avoided(rows: Rows) -> bytes:
    """Draw speed of impact over own speed, with and without brakes, beside what is possible; one panel a camera."""
    cameras = sorted({row["camera"] for row in rows})
    figure, axes = _panels(len(cameras))
    for ax, camera in zip(axes, cameras, strict=True):
        threats = [row for row in rows if row["threat"] and row["camera"] == camera]
        if threats:
            _speeds(ax, threats)
        ax.set(title=f"{camera}: {len(threats)} threats", xlabel="own speed (km/h)", ylabel="speed of impact (km/h)")
        ax.grid(visible=True)
    return _png(figure)


def _speeds(ax: Axes, threats: Sequence[Mapping[str, Any]]) -> None:
    speed = 3.6 * np.array([row["speed_mps"] for row in threats])
    edges = np.linspace(speed.min(), speed.max() + 1e-9, _BINS + 1)
    which = np.digitize(speed, edges[1:-1])
    curves = (
        ("unbraked_mps", "without brakes", MUTED, "--"),
        ("bound_mps", "physically possible", PALETTE[2], "-"),
        ("impact_mps", "driven", PALETTE[0], "-"),
    )
    for column, label, colour, line in curves:
        value = 3.6 * np.array([row[column] for row in threats])
        middle = [speed[which == k].mean() for k in range(_BINS) if np.any(which == k)]
        mean = [value[which == k].mean() for k in range(_BINS) if np.any(which == k)]
        ax.plot(middle, mean, line, color=colour, label=f"{label} (mean)", linewidth=1.6)
        if column == "impact_mps":
            ax.plot(speed, value, ".", color=colour, markersize=3, alpha=0.4)
    late = [k for k, row in enumerate(threats) if row["avoidable"] and not row["avoided"]]
    impact = 3.6 * np.array([row["impact_mps"] for row in threats])
    ax.plot(speed[late], impact[late], "x", color=RED, markersize=6, label="could have been avoided")
    ax.legend(loc="upper left", fontsize=8)


@matplotlib.rc_context(STYLE)
def latency(rows: Rows) -> bytes:
    """Draw how long each step from light to brake took: mean, and the range that holds 90 %."""
    figure, (ax,) = _panels(1)
    begins, names = 0.0, list[str]()
    for number, (one, other, name) in enumerate(STAGES):
        took = 1000 * finite(rows, one, other)
        if took.size:
            ax.barh(len(names), took.mean(), left=begins, color=PALETTE[number], height=0.6)
            low, high = np.percentile(took, [5, 95])
            ax.plot([begins + low, begins + high], [len(names)] * 2, color=INK, linewidth=1)
            begins += took.mean()
            names.append(name)
    ax.set(title="From light to brake", xlabel="time from the start of the exposure (ms)")
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    return _png(figure)


@matplotlib.rc_context(STYLE)
def false_brakes(rows: Rows) -> bytes:
    """Draw false brakes an hour for each group with their exact intervals of 95 %."""
    names = sorted({f"{row['group']}, {row['camera']}" for row in rows})
    figure, (ax,) = _panels(1)
    for k, name in enumerate(names):
        own = [row for row in rows if f"{row['group']}, {row['camera']}" == name]
        found = rate(sum(bool(row["false_brake"]) for row in own), sum(row["driven_s"] for row in own) / 3600)
        ax.plot([found.low, found.high], [k, k], color=PALETTE[0], linewidth=2)
        ax.plot(found.value, k, "o", color=RED if found.value else PALETTE[2], markersize=5)
    ax.set_yticks(range(len(names)), names)
    ax.set(title="False brakes an hour, with intervals of 95 %", xlabel="false brakes an hour", xlim=(0, None))
    ax.grid(visible=True, axis="x")
    ax.invert_yaxis()
    return _png(figure)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(max(8.5, 5.2 * count), 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(np.atleast_1d(figure.subplots(1, count)))


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
