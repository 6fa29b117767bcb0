"""The bus as a resource: python-can's interfaces, our messages, and nothing that blocks longer than it is told.

Whatever comes in and is no message of the car is refused and counted by its reason, never raised.
"""

import ipaddress
import os
import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from rangecam.can.codec import CodecError, Message, Reason, decode, encode
from rangecam.errors import DataError, UsageError

GROUP, PORT = "239.74.163.2", 43113
"""Multicast group and port of python-can for UDP over IPv4."""
LOOPBACK = "127.0.0.1"
_IP_MULTICAST_ALL = 49  # of Linux; Python has no name for it


@dataclass(frozen=True)
class Received:
    """One frame from the bus: what it is, or why it was refused. time_s: of arrival, on the clock of the bus."""

    time_s: float
    can_id: int
    data: bytes
    message: Message | None
    refusal: Reason | None = None


def _virtual(channel: str) -> Any:
    import can

    return can.Bus(interface="virtual", channel=channel)


def _udp_multicast(channel: str) -> Any:
    """Open a multicast socket that hears and reaches this machine only; python-can's own would be on the network."""
    import can

    try:
        usable = ipaddress.IPv4Address(channel).is_multicast
    except ValueError:
        usable = False
    if not usable:
        raise UsageError(f"channel '{channel}': expected an IPv4 multicast group, such as {GROUP}")
    bus = can.Bus(interface="udp_multicast", channel=channel, port=PORT, hop_limit=0, fd=False)
    group, loopback = socket.inet_aton(channel), socket.inet_aton(LOOPBACK)
    with socket.socket(fileno=os.dup(bus.fileno())) as same:  # options belong to the socket, whoever holds it
        same.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, group + socket.inet_aton("0.0.0.0"))
        same.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + loopback)
        same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        if hasattr(socket, "SO_BINDTODEVICE"):  # Linux: packets that others send to the port do not arrive either
            same.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")
            same.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)  # nor what others here send to other groups
    _emptied(bus)
    return bus


def _emptied(bus: Any) -> None:
    """Throw away what came in before the options were set: it may be of other groups, or from elsewhere."""
    import can

    for _ in range(10_000):
        try:
            if bus.recv(0.0) is None:
                return
        except can.CanError:
            continue


def _socketcan(channel: str) -> Any:
    import can

    return can.Bus(interface="socketcan", channel=channel)


INTERFACES: dict[str, tuple[Callable[[str], Any], str]] = {
    "virtual": (_virtual, "rangecam"),
    "udp_multicast": (_udp_multicast, GROUP),
    "socketcan": (_socketcan, "vcan0"),
}
"""Interfaces by name: what opens one, and its usual channel. `virtual` stays within one process."""


class Bus:
    """An open bus, to be used in a `with` statement. refused: frames that were no message of the car, by reason."""

    def __init__(self, interface: str = "udp_multicast", channel: str | None = None) -> None:
        """Open the bus; raises UsageError for an unknown interface, DataError where it cannot be opened."""
        import can

        if interface not in INTERFACES:
            raise UsageError(f"unknown CAN interface '{interface}'; interfaces: {', '.join(INTERFACES)}")
        make, usual = INTERFACES[interface]
        self.name = f"{interface}:{channel or usual}"
        self.refused: Counter[Reason] = Counter()
        try:
            self._bus = make(channel or usual)
        except (can.CanError, OSError) as error:
            raise DataError(f"{self.name}: cannot open this bus: {error}") from error

    def send(self, message: Message) -> None:
        """Send a message; raises CodecError for one that cannot be packed, DataError where the bus does not take it."""
        self.send_frame(*encode(message))

    def send_frame(self, can_id: int, data: bytes) -> None:
        """Send a frame as it is; raises DataError where the bus does not take it within 50 ms."""
        import can

        try:
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False), timeout=0.05)
        except (can.CanError, OSError) as error:
            raise DataError(f"{self.name}: cannot send: {error}") from error

    def receive(self, timeout_s: float = 0.0) -> Received | None:
        """Return the next frame, or None if none comes within the timeout. Raises nothing for what frames hold."""
        import can

        try:
            frame = self._bus.recv(timeout_s)
        except (can.CanError, ValueError) as error:
            if error.__cause__ is None or isinstance(error.__cause__, OSError):
                raise DataError(f"{self.name}: cannot receive: {error}") from error
            self.refused[Reason.UNREADABLE] += 1
            return None
        if frame is None:
            return None
        received = read(frame.timestamp, frame.arbitration_id, bytes(frame.data), plain=_is_plain(frame))
        if received.refusal is not None:
            self.refused[received.refusal] += 1
        return received

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()


def _is_plain(frame: Any) -> bool:
    return not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame)


def read(time_s: float, can_id: int, data: bytes, plain: bool = True) -> Received:
    """Return a frame with its message or its refusal; only plain data frames with 11 bit identifier are the car's."""
    if not plain:
        return Received(time_s, can_id, data, None, Reason.UNKNOWN_ID)
    try:
        return Received(time_s, can_id, data, decode(can_id, data))
    except CodecError as error:
        return Received(time_s, can_id, data, None, error.reason)
