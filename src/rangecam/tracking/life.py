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
from rangecam.tracking.sighting import ACROSS, complete, ends, wander
from rangecam.types import CLASSES, MEMORY, Floats, Ints, Tracks, TrackStatus

_WIDTH, _PLACED, _SIDE = (MEMORY.index(name) for name in ("log_width", "placed_width", "placed_side"))


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
    end = ends(covariance, (size, n_pixels, seen[10], seen[11]), rules, R)
    first = first[: left_over(took, position, covariance, size, first)]
    memory = first_memory(shapes(seen)[first], settings.shape_sigma)
    end, cut = end[first], seen[10][first]
    position, R = _whole((position[first], R[first], size[first, 1], cut), end, memory, settings)
    n, count = len(first), len(settings.motion.modes)
    state, P, unknown = np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, len(CLASSES)))
    state[:, ::3] = position  # as `POSITION`, but a slice is quicker than a list
    P[:, range(9), range(9)] = (0.0, settings.speed_sigma_mps**2, settings.acceleration_sigma_mps2**2) * 3
    P[:, 5] *= settings.motion.lateral_share**2
    P[:, 6:] *= settings.motion.vertical_share**2
    P[:, ::3, ::3] = R
    restless = wander(memory, settings.outline_sigma**2)
    restless[:, 1] *= np.abs(end[:, 1]) != 1  # as in `sighting.aside`
    P[:, range(0, 9, 3), range(0, 9, 3)] += restless
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


def _whole(
    seen: tuple[Floats, Floats, Floats, Ints], end: Floats, memory: Floats, settings: TrackingSettings
) -> tuple[Floats, Floats]:
    """Return position (M, 3) and covariance of what is open at a side and may be wider, as `sighting.ends` places them.

    seen: position, covariance, width and bits of `Cut`. Written, in `memory`: the widths and the side that is open.
    """
    position, R, width, cut = seen
    side = np.where(np.abs(end[:, 1]) == 1, end[:, 1], 0.0)
    missing = np.where(cut & ACROSS != 0, np.maximum(settings.cut_width_m - np.maximum(width, 0.0), 0.0), 0.0)
    memory[:, _SIDE] = side
    if not side.any() and not missing.any():
        return position, R
    placed = np.maximum(end[:, 2], np.where(cut & ACROSS != 0, settings.cut_width_m, 0.0))
    memory[missing > 0, _WIDTH] = np.log((width + missing)[missing > 0])
    memory[:, _PLACED] = np.where(end[:, 1] != 0, placed, memory[:, _PLACED])
    position, R = position.copy(), R.copy()
    position[:, 1] = np.where(side != 0, end[:, 0] + side * placed / 2, position[:, 1])
    R[:, 1, 1] += np.where(side == 0, settings.cut_sigma**2 * missing**2, 0.0)
    return position, R


def _map(function: Callable[..., Any], tracks: Tracks, *others: Tracks) -> Tracks:
    """Return `tracks` with `function` applied to each of its arrays, and to those of the `others` beside it."""
    rows = [vars(each) for each in (tracks, *others)]
    changed = {key: function(*(row[key] for row in rows)) for key, of in rows[0].items() if isinstance(of, np.ndarray)}
    return Tracks(**{**rows[0], **changed})
