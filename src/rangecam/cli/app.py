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
StreamTo = Annotated[
    str | None, Parameter(name="--stream", help="Send every frame to udp://HOST:PORT, where `rangecam run` takes it.")
]
StreamMode = Annotated[
    str, Parameter(help="What is sent: raw samples, real_imaginary, range (of `run` only), or none but words.")
]
LinkMbit = Annotated[float, Parameter(help="Mbit/s of the network that packets may fill; 0: as fast as can be.")]
RealTime = Annotated[
    bool, Parameter(negative=(), show_default=False, help="Take frames when their time has come, as from a camera.")
]
