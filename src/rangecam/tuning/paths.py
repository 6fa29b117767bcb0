"""What tracks took, and how likely it is to a tracker with other settings."""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from rangecam.errors import DataError
from rangecam.tracking import TrackingSettings, update_tracks
from rangecam.types import POSITION, VELOCITY, Floats, Frame, Ints, Refused, Segments, Tracks, TrackStatus
from rangecam.values import value

_APART_M = 1e6  # the paths are filtered side by side, so far apart that none can be taken for another
_ROWS, _COLUMNS = np.ix_(POSITION, POSITION)


@value
class Paths:
    """What the confirmed tracks of a source took, and the settings that they were followed with.

    count: of the paths. gap: most frames in a row in which one was not seen. time_s (F,): of the frames; ends (F,): how
    many rows of `segments` there are up to each. The segments are numbered by their path (label 1..count) and moved
    aside by its number times 1000 km. notes: what the source has to say.
    """

    name: str
    tracking: TrackingSettings
    count: int
    gap: int
    time_s: Floats
    ends: Ints
    segments: Segments
    notes: tuple[str, ...] = ()


class Likelihood(NamedTuple):
    """Sum of the log-likelihoods of the measurements after each path's first, sum of their NIS, and their number."""

    total: float
    nis: float
    measurements: int

    def __add__(self, other: Any) -> "Likelihood":
        return Likelihood(self.total + other.total, self.nis + other.nis, self.measurements + other.measurements)


def follow(url: str, preset: str | None = None, layers: Sequence[Mapping[str, Any]] = (), seed: int = 0) -> Paths:
    """Perceive a source and return the paths of its confirmed tracks; arguments and errors as of `io.open_source`.

    Merges are not recognised meanwhile: a segment of several tracks is nobody's measurement.
    """
    from rangecam import pipeline
    from rangecam.io import open_source

    opened = open_source(url, preset=preset, layers=layers, seed=seed)
    alone = dataclasses.replace(opened.config.tracking, recognise_merges=False)
    frames = pipeline.run(opened.captures, dataclasses.replace(opened.config, tracking=alone))
    return paths_of(opened.name, frames, opened.config.tracking, tuple(opened.notes))


def paths_of(name: str, frames: Iterable[Frame], tracking: TrackingSettings, notes: tuple[str, ...] = ()) -> Paths:
    """Return the paths of the tracks in `frames` that were ever confirmed, from their first measurement on."""
    taken, confirmed = [], set()
    for frame in frames:
        tracks, segments = frame.tracks, frame.segments
        if tracks.refused in (Refused.REPEATED, Refused.LATE):
            continue
        own = np.flatnonzero(tracks.segment > 0)
        row = {label: j for j, label in enumerate(segments.label.tolist())}
        taken.append((tracks.time_s, segments, tracks.track_id[own], [row[label] for label in tracks.segment[own]]))
        confirmed |= set(tracks.track_id[tracks.status != TrackStatus.TENTATIVE].tolist())
    number = {track_id: k + 1 for k, track_id in enumerate(sorted(confirmed))}
    steps = []
    for time_s, segments, ids, rows in taken:
        kept = [(number[i], row) for i, row in zip(ids.tolist(), rows, strict=True) if i in number]
        numbers, picked = np.array(kept, int).reshape(-1, 2).T
        steps.append((time_s, dataclasses.replace(_part(segments, picked), label=numbers)))
    return side_by_side(name, steps, tracking, notes)


