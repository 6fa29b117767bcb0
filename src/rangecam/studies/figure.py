"""The figure of a study as a PNG; no global state of Matplotlib is touched."""

import io

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rangecam.report.figures import PALETTE, STYLE
from rangecam.studies.study import Panel, Picture, Study

_MANY = 6
"""So many series have no place for their legend beside them."""


@matplotlib.rc_context(STYLE)
def draw(study: Study) -> bytes:
    """Return the figure of a study as a PNG: panels side by side, error bars of two standard deviations."""
    count = len(study.panels)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(max(7.5, 4.9 * columns), 3.9 * rows + 0.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{study.name}: {study.section}", fontsize=10)
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for ax, panel in zip(axes, study.panels, strict=False):
        if panel.picture is not None:
            _draw_picture(figure, ax, panel.picture)
        _draw_panel(ax, panel)
    for ax in axes[count:]:
        ax.set_visible(False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _draw_picture(figure: Figure, ax: Axes, picture: Picture) -> None:
    low, high = picture.limits
    drawn = ax.imshow(np.asarray(picture.values), cmap="turbo_r", vmin=low, vmax=high, interpolation="nearest")
    figure.colorbar(drawn, ax=ax, fraction=0.046, pad=0.02, shrink=0.7, label=picture.label)


def _draw_panel(ax: Axes, panel: Panel) -> None:
    for number, one in enumerate(panel.series):
        colour = PALETTE[(number if one.colour is None else one.colour) % len(PALETTE)]
        label = one.label or None
        if one.sigma is None:
            ax.plot(one.x, one.y, one.line, color=colour, linewidth=1.4, markersize=4, label=label)
        else:
            two_sigma = 2 * np.asarray(one.sigma)
            ax.errorbar(one.x, one.y, two_sigma, fmt="o", color=colour, markersize=3, capsize=2, label=label)
    ax.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
    for name in panel.log:
        getattr(ax, f"set_{name}scale")("log")
    ax.grid(visible=panel.picture is None)
    labels = sum(bool(one.label) for one in panel.series)
    if labels >= _MANY:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    elif labels:
        ax.legend(loc="best", fontsize=8)
