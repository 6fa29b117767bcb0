"""The page of one drive: what happened over time, in one HTML file that opens offline."""

import io

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rangecam.brake.machine import Mode
from rangecam.drive.result import Drive, describe
from rangecam.report.figures import INK, MUTED, PALETTE, RED, STYLE
from rangecam.report.template import page, section


def html(drive: Drive, description: str) -> bytes:
    """Return the page of a drive."""
    text = (
        "Speed over ground, of the wheels, and as the bus reports it (a wheel that has locked tells nothing of it); "
        "true gap to the nearest thing beside the free way that perception saw; who drives, and how far the brakes are "
        "applied. Red: the vehicle obeys the bus."
    )
    parts = [section("The drive over time", text, timeline(drive), "\n".join(_budget(drive)))]
    return page(f"Drive: {drive.scenario}", description, describe(drive), parts).encode("utf-8")


def _budget(drive: Drive) -> list[str]:
    return [f"{name.removesuffix('_s'):9} {number:9.3f} s" for name, number in vars(drive.latency).items()]


@matplotlib.rc_context(STYLE)
def timeline(drive: Drive) -> bytes:
    """Draw speeds, distances, and modes of a drive as a PNG."""
    t = drive.timeline
    time = t["time_s"]
    figure = Figure(figsize=(8.5, 7.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    speeds, ways, modes = figure.subplots(3, 1, sharex=True)
    for name, label, colour in (
        ("speed_mps", "over ground", INK),
        ("wheel_mps", "of the wheels", PALETTE[1]),
        ("measured_mps", "as reported", PALETTE[0]),
    ):
        speeds.plot(time, 3.6 * t[name], color=colour, label=label, linewidth=1.3)
    speeds.set(title="Speed", ylabel="km/h")
    ways.plot(time, t["gap_m"], color=INK, label="true gap", linewidth=1.3)
    ways.plot(time, t["seen_m"], ".", color=PALETTE[0], label="free way that is seen", markersize=3)
    ways.set(title="Distance", ylabel="m", ylim=(0, None))
    modes.step(time, t["mode"], color=INK, label="mode of the brake", where="post", linewidth=1.3)
    modes.plot(time, t["brake"], color=RED, label="brakes applied", linewidth=1.3)
    modes.step(time, t["demand"], color=MUTED, label="decision demands braking", where="post", linewidth=0.8)
    modes.set(title="Who drives", xlabel="time (s)", ylim=(-0.1, 2.3))
    modes.set_yticks([int(mode) for mode in Mode], [mode.name.lower().replace("_", " ") for mode in Mode])
    for ax in (speeds, ways, modes):
        ax.fill_between(
            time, 0, 1, where=t["bus_control"] > 0, transform=ax.get_xaxis_transform(), color=RED, alpha=0.1
        )
        if np.isfinite(drive.hit_s):
            ax.axvline(drive.hit_s, color=RED, linestyle="--", linewidth=1)
        ax.grid(visible=True)
        ax.legend(loc="best", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
