"""A process that is to be in time: before others on the processor, and without pauses to collect garbage."""

import gc
import os
from collections.abc import Callable

_TASKS = "/proc/self/task"
_NICE = -15


def prompt(level: int) -> str:
    """Let all threads of this process run before usual ones; return what was permitted.

    "real-time": as soon as they can run, before those of a lower `level` (1 to 99; of Linux, SCHED_FIFO; not passed on
    to children). "priority": with a larger share of the time. "usual": neither is permitted to this user or known
    here. All objects there are stay out of the collection of garbage from now on; new ones are collected in no time.
    """
    gc.collect()
    gc.freeze()
    for name, attempt in _WAYS.items():
        try:
            for thread in _threads():
                attempt(thread, level)
            return name
        except (OSError, AttributeError):
            continue
    return "usual"


def relaxed() -> None:
    """Take `prompt` back."""
    gc.unfreeze()
    for back in (_share_as_usual, _usual):
        try:
            for thread in _threads():
                back(thread)
        except (OSError, AttributeError):
            continue


def _threads() -> list[int]:
    """Return the threads of this process, each of which has its own priority in Linux."""
    return [int(name) for name in os.listdir(_TASKS)] if os.path.isdir(_TASKS) else [0]


def _first(thread: int, level: int) -> None:
    os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))


def _share(thread: int, level: int) -> None:
    del level
    os.setpriority(os.PRIO_PROCESS, thread, _NICE)


def _usual(thread: int) -> None:
    os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


def _share_as_usual(thread: int) -> None:
    os.setpriority(os.PRIO_PROCESS, thread, 0)


_WAYS: dict[str, Callable[[int, int], None]] = {"real-time": _first, "priority": _share}
