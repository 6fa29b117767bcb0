"""`rangecam simulate`: raw samples of a simulated camera into a recording."""

import json as json_format
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rangecam.cli.app import ConfigFile, Json, LinkMbit, Preset, RealTime, Seed, Set, StreamMode, StreamTo, app
from rangecam.cli.running import open_stream, open_with_notes, progress
from rangecam.errors import UsageError


@app.command
def simulate(
    scenario: str,
    /,
    *,
    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], help="Recording (.mcap) to write the samples to.")
    ] = None,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    seed: Seed = 0,
    stream: StreamTo = None,
    stream_mode: StreamMode = "raw",
    link_mbit: LinkMbit = 100.0,
    real_time: RealTime = False,
    json: Json = False,
) -> None:
    """Simulate SCENARIO and write or stream the raw samples of its camera, without processing them."""
    from rangecam.io import Recorder
    from rangecam.io.udp import paced

    if output is None and stream is None:
        raise UsageError("simulate needs a recording to write (-o OUT.mcap) or an address (--stream udp://HOST:PORT)")
    opened = open_with_notes(f"scenario:{scenario.removeprefix('scenario:')}", preset, config, set_, seed)
    frames = 0
    with ExitStack() as stack:
        sinks = [
            *([stack.enter_context(Recorder(output, opened.config, opened.name))] if output else []),
            *open_stream(stack, stream, opened.config, stream_mode, link_mbit),
        ]
        captures = paced(opened.captures) if real_time else opened.captures
        for capture in progress(captures, opened.n_frames):
            for sink in sinks:
                sink.write(capture)
            frames += 1
    where = {"output": str(output) if output else None, **({"stream": stream} if stream else {})}
    result = {"scenario": opened.name, "preset": opened.config.preset, "frames": frames, **where}
    targets = " and ".join(str(one) for one in (output, stream) if one)
    print(json_format.dumps(result) if json else f"{targets}: {frames} frames of {opened.name}")
