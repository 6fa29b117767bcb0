"""`rangecam drive`: the closed loop, once or in thousands of variations."""

import json as json_format
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rangecam.cli.app import ConfigFile, Json, Preset, Record, ReportFile, Seed, Set, app
from rangecam.cli.running import progress
from rangecam.cli.tune import Scheduler
from rangecam.errors import DataError, UsageError

Faults = Annotated[
    list[str],
    Parameter(
        name="--fault",
        negative=(),
        show_default=False,
        help="Something that goes wrong in a single drive: KIND, or KIND,start_s=1.5,duration_s=0.2,value=0.1; may be "
        "given again. Kinds: frozen, dropped, late, repeated, out_of_order, saturated, status_silence, "
        "command_silence, wrong_magic, speed_stuck, slippery.",
    ),
]
_RUNS, _KEPT = 100, 20


@app.command
def drive(
    name: str,
    /,
    *,
    preset: Preset = None,
    config: ConfigFile = None,
    set_: Set = [],  # noqa: B006 (cyclopts reads the default, nobody changes it)
    fault: Faults = [],  # noqa: B006 (as above)
    seed: Seed = 0,
    record: Record = None,
    report: ReportFile = None,
    number: Annotated[int | None, Parameter(help="Of a campaign: drive this one alone, once more.")] = None,
    runs: Annotated[int | None, Parameter(help="Of a campaign: how many drives; otherwise 100.")] = None,
    jobs: Annotated[int, Parameter(help="Of a campaign: processes to work in.")] = 1,
    scheduler: Scheduler = None,
    folder: Annotated[
        Path | None, Parameter(help="Of a campaign: where its rows are kept; it goes on there if it was cut off.")
    ] = None,
    keep: Annotated[int | None, Parameter(help="Of a campaign: record so many failed drives; otherwise 20.")] = None,
    real_time: Annotated[
        bool,
        Parameter(
            negative=(),
            show_default=False,
            help="Of a single drive: camera, perception and car as processes, connected by UDP and CAN, in real time.",
        ),
    ] = False,
    duration: Annotated[
        float, Parameter(help="Of a drive in real time: approach after approach for so many seconds.")
    ] = 10.0,
    upsets: Annotated[
        int,
        Parameter(help="Of a drive in real time: kill, restart or freeze a process so often, and see all recover."),
    ] = 0,
    json: Json = False,
) -> None:
    """Drive NAME in closed loop: a scenario, or a campaign (scaled-car, full-size, false-positives).

    Settings of the drive begin with drive., such as --set drive.friction=0.2 or --set drive.vehicle=passenger_car.
    """
    from rangecam.config import overrides, read_toml
    from rangecam.drive.campaigns import CAMPAIGNS

    layers = [*([read_toml(config)] if config else []), overrides(set_)]
    options = {"--runs": runs, "--folder": folder, "--keep": keep, "--scheduler": scheduler, "--number": number}
    if name not in CAMPAIGNS:
        _refuse(name, {**options, "--jobs": None if jobs == 1 else jobs}, "is for a campaign")
        if real_time:
            _refuse(name, {"--record": record, "--report": report, "--fault": fault or None}, "is not for real time")
            _in_real_time(name, preset, layers, seed, duration, upsets, json)
            return
        _single(name, preset, layers, fault, seed, record, report, json)
        return
    _refuse(name, {"--fault": fault or None, "--preset": preset}, "is for a scenario; the campaign draws its own")
    if number is not None:
        _again(name, layers, seed, number, record, report, json)
        return
    _refuse(name, {"--record": record, "--report": report}, "needs --number; a campaign's are in its --folder")
    if (runs is not None and runs < 1) or (keep is not None and keep < 0):
        raise UsageError("expected --runs of at least 1 and --keep of at least 0")
    place = folder or Path(f"rangecam-{name}")
    result = _campaign(
        name, layers, seed, place, _RUNS if runs is None else runs, _KEPT if keep is None else keep, jobs, scheduler
    )
    print(json_format.dumps(result["json"], allow_nan=False) if json else result["text"])


