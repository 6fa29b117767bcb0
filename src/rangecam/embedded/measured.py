"""A schedule with the times that this machine takes for the stages of the chain."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rangecam.embedded.settings import Schedule, Task
from rangecam.errors import UsageError

UNITS = {
    **dict.fromkeys(("ranging", "clean"), 1),
    **dict.fromkeys(("geometry", "segmentation", "segments", "tracking", "classification"), 2),
    "decision": 0,
}
"""Which processing unit takes which stage, as the thesis has it; a stage not named goes with the one before it."""


def with_measured_stages(schedule: Schedule, seconds: Mapping[str, Sequence[float]]) -> Schedule:
    """Return the schedule with the stages of the chain instead of its own tasks of each frame.

    seconds: of each stage, in order of their call, one for each frame (`summary.Stopwatch`). A task takes the median,
    and may take as long as 99 % of the runs did. Periodic tasks stay. Raises UsageError without measurements.
    """
    if not seconds or not all(len(each) for each in seconds.values()):
        raise UsageError("no stage was measured: the source has no frames")
    tasks: list[Task] = []
    unit = 1
    for name, each in seconds.items():
        unit = UNITS.get(name, unit)
        middle, high = np.percentile(each, [50, 99])
        tasks.append(
            Task(
                name=name,
                unit=unit,
                time_s=float(middle),
                spread_s=float(high - middle),
                after=tasks[-1].name if tasks else "camera",
                priority=3 if unit == 0 else 1,
                slots=2,
            )
        )
    others = [task for task in schedule.tasks if task.period_s is not None]
    return replace(schedule, name="as measured here", tasks=(*tasks, *others), buffers=())
