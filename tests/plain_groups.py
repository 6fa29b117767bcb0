"""Merges and splits (K-FUT-06) in plain NumPy, by the equations, case by case: the oracle of the compiled kernels."""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rangecam.tracking.rules import Seen
from rangecam.tracking.shape import SHAPE_SPREAD
from rangecam.types import MEMORY, Floats, Ints, TrackStatus

_GROUP, _PARTS = MEMORY.index("merged"), MEMORY.index("parts")
_STAY = 2 * math.log(9.0)
"""Those who were merged a frame ago are nine times as likely to be so still: a merge lasts ten frames or more."""
_REACH = 2.0  # standard deviations of a predicted position
_MOST = 5  # tracks in one segment of which every part is tried as the group that it shows


class Scene(NamedTuple):
    """What merges and splits are judged by: all of one frame, before its update."""

    status: Ints
    track_id: Ints
    n_pixels: Floats
    size: Floats
    """(N, 3) of the tracks."""
    memory: Floats
    x: Floats
    """(N, 3) predicted positions."""
    P: Floats
    """(N, 3, 3) their covariances."""
    seen: Seen
    R: Floats
    """(M, 3, 3) covariances of the segments, all errors included."""
    shape: Floats
    gate: float
    missed: float
    """Cost of a track that is not seen."""


class Grouped(NamedTuple):
    """The pairing after merges and splits.

    seen: the segments; those that were used up are not finite, and what was made of them is added at the end.
    took (N,): index in `seen`; used (M,): which were used up; group, parts (N,): columns of the tracks' memory.
    """

    seen: Seen
    took: Ints
    used: Ints
    group: Floats
    parts: Floats


def regroup(scene: Scene, took: Ints, max_parts_frames: int) -> Grouped | None:
    """Return the pairing in which merged tracks share a segment and parts are one, None where there is neither.

    Confirmed tracks only: a tentative one yields its segment. Merged tracks coast, each held by what the common
    segment says of it where the others are; when the segments part, the usual association has each take its own.
    """
    took = took.copy()
    usable = np.asarray(np.isfinite(scene.seen[1]).all(axis=1) & np.isfinite(scene.R).all(axis=(1, 2)))
    lives = scene.status != TrackStatus.TENTATIVE
    group, parts = np.zeros(len(took)), lasting_parts(scene.memory, max_parts_frames)
    rows: list[tuple[object, ...]] = []
    used = np.zeros(len(usable), np.bool_)
    for j, members in _merged(scene, took, usable, lives):
        took[took == j] = -1
        for i, row in zip(members, _held(scene, j, members), strict=True):
            took[i] = len(usable) + len(rows)
            rows.append(row)
        group[list(members)] = scene.track_id[list(members)].min()
        used[j] = True
    for i, pieces in _split(scene, took, usable & ~used, lives & (group == 0), max_parts_frames):
        took[np.isin(took, pieces)] = -1
        took[i] = len(usable) + len(rows)
        rows.append(_joined(scene.seen, pieces))
        parts[i] = scene.memory[i, _PARTS] + 1
        used[list(pieces)] = True
    if not rows:
        return None
    added = [np.array(column, before.dtype) for column, before in zip(zip(*rows, strict=True), scene.seen, strict=True)]
    whole = [np.concatenate(pair) for pair in zip(scene.seen, added, strict=True)]
    whole[1][: len(used)][used] = math.nan
    return Grouped(tuple(whole), took, used, group, parts)  # type: ignore[arg-type]


def lasting_parts(memory: Floats, max_parts_frames: int) -> Floats:
    """Return the counts (N,) of frames in parts that stay while tracks compete: of those that are no longer one."""
    parts = memory[:, _PARTS]
    lasting: Floats = np.where(parts >= max_parts_frames, parts, 0.0)
    return lasting


