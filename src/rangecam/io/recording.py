"""Recordings as they are read and repaired: every complete frame, wherever a file ends or is damaged."""

import io
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from rangecam.errors import DataError
from rangecam.io.content import Content
from rangecam.io.files import check_source, check_target, replacing
from rangecam.io.messages import MARKER, read_capture, read_marker
from rangecam.io.recorder import LAYOUT, PROFILE, begin_file, checksum
from rangecam.types import Capture

_LARGEST_CHUNK = 1 << 30


def open_recording(path: Path) -> Content:
    """Return the complete frames of a recording and the settings that it was made with.

    A file that was cut off gives the frames that are whole, and a note that says so.
    Raises DataError for a file that is no recording of rangecam's or has no complete frame, and, while the frames are
    read, if the file is damaged in between.
    """
    facts, settings = _read_facts(path)
    n_frames = _indexed(path)
    notes: tuple[str, ...] = ()
    if not n_frames:
        n_frames = sum(frame is not None for frame in _frames(path))
        notes = (
            f"{path} was cut off or damaged, or is still being written: its {n_frames} complete frames are used "
            "(rangecam repair makes a whole file of them)",
        )
    if not n_frames:
        raise DataError(f"{path}: holds no complete frame")
    return Content(
        what=f"recorded samples of {settings['camera'].get('name') or 'a camera'}",
        kind=settings["camera"].get("kind"),
        preset=facts["preset"],
        settings=settings,
        captures=lambda _: _captures(path, None if notes else n_frames),
        n_frames=lambda _: n_frames,
        notes=notes,
    )


def repair(path: Path | str, out: Path | str) -> int:
    """Copy the complete frames of a recording, unchanged, into a new and whole one and return how many there are.

    Raises UsageError if there is no such file or `out` cannot be written; DataError, with nothing written, if the file
    is no recording of rangecam's or has no complete frame.
    """
    path, out = check_source(path), check_target(out, str(path))
    facts, _ = _read_facts(path)
    n_frames = 0
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    with replacing(out) as part:
        with part.open("wb") as file:
            writer = begin_file(file)
            writer.add_metadata(PROFILE, facts)
            for entries in filter(None, _frames(path)):
                for entry in entries:
                    _copy(writer, entry, schemas, channels)
                writer.flush()
                n_frames += 1
            writer.finish()
        if not n_frames:
            raise DataError(f"{path}: holds no complete frame")
    return n_frames


def _copy(writer: Writer, entry: "_Entry", schemas: dict[str, int], channels: dict[str, int]) -> None:
    """Write one message with its schema and channel; both dicts, name -> number, are kept up to date."""
    topic, schema, message = entry.channel.topic, entry.schema, entry.message
    if topic not in channels:
        if schema.name not in schemas:
            schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
        encoding = entry.channel.message_encoding
        channels[topic] = writer.register_channel(topic, encoding, schemas[schema.name])
    writer.add_message(channels[topic], message.log_time, message.data, message.publish_time, message.sequence)


