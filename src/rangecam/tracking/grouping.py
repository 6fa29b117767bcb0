"""Who shares a segment and who is seen in parts, as loops over arrays that the caller made: see `groups`."""

import math

import numpy as np
from numpy.typing import NDArray

from rangecam.compiled import kernel
from rangecam.types import MEMORY, Floats, Ints, TrackStatus

_TENTATIVE, _COASTING = int(TrackStatus.TENTATIVE), int(TrackStatus.COASTING)
_GROUP, _PARTS, _SPREAD = MEMORY.index("merged"), MEMORY.index("parts"), 3
_STAY = 2 * math.log(9.0)
"""Those who were merged a frame ago are nine times as likely to be so still: a merge lasts ten frames or more."""
_STAY_HIDDEN = -2 * math.log(0.9)
"""Cost of not being seen for those who were not a frame ago: whoever is hidden is so for ten frames or more."""
_REACH = 2.0  # standard deviations of a predicted position
_MOST = 5  # tracks in one segment of which every part is tried as the group that it shows
_DEPTH_M = 0.5  # of a segment's depth hardly anything is seen

State = tuple[Ints, Ints, Floats, Floats, Floats, Floats, Floats]
"""Of the tracks: status, track_id, n_pixels, size_m, memory; x (N, 9) and P (N, 9, 9), predicted."""
Shown = tuple[Floats, Floats, Ints, Floats, Floats]
"""Of the segments: position_m, size_m, n_pixels, R (M, 3, 3), shape (M, 7)."""


@kernel
def concerned(
    status: Ints, size: Floats, memory: Floats, x: Floats, P: Floats, position: Floats, extent: Floats, took: Ints,
    max_parts: float,
) -> bool:  # fmt: skip
    """Return whether anything may be merged or in parts: a lost track in a segment, or a segment left over by a track.

    Lost: it took none and is not tentative. Whoever is merged or in parts is so by more than this.
    """
    taken = np.zeros(len(position), np.bool_)
    for i in range(took.size):
        if took[i] >= 0:
            taken[took[i]] = True
    for i in range(took.size):
        if status[i] != _TENTATIVE:
            lost, whole = took[i] < 0, memory[i, _PARTS] < max_parts
            for j in range(taken.size):
                if lost and _near(x, P, size, i, 0.0, position, extent, j):
                    return True
                if whole and not taken[j] and _near(x, P, size, i, 0.5, position, extent, j):
                    return True
    return False


@kernel
def _near(x: Floats, P: Floats, size: Floats, i: int, share: float, position: Floats, extent: Floats, j: int) -> bool:
    """Return whether the predicted centre lies in the segment's box; share: of the track's size beside it."""
    for a in range(3):
        reach = extent[j, a] / 2 + share * size[i, a] + _REACH * math.sqrt(max(P[i, 3 * a, 3 * a], 0.0))
        if not abs(x[i, 3 * a] - position[j, a]) <= reach + (_DEPTH_M if a == 0 else 0.0):
            return False
    return True


@kernel
def search(
    tracks: State, shown: Shown, limits: tuple[float, float, float], took: Ints, mate_of: Ints, part_of: Ints
) -> int:
    """Find merges and splits; return how many tracks there are in them.

    limits: gate, cost of a track that is not seen, frames in parts. Written: mate_of (N,), the segment that each track
    shares, and part_of (M,), the track that each segment is a part of; -1 for none.
    """
    position, R = shown[0], shown[3]
    owner, free = np.empty(part_of.size, np.int64), np.empty(part_of.size, np.bool_)
    for j in range(part_of.size):
        total = 0.0
        for a in range(3):
            total += position[j, a] + R[j, a, 0] + R[j, a, 1] + R[j, a, 2]
        owner[j], part_of[j], free[j] = -1, -1, math.isfinite(total)
    for i in range(took.size):
        mate_of[i] = -1
        if took[i] >= 0 and tracks[0][i] != _TENTATIVE:
            owner[took[i]] = i
    count = _merged(tracks, shown, limits, took, owner, free, mate_of)
    return count + _split(tracks, shown, limits, took, owner, free, mate_of, part_of)


