"""The bit pattern: the levels of the sensor's control signals at each clock step, and the sequencer that executes it.

The cycle of one laser pulse is a table of eight strings of 0 and 1, a character for each clock step of 30 ns: the
signals Phi1 to Phi7 of König 2008, 4.1.1.5, and the trigger of the laser. The thesis names Phi1 (reset), Phi2 (select)
and Phi7 (shutter); what the others do is taken from its description of the circuit and *open*: Phi3 takes the voltage
over to the hold capacitor, Phi4 samples it with the laser on, Phi5 subtracts and accumulates, Phi6 ends the cycle.
Four pixels share a read-out stage and are selected one after the other.
"""

import math
from functools import lru_cache
from typing import NamedTuple

from rangecam.errors import UsageError
from rangecam.settings import NonNegative, Positive, PositiveInt, settings

Table = tuple[str, ...]

SIGNALS = ("Phi1", "Phi2", "Phi3", "Phi4", "Phi5", "Phi6", "Phi7", "laser")
"""Names of the rows of a table."""
_RESET, _SELECT, _HOLD, _SAMPLE, _ACCUMULATE, _END, _SHUTTER, _LASER = range(8)
_PIXELS_PER_STAGE = 4


@settings
class Sequencer:
    """The control of the sensor and its read-out (K-PIX-05, K-PIX-12); time to read a pixel and steps are *open*."""

    clock_step_s: Positive = 30e-9
    """Clock of the bit pattern (4.1.1.5)."""
    reset_steps: PositiveInt = 4
    """Clock steps of a reset. *open*"""
    transfer_steps: PositiveInt = 4
    """Clock steps in which one of the four pixels that share a read-out stage is selected. *open*"""
    table_a: Table = ()
    """Bit pattern of window a, eight strings of 0 and 1 (see `pulsed.bit_pattern`), in place of its times; empty: by
    the widths and delays of the camera, at any time."""
    table_b: Table = ()
    """The same for window b."""
    table_c: Table = ()
    """The same for window c."""
    pixel_read_s: NonNegative = 0.0
    """Time in which an output passes one pixel to its converter; the thesis leaves it out of the frame rate. *open*"""
    outputs: PositiveInt = 2
    """Outputs that are read at the same time (4.1.1)."""


class Cycle(NamedTuple):
    """What a bit pattern does: all times of the switches, s.

    window_s: when the shutter opens and closes, from the laser's trigger. off_after_s: from the opening with the laser
    on to that with it off. length_s: of the whole.
    """

    window_s: tuple[float, float]
    off_after_s: float
    length_s: float


def table_of(window_s: tuple[float, float], sequencer: Sequencer) -> Table:
    """Return the bit pattern of a shutter that opens and closes at these times from the laser's trigger.

    Inverse of `execute`. Raises UsageError for times that are not on the clock: only the delay of the laser can be
    finer (N-K-093).
    """
    opens, closes = (round(time_s / sequencer.clock_step_s) for time_s in window_s)
    for steps, time_s in ((opens, window_s[0]), (closes, window_s[1])):
        if abs(steps * sequencer.clock_step_s - time_s) > 1e-6 * sequencer.clock_step_s:
            raise UsageError(
                f"a shutter that switches at {time_s:g} s: the bit pattern has steps of {sequencer.clock_step_s:g} s, "
                f"the nearest is {steps * sequencer.clock_step_s:g} s; finer shifts need camera.laser_delay_s"
            )
    return _table(opens, closes, sequencer)


def cycle_of(window_s: tuple[float, float], sequencer: Sequencer) -> Cycle:
    """Return the cycle of a shutter with these times, widened to the clock."""
    opens = math.floor(window_s[0] / sequencer.clock_step_s + 1e-6)
    closes = math.ceil(window_s[1] / sequencer.clock_step_s - 1e-6)
    return execute(_table(opens, max(closes, opens + 1), sequencer), sequencer.clock_step_s)


