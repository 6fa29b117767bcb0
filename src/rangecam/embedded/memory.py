"""Whether all buffers fit into the memories of the microcontroller (Steinbäck 2016, 3.3.3 and 4.4.3; S-CPU-03)."""

from dataclasses import dataclass

from rangecam.embedded.settings import Memory, Schedule
from rangecam.errors import UsageError, did_you_mean

KBYTE = 1024
MEMORIES = (
    *(Memory(name=f"DSPR{n}", kbytes=size) for n, size in ((0, 120), (1, 240), (2, 240))),
    Memory(name="LMU", kbytes=32),
    # of 2048 in all; *open* how they are divided
    Memory(name="ADM", kbytes=1024),
    Memory(name="XAM", kbytes=1024),
    Memory(name="DFLASH", kbytes=768),
    *(Memory(name=f"PSPR{n}", kbytes=32) for n in range(3)),
    Memory(name="PFLASH", kbytes=8192),
)
"""Tables 3.2 and 3.3: local data of each processing unit (DSPR), memory for all (LMU), extended memory for the camera
and for applications (ADM and XAM of EMEM), data flash, local program memory (PSPR) and program flash."""


@dataclass(frozen=True)
class Placement:
    """How full a memory is, bytes; buffers: (name, bytes) of what lies in it."""

    memory: str
    size: int
    used: int
    buffers: tuple[tuple[str, int], ...]

    @property
    def fits(self) -> bool:
        """Whether there is room for all of it."""
        return self.used <= self.size


def placements(schedule: Schedule) -> list[Placement]:
    """Return how full each memory of a schedule is; raises UsageError for a buffer in a memory that is not there."""
    sizes = {memory.name: int(memory.kbytes * KBYTE) for memory in schedule.memories}
    inside: dict[str, list[tuple[str, int]]] = {name: [] for name in sizes}
    for buffer in schedule.buffers:
        if buffer.memory not in sizes:
            near = did_you_mean(buffer.memory, sizes)
            raise UsageError(f"buffer '{buffer.name}': there is no memory '{buffer.memory}'{near}")
        one = buffer.bytes or schedule.rows * schedule.columns * buffer.bytes_per_pixel
        inside[buffer.memory].append((buffer.name, one * buffer.count))
    return [Placement(name, sizes[name], sum(n for _, n in there), tuple(there)) for name, there in inside.items()]
