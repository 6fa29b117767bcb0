"""One step of all tracks: `update_tracks`."""

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from rangecam.errors import DataError
from rangecam.motion import MOTION, TURNS, MotionSettings, mode_switching
from rangecam.tracking.association import ASSOCIATION, priorities
from rangecam.tracking.filter import PAIRED, PAIRING, RULES, WHOLE, Seen, advance, advance_modes, complete, unseen
from rangecam.tracking.grouping import concerned
from rangecam.tracking.groups import Grouped, regroup
from rangecam.tracking.joint import marginals
from rangecam.tracking.life import delete, initiate
from rangecam.tracking.living import live
from rangecam.tracking.own_motion import braked, carried
from rangecam.tracking.settings import TrackingSettings
from rangecam.tracking.shape import memory_of, pair_shapes, shapes
from rangecam.types import MEMORY, Ego, Floats, Ints, Refused, Segments, Tracks

_FLOAT, _INT, _BYTE = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.uint8)
_STANDING: Floats = np.zeros(2)
_USED = (
    *(("label", _INT), ("position_m", _FLOAT), ("covariance_m2", _FLOAT), ("size_m", _FLOAT), ("near_m", _FLOAT)),
    *(("n_pixels", _INT), ("box", _INT), ("range_m", _FLOAT), ("amplitude", _FLOAT), ("sigma_range_m", _FLOAT)),
    ("cut", _BYTE),
)
"""What `Seen` takes of the segments, and in which type."""
_GROUP, _PARTS = MEMORY.index("merged"), MEMORY.index("parts")

_UNKNOWN = Ego()

State = tuple[int, float, float, Ego]
"""What of a frame goes straight into its tracks: refused, time_s, seconds since the last, ego."""
Written = tuple[Floats, Floats, Floats, Floats, Floats, Floats]
"""mode_probability, mode_state, mode_covariance, x, P, NIS."""
Step = Callable[[Seen, Ints, Floats | None, int], bool]
"""A kernel of the filter with all but the segments, the pairing, the weights and the stage."""


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
    if ego.braking and settings.own_braking_mps2 > 0:
        tracks = braked(tracks, settings.own_braking_mps2**2 * dt_s / 0.1)
    state = int(refused), time_s, dt_s, ego
    follow = _follow_modes if settings.motion.modes else _follow
    tracks, seen, took, ended, left = follow(tracks, seen, own, state, settings)
    if ended:
        tracks = delete(tracks)
    return initiate(tracks, seen, took, _constants(settings), settings) if left else tracks


def _follow(
    tracks: Tracks, seen: Seen, own: Floats, state: State, settings: TrackingSettings
) -> tuple[Tracks, Seen, Ints, int, int]:
    """Return the tracks after the frame, the segments, which each took, how many end, how many segments are left over.

    Ended tracks are still there, with the status `GONE`.
    """
    n, memory, rules = tracks.age.size, memory_of(tracks, settings.shape_sigma), _constants(settings)
    model = MOTION[settings.motion.model](state[2], settings.motion)
    x, P, nis, cost = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty(n), np.empty((n, seen[0].size))
    took, turn = np.empty(n, int), own if settings.motion.model == TURNS else None

    def step(seen: Seen, took: Ints, weights: Floats | None, stage: int) -> bool:
        # fmt: off
        return advance(
            tracks.state, tracks.covariance, memory, seen[1], seen[2], seen[3], seen[5], seen[10],
            model, rules, turn, x, P, nis, cost, took, weights, stage,
        )
        # fmt: on

    modes = tracks.mode_probability, tracks.mode_state, tracks.mode_covariance
    if modes[0].shape[1]:
        modes = np.empty((n, 0)), np.empty((n, 0, 9)), np.empty((n, 0, 9, 9))
    return _associated(step, tracks, (*modes, x, P, nis), (memory, cost, took), seen, rules, state, settings)


