"""The pictures of a design, several designs laid over each other; PNG bytes, no global state of Matplotlib touched."""

import io
from collections.abc import Callable, Sequence
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator

from rangecam.design.analysis import Design
from rangecam.design.experiment import Point
from rangecam.design.statistics import Estimate
from rangecam.report.figures import INK, MUTED, PALETTE, RED, STYLE
from rangecam.types import Floats

_MARKS = ("o", "s", "^", "D")
_LINES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
_SEEN = 0.02
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
_FAINT = 0.3

Value = Callable[[Point], Estimate]


@matplotlib.rc_context(STYLE)
def accuracy(designs: Sequence[Design]) -> bytes:
    """Draw the error over the range in the centre and in the corners of the image, beside the target."""
    figure, axes = _panels(2)
    for ax, region in zip(axes, ("centre", "corners"), strict=True):
        for number, design in enumerate(designs):
            _draw(ax, design, number, region, lambda p: _scaled(p.error, 100 / p.range_m))
            if region == "centre":
                _curves(ax, design, number, lambda sigma_m, range_m: 100 * sigma_m / range_m)
            ax.axhline(100 * design.plan.accuracy, color=RED, linestyle="--", linewidth=1)
        ax.set(title=f"Error, {region} of the image", xlabel="range (m)", ylabel="root mean square error (% of range)")
        _in_view(ax, [100 * p.error.value / p.range_m for d in designs for p in d.points if p.valid.value >= _SEEN])
    _legend(axes[0], designs, "target")
    return _png(figure)


@matplotlib.rc_context(STYLE)
def spread_and_bias(designs: Sequence[Design]) -> bytes:
    """Draw the measured spread beside the sigma that the chain expects, and the bias, in the centre of the image."""
    figure, axes = _panels(2)
    for number, design in enumerate(designs):
        _draw(axes[0], design, number, "centre", lambda p: _scaled(p.spread, 100))
        _curves(axes[0], design, number, lambda sigma_m, _: 100 * sigma_m)
        _draw(axes[1], design, number, "centre", lambda p: _scaled(p.bias, 100))
    axes[0].set(title="Spread; lines: what the chain says of it", xlabel="range (m)", ylabel="standard deviation (cm)")
    _in_view(axes[0], [100 * p.spread.value for d in designs for p in d.points if p.valid.value >= _SEEN])
    axes[1].axhline(0, color=INK, linewidth=0.8)
    worth = [p for d in designs for p in d.points if p.region == "centre" and p.valid.value >= d.plan.valid]
    if worth:  # what noise leaves of nearly invalid targets would hide the others
        reach = 130 * max(max(abs(p.bias.low), abs(p.bias.high)) for p in worth)
        axes[1].set_ylim(-reach, reach)
    axes[1].set(title="Bias: mean error", xlabel="range (m)", ylabel="bias (cm)")
    _legend(axes[0], designs)
    return _png(figure)


@matplotlib.rc_context(STYLE)
def light(designs: Sequence[Design]) -> bytes:
    """Draw the valid part of the pixels, and of cameras that tell them accumulations and electrons."""
    points = [p for design in designs for p in design.points]
    counted = any(p.n_acc is not None for p in points)
    known = any(p.electrons is not None for p in points)
    figure, axes = _panels(1 + counted + known)
    free = iter(axes)
    ax = next(free)
    for number, design in enumerate(designs):
        _draw(ax, design, number, "centre", lambda p: _scaled(p.valid, 100), joined=True)
        ax.axhline(100 * design.plan.valid, color=RED, linestyle="--", linewidth=1)
    ax.set(title="Valid pixels, centre", xlabel="range (m)", ylabel="valid (%)", ylim=(-4, 104))
    _legend(ax, designs, "asked for")
    for shown, of, title in ((counted, _count, "Accumulations (mean)"), (known, _electrons, "Electrons of the light")):
        if shown:
            ax = next(free)
            for number, design in enumerate(designs):
                _draw(ax, design, number, "centre", of, joined=True)
            ax.set(title=title, xlabel="range (m)", yscale="log")
    return _png(figure)