def _table(opens: int, closes: int, sequencer: Sequencer) -> Table:
    """Return the levels: reset, exposure with the laser, transfer of four pixels, and again without the laser."""
    trigger = sequencer.reset_steps + max(0, -opens)
    exposed = trigger + max(closes, 1)  # after the last of shutter and trigger
    transfer = sequencer.transfer_steps * _PIXELS_PER_STAGE
    half = exposed + 1 + transfer
    rows = [[0] * (2 * half + 1) for _ in SIGNALS]
    rows[_LASER][trigger] = 1
    rows[_END][-1] = 1
    for start, sampled in ((0, _SAMPLE), (half, _ACCUMULATE)):
        rows[_RESET][start : start + sequencer.reset_steps] = [1] * sequencer.reset_steps
        rows[_SHUTTER][start + trigger + opens : start + trigger + closes] = [1] * (closes - opens)
        rows[_HOLD][start + exposed] = 1
        for k in range(_PIXELS_PER_STAGE):
            first = start + exposed + 1 + k * sequencer.transfer_steps
            rows[_SELECT][first : first + sequencer.transfer_steps - 1] = [1] * (sequencer.transfer_steps - 1)
            rows[_SELECT][first] = 1
        rows[sampled][start + exposed + 1 : start + half] = [1] * transfer
    return tuple("".join(map(str, row)) for row in rows)


@lru_cache(maxsize=64)
def execute(table: Table, clock_step_s: float, name: str = "the bit pattern") -> Cycle:
    """Return what the sequencer does with a table, step by step as the circuit would (K-PIX-12).

    name: what to call it in an error. Raises UsageError for a table that is none, or would not give one exposure with
    and one without the laser, equally long, of which the second is subtracted.
    """
    _check_table(table, name)
    sense: list[int] | None = None
    held: list[int] = []
    lit: list[int] = []
    dark: list[int] = []
    for step, levels in enumerate(zip(*table, strict=True)):
        high = [level == "1" for level in levels]
        if high[_RESET]:
            _require(not high[_SHUTTER], name, step, "Phi1 resets the pixel while Phi7 collects")
            sense = []
        if high[_SHUTTER]:
            _require(sense is not None, name, step, "Phi7 collects before Phi1 has reset the pixel")
            sense = [*(sense or []), step]
        if high[_HOLD]:
            held, sense = sense or [], None
        if high[_SELECT] and high[_SAMPLE]:
            lit = held
        if high[_SELECT] and high[_ACCUMULATE]:
            dark = held
    return _cycle(table, clock_step_s, name, lit, dark)


def _cycle(table: Table, clock_step_s: float, name: str, lit: list[int], dark: list[int]) -> Cycle:
    """Return the cycle whose shutter collected in these steps, with the laser on and off."""
    last, triggers = len(table[0]), [i for i, level in enumerate(table[_LASER]) if level == "1"]
    _require(len(triggers) == 1, name, last, f"the laser is triggered {len(triggers)} times; it must be once")
    _require(bool(lit and dark), name, last, "an exposure was not sampled with Phi4 and one not accumulated with Phi5")
    for steps in (lit, dark):
        _require(steps[-1] - steps[0] + 1 == len(steps), name, last, "the shutter opens more than once in an exposure")
    _require(len(lit) == len(dark), name, last, "the exposures with the laser on and off are not equally long")
    _require(dark[0] > lit[-1], name, last, "what was collected with the laser on is accumulated again")
    window_s = ((lit[0] - triggers[0]) * clock_step_s, (lit[-1] + 1 - triggers[0]) * clock_step_s)
    return Cycle(window_s, (dark[0] - lit[0]) * clock_step_s, last * clock_step_s)


def _check_table(table: Table, name: str) -> None:
    if len(table) != len(SIGNALS) or len({len(row) for row in table}) != 1 or set("".join(table)) - {"0", "1"}:
        raise UsageError(f"{name}: must be {len(SIGNALS)} strings of 0 and 1, all as long: {', '.join(SIGNALS)}")


def _require(right: bool, name: str, step: int, what: str) -> None:
    if not right:
        raise UsageError(f"{name}, step {step}: {what}")
