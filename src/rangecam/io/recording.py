"""Recordings: MCAP files of raw samples, settings and results, which a kill or a full disk cannot spoil.

The file begins with the complete settings. Each frame is one chunk with a checksum, handed to the operating system
before the next frame is taken; its last message says which ones belong to it. A file that ends anywhere opens up to its
last complete frame.

    /raw/PLANE                          raw samples, of their own type       /ego, /truth, /truth/PLANE  if known
    /image/range sigma amplitude why    what became of them                  /tracks, /decision          in full
    /objects                            boxes to draw, in vehicle axes       /frame                      the marker
    /camera/calibration, /tf            lens and mounting, with the first frame
"""

import io
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import zstandard
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from rangecam.config import Config, tree
from rangecam.errors import DataError
from rangecam.io.content import Content
from rangecam.io.files import check_source, check_target, replacing
from rangecam.io.messages import (
    MARKER,
    SCHEMAS,
    Json,
    Payload,
    capture_messages,
    marker_message,
    nanoseconds,
    read_capture,
    read_marker,
    to_bytes,
)
from rangecam.io.results import geometry_messages, result_messages
from rangecam.types import Capture, Frame

PROFILE = "rangecam"
"""Profile in the header of the file and name of the metadata record that holds the settings."""
LAYOUT = "1"
"""Version of the topics and their meaning."""
_UNLIMITED = 1 << 62
_LARGEST_CHUNK = 1 << 30


class Recorder:
    """Writes a recording; with results where it is given any. A sink of `pipeline.run`.

    The file is begun with the first frame, so that a call that fails before leaves nothing, and from then on kept
    whatever happens: after an error it holds the frames until then.
    Raises UsageError at once if `path` cannot be written or is the file `source` that is read.
    """

    def __init__(self, path: Path | str, config: Config, source: str = "") -> None:
        self._path, self._config, self._source = check_target(path, source), config, source
        self._file: IO[bytes] | None = None
        self._writer: Writer | None = None
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._frames = 0

    def write(self, capture: Capture, frame: Frame | None = None) -> None:
        """Write one capture and, if given, what was made of it; raises OSError if the disk is full."""
        raw = capture.raw
        topics = list(capture_messages(capture))
        if frame is not None:
            topics += result_messages(frame)
        if self._writer is None:
            topics = [*geometry_messages(self._config, raw.shape, raw.time_s), *topics]
            self._writer = self._begin()
        topics.append(marker_message(raw, [topic for topic, _ in topics]))
        time_ns = nanoseconds(raw.time_s)
        try:
            for topic, payload in topics:
                channel = self._channel(self._writer, topic, payload)
                self._writer.add_message(channel, time_ns, to_bytes(payload), time_ns, self._frames)
            self._writer.flush()
        except OSError:
            self._abandon()
            raise
        self._frames += 1

    def _abandon(self) -> None:
        """Close the file as it is: it ends within a frame, and nothing may be written behind that."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def _begin(self) -> Writer:
        from rangecam import __version__

        self._file = self._path.open("wb")
        writer = _start(self._file)
        settings = json.dumps(tree(self._config), allow_nan=False)
        facts = {"layout": LAYOUT, "version": __version__, "preset": self._config.preset, "source": self._source}
        facts["settings"] = settings
        writer.add_metadata(PROFILE, {**facts, "crc32": _crc(facts)})
        return writer

    def _channel(self, writer: Writer, topic: str, payload: Payload) -> int:
        if topic not in self._channels:
            if isinstance(payload, Json):
                name, kind, encoding = payload.schema, "jsonschema", "json"
                schema = json.dumps({"title": name, **SCHEMAS[name]}).encode()
            else:
                name, kind, encoding = payload.DESCRIPTOR.full_name, "protobuf", "protobuf"
                schema = build_file_descriptor_set(type(payload)).SerializeToString()
            if name not in self._schemas:
                self._schemas[name] = writer.register_schema(name, kind, schema)
            self._channels[topic] = writer.register_channel(topic, encoding, self._schemas[name])
        return self._channels[topic]

    def close(self) -> None:
        """Write the index that lets other tools jump to any time, and close the file."""
        if self._file is None or self._writer is None or self._file.closed:
            return
        try:
            self._writer.finish()
            self._file.close()
        except OSError:
            self._abandon()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _start(file: IO[bytes]) -> Writer:
    """Return a begun writer that closes a chunk only when it is told to."""
    writer = Writer(file, chunk_size=_UNLIMITED)
    writer.start(profile=PROFILE, library="rangecam")
    return writer


def _crc(facts: Mapping[str, str]) -> str:
    """Return the checksum of everything that is said at the beginning, which the file format itself does not check."""
    return f"{zlib.crc32(json.dumps(facts, sort_keys=True).encode()):08x}"


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
            writer = _start(file)
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
    if _crc({key: value for key, value in facts.items() if key != "crc32"}) != facts.get("crc32"):
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
