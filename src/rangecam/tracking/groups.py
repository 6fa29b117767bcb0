"""Merges and splits (K-FUT-06): one segment of several tracks, and one track's segment in several parts."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rangecam.tracking.grouping import Shown, State, hold, search
from rangecam.tracking.rules import Seen
from rangecam.tracking.settings import TrackingSettings
from rangecam.types import MEMORY, Floats, Ints, Tracks

_PARTS = MEMORY.index("parts")


class Grouped(NamedTuple):
    """The pairing after merges and splits.

    seen: the segments; those that were used up are not finite, and what was made of them is added at the end.
    took (N,): index in `seen`; used (M,): which were used up; group, parts (N,): columns of the tracks' memory.
    """

    seen: Seen
    took: Ints
    used: NDArray[np.bool_]
    group: Floats
    parts: Floats


def regroup(
    tracks: Tracks, memory: Floats, predicted: tuple[Floats, Floats], segments: tuple[Seen, Floats, Floats],
    took: Ints, gate: float, settings: TrackingSettings,
) -> Grouped | None:  # fmt: skip
    """Return the pairing in which merged tracks share a segment and parts are one, None where there is neither.

    predicted: x (N, 9) and P (N, 9, 9) before the update; segments: what is seen, R (M, 3, 3) with all errors included,
    shapes (M, 7). Confirmed tracks only: a tentative one yields its segment. Merged tracks coast, each held by what the
    common segment says of it where the others are; when the segments part, the usual association has each take its own.
    """
    seen, R, shape = segments
    state: State = tracks.status, tracks.track_id, tracks.n_pixels, tracks.size_m, memory, *predicted
    shown: Shown = seen[1], seen[3], seen[5], R, shape
    limits = gate, -2 * math.log(1 - settings.detection_probability), float(settings.max_parts_frames)
    mate_of, part_of = np.empty(len(took), int), np.empty(len(R), int)
    if not search(state, shown, limits, took, mate_of, part_of):
        return None
    used, took = part_of >= 0, took.copy()
    used[mate_of[mate_of >= 0]] = True
    took[(took >= 0) & used[took]] = -1
    mates, source = np.argsort(mate_of, kind="stable")[(mate_of < 0).sum() :], part_of[part_of >= 0]
    who = np.flatnonzero(np.bincount(source, minlength=len(took)))
    pieces = [np.flatnonzero(part_of == i) for i in who]
    first = len(used) + len(mates)
    took[mates], took[who] = np.arange(len(used), first), np.arange(first, first + len(who))
    largest = [some[np.argmax(seen[5][some])] for some in pieces]
    rows = np.concatenate([np.arange(len(used)), mate_of[mates], np.array(largest, int)])
    whole = tuple(each[rows] for each in seen)
    whole[1][: len(used)][used] = math.nan
    group, parts = np.zeros(len(took)), memory[:, _PARTS]
    parts = np.where(parts >= settings.max_parts_frames, parts, 0.0)
    parts[who] = memory[who, _PARTS] + 1
    _hold(state, shown, mates, mate_of[mates], whole, group)
    for row, some in enumerate(pieces, first):
        _join(seen, some, whole, row)
    return Grouped(whole, took, used, group, parts)


def _hold(state: State, shown: Shown, mates: Ints, segment: Ints, whole: Seen, group: Floats) -> None:
    """Write the rows of merged tracks (K,), in the order of the segments (K,) that they share, and their group."""
    size, n = whole[3], len(shown[0])
    size[n : n + len(mates)], whole[5][n : n + len(mates)], whole[10][n : n + len(mates)] = 0.0, 0, 0
    for j in np.unique(segment):
        low, high = np.searchsorted(segment, (j, j + 1))
        some = mates[low:high]
        hold(state, shown, j, some, whole[1][n + low : n + high], whole[2][n + low : n + high])
        group[some] = state[1][some].min()


def _join(seen: Seen, pieces: Ints, whole: Seen, row: int) -> None:
    """Write one segment of several into the row of the largest, whose label it keeps."""
    some: tuple[Any, ...] = tuple(each[pieces] for each in seen)
    _, position, covariance, size, near, pixels, box, range_m, amplitude, sigma, cut, ends = some
    count = np.maximum(pixels, 1)
    weight = count / count.sum()
    low, high = (position - size / 2).min(axis=0), (position + size / 2).max(axis=0)
    whole[1][row], whole[3][row], whole[4][row], whole[5][row] = weight @ position, high - low, near.min(), count.sum()
    whole[2][row] = (weight**2 @ covariance.reshape(-1, 9)).reshape(3, 3)
    whole[6][row, :2], whole[6][row, 2:] = box[:, :2].min(axis=0), box[:, 2:].max(axis=0)
    whole[7][row], whole[8][row] = weight @ range_m, weight @ amplitude
    whole[9][row], whole[10][row] = math.sqrt(float(weight**2 @ sigma**2)), np.bitwise_or.reduce(cut)
    whole[11][row] = ends[:, 0].max(), ends[:, 1].min()
