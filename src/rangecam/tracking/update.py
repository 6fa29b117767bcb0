"""One step of all tracks: `update_tracks`."""

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from rangecam.errors import DataError
from rangecam.motion import MOTION, TURNS, MotionSettings, mode_switching
from rangecam.tracking.association import ASSOCIATION, likelier_than_new, priorities
from rangecam.tracking.grouping import concerned
from rangecam.tracking.groups import Grouped, regroup
from rangecam.tracking.joint import marginals
from rangecam.tracking.life import delete, initiate
from rangecam.tracking.own_motion import braked, carried, turned
from rangecam.tracking.rules import PAIRED, PAIRING, WHOLE, Seen, rules_of
from rangecam.tracking.settings import TrackingSettings
from rangecam.tracking.shape import memory_of, pair_shapes, shapes
from rangecam.tracking.sighting import complete, unseen
from rangecam.tracking.steps import Outcome, follow, follow_modes
from rangecam.types import MEMORY, Ego, Floats, Ints, Refused, Segments, Tracks

_STANDING: Floats = np.zeros(2)
_FLOAT, _INT, _BYTE = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.uint8)
_USED = {
    **{"label": _INT, "position_m": _FLOAT, "covariance_m2": _FLOAT, "size_m": _FLOAT, "near_m": _FLOAT},
    **{"n_pixels": _INT, "box": _INT, "range_m": _FLOAT, "amplitude": _FLOAT, "sigma_range_m": _FLOAT},
    **{"cut": _BYTE, "ends_m": _FLOAT},
}
"""What `Seen` takes of the segments, and in which type."""
_FIELDS, _TYPE = itemgetter(*_USED), attrgetter("dtype")
_TYPES: tuple[Any, ...] = tuple(_USED.values())
_HALVES: Floats = np.array([0.5, -0.5])
"""From the middle of a segment to its left and its right end, as shares of its width."""
_GROUP, _PARTS, _COLUMNS = MEMORY.index("merged"), MEMORY.index("parts"), len(MEMORY)

_UNKNOWN = Ego()

Written = tuple[
    Floats, Floats, Floats, Floats, Floats, Floats, Ints, Floats, Floats, Floats, Floats, Ints
]  # fmt: skip
"""mode_probability, mode_state and mode_covariance after the step, memory before it; x, P, counts, means, size, memory,
cost and took as of `steps.follow`."""
Step = Callable[[Seen, Ints, Floats | None, int], Outcome]
"""A kernel of `steps` with all but the segments, the pairing, the weights and the stage."""


def update_tracks(
    tracks: Tracks, segments: Segments, time_s: float, settings: TrackingSettings, ego: Ego = _UNKNOWN
) -> Tracks:
    """Carry the tracks on to the frame of `time_s` and take its segments in (K-TRK, K-KAL).

    Predict (König 2008, fig 6.8) over the true time since the last frame (eq 6.12), gate by the Mahalanobis distance
    with the innovation covariance (eq 6.14 and E-K-20), associate, recognise merges and splits, update, confirm,
    delete, and start a track for each segment left over. A missed track is only predicted (K-KAL-11). With the frame
    "ground", `ego` tells how the vehicle moved meanwhile. A repeated frame (of the time of the last) or a late one
    leaves the tracks as they are, but for `refused`, which says so; after a step back of the clock (`max_late_s`) all
    tracks are dropped, but their numbers are not used again. Segments whose position or covariance is not finite are
    ignored, and counted.

    Raises DataError if `time_s` is not finite.
    """
    if not math.isfinite(time_s):
        raise DataError(f"the frame's time is {time_s}; expected seconds on the camera's clock")
    dt_s, refused = time_s - tracks.time_s if math.isfinite(tracks.time_s) else 0.0, Refused.NOTHING
    if dt_s < -settings.max_late_s:
        tracks, dt_s = dataclasses.replace(Tracks.empty(), next_id=tracks.next_id), 0.0
        refused = Refused.CLOCK_SET_BACK
    elif dt_s < 0 or time_s == tracks.time_s:
        return dataclasses.replace(tracks, refused=int(Refused.LATE if dt_s < 0 else Refused.REPEATED))
    seen, own = _seen_in(segments), _STANDING
    if settings.frame == "ground":
        tracks, own = carried(tracks, ego, dt_s, settings.rear_axle_m)
    else:
        tracks = turned(tracks, ego)
    if ego.braking and settings.own_braking_mps2 > 0:
        tracks = braked(tracks, settings.own_braking_mps2**2 * dt_s / 0.1)
    rules = rules_of(settings)
    make = _modes if settings.motion.modes else _one_model
    step, written = make(tracks, seen[0].size, own, dt_s, settings)
    took = written[11]
    done, ended, left, lost, ignored = step(seen, took, None, WHOLE)
    if not done or (settings.recognise_merges and (left or lost) and _may_group(tracks, written, seen, rules)):
        (_, ended, left, _, ignored), seen, took = _competing(step, tracks, written, (seen, done), settings)
    tracks = _followed(tracks, written, time_s, ego, int(refused), ignored)
    if ended:
        tracks = delete(tracks)
    return initiate(tracks, seen, took, rules, settings) if left else tracks