def _follow_modes(
    tracks: Tracks, seen: Seen, own: Floats, state: State, settings: TrackingSettings
) -> tuple[Tracks, Seen, Ints, int, int]:
    """Do what `_follow` does with several motion models at once."""
    motion, n, dt_s = settings.motion, tracks.age.size, state[2]
    count, memory, rules = len(motion.modes), memory_of(tracks, settings.shape_sigma), _constants(settings)
    models = np.empty((count, 2, 3, 3))
    for k, mode in enumerate(motion.modes):
        models[k] = MOTION[mode.model](dt_s, mode)
    turns, any_turns = _turns(motion)
    known = models, mode_switching(dt_s, count, motion.mode_memory_s), turns
    old = *_modes_of(tracks, count), memory
    x, P, nis, cost = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty(n), np.empty((n, seen[0].size))
    written = np.empty((n, count)), np.empty((n, count, 9)), np.empty((n, count, 9, 9)), x, P, nis
    took, turn = np.empty(n, int), own if any_turns else None

    def step(seen: Seen, took: Ints, weights: Floats | None, stage: int) -> bool:
        used = seen[1], seen[2], seen[3], seen[5], seen[10]
        return advance_modes(old, used, known, rules, turn, written, cost, took, weights, stage)

    return _associated(step, tracks, written, (memory, cost, took), seen, rules, state, settings)


def _associated(
    step: Step,
    tracks: Tracks,
    written: Written,
    arrays: tuple[Floats, Floats, Ints],
    seen: Seen,
    rules: Floats,
    state: State,
    settings: TrackingSettings,
) -> tuple[Tracks, Seen, Ints, int, int]:
    """Take the step; where tracks or segments compete, or segments are left over, see who belongs to whom.

    written: what the step writes; arrays: memory of the tracks, cost and took, which it writes too.
    """
    memory, took, n = arrays[0], arrays[2], tracks.age.size
    counts, means, shape, new_memory = np.empty((5, n), int), np.empty((2, n)), np.empty((n, 3)), np.empty_like(memory)

    def lived(seen: Seen, took: Ints) -> tuple[int, int, int, int]:
        # fmt: off
        return live(
            tracks.status, tracks.age, tracks.hits, tracks.misses, tracks.size_m, tracks.near_offset_m,
            tracks.n_pixels, tracks.class_probability, memory, *seen, rules, state[2], took, written[4], written[5],
            counts, means, shape, new_memory,
        )
        # fmt: on

    done, grouped, shared = step(seen, took, None, WHOLE), None, False
    if done:
        ended, left, lost, ignored = lived(seen, took)
        if settings.recognise_merges and (left or lost):
            # fmt: off
            shared = concerned(
                tracks.status, tracks.size_m, memory, written[3], written[4], seen[1], seen[3], took, rules[17]
            )
            # fmt: on
    if not done or shared:
        took, weights, grouped = _resolved(step, tracks, written, arrays, (seen, done), rules, settings)
        seen = seen if grouped is None else grouped.seen
        step(seen, took, weights, PAIRED)
        ended, left, lost, ignored = lived(seen, took)
        if grouped is not None:
            new_memory[:, _GROUP], new_memory[:, _PARTS] = grouped.group, grouped.parts
            ignored -= int(grouped.used.sum())
    return _followed(tracks, written, (counts, means, shape, new_memory), state, ignored), seen, took, ended, left


def _resolved(
    step: Step,
    tracks: Tracks,
    written: Written,
    arrays: tuple[Floats, Floats, Ints],
    frame: tuple[Seen, bool],
    rules: Floats,
    settings: TrackingSettings,
) -> tuple[Ints, Floats | None, Grouped | None]:
    """Return which segment each track takes, the weights if they take several, and what merges and splits make of it.

    frame: the segments, and whether nothing competes; `written` is the prediction afterwards.
    """
    (memory, cost, took), (seen, alone), (x, P) = arrays, frame, written[3:5]
    shape, weights = shapes(seen), None
    if alone:
        step(seen, took, None, PAIRING)
    else:
        if settings.use_shape:
            cost = pair_shapes(cost, memory, shape, seen[10])
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
    unseen(x, P, memory, (seen[1], seen[3], seen[10]), rules, R, None)
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


