"""The source udp://HOST:PORT: frames as they come, with the settings that come with them."""

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from rangecam.config import Config, load_config, preset_names
from rangecam.errors import DataError, UsageError
from rangecam.io.content import Content
from rangecam.io.udp.address import Address, parse_address
from rangecam.io.udp.assembly import Received
from rangecam.io.udp.modes import MODES, capture_of, plain_capture
from rangecam.io.udp.packets import PACKET_BYTES, START, read_text
from rangecam.io.udp.receiver import Receiver
from rangecam.types import Capture

_LOOK_S = 0.1


def open_udp(rest: str, seed: int = 0, clock: Callable[[], float] = time.monotonic) -> Content:
    """Listen at udp:`rest`, wait for the first complete frame, and return what it says of the stream.

    The stream ends when nothing has come for `idle` seconds, or by `live.stop`. Its address is given back then.
    Raises UsageError for an address that is none or cannot be had, DataError if no frame comes in time or it is not one
    that can be decoded.
    """
    address = parse_address("udp:" + rest)
    receiver = Receiver(address, clock)
    try:
        first: tuple[float, Received] | None = _first(address, receiver, clock)
        assert first is not None
        read = _plain(address) if address.planes else _checked
        content = _described(address, first[1], receiver)
        shape = first[1].images[0].shape
    except BaseException:
        receiver.close()
        raise

    def captures(config: Config) -> Iterator[Capture]:
        nonlocal first
        waiting, first = first, None
        try:
            while True:
                if waiting is not None:
                    try:
                        capture = read(*waiting, config)
                        _check_shape(capture, shape)
                    except DataError:
                        receiver.unreadable += 1
                    else:
                        yield capture
                waiting = receiver.next_frame(_LOOK_S)
                if waiting is None and (receiver.ended or clock() - receiver.heard_s > address.idle_s):
                    return
        finally:
            receiver.close()

    return content(captures)


def _first(address: Address, receiver: Receiver, clock: Callable[[], float]) -> tuple[float, Received]:
    until_s = clock() + address.wait_s
    while (left_s := until_s - clock()) > 0:
        found = receiver.next_frame(min(left_s, _LOOK_S))
        if found is not None:
            return found
    counts = receiver.counts()
    came = (
        f"{counts['packets']} packets came, {counts['incomplete']} incomplete frames"
        if counts["packets"]
        else ("nothing came")
    )
    raise DataError(
        f"udp://{address.host}:{address.port}: no complete frame within {address.wait_s:g} s ({came}); awaited packets "
        f"of {PACKET_BYTES} bytes from {START.decode()} to FRM_STOP, such as `rangecam simulate --stream` sends"
    )


def _described(
    address: Address, first: Received, receiver: Receiver
) -> Callable[[Callable[[Config], Iterator[Capture]]], Content]:
    """Return how the content is made, once its captures are known, of a stream that begins with this frame."""
    where = f"udp://{address.host}:{receiver.port}"
    if address.planes:
        preset = "generic_range" if "range_mm" in address.planes else "scaled_car"
        words: Mapping[str, Any] = {"mode": "raw", "preset": preset, "settings": {}}
    else:
        words = read_text(first.debug[0])
    mode, preset = words.get("mode"), str(words.get("preset"))
    if mode not in MODES or not first.images:
        raise DataError(f"{where}: the sender streams mode {mode!r} without images; nothing can be perceived in it")
    if preset not in preset_names():
        raise DataError(f"{where}: the sender's preset '{preset}' is none of this version's")
    settings = words.get("settings")
    notes = []
    if not isinstance(settings, dict):
        settings = {}
        notes.append(
            f"the sender's settings differ from its preset {preset} by more than the stream can say: give them here"
        )
    try:
        kind = load_config(preset, settings).camera.kind
    except UsageError as error:
        raise DataError(f"{where}: the sender's settings do not fit this version: {error}") from error
    rows, columns = first.images[0].shape
    return lambda captures: Content(
        what=f"a stream of mode {mode}",
        kind=kind,
        preset=preset,
        captures=captures,
        n_frames=lambda config: None,
        settings=settings,
        facts={"camera": {"rows": rows, "columns": columns}},
        notes=tuple(notes),
        live=receiver,
    )


def _check_shape(capture: Capture, shape: tuple[int, ...]) -> None:
    if any(plane.shape != shape for plane in capture.raw.planes.values()):
        raise DataError(f"a frame of the stream is not of {shape[0]} x {shape[1]} pixels, as the first was")


def _checked(heard_s: float, received: Received, config: Config) -> Capture:
    return capture_of(read_text(received.debug[0]), read_text(received.debug[1]), received.images, config)


def _plain(address: Address) -> Callable[[float, Received, Config], Capture]:
    def read(heard_s: float, received: Received, config: Config) -> Capture:
        return plain_capture(heard_s, received.number, dict(zip(address.planes, received.images, strict=True)), config)

    return read
