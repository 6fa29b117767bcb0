"""The command line: `rangecam demo | run | simulate | study | bench | repair`.

Thin: each command opens a source, lets `pipeline.run` work and prints. Nothing heavy is imported before it is needed,
so that `rangecam --help` answers at once. An error is one line on standard error; exit code 1 for data, 2 for the call.
"""

import json as json_format
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

import rangecam
from rangecam.errors import RangecamError, UsageError

if TYPE_CHECKING:
    from rangecam.io import Source

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

    opened = _open(source, preset, config, set_, seed)
    watch, summary = Stopwatch(), Summary(opened.name, opened.config)
    with ExitStack() as stack:
        sinks = [
            summary,
            *_sinks(stack, opened, {"record": record, "report": report, "images": images, "tracks": tracks}),
        ]
        captures = _progress(_warmed_up(opened, pipeline), opened.n_frames)
        for _ in pipeline.run(captures, opened.config, sinks, watch):
            pass
    result = summary.result(watch)
    print(json_format.dumps(result) if json else describe(result))


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

    opened = _open(f"scenario:{scenario.removeprefix('scenario:')}", preset, config, set_, seed)
    frames = 0
    with Recorder(output, opened.config, opened.name) as recorder:
        for capture in _progress(opened.captures, opened.n_frames):
            recorder.write(capture)
            frames += 1
    result = {"scenario": opened.name, "preset": opened.config.preset, "frames": frames, "output": str(output)}
    print(json_format.dumps(result) if json else f"{output}: {frames} frames of {opened.name}")


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


@app.command
def study(
    name: str | None = None,
    /,
    *,
    folder: Annotated[Path, Parameter(help="Where the figures go, NAME.png.")] = Path(),
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Repeat the experiments of the theses: NAME (table and NAME.png) or all (studies.html); without a name, list."""
    from rangecam import studies
    from rangecam.io.files import check_target, replacing

    if name is None and not json:
        print(studies.study_list())
        return
    if name is None:
        raise UsageError(f"study --json needs a name: {', '.join([*studies.STUDIES, 'all'])}")
    names = studies.study_names(name)
    path = None if json else check_target(folder / ("studies.html" if name == "all" else f"{name}.png"))
    results = [studies.run_study(one, seed) for one in _progress(names, len(names), "studies")]
    if path is None:
        print(json_format.dumps(studies.as_json(results)))
        return
    with replacing(path) as part:
        part.write_bytes(_study_page(results) if name == "all" else studies.draw(results[0]))
    print(studies.verdicts(results) if name == "all" else studies.table(results[0]))
    print(f"{'report' if name == 'all' else 'figure'}     {path}")


def _study_page(results: Sequence[Any]) -> bytes:
    """Return one page with the figure and the claims of every study."""
    from rangecam import studies
    from rangecam.report.template import page, section

    lead = "What the theses state beside what this program computes; where they differ, the reason."
    parts = [section(one.name, one.section, studies.draw(one), studies.table(one)) for one in results]
    return page("The experiments of the theses", lead, studies.verdicts(results), parts).encode("utf-8")


@app.command
def bench(*, seconds: Annotated[float, Parameter(help="Time spent on each row.")] = 2.0, json: Json = False) -> None:
    """Measure milliseconds a stage and a chain, beside peers in the same process (extra: rangecam[bench])."""
    from rangecam.bench import measure, table

    result = measure(seconds)
    print(json_format.dumps(result) if json else table(result))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done, 1 the data or a check failed, 2 the call was wrong."""
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in tokens
    tokens = [token for token in tokens if token != "--debug"]
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except RangecamError as error:
        return _fail(error, str(error), error.exit_code, debug)
    except CycloptsError as error:
        return _fail(error, str(error), 2, debug)
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        return _fail(None, "interrupted", 130, False)
    except OSError as error:
        return _fail(error, f"{error.filename or 'input or output'}: {error.strerror or error}", 1, debug)
    except Exception as error:  # the last line of defence: no traceback for users, but nothing hidden from --debug
        message = f"internal error: {type(error).__name__}: {error} (run again with --debug and report it)"
        return _fail(error, message, 1, debug)
    return 0


def _fail(error: BaseException | None, message: str, code: int, debug: bool) -> int:
    if debug and error is not None:
        raise error
    print("rangecam: " + " ".join(message.split()), file=sys.stderr)
    return code


def _open(source: str, preset: str | None, config: Path | None, set_: Sequence[str], seed: int) -> "Source":
    """Open a source with the settings of the command line over its own, and pass on what it has to say."""
    from rangecam.config import overrides, read_toml
    from rangecam.io import open_source

    layers = [*([read_toml(config)] if config else []), overrides(set_)]
    opened = open_source(source, preset=preset, layers=layers, seed=seed)
    for note in opened.notes:
        print(f"rangecam: note: {note}", file=sys.stderr)
    return opened


def _sinks(stack: ExitStack, opened: "Source", targets: dict[str, Path | None]) -> Iterator[Any]:
    """Open the outputs that were asked for; the stack closes them, and on an error they leave nothing behind."""
    from rangecam import io
    from rangecam.report import Report

    makers: dict[str, Any] = {
        "record": io.Recorder,
        "report": Report,
        "images": io.ImagesWriter,
        "tracks": io.TracksWriter,
    }
    for name, path in targets.items():
        if path is not None:
            yield stack.enter_context(makers[name](path, opened.config, opened.name))


@contextmanager
def _message_if_slow(message: str, after_s: float) -> Iterator[None]:
    timer = threading.Timer(after_s, lambda: print(message, file=sys.stderr))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _warmed_up(opened: "Source", pipeline: Any) -> Iterator[Any]:
    """Yield the captures, once the kernels are compiled, so that compiling is not taken for latency."""
    for number, capture in enumerate(opened.captures):
        if number == 0:
            with _message_if_slow("rangecam: compiling kernels (on the first use only) ...", 1.5):
                pipeline.warm_up(capture, opened.config)
        yield capture


def _progress(items: Any, total: int | None, what: str = "frames") -> Iterator[Any]:
    """Show progress on standard error while `items` pass, if someone is looking."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, what, total=total, console=Console(stderr=True), transient=True)


if __name__ == "__main__":
    sys.exit(main())
