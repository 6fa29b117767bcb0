"""One step of all tracks: `update_tracks`."""

import dataclasses
import math
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from rangecam.errors import DataError
from rangecam.motion import MOTION, mode_switching
from rangecam.tracking.association import ASSOCIATION
from rangecam.tracking.filter import CONTESTED, Seen, advance, advance_modes
from rangecam.tracking.life import delete, initiate
from rangecam.tracking.settings import TrackingSettings
from rangecam.types import Floats, Ints, Segments, Tracks

_FLOAT, _INT = np.dtype(np.float64), np.dtype(np.int64)


def update_tracks(tracks: Tracks, segments: Segments, time_s: float, settings: TrackingSettings) -> Tracks:
    """Carry the tracks on to the frame of `time_s` and take its segments in (K-TRK, K-KAL).

    Predict (König 2008, fig 6.8) over the true time since the last frame (eq 6.12), gate by the Mahalanobis distance
    with the innovation covariance (eq 6.14 and E-K-20), associate, update, confirm, delete, and start a track for
    each segment left over. A missed track is only predicted (K-KAL-11). Two frames of one time are both used. A late
    frame leaves the tracks as they are; after a step back of the clock (`max_late_s`) all tracks are dropped, but
    their numbers are not used again. Segments whose position or covariance is not finite are ignored.

    Raises DataError if `time_s` is not finite.
    """
    if not math.isfinite(time_s):
        raise DataError(f"the frame's time is {time_s}; expected seconds on the camera's clock")
    dt_s = time_s - tracks.time_s if math.isfinite(tracks.time_s) else 0.0
    if dt_s < -settings.max_late_s:
        tracks, dt_s = dataclasses.replace(Tracks.empty(), next_id=tracks.next_id), 0.0
    elif dt_s < 0:
        return tracks
    seen, follow = _seen_in(segments), _follow_modes if settings.motion.modes else _follow
    tracks, took, ended, left = follow(tracks, seen, dt_s, time_s, settings)
    if ended:
        tracks = delete(tracks)
    return initiate(tracks, seen, took, settings) if left else tracks


def _follow(
    tracks: Tracks, seen: Seen, dt_s: float, time_s: float, settings: TrackingSettings
) -> tuple[Tracks, Ints, int, int]:
    """Return the tracks at `time_s`, the segment that each took, how many have ended, how many segments are left over.

    Ended tracks are still there, with the status `GONE`.
    """
    model = MOTION[settings.motion.model](dt_s, settings.motion)
    n, m = tracks.age.size, seen[0].size
    x, P, shape, cost = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty((n, 3)), np.empty((n, m))
    counts, means, took = np.empty((5, n), int), np.empty((3, n)), np.empty(n, int)
    # fmt: off
    given = (
        tracks.state, tracks.covariance, tracks.status, tracks.age, tracks.hits, tracks.misses,
        tracks.size_m, tracks.near_offset_m, tracks.n_pixels,
        *seen, model, _constants(settings), x, P, counts, means, shape, cost, took,
    )
    # fmt: on
    ended, left = advance(*given, False)
    if ended == CONTESTED:
        took[:] = ASSOCIATION[settings.association](cost, tracks.age)
        ended, left = advance(*given, True)
    no_modes = np.empty((n, 0)), np.empty((n, 0, 9)), np.empty((n, 0, 9, 9))
    return _followed(tracks, (*no_modes, x, P, counts, means, shape), time_s), took, ended, left


def _follow_modes(
    tracks: Tracks, seen: Seen, dt_s: float, time_s: float, settings: TrackingSettings
) -> tuple[Tracks, Ints, int, int]:
    """Do what `_follow` does with several motion models at once."""
    motion, n, m = settings.motion, tracks.age.size, seen[0].size
    count = len(motion.modes)
    models = np.stack([MOTION[mode.model](dt_s, mode) for mode in motion.modes])
    modes = _modes_of(tracks, count)
    life = tracks.status, tracks.age, tracks.hits, tracks.misses, tracks.size_m, tracks.near_offset_m, tracks.n_pixels
    mu, states, spreads = (np.empty_like(each) for each in modes)
    x, P, counts, means, shape = (
        np.empty((n, 9)),
        np.empty((n, 9, 9)),
        np.empty((5, n), int),
        np.empty((3, n)),
        np.empty((n, 3)),
    )
    written = mu, states, spreads, x, P, counts, means, shape
    cost, took = np.empty((n, m)), np.empty(n, int)
    switching = mode_switching(dt_s, count, motion.mode_memory_s)
    old, rules = (*modes, *life), _constants(settings)
    step = partial(advance_modes, old, seen, (models, switching), rules, written, cost, took)
    ended, left = step(False)
    if ended == CONTESTED:
        took[:] = ASSOCIATION[settings.association](cost, tracks.age)
        ended, left = step(True)
    return _followed(tracks, written, time_s), took, ended, left


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


def _followed(tracks: Tracks, written: tuple[Any, ...], time_s: float) -> Tracks:
    """Return the tracks with what the kernels have written."""
    mode_probability, mode_state, mode_covariance, x, P, counts, means, shape = written
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
    )


@lru_cache(maxsize=16)
def _constants(settings: TrackingSettings) -> Floats:
    """Return what `advance` is told by the settings, once for all frames."""
    noise = settings.position_sigma_m**2, settings.extent_sigma**2, settings.frame_time_sigma_s**2
    life = settings.confirm_hits, settings.confirm_frames, settings.max_misses, settings.max_position_sigma_m**2
    shares = settings.shape_weight, settings.motion.vertical_share**2
    return np.array([gate_threshold(settings.gate_probability), *noise, *shares, *life])


def gate_threshold(probability: float) -> float:
    """Return the squared Mahalanobis distance within which a three-dimensional measurement lies with `probability`.

    The quantile of chi-square with three degrees of freedom (König 2008, appendix B); at most 1000 squared.
    """
    return min(float(chdtri(3, 1 - probability)), 1e6)
