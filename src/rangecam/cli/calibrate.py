"""`rangecam calibrate`: from recordings of darkness and plane targets to a calibration file."""

import json as json_format
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from rangecam.cli.app import ConfigFile, Json, Preset, Set, app
from rangecam.errors import UsageError

if TYPE_CHECKING:
    from rangecam.calibration import Calibration, Recording

calibrate = App(
    name="calibrate",
    help="Calibrate a camera from recordings (or scenarios); use the file with --set camera.calibration=FILE.",
)
app.command(calibrate)

Output = Annotated[Path, Parameter(name=["--output", "-o"], help="Write the calibration to this file (.npz).")]
From = Annotated[
    Path | None, Parameter(name="--from", help="Calibration to complete; what a step does not determine stays.")
]
Straight = Annotated[
    bool, Parameter(negative=(), show_default=False, help="A line for each pixel alone, no curve for the camera.")
]


@calibrate.command
def dark(
    *recordings: str,
    output: Output,
    from_: From = None,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (cyclopts reads the default, nobody changes it)
    json: Json = False,
) -> None:
    """Take the offset of every pixel from RECORDINGS without light, of each number of accumulations."""
    opened = _open(recordings, from_, (preset, config, set_), numbered=False)
    _finish("dark", opened, from_, output, json, {})