def _merged(
    scene: Scene, took: Ints, usable: NDArray[np.bool_], lives: NDArray[np.bool_]
) -> list[tuple[int, tuple[int, ...]]]:
    """Return the segments that show several tracks, with the tracks: none of them elsewhere, together of its size."""
    alone = np.flatnonzero(lives & ((took < 0) | np.isin(took, np.flatnonzero(usable))))
    taken_by_living = np.bincount(took[lives & (took >= 0)], minlength=len(usable)) > 0
    lost = alone[took[alone] < 0]
    found: list[tuple[int, tuple[int, ...]]] = []
    if not len(lost):
        return found
    near = _within(scene, lost, np.arange(len(usable)), 0.0) & usable
    for j in np.flatnonzero(near.any(axis=0)):
        owner = [i for i in alone.tolist() if took[i] == j] if taken_by_living[j] else []
        before = {i for _, members in found for i in members}
        members = [*owner, *(i for i in lost[near[:, j]].tolist() if i not in before)]
        if len(members) > 1:
            best = min(_groups(members), key=lambda some: _total(scene, int(j), some))
            if len(best) > 1 and math.isfinite(_total(scene, int(j), best)):
                found.append((int(j), best))
    return found


def _groups(members: list[int]) -> list[tuple[int, ...]]:
    """Return the tracks alone and together: every part of a few, of many each alone and all."""
    if len(members) > _MOST:
        return [*((i,) for i in members), tuple(members)]
    return [some for n in range(1, len(members) + 1) for some in itertools.combinations(members, n)]


def _within(scene: Scene, tracks: Ints, segments: Ints, share: float) -> Ints:
    """Return (n, m): whether the predicted centre lies in the segment's box; share: of the track's size beside it."""
    sigma = np.sqrt(np.maximum(scene.P[tracks][:, range(3), range(3)], 0.0))  # rounding, where there is no noise
    half = scene.seen[3][segments] / 2
    own = scene.size[tracks] * share + np.array([0.5, 0.0, 0.0])  # as `living.hidden`: depth is hardly ever seen
    apart = np.abs(scene.x[tracks][:, None] - scene.seen[1][segments][None])
    near: Ints = (apart <= half[None] + (own + _REACH * sigma)[:, None]).all(axis=2)
    return near


def _total(scene: Scene, j: int, some: tuple[int, ...]) -> float:
    """Return the cost of segment j showing these tracks together, beside that of seeing none of them.

    Expected: the centroid by their pixels; whose shares may be anything, where one hides another, which spreads it
    along the line between them; width and height from edge to edge. Each of them must make the group wider by more than
    it is uncertain: whoever is behind the others is hidden, not merged.
    """
    i = list(some)
    share = scene.n_pixels[i] / scene.n_pixels[i].sum()
    centre = share @ scene.x[i]
    apart = scene.x[i] - centre
    S = np.einsum("i,iab->ab", share**2, scene.P[i]) + scene.R[j] + np.einsum("i,ia,ib->ab", share / 3, apart, apart)
    off = scene.seen[1][j] - centre
    squared = float(off @ np.linalg.solve(S, off))
    if not squared <= scene.gate:
        return math.inf
    cost = squared + float(np.linalg.slogdet(S).logabsdet)
    hidden = (scene.status[i] == TrackStatus.COASTING) & (scene.memory[i, _GROUP] == 0)
    cost -= float(np.where(hidden, -2 * math.log(0.9), scene.missed).sum())
    for axis in (1, 2):
        half = np.exp(scene.memory[i, axis - 1]) / 2
        extent = (scene.x[i, axis] + half).max() - (scene.x[i, axis] - half).min()
        variance = scene.memory[i, SHAPE_SPREAD + axis - 1].mean() + scene.shape[j, SHAPE_SPREAD + axis - 1]
        if len(i) > 1:
            variance += scene.P[i, axis, axis].sum() / extent**2
        cost += (math.log(extent) - scene.shape[j, axis - 1]) ** 2 / variance + math.log(variance)
    if len(i) > 1 and not _each_widens(scene, i):
        return math.inf
    groups = set(scene.memory[i, _GROUP].tolist())
    return cost - (_STAY if len(i) > 1 and len(groups) == 1 and groups != {0.0} else 0.0)


