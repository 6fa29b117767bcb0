"""A campaign's folder: rows as they come, the table of all, and recordings of what failed.

campaign.json   what is driven: name, seed, settings, version. A folder goes on only with the same.
drives.jsonl    a row for each finished drive, appended and flushed; a line that was cut off counts as none
drives.parquet  all rows by number, once all are there; the same bytes for any number of workers
failures/       NUMBER.mcap: drives that failed, once more with everything the camera saw
report.html     the page
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rangecam.drive.campaigns import trial_of
from rangecam.drive.campaigns.row import COLUMNS, row_of
from rangecam.drive.loop import drive
from rangecam.errors import DataError, UsageError
from rangecam.io.files import replacing
from rangecam.io.recorder import Recorder
from rangecam.workers import Mapper

FACTS, ROWS, TABLE, REPORT, FAILURES = "campaign.json", "drives.jsonl", "drives.parquet", "report.html", "failures"

Row = dict[str, Any]


def one(number: int, campaign: str, seed: int, layers: Mapping[str, Any]) -> Row:
    """Drive number `number` of a campaign; the work of a worker."""
    return row_of(number, trial_of(campaign, seed, number, layers))


def run(folder: Path, campaign: str, runs: int, seed: int, layers: Mapping[str, Any], mapper: Mapper) -> list[Row]:
    """Drive what of a campaign is not yet in `folder`, and return the rows of drives 0..runs - 1.

    Every finished drive is kept at once, so that a killed campaign goes on where it stopped. Raises UsageError if the
    folder belongs to another campaign.
    """
    trial_of(campaign, seed, 0, layers)  # wrong names and settings are told before anything is written
    begin(folder, campaign, seed, layers)
    done = {row["number"]: row for row in finished(folder)}
    missing = [number for number in range(runs) if number not in done]
    with (folder / ROWS).open("a", encoding="utf-8") as file:
        for row in mapper(partial(one, campaign=campaign, seed=seed, layers=layers), missing):
            file.write(json.dumps(_written(row)) + "\n")
            file.flush()
            done[row["number"]] = row
    rows = [done[number] for number in range(runs)]
    write_table(folder / TABLE, rows)
    return rows


def begin(folder: Path, campaign: str, seed: int, layers: Mapping[str, Any]) -> None:
    """Make the folder of a campaign, or check that it is one and the same; a line cut off at its end is removed."""
    from rangecam import __version__

    facts = {"campaign": campaign, "seed": seed, "settings": dict(layers), "version": __version__}
    folder.mkdir(parents=True, exist_ok=True)
    known = folder / FACTS
    if known.exists():
        try:
            there = json.loads(known.read_text(encoding="utf-8"))
        except ValueError as error:
            raise DataError(f"{known}: not the beginning of a campaign: {error}") from error
        if there != json.loads(json.dumps(facts)):
            raise UsageError(f"{folder} holds another campaign ({_told(there)}); name another --folder")
    else:
        with replacing(known) as part:
            part.write_text(json.dumps(facts, indent=1), encoding="utf-8")
    rows = folder / ROWS
    text = rows.read_text(encoding="utf-8") if rows.exists() else ""
    if text and not text.endswith("\n"):
        with replacing(rows) as part:
            part.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")


def _told(facts: Any) -> str:
    if not isinstance(facts, dict):
        return "unreadable"
    return ", ".join(f"{key} {facts.get(key)}" for key in ("campaign", "seed", "settings", "version"))


def finished(folder: Path) -> Iterator[Row]:
    """Yield the rows of a folder, in the order in which they were driven. Raises DataError for a line that is none."""
    path = folder / ROWS
    for n, line in enumerate(path.read_text(encoding="utf-8").splitlines() if path.exists() else []):
        try:
            values = json.loads(line)
            yield {name: _read(kind, values[name]) for name, kind in COLUMNS.items()}
        except (ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path}: line {n + 1} is no drive of this version: {error!r}") from error


def _written(row: Row) -> Row:
    """Return a row as JSON has it: numbers exact, those that JSON lacks as text."""
    return {name: str(v) if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}


def _read(kind: type, value: Any) -> Any:
    if kind is float:
        return float(value)
    if not isinstance(value, kind):
        raise TypeError(f"expected {kind.__name__}, got {value!r}")
    return value


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as a Parquet file; the same rows give the same bytes."""
    import pyarrow
    from pyarrow import parquet

    kinds = {int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    table = pyarrow.table({name: [row[name] for row in rows] for name in COLUMNS}, schema=schema)
    with replacing(path) as part:
        parquet.write_table(table, part, compression="zstd")


def record(path: Path, campaign: str, seed: int, number: int, layers: Mapping[str, Any]) -> None:
    """Drive one number once more, into a recording that `rangecam run` opens."""
    trial = trial_of(campaign, seed, number, layers)
    with Recorder(path, trial.config, f"{campaign} {number}") as recorder:
        drive(trial.scenario, trial.config, trial.settings, trial.seed, [recorder])


def record_failures(
    folder: Path,
    campaign: str,
    seed: int,
    layers: Mapping[str, Any],
    numbers: Sequence[int],
    mapper: Mapper,
) -> list[Path]:
    """Record drives into the folder's `failures`, those that are not there yet, and return their files.

    Whoever works for `mapper` must see the folder.
    """
    place = folder / FAILURES
    if numbers:
        place.mkdir(exist_ok=True)
    paths = [place / f"{number}.mcap" for number in numbers]
    missing = [(path, number) for path, number in zip(paths, numbers, strict=True) if not path.exists()]
    for _ in mapper(partial(_recorded, campaign=campaign, seed=seed, layers=layers), missing):
        pass
    return paths


def _recorded(what: tuple[Path, int], campaign: str, seed: int, layers: Mapping[str, Any]) -> None:
    """Record one drive; the work of a worker."""
    path, number = what
    with replacing(path) as part:
        record(part, campaign, seed, number, layers)
