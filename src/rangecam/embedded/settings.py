"""What a schedule is: tasks on processing units, the camera that starts them, and the buffers between them."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from rangecam.config import parse, read_toml
from rangecam.errors import UsageError, did_you_mean
from rangecam.settings import NonNegative, NonNegativeInt, Positive, PositiveInt, settings

CAMERA = "camera"
"""What the first task of a frame comes after."""


@settings
class Task:
    """Something that a processing unit does, again and again."""

    name: str
    """What people call it; each name once."""
    unit: NonNegativeInt
    """Number of the processing unit (CPU) that it runs on."""
    time_s: Positive
    """How long one run computes, at least."""
    spread_s: NonNegative = 0.0
    """How much longer it may compute, by what it finds in the data (S-CPU-08)."""
    after: str = ""
    """What starts it, by an interrupt: "camera" for a new frame in memory, or another task; empty: `period_s`."""
    period_s: Positive | None = None
    """It is started this often instead."""
    delay_s: NonNegative = 0.0
    """From what starts it to when it can run: the interrupt, and copying through the shared memory."""
    priority: int = 1
    """A task with a greater number interrupts one with a smaller; equal ones share the unit in slices of time."""
    slots: PositiveInt = 1
    """Runs of it that may wait or be under way; what comes beyond is skipped: no buffer is free (S-CPU-06)."""
    deadline_s: Positive | None = None
    """From its start until it must be done; none: until the next frame, or the next of its own period."""
    optional: bool = False
    """Debug data: what it misses is no fault."""


@settings
class Memory:
    """A memory of the microcontroller."""

    name: str
    kbytes: Positive
    """Size, in units of 1024 bytes."""


@settings
class Buffer:
    """Data that must lie in one memory; all numbers multiplied."""

    name: str
    memory: str
    """Name of the memory."""
    bytes: NonNegativeInt = 0
    """Size of one; none: an image of `bytes_per_pixel`."""
    bytes_per_pixel: NonNegativeInt = 2
    """Of an image of the camera's rows and columns."""
    count: PositiveInt = 1
    """How many of it."""


@settings
class Schedule:
    """Tasks, the camera that starts them, and where their data lie."""

    name: str = "schedule"
    """The name of its file."""
    description: str = ""
    """What it is, in a phrase for people."""
    frame_rate_hz: Positive = 30.0
    rows: PositiveInt = 120
    columns: PositiveInt = 160
    exposures: PositiveInt = 4
    """Phase images of a frame; the interrupt comes after the last (S-PIF-02)."""
    illumination_time_s: NonNegative = 2e-3
    readout_time_s: NonNegative = 1.23e-3
    """Of one phase image; measured (E-S-14)."""
    slice_s: Positive = 1e-3
    """Slice of time that tasks of equal priority get in turn; *open*: the usual tick of the operating system."""
    clock_hz: Positive = 300e6
    """Of the processing units."""
    tasks: tuple[Task, ...] = ()
    memories: tuple[Memory, ...] = ()
    buffers: tuple[Buffer, ...] = ()


def capture_time_s(schedule: Schedule) -> float:
    """Return how long the exposures of a frame and their read-out take (N-S-019)."""
    return schedule.exposures * (schedule.illumination_time_s + schedule.readout_time_s)


def schedule_names() -> list[str]:
    """Return the names of the schedules that ship with rangecam, sorted."""
    entries = files("rangecam").joinpath("embedded", "schedules").iterdir()
    return sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml"))


def load_schedule(name: str | Path) -> Schedule:
    """Return the schedule of that name, or of a file NAME.toml; raises UsageError for one that cannot be."""
    text = str(name)
    if text.endswith(".toml"):
        return checked(_parsed(Path(text).stem, read_toml(text)))
    known = schedule_names()
    if text not in known:
        near = did_you_mean(text, known)
        raise UsageError(f"unknown schedule '{text}'{near}; schedules: {', '.join(known)}, or a file NAME.toml")
    found = files("rangecam").joinpath("embedded", "schedules", f"{text}.toml").read_text("utf-8")
    return checked(_parsed(text, tomllib.loads(found)))


def _parsed(name: str, values: Mapping[str, Any]) -> Schedule:
    schedule = parse(Schedule, {"name": name, **values}, f"schedule '{name}'")
    if not schedule.memories:
        from rangecam.embedded.memory import MEMORIES

        schedule = replace(schedule, memories=MEMORIES)
    return schedule


def checked(schedule: Schedule) -> Schedule:
    """Return the schedule if its tasks can run: each named once, and started by the camera, a task, or its period."""
    where, names = f"schedule '{schedule.name}'", [task.name for task in schedule.tasks]
    if not names:
        raise UsageError(f"{where}: there are no tasks in it; write [[tasks]] with name, unit, time_s and after")
    for task in schedule.tasks:
        if names.count(task.name) > 1 or task.name == CAMERA:
            raise UsageError(f"{where}: task '{task.name}': this name is there already; give each task its own")
        if bool(task.after) == (task.period_s is not None):
            raise UsageError(f"{where}: task '{task.name}': say either what it comes after or its period_s")
        if task.after and task.after not in (CAMERA, *names):
            near = did_you_mean(task.after, [CAMERA, *names])
            raise UsageError(f"{where}: task '{task.name}' comes after '{task.after}', which is not there{near}")
        if task.after and not started_by_camera(schedule, task) and _cycle(schedule, task):
            raise UsageError(f"{where}: task '{task.name}' comes after itself")
    if 1 / schedule.frame_rate_hz < capture_time_s(schedule):
        raise UsageError(
            f"{where}: frame_rate_hz = {schedule.frame_rate_hz:g}: {schedule.exposures} exposures and read-outs leave "
            f"no more than {1 / capture_time_s(schedule):.4g}"
        )
    return schedule


def _chain(schedule: Schedule, task: Task) -> list[Task]:
    """Return the tasks that lead to this one, itself last; stops where a task comes again."""
    by_name, chain = {each.name: each for each in schedule.tasks}, [task]
    while (before := by_name.get(chain[0].after)) is not None and before not in chain:
        chain.insert(0, before)
    return chain


def _cycle(schedule: Schedule, task: Task) -> bool:
    return _chain(schedule, task)[0].after not in ("", CAMERA)


def started_by_camera(schedule: Schedule, task: Task) -> bool:
    """Return whether this task runs once for each frame."""
    return _chain(schedule, task)[0].after == CAMERA
