"""The embedded view: schedules against closed forms, memories against the tables, traces against their format."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rangecam.cli import main
from rangecam.embedded import analyse, highest_frame_rate_hz, load_schedule, run_schedule, schedule_names
from rangecam.embedded.linker import LINKER, Region, disagreements, misplaced, overlaps
from rangecam.embedded.measured import with_measured_stages
from rangecam.embedded.memory import MEMORIES, placements
from rangecam.embedded.partition import best_partition, repartitioned
from rangecam.embedded.results import frame_rate_bound_hz, slots_in_use
from rangecam.embedded.settings import Buffer, Memory, Schedule, Task, capture_time_s, checked
from rangecam.embedded.trace import trace_events
from rangecam.errors import UsageError

MS = 1e-3
AT_ONCE: dict[str, Any] = {"illumination_time_s": 0.0, "readout_time_s": 0.0}


def schedule(*tasks: Task, rate_hz: float = 50.0, **more: Any) -> Schedule:
    return checked(Schedule(frame_rate_hz=rate_hz, tasks=tasks, **{**AT_ONCE, **more}))


def spans(found: Any, name: str) -> list[tuple[float, float]]:
    """When a task ran, ms."""
    return [(s.start_ns / 1e6, s.end_ns / 1e6) for s in found.spans if s.job.task.name == name]


def chain(*times_ms: float, **more: Any) -> list[Task]:
    names = ["camera", *(f"stage {k}" for k in range(len(times_ms)))]
    return [Task(name=names[k + 1], unit=k, time_s=t * MS, after=names[k], **more) for k, t in enumerate(times_ms)]


# -- who runs when -----------------------------------------------------------------------------------------------------


def test_a_frame_passes_from_unit_to_unit_while_the_next_follows() -> None:
    found = run_schedule(schedule(*chain(12, 15, 1)), 2)
    assert spans(found, "stage 0") == [(0, 12), (20, 32)]
    assert spans(found, "stage 1") == [(12, 27), (32, 47)]
    assert spans(found, "stage 2") == [(27, 28), (47, 48)]
    assert analyse(found).latency_s == pytest.approx((28 * MS, 28 * MS))


def test_the_interrupt_comes_after_the_last_read_out() -> None:
    lit = schedule(*chain(5), illumination_time_s=1e-3, readout_time_s=1.23e-3)
    assert capture_time_s(lit) == pytest.approx(8.92e-3)
    assert spans(run_schedule(lit, 1), "stage 0") == [(8.92, 13.92)]


def test_a_more_urgent_task_interrupts_at_once_and_the_other_goes_on_where_it_was() -> None:
    low = Task(name="low", unit=0, time_s=10 * MS, after="camera")
    high = Task(name="high", unit=0, time_s=2 * MS, after="camera", delay_s=4 * MS, priority=2)
    found = run_schedule(schedule(low, high), 1)
    assert spans(found, "low") == [(0, 4), (6, 12)]
    assert spans(found, "high") == [(4, 6)]


def test_equally_urgent_tasks_take_turns_and_a_lone_one_is_not_disturbed() -> None:
    pair = [Task(name=name, unit=0, time_s=t * MS, after="camera") for name, t in (("a", 3), ("b", 2))]
    found = run_schedule(schedule(*pair), 1)
    assert spans(found, "a") == [(0, 1), (2, 3), (4, 5)]
    assert spans(found, "b") == [(1, 2), (3, 4)]
    assert len(run_schedule(schedule(pair[0]), 1).spans) == 1


def test_an_interrupted_task_comes_before_others_of_its_urgency() -> None:
    tasks = [
        Task(name="a", unit=0, time_s=3 * MS, after="camera"),
        Task(name="b", unit=0, time_s=1 * MS, after="camera", delay_s=0.2 * MS),
        Task(name="urgent", unit=0, time_s=1 * MS, after="camera", delay_s=0.5 * MS, priority=9),
    ]
    found = run_schedule(schedule(*tasks, slice_s=10 * MS), 1)
    assert spans(found, "a") == [(0, 0.5), (1.5, 4)]
    assert spans(found, "b") == [(4, 5)]


def test_what_finds_no_free_buffer_is_skipped_and_debug_data_are_no_fault() -> None:
    slow = replace(chain(30)[0], optional=True)
    found = analyse(run_schedule(schedule(slow), 10))
    assert found.skipped == {"stage 0": 5}
    assert found.faults == 0
    waits = analyse(run_schedule(schedule(replace(slow, slots=2, optional=False)), 10))
    assert waits.skipped["stage 0"] < 5
    assert waits.faults > 0


def test_a_frame_whose_stage_was_skipped_is_lost() -> None:
    found = analyse(run_schedule(schedule(*chain(30)), 4))
    assert [np.isnan(each) for each in found.latency_s] == [False, True, False, True]


def test_a_late_run_is_a_missed_deadline() -> None:
    early, late = (analyse(run_schedule(schedule(replace(chain(5)[0], deadline_s=d * MS)), 3)) for d in (5, 4.9))
    assert (early.missed["stage 0"], early.faults) == (0, 0)
    assert (late.missed["stage 0"], late.faults) == (3, 3)


def test_a_periodic_task_has_its_own_period_as_deadline() -> None:
    periodic = Task(name="tick", unit=0, time_s=6 * MS, period_s=5 * MS, slots=9)
    found = analyse(run_schedule(schedule(periodic, *chain(1)), 2))
    assert found.missed["tick"] > 0
    assert found.unit_load[0] == pytest.approx(1.0)


def test_loads_are_times_over_periods() -> None:
    tick = Task(name="tick", unit=0, time_s=1 * MS, period_s=10 * MS)
    found = analyse(run_schedule(schedule(*chain(4, 8), tick), 20))
    assert found.task_load == pytest.approx({"stage 0": 0.2, "stage 1": 0.4, "tick": 0.1})
    assert found.unit_load == pytest.approx({0: 0.3, 1: 0.4})


def test_times_with_a_spread_are_drawn_within_it_and_the_longest_without_a_generator() -> None:
    spread = schedule(replace(chain(4)[0], spread_s=2 * MS))
    drawn = [b - a for a, b in spans(run_schedule(spread, 200, np.random.default_rng(1)), "stage 0")]
    assert 4 <= min(drawn) < 4.1
    assert 5.9 < max(drawn) <= 6
    assert np.mean(drawn) == pytest.approx(5.0, abs=0.15)
    assert {b - a for a, b in spans(run_schedule(spread, 3), "stage 0")} == {6.0}


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_time_is_lost_or_made_and_no_unit_runs_two_tasks(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 5))
    tasks = []
    for k in range(count):
        after = data.draw(st.sampled_from(["camera", *(t.name for t in tasks)]))
        time_s = data.draw(st.integers(1, 30)) * MS
        priority, unit = data.draw(st.integers(1, 3)), data.draw(st.integers(0, 2))
        tasks.append(Task(name=f"t{k}", unit=unit, time_s=time_s, after=after, priority=priority, slots=2))
    found = run_schedule(schedule(*tasks), 6)
    for unit in {task.unit for task in tasks}:
        mine = sorted((s.start_ns, s.end_ns) for s in found.spans if s.unit == unit)
        assert all(a[1] <= b[0] for a, b in pairwise(mine))
    for job in found.jobs:
        ran = sum(s.end_ns - s.start_ns for s in found.spans if s.job is job)
        assert ran == (0 if job.skipped else round(job.task.time_s * 1e9))
        assert job.skipped or (
            job.ended_ns is not None and job.began_ns is not None and job.began_ns >= job.released_ns
        )


# -- how fast the camera may be ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("times", [(12.0, 5.0, 1.0), (3.0, 14.0, 2.0), (8.0, 8.0, 8.0)])
def test_the_longest_stage_of_a_pipeline_limits_the_frame_rate(times: tuple[float, ...]) -> None:
    assert highest_frame_rate_hz(schedule(*chain(*times))) == pytest.approx(1e3 / max(times), rel=2e-3)


def test_periodic_tasks_and_the_camera_limit_it_too() -> None:
    tick = Task(name="tick", unit=0, time_s=1 * MS, period_s=4 * MS, priority=2)
    assert frame_rate_bound_hz(schedule(*chain(12), tick)) == pytest.approx(0.75 / 12e-3)
    assert highest_frame_rate_hz(schedule(*chain(12), tick)) <= 0.75 / 12e-3
    lit = schedule(*chain(1), illumination_time_s=2e-3, readout_time_s=1.23e-3)
    assert highest_frame_rate_hz(lit) == pytest.approx(77.4, abs=0.05)  # N-S-019.2


def test_a_schedule_that_never_works_has_no_frame_rate() -> None:
    assert highest_frame_rate_hz(schedule(replace(chain(5)[0], deadline_s=1 * MS))) == 0.0
    busy = Task(name="tick", unit=0, time_s=4 * MS, period_s=4 * MS)
    assert highest_frame_rate_hz(schedule(*chain(5), busy)) == 0.0


def test_n_s_034_the_thesis_schedule_ends_at_35_hz_and_an_even_share_reaches_60() -> None:
    thesis = load_schedule("thesis")
    assert highest_frame_rate_hz(thesis) == pytest.approx(35, abs=0.1)
    assert highest_frame_rate_hz(repartitioned(thesis)) >= 60
    assert thesis.clock_hz / (thesis.rows * thesis.columns) / 35 == pytest.approx(446.4, abs=0.05)


def test_n_s_049_three_two_and_one_buffers_keep_the_debug_data() -> None:
    full = schedule(*chain(19.99, 19.99, 19.99))
    assert [*slots_in_use(run_schedule(full, 12)).values()] == [3, 2, 1]
    assert [*slots_in_use(run_schedule(schedule(*chain(5, 5, 5)), 12)).values()] == [1, 1, 1]
    assert slots_in_use(run_schedule(schedule(Task(name="t", unit=0, time_s=MS, period_s=1.0)), 1)) == {}


def brute_force(times: list[float], units: int) -> float:
    """Smallest longest part, by trying every assignment that keeps the order."""
    if units == 1 or len(times) == 1:
        return sum(times)
    return min([sum(times), *(max(sum(times[:k]), brute_force(times[k:], units - 1)) for k in range(1, len(times)))])


@given(st.lists(st.integers(1, 50), min_size=1, max_size=7), st.integers(1, 4))
def test_no_other_partition_has_a_shorter_longest_part(times: list[int], units: int) -> None:
    places = best_partition([float(t) for t in times], units)
    assert places == sorted(places)
    assert max(places) < units
    longest = max(sum(t for t, place in zip(times, places, strict=True) if place == k) for k in set(places))
    assert longest == brute_force([float(t) for t in times], units)


def test_what_cannot_be_shared_is_refused() -> None:
    with pytest.raises(UsageError, match="stages and processing units"):
        best_partition([], 3)
    fork = [*chain(1, 2), Task(name="other", unit=0, time_s=MS, after="stage 0")]
    with pytest.raises(UsageError, match="'other' does not come after 'stage 1'"):
        repartitioned(schedule(*fork))


def test_measured_stages_go_where_the_thesis_has_them() -> None:
    seconds = {"ranging": [1e-3] * 99 + [5e-3], "own": [2e-3] * 100, "segmentation": [1e-3] * 100, "decision": [1e-4]}
    found = with_measured_stages(load_schedule("thesis"), seconds)
    assert [(t.name, t.unit) for t in found.tasks if t.after] == [
        ("ranging", 1),
        ("own", 1),
        ("segmentation", 2),
        ("decision", 0),
    ]
    assert found.tasks[0].time_s == pytest.approx(1e-3)
    assert found.tasks[0].spread_s == pytest.approx(np.percentile(seconds["ranging"], 99) - 1e-3)
    assert not analyse(run_schedule(found, 10)).faults
    with pytest.raises(UsageError, match="no stage was measured"):
        with_measured_stages(found, {})


# -- memories ----------------------------------------------------------------------------------------------------------


def test_n_s_032_and_033_memories_and_the_linkers_map() -> None:
    sizes = {memory.name: memory.kbytes for memory in MEMORIES}
    assert [sizes[name] for name in ("DSPR0", "DSPR1", "DSPR2", "LMU", "DFLASH", "PFLASH")] == [
        120,
        240,
        240,
        32,
        768,
        8192,
    ]
    assert sizes["ADM"] + sizes["XAM"] == 2048
    assert sizes["LMU"] * 1024 < 38400
    assert sizes["DSPR1"] * 1024 / 38400 == pytest.approx(6.4)
    assert disagreements() == {"DFLASH": (1104 * 1024, 768 * 1024)}  # E-S-23
    assert LINKER["DMI_DSPR1_EX"].origin % 0x10000000 == 0x5000 == 20 * 1024
    assert overlaps() == []
    assert misplaced() == []


def test_a_map_with_faults_is_found_out() -> None:
    wrong = {**LINKER, "PMU_PFLASH0": Region(0x80000000, 3 << 20), "DMI_DSPR1_EX": Region(0x60004000, 220 << 10)}
    assert overlaps(wrong) == [("PMU_PFLASH0", "PMU_PFLASH1")]
    assert misplaced(wrong) == ["DMI_DSPR1_EX"]
    assert disagreements(wrong)["PFLASH"] == (9 << 20, 8 << 20)


def test_every_buffer_of_the_thesis_fits_and_a_larger_camera_does_not() -> None:
    thesis = load_schedule("thesis")
    rows = {row.memory: row for row in placements(thesis)}
    assert all(row.fits for row in rows.values())
    assert rows["ADM"].used == 153600
    assert rows["XAM"].used == (1 + 12 + 2 + 4) * 38400
    large = {row.memory for row in placements(replace(thesis, rows=240, columns=320)) if not row.fits}
    assert large == {"DSPR0", "DSPR1", "DSPR2", "XAM"}


def test_a_buffer_in_no_memory_is_named() -> None:
    lost = schedule(*chain(1), memories=(Memory(name="RAM", kbytes=1),), buffers=(Buffer(name="b", memory="RAN"),))
    with pytest.raises(UsageError, match="no memory 'RAN'; did you mean 'RAM'"):
        placements(lost)


# -- files, traces, the command line -----------------------------------------------------------------------------------

ONE = '[[tasks]]\nname = "a"\nunit = 0\ntime_s = 1e-3\nafter = "camera"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "there are no tasks in it"),
        (ONE + ONE, "task 'a': this name is there already"),
        (ONE.replace('"a"', '"camera"'), "task 'camera': this name"),
        (ONE + "period_s = 1.0", "either what it comes after or its period_s"),
        (ONE.replace('after = "camera"', ""), "either what it comes after or its period_s"),
        (ONE.replace('"camera"', '"camra"'), "'camra', which is not there; did you mean 'camera'"),
        (ONE.replace('"camera"', '"a"'), "task 'a' comes after itself"),
        ("frame_rate_hz = 90.0\n" + ONE, "no more than 77.4"),
        ("frame_rate = 90.0\n" + ONE, "unknown setting 'frame_rate'"),
        (ONE.replace("1e-3", "-1.0"), "time_s"),
        ("[[tasks", "not a TOML file"),
    ],
)
def test_schedules_that_cannot_run_are_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        load_schedule(path)


def test_schedules_ship_and_an_unknown_one_is_named_with_the_nearest() -> None:
    assert schedule_names() == ["earlier-platform", "thesis"]
    for name in schedule_names():
        assert not analyse(run_schedule(load_schedule(name), 10)).faults
    with pytest.raises(UsageError, match="did you mean 'thesis'"):
        load_schedule("thesiss")


def test_a_trace_holds_every_span_and_pairs_of_arrows() -> None:
    late = replace(chain(5)[0], name="late", deadline_s=1 * MS)
    slow = Task(name="slow", unit=1, time_s=30 * MS, after="late")
    found = run_schedule(schedule(late, slow), 4)
    events = trace_events(found)["traceEvents"]
    json.dumps(events, allow_nan=False)
    assert sum(e["dur"] for e in events if e["ph"] == "X" and e["name"] == "late") == pytest.approx(4 * 5000)
    starts, ends = ([e["id"] for e in events if e["ph"] == ph] for ph in "sf")
    assert starts == ends
    assert len(starts) == 2
    assert [e["name"] for e in events if e["ph"] == "i"].count("late late") == 4
    assert [e["name"] for e in events if e["ph"] == "i"].count("slow skipped") == 2
    assert {e["args"]["name"] for e in events if e["ph"] == "M"} == {"schedule", "CPU 0", "CPU 1"}


def test_the_command_says_where_the_limit_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = tmp_path / "out.json"
    assert main(["embedded", "--frames", "10", "--trace", str(trace)]) == 0
    out = capsys.readouterr().out
    assert "limit      35.0 frames a second" in out
    assert f"trace      {trace}" in out
    assert json.loads(trace.read_text())["traceEvents"]
    assert main(["embedded", "--share", "--frame-rate", "60", "--random", "--frames", "10", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["faults"], result["lost_frames"], result["frame_rate_hz"]) == (0, 0, 60.0)
    assert result["tasks"]["median"]["unit"] == 2
    assert all(row["fits"] for row in result["memory"])
    assert main(["embedded", "--frame-rate", "50", "--frames", "10"]) == 0
    assert "skipped" in capsys.readouterr().out


def test_the_command_measures_this_machine(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["embedded", "--measure", "scenario:test-scene", "--frames", "5", "--json"]) == 0
    assert {"ranging", "segmentation", "decision"} <= {*json.loads(capsys.readouterr().out)["tasks"]}


def test_a_memory_that_overflows_is_shouted_and_lost_frames_have_no_latency(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    buffer = '[[buffers]]\nname = "b"\nmemory = "LMU"\n'
    (tmp_path / "mine.toml").write_text(ONE + ONE.replace('"a"', '"b"').replace("1e-3", "9.0") + buffer)
    assert main(["embedded", str(tmp_path / "mine.toml"), "--frames", "1"]) == 0
    assert "LMU        38400 of    32768 bytes   DOES NOT FIT" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--frames", "0"], "expected one or more"),
        (["--frame-rate", "0"], "expected a number above zero"),
        (["--frame-rate", "200"], "no more than 77.4"),
        (["--trace", "nowhere/out.json"], "folder nowhere does not exist"),
    ],
)
def test_calls_that_cannot_be_are_named(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["embedded", *arguments]) == 2
    assert words in capsys.readouterr().err
