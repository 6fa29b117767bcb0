"""Birth, life and end of tracks."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from rangecam.tracking.seen import Seen
from rangecam.tracking.settings import TrackingSettings
from rangecam.types import ACCELERATION, CLASSES, POSITION, VELOCITY, Floats, Ints, Tracks, TrackStatus

_TENTATIVE, _CONFIRMED, _COASTING = (int(s) for s in TrackStatus)
_GONE = -1  # in the place of a status: the track ends with this frame


def age(
    tracks: Tracks,
    estimate: tuple[Floats, Floats, Floats],
    took: Ints,
    seen: Seen,
    time_s: float,
    settings: TrackingSettings,
) -> Tracks:
    """Return the tracks one frame older, without those that end.

    estimate: their updated states, covariances and NIS; took (N,): index of the segment they took, -1 for none.
    """
    n = len(took)
    status, older, hits, misses = np.empty(n, int), np.empty(n, int), np.empty(n, int), np.empty(n, int)
    segment, size_m, near_offset_m, n_pixels = np.empty(n, int), np.empty((n, 3)), np.empty(n), np.empty(n)
    rules = (settings.confirm_hits, settings.confirm_frames, settings.max_misses, settings.max_position_sigma_m**2)
    lives = (tracks.status, tracks.age, tracks.hits, tracks.misses), (status, older, hits, misses)
    shapes = (tracks.size_m, tracks.near_offset_m, tracks.n_pixels), (segment, size_m, near_offset_m, n_pixels)
    gone = _count_and_reshape(took, estimate[1], seen, lives, shapes, (rules, settings.shape_weight))
    aged = Tracks(
        track_id=tracks.track_id,
        status=status,
        state=estimate[0],
        covariance=estimate[1],
        age=older,
        hits=hits,
        misses=misses,
        size_m=size_m,
        near_offset_m=near_offset_m,
        n_pixels=n_pixels,
        segment=segment,
        class_probability=tracks.class_probability,
        nis=estimate[2],
        time_s=time_s,
        next_id=tracks.next_id,
    )
    return _map(lambda values: values[status != _GONE], aged) if gone else aged


@njit(cache=True, nogil=True)
def _count_and_reshape(took: Ints, covariance: Floats, seen: Seen, lives: Any, shapes: Any, rules: Any) -> int:
    """Write what `_count` and `_reshape` write; return how many tracks end."""
    _reshape(took, shapes[0], seen, rules[1], shapes[1])
    return _count(took, lives[0], covariance, rules[0], lives[1])


@njit(cache=True, nogil=True)
def _count(
    took: Ints,
    old: tuple[Ints, Ints, Ints, Ints],
    covariance: Floats,
    rules: tuple[int, int, int, float],
    new: tuple[Ints, Ints, Ints, Ints],
) -> int:
    """Write the new status (`_GONE` for the end), age, hits and misses; return how many tracks end."""
    status, age, hits, misses = new
    confirm_hits, confirm_frames, max_misses, max_variance = rules
    gone = 0
    for i in range(took.size):
        hit = 1 if took[i] >= 0 else 0
        age[i], hits[i], misses[i] = old[1][i] + 1, old[2][i] + hit, 0 if hit else old[3][i] + 1
        if old[0][i] != _TENTATIVE:
            fate = _CONFIRMED if hit else _COASTING if misses[i] <= max_misses else _GONE
        elif hits[i] >= confirm_hits:
            fate = _CONFIRMED
        else:  # can it still be seen often enough within its first frames?
            fate = _TENTATIVE if confirm_hits - hits[i] <= confirm_frames - age[i] else _GONE
        for a in (0, 3, 6):
            if not covariance[i, a, a] <= max_variance:
                fate = _GONE
        status[i] = fate
        gone += fate == _GONE
    return gone


@njit(cache=True, nogil=True)
def _reshape(
    took: Ints, old: tuple[Floats, Floats, Floats], seen: Seen, weight: float, new: tuple[Ints, Floats, Floats, Floats]
) -> None:
    """Write the label of the segment each track took, and the running means of size, nearest point and pixels."""
    label, new_size, new_offset, new_pixels = new
    size, offset, pixels = old
    for i in range(took.size):
        j = took[i]
        label[i], new_offset[i], new_pixels[i] = 0, offset[i], pixels[i]
        for a in range(3):
            new_size[i, a] = size[i, a]
        if j >= 0:
            label[i] = seen.label[j]
            new_offset[i] += weight * (seen.position_m[j, 0] - seen.near_m[j] - offset[i])
            new_pixels[i] += weight * (seen.n_pixels[j] - pixels[i])
            for a in range(3):
                new_size[i, a] += weight * (seen.size_m[j, a] - size[i, a])


def initiate(tracks: Tracks, took: Ints, seen: Seen, R: Floats, settings: TrackingSettings) -> Tracks:
    """Return the tracks, and a new one for each finite segment that none took: at rest until seen to move.

    took (N',): index of the segment of each track before any ended; R (M, 3, 3): covariances of the positions.
    """
    first = np.empty(len(R), int)
    n = _unclaimed(took, seen.position_m, R, first)
    if n == 0:
        return tracks
    first = first[:n]
    state, covariance, unknown = np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, len(CLASSES)))
    state[:, POSITION] = seen.position_m[first]
    covariance[np.ix_(range(n), POSITION, POSITION)] = R[first]
    covariance[:, VELOCITY, VELOCITY] = settings.speed_sigma_mps**2
    covariance[:, ACCELERATION, ACCELERATION] = settings.acceleration_sigma_mps2**2
    unknown[:, CLASSES.index("unknown")] = 1.0
    once = np.ones(n, int)
    new = Tracks(
        track_id=tracks.next_id + np.arange(n),
        status=np.full(n, _CONFIRMED if settings.confirm_hits == 1 else _TENTATIVE),
        state=state,
        covariance=covariance,
        age=once,
        hits=once,
        misses=np.zeros(n, int),
        size_m=seen.size_m[first],
        near_offset_m=seen.position_m[first, 0] - seen.near_m[first],
        n_pixels=seen.n_pixels[first].astype(float),
        segment=seen.label[first],
        class_probability=unknown,
        nis=np.full(n, np.nan),
    )
    return dataclasses.replace(_map(lambda *both: np.concatenate(both), tracks, new), next_id=tracks.next_id + n)


@njit(cache=True, nogil=True)
def _unclaimed(took: Ints, position: Floats, R: Floats, first: Ints) -> int:
    """Write the indices of the finite segments that no track took into `first`; return how many."""
    n = 0
    for j in range(first.size):
        total = 0.0
        for a in range(3):
            total += position[j, a] + R[j, a, 0] + R[j, a, 1] + R[j, a, 2]
        free = math.isfinite(total)
        for i in range(took.size):
            free = free and took[i] != j
        if free:
            first[n] = j
            n += 1
    return n


def _map(function: Callable[..., Any], tracks: Tracks, *others: Tracks) -> Tracks:
    """Return `tracks` with `function` applied to each of its arrays, and to those of the `others` beside it."""
    fields = [name for name, value in vars(tracks).items() if isinstance(value, np.ndarray)]
    arrays = {name: function(*(getattr(t, name) for t in (tracks, *others))) for name in fields}
    return dataclasses.replace(tracks, **arrays)