@kernel
def _merged(
    tracks: State,
    shown: Shown,
    limits: tuple[float, float, float],
    took: Ints,
    owner: Ints,
    free: NDArray[np.bool_],
    mate_of: Ints,
) -> int:
    """Find the segments that show several tracks, none of them elsewhere, together of its size.

    They are neither free nor anybody's own afterwards.
    """
    status, _, _, size, _, x, P = tracks
    members, some, best = np.empty((3, took.size), np.int64)
    room, count = np.empty((4, max(took.size, 3))), 0
    for j in range(free.size):
        m = 0
        if owner[j] >= 0:
            members[0], m = owner[j], 1
        for i in range(took.size if free[j] else 0):
            lost = took[i] < 0 and status[i] != _TENTATIVE and mate_of[i] < 0
            if lost and _near(x, P, size, i, 0.0, shown[0], shown[1], j):
                members[m] = i
                m += 1
        if m < 2:
            continue
        least, most = math.inf, 0
        for case in range(1, 2**m if m <= _MOST else m + 2):  # every part of a few, of many each alone and all
            n = _picked(members, m, case, some)
            cost = _total(tracks, shown, limits, j, some, n, room)
            if cost < least:
                least, most = cost, n
                for k in range(n):
                    best[k] = some[k]
        if most > 1:
            free[j], owner[j] = False, -1
            count += most
            for k in range(most):
                mate_of[best[k]] = j
    return count


@kernel
def _picked(members: Ints, m: int, case: int, some: Ints) -> int:
    """Write the members of this case and return how many they are; a count from a loop would compile its user twice."""
    n = 0
    for k in range(m):
        if (case >> k & 1) if m <= _MOST else (case == k + 1 or case == m + 1):
            some[n] = members[k]
            n += 1
    return n


@kernel
def _total(
    tracks: State, shown: Shown, limits: tuple[float, float, float], j: int, some: Ints, n: int, room: Floats
) -> float:  # fmt: skip
    """Return the cost of segment j showing the first n of `some`, beside that of seeing none of them.

    Expected: the centroid by their pixels; whose shares may be anything, where one hides another, which spreads it
    along the line between them; width and height from edge to edge. Each of them must make the group wider by more than
    it is uncertain: whoever is behind the others is hidden, not merged.
    """
    status, _, n_pixels, _, memory, x, P = tracks
    position, _, _, R, shape = shown
    S = np.empty((3, 3))
    _mean_of(n_pixels, x, P, R, j, some, n, -1, room, S)
    centre, together = room[0], n > 1 and memory[some[0], _GROUP] != 0
    for k in range(n):
        together = together and memory[some[k], _GROUP] == memory[some[0], _GROUP]
    squared, log_determinant = _distance(
        S, position[j, 0] - centre[0], position[j, 1] - centre[1], position[j, 2] - centre[2]
    )
    if not squared <= limits[0] or (n > 1 and not _each_widens(memory, x, P, some, n, room)):
        return math.inf
    cost = squared + log_determinant - (_STAY if together else 0.0)
    for k in range(n):
        was_hidden = status[some[k]] == _COASTING and memory[some[k], _GROUP] == 0
        cost -= _STAY_HIDDEN if was_hidden else limits[1]
    for axis in (1, 2):
        low, high, spread, place = math.inf, -math.inf, 0.0, 0.0
        for k in range(n):
            half = math.exp(memory[some[k], axis - 1]) / 2
            low, high = min(low, x[some[k], 3 * axis] - half), max(high, x[some[k], 3 * axis] + half)
            spread += memory[some[k], _SPREAD + axis - 1]
            place += P[some[k], 3 * axis, 3 * axis]
        variance = spread / n + shape[j, _SPREAD + axis - 1]
        if n > 1:
            variance += place / (high - low) ** 2
        cost += (math.log(high - low) - shape[j, axis - 1]) ** 2 / variance + math.log(variance)
    return cost


@kernel
def _mean_of(
    n_pixels: Floats, x: Floats, P: Floats, R: Floats, j: int, some: Ints, n: int, without: int, room: Floats,
    S: Floats,
) -> None:  # fmt: skip
    """Write the centroid of tracks by their pixels and its covariance as segment j measures it; shares may be anything.

    Written: room[0], the centroid; room[1], shares of the pixels; S (3, 3). without: of whom P is left out.
    """
    pixels = 0.0
    for k in range(n):
        pixels += n_pixels[some[k]]
    for a in range(3):
        room[0, a] = 0.0
        for k in range(n):
            room[1, k] = n_pixels[some[k]] / pixels
            room[0, a] += room[1, k] * x[some[k], 3 * a]
    for a in range(3):
        for b in range(3):
            S[a, b] = R[j, a, b]
            for k in range(n):
                apart = (x[some[k], 3 * a] - room[0, a]) * (x[some[k], 3 * b] - room[0, b])
                S[a, b] += room[1, k] / 3 * apart
                if k != without:
                    S[a, b] += room[1, k] ** 2 * P[some[k], 3 * a, 3 * b]


