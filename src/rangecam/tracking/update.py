"""One step of all tracks: `update_tracks`."""

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import chdtri

from rangecam.errors import DataError
from rangecam.motion import MOTION, TURNS, MotionSettings, mode_switching
from rangecam.tracking.association import ASSOCIATION, NO_PAIR, priorities
from rangecam.tracking.filter import (
    CONTESTED,
    PAIRED,
    PAIRING,
    RULES,
    WHOLE,
    Seen,
    advance,
    advance_modes,
    complete,
    unseen,
)
from rangecam.tracking.groups import lasting_parts, regroup, scene_of
from rangecam.tracking.joint import marginals
from rangecam.tracking.life import delete, initiate
from rangecam.tracking.own_motion import carried
from rangecam.tracking.settings import TrackingSettings
from rangecam.tracking.shape import memory_of, pair_shapes, shapes
from rangecam.types import MEMORY, Ego, Floats, Ints, Refused, Segments, Tracks, TrackStatus

_FLOAT, _INT = np.dtype(np.float64), np.dtype(np.int64)
_NO_WEIGHTS: Floats = np.zeros((0, 0))
_STANDING: Floats = np.zeros(2)
_GROUP, _PARTS = MEMORY.index("merged"), MEMORY.index("parts")

_UNKNOWN = Ego()

State = tuple[int, float, Ego]
"""What of a frame goes straight into its tracks: refused, time_s, ego."""
Step = Callable[[Seen, Ints, Floats, int], tuple[int, int, int]]
"""A kernel with all but the segments, the pairing, the weights and the stage."""


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
    state = int(refused), time_s, ego
    follow = _follow_modes if settings.motion.modes else _follow
    tracks, seen, took, ended, left = follow(tracks, seen, dt_s, own, state, settings)
    if ended:
        tracks = delete(tracks)
    return initiate(tracks, seen, took, _constants(settings), settings) if left else tracks


def _follow(
    tracks: Tracks, seen: Seen, dt_s: float, own: Floats, state: State, settings: TrackingSettings
) -> tuple[Tracks, Seen, Ints, int, int]:
    """Return the tracks after the frame, the segments, which each took, how many end, how many segments are left over.

    Ended tracks are still there, with the status `GONE`.
    """
    model, memory = MOTION[settings.motion.model](dt_s, settings.motion), memory_of(tracks, settings.shape_sigma)
    n, m = tracks.age.size, seen[0].size
    x, P, shape, cost = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty((n, 3)), np.empty((n, m))
    counts, means, took, new_memory = np.empty((5, n), int), np.empty((3, n)), np.empty(n, int), np.empty_like(memory)
    rules = _constants(settings)

    def step(seen: Seen, took: Ints, weights: Floats, stage: int) -> tuple[int, int, int]:
        # fmt: off
        return advance(
            tracks.state, tracks.covariance, tracks.status, tracks.age, tracks.hits, tracks.misses,
            tracks.size_m, tracks.near_offset_m, tracks.n_pixels, tracks.class_probability, memory,
            *seen, model, rules, own, x, P, counts, means, shape, new_memory, cost, took, weights, stage,
        )
        # fmt: on

    seen, took, ended, left, ignored = _associated(step, tracks, memory, (x, P, cost, took, new_memory), seen, settings)
    no_modes = np.empty((n, 0)), np.empty((n, 0, 9)), np.empty((n, 0, 9, 9))
    written = *no_modes, x, P, counts, means, shape, new_memory
    return _followed(tracks, written, state, ignored), seen, took, ended, left


def _follow_modes(
    tracks: Tracks, seen: Seen, dt_s: float, own: Floats, state: State, settings: TrackingSettings
) -> tuple[Tracks, Seen, Ints, int, int]:
    """Do what `_follow` does with several motion models at once."""
    motion, n, m = settings.motion, tracks.age.size, seen[0].size
    count, memory = len(motion.modes), memory_of(tracks, settings.shape_sigma)
    models = np.stack([MOTION[mode.model](dt_s, mode) for mode in motion.modes])
    modes = _modes_of(tracks, count)
    life = tracks.status, tracks.age, tracks.hits, tracks.misses, tracks.size_m, tracks.near_offset_m, tracks.n_pixels
    mu, states, spreads = (np.empty_like(each) for each in modes)
    x, P, shape, cost = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty((n, 3)), np.empty((n, m))
    counts, means, took, new_memory = np.empty((5, n), int), np.empty((3, n)), np.empty(n, int), np.empty_like(memory)
    written = mu, states, spreads, x, P, counts, means, shape, new_memory
    known = models, mode_switching(dt_s, count, motion.mode_memory_s), _turns(motion)
    old, rules = (*modes, *life, tracks.class_probability, memory), _constants(settings)

    def step(seen: Seen, took: Ints, weights: Floats, stage: int) -> tuple[int, int, int]:
        return advance_modes(old, seen, known, rules, own, written, cost, took, weights, stage)

    seen, took, ended, left, ignored = _associated(step, tracks, memory, (x, P, cost, took, new_memory), seen, settings)
    return _followed(tracks, written, state, ignored), seen, took, ended, left


