"""`rangecam tune`: the process noise that a recording or a scenario speaks for."""

import json as json_format
import math
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from rangecam.cli.app import ConfigFile, Json, Preset, Seed, Set, app
from rangecam.cli.running import progress
from rangecam.errors import UsageError

if TYPE_CHECKING:
    from rangecam.tuning import Paths, Tuned

Names = Annotated[
    list[str],
    Parameter(
        name="--parameter",
        negative=(),
        show_default=False,
        help="What to tune, such as tracking.motion.drift_mps2; twice for two. Otherwise the model's process noise.",
    ),
]
Jobs = Annotated[
    int | None, Parameter(help="Processes to work in; otherwise one a source, as many as there are cores.")
]
Scheduler = Annotated[
    str | None, Parameter(help="Address of a Dask scheduler to work for us, such as tcp://host:8786.")
]


@app.command
def tune(
    *sources: str,
    parameter: Names = [],  # noqa: B006 (cyclopts reads the default, nobody changes it)
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    seed: Seed = 0,
    low: Annotated[float, Parameter(help="Smallest value to try.")] = 0.01,
    high: Annotated[float, Parameter(help="Largest value to try.")] = 100.0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    figure: Annotated[Path | None, Parameter(help="Draw the likelihood of what was tried (.png).")] = None,
    json: Json = False,
) -> None:
    """Find the process noise that makes what was seen in SOURCES (recordings, scenarios) most likely."""
    from rangecam import tuning
    from rangecam.config import overrides, read_toml
    from rangecam.io.files import check_target, replacing

    if not sources:
        raise UsageError("tune needs a source: a recording (.mcap, .npz) or scenario:NAME; several count together")
    target = None if figure is None else check_target(figure)
    layers = [*([read_toml(config)] if config else []), overrides(set_)]
    with tuning.workers(_cores(len(sources)) if jobs is None else jobs, scheduler) as executor:
        follow, search = (tuning.mapping(executor, partial(_watch, what)) for what in ("sources", "values"))
        paths = tuning.follow_all(sources, preset, layers, seed, follow)
        for note in (note for one in paths for note in one.notes):
            print(f"rangecam: note: {note}", file=sys.stderr)
        tuned = tuning.tune(paths, parameter, low, high, search)
    if target is not None:
        with replacing(target) as part:
            part.write_bytes(_figure(tuned, paths))
    print(json_format.dumps(_result(tuned, paths), allow_nan=False) if json else _describe(tuned, paths))
    if target is not None and not json:
        print(f"figure     {target}")


def _watch(what: str, items: Any, total: int) -> Any:
    """Show progress of batches that are worth it."""
    return progress(items, total, what) if total > _FEW else items


_FEW = 3


def _cores(most: int) -> int:
    import os

    return min(most, os.cpu_count() or 1)


def _result(tuned: "Tuned", paths: "list[Paths]") -> dict[str, Any]:
    from rangecam.tuning import toml_of

    columns = tuned.parameters, tuned.before, tuned.best, tuned.sigma, tuned.at_edge
    keys = "name", "before", "tuned", "sigma_relative", "at_edge"
    return {
        "sources": [{"name": one.name, "tracks": one.count} for one in paths],
        "measurements": tuned.new.measurements,
        "parameters": [_plain(dict(zip(keys, row, strict=True))) for row in zip(*columns, strict=True)],
        "log_likelihood": _plain({"before": tuned.old.total, "tuned": tuned.new.total}),
        "nis": _plain({"before": _nis(tuned.old), "tuned": _nis(tuned.new)}),
        "grid": [_plain({"values": list(values), "log_likelihood": total}) for values, total in tuned.grid],
        "toml": toml_of(tuned),
    }


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in values.items()}


def _nis(score: Any) -> float:
    """Return the mean NIS over its degrees of freedom: 1 where the innovations are as large as they should be."""
    return float(score.nis / (3 * score.measurements)) if score.measurements else math.nan


def _describe(tuned: "Tuned", paths: "list[Paths]") -> str:
    from rangecam.summary import count
    from rangecam.tuning import toml_of

    lines = [f"{one.name}: {count(one.count, 'confirmed track')}" for one in paths]
    lines.append(f"measured   {tuned.new.measurements} times after the first of each track")
    for name, before, now, sigma, edge in zip(
        tuned.parameters, tuned.before, tuned.best, tuned.sigma, tuned.at_edge, strict=True
    ):
        certain = "at the edge of the range tried" if edge else f"+- {100 * sigma:.0f} %, if the motion model holds"
        was = "one each" if math.isnan(before) else f"{before:g}"
        lines.append(f"{name}: {was} -> {now:g} ({certain})")
    each = [score.total / max(score.measurements, 1) for score in (tuned.old, tuned.new)]
    lines.append(f"likelihood {each[0]:.4g} -> {each[1]:.4g} (logarithm, a measurement)")
    lines.append(f"NIS        {_nis(tuned.old):.2f} -> {_nis(tuned.new):.2f} (1: errors are as large as sigma says)")
    return "\n".join([*lines, "", toml_of(tuned)])


def _figure(tuned: "Tuned", paths: "list[Paths]") -> bytes:
    """Return how far the log-likelihood is below its maximum over each parameter, with the best of the other."""
    from rangecam.studies import Panel, Series, Study, draw

    panels = []
    for k, name in enumerate(tuned.parameters):
        profile: dict[float, float] = {}
        for values, total in tuned.grid:
            profile[values[k]] = max(profile.get(values[k], -math.inf), total)
        points = [
            (x, (tuned.new.total - y) / tuned.new.measurements) for x, y in sorted(profile.items()) if math.isfinite(y)
        ]
        x, y = zip(*sorted([*points, (tuned.best[k], 0.0)]), strict=True)
        series = [
            Series("", x, y, line="o-"),
            Series(f"most likely: {tuned.best[k]:g}", [tuned.best[k]], [0.0], line="D"),
        ]
        panels.append(Panel("log-likelihood below its maximum", name, "difference, a measurement", series, log="x"))
    return draw(Study("tune", ", ".join(one.name for one in paths), [], panels))