@kernel
def _distance(S: Floats, u: float, v: float, w: float) -> tuple[float, float]:
    """Return the squared distance of (u, v, w) with the covariance S (3, 3), and log det S; infinite if it is none."""
    c00 = S[1, 1] * S[2, 2] - S[1, 2] * S[1, 2]
    c01 = S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
    c02 = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]
    determinant = S[0, 0] * c00 + S[0, 1] * c01 + S[0, 2] * c02
    if not determinant > 0:
        return math.inf, 0.0
    c11 = S[0, 0] * S[2, 2] - S[0, 2] * S[0, 2]
    c12 = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2]
    c22 = S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    squared = c00 * u * u + c11 * v * v + c22 * w * w + 2 * (c01 * u * v + c02 * u * w + c12 * v * w)
    return squared / determinant, math.log(determinant)


@kernel
def _each_widens(memory: Floats, x: Floats, P: Floats, some: Ints, n: int, room: Floats) -> bool:
    """Return whether the group covers less of the line across without any one of them, by more than its sigma.

    Written: room[2], room[3]: the ends of each, in the order of the right ones.
    """
    for k in range(n):
        half, m = math.exp(memory[some[k], 0]) / 2, k
        while m > 0 and room[2, m - 1] > x[some[k], 3] - half:
            room[2, m], room[3, m] = room[2, m - 1], room[3, m - 1]
            m -= 1
        room[2, m], room[3, m] = x[some[k], 3] - half, x[some[k], 3] + half
    whole = _covered(room, n, math.nan)
    for k in range(n):
        right = x[some[k], 3] - math.exp(memory[some[k], 0]) / 2
        if not whole - _covered(room, n, right) > math.sqrt(P[some[k], 3, 3]):
            return False
    return True


@kernel
def _covered(room: Floats, n: int, without: float) -> float:
    """Return how much of the line is covered, without the one whose right end that is."""
    reached, covered = -math.inf, 0.0
    for k in range(n):
        if room[2, k] != without and room[3, k] > reached:
            covered += room[3, k] - (reached if reached > room[2, k] else room[2, k])
            reached = room[3, k]
    return covered


@kernel
def _split(
    tracks: State, shown: Shown, limits: tuple[float, float, float], took: Ints, owner: Ints,
    free: NDArray[np.bool_], mate_of: Ints, part_of: Ints,
) -> int:  # fmt: skip
    """Find the tracks seen in parts: segments that together are more like them than any alone."""
    status, _, _, size, memory, x, P = tracks
    order, pieces = np.empty((2, free.size + 1), np.int64)
    far, count = np.empty(free.size), 0
    for i in range(took.size):
        m = 0
        whole = status[i] != _TENTATIVE and mate_of[i] < 0 and memory[i, _PARTS] < limits[2]
        for j in range(free.size if whole else 0):
            available = free[j] and owner[j] < 0 and part_of[j] < 0
            if available and _near(x, P, size, i, 0.5, shown[0], shown[1], j):
                apart, k = 0.0, m
                for a in range(3):
                    apart += abs(shown[0][j, a] - x[i, 3 * a])
                while k > 0 and far[k - 1] > apart:
                    far[k], order[k] = far[k - 1], order[k - 1]
                    k -= 1
                far[k], order[k] = apart, j
                m += 1
        if m == 0:
            continue
        owns, best, n = took[i] >= 0 and owner[took[i]] == i, math.inf, 0
        for k in range(-1 if owns else 0, m):
            pieces[n] = order[k] if k >= 0 else took[i]
            cost = _likeness(tracks, shown, limits[0], i, pieces, n + 1)
            if n == 0 or cost < best or not (best < math.inf or owns):
                best, n = cost, n + 1
        if n > 1 and best < math.inf:
            count += 1
            for k in range(n):
                part_of[pieces[k]] = i
    return count


