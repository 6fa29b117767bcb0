"""Recordings as they are written: MCAP files of raw samples, settings and results.

The file begins with the complete settings. Each frame is one chunk with a checksum, handed to the operating system
before the next frame is taken; its last message says which ones belong to it. A file that ends anywhere opens up to its
last complete frame.

    /raw/PLANE                          raw samples, of their own type       /ego, /truth, /truth/PLANE  if known
    /image/range sigma amplitude why    what became of them                  /tracks, /decision          in full
    /objects                            boxes to draw, in vehicle axes       /frame                      the marker
    /camera/calibration, /tf            lens and mounting, with the first frame
"""

import json
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from rangecam.config import Config, tree
from rangecam.io.files import check_target
from rangecam.io.messages import (
    SCHEMAS,
    Json,
    Payload,
    capture_messages,
    marker_message,
    nanoseconds,
    to_bytes,
)
from rangecam.io.results import geometry_messages, result_messages
from rangecam.types import Capture, Frame

PROFILE = "rangecam"
"""Profile in the header of the file and name of the metadata record that holds the settings."""
LAYOUT = "1"
"""Version of the topics and their meaning."""
_UNLIMITED = 1 << 62


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
        writer = begin_file(self._file)
        settings = json.dumps(tree(self._config), allow_nan=False)
        facts = {"layout": LAYOUT, "version": __version__, "preset": self._config.preset, "source": self._source}
        facts["settings"] = settings
        writer.add_metadata(PROFILE, {**facts, "crc32": checksum(facts)})
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


def begin_file(file: IO[bytes]) -> Writer:
    """Return a begun writer that closes a chunk only when it is told to."""
    writer = Writer(file, chunk_size=_UNLIMITED)
    writer.start(profile=PROFILE, library="rangecam")
    return writer


def checksum(facts: Mapping[str, str]) -> str:
    """Return the checksum of everything that is said at the beginning, which the file format itself does not check."""
    return f"{zlib.crc32(json.dumps(facts, sort_keys=True).encode()):08x}"
