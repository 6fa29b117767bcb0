"""`rangecam embedded`: who computes what and when on a microcontroller, and how fast the camera may be."""

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from rangecam.cli.app import Json, Seed, app

if TYPE_CHECKING:
    from rangecam.embedded import Schedule


@app.command
def embedded(
    schedule: str = "thesis",
    /,
    *,
    measure: Annotated[
        str | None, Parameter(help="Take the times of the stages from running this source here, with its own settings.")
    ] = None,
    share: Annotated[
        bool, Parameter(negative=(), show_default=False, help="Share the stages evenly, without debug data.")
    ] = False,
    frame_rate: Annotated[float | None, Parameter(help="Frames a second, instead of the schedule's.")] = None,
    frames: Annotated[int, Parameter(help="Frames to simulate.")] = 100,
    random: Annotated[
        bool, Parameter(negative=(), show_default=False, help="Draw the times of tasks instead of taking the longest.")
    ] = False,
    seed: Seed = 0,
    trace: Annotated[Path | None, Parameter(help="Write the timeline for ui.perfetto.dev (.json).")] = None,
    json: Json = False,
) -> None:
    """Simulate SCHEDULE, a name or a file (.toml): load, latency, deadlines, highest frame rate, memory."""
    from dataclasses import replace

    import numpy as np

    from rangecam.embedded import load_schedule, run_schedule
    from rangecam.embedded.measured import with_measured_stages
    from rangecam.embedded.memory import placements
    from rangecam.embedded.partition import repartitioned
    from rangecam.embedded.results import as_json
    from rangecam.embedded.settings import checked
    from rangecam.embedded.trace import trace_events
    from rangecam.errors import UsageError
    from rangecam.io.files import check_target, replacing

    if frames < 1:
        raise UsageError(f"--frames {frames}: expected one or more")
    if trace is not None:
        check_target(trace)
    chosen = load_schedule(schedule)
    if measure is not None:
        chosen = with_measured_stages(chosen, _stage_seconds(measure, seed))
    if share:
        chosen = repartitioned(chosen)
    if frame_rate is not None:
        if not frame_rate > 0:
            raise UsageError(f"--frame-rate {frame_rate:g}: expected a number above zero")
        chosen = checked(replace(chosen, frame_rate_hz=frame_rate))
    timeline = run_schedule(chosen, frames, np.random.default_rng(seed) if random else None)
    result = as_json(timeline, placements(chosen))
    if trace is not None:
        with replacing(trace) as part:
            part.write_text(json_format.dumps(trace_events(timeline)), encoding="utf-8")
    print(json_format.dumps(result) if json else describe(chosen, result))
    if trace is not None and not json:
        print(f"trace      {trace} (open it at ui.perfetto.dev or chrome://tracing)")


def _stage_seconds(source: str, seed: int) -> dict[str, list[float]]:
    """Return how long each stage took for each frame of a source, once its kernels are compiled."""
    from rangecam import pipeline
    from rangecam.cli.running import open_with_notes, progress, warmed_up
    from rangecam.summary import Stopwatch

    opened, watch = open_with_notes(source, None, None, [], seed), Stopwatch()
    for _ in pipeline.run(progress(warmed_up(opened, pipeline), opened.n_frames), opened.config, (), watch):
        pass
    return watch.seconds


def describe(schedule: "Schedule", result: dict[str, Any]) -> str:
    """Return the analysis as lines for people."""
    latency = result["latency_ms"]
    lines = [
        f"{schedule.name}: {schedule.description}",
        f"frames     {result['frames']} at {result['frame_rate_hz']:g} a second, {result['lost_frames']} lost",
    ]
    for unit, load in result["units"].items():
        lines.append(f"CPU {unit}      {100 * load:5.1f} % busy")
        for name, task in result["tasks"].items():
            if str(task["unit"]) == unit:
                late = f", {task['missed']} late" if task["missed"] else ""
                skipped = f", {task['skipped']} skipped" if task["skipped"] else ""
                lines.append(f"             {100 * task['load']:5.1f} % {name}{late}{skipped}")
    if latency["mean"] is not None:
        span = f"({latency['min']:.2f} to {latency['max']:.2f})"
        lines.append(f"latency    {latency['mean']:.2f} ms from exposure to decision {span}")
    lines.append(
        f"limit      {result['highest_frame_rate_hz']:.1f} frames a second with all deadlines met "
        f"(no schedule of these tasks exceeds {result['bound_hz']:.1f})"
    )
    for row in result["memory"]:
        if row["used_bytes"]:
            verdict = "" if row["fits"] else "   DOES NOT FIT"
            lines.append(f"memory     {row['memory']:7} {row['used_bytes']:8} of {row['bytes']:8} bytes{verdict}")
    return "\n".join(lines)