@kernel
def _likeness(tracks: State, shown: Shown, gate: float, i: int, pieces: Ints, n: int) -> float:
    """Return the cost of the first n of `pieces` being, together, track i; infinite where that is outside its gate."""
    _, _, _, _, memory, x, P = tracks
    position, size, pixels, R, shape = shown
    all_pixels, u, v, w = 0.0, -x[i, 0], -x[i, 3], -x[i, 6]
    S = np.empty((3, 3))
    for k in range(n):
        all_pixels += pixels[pieces[k]] if pixels[pieces[k]] > 1 else 1
    for a in range(3):
        for b in range(3):
            S[a, b] = P[i, 3 * a, 3 * b]
    for k in range(n):
        j = pieces[k]
        weight = (pixels[j] if pixels[j] > 1 else 1) / all_pixels
        u, v, w = u + weight * position[j, 0], v + weight * position[j, 1], w + weight * position[j, 2]
        for a in range(3):
            for b in range(3):
                S[a, b] += weight**2 * R[j, a, b]
    squared, log_determinant = _distance(S, u, v, w)
    if not squared <= gate:
        return math.inf
    cost = squared + log_determinant
    for axis in (1, 2):
        low, high, least = math.inf, -math.inf, math.inf
        for k in range(n):
            j = pieces[k]
            low = min(low, position[j, axis] - size[j, axis] / 2)
            high = max(high, position[j, axis] + size[j, axis] / 2)
            least = min(least, shape[j, _SPREAD + axis - 1])
        variance = memory[i, _SPREAD + axis - 1] + least
        cost += (memory[i, axis - 1] - math.log(max(high - low, 1e-3))) ** 2 / variance + math.log(variance)
    return cost


@kernel
def hold(tracks: State, shown: Shown, j: int, some: Ints, place: Floats, covariance: Floats) -> None:
    """Write what a common segment says of each of its tracks: place (n, 3) and covariance (n, 3, 3).

    The one that reaches furthest to a side ends where the segment ends, if none of the others is likely to reach as
    far: its centre is half its width from there, as surely as the width is known. Else it is where it is if the others
    are where they are expected: z = sum of a_i p_i, a_i the shares of the pixels, gives p_i = (z - sum of the others'
    a p) / a_i, with the covariance of all that is subtracted, and that of the shares, over a_i^2; for two alike that is
    more than four times that of the segment, plus that of the other. Ahead it is where the segment is, but for how far
    it is expected from it.
    """
    _, _, n_pixels, _, memory, x, P = tracks
    position, size, _, R, shape = shown
    n, width = some.size, size[j, 1]
    room, S = np.empty((4, max(n, 3))), np.empty((3, 3))
    for k in range(n):
        half = math.exp(memory[some[k], 0]) / 2
        room[2, k], room[3, k] = half - x[some[k], 3], half + x[some[k], 3]
    right, left = _furthest(room, 2, P, some), _furthest(room, 3, P, some)
    for k in range(n):
        i = some[k]
        _mean_of(n_pixels, x, P, R, j, some, n, k, room, S)
        for a in range(3):
            place[k, a] = (position[j, a] - room[0, a]) / room[1, k] + x[i, 3 * a]
            for b in range(3):
                covariance[k, a, b] = S[a, b] / room[1, k] ** 2
        _settle(place, covariance, k, 0, position[j, 0], R[j, 0, 0] + (x[i, 0] - room[0, 0]) ** 2)
        if k in (left, right):
            far_right, far_left = -math.inf, -math.inf
            for m in range(n):
                far_right, far_left = max(far_right, room[2, m]), max(far_left, room[3, m])
            middle = position[j, 1] + (far_left - far_right) / 2 - room[0, 1]  # of the box, not of the pixels
            half = math.exp(memory[i, 0]) / 2
            sure = half**2 * memory[i, _SPREAD] + width**2 * shape[j, _SPREAD] / 4 + R[j, 1, 1]
            _settle(place, covariance, k, 1, middle + (width / 2 - half) * (1.0 if k == left else -1.0), sure)


@kernel
def _settle(place: Floats, covariance: Floats, k: int, axis: int, value: float, variance: float) -> None:
    """Write a coordinate that is known apart from the others."""
    place[k, axis] = value
    for a in range(3):
        covariance[k, axis, a], covariance[k, a, axis] = 0.0, 0.0
    covariance[k, axis, axis] = variance


@kernel
def _furthest(reach: Floats, side: int, P: Floats, some: Ints) -> int:
    """Return which track reaches furthest, -1 where another may reach as far."""
    first, second = (0, 1) if reach[side, 0] >= reach[side, 1] else (1, 0)
    for k in range(2, some.size):
        if reach[side, k] > reach[side, first]:
            first, second = k, first
        elif reach[side, k] > reach[side, second]:
            second = k
    sigma = math.sqrt(P[some[first], 3, 3] + P[some[second], 3, 3])
    return first if reach[side, first] - reach[side, second] > _REACH * sigma else -1
