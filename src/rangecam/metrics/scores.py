"""Tracks against the truth as scores: GOSPA, CLEAR MOT and HOTA, all from the distances in each frame."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from rangecam.errors import UsageError
from rangecam.types import Floats, Ints
from rangecam.values import value


@value
class Moment:
    """One frame: who was there, who was reported, and how far apart they were.

    truth_id (n,), track_id (m,) int: unique within a frame. distance (n, m): in any unit; 1 - IoU of boxes serves, too.
    """

    truth_id: Ints
    track_id: Ints
    distance: Floats


class Gospa(NamedTuple):
    """The metric, and its parts in its unit to the power of the order, which add up to it to that power."""

    total: float
    localisation: float
    missed: float
    false: float


class Clear(NamedTuple):
    """CLEAR MOT: accuracy, mean distance of the matched, and the counts that the accuracy is made of."""

    mota: float
    motp: float
    switches: int
    misses: int
    false_positives: int
    matches: int


class Hota(NamedTuple):
    """HOTA and what it is made of: detection, association, localisation; each a mean over the thresholds."""

    hota: float
    detection: float
    association: float
    localisation: float


def moment(truth_id: Any, truth_m: Any, track_id: Any, track_m: Any) -> Moment:
    """Return a frame of objects at `truth_m` (n, d) and tracks at `track_m` (m, d), with their Euclidean distances.

    Raises UsageError where the numbers of ids and places differ, or an id comes twice.
    """
    truth_id, track_id = np.asarray(truth_id, int).ravel(), np.asarray(track_id, int).ravel()
    truth_m, track_m = np.asarray(truth_m, float), np.asarray(track_m, float)
    for what, ids, places in (("truth", truth_id, truth_m), ("track", track_id, track_m)):
        if len(ids) != len(places):
            raise UsageError(f"{len(ids)} {what} ids for {len(places)} places: expected one each")
        if len(np.unique(ids)) < len(ids):
            raise UsageError(f"a {what} id comes twice in one frame: {ids.tolist()}")
    if not (len(truth_id) and len(track_id)):
        return Moment(truth_id, track_id, np.zeros((len(truth_id), len(track_id))))
    return Moment(truth_id, track_id, np.linalg.norm(truth_m[:, None] - track_m[None], axis=-1))


def gospa(frame: Moment, cutoff: float, order: float = 2.0) -> Gospa:
    """Return the generalised optimal sub-pattern assignment metric of one frame (Rahmathullah et al. 2017), alpha = 2.

    A missed or false object costs cutoff^order / 2; two farther apart than `cutoff` are one of each.
    """
    _check_limit("cutoff", cutoff)
    cost = np.minimum(frame.distance, cutoff) ** order
    rows, columns = linear_sum_assignment(cost)
    near = frame.distance[rows, columns] < cutoff
    localisation = float(cost[rows, columns][near].sum())
    missed, false = ((len(ids) - int(near.sum())) * cutoff**order / 2 for ids in (frame.truth_id, frame.track_id))
    return Gospa((localisation + missed + false) ** (1 / order), localisation, missed, false)


def clear_mot(frames: Sequence[Moment], limit: float) -> Clear:
    """Return the CLEAR MOT metrics (Bernardin and Stiefelhagen 2008); `limit` is the largest distance of a match.

    Those matched in the frame before stay matched while they can; of the rest, as many as possible are, as near as
    possible. An object that is matched to another track than the last time is a switch. MOTA is NaN without truth,
    MOTP without matches.
    """
    _check_limit("limit", limit)
    before: dict[int, int] = {}
    last: dict[int, int] = {}
    switches = matches = 0
    total = 0.0
    for frame in frames:
        kept = [[before.get(i) == j for j in frame.track_id.tolist()] for i in frame.truth_id.tolist()]
        allowed = frame.distance <= limit
        cost = np.where(allowed, frame.distance / limit - 1e3 * np.reshape(kept, allowed.shape), 1e6)
        rows, columns = linear_sum_assignment(cost)
        good = allowed[rows, columns]
        rows, columns = rows[good], columns[good]
        before = dict(zip(frame.truth_id[rows].tolist(), frame.track_id[columns].tolist(), strict=True))
        switches += sum(last.get(i, j) != j for i, j in before.items())
        last |= before
        matches += len(rows)
        total += float(frame.distance[rows, columns].sum())
    present, reported = (sum(len(getattr(frame, key)) for frame in frames) for key in ("truth_id", "track_id"))
    misses, false = present - matches, reported - matches
    mota = 1 - (misses + false + switches) / present if present else float("nan")
    return Clear(mota, total / matches if matches else float("nan"), switches, misses, false, matches)


def hota(frames: Sequence[Moment], limit: float) -> Hota:
    """Return the higher order tracking accuracy (Luiten et al. 2021); similarity is 1 - distance / limit, at least 0.

    The mean over 19 thresholds of the similarity, 0.05 to 0.95. At each, matches are chosen so that whole tracks fit;
    sqrt(detection * association) weighs both alike. NaN where nobody was there and nobody was reported.
    """
    _check_limit("limit", limit)
    alike = [np.maximum(0.0, 1 - frame.distance / limit) for frame in frames]
    truths, tracks = (_numbered([getattr(frame, key) for frame in frames]) for key in ("truth_id", "track_id"))
    aligned, lengths = _alignment(truths, tracks, alike)
    thresholds = np.arange(1, 20) * 0.05
    matched, localisation = np.zeros((len(thresholds), *aligned.shape)), np.zeros(len(thresholds))
    for rows, columns, likeness in zip(truths, tracks, alike, strict=True):
        i, j = linear_sum_assignment(-aligned[np.ix_(rows, columns)] * likeness)
        good = likeness[i, j] >= thresholds[:, None] - 1e-12
        localisation += good @ likeness[i, j]
        matched[:, rows[i], columns[j]] += good
    hits = matched.sum(axis=(1, 2))
    everyone = sum(map(len, truths)) + sum(map(len, tracks)) - hits  # matches, misses and false positives
    if not everyone.any():
        return Hota(*[float("nan")] * 4)
    association = (matched**2 / np.maximum(lengths - matched, 1)).sum(axis=(1, 2)) / np.maximum(hits, 1)
    detection = hits / everyone
    where = np.divide(localisation, hits, out=np.ones(len(hits)), where=hits > 0)
    means = (float(each.mean()) for each in (np.sqrt(detection * association), detection, association, where))
    return Hota(*means)


def _numbered(ids: Sequence[Ints]) -> list[Ints]:
    """Return the ids of each frame as numbers from 0 without gaps."""
    known = np.unique(np.concatenate([np.zeros(0, int), *ids]))
    return [np.searchsorted(known, one) for one in ids]


def _alignment(truths: list[Ints], tracks: list[Ints], alike: list[Floats]) -> tuple[Floats, Floats]:
    """Return how much each object and each track are of one kind over all frames, and the sum of their lengths."""
    sizes = [1 + max((int(one.max()) for one in ids if len(one)), default=-1) for ids in (truths, tracks)]
    together, lengths = np.zeros(sizes), np.zeros(sizes)
    for rows, columns, likeness in zip(truths, tracks, alike, strict=True):
        either = likeness.sum(axis=1, keepdims=True) + likeness.sum(axis=0, keepdims=True) - likeness
        share = np.divide(likeness, either, out=np.zeros_like(likeness), where=either > 0)
        together[np.ix_(rows, columns)] += share
        lengths[rows] += 1
        lengths[:, columns] += 1
    return together / np.maximum(lengths - together, 1e-300), lengths


def _check_limit(name: str, limit: float) -> None:
    if not limit > 0:
        raise UsageError(f"{name} = {limit}: expected a distance above 0")
