"""Captures as messages and back: images in Foxglove's protobuf schema, everything else in JSON.

A message is a topic and a payload, a protobuf message or a `Json` value. Numbers in JSON are exact; those that JSON
does not have are the strings "NaN", "Infinity" and "-Infinity".

Images are foxglove.RawImage, row by row without padding. Types that other tools know have their names (mono8, mono16,
32FC1); any other is "numpy:" and the type as NumPy writes it (numpy:<f8, numpy:|b1, ...).
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError, Message
from google.protobuf.timestamp_pb2 import Timestamp

from rangecam.errors import DataError
from rangecam.types import Capture, Ego, Floats, Image, RawFrame, Truth

OPTICAL = "camera_optical"
"""Frame of reference of images as other tools want it: z forward, x right, y down."""
MARKER = "/frame"
"""Topic of the last message of each frame: without it the frame is not complete."""
RAW = "/raw/"
"""Topics of the raw planes begin with it."""


@dataclass(frozen=True)
class Json:
    """A JSON payload and the name of its schema, a key of `SCHEMAS`."""

    schema: str
    value: Mapping[str, Any]


Payload: TypeAlias = Message | Json
Topic: TypeAlias = tuple[str, Payload]

_NUMBER, _INTEGER, _BOOLEAN, _TEXT = ({"type": name} for name in ("number", "integer", "boolean", "string"))
_NUMBERS, _TEXTS = ({"type": "array", "items": item} for item in (_NUMBER, _TEXT))
_ROWS = {"type": "array", "items": _NUMBERS}


def _schema(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


SCHEMAS = {
    "rangecam.Frame": _schema(frame_id=_INTEGER, time_s=_NUMBER, topics=_TEXTS),
    "rangecam.Ego": _schema(
        time_s=_NUMBER,
        speed_mps=_NUMBER,
        yaw_rate_radps=_NUMBER,
        forward=_BOOLEAN,
        braking=_BOOLEAN,
        friction=_NUMBER,
    ),
    "rangecam.Truth": _schema(names=_TEXTS, positions_m=_ROWS, velocities_mps=_ROWS),
    "rangecam.Tracks": _schema(
        time_s=_NUMBER,
        next_id=_INTEGER,
        tracks={
            "type": "array",
            "items": _schema(
                track_id=_INTEGER,
                status=_TEXT,
                state=_NUMBERS,
                covariance=_ROWS,
                age=_INTEGER,
                hits=_INTEGER,
                misses=_INTEGER,
                size_m=_NUMBERS,
                near_offset_m=_NUMBER,
                n_pixels=_NUMBER,
                segment=_INTEGER,
                class_probability=_NUMBERS,
                nis=_NUMBER,
            ),
        },
    ),
    "rangecam.Decision": _schema(
        time_s=_NUMBER,
        brake=_BOOLEAN,
        reason=_TEXT,
        track_id=_INTEGER,
        distance_m=_NUMBER,
        closing_speed_mps=_NUMBER,
        stopping_distance_m=_NUMBER,
        needed_deceleration_mps2=_NUMBER,
        ttc_s=_NUMBER,
        ttc_sigma_s=_NUMBER,
        p_collision=_NUMBER,
        collisions=_schema(
            ttc_s=_NUMBERS,
            ttc_sigma_s=_NUMBERS,
            lateral_m=_NUMBERS,
            p_collision=_NUMBERS,
            ttc_quantiles_s=_ROWS,
            side=_NUMBERS,
            closest_m=_NUMBERS,
            closest_s=_NUMBERS,
        ),
    ),
}
"""JSON schemas of the messages that are JSON."""


def to_bytes(payload: Payload) -> bytes:
    """Return the bytes of a message."""
    if isinstance(payload, Json):
        return json.dumps(_plain(payload.value), allow_nan=False).encode()
    data: bytes = payload.SerializeToString()
    return data


def _plain(value: Any) -> Any:
    """Return `value` made of what JSON has: arrays as lists, NaN and infinities as strings."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def nanoseconds(time_s: float) -> int:
    """Return the time stamp of other tools, which has no place for NaN and times before zero: both become zero."""
    return 0 if math.isnan(time_s) else round(min(max(time_s, 0.0), 9e9) * 1e9)


def timestamp(time_s: float) -> Timestamp:
    """Return the same as a protobuf message."""
    seconds, nanos = divmod(nanoseconds(time_s), 10**9)
    return Timestamp(seconds=seconds, nanos=nanos)


_KINDS = "buifc"
_NAMES: dict[np.dtype[Any], str] = {np.dtype("u1"): "mono8", np.dtype("<u2"): "mono16", np.dtype("<f4"): "32FC1"}
_DTYPES: dict[str, np.dtype[Any]] = {name: dtype for dtype, name in _NAMES.items()}


