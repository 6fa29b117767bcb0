"""The application that commands register with, and the options that several of them have."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

import rangecam

app = App(
    name="rangecam",
    help="Time-of-flight range cameras, from raw samples to the brake command.",
    version=rangecam.__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
)

Set = Annotated[
    list[str],
    Parameter(
        name="--set",
        negative=(),
        show_default=False,
        help="One setting, key=value; may be given again. Wins over all else.",
    ),
]
Preset = Annotated[
    str | None, Parameter(help="Camera and processing to start from; otherwise the source suggests one.")
]
ConfigFile = Annotated[Path | None, Parameter(name="--config", help="TOML file of settings, over the preset.")]
Json = Annotated[
    bool,
    Parameter(name="--json", negative=(), show_default=False, help="Print one JSON object instead of the summary."),
]
Record = Annotated[Path | None, Parameter(help="Write raw samples, settings and results to this recording (.mcap).")]
ReportFile = Annotated[
    Path | None,
    Parameter(help="Write one HTML page that opens offline: images, life of a frame, tracks from above, braking."),
]
Images = Annotated[
    Path | None, Parameter(help="Write range_m, sigma_m, amplitude, valid, why and time_s of every frame (.npz).")
]
TracksFile = Annotated[Path | None, Parameter(help="Write a row for each confirmed track and frame (.csv).")]
Seed = Annotated[int, Parameter(help="Seed of the simulated noise.")]
