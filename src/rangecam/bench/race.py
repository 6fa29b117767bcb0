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
    """Run blocks of both in turn for about `seconds` and return the medians of this thread's processor time.

    Processor time of the thread, so that other work on the machine does not count; in turn, so that both see the same
    slow moments; in blocks after a call that is not counted, so that neither pays for the caches that the other has
    filled; what takes longer than a block does not see the difference.
    """
    functions = [ours] if theirs is None else [ours, theirs]
    blocks = [_block(function) for function in functions]
    taken: list[list[float]] = [[] for _ in functions]
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(taken[0]) < 5:
        for function, block, times in zip(functions, blocks, taken, strict=True):
            if block > 1:
                function()
            times.append(_timed(function, block))
    return Row(work, median(taken[0]), peer, median(taken[1]) if theirs is not None else None)


def _block(function: Callable[[], Any]) -> int:
    """Return how many calls take about 10 ms, after the first calls have compiled and filled the caches."""
    function()
    if _timed(function, 1) > 10.0:
        return 1
    for _ in range(2):
        function()
    return max(1, round(10.0 / max(_timed(function, 3), 1e-4)))


def _timed(function: Callable[[], Any], calls: int) -> float:
    """Return the milliseconds of processor time of one call, the mean of a block of calls."""
    start = time.thread_time_ns()
    for _ in range(calls):
        function()
    return (time.thread_time_ns() - start) / 1e6 / calls
