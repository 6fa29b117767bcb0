"""Birth and end of tracks: rare beside their life, which is a loop in `living.py`."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from rangecam.tracking.living import left_over
from rangecam.tracking.rules import GONE, Seen
from rangecam.tracking.settings import TrackingSettings
from rangecam.tracking.shape import first_memory, shapes
from rangecam.tracking.sighting import ACROSS, LEFT, RIGHT, complete, wander, widen
from rangecam.types import CLASSES, MEMORY, Floats, Ints, Tracks, TrackStatus

_WIDTH, _WIDTH_VARIANCE, _PLACED = (MEMORY.index(n) for n in ("log_width", "log_width_variance", "placed_width"))


def delete(tracks: Tracks) -> Tracks:
    """Return the tracks without those whose end has come."""
    stays = tracks.status != GONE
    return _map(lambda values: values[stays], tracks)


def initiate(tracks: Tracks, seen: Seen, took: Ints, rules: Floats, settings: TrackingSettings) -> Tracks:
    """Return the tracks, and a new one for each finite segment that none took: at rest until seen to move.

    took (N',): index of the segment of each track before any ended; rules: `RULES`.
    """
    label, position, covariance, size, near, n_pixels = seen[:6]
    R, first = np.empty_like(covariance), np.empty_like(label)
    complete(covariance, size, seen[10], rules, R)
    first = first[: left_over(took, position, covariance, size, first)]
    memory = first_memory(shapes(seen)[first], settings.shape_sigma)
    position, R, width, cut = position[first], R[first], size[first, 1], seen[10][first]
    missing = _missing(width, cut, memory, settings.cut_width_m)
    if missing.any():
        widen(position, R, width, cut, missing, memory[:, _WIDTH_VARIANCE], settings.cut_sigma**2)
    n, count = len(first), len(settings.motion.modes)
    state, P, unknown = np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, len(CLASSES)))
    state[:, ::3] = position  # as `POSITION`, but a slice is quicker than a list
    P[:, range(9), range(9)] = (0.0, settings.speed_sigma_mps**2, settings.acceleration_sigma_mps2**2) * 3
    P[:, 6:] *= settings.motion.vertical_share**2
    P[:, ::3, ::3] = R
    P[:, range(0, 9, 3), range(0, 9, 3)] += wander(memory, settings.outline_sigma**2)
    if settings.position_lasts_s > 0:
        P[:, range(0, 9, 3), range(0, 9, 3)] += settings.position_sigma_m**2
    unknown[:, CLASSES.index("unknown")] = 1.0
    once = np.ones(n, int)
    status = TrackStatus.CONFIRMED if settings.confirm_hits == 1 else TrackStatus.TENTATIVE
    new = Tracks(
        track_id=tracks.next_id + np.arange(n),
        status=np.full(n, int(status)),
        state=state,
        covariance=P,
        age=once,
        hits=once,
        misses=np.zeros(n, int),
        size_m=size[first],
        near_offset_m=position[:, 0] - near[first],
        n_pixels=n_pixels[first].astype(float),
        segment=label[first],
        class_probability=unknown,
        class_memory=None if tracks.class_memory is None else np.zeros((n, tracks.class_memory.shape[1])),
        nis=np.full(n, math.nan),
        mode_probability=np.full((n, count), 1 / max(count, 1)),
        mode_state=np.repeat(state[:, None], count, axis=1),
        mode_covariance=np.repeat(P[:, None], count, axis=1),
        memory=memory,
    )
    together = _map(lambda lived, born: np.concatenate((lived, born)), tracks, new)
    return replace(together, next_id=tracks.next_id + n)


def _missing(width: Floats, cut: Ints, memory: Floats, expected_m: float) -> Floats:
    """Return how much wider (M,) than seen what is cut short is expected to be; the widths in `memory` become those."""
    missing = np.where(cut & ACROSS != 0, np.maximum(expected_m - width, 0.0), 0.0)
    wider = missing > 0
    if wider.any():
        whole, one_sided = width + missing, (cut & LEFT != 0) != (cut & RIGHT != 0)
        memory[wider, _WIDTH] = np.log(whole[wider])
        memory[wider & one_sided, _PLACED] = whole[wider & one_sided]
    return missing


def _map(function: Callable[..., Any], tracks: Tracks, *others: Tracks) -> Tracks:
    """Return `tracks` with `function` applied to each of its arrays, and to those of the `others` beside it."""
    rows = [vars(each) for each in (tracks, *others)]
    changed = {key: function(*(row[key] for row in rows)) for key, of in rows[0].items() if isinstance(of, np.ndarray)}
    return Tracks(**{**rows[0], **changed})