def side_by_side(
    name: str, steps: Sequence[tuple[float, Segments]], tracking: TrackingSettings, notes: tuple[str, ...] = ()
) -> Paths:
    """Return the paths of segments whose labels are the numbers of their paths, 1..count, frame by frame.

    Raises DataError if there is no frame.
    """
    if not steps:
        raise DataError(f"{name}: no frame that could be followed")
    every = [_measured(segments) for _, segments in steps]
    joined = Segments(**{key: np.concatenate([one[key] for one in every]) for key in every[0]})
    sizes = [len(segments) for _, segments in steps]
    order, frame = np.argsort(joined.label, kind="stable"), np.repeat(np.arange(len(steps)), sizes)
    same = np.diff(joined.label[order]) == 0
    gap = int(np.max(np.diff(frame[order])[same], initial=1)) - 1
    aside = np.outer(joined.label, [0.0, _APART_M, 0.0])
    moved = dataclasses.replace(joined, position_m=joined.position_m + aside)
    if joined.ends_m is not None:
        moved = dataclasses.replace(moved, ends_m=joined.ends_m + aside[:, 1:2])
    times = np.array([time_s for time_s, _ in steps])
    return Paths(name, tracking, int(np.max(joined.label, initial=0)), gap, times, np.cumsum(sizes), moved, notes)


def _part(segments: Segments, which: Any) -> Segments:
    return Segments(**{key: array[which] for key, array in _measured(segments).items()})


def _measured(segments: Segments) -> dict[str, Any]:
    """Return the fields of segments that were measured, without profile and surface: no filter asks for them."""
    return {k: each for k, each in vars(segments).items() if k not in ("profile", "surface") and each is not None}


def likelihood(paths: Paths, settings: TrackingSettings) -> Likelihood:
    """Return how likely the measurements of the paths are to a tracker with these settings.

    Each adds -(3 log 2 pi + log det S + NIS) / 2 with S the covariance of its innovation. The tracks themselves say
    what is needed: one step without any segment is the prediction, and a track that is just born has the measurement's
    covariance with all that the settings add to it; so the kernels need not keep det S for every frame. Of an
    interacting model S is that of the mean. Rules of life and gates are off. The total is -inf if a measurement is more
    than a thousand standard deviations off.
    """
    settings = dataclasses.replace(
        settings,
        gate_probability=1.0,
        association="global",
        use_shape=False,
        recognise_merges=False,  # each measurement is one path's
        confirm_hits=1,
        max_misses=paths.gap + 1,  # one more for the step without any segment
        max_position_sigma_m=_APART_M / 2000,
    )
    tracks, innovations, covariances = Tracks.empty(), [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
    nothing, noise = _part(paths.segments, slice(0)), _noise(paths, settings)
    for time_s, start, end in zip(paths.time_s.tolist(), [0, *paths.ends[:-1]], paths.ends, strict=True):
        segments, R = _part(paths.segments, slice(start, end)), noise[start:end]
        predicted = update_tracks(tracks, nothing, time_s, settings)
        tracks = update_tracks(tracks, segments, time_s, settings)
        row = np.full(paths.count + 1, -1)
        row[np.rint(predicted.state[:, 3] / _APART_M).astype(int)] = np.arange(len(predicted))
        known = row[segments.label] >= 0
        own = row[segments.label[known]]
        if not np.array_equal(tracks.segment[own], segments.label[known]):
            return Likelihood(-math.inf, math.inf, 1)
        moved = settings.frame_time_sigma_s * predicted.state[own][:, VELOCITY]
        innovations.append(segments.position_m[known] - predicted.state[own][:, POSITION])
        covariances.append(
            predicted.covariance[own][:, _ROWS, _COLUMNS] + R[known] + moved[:, :, None] * moved[:, None]
        )
    return _of_innovations(np.concatenate(innovations), np.concatenate(covariances))


def _noise(paths: Paths, settings: TrackingSettings) -> Floats:
    """Return the covariances (N, 3, 3) of the measurements as the tracker takes them."""
    born = update_tracks(Tracks.empty(), paths.segments, 0.0, settings)
    return born.covariance[:, _ROWS, _COLUMNS]


def _of_innovations(innovation: Floats, S: Floats) -> Likelihood:
    nis = float((innovation * np.linalg.solve(S, innovation[..., None])[..., 0]).sum())
    log_det = float(np.linalg.slogdet(S).logabsdet.sum())
    return Likelihood(-(3 * len(S) * math.log(2 * math.pi) + log_det + nis) / 2, nis, len(S))
