"""Who runs when: an exact simulation of events, in whole nanoseconds (S-CPU-01, S-CPU-05, S-CPU-06).

Each processing unit runs the waiting task of the highest priority; one of a higher priority interrupts at once, equal
ones take turns of one slice. A task that ends starts those after it, on whatever unit, by an interrupt.
"""

import heapq
from collections import defaultdict, deque
from dataclasses import dataclass, field

import numpy as np

from rangecam.embedded.settings import CAMERA, Schedule, Task, capture_time_s, started_by_camera

_S = 1e9


@dataclass(eq=False)
class Job:
    """One run of a task, times in ns: from when it could run, since when and until when it did; None: skipped.

    frame: number of the frame it belongs to, or of the run of a periodic task. left_ns: still to compute.
    """

    task: Task
    frame: int
    released_ns: int
    deadline_ns: int
    left_ns: int
    began_ns: int | None = None
    ended_ns: int | None = None
    skipped: bool = False


@dataclass(frozen=True)
class Span:
    """A time during which a unit ran one job, ns."""

    unit: int
    job: Job
    start_ns: int
    end_ns: int


@dataclass(frozen=True, eq=False)
class Timeline:
    """What happened: every job, also those skipped, in order of release; every span of running, in order of its end."""

    schedule: Schedule
    n_frames: int
    jobs: list[Job]
    spans: list[Span]


@dataclass(eq=False)
class _Unit:
    number: int
    slice_ns: int
    ready: dict[int, deque[Job]] = field(default_factory=lambda: defaultdict(deque))
    running: Job | None = None
    since_ns: int = 0
    turn_ends_ns: int = 0

    def stops_ns(self) -> int | None:
        """When the running job ends, or its turn if another waits that is as urgent."""
        if self.running is None:
            return None
        ends = self.since_ns + self.running.left_ns
        return min(ends, self.turn_ends_ns) if self.ready.get(self.running.task.priority) else ends

    def put_aside(self, now_ns: int, spans: list[Span]) -> Job | None:
        """Stop the running job, note what it did, and return it."""
        job, self.running = self.running, None
        if job is not None and now_ns > self.since_ns:
            job.left_ns -= now_ns - self.since_ns
            spans.append(Span(self.number, job, self.since_ns, now_ns))
        return job

    def choose(self, now_ns: int, spans: list[Span]) -> None:
        """Let the most urgent job run."""
        top = max((priority for priority, jobs in self.ready.items() if jobs), default=None)
        if top is None:
            return
        if self.running is not None:
            mine = self.running.task.priority
            if mine > top or (mine == top and now_ns < self.turn_ends_ns):
                return
            job = self.put_aside(now_ns, spans)
            assert job is not None
            # interrupted, it goes on first when its turn comes again; at the end of its turn it queues up
            (self.ready[mine].appendleft if top > mine else self.ready[mine].append)(job)
        self.running = self.ready[top].popleft()
        self.since_ns, self.turn_ends_ns = now_ns, now_ns + self.slice_ns
        if self.running.began_ns is None:
            self.running.began_ns = now_ns


def run_schedule(schedule: Schedule, n_frames: int, rng: np.random.Generator | None = None) -> Timeline:
    """Return what `n_frames` frames and the periodic tasks beside them do until the last of them is done.

    Frame k is exposed from k frame periods on. rng: draws how long tasks with a spread compute, evenly within it;
    None: as long as they may.
    """
    period_ns = round(_S / schedule.frame_rate_hz)
    first_ns = round(capture_time_s(schedule) * _S)
    horizon_ns = first_ns + n_frames * period_ns
    queue: list[tuple[int, int, Task, int]] = []  # when, order, task, frame

    def start(task: Task, at_ns: int, frame: int) -> None:
        heapq.heappush(queue, (at_ns + round(task.delay_s * _S), len(jobs) + len(queue), task, frame))

    jobs: list[Job] = []
    spans: list[Span] = []
    after: dict[str, list[Task]] = defaultdict(list)
    for task in schedule.tasks:
        after[task.after].append(task)
        if task.period_s is not None:
            step_ns = round(task.period_s * _S)
            for k, at_ns in enumerate(range(0, horizon_ns, step_ns)):
                start(task, at_ns, k)
    for frame in range(n_frames):
        for task in after[CAMERA]:
            start(task, first_ns + frame * period_ns, frame)
    units = {n: _Unit(n, round(schedule.slice_s * _S)) for n in sorted({task.unit for task in schedule.tasks})}
    open_jobs: dict[str, int] = defaultdict(int)
    while (now_ns := _next_ns(queue, units)) is not None:
        for unit in units.values():
            if unit.running is not None and unit.since_ns + unit.running.left_ns == now_ns:
                job = unit.put_aside(now_ns, spans)
                assert job is not None
                job.ended_ns = now_ns
                open_jobs[job.task.name] -= 1
                for task in after[job.task.name]:
                    start(task, now_ns, job.frame)
        while queue and queue[0][0] == now_ns:
            _, _, task, frame = heapq.heappop(queue)
            job = _released(schedule, task, frame, now_ns, period_ns, rng)
            jobs.append(job)
            if open_jobs[task.name] == task.slots:
                job.skipped = True
                continue
            open_jobs[task.name] += 1
            units[task.unit].ready[task.priority].append(job)
        for unit in units.values():
            unit.choose(now_ns, spans)
    return Timeline(schedule, n_frames, jobs, spans)


def _next_ns(queue: list[tuple[int, int, Task, int]], units: dict[int, _Unit]) -> int | None:
    """Return when something happens next."""
    times = [at for unit in units.values() if (at := unit.stops_ns()) is not None]
    return min([*times, queue[0][0]] if queue else times, default=None)


def _released(
    schedule: Schedule, task: Task, frame: int, now_ns: int, period_ns: int, rng: np.random.Generator | None
) -> Job:
    time_s = task.time_s + task.spread_s * (1.0 if rng is None else float(rng.random()))
    if task.deadline_s is not None:
        due_ns = round(task.deadline_s * _S)
    elif started_by_camera(schedule, task):
        due_ns = period_ns
    else:
        due_ns = round((task.period_s or 1 / schedule.frame_rate_hz) * _S)
    return Job(task, frame, now_ns, now_ns + due_ns, max(1, round(time_s * _S)))
