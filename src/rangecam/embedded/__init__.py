"""The embedded view: three processing units, their tasks and memories, in time (Steinbäck 2016, 4.4, 5.3.4; S-CPU).

- settings: schedules (tasks, camera, buffers) as TOML; schedules/*.toml
- scheduler: who runs when, exactly; results: utilisation, latency, deadlines, the highest frame rate
- partition: a chain of stages shared evenly among units; measured: stages as this machine runs them
- memory: do all buffers fit; linker: the memory map of the thesis
- trace: the same for Perfetto and chrome://tracing
"""

from rangecam.embedded.results import analyse, highest_frame_rate_hz
from rangecam.embedded.scheduler import run_schedule
from rangecam.embedded.settings import Schedule, load_schedule, schedule_names

__all__ = ["Schedule", "analyse", "highest_frame_rate_hz", "load_schedule", "run_schedule", "schedule_names"]
