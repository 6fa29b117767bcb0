"""The pictures of the report. Each function returns a PNG as base64 text; no global state of Matplotlib is touched."""

import base64
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Ellipse, Patch, Rectangle

from rangecam.clean import clean_stages
from rangecam.config import Config
from rangecam.geometry import Lens, rays
from rangecam.summary import count
from rangecam.types import POSITION, Ego, Floats, Frame, Image, RangeImage, TrackStatus, Why

INVALID = "#d5dae1"
INK, MUTED, RED = "#1f2933", "#7b8794", "#d64545"
PALETTE = ("#2563eb", "#ea580c", "#16a34a", "#9333ea", "#0891b2", "#db2777", "#ca8a04", "#4f46e5", "#65a30d", "#be123c")
WHY_COLOURS = {
    Why.VALID: "#ffffff",
    Why.NO_SIGNAL: "#1f2933",
    Why.NOT_FINITE: "#dc2626",
    Why.LOW_AMPLITUDE: "#64748b",
    Why.SATURATED: "#f59e0b",
    Why.OUT_OF_RANGE: "#a16207",
    Why.WRAPPED: "#7c3aed",
    Why.SENSOR_FLAG: "#0e7490",
    Why.FLYING: "#db2777",
    Why.ISOLATED: "#fb7185",
    Why.FLOOR: "#86efac",
    Why.OUTSIDE_AREA: "#bfdbfe",
    Why.BORDER: "#94a3b8",
    Why.MOTION: "#2563eb",
    Why.MULTIPATH: "#15803d",
}
STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#e4e7eb",
    "legend.frameon": False,
}