def _each_widens(scene: Scene, i: list[int]) -> bool:
    half = np.exp(scene.memory[i, 0]) / 2
    low, high, sigma = scene.x[i, 1] - half, scene.x[i, 1] + half, np.sqrt(scene.P[i, 1, 1])
    every = range(len(i))
    whole = _covered(low, high)
    return all(
        whole - _covered(low[rest], high[rest]) > sigma[k] for k in every for rest in [[m for m in every if m != k]]
    )


def _covered(low: Floats, high: Floats) -> float:
    """Return how much of the line the intervals cover."""
    order = np.argsort(low)
    reached = np.maximum.accumulate(high[order])
    gaps = np.maximum(low[order][1:] - reached[:-1], 0.0).sum()
    return float(reached[-1] - low[order][0] - gaps)


def _held(scene: Scene, j: int, members: tuple[int, ...]) -> list[tuple[object, ...]]:
    """Return what a common segment says of each of its tracks.

    The one that reaches furthest to a side ends where the segment ends, if none of the others is likely to reach as
    far: its centre is half its width from there, as surely as the width is known. Else it is where it is if the others
    are where they are expected: z = sum of a_i p_i, a_i the shares of the pixels, gives p_i = (z - sum of the others'
    a p) / a_i, with the covariance of all that is subtracted, and that of the shares, over a_i^2; for two alike that is
    more than four times that of the segment, plus that of the other. Ahead it is where the segment is, but for how far
    it is expected from it.
    """
    i = list(members)
    share = scene.n_pixels[i] / scene.n_pixels[i].sum()
    apart = scene.x[i] - share @ scene.x[i]
    spread = scene.R[j] + np.einsum("i,ia,ib->ab", share / 3, apart, apart)
    half = np.exp(scene.memory[i, 0]) / 2
    half_m2 = half**2 * scene.memory[i, SHAPE_SPREAD] + scene.seen[3][j, 1] ** 2 * scene.shape[j, SHAPE_SPREAD] / 4
    low, high = scene.x[i, 1] - half, scene.x[i, 1] + half
    middle = scene.seen[1][j, 1] + (low.min() + high.max()) / 2 - share @ scene.x[i, 1]  # of the box, not of the pixels
    end = scene.seen[3][j, 1] / 2
    sides = {_furthest(-low, scene.P[i]): -1.0, _furthest(high, scene.P[i]): 1.0}
    rows = []
    for k, a in enumerate(share):
        others = np.arange(len(i)) != k
        place = (scene.seen[1][j] - share[others] @ scene.x[i][others]) / a
        variance = (spread + np.einsum("i,iab->ab", share[others] ** 2, scene.P[i][others])) / a**2
        place[0], variance[0, :], variance[:, 0] = scene.seen[1][j, 0], 0.0, 0.0
        variance[0, 0] = scene.R[j, 0, 0] + apart[k, 0] ** 2
        if k in sides:
            place[1], variance[1, :], variance[:, 1] = middle + sides[k] * (end - half[k]), 0.0, 0.0
            variance[1, 1] = half_m2[k] + scene.R[j, 1, 1]
        row = [column[j] for column in scene.seen]
        row[1], row[2], row[3], row[5], row[10] = place, variance, np.zeros(3), 0, 0
        rows.append(tuple(row))
    return rows


def _furthest(reach: Floats, P: Floats) -> int:
    """Return which track reaches furthest, -1 where another may reach as far."""
    first, second = np.argsort(-reach)[:2]
    sigma = math.sqrt(P[first, 1, 1] + P[second, 1, 1])
    return int(first) if reach[first] - reach[second] > _REACH * sigma else -1


