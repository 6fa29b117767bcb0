"""The memory map that the linker was given (Steinbäck 2016, listing A.2; S-CPU-04), as data that can be checked."""

from itertools import pairwise
from typing import NamedTuple

from rangecam.embedded.memory import KBYTE, MEMORIES


class Region(NamedTuple):
    """A range of addresses: where it begins, and its bytes."""

    origin: int
    length: int


LINKER = {
    "PMU_PFLASH0": Region(0x80000000, 2048 * KBYTE),
    "PMU_PFLASH1": Region(0x80200000, 2048 * KBYTE),
    "PMU_PFLASH2": Region(0x80400000, 2048 * KBYTE),
    "PMU_PFLASH3": Region(0x80600000, 2048 * KBYTE),
    "PMU_DFLASH0": Region(0xAF000000, 1024 * KBYTE),
    "PMU_DFLASH0_1": Region(0xAF100000, 16 * KBYTE),
    "PMU_DFLASH1": Region(0xAF110000, 64 * KBYTE),
    "BROM": Region(0x8FFF8000, 32 * KBYTE),
    "PMI_PSPR": Region(0xC0000000, 32 * KBYTE),
    "DMI_DSPR": Region(0xD0000000, 20 * KBYTE),
    "DMI_DSPR0_EX": Region(0x70005000, 100 * KBYTE),
    "DMI_DSPR1_EX": Region(0x60005000, 220 * KBYTE),
    "DMI_DSPR2_EX": Region(0x50005000, 220 * KBYTE),
    "LMU_SRAM": Region(0x90000000, 32 * KBYTE),
}
PARTS = {
    "DSPR0": ("DMI_DSPR", "DMI_DSPR0_EX"),
    "DSPR1": ("DMI_DSPR", "DMI_DSPR1_EX"),
    "DSPR2": ("DMI_DSPR", "DMI_DSPR2_EX"),
    "LMU": ("LMU_SRAM",),
    "PSPR0": ("PMI_PSPR",),
    "PFLASH": ("PMU_PFLASH0", "PMU_PFLASH1", "PMU_PFLASH2", "PMU_PFLASH3"),
    "DFLASH": ("PMU_DFLASH0", "PMU_DFLASH0_1", "PMU_DFLASH1"),
}
"""Which regions make a memory. DMI_DSPR is the beginning of the local memory of whichever unit runs: one address for
all three, where the operating system lies; the exclusive part begins behind it."""
_SEGMENT = 1 << 28


def overlaps(regions: dict[str, Region] = LINKER) -> list[tuple[str, str]]:
    """Return pairs of regions that share an address."""
    ordered = sorted(regions, key=lambda name: regions[name])
    return [(a, b) for a, b in pairwise(ordered) if regions[a].origin + regions[a].length > regions[b].origin]


def disagreements(regions: dict[str, Region] = LINKER) -> dict[str, tuple[int, int]]:
    """Return the memories that are not as large in the linker's map as in the tables: bytes there, bytes here.

    The data flash is such a one (E-S-23).
    """
    sizes = {memory.name: int(memory.kbytes * KBYTE) for memory in MEMORIES}
    found = {name: sum(regions[part].length for part in parts) for name, parts in PARTS.items()}
    return {name: (size, sizes[name]) for name, size in found.items() if size != sizes[name]}


def misplaced(regions: dict[str, Region] = LINKER) -> list[str]:
    """Return the exclusive local memories that do not begin right behind what all units share of theirs."""
    shared = regions["DMI_DSPR"].length
    return [name for name in regions if name.endswith("_EX") and regions[name].origin % _SEGMENT != shared]
