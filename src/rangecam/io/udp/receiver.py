"""A socket that never waits for whoever uses its frames: a thread takes in packets and puts frames together."""

import select
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rangecam.errors import UsageError
from rangecam.io.udp.address import Address
from rangecam.io.udp.assembly import Assembler, PlainAssembler, Received
from rangecam.io.udp.packets import PACKET_BYTES

BUFFER_BYTES = 4 << 20
"""Asked of the operating system for packets that wait: several frames. It may give less."""
KEPT = 8
"""Complete frames that wait for whoever uses them; if that takes too long, the oldest is skipped: late is worthless."""
_STAMPS = 35
"""SO_TIMESTAMPNS of Linux, for which Python has no name: the kernel says when a packet came."""
_LOOK_S = 0.05
"""How often the thread looks whether it shall stop."""


class Receiver:
    """Takes in a stream from the moment it is made until `close`.

    clock: seconds; a frame comes with the time of its last packet on it. Where the kernel stamps packets, by `wall`
    (seconds since 1970), that is when it came to this machine, however late somebody got to it. Raises UsageError if
    the address is taken or none.
    """

    def __init__(self, address: Address, clock: Callable[[], float], wall: Callable[[], float] = time.time) -> None:
        plain = address.planes
        self._assembler = PlainAssembler([address.shape] * len(plain)) if plain else Assembler()
        self._clock, self._wall = clock, wall
        self._frames: deque[tuple[float, Received]] = deque(maxlen=KEPT)
        self._changed = threading.Condition()
        self._ended = False
        self._skipped = 0
        self.unreadable = 0
        self.heard_s = clock()
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            if sys.platform == "linux":
                self._socket.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
            self._socket.bind((address.host, address.port))
        except OSError as error:
            self._socket.close()
            raise UsageError(
                f"udp://{address.host}:{address.port}: cannot listen there: {error.strerror or error}"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._receive, name="rangecam-udp", daemon=True)
        self._thread.start()

    def _receive(self) -> None:
        while not self._ended:
            if not select.select([self._socket], [], [], _LOOK_S)[0]:
                continue
            # one more, so that a longer one is not taken for one of ours
            packet, stamps, _, _ = self._socket.recvmsg(PACKET_BYTES + 1, _STAMP_BYTES)
            self.heard_s = self._clock()
            came_s = self.heard_s - _age_s(stamps, self._wall())
            received = self._assembler.take(packet)
            if received is not None:
                with self._changed:
                    self._skipped += len(self._frames) == KEPT
                    self._frames.append((came_s, received))
                    self._changed.notify()
        self._socket.close()

    def next_frame(self, timeout_s: float) -> tuple[float, Received] | None:
        """Return when the oldest frame came and the frame, waiting for one; None if there is none in time."""
        with self._changed:
            if not self._frames and not self._ended:
                self._changed.wait(timeout_s)
            return self._frames.popleft() if self._frames else None

    @property
    def ended(self) -> bool:
        """True once it was stopped."""
        return self._ended

    def stop(self) -> None:
        """Take in no more; frames that are complete can still be had. May be called from anywhere, again and again."""
        self._ended = True

    def close(self) -> None:
        """Stop, and give the address back."""
        self.stop()
        self._thread.join()
        self._assembler.close()

    def counts(self) -> dict[str, int]:
        """Return `assembly.Counts`, and the complete frames that were skipped as too late or are `unreadable`."""
        return {**asdict(self._assembler.counts), "skipped": self._skipped, "unreadable": self.unreadable}


_STAMP = struct.Struct("@qq")
_STAMP_BYTES = 64


def _age_s(stamps: list[tuple[int, int, Any]], now_s: float) -> float:
    """Return how long ago a packet came, by the kernel's stamp; 0 without one, or if the time of day was set back."""
    for level, kind, data in stamps:
        if level == socket.SOL_SOCKET and kind == _STAMPS and len(data) >= _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack_from(data)
            stamped_s = float(seconds) + 1e-9 * float(nanoseconds)
            return max(0.0, now_s - stamped_s)
    return 0.0
