"""`rangecam demo`: the main job on a built-in scenario."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rangecam.cli.app import Json, app
from rangecam.cli.run import run


@app.command
def demo(
    *,
    folder: Annotated[Path, Parameter(help="Where to leave them.")] = Path(),
    scenario: Annotated[str, Parameter(help="Another built-in scenario.")] = "approach-box",
    json: Json = False,
) -> None:
    """Simulate a car that drives towards a box, perceive it, brake; leave a report and a recording in FOLDER."""
    stem = folder / f"rangecam-{scenario}"
    run(f"scenario:{scenario}", record=stem.with_suffix(".mcap"), report=stem.with_suffix(".html"), json=json)
    if not json:
        print(f"report     {stem.with_suffix('.html')} (open it in a browser)")
        print(f"recording  {stem.with_suffix('.mcap')} (rangecam run {stem.with_suffix('.mcap')} decodes it again)")
