"""`rangecam simulate`: raw samples of a simulated camera into a recording."""

import json as json_format
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rangecam.cli.app import ConfigFile, Json, Preset, Seed, Set, app
from rangecam.cli.running import open_with_notes, progress


@app.command
def simulate(
    scenario: str,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Simulate SCENARIO and write the raw samples of its camera to a recording, without processing them."""
    from rangecam.io import Recorder

    opened = open_with_notes(f"scenario:{scenario.removeprefix('scenario:')}", preset, config, set_, seed)
    frames = 0
    with Recorder(output, opened.config, opened.name) as recorder:
        for capture in progress(opened.captures, opened.n_frames):
            recorder.write(capture)
            frames += 1
    result = {"scenario": opened.name, "preset": opened.config.preset, "frames": frames, "output": str(output)}
    print(json_format.dumps(result) if json else f"{output}: {frames} frames of {opened.name}")