def _followed(
    tracks: Tracks, written: Written, lived: tuple[Ints, Floats, Floats, Floats], state: State, ignored: int
) -> Tracks:
    """Return the tracks with what the kernels have written."""
    mode_probability, mode_state, mode_covariance, x, P, nis = written
    counts, means, shape, memory = lived
    status, age, hits, misses, segment = counts
    near_offset_m, n_pixels = means
    refused, time_s, _, ego = state
    return Tracks(
        track_id=tracks.track_id,
        status=status,
        state=x,
        covariance=P,
        age=age,
        hits=hits,
        misses=misses,
        size_m=shape,
        near_offset_m=near_offset_m,
        n_pixels=n_pixels,
        segment=segment,
        class_probability=tracks.class_probability,
        class_memory=tracks.class_memory,
        nis=nis,
        mode_probability=mode_probability,
        mode_state=mode_state,
        mode_covariance=mode_covariance,
        time_s=time_s,
        next_id=tracks.next_id,
        memory=memory,
        ego=ego,
        refused=refused,
        ignored=ignored,
    )


def _seen_in(segments: Segments) -> Seen:
    """Return what the tracker uses of the segments, in the types that its kernels are compiled for."""
    values = vars(segments)
    return tuple(  # type: ignore[return-value]  # as long as _USED, which mypy cannot count
        [a if (a := values[name]).dtype is kind else np.asarray(a, kind) for name, kind in _USED]
    )


@lru_cache(maxsize=16)
def _turns(motion: MotionSettings) -> tuple[Floats, bool]:
    """Return for each mode whether it turns, and whether any does."""
    turns = [mode.model == TURNS for mode in motion.modes]
    return np.array(turns, float), any(turns)


@lru_cache(maxsize=16)
def _constants(settings: TrackingSettings) -> Floats:
    """Return what `advance` is told by the settings, once for all frames."""
    motion, misses = (
        settings.motion,
        (settings.max_misses_vru, settings.max_misses_vehicle, settings.max_misses_obstacle),
    )
    gate = gate_threshold(settings.gate_probability)
    euclidean = settings.euclidean_gate_m**2 / gate if settings.distance == "euclidean" else 0.0
    rules = {
        "gate": gate,
        "common": settings.position_sigma_m**2,
        "extent": settings.extent_sigma**2,
        "time_variance": settings.frame_time_sigma_s**2,
        "weight": settings.shape_weight,
        "vertical": motion.vertical_share**2,
        "confirm_hits": settings.confirm_hits,
        "confirm_frames": settings.confirm_frames,
        "max_misses": settings.max_misses,
        "max_misses_vru": settings.max_misses if misses[0] is None else misses[0],
        "max_misses_vehicle": settings.max_misses if misses[1] is None else misses[1],
        "max_misses_obstacle": settings.max_misses if misses[2] is None else misses[2],
        "max_variance": settings.max_position_sigma_m**2,
        "euclidean": euclidean,
        "adapt_s": motion.adapt_s,
        "adapt_limit": motion.adapt_limit,
        "cut": settings.cut_sigma**2,
        "max_parts": settings.max_parts_frames,
        "outline": settings.outline_sigma**2,
        "lasts_s": settings.position_lasts_s,
    }
    return np.array([float(rules[name]) for name in RULES])


def gate_threshold(probability: float) -> float:
    """Return the squared Mahalanobis distance within which a three-dimensional measurement lies with `probability`.

    The quantile of chi-square with three degrees of freedom (König 2008, appendix B); at most 1000 squared.
    """
    return min(float(chdtri(3, 1 - probability)), 1e6)
