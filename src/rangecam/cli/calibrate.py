"""`rangecam calibrate`: from recordings of darkness and plane targets to a calibration file."""

import json as json_format
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
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


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class How:
    """What every step is told beside its recordings."""

    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Write the calibration to this file (.npz).")]
    start: Annotated[
        Path | None, Parameter(name="--from", help="Calibration to complete; what a step does not determine stays.")
    ] = None
    preset: Preset = None
    config: ConfigFile = None
    set_: Set = field(default_factory=list)
    json: Json = False


Straight = Annotated[
    bool, Parameter(negative=(), show_default=False, help="A line for each pixel alone, no curve for the camera.")
]


@calibrate.command
def dark(
    *recordings: str,
    how: How,
) -> None:
    """Take the offset of every pixel from RECORDINGS without light, of each number of accumulations."""
    opened = _open(recordings, how, numbered=False)
    _finish("dark", opened, how, {})


@calibrate.command(name="range")
def range_(
    *recordings: str,
    how: How,
    straight: Straight = False,
) -> None:
    """Take curve and lines from DISTANCE=RECORDING of a plane target across the optical axis, m from the camera."""
    opened = _open(recordings, how, numbered=True)
    _finish("range", opened, how, {"straight": straight} if straight else {})


@calibrate.command
def delay(
    *recordings: str,
    distance: Annotated[float, Parameter(help="Distance of the plane target in all recordings, m.")],
    how: How,
    straight: Straight = False,
) -> None:
    """Take curve and lines from DELAY=RECORDING: the laser fires DELAY s later than in use, the target stays."""
    opened = _open(recordings, how, numbered=True)
    _finish("delay", opened, how, {"distance_m": distance, "straight": straight})


@calibrate.command
def noise(
    *recordings: str,
    how: How,
    figure: Annotated[Path | None, Parameter(help="Draw the fit (.png).")] = None,
) -> None:
    """Fit the noise parameters to RECORDINGS: in darkness at several accumulations, or of a scene at rest (taps)."""
    from rangecam.io.files import check_target, replacing

    if figure is not None:
        check_target(figure)
    opened = _open(recordings, how, numbered=False)
    result = _finish("noise", opened, how, {})
    if figure is not None:
        with replacing(figure) as part:
            part.write_bytes(_noise_figure(result))
        if not how.json:
            print(f"figure      {figure}")


@calibrate.command
def wiggling(
    *recordings: str,
    how: How,
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
) -> None:
    """Take the error over the phase from DISTANCE=RECORDING of planes, or RECORDING with a reference range."""
    opened = _open(recordings, how, numbered=None)
    _finish("wiggling", opened, how, {"model": model, "size": size, "partial": partial})


@calibrate.command
def pattern(
    *recordings: str,
    how: How,
) -> None:
    """Take the offset of every pixel from DISTANCE=RECORDING of planes, or RECORDING of planes anywhere."""
    opened = _open(recordings, how, numbered=None)
    _finish("pattern", opened, how, {})


@calibrate.command
def temperature(
    *recordings: str,
    how: How,
) -> None:
    """Take the drift of the range from TEMPERATURE=RECORDING of a scene at rest, degrees Celsius."""
    opened = _open(recordings, how, numbered=None)
    _finish("temperature", opened, how, {})


@calibrate.command
def scattering(
    target: str,
    *,
    without: Annotated[
        str | None, Parameter(show_default=False, help="Recording of the same scene without the target.")
    ] = None,
    how: How,
) -> None:
    """Take the stray light of the lens from TARGET, a recording of something small and bright before darkness."""
    recordings = [target] if without is None else [target, without]
    opened = _open(recordings, how, numbered=False)
    _finish("scattering", opened, how, {})


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Where:
    """What finding the mounting is told."""

    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Write the mounting to this file (.toml).")]
    preset: Preset = None
    config: ConfigFile = None
    set_: Set = field(default_factory=list)
    json: Json = False


@calibrate.command
def mounting(
    recording: str,
    *,
    where: Where,
) -> None:
    """Take height, pitch and roll from RECORDING of a floor at rest, empty or not; use with --config FILE."""
    from dataclasses import asdict

    import numpy as np

    from rangecam.calibration import fit_mounting
    from rangecam.cli.running import open_with_notes
    from rangecam.hdr import ranged
    from rangecam.io.files import check_target, replacing
    from rangecam.pipeline import RANGING

    check_target(where.output)
    source = open_with_notes(recording, where.preset, where.config, where.set_, 0)
    camera, method = source.config.camera, RANGING[source.config.ranging]
    images = (ranged(method, capture.raw, camera) for capture in source.captures)
    fit = fit_mounting(images, camera.lens, source.config.mounting, np.random.default_rng(0))
    found = asdict(fit)
    pose = found.pop("mounting")
    text = "[mounting]\n" + "\n".join(f"{name} = {value:.6g}" for name, value in pose.items()) + "\n"
    with replacing(where.output) as part:
        part.write_text(text, encoding="utf-8")
    if where.json:
        print(json_format.dumps({"step": "mounting", "output": str(where.output), "mounting": pose, "found": found}))
    else:
        print(f"{text}\n{_lines(found)}\nmounting    {where.output} (use it with --config {where.output})")


def _open(recordings: Sequence[str], how: How, numbered: bool | None) -> "list[Recording]":
    """Open recordings without the calibration that they may hold; numbered: each is NUMBER=RECORDING, None: may be."""
    from rangecam.calibration import Recording
    from rangecam.config import FAMILIES, merge, overrides, read_toml
    from rangecam.io import open_source

    if not recordings:
        raise UsageError(
            "calibrate needs a recording" + (": NUMBER=RECORDING, for example 5=wall-5.mcap" * (numbered is not False))
        )
    wanted = merge(*([read_toml(how.config)] if how.config else []), overrides(how.set_))
    opened = []
    for text in recordings:
        number, name = _numbered(text) if numbered or (numbered is None and _NUMBER.match(text)) else (None, text)
        kind = open_source(name, preset=how.preset, layers=[wanted]).config.camera.kind
        family: Any = FAMILIES[kind]
        if not hasattr(family, "CALIBRATE"):
            raise UsageError(f"{name}: there is nothing to calibrate of a camera of kind {kind}")
        source = open_source(name, preset=how.preset, layers=[wanted, {"camera": {"calibration": ""}}])
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


def _finish(step: str, opened: "list[Recording]", how: How, options: dict[str, Any]) -> "Calibration":
    """Do a step, write the file and say what was found."""
    from rangecam.calibration import Calibration, load_calibration, save_calibration
    from rangecam.config import FAMILIES
    from rangecam.io.files import check_target

    check_target(how.output)
    family: Any = FAMILIES[opened[0].camera.kind]
    steps = family.CALIBRATE
    if step not in steps:
        raise UsageError(f"calibrate {step}: a {opened[0].camera.kind} camera has only {', '.join(steps)}")
    result: Calibration = steps[step](opened, load_calibration(how.start) if how.start else Calibration({}), **options)
    save_calibration(how.output, result)
    found = result.taken.get(step, result.taken.get("range"))
    print(
        json_format.dumps({"step": step, "output": str(how.output), "settings": result.settings, "found": found})
        if how.json
        else f"{_lines(found or {})}\ncalibration {how.output} (use it with --set camera.calibration={how.output})"
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
