"""`rangecam run`: perceive a source."""

import json as json_format
from contextlib import ExitStack

from rangecam.cli.app import (
    ConfigFile,
    Images,
    Json,
    LinkMbit,
    Preset,
    RealTime,
    Record,
    ReportFile,
    Seed,
    Set,
    StreamMode,
    StreamTo,
    TracksFile,
    app,
)
from rangecam.cli.running import ends_on_interrupt, open_sinks, open_stream, open_with_notes, progress, warmed_up


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
    stream: StreamTo = None,
    stream_mode: StreamMode = "raw",
    link_mbit: LinkMbit = 100.0,
    real_time: RealTime = False,
    json: Json = False,
) -> None:
    """Perceive SOURCE: scenario:NAME, a recording (.mcap), a NumPy file (.npz), or a stream udp://HOST:PORT."""
    from rangecam import pipeline
    from rangecam.io.udp import paced
    from rangecam.summary import Stopwatch, Summary, describe

    opened = open_with_notes(source, preset, config, set_, seed)
    watch, summary = Stopwatch(), Summary(opened.name, opened.config)
    with ExitStack() as stack:
        sinks = [
            summary,
            *open_sinks(stack, opened, {"record": record, "report": report, "images": images, "tracks": tracks}),
            *open_stream(stack, stream, opened.config, stream_mode, link_mbit),
        ]
        stack.enter_context(ends_on_interrupt(opened))
        warm = warmed_up(opened, pipeline)
        captures = progress(paced(warm) if real_time else warm, opened.n_frames)
        for _ in pipeline.run(captures, opened.config, sinks, watch):
            pass
    result = summary.result(watch)
    if opened.live is not None:
        result["received"] = opened.live.counts()
    print(json_format.dumps(result) if json else describe(result))
