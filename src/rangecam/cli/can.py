"""`rangecam can`: watch the car's bus and send to it, in place of a vendor's bus tool (Steinbäck 2016, A.6)."""

import json as json_format
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from rangecam.cli.app import Json, app
from rangecam.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from rangecam.can.codec import Message
    from rangecam.can.monitor import Table

can = App(name="can", help="Watch the CAN bus of the car and send to it.")
app.command(can)

Interface = Annotated[
    str, Parameter(help="virtual (this process only), udp_multicast (this machine only) or socketcan (a real bus).")
]
Channel = Annotated[str | None, Parameter(help="Channel of the interface, such as can0.")]


@can.command(name="list")
def list_(*, json: Json = False) -> None:
    """List the messages of the car, their fields and limits."""
    from rangecam.can.codec import FIELDS, database

    rows = []
    for name, (_, fields) in FIELDS.items():
        known = database().get_message_by_name(name)
        signals = {field: known.get_signal_by_name(signal) for field, signal in fields.items()}
        described = {
            field: {
                "signal": signal.name,
                "first_byte": signal.start // 8,
                "bits": signal.length,
                "minimum": float(signal.minimum),
                "maximum": float(signal.maximum),
                "unit": signal.unit or "",
                "codes": {str(label): code for code, label in (signal.choices or {}).items()},
            }
            for field, signal in signals.items()
        }
        rows.append(
            {"name": name, "id": f"0x{known.frame_id:X}", "period_s": known.cycle_time / 1000, "fields": described}
        )
    if json:
        print(json_format.dumps({"messages": rows}))
        return
    for row in rows:
        print(f"{row['id']:>5} {row['name']:<10} every {row['period_s'] * 1000:.0f} ms")
        for field, signal in row["fields"].items():
            allowed = ", ".join(signal["codes"]) or f"{signal['minimum']:g} to {signal['maximum']:g} {signal['unit']}"
            print(f"      {field:<18} byte {signal['first_byte']}, {signal['bits']:>2} bits: {allowed.rstrip()}")


@can.command
def monitor(
    *,
    interface: Interface = "udp_multicast",
    channel: Channel = None,
    duration: Annotated[float | None, Parameter(help="Seconds to listen; otherwise until interrupted.")] = None,
    frames: Annotated[int | None, Parameter(help="Frames after which to stop.")] = None,
    log: Annotated[
        Path | None, Parameter(help="Write every frame to this file: .asc, .blf, .csv, .log or .trc.")
    ] = None,
    json: Json = False,
) -> None:
    """Show what is on the bus: each identifier with its values, counts and periods."""
    from rangecam.can.bus import Bus
    from rangecam.can.monitor import as_json, observe

    table: Table = {}
    with ExitStack() as stack:
        bus = stack.enter_context(Bus(interface, channel))
        write = stack.enter_context(_log_to(log)) if log is not None else None
        show = stack.enter_context(_screen()) if not json else None
        until_s = None if duration is None else time.monotonic() + duration
        try:
            while not _over(until_s) and sum(row.count for row in table.values()) != frames:
                received = bus.receive(0.05)
                if received is not None:
                    table = observe(table, received)
                    if write is not None:
                        write(received)
                if show is not None:
                    show(table)
        except KeyboardInterrupt:
            pass
        result = {"bus": bus.name, "rows": as_json(table), "refused": {str(k): n for k, n in bus.refused.items()}}
    print(json_format.dumps(result) if json else _summary(result))


@can.command
def send(
    name: str,
    /,
    *fields: str,
    interface: Interface = "udp_multicast",
    channel: Channel = None,
    every: Annotated[float | None, Parameter(help="Repeat with this period in seconds.")] = None,
    count: Annotated[int | None, Parameter(help="How many to send; otherwise one, or until interrupted.")] = None,
    arm: Annotated[bool, Parameter(negative=(), help="Needed for MasterID, which takes control of the car.")] = False,
    json: Json = False,
) -> None:
    """Send the message NAME with FIELDS such as speed_mps=3; what is not named is zero. GiveBack gives control back."""
    from rangecam.can.bus import Bus
    from rangecam.can.codec import TakeOver, encode

    message = _message(name, fields)
    if isinstance(message, TakeOver) and not arm:
        raise UsageError("MasterID takes control of the car: add --arm if that is what you want")
    if every is not None and not every > 0:
        raise UsageError(f"--every {every:g}: must be greater than 0 s")
    total = count if count is not None else (1 if every is None else None)
    can_id, data = encode(message)
    sent = 0
    with Bus(interface, channel) as bus:
        start_s = time.monotonic()
        try:
            while sent != total:
                bus.send_frame(can_id, data)
                sent += 1
                if sent != total:
                    time.sleep(max(0.0, start_s + sent * (every or 0.02) - time.monotonic()))
        except KeyboardInterrupt:
            pass
    result = {"bus": bus.name, "id": f"0x{can_id:X}", "data": data.hex(" "), "sent": sent}
    print(json_format.dumps(result) if json else f"{bus.name}: 0x{can_id:X} [{data.hex(' ')}] sent {sent} times")


