"""A process that is to be in time: before others on the processor, and without pauses to collect garbage."""

import ctypes
import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import wait

_TASKS = "/proc/self/task"
_NICE = -15
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _LARGEST = -1, -3, 1 << 30  # of glibc's mallopt
_CURRENT, _FUTURE = 1, 2  # of mlockall


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


def sooner() -> None:
    """Give this process a larger share of the time while it starts, where that is permitted; others go on."""
    with suppress(OSError, AttributeError):
        for thread in _threads():
            _share(thread, 0)


def keep_memory() -> None:
    """Keep this process's memory where it is, and what it frees for what it needs next, where that is permitted.

    A page that has to be fetched, or made empty by a host below, costs milliseconds: images come and go by megabytes.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        for option in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
            library.mallopt(option, _LARGEST)
        library.mlockall(_CURRENT | _FUTURE)


def end_with_parent() -> None:
    """Let this process be killed when the one that started it ends, however that comes.

    Whoever runs before all others would go on for ever if the one who ends it was killed. A thread waits for that.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os.kill(os.getpid(), signal.SIGKILL)


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
