"""What the whole chain sees of random drives: the features of tracks, and the class that the truth knows."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from rangecam.cameras.simulated import frames
from rangecam.classify.features import FEATURES, observe
from rangecam.config import load_config
from rangecam.pipeline import process_frame
from rangecam.training.drives import Drive, DriveSettings, random_drive
from rangecam.types import Capture, Floats, Frame, Ints, Tracks, TrackStatus

_EVERY = 3  # frames from one example of a track to the next
_OWN_SHARE = 0.7  # of the pixels of a segment that must show things of one class


@dataclass(frozen=True, eq=False)
class Examples:
    """Moments of tracks.

    features (N, F): see `classify.features`. classes (N,): index of `CLASSES` that the truth has. given (N, 4): class
    probabilities that the configuration of the drives gave. range_m (N,). pixels (N, 2): columns and rows of its box in
    the image, cut (N,): bits of `Cut`, share (N,): of the pixels that show its main object, those that are in its
    segment; all of that moment. kinds (N,) str. drives (N,) int: where each comes from:
    examples of one drive belong together.
    """

    features: Floats
    classes: Ints
    given: Floats
    range_m: Floats
    pixels: Ints
    cut: Ints
    share: Floats
    kinds: np.ndarray[tuple[int, ...], np.dtype[np.str_]]
    drives: Ints

    def __len__(self) -> int:
        return len(self.classes)


class Lot(NamedTuple):
    """Drives to simulate: their sensor, what is drawn, seed and number of each, settings over the preset."""

    preset: str
    given: DriveSettings
    seed: int
    numbers: range
    settings: Mapping[str, Any] = {}


def simulated(lot: Lot) -> Examples:
    """Return what is seen of each drive of a lot.

    Each third frame of a confirmed track is an example, if its segment shows things of one class.
    """
    config = load_config(lot.preset, lot.settings)
    rows: list[tuple[Any, ...]] = []
    for number in lot.numbers:
        rng = np.random.default_rng([lot.seed, number])
        drive = random_drive(lot.preset, lot.given, rng)
        tracks, image = Tracks.empty(), None
        for k, capture in enumerate(frames(drive.scenario, config, int(rng.integers(2**31)))):
            frame = process_frame(capture.raw, tracks, capture.ego, config, before=image)
            memory, features = observe(frame.tracks, capture.ego, frame.segments)
            rows += [(*seen, number) for seen in _seen(capture, frame, features, drive, k)]
            tracks, image = replace(frame.tracks, class_memory=memory), frame.image
    return _examples(rows)


def joined(several: Iterable[Examples]) -> Examples:
    """Return all examples as one; those of the drives of each part keep apart."""
    parts, first = [], 0
    for part in several:
        parts.append(replace(part, drives=part.drives + first))
        first += int(part.drives.max(initial=-1)) + 1
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Examples(*(np.concatenate(column) for column in columns))


def _examples(rows: list[tuple[Any, ...]]) -> Examples:
    features, classes, given, range_m, pixels, cut, share, kinds, drives = (
        zip(*rows, strict=True) if rows else ((),) * 9
    )
    return Examples(
        np.array(features, float).reshape(-1, len(FEATURES)),
        np.array(classes, int),
        np.array(given, float).reshape(-1, 4),
        np.array(range_m, float),
        np.array(pixels, int).reshape(-1, 2),
        np.array(cut, int),
        np.array(share, float),
        np.array(kinds, str),
        np.array(drives, int),
    )


def _seen(capture: Capture, frame: Frame, features: Floats, drive: Drive, k: int) -> list[tuple[Any, ...]]:
    """Return a row of `Examples`, but for the drive, for each track whose turn it is in frame `k`."""
    tracks, found = frame.tracks, []
    if capture.truth is None:
        return []
    of_object = np.array([0, *drive.classes])
    for i in np.flatnonzero((tracks.status == TrackStatus.CONFIRMED) & (tracks.segment > 0)):
        if (k + int(tracks.track_id[i])) % _EVERY:
            continue
        objects = np.maximum(capture.truth.object_id[frame.labels == tracks.segment[i]], 0)
        counts = np.bincount(of_object[objects], minlength=4)
        best = int(np.argmax(counts))
        if best == 0 or counts[best] < _OWN_SHARE * counts.sum():
            continue
        per_object = np.bincount(objects, minlength=len(of_object))[1:]
        main = int(np.argmax(per_object))
        share = per_object[main] / np.count_nonzero((capture.truth.object_id == main + 1) & frame.image.valid)
        segment = frame.segments[int(tracks.segment[i]) - 1]
        top, left, bottom, right = segment.box
        seen = segment.range_m, (right - left, bottom - top), segment.cut, share
        found.append((features[i], best, tracks.class_probability[i], *seen, drive.kinds[main]))
    return found
