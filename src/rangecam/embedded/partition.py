"""A chain of stages shared among processing units so that the busiest has as little to do as possible."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise

from rangecam.embedded.settings import Schedule, Task, started_by_camera
from rangecam.errors import UsageError


def best_partition(times_s: Sequence[float], units: int) -> list[int]:
    """Return the unit, from 0 on, of each stage of a chain: parts that stay together, the longest as short as can be.

    Of equally good ones the first. Raises UsageError without stages or units.
    """
    n = len(times_s)
    if not n or units < 1:
        raise UsageError("a partition needs stages and processing units")
    cuts = (c for k in range(min(units, n)) for c in combinations(range(1, n), k))

    def longest(cut: tuple[int, ...]) -> float:
        edges = (0, *cut, n)
        return max(sum(times_s[a:b]) for a, b in pairwise(edges))

    best = min(cuts, key=longest)
    return [sum(stage >= cut for cut in best) for stage in range(n)]


def repartitioned(schedule: Schedule, order: Sequence[int] = (1, 2, 0)) -> Schedule:
    """Return the schedule without debug data and with the tasks of each frame on the units that share them best.

    order: units by their place in the pipeline. The chain must be one: each task after the one before it. Equal tasks
    stay in their order by the deadlines of the pipeline: each has its whole frame period.
    """
    chain = [task for task in schedule.tasks if started_by_camera(schedule, task) and not task.optional]
    for before, task in pairwise(chain):
        if task.after != before.name:
            raise UsageError(f"task '{task.name}' does not come after '{before.name}': only a chain can be shared")
    places = best_partition([task.time_s + task.spread_s for task in chain], len(order))
    moved = [replace(task, unit=order[place]) for task, place in zip(chain, places, strict=True)]
    others = [task for task in schedule.tasks if not started_by_camera(schedule, task)]
    tasks: tuple[Task, ...] = (*moved, *others)
    return replace(schedule, name=f"{schedule.name}, shared evenly", tasks=tasks)