class LifeOfAFrame:
    """A `step` for `process_frame` that keeps what went into each stage and what came out."""

    def __init__(self) -> None:
        self.arguments: dict[str, tuple[Any, ...]] = {}
        self.results: dict[str, Any] = {}

    def __call__(self, stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call `function` and keep arguments and result."""
        self.arguments[stage] = arguments
        self.results[stage] = result = function(*arguments)
        return result

    def before_cleaning(self) -> RangeImage:
        """Return the image straight after ranging."""
        image: RangeImage = self.results["ranging"]
        return image

    def points(self) -> Floats:
        """Return the points of the cleaned image: (H, W, 3) m."""
        points: Floats = self.results["geometry"]
        return points

    def cleaning(self) -> list[tuple[str, RangeImage]]:
        """Return (name, image) after each stage of cleaning."""
        return list(clean_stages(*self.arguments["clean"]))


@dataclass(frozen=True)
class Moment:
    """What the time line shows of one frame."""

    time_s: float
    brake: bool
    distance_m: float
    stopping_distance_m: float
    closing_speed_mps: float
    ego_speed_mps: float
    ttc_s: float
    ttc_sigma_s: float
    p_collision: float


def moment(frame: Frame, ego: Ego) -> Moment:
    """Return what the time line needs of one frame; unknown values are NaN."""
    d = frame.decision
    return Moment(
        time_s=d.time_s,
        brake=d.brake,
        distance_m=d.distance_m,
        stopping_distance_m=d.stopping_distance_m,
        closing_speed_mps=d.closing_speed_mps,
        ego_speed_mps=math.nan if ego.speed_mps is None else ego.speed_mps,
        ttc_s=d.ttc_s if math.isfinite(d.ttc_s) else math.nan,
        ttc_sigma_s=d.ttc_sigma_s,
        p_collision=d.p_collision,
    )


@matplotlib.rc_context(STYLE)
def images(ranged: RangeImage, cleaned: RangeImage, lens: Lens) -> str:
    """Draw amplitude, range and sigma as they came out of ranging, and why pixels were refused there or by cleaning."""
    aspect = _aspect(lens, ranged.shape)
    figure, axes = _grid(4, ranged.shape, aspect)
    finite = np.isfinite(ranged.amplitude)
    top = float(np.percentile(ranged.amplitude[finite], 99)) if finite.any() else 1.0
    title = "Amplitude" if finite.any() else "Amplitude: the camera gives none"
    _show(figure, axes[0], np.where(finite, ranged.amplitude, np.nan), title, aspect, "gray", (0.0, max(top, 1e-9)))
    _show(figure, axes[1], _masked(ranged.range_m, ranged), "Range (m)", aspect, "turbo_r", range_limits(ranged))
    _show(figure, axes[2], _masked(ranged.sigma_m * 1e3, ranged), "Standard deviation of range (mm)", aspect, "magma")
    _show_why(axes[3], cleaned, aspect)
    return _png(figure)


@matplotlib.rc_context(STYLE)
def life(stages: LifeOfAFrame, frame: Frame, config: Config) -> str:
    """Draw raw planes, the image after ranging and after every cleaning stage, and the segments with their boxes."""
    lens, shape = config.camera.lens, frame.image.shape
    aspect = _aspect(lens, shape)
    ranged, limits = stages.before_cleaning(), range_limits(stages.before_cleaning())
    planes = list(frame.raw.planes.items())[:4]
    cleaned = stages.cleaning()
    figure, axes = _grid(len(planes) + 1 + len(cleaned) + 2, shape, aspect)
    panel = iter(axes)
    for name, plane in planes:
        _show(figure, next(panel), np.asarray(plane, dtype=float), f"raw: {name}", aspect, "gray")
    _show(
        figure, next(panel), _masked(ranged.range_m, ranged), f"{config.ranging}: range (m)", aspect, "turbo_r", limits
    )
    before = ranged
    for name, image in cleaned:
        title = f"{name}: {_change(before, image)}"
        _show(figure, next(panel), _masked(image.range_m, image), title, aspect, "turbo_r", limits)
        before = image
    _show_segments(next(panel), frame, aspect)
    _show_histogram(next(panel), frame)
    return _png(figure)


@matplotlib.rc_context(STYLE)
def from_above(
    frame: Frame,
    stages: LifeOfAFrame,
    trails: Mapping[int, Sequence[tuple[float, float]]],
    classes: Mapping[int, str],
    config: Config,
) -> str:
    """Draw the points, segments and tracks of the frame and the trails of the run, seen from above."""
    figure = _figure(10.5, 5.4)
    ax = figure.add_subplot()
    points, valid = stages.points(), frame.image.valid
    now = {track.track_id: track for track in frame.tracks if track.status != TrackStatus.TENTATIVE}
    for label in range(int(frame.labels.max(initial=0)) + 1):
        chosen = valid & (frame.labels == label)
        colour = MUTED if label == 0 else PALETTE[(label - 1) % len(PALETTE)]
        ax.scatter(
            points[chosen][:, 0],
            points[chosen][:, 1],
            s=3,
            color=colour,
            alpha=0.25 if label == 0 else 0.6,
            linewidths=0,
        )
    for number, trail in trails.items():
        colour = PALETTE[number % len(PALETTE)]
        x, y = np.array(trail).T
        place = (float(x[-1]), float(y[-1]))
        ax.plot(x, y, "-", color=colour, linewidth=1.4, alpha=0.8)
        if number in now:
            place = (float(now[number].position_m[0]), float(now[number].position_m[1]))
            _ellipse(ax, now[number].position_m[:2], now[number].covariance[np.ix_(POSITION[:2], POSITION[:2])])
        name = f"#{number} {classes[number]}"
        ax.annotate(name, place, color=colour, weight="bold", xytext=(6, 8), textcoords="offset points")
    half = config.decision.corridor.width_m / 2
    for side in (-half, half):
        ax.axhline(side, color=MUTED, linestyle=(0, (4, 4)), linewidth=0.8)
    ax.plot(config.mounting.x_m, config.mounting.y_m, marker=">", markersize=11, color=INK, clip_on=False)
    ax.set(
        xlabel="x forward (m)",
        ylabel="y left (m)",
        aspect="equal",
        title=f"{frame.image.time_s:.2f} s; dashed: path of the vehicle",
    )
    ax.set_xlim(left=min(config.mounting.x_m, 0.0) - 0.02 * max(1.0, ax.get_xlim()[1]))
    ax.grid(visible=True)
    ratio = np.ptp(ax.get_ylim()) / np.ptp(ax.get_xlim())
    figure.set_size_inches(10.5, float(np.clip(10.2 * ratio + 0.9, 2.4, 8.0)))
    return _png(figure)


@matplotlib.rc_context(STYLE)
def timeline(moments: Sequence[Moment], margin: float) -> str:
    """Draw free way, speeds, time to collision and collision probability over time; braking is shaded.

    margin: the multiple of the stopping distance at which the rule begins to brake.
    """
    columns = {name: np.array([getattr(m, name) for m in moments]) for name in Moment.__dataclass_fields__}
    t = columns["time_s"]
    figure = _figure(10.5, 7.2)
    axes = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": [2, 1.4, 1.6, 1]})
    mark = "o" if len(moments) == 1 else ""
    axes[0].plot(t, columns["distance_m"], marker=mark, color=PALETTE[0], label="free way")
    axes[0].plot(t, columns["stopping_distance_m"], marker=mark, color=RED, label="stopping distance")
    limit = margin * columns["stopping_distance_m"]
    axes[0].plot(t, limit, linestyle=":", marker=mark, color=RED, label=f"{margin:g} times that: the rule brakes below")
    axes[0].set(ylabel="m", ylim=(0, None))
    axes[1].plot(t, columns["closing_speed_mps"], marker=mark, color=PALETTE[0], label="closing speed")
    if np.isfinite(columns["ego_speed_mps"]).any():
        axes[1].plot(t, columns["ego_speed_mps"], linestyle="--", marker=mark, color=INK, label="own speed")
    speeds = np.concatenate([columns["closing_speed_mps"], columns["ego_speed_mps"]])
    axes[1].set(ylabel="m/s", ylim=(0, 1.4 * speeds[np.isfinite(speeds)].max(initial=0.5)))
    ttc = np.where(columns["ttc_s"] <= 10, columns["ttc_s"], np.nan)  # later ones are no news
    spread = np.where(np.isfinite(ttc), 2 * columns["ttc_sigma_s"], np.nan)
    axes[2].fill_between(t, np.clip(ttc - spread, 0, None), ttc + spread, color=PALETTE[3], alpha=0.2, linewidth=0)
    axes[2].plot(t, ttc, marker=mark, color=PALETTE[3], label="time to collision, two standard deviations")
    seen = ttc[np.isfinite(ttc)]
    axes[2].set(ylabel="s", ylim=(0, 1.15 * seen.max() if seen.size else 1))
    axes[3].plot(t, columns["p_collision"], marker=mark, color=PALETTE[1], label="probability of a collision")
    axes[3].set(ylim=(-0.03, 1.03), xlabel="time (s)")
    for ax in axes:
        _shade(ax, t, columns["brake"])
        ax.grid(visible=True)
        ax.legend(loc="best")
    return _png(figure)


def range_limits(image: RangeImage) -> tuple[float, float]:
    """Return limits of a colour scale that hold 98 % of the valid ranges: m."""
    ranges = image.range_m[image.valid]
    if not ranges.size:
        return 0.0, 1.0
    low, high = np.percentile(ranges, [1, 99])
    return float(low), float(max(high, low + 0.05))


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=110, layout=ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.06))
    FigureCanvasAgg(figure)
    return figure


def _grid(panels: int, shape: tuple[int, int], aspect: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with at least `panels` axes, wide images in one column, others in two or three."""
    ratio = shape[0] * aspect / shape[1]
    columns = 2 if ratio < 0.45 or panels <= 4 else 3
    rows = -(-panels // columns)
    width = 10.5
    figure = _figure(width, rows * (width / columns * max(ratio, 0.25) * 0.86 + 0.5))
    axes = list(np.atleast_1d(figure.subplots(rows, columns)).ravel())
    for ax in axes[panels:]:
        ax.set_visible(False)
    return figure, axes


def _aspect(lens: Lens, shape: tuple[int, int]) -> float:
    """Return height over width of one pixel as the lens sees it."""
    ray = rays(lens, shape)
    row, column = shape[0] // 2, shape[1] // 2
    if min(shape) < 2:
        return 1.0
    down = np.linalg.norm(ray[row, column] - ray[row - 1, column])
    across = np.linalg.norm(ray[row, column] - ray[row, column - 1])
    return float(down / across)


def _masked(values: Image, image: RangeImage) -> Image:
    return np.where(image.valid, values, np.nan)


def _show(
    figure: Figure,
    ax: Axes,
    values: Image,
    title: str,
    aspect: float,
    colours: str,
    limits: tuple[float, float] | None = None,
) -> None:
    seen = values[np.isfinite(values)]
    low, high = limits or (tuple(np.percentile(seen, [1, 99])) if seen.size else (0.0, 1.0))
    colour_map = matplotlib.colormaps[colours].with_extremes(bad=INVALID)
    drawn = ax.imshow(values, cmap=colour_map, vmin=low, vmax=high, aspect=aspect, interpolation="nearest")
    figure.colorbar(drawn, ax=ax, fraction=0.046, pad=0.02)
    ax.set(title=title, xticks=[], yticks=[])


def _show_why(ax: Axes, image: RangeImage, aspect: float) -> None:
    colour_map = ListedColormap([WHY_COLOURS[why] for why in Why])
    ax.imshow(image.why, cmap=colour_map, vmin=-0.5, vmax=len(Why) - 0.5, aspect=aspect, interpolation="nearest")
    counts = np.bincount(image.why.ravel(), minlength=len(Why))
    present = [why for why in Why if counts[why]]
    patches = [Patch(facecolor=WHY_COLOURS[why], edgecolor=MUTED, label=_share(why, counts)) for why in present]
    ax.legend(handles=patches, loc="upper left", bbox_to_anchor=(0, -0.02), ncols=2, fontsize=8, borderaxespad=0)
    ax.set(title="Why a pixel is invalid", xticks=[], yticks=[])


def _share(why: Why, counts: Any) -> str:
    return f"{why.name.lower().replace('_', ' ')} {100 * counts[why] / counts.sum():.1f} %"


def _change(before: RangeImage, after: RangeImage) -> str:
    """Return in words what a stage of cleaning did."""
    lost = int(before.valid.sum()) - int(after.valid.sum())
    if lost:
        return f"{lost} pixels fewer"
    same = np.array_equal(before.range_m[after.valid], after.range_m[after.valid])
    return "no change" if same else "less noise"


def _show_histogram(ax: Axes, frame: Frame) -> None:
    """Draw how many valid pixels lie at which range, stacked by segment."""
    ranges = frame.image.range_m
    low, high = range_limits(frame.image)
    shown = [frame.image.valid & (frame.labels == label) for label in range(len(frame.segments) + 1)]
    colours = [MUTED, *(PALETTE[i % len(PALETTE)] for i in range(len(frame.segments)))]
    ax.hist([ranges[s] for s in shown], bins=60, range=(0.9 * low, 1.1 * high), stacked=True, color=colours)
    ax.set(title="pixels over range (m)", yticks=[])


def _show_segments(ax: Axes, frame: Frame, aspect: float) -> None:
    colours = np.array([matplotlib.colors.to_rgb(c) for c in PALETTE])
    picture = np.ones((*frame.labels.shape, 3)) * matplotlib.colors.to_rgb("#f0f2f5")
    inside = frame.labels > 0
    picture[inside] = colours[(frame.labels[inside] - 1) % len(PALETTE)]
    ax.imshow(picture, aspect=aspect, interpolation="nearest")
    largest = sorted(frame.segments, key=lambda segment: -segment.n_pixels)[:6]  # more would hide each other
    for segment in largest:
        top, left, bottom, right = segment.box
        ax.add_patch(
            Rectangle((left - 0.5, top - 0.5), right - left, bottom - top, fill=False, edgecolor=INK, linewidth=1)
        )
        ax.text(left, top - 1, f"{segment.range_m:.2f} m", fontsize=8, va="bottom")
    ax.set(title=count(len(frame.segments), "segment"), xticks=[], yticks=[])


def _ellipse(ax: Axes, centre: Floats, covariance: Floats) -> None:
    """Draw the two-sigma ellipse of a position in the plane."""
    values, vectors = np.linalg.eigh(covariance)
    width, height = 4 * np.sqrt(np.maximum(values, 0))  # two standard deviations to either side
    angle = math.degrees(math.atan2(vectors[1, 0], vectors[0, 0]))
    ax.add_patch(Ellipse((centre[0], centre[1]), width, height, angle=angle, fill=False, edgecolor=INK, linewidth=1.2))


def _shade(ax: Axes, times: Floats, braking: Image) -> None:
    if not braking.any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[0], braking.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        ax.axvspan(times[start], times[min(stop, len(times) - 1)], color=RED, alpha=0.13, linewidth=0)


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return base64.b64encode(buffer.getvalue()).decode("ascii")
