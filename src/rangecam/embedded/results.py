"""What a timeline says: utilisation, latency, missed deadlines, buffers in use, and how fast the camera may be."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rangecam.embedded.scheduler import Timeline, run_schedule
from rangecam.embedded.settings import Schedule, capture_time_s, started_by_camera

_FILL = 3
"""Frames until the pipeline is full: they do not count for the utilisation."""


@dataclass(frozen=True)
class Analysis:
    """What a timeline comes to.

    unit_load, task_load: share of the time that a unit is busy, and that a task computes. latency_s: of each frame,
    from the beginning of its first exposure to the end of its last task that is not optional; NaN where it was lost.
    missed, skipped: number of runs of each task that ended too late, and that found no free buffer. faults: how many of
    these are not of optional tasks. slots: buffers of each task that are in use at once by frames (S-CPU-06).
    """

    unit_load: dict[int, float]
    task_load: dict[str, float]
    latency_s: tuple[float, ...]
    missed: dict[str, int]
    skipped: dict[str, int]
    faults: int
    slots: dict[str, int]


def analyse(timeline: Timeline) -> Analysis:
    """Return what a timeline comes to."""
    schedule = timeline.schedule
    names = [task.name for task in schedule.tasks]
    missed, skipped, faults = dict.fromkeys(names, 0), dict.fromkeys(names, 0), 0
    for job in timeline.jobs:
        late = job.ended_ns is not None and job.ended_ns > job.deadline_ns
        missed[job.task.name] += late
        skipped[job.task.name] += job.skipped
        faults += (late or job.skipped) and not job.task.optional
    task_load = _loads(timeline)
    units = sorted({task.unit for task in schedule.tasks})
    unit_load = {n: sum(task_load[task.name] for task in schedule.tasks if task.unit == n) for n in units}
    return Analysis(unit_load, task_load, _latencies_s(timeline), missed, skipped, faults, slots_in_use(timeline))


def _loads(timeline: Timeline) -> dict[str, float]:
    """Return the share of time that each task computes once the pipeline is full."""
    schedule, n = timeline.schedule, timeline.n_frames
    first = min(_FILL, n - 1)
    start, end = (1e9 * (capture_time_s(schedule) + k / schedule.frame_rate_hz) for k in (first, n))
    loads = {task.name: 0.0 for task in schedule.tasks}
    for span in timeline.spans:
        loads[span.job.task.name] += max(0.0, min(span.end_ns, end) - max(span.start_ns, start)) / (end - start)
    return loads


def _latencies_s(timeline: Timeline) -> tuple[float, ...]:
    schedule = timeline.schedule
    needed = {task.name for task in schedule.tasks if not task.optional and started_by_camera(schedule, task)}
    ends: dict[int, list[int | None]] = {frame: [] for frame in range(timeline.n_frames)}
    for job in timeline.jobs:
        if job.task.name in needed:
            ends[job.frame].append(job.ended_ns)
    return tuple(
        max(e for e in each if e is not None) / 1e9 - frame / schedule.frame_rate_hz
        if needed and len(each) == len(needed) and None not in each
        else math.nan
        for frame, each in ends.items()
    )


def slots_in_use(timeline: Timeline) -> dict[str, int]:
    """Return, by task, how many frames' worth of its output must be kept until the last task has collected them.

    A task writes the debug data of a frame from when it begins; the last task that is not optional collects those of
    all tasks when it ends (4.4.4). With every stage as long as the frame period a chain of three needs 3, 2 and 1
    (N-S-049).
    """
    schedule = timeline.schedule
    chain = [task for task in schedule.tasks if not task.optional and started_by_camera(schedule, task)]
    if not chain:
        return {}
    last = chain[-1].name
    collected = {job.frame: job.ended_ns for job in timeline.jobs if job.task.name == last and job.ended_ns is not None}
    slots = {}
    for task in chain:
        begun = [(job.frame, job.began_ns) for job in timeline.jobs if job.task is task and job.began_ns is not None]
        slots[task.name] = max(
            (sum(frame >= k and began < ended for frame, began in begun) for k, ended in collected.items()),
            default=0,
        )
    return slots


def frame_rate_bound_hz(schedule: Schedule) -> float:
    """Return the frame rate that no schedule of these tasks on these units can exceed: each unit is busy all the time.

    Of tasks that run for every frame and are not optional, at their longest, beside the periodic ones; and no more than
    the camera can do.
    """
    bound = 1 / capture_time_s(schedule) if capture_time_s(schedule) > 0 else math.inf
    for unit in {task.unit for task in schedule.tasks}:
        mine = [task for task in schedule.tasks if task.unit == unit and not task.optional]
        frame_s = sum(task.time_s + task.spread_s for task in mine if started_by_camera(schedule, task))
        periodic = sum((task.time_s + task.spread_s) / task.period_s for task in mine if task.period_s)
        if frame_s:
            bound = min(bound, max(0.0, 1 - periodic) / frame_s)
    return bound


def highest_frame_rate_hz(schedule: Schedule, n_frames: int = 40, tolerance: float = 1e-3) -> float:
    """Return the highest frame rate at which no task that is not optional misses a deadline or finds no buffer.

    Each run takes as long as it may. Found by halving an interval between a rate that works and `frame_rate_bound_hz`,
    down to the relative tolerance; 0 if not even a 16th of the bound works.
    """
    high = frame_rate_bound_hz(schedule)
    low = high / 16

    def works(rate_hz: float) -> bool:
        return not analyse(run_schedule(replace(schedule, frame_rate_hz=rate_hz), n_frames)).faults

    if high <= 0 or not works(low):
        return 0.0
    if works(high):
        return high
    while high - low > tolerance * high:
        middle = (low + high) / 2
        low, high = (middle, high) if works(middle) else (low, middle)
    return low


def as_json(timeline: Timeline, memory: Iterable[Any]) -> dict[str, Any]:
    """Return the analysis, the highest frame rate and the placement in memory as JSON values."""
    found, schedule = analyse(timeline), timeline.schedule
    latencies = np.array([each for each in found.latency_s if math.isfinite(each)])
    return {
        "schedule": schedule.name,
        "frame_rate_hz": schedule.frame_rate_hz,
        "frames": timeline.n_frames,
        "lost_frames": sum(not math.isfinite(each) for each in found.latency_s),
        "latency_ms": {
            name: round(1e3 * float(function(latencies)), 4) if latencies.size else None
            for name, function in (("min", np.min), ("mean", np.mean), ("max", np.max))
        },
        "units": {str(n): round(load, 6) for n, load in found.unit_load.items()},
        "tasks": {
            task.name: {
                "unit": task.unit,
                "load": round(found.task_load[task.name], 6),
                "missed": found.missed[task.name],
                "skipped": found.skipped[task.name],
                **({"slots": found.slots[task.name]} if task.name in found.slots else {}),
            }
            for task in schedule.tasks
        },
        "faults": found.faults,
        "highest_frame_rate_hz": round(highest_frame_rate_hz(schedule), 3),
        "bound_hz": round(frame_rate_bound_hz(schedule), 3),
        "memory": [
            {"memory": row.memory, "used_bytes": row.used, "bytes": row.size, "fits": row.fits} for row in memory
        ],
    }
