"""What a frame looks like on the wire: packets of 400 bytes (Steinbäck 2016, 4.3.4 and fig 4.8; S-UDP-01..05).

    FRM_STRT   metadata   CPU 0   CPU 1   CPU 2   IMG_0  data ... data   IMG_1  data ...   FRM_STOP

The thesis leaves the bytes behind the words of control packets free. There we put what lets a receiver undo any
reordering and duplication, and notice any loss: checksums of all packets that follow. Receivers that go by order and
number, as that of the thesis, need not know them.
"""

import json
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from rangecam.errors import DataError, UsageError
from rangecam.types import Image

PACKET_BYTES = 400
BYTE_ORDER: Literal["<"] = "<"
"""Little endian, as the microcontroller's memory; *open* in the thesis (S-UDP-07). Of samples and of our own fields."""
START, STOP, IMAGE = b"FRM_STRT", b"FRM_STOP", b"IMG_"
DEBUG_PACKETS = 4
"""Metadata of the system, then what each of the three processing units has to say: text, filled up with zeros."""
DATA_PACKETS = 96
"""Packets of one 160x120 image of 16 bits. More does not follow one IMG_x: a larger image goes in several strips."""
STRIP_BYTES = DATA_PACKETS * PACKET_BYTES
MARK = b"rcam1"
"""Behind FRM_STRT: our checksums follow, version 1."""
OVERHEAD_BYTES = 66
"""What each packet costs beside its payload on the wire: 8 UDP, 20 IP, 38 Ethernet with preamble and pause."""

_TYPES = tuple(np.dtype(BYTE_ORDER + name) for name in ("u2", "i2", "f4", "u1", "f8", "i4", "u4", "i1", "i8", "u8"))
_HEAD = struct.Struct(BYTE_ORDER + "8s5sxHI")  # FRM_STRT, mark, number of IMG_x, frame number
_CONTROL = struct.Struct(BYTE_ORDER + "5sBHHHI")  # IMG_x, type, rows, columns, image, checksum of the strip
_WORD = struct.Struct(BYTE_ORDER + "I")
_MOST_STRIPS = (PACKET_BYTES - _HEAD.size) // 4 - DEBUG_PACKETS - 2


class Start(NamedTuple):
    """What FRM_STRT announces: checksums of metadata and processing units, FRM_STOP, and every IMG_x."""

    number: int
    debug: tuple[int, ...]
    stop: int
    controls: tuple[int, ...]


class Control(NamedTuple):
    """What IMG_x announces: a strip of image number `image`, of (rows, columns) samples, and its data packets."""

    image: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    checksum: int
    data: tuple[int, ...]
    n_bytes: int


def encode(number: int, debug: Sequence[Mapping[str, Any]], images: Sequence[Image]) -> list[bytes]:
    """Return the packets of one frame, each of `PACKET_BYTES`.

    number: counts frames, modulo 2^32. debug: metadata and the words of the three processing units, JSON values.
    images: (H, W) each. Raises UsageError for text that does not fit, a type of samples that cannot travel, and for
    more image than one FRM_STRT can announce.
    """
    texts = [text_packet(values) for values in debug]
    strips = [strip for k, image in enumerate(images) for strip in _strips(k, image)]
    if len(strips) > _MOST_STRIPS:
        raise UsageError(
            f"{len(images)} images of {sum(np.asarray(i).nbytes for i in images)} bytes do not fit into a frame of the "
            f"stream, which holds {_MOST_STRIPS} strips of {STRIP_BYTES} bytes"
        )
    packets = [_control(k, *strip) for k, strip in enumerate(strips)]
    stop = _filled(STOP + _WORD.pack(number & 0xFFFFFFFF))  # so that no two are alike
    head = _HEAD.pack(START, MARK, len(strips), number & 0xFFFFFFFF)
    sums = b"".join(_WORD.pack(zlib.crc32(each[0])) for each in (*((t,) for t in texts), (stop,), *packets))
    begin = _filled(head + sums)[:-4]
    return [
        begin + _WORD.pack(zlib.crc32(begin)),
        *texts,
        *(packet for strip in packets for packet in strip),
        stop,
    ]


