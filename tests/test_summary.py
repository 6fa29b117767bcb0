"""What a run says of frames that it could not use."""

import dataclasses

import rangecam
from rangecam.pipeline import run
from rangecam.summary import Stopwatch, Summary, describe


def test_a_run_says_how_many_frames_were_repeated_or_late_and_that_the_clock_was_set_back() -> None:
    source = rangecam.open_source("scenario:approach-box", layers=[{"camera": {"rows": 24, "columns": 32}}])
    first, second, third = (capture for capture, _ in zip(source.captures, range(3), strict=False))
    hour_ago = dataclasses.replace(third, raw=dataclasses.replace(third.raw, time_s=third.raw.time_s - 3600.0))
    summary = Summary(source.name, source.config)
    for _ in run([first, third, third, third, second, hour_ago], source.config, [summary]):
        pass
    result = summary.result(Stopwatch())
    assert result["refused"] == {"repeated": 2, "late": 1, "clock_set_back": 1}
    assert result["ignored_segments"] == 0
    assert "not used   2 repeated frames, 1 late frame, clock set back 1 time" in describe(result)
    assert "1 segment of no finite position" in describe(result | {"ignored_segments": 1})


def test_a_run_whose_frames_were_all_used_says_nothing_of_it() -> None:
    source = rangecam.open_source("scenario:approach-box", layers=[{"camera": {"rows": 24, "columns": 32}}])
    summary = Summary(source.name, source.config)
    for _ in run([capture for capture, _ in zip(source.captures, range(2), strict=False)], source.config, [summary]):
        pass
    assert "not used" not in describe(summary.result(Stopwatch()))
