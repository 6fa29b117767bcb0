"""`rangecam repair`: the complete frames of a recording that was cut off."""

import json as json_format
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rangecam.cli.app import Json, app


@app.command
def repair(
    recording: Path, /, *, output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None, json: Json = False
) -> None:
    """Copy the complete frames of a recording that was cut off (by default to RECORDING.repaired.mcap)."""
    from rangecam.io import repair as repair_recording

    target = output or recording.with_suffix(".repaired.mcap")
    frames = repair_recording(recording, target)
    print(
        json_format.dumps({"frames": frames, "output": str(target)}) if json else f"{target}: {frames} complete frames"
    )