def _may_group(tracks: Tracks, written: Written, seen: Seen, rules: Floats) -> bool:
    """Return whether any tracks or segments may be merged or in parts."""
    _, _, _, memory, x, P, *_, took = written
    return bool(concerned(tracks.status, tracks.size_m, memory, x, P, seen[1], seen[3], took, rules[17]))


def _one_model(tracks: Tracks, m: int, own: Floats, dt_s: float, settings: TrackingSettings) -> tuple[Step, Written]:
    """Return the step of these tracks to m segments, and what it writes."""
    n, memory, motion = tracks.age.size, memory_of(tracks, settings.shape_sigma), settings.motion
    model, turn = MOTION[motion.model](dt_s, motion), own if motion.model == TURNS else None
    x, P, counts, means, size, new_memory, cost, _ = room = _room(n, m)
    # fmt: off
    before: tuple[Any, ...] = (
        tracks.state, tracks.covariance, tracks.status, tracks.age, tracks.hits, tracks.misses, tracks.size_m,
        tracks.near_offset_m, tracks.n_pixels, tracks.class_probability, memory,
    )
    # fmt: on
    after: tuple[Any, ...] = model, rules_of(settings), turn, dt_s, x, P, counts, means, size, new_memory, cost

    def step(seen: Seen, took: Ints, weights: Floats | None, stage: int) -> Outcome:
        arguments: tuple[Any, ...] = (*before, *seen, *after, took, weights, stage)
        return follow(*arguments)

    modes = tracks.mode_probability, tracks.mode_state, tracks.mode_covariance
    if modes[0].shape[1]:
        modes = np.empty((n, 0)), np.empty((n, 0, 9)), np.empty((n, 0, 9, 9))
    return step, (*modes, memory, *room)


def _modes(tracks: Tracks, m: int, own: Floats, dt_s: float, settings: TrackingSettings) -> tuple[Step, Written]:
    """Do what `_one_model` does with several motion models at once."""
    n, memory, motion = tracks.age.size, memory_of(tracks, settings.shape_sigma), settings.motion
    count, (turns, any_turns) = len(motion.modes), _turns(motion)
    models, turn = np.empty((count, 2, 3, 3)), own if any_turns else None
    for k, mode in enumerate(motion.modes):
        models[k] = MOTION[mode.model](dt_s, mode)
    x, P, counts, means, size, new_memory, cost, _ = room = _room(n, m)
    modes = np.empty((n, count)), np.empty((n, count, 9)), np.empty((n, count, 9, 9))
    # fmt: off
    before: tuple[Any, ...] = (
        *_modes_of(tracks, count), tracks.state, tracks.status, tracks.age, tracks.hits, tracks.misses, tracks.size_m,
        tracks.near_offset_m, tracks.n_pixels, tracks.class_probability, memory,
    )
    after: tuple[Any, ...] = (
        models, mode_switching(dt_s, count, motion.mode_memory_s), turns, rules_of(settings), turn, dt_s,
        *modes, x, P, counts, means, size, new_memory, cost,
    )
    # fmt: on

    def step(seen: Seen, took: Ints, weights: Floats | None, stage: int) -> Outcome:
        arguments: tuple[Any, ...] = (*before, *seen, *after, took, weights, stage)
        return follow_modes(*arguments)

    return step, (*modes, memory, *room)


def _room(n: int, m: int) -> tuple[Floats, Floats, Ints, Floats, Floats, Floats, Floats, Ints]:
    """Return what a step writes of n tracks and m segments: the last of `Written`."""
    # fmt: off
    return (
        np.empty((n, 9)), np.empty((n, 9, 9)), np.empty((5, n), _INT), np.empty((3, n)), np.empty((n, 3)),
        np.empty((n, _COLUMNS)), np.empty((n, m)), np.empty(n, _INT),
    )
    # fmt: on


