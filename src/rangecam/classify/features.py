"""What the learned classifier looks at: how a track looks and moves, and did so far.

Frames of one track are not independent evidence: its size in one of them tells much of that in the next. So no
probabilities are multiplied; what is seen is averaged, and the classifier learns how sure one may be of such averages.
It sees the present frame beside them: where both differ, a track has just lost a part of its object, or taken another.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from rangecam.classify.ground import own_velocity
from rangecam.types import PROFILE_BANDS, SURFACE, Ego, Floats, Segments, Tracks, TrackStatus

SEEN = (
    *("log_width", "log_height", "log_depth", "log_fill"),
    *(f"{what}_{band}" for what in ("across", "filled", "behind") for band in range(1, PROFILE_BANDS + 1)),
    *("bottom_m", "top_m", "log_columns", "log_rows", "log_range"),
    *("cut_beside", "cut_above", "cut_below", "occluded"),
    *("log_speed", "log_speed_across", "log_speed_along", "log_speed_sigma"),
    *("log_rough", "lean_across", "lean_up", "sag_across", "sag_up", "shade_across", "inner", "pieces"),
)
"""What is seen of an object in one frame: its extent across the line of sight, upwards and along it (m), the share of
its box in the image that it fills, the profile of its outline (`Segments`), where it begins and ends above the ground,
pixels across and down, range, what cuts it short (0 or 1), and its speed over ground, m/s: whole, across the line of
sight, along it, its standard deviation. And the shape of its surface (`SURFACE`): how far it is from smooth, how it
leans, by how much its sides and its ends lie behind its middle (m), and by how much less light its sides send back."""
_SPREADS, _SEEN, _MEANS = 4 + PROFILE_BANDS, len(SEEN), 4
_BOX = 4 + 3 * PROFILE_BANDS  # first of what follows the profile
_SURFACE = _SEEN - len(SURFACE)
FEATURES = (
    *SEEN,
    *(f"{name}_now" for name in SEEN),
    *(f"{name}_spread" for name in SEEN[:_SPREADS]),
    *("log_slenderness", "moved_mps", "log_seen_s"),
)
"""What the classifier is given: running means, what is seen at last, the spread of the first of them (legs swing),
height over width, the greatest speed that it had for sure, and for how long it is seen."""
MEMORY = (
    *("frames", "time_s", "moved_mps", "since_s", *SEEN),
    *(f"{name}_now" for name in SEEN),
    *(f"{name}_variance" for name in SEEN[:_SPREADS]),
)
"""Columns of `Tracks.class_memory`."""
RESOLVED_PIXELS = 4
"""Columns, and rows, below which an object is not resolved. What tells a person from a post is that the head is 0.24 m
narrower than the shoulders, which are 0.45 m wide. At each edge one pixel more or less is chance, evenly, with a
standard deviation of 0.29 pixels: 0.41 for a width, 0.58 for a difference of two. Three and a half of that, 2 pixels,
must fit into 0.24 m: pixels are at most 0.12 m, and shoulders 4 of them wide. The outline is looked at in as many
bands."""
_MEMORY_S = 1.0  # of the running means
_UNKNOWN_SPEED_MPS = 10.0  # standard deviation of the speed over ground where nobody measures ours
_CONFIRMED = int(TrackStatus.CONFIRMED)


def observe(tracks: Tracks, ego: Ego, segments: Segments) -> tuple[Floats, Floats]:
    """Return the memory of the tracks with this frame, and their features, (N, F) each.

    Tracks that took no segment in this frame keep what they had.
    """
    count = tracks.status.size
    old = tracks.class_memory
    memory = np.zeros((count, len(MEMORY))) if old is None or old.shape != (count, len(MEMORY)) else old.copy()
    features = np.empty((count, len(FEATURES)))
    seen = (
        np.asarray(segments.position_m, float),
        np.asarray(segments.size_m, float),
        np.asarray(segments.n_pixels, np.int64),
        np.asarray(segments.box, np.int64),
        np.asarray(segments.range_m, float),
        np.asarray(segments.cut, np.int64),
        _profile_of(segments),
        _surface_of(segments),
    )
    rows = np.asarray(tracks.segment, np.int64) - 1
    _observe(rows, tracks.state, tracks.covariance, own_velocity(ego), tracks.time_s, *seen, memory, features)
    return memory, features


@njit(cache=True, nogil=True)
def is_resolved(features: Any) -> bool:
    """Return whether an object with these features (F,) has enough pixels and is seen from side to side; a kernel.

    Of the last second: the geometric mean of its pixels counts as enough from a fifth below on, and what is seen from
    side to side in more than a quarter of the frames as seen.
    """
    columns, rows, beside, hidden = features[_BOX + 2], features[_BOX + 3], features[_BOX + 5], features[_BOX + 8]
    return bool(min(columns, rows) >= math.log(0.8 * RESOLVED_PIXELS) and beside < 0.75 and hidden < 0.75)


def _profile_of(segments: Segments) -> Floats:
    """Return the profiles (N, 3 B); where nobody measured them, those of boxes that are seen upright and full."""
    count = len(segments)
    if segments.profile is None:
        return np.repeat([[1.0, 1.0, 0.0]], PROFILE_BANDS, axis=1).repeat(count, axis=0)
    return np.asarray(segments.profile, float).reshape(count, 3 * PROFILE_BANDS)


def _surface_of(segments: Segments) -> Floats:
    """Return the surfaces (N, 8); where nobody measured them, those of smooth boards that face us."""
    if segments.surface is None:
        return np.repeat([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]], len(segments), axis=0)
    return np.asarray(segments.surface, float)


@njit(cache=True, nogil=True)
def _observe(
    rows: Any,
    state: Any,
    covariance: Any,
    own: Any,
    time_s: Any,
    position: Any,
    size: Any,
    n_pixels: Any,
    box: Any,
    range_m: Any,
    cut: Any,
    profile: Any,
    surface: Any,
    memory: Any,
    features: Any,
) -> None:
    now = np.empty(_SEEN)
    for i in range(len(rows)):
        k = rows[i]
        if 0 <= k < len(range_m) and (memory[i, 0] == 0.0 or memory[i, 1] != time_s):
            _look(position[k], size[k], n_pixels[k], box[k], range_m[k], cut[k], profile[k], now)
            _feel(surface[k], now)
            moved = _move(state[i], covariance[i], own, now)
            _remember(now, moved, time_s, memory[i])
        _describe(memory[i], features[i])


@njit(cache=True, nogil=True)
def _look(position: Any, size: Any, n_pixels: Any, box: Any, range_m: Any, cut: Any, profile: Any, now: Any) -> None:
    """Fill how an object looks."""
    away = max(math.sqrt(position[0] ** 2 + position[1] ** 2), 1e-6)
    cosine, sine = position[0] / away, position[1] / away
    now[0] = math.log(max(math.sqrt((size[0] * sine) ** 2 + (size[1] * cosine) ** 2), 0.01))
    now[1] = math.log(max(size[2], 0.01))
    now[2] = math.log(max(math.sqrt((size[0] * cosine) ** 2 + (size[1] * sine) ** 2), 0.01))
    rows, columns = box[2] - box[0], box[3] - box[1]
    now[3] = math.log(n_pixels / (rows * columns))
    for k in range(profile.size):
        now[4 + k] = profile[k]
    at = _BOX
    now[at], now[at + 1] = position[2] - size[2] / 2, position[2] + size[2] / 2
    now[at + 2], now[at + 3], now[at + 4] = math.log(columns), math.log(rows), math.log(max(range_m, 0.01))
    now[at + 5], now[at + 6] = 1.0 if cut & 3 else 0.0, 1.0 if cut & 4 else 0.0
    now[at + 7], now[at + 8] = 1.0 if cut & 8 else 0.0, 1.0 if cut & 16 else 0.0


@njit(cache=True, nogil=True)
def _feel(surface: Any, now: Any) -> None:
    """Fill how the surface of an object is bent; width and height are filled in."""
    at, wide, high = _SURFACE, math.exp(now[0]) / 2, math.exp(now[1]) / 2
    now[at], now[at + 1], now[at + 2] = math.log(0.005 + surface[0]), abs(surface[1]), surface[2]
    now[at + 3], now[at + 4] = surface[3] * wide * wide, surface[4] * high * high
    now[at + 5], now[at + 6], now[at + 7] = surface[5] * wide * wide, surface[6], surface[7]


@njit(cache=True, nogil=True)
def _move(state: Any, covariance: Any, own: Any, now: Any) -> float:
    """Fill how an object moves over ground; return the speed that it has for sure, two standard deviations less."""
    vx, vy, known = state[1] + own[0], state[4] + own[1], own[0] == own[0]
    if not known:
        vx, vy = 0.0, 0.0
    speed = math.sqrt(vx * vx + vy * vy)
    variance = (covariance[1, 1] + covariance[4, 4]) / 2
    if speed > 1e-6:
        variance = vx * vx * covariance[1, 1] + 2 * vx * vy * covariance[1, 4] + vy * vy * covariance[4, 4]
        variance /= speed * speed
    sigma = math.sqrt(max(variance, 0.0) + (0.0 if known else _UNKNOWN_SPEED_MPS**2))
    away = max(math.sqrt(state[0] ** 2 + state[3] ** 2), 1e-6)
    along = abs(vx * state[0] + vy * state[3]) / away
    across = abs(vy * state[0] - vx * state[3]) / away
    at = _BOX + 9
    now[at], now[at + 1], now[at + 2] = math.log(0.2 + speed), math.log(0.2 + across), math.log(0.2 + along)
    now[at + 3] = math.log(0.05 + sigma)
    return max(speed - 2 * sigma, 0.0)


@njit(cache=True, nogil=True)
def _remember(now: Any, moved: float, time_s: float, memory: Any) -> None:
    """Take a frame into the running means and variances: all frames alike at first, those of the last second later."""
    memory[0] += 1.0
    weight = 1.0 / memory[0]
    if memory[0] == 1.0:
        memory[3] = time_s
    else:
        weight = max(weight, 1.0 - math.exp(-max(time_s - memory[1], 0.0) / _MEMORY_S))
    memory[1], memory[2] = time_s, max(memory[2], moved)
    for k in range(now.size):
        apart = now[k] - memory[_MEANS + k]
        memory[_MEANS + k] += weight * apart
        memory[_MEANS + now.size + k] = now[k]
        if k < _SPREADS:
            at = _MEANS + 2 * now.size + k
            memory[at] = (1.0 - weight) * (memory[at] + weight * apart * apart)


@njit(cache=True, nogil=True)
def _describe(memory: Any, features: Any) -> None:
    count = _SEEN
    for k in range(count):
        features[k], features[count + k] = memory[_MEANS + k], memory[_MEANS + count + k]
    for k in range(_SPREADS):
        features[2 * count + k] = math.sqrt(max(memory[_MEANS + 2 * count + k], 0.0))
    at = 2 * count + _SPREADS
    features[at] = memory[_MEANS + 1] - memory[_MEANS]
    features[at + 1] = memory[2]
    features[at + 2] = math.log(0.1 + memory[1] - memory[3])
