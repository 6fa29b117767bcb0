"""From packets back to frames: the receiver's state machine (Steinbäck 2016, fig 4.9; S-UDP-06).

A frame whose FRM_STRT holds our checksums is put together by content: whichever order its packets come in, however
often, and whatever they look like, each finds the place that its checksum was announced for. A frame is given when its
last packet has come, or never.
"""

import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rangecam.errors import DataError
from rangecam.io.udp.packets import (
    DEBUG_PACKETS,
    PACKET_BYTES,
    START,
    STOP,
    Control,
    Start,
    control_word,
    data_packets,
    read_control,
    read_start,
)
from rangecam.types import Image

_WAITING = 256
"""Packets kept that nobody has announced yet: those that overtook what announces them."""
_OPEN = 2
"""Frames that are put together at a time: the end of one may come after the beginning of the next."""


@dataclass
class Counts:
    """What happened to the packets of a stream so far.

    packets: received. frames: complete. incomplete: frames begun and never completed. missing: packets that those
    lacked. unexpected: packets that belong to no frame: duplicates, strangers, those of frames whose beginning is lost.
    """

    packets: int = 0
    frames: int = 0
    incomplete: int = 0
    missing: int = 0
    unexpected: int = 0


@dataclass(frozen=True, eq=False)
class Received:
    """One complete frame: its number, the packets of metadata and of the three processing units, and its images."""

    number: int
    debug: tuple[bytes, ...]
    images: tuple[Image, ...]


_Place = tuple[int, int]  # (row, column) of a packet: row -1 the debug packets and FRM_STOP, row k IMG_x and its data


class _Frame:
    """A frame that is being put together."""

    def __init__(self, start: Start) -> None:
        self.start = start
        self._wanted: dict[int, list[_Place]] = {}
        self._got: dict[_Place, bytes] = {}
        self._controls: dict[int, Control] = {}
        for column, checksum in enumerate((*start.debug, start.stop)):
            self._want(checksum, (-1, column))
        for row, checksum in enumerate(start.controls):
            self._want(checksum, (row, 0))

    def _want(self, checksum: int, place: _Place) -> None:
        self._wanted.setdefault(checksum, []).append(place)

    def take(self, checksum: int, packet: bytes) -> bool:
        """Return whether the packet has a place here, and put it there."""
        places = self._wanted.get(checksum)
        if not places:
            return False
        row, column = place = places.pop(0)
        if not places:
            del self._wanted[checksum]
        if row >= 0 and column == 0:
            control = self._controls[row] = read_control(packet)
            for k, each in enumerate(control.data):
                self._want(each, (row, k + 1))
        self._got[place] = packet
        return True

    @property
    def missing(self) -> int:
        """How many packets have not come, of those known to exist."""
        return sum(map(len, self._wanted.values()))

    @property
    def complete(self) -> bool:
        """Whether every packet has come."""
        return not self._wanted

    def finish(self) -> Received:
        """Return the frame; raises DataError if its strips do not make images or are not what was sent."""
        parts: dict[int, list[Image]] = {}
        for row, control in sorted(self._controls.items()):
            data = b"".join(self._got[row, k + 1] for k in range(len(control.data)))[: control.n_bytes]
            if zlib.crc32(data) != control.checksum:
                raise DataError(f"strip {row} is not what was sent")
            parts.setdefault(control.image, []).append(np.frombuffer(data, control.dtype).reshape(control.shape))
        try:
            images = tuple(_native(np.concatenate(parts[k])) for k in range(len(parts)))
        except (KeyError, ValueError) as error:
            raise DataError(f"strips that do not make images: {error!r}") from error
        debug = tuple(self._got[-1, column] for column in range(DEBUG_PACKETS))
        return Received(self.start.number, debug, images)


def _native(image: Image) -> Image:
    return image.astype(image.dtype.newbyteorder("="))


