"""How two functions are timed against each other: in turn, in one process, on one thread, medians of many."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Row:
    """One line of the table: milliseconds of ours, of the peer (None where it is not installed), and peer over ours."""

    work: str
    ms: float
    peer: str
    peer_ms: float | None

    @property
    def ratio(self) -> float | None:
        """How many times faster ours is; None without a peer."""
        return None if self.peer_ms is None else self.peer_ms / self.ms


def race(work: str, ours: Callable[[], Any], peer: str, theirs: Callable[[], Any] | None, seconds: float) -> Row:
    """Run both in turn for about `seconds` and return the medians of this thread's processor time.

    Processor time of the thread, so that other work on the machine does not count; both see the same slow moments.
    """
    for function in (ours, theirs):
        if function is not None:
            for _ in range(3):
                function()
    own: list[float] = []
    other: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(own) < 5:
        own.append(_timed(ours))
        if theirs is not None:
            other.append(_timed(theirs))
    return Row(work, median(own), peer, median(other) if theirs is not None else None)


def _timed(function: Callable[[], Any]) -> float:
    """Return the milliseconds of processor time of one call, averaged over a few where it is very short."""
    repeats = 1
    while True:
        start = time.thread_time_ns()
        for _ in range(repeats):
            function()
        spent_ms = (time.thread_time_ns() - start) / 1e6
        if spent_ms > 0.2 or repeats >= 8:
            return spent_ms / repeats
        repeats *= 8