def _count(point: Point) -> Estimate:
    value = float("nan") if point.n_acc is None else point.n_acc
    return Estimate(value, value, value)


def _electrons(point: Point) -> Estimate:
    value = float("nan") if point.electrons is None else max(point.electrons, 1e-3)
    return Estimate(value, value, value)


def _scaled(estimate: Estimate, factor: float) -> Estimate:
    return Estimate(estimate.value * factor, estimate.low * factor, estimate.high * factor)


def _draw(ax: Axes, design: Design, number: int, region: str, value: Value, joined: bool = False) -> None:
    """Draw a value of every point with its interval; faint where fewer pixels are valid than asked for.

    joined: also where hardly a pixel is valid, and with lines between the points.
    """
    for colour, rho in zip(PALETTE, design.plan.reflectivities, strict=False):
        points = [p for p in design.points if p.region == region and p.reflectivity == rho]
        points = [p for p in points if joined or p.valid.value >= _SEEN]
        if joined:
            ax.plot(
                [p.range_m for p in points], [value(p).value for p in points], _line(number), color=colour, linewidth=1
            )
        for faint in (False, True):
            kept = [p for p in points if (p.valid.value < design.plan.valid and not joined) == faint]
            found = [value(p) for p in kept]
            bars = np.array([[e.value - e.low for e in found], [e.high - e.value for e in found]])
            ax.errorbar(
                [p.range_m for p in kept],
                [e.value for e in found],
                bars,
                fmt=_MARKS[number % len(_MARKS)],
                color=colour,
                markersize=3.5,
                markerfacecolor=colour if number == 0 else "white",
                capsize=2,
                linewidth=1,
                alpha=_FAINT if faint else 1.0,
            )
    ax.grid(visible=True)


def _curves(ax: Axes, design: Design, number: int, scale: Callable[[Floats, Floats], Floats]) -> None:
    for colour, (range_m, sigma_m) in zip(PALETTE, design.curves.values(), strict=False):
        ax.plot(range_m, scale(sigma_m, range_m), _line(number), color=colour, linewidth=1.1, alpha=0.8)


def _line(number: int) -> Literal["-", "--", ":", "-."]:
    return _LINES[number % len(_LINES)]


def _in_view(ax: Axes, values: Sequence[float]) -> None:
    """Set a logarithmic axis to what was measured, so that what is expected of hopeless targets does not squash it."""
    seen = [value for value in values if np.isfinite(value) and value > 0]
    ax.set_yscale("log")
    for each, steps in ((ax.yaxis.set_major_locator, (1.0,)), (ax.yaxis.set_minor_locator, (2.0, 5.0))):
        each(LogLocator(subs=steps))
    ax.yaxis.set_major_formatter(_PLAIN)
    ax.yaxis.set_minor_formatter(_PLAIN)
    if seen:
        ax.set_ylim(0.6 * min(seen), 1.8 * max(seen))


def _legend(ax: Axes, designs: Sequence[Design], limit: str = "") -> None:
    rhos = list(dict.fromkeys(rho for design in designs for rho in design.plan.reflectivities))
    handles = [
        Line2D([], [], color=colour, marker="o", linestyle="", label=f"{100 * rho:g} %")
        for colour, rho in zip(PALETTE, rhos, strict=False)
    ]
    if len(designs) > 1:
        handles += [
            Line2D([], [], color=MUTED, marker=_MARKS[i % len(_MARKS)], linestyle=_line(i), label=design.name)
            for i, design in enumerate(designs)
        ]
    if limit:
        handles.append(Line2D([], [], color=RED, linestyle="--", label=limit))
    ax.legend(handles=handles, loc="best", fontsize=8)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(10.5, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(np.atleast_1d(figure.subplots(1, count)))


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