def _in_real_time(
    name: str,
    preset: str | None,
    layers: Sequence[Mapping[str, Any]],
    seed: int,
    duration_s: float,
    upsets: int,
    json: bool,
) -> None:
    from rangecam.drive.opening import opened
    from rangecam.drive.realtime import describe, drive_in_real_time

    if not duration_s > 0 or upsets < 0:
        raise UsageError("expected --duration above zero and --upsets of at least 0")
    began = opened(name, preset, layers)
    result = drive_in_real_time(*began, seed, duration_s, upsets, lambda line: print(line, file=sys.stderr, flush=True))
    print(json_format.dumps(result) if json else describe(result))
    if result["cut_off"] is not None:
        raise DataError(f"{name}: cut off ({result['cut_off']}) after {len(result['upsets'])} upsets of {upsets}")
    if result["collision"] or not all(each["held"] for each in result["upsets"]):
        raise DataError(f"{name}: the car did not stop as stated, or not all recovered")


def _refuse(name: str, options: Mapping[str, Any], why: str) -> None:
    for option, value in options.items():
        if value is not None:
            raise UsageError(f"{name}: {option} {why}")


def _single(
    name: str,
    preset: str | None,
    layers: Sequence[Mapping[str, Any]],
    faults: Sequence[str],
    seed: int,
    record: Path | None,
    report: Path | None,
    json: bool,
) -> None:
    from rangecam.drive.opening import opened

    told = {"drive": {"faults": [_fault(text) for text in faults]}} if faults else {}
    scenario, config, settings = opened(name, preset, [*layers, told])
    _driven(scenario, config, settings, seed, record, report, json)


def _again(
    campaign: str,
    layers: Sequence[Mapping[str, Any]],
    seed: int,
    number: int,
    record: Path | None,
    report: Path | None,
    json: bool,
) -> None:
    from rangecam.config import merge
    from rangecam.drive.campaigns import trial_of

    trial = trial_of(campaign, seed, number, merge(*layers))
    _driven(trial.scenario, trial.config, trial.settings, trial.seed, record, report, json)


def _driven(
    scenario: Any, config: Any, settings: Any, seed: int, record: Path | None, report: Path | None, json: bool
) -> None:
    from rangecam.drive import page
    from rangecam.drive.loop import drive as drive_once
    from rangecam.drive.result import as_json, describe
    from rangecam.io import Recorder
    from rangecam.io.files import check_target, replacing

    target = None if report is None else check_target(report)
    with ExitStack() as stack:
        sinks = [] if record is None else [stack.enter_context(Recorder(record, config, scenario.name))]
        result = drive_once(scenario, config, settings, seed, sinks)
    if target is not None:
        with replacing(target) as part:
            part.write_bytes(page.html(result, scenario.description))
    print(json_format.dumps(as_json(result), allow_nan=False) if json else describe(result))


def _campaign(
    name: str,
    layers: Sequence[Mapping[str, Any]],
    seed: int,
    folder: Path,
    runs: int,
    keep: int,
    jobs: int,
    scheduler: str | None,
) -> dict[str, Any]:
    from rangecam.config import merge
    from rangecam.drive.campaigns import page, run, statistics
    from rangecam.io.files import replacing
    from rangecam.workers import mapping, workers

    together = merge(*layers)
    with workers(jobs, scheduler) as executor:
        rows = run.run(folder, name, runs, seed, together, mapping(executor, partial(_watch, "drives")))
        failures = [row["number"] for row in statistics.worst(rows, keep)]
        nearby = executor if scheduler is None else None  # the workers of a scheduler may not see the folder
        mapper = mapping(nearby, partial(_watch, "recordings"))
        paths = run.record_failures(folder, name, seed, together, failures, mapper)
    files = [str(path.relative_to(folder)) for path in paths]
    with replacing(folder / run.REPORT) as part:
        part.write_bytes(page.html(name, rows, files))
    text = [page.describe(name, rows), f"table      {folder / run.TABLE}", f"report     {folder / run.REPORT}"]
    return {"json": statistics.summary(rows), "text": "\n".join(text)}


def _watch(what: str, items: Any, total: int) -> Any:
    if total and not sys.stderr.isatty():
        print(f"rangecam: {total} {what} to go", file=sys.stderr)
    return progress(items, total, what)


def _fault(text: str) -> dict[str, Any]:
    from rangecam.config import overrides

    kind, *values = text.split(",")
    return {"kind": kind.strip(), **overrides(values)}