def image_message(image: Image, time_s: float) -> RawImage:
    """Return an (H, W) array of numbers or truth values as a message that holds every bit; see `read_image`.

    Raises DataError for anything else.
    """
    if image.ndim != 2 or image.dtype.kind not in _KINDS:
        raise DataError(
            f"cannot record an array of shape {image.shape} of {image.dtype}; it must be an image of numbers"
        )
    height, width = image.shape
    return RawImage(
        timestamp=timestamp(time_s),
        frame_id=OPTICAL,
        width=width,
        height=height,
        encoding=_NAMES.get(image.dtype, f"numpy:{image.dtype.str}"),
        step=width * image.dtype.itemsize,
        data=image.tobytes(),
    )


def read_image(data: bytes) -> Image:
    """Return the array that `image_message` made a message of; raises DataError for one that is no such image."""
    try:
        message = RawImage.FromString(data)
        name: str = message.encoding
        dtype = _DTYPES[name] if name in _DTYPES else np.dtype(name.removeprefix("numpy:"))
        if dtype.kind not in _KINDS:
            raise TypeError(f"type {dtype}")
        flat = np.frombuffer(message.data, dtype).copy()  # a copy, because the buffer cannot be written to
        return flat.reshape(message.height, message.width)
    except (DecodeError, TypeError, ValueError, SyntaxError) as error:
        raise DataError(f"not an image of numbers: {error}") from error


def capture_messages(capture: Capture) -> Iterator[Topic]:
    """Yield all messages of a capture but the marker, which goes last; `read_capture` is the inverse."""
    raw, ego, truth = capture.raw, capture.ego, capture.truth
    for name, plane in raw.planes.items():
        yield RAW + name, image_message(plane, raw.time_s)
    values = {
        "time_s": ego.time_s,
        "yaw_rate_radps": ego.yaw_rate_radps,
        "forward": ego.forward,
        "braking": ego.braking,
    }
    for name in _WHERE_KNOWN:
        if getattr(ego, name) is not None:
            values[name] = getattr(ego, name)
    yield "/ego", Json("rangecam.Ego", values)
    if truth is not None:
        for name in _TRUTH_IMAGES:
            yield f"/truth/{name}", image_message(getattr(truth, name), raw.time_s)
        lists = {"names": truth.names, "positions_m": truth.positions_m, "velocities_mps": truth.velocities_mps}
        yield "/truth", Json("rangecam.Truth", lists)


_WHERE_KNOWN = ("speed_mps", "friction")
_TRUTH_IMAGES = ("range_m", "reflectivity", "object_id")


def marker_message(raw: RawFrame, topics: list[str]) -> Topic:
    """Return the last message of a frame, which names the topics of all messages before it."""
    values = {"frame_id": raw.frame_id, "time_s": raw.time_s, "topics": topics}
    return MARKER, Json("rangecam.Frame", values)


def read_marker(data: bytes) -> tuple[int, float, list[str]]:
    """Return frame_id, time_s and the topics of the frame; raises DataError if it is no marker."""
    try:
        values = json.loads(data)
        return int(values["frame_id"]), float(values["time_s"]), [str(topic) for topic in values["topics"]]
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise DataError(f"{MARKER} is not a marker of rangecam: {error!r}") from error


def read_capture(messages: Mapping[str, bytes]) -> Capture:
    """Return the capture of a complete frame, given the bytes of its messages by topic.

    Raises DataError that names the topic at fault.
    """
    topic = MARKER
    try:
        frame_id, time_s, _ = read_marker(messages[MARKER])
        planes = {}
        for topic in messages:
            if topic.startswith(RAW):
                planes[topic.removeprefix(RAW)] = read_image(messages[topic])
        if not planes:
            raise DataError("no raw plane in it")
        topic = "/ego"
        ego = json.loads(messages[topic])
        speed, friction = (float(ego[name]) if name in ego else None for name in _WHERE_KNOWN)
        yaw_rate, forward, braking = float(ego["yaw_rate_radps"]), bool(ego["forward"]), bool(ego.get("braking"))
        state = Ego(float(ego["time_s"]), speed, yaw_rate, forward, braking, friction)
        topic = "/truth"
        truth = _read_truth(messages) if topic in messages else None
    except DataError as error:
        raise DataError(f"{topic}: {error}") from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise DataError(f"{topic} cannot be read: {error!r}") from error
    return Capture(RawFrame(time_s, planes, frame_id), state, truth)


def _read_truth(messages: Mapping[str, bytes]) -> Truth:
    values = json.loads(messages["/truth"])
    range_m, reflectivity, object_id = (read_image(messages[f"/truth/{name}"]) for name in _TRUTH_IMAGES)
    names = tuple(str(name) for name in values["names"])
    return Truth(range_m, reflectivity, object_id, names, _rows(values["positions_m"]), _rows(values["velocities_mps"]))


def _rows(rows: list[list[float | str]]) -> Floats:
    """Return the (K, 3) array of a JSON list."""
    return np.array([[float(value) for value in row] for row in rows], np.float64).reshape(-1, 3)
