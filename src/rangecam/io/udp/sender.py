"""Streaming: a sink whose frames go out as packets."""

import socket
import time
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Any, Self

from rangecam.config import Config
from rangecam.errors import DataError, UsageError, did_you_mean
from rangecam.io.udp.address import parse_address
from rangecam.io.udp.modes import MODES, static_words, words_of
from rangecam.io.udp.packets import OVERHEAD_BYTES, PACKET_BYTES, encode, wire_mbit
from rangecam.types import Capture, Frame

LINK_MBIT = 100.0
"""What the network carries: packets leave no faster, as through the Ethernet of the microcontroller (S-UDP-08)."""
_TOGETHER = 16
"""Packets that leave before the clock is looked at again."""


class Stream:
    """Sends frames to udp://HOST:PORT. A sink of `pipeline.run`; without a frame, `write` sends what was captured.

    mode: a key of `MODES`. link_mbit: packets leave at the pace of a network that carries so many Mbit/s, so that the
    buffers on the way hold them; 0: as fast as can be. clock and sleep: seconds.
    Raises UsageError for an address, mode or frame that cannot be sent, DataError if the network refuses it.
    """

    def __init__(
        self,
        url: str,
        config: Config,
        mode: str = "raw",
        *,
        link_mbit: float = LINK_MBIT,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if mode not in MODES:
            raise UsageError(f"unknown stream mode '{mode}'{did_you_mean(mode, MODES)}; modes: {', '.join(MODES)}")
        self._url, self._config, self._mode = url, config, mode
        address = parse_address(url)
        try:
            found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
            family, _, _, _, to = found[0]
            self._to: Any = to
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
        except OSError as error:
            raise UsageError(f"{url}: {error.strerror or error}") from error
        self._packet_s = (PACKET_BYTES + OVERHEAD_BYTES) * 8 / (link_mbit * 1e6) if link_mbit else 0.0
        self._link_mbit, self._clock, self._sleep = link_mbit, clock, sleep
        self._static: dict[str, Any] | None = None
        self.frames = 0

    def write(self, capture: Capture, frame: Frame | None = None) -> None:
        """Send one frame."""
        planes = MODES[self._mode].images(capture, frame, self._config)
        if self._static is None:
            self._static = static_words(self._config, self._mode, planes)
        packets = encode(self.frames, words_of(capture, frame, self._static), list(planes.values()))
        if not self.frames:
            self._check_rate(len(packets))
        self.frames += 1
        due_s = self._clock()
        try:
            for first in range(0, len(packets), _TOGETHER):
                together = packets[first : first + _TOGETHER]
                for packet in together:
                    self._socket.sendto(packet, self._to)
                due_s += len(together) * self._packet_s
                if (early_s := due_s - self._clock()) > 0:
                    self._sleep(early_s)
        except OSError as error:
            raise DataError(f"{self._url}: cannot send: {error.strerror or error}") from error

    def _check_rate(self, n_packets: int) -> None:
        rate_hz = self._config.camera.frame_rate_hz
        if self._link_mbit and wire_mbit(n_packets, rate_hz) > self._link_mbit:
            raise UsageError(
                f"{self._url}: {rate_hz:g} frames/s of {n_packets} packets are {wire_mbit(n_packets, rate_hz):.1f} "
                f"Mbit/s on the wire; the link carries {self._link_mbit:g}, which is enough for "
                f"{self._link_mbit / wire_mbit(n_packets, 1.0):.1f} frames/s; stream less (--stream-mode) or slower"
            )

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def paced(
    captures: Iterable[Capture],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Capture]:
    """Yield captures when their time has come: as long after the first as their `time_s` says, or at once if late."""
    begun: tuple[float, float] | None = None
    for capture in captures:
        if begun is None:
            begun = clock(), capture.raw.time_s
        early_s = begun[0] + capture.raw.time_s - begun[1] - clock()
        if early_s > 0:
            sleep(early_s)
        yield capture