def _associated(
    step: Step,
    tracks: Tracks,
    memory: Floats,
    arrays: tuple[Floats, Floats, Floats, Ints, Floats],
    seen: Seen,
    settings: TrackingSettings,
) -> tuple[Seen, Ints, int, int, int]:
    """Take the step; where tracks or segments compete, or segments are left over, see who belongs to whom.

    arrays: x, P, cost, took, new memory, which the step writes. Return the segments, which each track took, how many
    tracks end, how many segments are left over, and how many are not finite.
    """
    x, P, cost, took, new_memory = arrays
    ended, left, ignored = step(seen, took, _NO_WEIGHTS, WHOLE)
    contested, hidden, left = ended == CONTESTED, left < 0, max(left, -1 - left)
    shared = settings.recognise_merges and (
        hidden or (left > 0 and bool((tracks.status != TrackStatus.TENTATIVE).any()))
    )
    if not (contested or shared):
        return seen, took, ended, left, ignored
    shape, weights, grouped = shapes(seen), _NO_WEIGHTS, None
    if contested:
        if settings.use_shape:
            rows, columns = np.nonzero(cost < NO_PAIR)
            cost = pair_shapes(cost, memory, shape, (rows, columns))
        priority = priorities(tracks.age, tracks.n_pixels, memory)
        took = ASSOCIATION[settings.association](cost, priority)
        if settings.association == "joint_probabilistic":
            gate, density = settings.gate_probability, settings.clutter_density_per_m3
            weights = marginals(cost, settings.detection_probability, gate, density)
    else:
        step(seen, took, _NO_WEIGHTS, PAIRING)
    if settings.recognise_merges:
        rules, R = _constants(settings), np.empty_like(seen[2])
        complete(seen[2], seen[3], seen[10], rules, R)
        unseen(x, P, memory, seen[1], seen[3], seen[10], rules, R)
        scene = scene_of(tracks, memory, (x, P), (seen, shape), R, rules[0], settings)
        grouped = regroup(scene, took, settings.max_parts_frames)
    if grouped is None:
        ended, left, ignored = step(seen, took, weights, PAIRED)
        new_memory[:, _PARTS] = lasting_parts(memory, settings.max_parts_frames)
        return seen, took, ended, max(left, -1 - left), ignored
    if weights.size:
        weights = np.where(grouped.used, 0.0, weights)
        weights[grouped.took >= len(grouped.used)] = 0.0
        weights = np.pad(weights, ((0, 0), (0, len(grouped.seen[0]) - weights.shape[1])))
    ended, left, ignored = step(grouped.seen, grouped.took, weights, PAIRED)
    new_memory[:, _GROUP], new_memory[:, _PARTS] = grouped.group, grouped.parts
    return grouped.seen, grouped.took, ended, max(left, -1 - left), ignored - int(grouped.used.sum())


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


def _followed(tracks: Tracks, written: tuple[Any, ...], state: State, ignored: int) -> Tracks:
    """Return the tracks with what the kernels have written."""
    mode_probability, mode_state, mode_covariance, x, P, counts, means, shape, memory = written
    refused, time_s, ego = state
    return Tracks(
        track_id=tracks.track_id,
        status=counts[0],
        state=x,
        covariance=P,
        age=counts[1],
        hits=counts[2],
        misses=counts[3],
        size_m=shape,
        near_offset_m=means[0],
        n_pixels=means[1],
        segment=counts[4],
        class_probability=tracks.class_probability,
        class_memory=tracks.class_memory,
        nis=means[2],
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
    return (
        np.asarray(segments.label, _INT),
        np.asarray(segments.position_m, _FLOAT),
        np.asarray(segments.covariance_m2, _FLOAT),
        np.asarray(segments.size_m, _FLOAT),
        np.asarray(segments.near_m, _FLOAT),
        np.asarray(segments.n_pixels, _INT),
        np.asarray(segments.box, _INT),
        np.asarray(segments.range_m, _FLOAT),
        np.asarray(segments.amplitude, _FLOAT),
        np.asarray(segments.sigma_range_m, _FLOAT),
        np.asarray(segments.cut, _INT),
    )


@lru_cache(maxsize=16)
def _turns(motion: MotionSettings) -> Floats:
    """Return for each mode whether it turns."""
    return np.array([float(mode.model == TURNS) for mode in motion.modes])


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
        "turns": motion.model == TURNS,
        "cut": settings.cut_sigma**2,
    }
    return np.array([float(rules[name]) for name in RULES])


def gate_threshold(probability: float) -> float:
    """Return the squared Mahalanobis distance within which a three-dimensional measurement lies with `probability`.

    The quantile of chi-square with three degrees of freedom (König 2008, appendix B); at most 1000 squared.
    """
    return min(float(chdtri(3, 1 - probability)), 1e6)