def _split(
    scene: Scene, took: Ints, usable: NDArray[np.bool_], lives: NDArray[np.bool_], max_parts_frames: int
) -> list[tuple[int, tuple[int, ...]]]:
    """Return the tracks that are seen in parts, with the segments that together are more like them than any alone."""
    found: list[tuple[int, tuple[int, ...]]] = []
    owned = np.zeros(len(usable), bool)
    owned[took[(took >= 0) & (took < len(usable)) & (scene.status != TrackStatus.TENTATIVE)]] = True
    free = np.flatnonzero(usable & ~owned)
    whole = np.flatnonzero(lives & (scene.memory[:, _PARTS] < max_parts_frames))
    if not (len(free) and len(whole)):
        return found
    near = _within(scene, whole, free, 0.5)
    taken: set[int] = set()
    for k in np.flatnonzero(near.any(axis=1)):
        i = int(whole[k])
        order = [j for j in free[near[k]].tolist() if j not in taken]
        order = [order[k] for k in np.argsort(np.abs(scene.seen[1][order] - scene.x[i]).sum(axis=1))]
        pieces = [int(took[i])] if took[i] >= 0 else order[:1]
        best = _likeness(scene, i, pieces) if pieces else math.inf
        for j in order:
            cost = _likeness(scene, i, [*pieces, j]) if j not in pieces else math.inf
            if cost < best or not (math.isfinite(best) or took[i] >= 0):
                pieces, best = [*pieces, j] if j not in pieces else pieces, cost
        if len(pieces) > 1 and math.isfinite(best):
            found.append((i, tuple(pieces)))
            taken |= set(pieces)
    return found


def _likeness(scene: Scene, i: int, pieces: list[int]) -> float:
    """Return the cost of these segments being, together, track i; infinite where that is outside its gate."""
    weight = np.maximum(scene.seen[5][pieces], 1).astype(float)
    weight /= weight.sum()
    low, high = _bounds(scene.seen, pieces)
    S = scene.P[i] + np.einsum("i,iab->ab", weight**2, scene.R[pieces])
    off = weight @ scene.seen[1][pieces] - scene.x[i]
    squared = float(off @ np.linalg.solve(S, off))
    if not squared <= scene.gate:
        return math.inf
    cost = squared + float(np.linalg.slogdet(S).logabsdet)
    for axis in (1, 2):
        variance = scene.memory[i, SHAPE_SPREAD + axis - 1] + scene.shape[pieces, SHAPE_SPREAD + axis - 1].min()
        extent = max(float(high[axis] - low[axis]), 1e-3)
        cost += (scene.memory[i, axis - 1] - math.log(extent)) ** 2 / variance + math.log(variance)
    return cost


def _bounds(seen: Seen, pieces: list[int] | tuple[int, ...]) -> tuple[Floats, Floats]:
    centre, half = seen[1][list(pieces)], seen[3][list(pieces)] / 2
    return (centre - half).min(axis=0), (centre + half).max(axis=0)


def _joined(seen: Seen, pieces: tuple[int, ...]) -> tuple[object, ...]:
    """Return one segment of several, its label that of the largest."""
    label, position, covariance, _, near, pixels, box, range_m, amplitude, sigma, cut, ends = (
        each[list(pieces)] for each in seen
    )
    count = np.maximum(pixels, 1)
    weight = count / count.sum()
    low, high = _bounds(seen, pieces)
    return (
        label[np.argmax(pixels)],
        weight @ position,
        np.einsum("i,iab->ab", weight**2, covariance),
        high - low,
        near.min(),
        count.sum(),
        np.concatenate([box[:, :2].min(axis=0), box[:, 2:].max(axis=0)]),
        weight @ range_m,
        weight @ amplitude,
        math.sqrt(float(weight**2 @ sigma**2)),
        np.bitwise_or.reduce(cut),
        np.array([ends[:, 0].max(), ends[:, 1].min()]),
    )
