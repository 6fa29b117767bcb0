"""A timeline as Perfetto and chrome://tracing open it: the logic analyser of S-CPU-07 and S-DBG-03."""

from typing import Any

from rangecam.embedded.scheduler import Timeline


def trace_events(timeline: Timeline) -> dict[str, Any]:
    """Return the timeline in the JSON trace event format: a track for each unit, an arrow for each interrupt.

    Missed deadlines and skipped runs are instants on the track of their unit. Times in microseconds.
    """
    units = sorted({task.unit for task in timeline.schedule.tasks})
    events: list[dict[str, Any]] = [
        {"ph": "M", "name": "process_name", "pid": 1, "args": {"name": timeline.schedule.name}},
        *({"ph": "M", "name": "thread_name", "pid": 1, "tid": n, "args": {"name": f"CPU {n}"}} for n in units),
    ]
    for span in timeline.spans:
        task = span.job.task
        times = {"ts": span.start_ns / 1e3, "dur": (span.end_ns - span.start_ns) / 1e3}
        what = {"ph": "X", "name": task.name, "cat": "task", "args": {"frame": span.job.frame}}
        events.append({**what, **times, "pid": 1, "tid": span.unit})
    runs = {(job.task.name, job.frame): job for job in timeline.jobs}
    for number, job in enumerate(timeline.jobs):
        place = {"pid": 1, "tid": job.task.unit}
        before = runs.get((job.task.after, job.frame))
        if before is not None and before.ended_ns is not None and job.began_ns is not None:
            arrow = {"name": "interrupt", "cat": "interrupt", "id": number}
            events.append({"ph": "s", **arrow, "pid": 1, "tid": before.task.unit, "ts": before.ended_ns / 1e3})
            events.append({"ph": "f", "bp": "e", **arrow, **place, "ts": job.began_ns / 1e3})
        if job.skipped:
            text = f"{job.task.name} skipped"
            events.append({"ph": "i", "s": "t", "name": text, **place, "ts": job.released_ns / 1e3})
        elif job.ended_ns is not None and job.ended_ns > job.deadline_ns:
            text = f"{job.task.name} late"
            events.append({"ph": "i", "s": "t", "name": text, **place, "ts": job.deadline_ns / 1e3})
    return {"traceEvents": events, "displayTimeUnit": "ms"}