def _message(name: str, assignments: tuple[str, ...]) -> "Message":
    """Return the message that a call describes; raises UsageError for a name, field or value that is none."""
    from rangecam.can.codec import FIELDS, DriveMode, GiveBack, SteeringMode

    if name == "GiveBack":
        if assignments:
            raise UsageError(f"{assignments[0]}: expected no fields: GiveBack has none")
        return GiveBack()
    if name not in FIELDS:
        known = [*FIELDS, "GiveBack"]
        raise UsageError(f"unknown message '{name}'{did_you_mean(name, known)}; messages: {', '.join(known)}")
    kind, fields = FIELDS[name]
    codes: dict[str, type[DriveMode] | type[SteeringMode]] = {}
    values: dict[str, Any] = dict.fromkeys(fields, 0.0)
    if name == "MasterID":
        codes = {"mode": DriveMode, "steering": SteeringMode}
        values |= {"mode": DriveMode.NONE, "steering": SteeringMode.NONE}
    for assignment in assignments:
        field, _, text = assignment.partition("=")
        if field not in fields:
            raise UsageError(f"{assignment}: expected field=value; fields of {name}: {', '.join(fields)}")
        try:
            values[field] = codes[field][text.upper()] if field in codes else float(text)
        except (KeyError, ValueError) as error:
            allowed = ", ".join(code.name.lower() for code in codes[field]) if field in codes else "a number"
            raise UsageError(f"{assignment}: expected {allowed}") from error
    return kind(**values)


def _over(until_s: float | None) -> bool:
    return until_s is not None and time.monotonic() >= until_s


@contextmanager
def _log_to(path: Path) -> Iterator[Callable[[Any], None]]:
    """Give a function that writes frames to a log file of the kind that its ending says."""
    import can as python_can

    try:
        logger = python_can.Logger(path)
    except ValueError as error:
        raise UsageError(f"--log {path}: expected a file that ends in .asc, .blf, .csv, .log or .trc") from error
    try:
        yield lambda one: logger.on_message_received(
            python_can.Message(one.time_s, one.can_id, is_extended_id=one.can_id > 0x7FF, data=one.data)
        )
    finally:
        logger.stop()


@contextmanager
def _screen() -> Iterator[Callable[["Table"], None]]:
    """Give a function that shows the table on standard error, if someone is looking."""
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda table: None
        return
    with Live(console=console, transient=True, auto_refresh=True) as live:
        yield lambda table: live.update(_drawn(table))


def _drawn(table: "Table") -> Any:
    from rich.table import Table as Drawn

    from rangecam.can.monitor import as_json

    drawn = Drawn("ID", "message", "count", "refused", "period", "data", "values")
    for row in as_json(table):
        drawn.add_row(*_cells(row))
    return drawn


def _cells(row: dict[str, Any]) -> list[str]:
    period = "-" if row["period_s"] is None else f"{1000 * row['period_s']:.1f} ms"
    values = ", ".join(f"{k} {v:g}" if isinstance(v, float | int) else f"{k} {v}" for k, v in row["values"].items())
    return [row["id"], row["message"], str(row["count"]), str(row["refused"]), period, row["data"], values]


def _summary(result: dict[str, Any]) -> str:
    lines = [f"{result['bus']}: {sum(row['count'] for row in result['rows'])} frames"]
    lines += ["  ".join(_cells(row)) for row in result["rows"]]
    lines += [f"refused, {reason}: {count}" for reason, count in result["refused"].items()]
    return "\n".join(lines)