@calibrate.command(name="range")
def range_(
    *recordings: str,
    output: Output,
    from_: From = None,
    straight: Straight = False,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Take curve and lines from DISTANCE=RECORDING of a plane target across the optical axis, m from the camera."""
    opened = _open(recordings, from_, (preset, config, set_), numbered=True)
    _finish("range", opened, from_, output, json, {"straight": straight} if straight else {})


@calibrate.command
def delay(
    *recordings: str,
    distance: Annotated[float, Parameter(help="Distance of the plane target in all recordings, m.")],
    output: Output,
    from_: From = None,
    straight: Straight = False,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Take curve and lines from DELAY=RECORDING: the laser fires DELAY s later than in use, the target stays."""
    opened = _open(recordings, from_, (preset, config, set_), numbered=True)
    _finish("delay", opened, from_, output, json, {"distance_m": distance, "straight": straight})


@calibrate.command
def noise(
    *recordings: str,
    output: Output,
    from_: From = None,
    figure: Annotated[Path | None, Parameter(help="Draw the fit (.png).")] = None,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Fit the noise parameters to RECORDINGS: in darkness at several accumulations, or of a scene at rest (taps)."""
    from rangecam.io.files import check_target, replacing

    if figure is not None:
        check_target(figure)
    opened = _open(recordings, from_, (preset, config, set_), numbered=False)
    result = _finish("noise", opened, from_, output, json, {})
    if figure is not None:
        with replacing(figure) as part:
            part.write_bytes(_noise_figure(result))
        if not json:
            print(f"figure      {figure}")


@calibrate.command
def wiggling(
    *recordings: str,
    output: Output,
    from_: From = None,
    model: Annotated[
        Literal["table", "harmonics"], Parameter(help="Values over the phase with a spline between, or its harmonics.")
    ] = "table",
    size: Annotated[
        int | None, Parameter(show_default=False, help="Values of the table (64), or harmonics (4).")
    ] = None,
    partial: Annotated[
        bool,
        Parameter(negative=(), show_default=False, help="Take what a scene shows although it has not all ranges."),
    ] = False,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Take the error over the phase from DISTANCE=RECORDING of planes, or RECORDING with a reference range."""
    opened = _open(recordings, from_, (preset, config, set_), numbered=None)
    _finish("wiggling", opened, from_, output, json, {"model": model, "size": size, "partial": partial})


@calibrate.command
def pattern(
    *recordings: str,
    output: Output,
    from_: From = None,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Take the offset of every pixel from DISTANCE=RECORDING of planes, or RECORDING of planes anywhere."""
    opened = _open(recordings, from_, (preset, config, set_), numbered=None)
    _finish("pattern", opened, from_, output, json, {})


@calibrate.command
def temperature(
    *recordings: str,
    output: Output,
    from_: From = None,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Take the drift of the range from TEMPERATURE=RECORDING of a scene at rest, degrees Celsius."""
    opened = _open(recordings, from_, (preset, config, set_), numbered=None)
    _finish("temperature", opened, from_, output, json, {})


@calibrate.command
def scattering(
    target: str,
    *,
    without: Annotated[
        str | None, Parameter(show_default=False, help="Recording of the same scene without the target.")
    ] = None,
    output: Output,
    from_: From = None,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (as above)
    json: Json = False,
) -> None:
    """Take the stray light of the lens from TARGET, a recording of something small and bright before darkness."""
    recordings = [target] if without is None else [target, without]
    opened = _open(recordings, from_, (preset, config, set_), numbered=False)
    _finish("scattering", opened, from_, output, json, {})


def _open(
    recordings: Sequence[str],
    start: Path | None,
    settings: tuple[str | None, Path | None, Sequence[str]],
    numbered: bool | None,
) -> "list[Recording]":
    """Open recordings without the calibration that they may hold; numbered: each is NUMBER=RECORDING, None: may be."""
    from rangecam.calibration import Recording
    from rangecam.config import FAMILIES, merge, overrides, read_toml
    from rangecam.io import open_source

    if not recordings:
        raise UsageError(
            "calibrate needs a recording" + (": NUMBER=RECORDING, for example 5=wall-5.mcap" * (numbered is not False))
        )
    preset, config, assignments = settings
    wanted = merge(*([read_toml(config)] if config else []), overrides(assignments))
    opened = []
    for text in recordings:
        number, name = _numbered(text) if numbered or (numbered is None and _NUMBER.match(text)) else (None, text)
        kind = open_source(name, preset=preset, layers=[wanted]).config.camera.kind
        family: Any = FAMILIES[kind]
        if not hasattr(family, "CALIBRATE"):
            raise UsageError(f"{name}: there is nothing to calibrate of a camera of kind {kind}")
        source = open_source(name, preset=preset, layers=[wanted, {"camera": {"calibration": ""}}])
        method = source.config.ranging
        frames = (capture.raw for capture in source.captures)
        opened.append(Recording(name, frames, source.config.camera, method, family.RANGING[method], number))
    return opened


_NUMBER = re.compile(r"[-+.\d]+(e[-+]?\d+)?=")


def _numbered(text: str) -> tuple[float, str]:
    number, equals, name = text.partition("=")
    try:
        return float(number), name if equals else text[:-1]
    except ValueError:
        raise UsageError(f"{text}: expected NUMBER=RECORDING, for example 5=wall-5.mcap") from None


def _finish(
    step: str, opened: "list[Recording]", start: Path | None, output: Path, json: bool, options: dict[str, Any]
) -> "Calibration":
    """Do a step, write the file and say what was found."""
    from rangecam.calibration import Calibration, load_calibration, save_calibration
    from rangecam.config import FAMILIES
    from rangecam.io.files import check_target

    check_target(output)
    family: Any = FAMILIES[opened[0].camera.kind]
    steps = family.CALIBRATE
    if step not in steps:
        raise UsageError(f"calibrate {step}: a {opened[0].camera.kind} camera has only {', '.join(steps)}")
    result: Calibration = steps[step](opened, load_calibration(start) if start else Calibration({}), **options)
    save_calibration(output, result)
    found = result.taken.get(step, result.taken.get("range"))
    print(
        json_format.dumps({"step": step, "output": str(output), "settings": result.settings, "found": found})
        if json
        else f"{_lines(found or {})}\ncalibration {output} (use it with --set camera.calibration={output})"
    )
    return result


def _lines(found: dict[str, Any]) -> str:
    hidden = {"x", "variance", "error"}
    return "\n".join(f"{name:15}{_short(value)}" for name, value in found.items() if name not in hidden)


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_short(one)}" for name, one in value.items())
    if isinstance(value, list):
        return " ".join(_short(one) for one in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _noise_figure(result: "Calibration") -> bytes:
    """Return the points of a noise fit and its line, and the line of the settings before."""
    import numpy as np

    from rangecam.studies import Panel, Series, Study, draw

    fit = result.taken["noise"]
    x = np.array(fit["x"])
    old = fit["line_before"][0] + fit["line_before"][1] * x
    label = "\n".join(f"{name} = {value:.4g}" for name, value in fit["found"].items())
    series = [
        Series("recorded", x, fit["variance"], fit["error"]),
        Series(label, x, fit["base"] + fit["slope"] * x),
        Series("settings before", x, old, line="--"),
    ]
    unit = fit["unit"].partition(" over ")[2]
    over = "accumulations" if unit == "n_acc" else f"light, {unit}"
    panel = Panel("Variance of a value over time", over, fit["unit"].partition(" ")[0], series)
    return draw(Study("calibrate noise", "variance over signal", [], [panel]))