def _competing(
    step: Step, tracks: Tracks, written: Written, frame: tuple[Seen, bool], settings: TrackingSettings
) -> tuple[Outcome, Seen, Ints]:
    """Take the step where tracks or segments compete, or may be merged or in parts.

    frame: the segments, and whether nothing competes. Return what came of the step, the segments, which each took.
    """
    took, weights, grouped = _resolved(step, tracks, written, frame, settings)
    if grouped is None:
        return step(frame[0], took, weights, PAIRED), frame[0], took
    done, ended, left, lost, ignored = step(grouped.seen, took, weights, PAIRED)
    *_, memory, _, _ = written
    memory[:, _GROUP], memory[:, _PARTS] = grouped.group, grouped.parts
    return (done, ended, left, lost, ignored - int(grouped.used.sum())), grouped.seen, took


def _resolved(
    step: Step,
    tracks: Tracks,
    written: Written,
    frame: tuple[Seen, bool],
    settings: TrackingSettings,
) -> tuple[Ints, Floats | None, Grouped | None]:
    """Return which segment each track takes, the weights if they take several, and what merges and splits make of it.

    frame: the segments, and whether nothing competes; `written` is the prediction afterwards.
    """
    memory, x, P = written[3:6]
    (seen, alone), rules, (cost, took) = frame, rules_of(settings), written[10:]
    shape, weights = shapes(seen), None
    if alone:
        step(seen, took, None, PAIRING)
    else:
        if settings.use_shape:
            cost = pair_shapes(cost, memory, shape, seen[10])
        if settings.new_density_per_m3 > 0:
            cost = likelier_than_new(cost, tracks.misses, settings.new_density_per_m3)
        wanted = settings.association == "by_age"
        priority = priorities(tracks.age, tracks.n_pixels, memory) if wanted else tracks.n_pixels
        took = ASSOCIATION[settings.association](cost, priority)
        if settings.association == "joint_probabilistic":
            gate, density = settings.gate_probability, settings.clutter_density_per_m3
            weights = marginals(cost, settings.detection_probability, gate, density)
    if not settings.recognise_merges:
        return took, weights, None
    R = np.empty_like(seen[2])
    complete(seen[2], seen[3], seen[10], rules, R)
    unseen(x, P, memory, (seen[1], seen[3], seen[10]), rules, R, False)
    grouped = regroup(tracks, memory, (x, P), (seen, R, shape), took, rules[0], settings)
    if grouped is None:
        return took, weights, None
    if weights is not None:
        weights = np.where(grouped.used, 0.0, weights)
        weights[grouped.took >= len(grouped.used)] = 0.0
        weights = np.pad(weights, ((0, 0), (0, len(grouped.seen[0]) - weights.shape[1])))
    return grouped.took, weights, grouped


def _modes_of(tracks: Tracks, count: int) -> tuple[Floats, Floats, Floats]:
    """Return probability, state and covariance of each mode; new tracks, which have none, start alike in all."""
    if tracks.mode_probability.shape == (tracks.age.size, count):
        return tracks.mode_probability, tracks.mode_state, tracks.mode_covariance
    n = tracks.age.size
    return (
        np.full((n, count), 1 / count),
        np.repeat(tracks.state[:, None], count, axis=1),
        np.repeat(tracks.covariance[:, None], count, axis=1),
    )


def _followed(tracks: Tracks, written: Written, time_s: float, ego: Ego, refused: int, ignored: int) -> Tracks:
    """Return the tracks with what the kernel has written: fields by position, which takes half the time of names."""
    mode_probability, mode_state, mode_covariance, _, x, P, counts, means, size, memory, _, _ = written
    # fmt: off
    return Tracks(
        tracks.track_id, counts[0], x, P, counts[1], counts[2], counts[3], size, means[0], means[1], counts[4],
        tracks.class_probability, means[2], mode_probability, mode_state, mode_covariance, time_s, tracks.next_id,
        tracks.class_memory, None, memory, ego, refused, ignored,
    )
    # fmt: on


def _seen_in(segments: Segments) -> Seen:
    """Return what the tracker uses of the segments, in the types that its kernels are compiled for."""
    seen: Any = _FIELDS(vars(segments))
    if seen[-1] is None:
        seen = (*seen[:-1], segments.position_m[:, 1:2] + segments.size_m[:, 1:2] * _HALVES)
    if tuple(map(_TYPE, seen)) == _TYPES:
        return seen  # type: ignore[no-any-return]  # these are the types of Seen
    return tuple(np.asarray(each, kind) for each, kind in zip(seen, _TYPES, strict=True))  # type: ignore[return-value]


@lru_cache(maxsize=16)
def _turns(motion: MotionSettings) -> tuple[Floats, bool]:
    """Return for each mode whether it turns, and whether any does."""
    turns = [mode.model == TURNS for mode in motion.modes]
    return np.array(turns, float), any(turns)