class _Clipped(io.BufferedReader):
    """A file that is never asked for more than there is, whatever length a damaged record states."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path), 1 << 20)
        self.size = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """Return up to `size` bytes."""
        left = self.size - self.tell()
        return super().read(left if size is None or size < 0 else min(size, left))


def _records(file: _Clipped) -> Iterator[McapRecord | None]:
    """Yield the records of a file, chunks unopened; the last one is None if it does not end as it should."""
    records = StreamReader(file, emit_chunks=True, record_size_limit=file.size).records
    try:
        yield from records
    except Exception:  # whatever the reader makes of a file that ends or goes wrong anywhere
        yield None


def _open_chunk(chunk: Chunk) -> list[McapRecord] | None:
    """Return the records inside a chunk, None if it is damaged."""
    try:
        known = chunk.compression != "zstd" or zstandard.frame_content_size(chunk.data) in (-1, chunk.uncompressed_size)
        if chunk.uncompressed_size > _LARGEST_CHUNK or not known:
            return None
        return breakup_chunk(chunk, validate_crc=True)
    except Exception:  # whatever decompression and parsing make of damaged bytes
        return None


def _read_facts(path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """Return what the beginning of a recording says of it, and the settings; raises DataError if it is none."""
    with _Clipped(path) as file:
        records = _records(file)
        header = next(records, None)
        if not isinstance(header, Header):
            raise DataError(f"{path}: not an MCAP file, or cut off at its very beginning")
        if header.profile != PROFILE:
            raise DataError(f"{path}: an MCAP file, but not a recording of rangecam's (profile '{header.profile}')")
        found = (r.metadata for r in records if isinstance(r, Metadata) and r.name == PROFILE)
        facts = next(found, None)
    if facts is None:
        raise DataError(f"{path}: holds no complete frame: it was cut off before the first one")
    if facts.get("layout") != LAYOUT:
        raise DataError(
            f"{path}: written by rangecam {facts.get('version')} in layout {facts.get('layout')}; "
            f"this version reads layout {LAYOUT}"
        )
    if checksum({key: value for key, value in facts.items() if key != "crc32"}) != facts.get("crc32"):
        raise DataError(f"{path}: its settings are damaged (checksum)")
    settings: dict[str, Any] = json.loads(facts["settings"])
    return facts, settings


def _indexed(path: Path) -> int | None:
    """Return the number of frames that the index at the end of a whole file states, None if there is no index."""
    try:
        with _Clipped(path) as file:
            summary = SeekingReader(file, record_size_limit=file.size).get_summary()
    except Exception:  # whatever the reader makes of a file that was cut off
        return None
    if summary is None or summary.statistics is None:
        return None
    markers = [number for number, channel in summary.channels.items() if channel.topic == MARKER]
    return sum(summary.statistics.channel_message_counts.get(number, 0) for number in markers)


@dataclass(frozen=True)
class _Entry:
    schema: Schema
    channel: Channel
    message: Message


def _frames(path: Path) -> Iterator[list[_Entry] | None]:
    """Yield the messages of each complete frame, in the order of the file; None where something is damaged or lost."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    pending: list[_Entry] = []
    with _Clipped(path) as file:
        for record in _records(file):
            inside = _open_chunk(record) if isinstance(record, Chunk) else [record]
            for item in [None] if inside is None else inside:
                if isinstance(item, Schema):
                    schemas[item.id] = item
                elif isinstance(item, Channel):
                    channels[item.id] = item
                elif isinstance(item, Message) and item.channel_id in channels:
                    channel = channels[item.channel_id]
                    pending.append(_Entry(schemas[channel.schema_id], channel, item))
                    if channel.topic == MARKER:
                        yield pending if _is_complete(pending) else None
                        pending = []
                elif item is None or isinstance(item, Message):
                    yield None
                    pending = []


def _is_complete(entries: list[_Entry]) -> bool:
    """Return whether the messages are those that the marker at their end names."""
    *others, marker = entries
    try:
        _, _, topics = read_marker(marker.message.data)
    except DataError:
        return False
    return topics == [entry.channel.topic for entry in others]


def _captures(path: Path, indexed: int | None) -> Iterator[Capture]:
    """Yield the capture of each complete frame.

    indexed: the number of frames in a file that seemed whole; raises DataError if they are not all there.
    """
    n = 0
    for entries in _frames(path):
        if entries is not None:
            try:
                yield read_capture({entry.channel.topic: entry.message.data for entry in entries})
            except DataError as error:
                raise DataError(f"{path}: frame {n}: {error}") from error
            n += 1
        elif indexed is not None:
            raise DataError(f"{path}: damaged after {n} frames; rangecam repair copies the ones that are not")
    if indexed not in (None, n):
        raise DataError(f"{path}: damaged: {n} of {indexed} frames found; rangecam repair makes a whole file of them")
