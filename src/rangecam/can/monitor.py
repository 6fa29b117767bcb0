"""What is on the bus: a row for each identifier, with its period, its last values and what was refused. Pure."""

from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import Any

from rangecam.can.bus import Received
from rangecam.can.codec import GiveBack, TakeOver, name_of


@dataclass(frozen=True)
class Row:
    """Frames of one identifier: how many, how many of them refused, first and last arrival, the last one, jitter.

    shortest_s, longest_s: least and greatest time between two of them.
    """

    count: int
    refused: int
    first_s: float
    last: Received
    shortest_s: float = float("inf")
    longest_s: float = 0.0

    @property
    def period_s(self) -> float | None:
        """Mean time between frames, None for fewer than two."""
        return (self.last.time_s - self.first_s) / (self.count - 1) if self.count > 1 else None


Table = dict[int, Row]


def observe(table: Table, received: Received) -> Table:
    """Return the table after one more frame."""
    refused = received.refusal is not None
    row = table.get(received.can_id)
    if row is None:
        return {**table, received.can_id: Row(1, refused, received.time_s, received)}
    gap_s = received.time_s - row.last.time_s
    row = replace(
        row,
        count=row.count + 1,
        refused=row.refused + refused,
        last=received,
        shortest_s=min(row.shortest_s, gap_s),
        longest_s=max(row.longest_s, gap_s),
    )
    return {**table, received.can_id: row}


def describe(received: Received) -> tuple[str, dict[str, Any]]:
    """Return the name of a frame's message and its values for people; a refused frame has its reason as the name."""
    message = received.message
    if message is None:
        return f"refused: {received.refusal}", {}
    if isinstance(message, TakeOver | GiveBack):
        name = "take-over" if isinstance(message, TakeOver) else "give-back"
    else:
        name = name_of(message)
    values = asdict(message)
    return name, {key: value.name.lower() if isinstance(value, Enum) else value for key, value in values.items()}


def as_json(table: Table) -> list[dict[str, Any]]:
    """Return the table as JSON values, sorted by identifier, which is the priority on the bus."""
    rows = []
    for can_id, row in sorted(table.items()):
        name, values = describe(row.last)
        rows.append(
            {
                "id": f"0x{can_id:X}",
                "message": name,
                "count": row.count,
                "refused": row.refused,
                "period_s": row.period_s,
                "shortest_s": row.shortest_s if row.count > 1 else None,
                "longest_s": row.longest_s if row.count > 1 else None,
                "data": row.last.data.hex(" "),
                "values": values,
            }
        )
    return rows
