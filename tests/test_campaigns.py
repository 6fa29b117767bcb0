"""Campaigns: drives drawn from their own seeds, kept as they come, the same for any number of workers."""

import json
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet

from rangecam.cli import main
from rangecam.drive.campaigns import CAMPAIGNS, page, run, statistics, trial_of
from rangecam.drive.campaigns.full_size import PROTOCOLS
from rangecam.drive.campaigns.row import COLUMNS, badness, failed
from rangecam.errors import DataError, UsageError
from rangecam.workers import mapping, workers

COARSE = {
    "camera": {"rows": 24, "columns": 32, "pseudo_rows": 0, "read_noise_lsb": 0.5},
    "decision": {"min_object_px": 2.0, "large_object_px": 30.0, "min_object_m": 0.01},
    "segments": {"min_pixels": 3},
}
"""Of the scaled car's camera: few pixels, so that a drive takes little time."""
SET = [f"--set={group}.{key}={json.dumps(value)}" for group, values in COARSE.items() for key, value in values.items()]
RUNS = 5


def passed(items: Any, total: int) -> Iterator[Any]:
    yield from items


def driven(folder: Path, runs: int = RUNS, jobs: int = 1, seed: int = 3) -> list[run.Row]:
    with workers(jobs) as executor:
        return run.run(folder, "scaled-car", runs, seed, COARSE, mapping(executor, passed))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a campaign that was driven at once."""
    folder = tmp_path_factory.mktemp("campaign") / "whole"
    driven(folder)
    return folder


def row(**different: Any) -> dict[str, Any]:
    usual = {kind: {int: 0, float: 1.0, str: "", bool: False}[value] for kind, value in COLUMNS.items()}
    usual |= {"camera": "usercams", "group": "CCRs", "unbraked_mps": 10.0, "speed_mps": 10.0, "driven_s": 36.0}
    return {**usual, **different}


# -- what is drawn ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_a_drive_depends_on_its_seed_and_number_alone(campaign: str) -> None:
    one, again, other = (trial_of(campaign, 7, number, {}) for number in (41, 41, 42))
    assert (one.scenario, one.settings, one.seed) == (again.scenario, again.settings, again.seed)
    assert one.scenario != other.scenario


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_each_group_comes_about_as_often_as_it_should_and_can_be_loaded(campaign: str) -> None:
    trials = [trial_of(campaign, 0, number, {}) for number in range(150)]
    groups = {trial.drawn.group for trial in trials}
    assert len(groups) >= 5
    assert all(trial.scenario.duration_s > 0 and trial.config.camera.rows for trial in trials)
    if campaign == "full-size":
        assert groups == set(PROTOCOLS)
        assert {trial.drawn.camera for trial in trials} == {"usercams", "scaled_car", "road_cw_20m"}
    if campaign == "scaled-car":
        assert 3 < sum(bool(trial.drawn.fault) for trial in trials) < 35


def test_a_user_changes_the_camera_of_every_drive() -> None:
    assert trial_of("scaled-car", 0, 1, COARSE).config.camera.rows == 24


def test_an_unknown_campaign_is_refused_with_those_that_are() -> None:
    with pytest.raises(UsageError, match="full-size"):
        trial_of("full-sise", 0, 0, {})


# -- what is kept -----------------------------------------------------------------------------------------------------


def test_a_campaign_that_was_cut_off_goes_on_and_ends_with_the_same_table(whole: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut"
    driven(cut, 2)
    with (cut / run.ROWS).open("a") as file:
        file.write('{"number": 2, "seed": 1')  # killed while it wrote
    before = (cut / run.ROWS).read_text().splitlines()[:2]
    driven(cut)
    assert (cut / run.ROWS).read_text().splitlines()[:2] == before
    assert (cut / run.TABLE).read_bytes() == (whole / run.TABLE).read_bytes()


def test_two_workers_give_the_same_table_as_one(whole: Path, tmp_path: Path) -> None:
    driven(tmp_path / "two", jobs=2)
    assert (tmp_path / "two" / run.TABLE).read_bytes() == (whole / run.TABLE).read_bytes()


def test_the_table_holds_every_column_of_every_drive(whole: Path) -> None:
    table = parquet.read_table(whole / run.TABLE)
    assert table.column_names == list(COLUMNS)
    assert table["number"].to_pylist() == list(range(RUNS))
    rows = sorted(run.finished(whole), key=lambda each: each["number"])
    assert table["unbraked_mps"].to_pylist() == [each["unbraked_mps"] for each in rows]
    assert any(each["threat"] for each in rows)


def test_a_folder_goes_on_only_with_its_own_campaign(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="another campaign"):
        driven(whole, seed=4)
    (tmp_path / run.FACTS).write_text("[]")
    with pytest.raises(UsageError, match="unreadable"):
        driven(tmp_path)
    (tmp_path / run.FACTS).write_text("{")
    with pytest.raises(DataError, match="not the beginning"):
        driven(tmp_path)


@pytest.mark.parametrize("line", ["{}", "7", '{"number": "x"}', "nothing"])
def test_a_line_that_is_no_drive_is_told(line: str, tmp_path: Path) -> None:
    (tmp_path / run.ROWS).write_text(line + "\n")
    with pytest.raises(DataError, match="line 1"):
        list(run.finished(tmp_path))


def test_failures_are_recorded_once(whole: Path) -> None:
    record = partial(run.record_failures, whole, "scaled-car", 3, COARSE, mapper=mapping(None, passed))
    (path,) = record(numbers=[1])
    before = path.stat().st_mtime_ns
    assert record(numbers=[1]) == [path]
    assert path.stat().st_mtime_ns == before
    assert record(numbers=[]) == []


# -- what it comes to -------------------------------------------------------------------------------------------------


def test_rates_have_the_exact_interval_of_a_poisson_process() -> None:
    assert statistics.rate(0, 50.0) == pytest.approx((0.0, 0.0, 3.688879 / 50))
    assert statistics.rate(3, 2.0) == pytest.approx((1.5, 0.618672 / 2, 8.767273 / 2), rel=1e-5)
    assert all(math.isnan(v) for v in statistics.rate(0, 0.0))


def test_shares_have_the_exact_interval_of_clopper_and_pearson() -> None:
    assert statistics.share(10, 10) == pytest.approx((1.0, 0.025 ** (1 / 10), 1.0))
    assert statistics.share(0, 10) == pytest.approx((0.0, 0.0, 1 - 0.025 ** (1 / 10)))
    assert statistics.share(3, 10) == pytest.approx((0.3, 0.066740, 0.652453), rel=1e-4)
    assert all(math.isnan(v) for v in statistics.share(0, 0))


def test_what_failed_is_a_collision_that_could_have_been_avoided_or_a_false_brake() -> None:
    late = row(number=1, threat=True, avoidable=True, impact_mps=4.0, bound_mps=0.0, hit="car")
    beyond = row(number=2, threat=True, avoidable=False, impact_mps=6.0, bound_mps=6.0, hit="car")
    false = row(number=3, false_brake=True, reason="a leaf")
    good = row(number=4, threat=True, avoidable=True, avoided=True, impact_mps=0.0, bound_mps=0.0)
    lucky = row(number=5, threat=True, avoidable=False, avoided=True, impact_mps=0.0, bound_mps=3.0)
    rows = [late, beyond, false, good, lucky]
    assert [failed(each) for each in rows] == [True, False, True, False, False]
    assert badness(late) == 4.0
    assert badness(good) == 0.0
    assert [each["number"] for each in statistics.worst(rows)] == [3, 1]
    found = statistics.summary(rows)
    assert {key: found[key] for key in ("runs", "avoidable", "avoided", "collisions", "false_brakes", "hours")} == {
        "runs": 5, "avoidable": 2, "avoided": 1, "collisions": 2, "false_brakes": 1, "hours": 0.05,
    }  # fmt: skip
    assert found["avoided_beyond"] == 1
    (group,) = statistics.groups(rows, "camera")
    assert group.speed_taken == pytest.approx((0.6 + 0.4 + 1 + 1) / 4)
    assert group.speed_possible == pytest.approx((1 + 0.4 + 1 + 0.7) / 4)


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_the_page_holds_curves_rates_budget_and_failures(campaign: str) -> None:
    threat = {"threat": True, "avoidable": True, "light": "sun", "target_mps": 0.0}
    rows = [
        row(number=0, avoided=True, impact_mps=0.0, reason="car at 9 m", **threat),
        row(number=1, impact_mps=3.0, fault="late", hit="car", speed_mps=12.0, **threat),
        row(number=2, camera="road_cw_20m", false_brake=True, exposed_s=math.nan),
    ]
    text = page.html(campaign, rows, ["failures/1.mcap"]).decode()
    for words in ("Speed of impact", "False brakes", "From light to brake", "failures/1.mcap", "fault late"):
        assert words in text
    assert ("Steinbäck" in text) == (campaign == "full-size") or "Steinb" in page.LEADS[campaign]
    assert "no threat was driven" in text or campaign != "full-size"


def test_a_page_of_quiet_drives_has_neither_curves_nor_a_budget() -> None:
    text = page.html("false-positives", [row(exposed_s=math.nan)], []).decode()
    assert "Speed of impact" not in text
    assert "From light to brake" not in text
    assert "none" in text
    assert "? to ?" in page.describe("false-positives", [row(driven_s=0.0)])


# -- the command line -------------------------------------------------------------------------------------------------


def test_a_campaign_on_the_command_line_leaves_table_report_and_recordings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["drive", "scaled-car", "--runs", "2", "--jobs", "1", "--keep", "1", "--seed", "3", f"--folder={tmp_path}"]
    assert main([*call, *SET, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"runs", "avoidable", "avoided", "collisions", "false_brakes", "hours", "worst"} <= set(found)
    assert found["runs"] == 2
    assert main([*call, *SET]) == 0
    assert "report.html" in capsys.readouterr().out
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "drives.parquet").exists()


def test_one_drive_on_the_command_line_leaves_recording_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = [f"--record={tmp_path / 'd.mcap'}", f"--report={tmp_path / 'd.html'}"]
    settings = tmp_path / "s.toml"
    settings.write_text("[drive]\nfriction = 0.6\nrun_in_s = 0.2\n")
    call = ["drive", "approach-box", *SET, f"--config={settings}", "--preset=scaled_car", "--fault=late,value=0.01"]
    assert main([*call, *made, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["timeline"]["time_s"][0] == -0.2
    assert main(["run", str(tmp_path / "d.mcap"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == found["frames"]
    assert "Drive: approach-box" in (tmp_path / "d.html").read_text()


def test_a_drive_of_a_campaign_is_repeated_by_its_number(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", "scaled-car", "--seed", "3", "--number", "1", *SET, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    (there,) = [each for each in run.finished(whole) if each["number"] == 1]
    assert again["frames"] == there["frames"]
    assert again["braked_s"] == pytest.approx(there["braked_s"]) or not math.isfinite(there["braked_s"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["approach-box", "--runs", "3"], "--runs is for a campaign"),
        (["approach-box", "--jobs", "2"], "--jobs is for a campaign"),
        (["approach-box", "--scheduler", "tcp://127.0.0.1:1"], "--scheduler is for a campaign"),
        (["approach-box", "--fault", "lightning"], "lightning"),
        (["scaled-car", "--fault", "late"], "--fault is for a scenario"),
        (["scaled-car", "--record", "x.mcap"], "--record needs --number"),
        (["scaled-car", "--runs", "0"], "at least 1"),
        (["scaled-car", "--keep", "-1"], "at least 1"),
        (["scaled-cat"], "unknown scenario"),
    ],
)
def test_a_wrong_call_is_told(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", *arguments]) == 2
    assert words in capsys.readouterr().err