class Assembler:
    """Puts frames together from packets, one at a time. What does not become a frame is counted in `counts`."""

    def __init__(self) -> None:
        self.counts = Counts()
        self._open: list[_Frame] = []
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._recent: deque[Start] = deque(maxlen=8)

    def take(self, packet: bytes) -> Received | None:
        """Take in the next packet of the network, of whatever content and length; return the frame that it completes.

        Frames come in the order of their beginnings; one that is overtaken by the next is given up.
        """
        self.counts.packets += 1
        if len(packet) != PACKET_BYTES:
            self.counts.unexpected += 1
            return None
        checksum = zlib.crc32(packet)
        frame = self._place(checksum, packet)
        if frame is None and (start := read_start(packet)) is not None and start not in self._recent:
            self._recent.append(start)
            frame = self._begin(start)
        if frame is None:
            self._wait(checksum, packet)
            return None
        if frame in self._open:
            self._place_those_waiting()
        return self._given() if frame in self._open and frame.complete else None

    def close(self) -> None:
        """Count what is left open as incomplete and what waits as unexpected."""
        for frame in list(self._open):
            self._give_up(frame)
        self.counts.unexpected += len(self._waiting)
        self._waiting.clear()

    def _place(self, checksum: int, packet: bytes) -> _Frame | None:
        """Put a packet into the latest frame that wants it: what an older one lost must not be taken from the next."""
        for frame in reversed(self._open):
            try:
                if frame.take(checksum, packet):
                    return frame
            except DataError:
                self._give_up(frame)
                return frame
        return None

    def _begin(self, start: Start) -> _Frame:
        if len(self._open) == _OPEN:
            self._give_up(self._open[0])
        self._open.append(_Frame(start))
        return self._open[-1]

    def _wait(self, checksum: int, packet: bytes) -> None:
        if len(self._waiting) == _WAITING:
            self._waiting.popleft()
            self.counts.unexpected += 1
        self._waiting.append((checksum, packet))

    def _place_those_waiting(self) -> None:
        """Place the packets that came before they were announced; a control packet among them announces more."""
        placed = True
        while placed and self._waiting:
            before, self._waiting = self._waiting, deque()
            for each in before:
                if self._place(*each) is None:
                    self._waiting.append(each)
            placed = len(self._waiting) < len(before)

    def _given(self) -> Received | None:
        """Return the first complete frame and give up those before it."""
        for frame in list(self._open):
            if not frame.complete:
                self._give_up(frame)
                continue
            try:
                received = frame.finish()
            except DataError:
                self._give_up(frame)
                return None
            self._open.remove(frame)
            self.counts.frames += 1
            return received
        return None

    def _give_up(self, frame: _Frame) -> None:
        self._open.remove(frame)
        self.counts.incomplete += 1
        self.counts.missing += frame.missing


class PlainAssembler:
    """Puts frames together by order and number alone, as the receiver of the thesis: for senders without checksums.

    images: (H, W) shapes of images of 16 bits without sign, which must be known here. What is lost or comes twice makes
    a frame incomplete; packets of one image that come in another order cannot be noticed. After a fault it begins again
    at the next FRM_STRT, also if that had already been taken for data. Same methods as `Assembler`.
    """

    def __init__(self, shapes: Sequence[tuple[int, int]]) -> None:
        self.counts = Counts()
        self._shapes = shapes
        self._packets: list[bytes] = []
        self._words, self._length = {0: START}, 1 + DEBUG_PACKETS
        for x, (rows, columns) in enumerate(shapes):
            self._words[self._length] = control_word(x)
            self._length += 1 + data_packets(2 * rows * columns)
        self._words[self._length] = STOP
        self._length += 1

    def take(self, packet: bytes) -> Received | None:
        """Take in the next packet; return the frame that it completes."""
        self.counts.packets += 1
        if len(packet) != PACKET_BYTES:
            self.counts.unexpected += 1
            return None
        self._packets.append(packet)
        while self._packets and not self._fits():
            self._begin_again()
        if len(self._packets) < self._length:
            return None
        packets, self._packets = self._packets, []
        self.counts.frames += 1
        images, place = [], 1 + DEBUG_PACKETS
        for shape in self._shapes:
            n_bytes = 2 * shape[0] * shape[1]
            count = data_packets(n_bytes)
            data = b"".join(packets[place + 1 : place + 1 + count])[:n_bytes]
            images.append(np.frombuffer(data, "<u2").reshape(shape).astype(np.uint16))
            place += 1 + count
        return Received(self.counts.frames, tuple(packets[1 : 1 + DEBUG_PACKETS]), tuple(images))

    def close(self) -> None:
        """Count a frame that has begun as incomplete."""
        while self._packets:
            self._begin_again()

    def _fits(self) -> bool:
        there = len(self._packets)
        return all(self._packets[k].startswith(word) for k, word in self._words.items() if k < there)

    def _begin_again(self) -> None:
        """Drop packets up to the next that may begin a frame."""
        begun = self._packets[0].startswith(START)
        later = next((k for k, each in enumerate(self._packets) if k and each.startswith(START)), len(self._packets))
        self.counts.incomplete += begun
        self.counts.missing += self._length - min(later, self._length) if begun else 0
        self.counts.unexpected += 0 if begun else later
        self._packets = self._packets[later:]
