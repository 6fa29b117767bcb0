"""`rangecam run`: perceive a source."""

import json as json_format
from contextlib import ExitStack

from rangecam.cli.app import ConfigFile, Images, Json, Preset, Record, ReportFile, Seed, Set, TracksFile, app
from rangecam.cli.running import open_sinks, open_with_notes, progress, warmed_up


@app.command
def run(
    source: str,
    /,
    *,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (cyclopts reads the default, nobody changes it)
    seed: Seed = 0,
    record: Record = None,
    report: ReportFile = None,
    images: Images = None,
    tracks: TracksFile = None,
    json: Json = False,
) -> None:
    """Perceive SOURCE: scenario:NAME, a recording (.mcap) or a NumPy file (.npz)."""
    from rangecam import pipeline
    from rangecam.summary import Stopwatch, Summary, describe

    opened = open_with_notes(source, preset, config, set_, seed)
    watch, summary = Stopwatch(), Summary(opened.name, opened.config)
    with ExitStack() as stack:
        sinks = [
            summary,
            *open_sinks(stack, opened, {"record": record, "report": report, "images": images, "tracks": tracks}),
        ]
        captures = progress(warmed_up(opened, pipeline), opened.n_frames)
        for _ in pipeline.run(captures, opened.config, sinks, watch):
            pass
    result = summary.result(watch)
    print(json_format.dumps(result) if json else describe(result))