def text_packet(values: Mapping[str, Any]) -> bytes:
    """Return a packet with JSON text in it; raises UsageError if that is longer than a packet."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False).encode()
    if len(text) > PACKET_BYTES:
        raise UsageError(f"{len(text)} bytes do not fit into a packet of {PACKET_BYTES}: {text[:60].decode()} ...")
    return _filled(text)


def read_text(packet: bytes) -> dict[str, Any]:
    """Return the values of a packet of text; raises DataError if it holds anything but one JSON object."""
    try:
        values = json.loads(packet.rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise DataError(f"a packet of text that is no JSON: {packet[:40]!r}") from error
    if not isinstance(values, dict):
        raise DataError(f"a packet of text that is no JSON object: {packet[:40]!r}")
    return values


def read_start(packet: bytes) -> Start | None:
    """Return what an FRM_STRT with our checksums announces, None if the packet is not exactly that."""
    if not packet.startswith(START + MARK) or zlib.crc32(packet[:-4]) != _WORD.unpack(packet[-4:])[0]:
        return None
    _, _, count, number = _HEAD.unpack_from(packet)
    if count > _MOST_STRIPS:
        return None
    sums = struct.unpack_from(f"{BYTE_ORDER}{DEBUG_PACKETS + 1 + count}I", packet, _HEAD.size)
    return Start(number, sums[:DEBUG_PACKETS], sums[DEBUG_PACKETS], sums[DEBUG_PACKETS + 1 :])


def read_control(packet: bytes) -> Control:
    """Return what an IMG_x with our checksums announces; raises DataError if it cannot be."""
    word, kind, rows, columns, image, checksum = _CONTROL.unpack_from(packet)
    n_bytes = rows * columns * (_TYPES[kind].itemsize if kind < len(_TYPES) else 0)
    if not word.startswith(IMAGE) or not 0 < n_bytes <= STRIP_BYTES:
        raise DataError(f"not a control packet of an image: {packet[:16]!r}")
    count = data_packets(n_bytes)
    sums = struct.unpack_from(f"{BYTE_ORDER}{count}I", packet, _CONTROL.size)
    return Control(image, (rows, columns), _TYPES[kind], checksum, sums, n_bytes)


def _strips(number: int, image: Image) -> list[tuple[bytes, int, int, int, int]]:
    """Return an image as strips of whole rows: bytes, type, rows, columns, number of the image."""
    image = np.asarray(image)
    if image.dtype == bool:
        image = image.astype(np.uint8)
    dtype = image.dtype.newbyteorder(BYTE_ORDER) if image.dtype.itemsize > 1 else image.dtype
    if dtype not in _TYPES:
        raise UsageError(f"samples of type {image.dtype} cannot be streamed; possible are {_listed()}")
    rows, columns = image.shape
    together = STRIP_BYTES // (columns * dtype.itemsize)
    if not together or not rows:
        raise UsageError(f"an image of {rows} rows of {columns} samples cannot be streamed")
    parts = (image[top : top + together] for top in range(0, rows, together))
    return [(part.astype(dtype).tobytes(), _TYPES.index(dtype), *part.shape, number) for part in parts]


def _listed() -> str:
    return ", ".join(dtype.name for dtype in _TYPES)


def _control(x: int, samples: bytes, kind: int, rows: int, columns: int, image: int) -> list[bytes]:
    """Return IMG_x and the data packets of a strip."""
    data = [_filled(samples[k : k + PACKET_BYTES]) for k in range(0, len(samples), PACKET_BYTES)]
    head = _CONTROL.pack(control_word(x), kind, rows, columns, image, zlib.crc32(samples))
    return [_filled(head + b"".join(_WORD.pack(zlib.crc32(packet)) for packet in data)), *data]


def control_word(x: int) -> bytes:
    """Return IMG_x: x is an ASCII digit up to 9, and counts on in the code behind it."""
    return IMAGE + bytes([ord("0") + x])


def _filled(text: bytes) -> bytes:
    return text.ljust(PACKET_BYTES, b"\0")


def data_packets(n_bytes: int) -> int:
    """Return how many data packets so many bytes take."""
    return math.ceil(n_bytes / PACKET_BYTES)


def frame_packets(images: int, image_bytes: int = STRIP_BYTES) -> int:
    """Return how many packets a frame of so many images has (N-S-009)."""
    strips = math.ceil(image_bytes / STRIP_BYTES)
    return 2 + DEBUG_PACKETS + images * (strips + data_packets(image_bytes))


def payload_mbit(packets: int, frame_rate_hz: float) -> float:
    """Return the payload in Mbit/s of frames of so many packets (eq 3.21, for packets)."""
    return packets * PACKET_BYTES * 8 * frame_rate_hz / 1e6


def wire_mbit(packets: int, frame_rate_hz: float) -> float:
    """Return the same with what Ethernet, IP and UDP add: what a link of 10 or 100 Mbit/s must carry (S-UDP-08)."""
    return packets * (PACKET_BYTES + OVERHEAD_BYTES) * 8 * frame_rate_hz / 1e6
