"""The one function where data flows, and the loop around it.

Read `process_frame` from top to bottom and you have read the system. Everything else either makes a `RawFrame`
(simulation, files, wires) or uses a `Frame` (recorder, report, bus, applications).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from rangecam import cw, processed, pulsed
from rangecam.brake import decide
from rangecam.classify import classify
from rangecam.clean import clean
from rangecam.config import Config
from rangecam.geometry import to_world
from rangecam.hdr import ranged
from rangecam.segmentation import measure_segments, segment
from rangecam.tracking import update_tracks
from rangecam.types import Capture, Ego, Frame, RangeImage, RawFrame, Tracks

RANGING: dict[str, Callable[..., RangeImage]] = {**pulsed.RANGING, **cw.RANGING, **processed.RANGING}
"""Ranging methods by name, of all camera families: (RawFrame, camera settings) -> RangeImage."""


def call(stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call `function`; `process_frame` calls every stage through this, so that a caller can time or keep them."""
    return function(*arguments)


def process_frame(
    raw: RawFrame,
    tracks: Tracks,
    ego: Ego,
    config: Config,
    step: Callable[..., Any] = call,
    before: RangeImage | None = None,
) -> Frame:
    """One step of perception: raw samples in, decision out. Pure: same arguments, same Frame.

    `step(stage, function, *arguments)` calls each stage; it may watch, but must return what the function returns.
    `before` is the image of the last frame, for cleaning that averages over time.
    """
    camera, lens, mounting = config.camera, config.camera.lens, config.mounting
    image = step("ranging", ranged, RANGING[config.ranging], raw, camera)
    image = step("clean", clean, image, lens, mounting, config.clean, before)
    points = step("geometry", to_world, image, lens, mounting)
    labels = step("segmentation", segment, config.segmentation, image, points, config.segments, tracks)
    segments = step("segments", measure_segments, labels, points, image, lens, mounting, config.segments)
    tracks = step("tracking", update_tracks, tracks, segments, image.time_s, config.tracking, ego)
    tracks = step("classification", classify, tracks, ego, config.classification, segments)
    decision = step("decision", decide, tracks, ego, config.decision)
    return Frame(raw, image, labels, segments, tracks, decision)


def warm_up(capture: Capture, config: Config) -> None:
    """Compile every kernel that this configuration needs, so that the first object need not wait seconds for it.

    The frame goes through the chain, and then the stages after it get one object, should it hold none.
    """
    process_frame(capture.raw, Tracks.empty(), capture.ego, config)
    lens, shape = config.camera.lens, capture.raw.shape
    plane = np.full(shape, 2.0, np.float32)
    image = RangeImage(0.0, plane, plane, plane, np.zeros(shape, np.uint8))
    points = to_world(image, lens, config.mounting)
    segment(config.segmentation, image, points, config.segments, Tracks.empty())
    one, two = np.ones(shape, np.int32), np.ones(shape, np.int32)
    two[:, (shape[1] + 1) // 2 :] = 2  # an image of one column has one object only
    tracks = Tracks.empty()
    for time_s, labels in ((0.0, one), (0.1, two), (0.2, one)):  # objects that part and merge
        segments = measure_segments(labels, points, image, lens, config.mounting, config.segments)
        tracks = update_tracks(tracks, segments, time_s, config.tracking, capture.ego)
        tracks = classify(tracks, capture.ego, config.classification, segments)
        decide(tracks, capture.ego, config.decision)


class Sink(Protocol):
    """Whoever uses frames: a recorder, a report, an export. `close` is called once, also after an error."""

    def write(self, capture: Capture, frame: Frame) -> None:
        """Take in one frame and the capture that it came from."""

    def close(self) -> None:
        """Finish what was begun."""


def run(
    captures: Iterable[Capture], config: Config, sinks: Sequence[Sink] = (), step: Callable[..., Any] = call
) -> Iterator[Frame]:
    """Yield the Frame of each capture, after every sink has had it; tracks and image are the memory of the next."""
    tracks, image = Tracks.empty(), None
    for capture in captures:
        frame = process_frame(capture.raw, tracks, capture.ego, config, step, image)
        for sink in sinks:
            sink.write(capture, frame)
        tracks, image = frame.tracks, frame.image
        yield frame
