"""From segments to tracks: predict, associate, update, initiate, delete."""

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from numba import njit
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from rangecam.errors import DataError
from rangecam.motion import MOTION, MotionSettings
from rangecam.settings import Fraction, NonNegative, NonNegativeInt, Positive, PositiveInt, settings
from rangecam.types import ACCELERATION, CLASSES, POSITION, VELOCITY, Floats, Ints, Segments, Tracks, TrackStatus

_TENTATIVE, _CONFIRMED, _COASTING = (int(s) for s in TrackStatus)
_GONE = -1

NO_PAIR = 1e6
"""Cost of a pairing outside the gate: far above any that is inside."""


@settings
class TrackingSettings:
    """How tracks are born, live and die."""

    motion: MotionSettings = MotionSettings()
    association: Literal["global", "by_age"] = "global"
    """global: the best pairing as a whole; by_age: the oldest track chooses first (the thesis)."""
    gate_probability: Annotated[float, Interval(gt=0, lt=1)] = 0.999
    """Share of true measurements that lie in the gate around the predicted position."""
    speed_sigma_mps: Positive = 5.0
    """How fast new objects may be: their velocity starts as 0 with this standard deviation, along each axis."""
    acceleration_sigma_mps2: Positive = 3.0
    """The same for their acceleration."""
    position_sigma_m: NonNegative = 0.01
    """Error of a measured position that does not average out, added to the measurement's own covariance."""
    extent_sigma: NonNegative = 0.05
    """Wander of the centroid over an extended object: standard deviation as a share of the object's size."""
    frame_time_sigma_s: NonNegative = 0.0
    """Jitter of the frames' time stamps; it blurs the position of a moving object along its way."""
    confirm_hits: PositiveInt = 3
    """A track is confirmed once seen this often ..."""
    confirm_frames: PositiveInt = 5
    """... within its first frames, this many; otherwise it is dropped."""
    max_misses: NonNegativeInt = 10
    """A confirmed track is deleted when missed more often than this in a row."""
    max_position_sigma_m: Positive = 2.0
    """A track is deleted when its position, along any axis, is less certain than this: the limit for long gaps."""
    max_late_s: NonNegative = 1.0
    """A frame older than the tracks by up to this is late and ignored; one older still means that the camera's clock
    was set back, and tracking starts anew."""
    shape_weight: Fraction = 0.3
    """Weight of the newest size, nearest point and pixel count in their running means."""


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
    seen = _seen(segments)
    state, covariance, R, cost = _predict(tracks, seen, dt_s, settings)
    took = ASSOCIATION[settings.association](cost, tracks.age)
    tracks = _update(tracks, (state, covariance, R), took, seen, time_s, settings)
    first = _unclaimed(took, seen[0], R)
    return _initiate(tracks, seen, R, first, settings) if first.size else tracks


@lru_cache(maxsize=16)
def gate_threshold(probability: float) -> float:
    """Return the squared Mahalanobis distance within which a three-dimensional measurement lies with `probability`.

    The quantile of chi-square with three degrees of freedom (König 2008, appendix B).
    """
    return float(chdtri(3, 1 - probability))


def associate_globally(cost: Floats, age: Ints) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: as many pairs as possible, of the least total cost.

    cost (N, M): squared Mahalanobis distance plus log det S, twice the negative log-likelihood of the pairing but for
    a constant; `NO_PAIR` outside the gate.
    """
    took = np.empty(age.size, np.int64)
    _take_pairs(took, cost, *linear_sum_assignment(cost))
    return took


@njit(cache=True, nogil=True)
def _take_pairs(took: Ints, cost: Floats, rows: Ints, columns: Ints) -> None:
    took[:] = -1
    for k in range(rows.size):
        if cost[rows[k], columns[k]] < NO_PAIR:
            took[rows[k]] = columns[k]


def associate_by_age(cost: Floats, age: Ints) -> Ints:
    """Return the segment's index for each track (N,), -1 for none: the oldest chooses first (K-TRK-04, K-TRK-05)."""
    took = np.full(len(age), -1)
    if cost.shape[1]:
        free = cost.copy()
        for i in np.argsort(-age, kind="stable"):
            j = int(np.argmin(free[i]))
            if free[i, j] < NO_PAIR:
                took[i] = j
                free[:, j] = NO_PAIR
    return took


ASSOCIATION: dict[str, Callable[[Floats, Ints], Ints]] = {"global": associate_globally, "by_age": associate_by_age}
"""Association methods by name: (cost of each pairing, age of each track) -> segment of each track."""

_Measured = tuple[Floats, Floats, float]
"""Positions (M, 3), covariances (M, 3, 3), variance of the time."""
_Seen = tuple[Floats, Floats, Ints, Floats, Floats, Floats]


def _seen(segments: Segments) -> _Seen:
    """Return position, covariance, label, size, nearest x and pixel count in the types that the kernels expect."""
    return (
        np.asarray(segments.position_m, np.float64),
        np.asarray(segments.covariance_m2, np.float64),
        np.asarray(segments.label, np.int64),
        np.asarray(segments.size_m, np.float64),
        np.asarray(segments.near_m, np.float64),
        np.asarray(segments.n_pixels, np.float64),
    )


def _predict(
    tracks: Tracks, seen: _Seen, dt_s: float, settings: TrackingSettings
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return predicted states (N, 9) and covariances (N, 9, 9), R (M, 3, 3), and the cost of each pairing (N, M)."""
    n, m = len(tracks), len(seen[0])
    new = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty((m, 3, 3)), np.empty((n, m))
    model = MOTION[settings.motion.model](dt_s, settings.motion)
    noise = settings.position_sigma_m**2, settings.extent_sigma**2, settings.frame_time_sigma_s**2
    gate = gate_threshold(settings.gate_probability)
    _predict_and_gate((tracks.state, tracks.covariance), model, (seen[0], seen[1], seen[3]), noise, gate, new)
    return new


@njit(cache=True, nogil=True)
def _predict_and_gate(
    old: tuple[Floats, Floats],
    model: tuple[Floats, Floats],
    seen: tuple[Floats, Floats, Floats],
    noise: tuple[float, float, float],
    gate: float,
    new: tuple[Floats, Floats, Floats, Floats],
) -> None:
    """Write the predictions, the measurement covariances with all their parts, and the cost of each pairing."""
    x, P, R, cost = new
    z, covariance, size = seen
    common, extent, time_variance = noise
    for j in range(size.shape[0]):
        for a in range(3):
            for b in range(3):
                R[j, a, b] = covariance[j, a, b]
            R[j, a, a] += common + extent * size[j, a] ** 2
    _predict_states(old[0], old[1], model, x, P)
    _gate(x, P, (z, R, time_variance), gate, cost)


@njit(cache=True, nogil=True)
def _predict_states(state: Floats, covariance: Floats, model: tuple[Floats, Floats], x: Floats, P: Floats) -> None:
    """Write F x and F P F' + Q (König 2008, fig 6.8) into x and P, block by block; all of F is upper triangular."""
    F, Q = model
    t, f, r = F[0, 1], F[0, 2], F[1, 2]
    d = F[2, 2]
    for i in range(state.shape[0]):
        for a in (0, 3, 6):
            x[i, a] = state[i, a] + t * state[i, a + 1] + f * state[i, a + 2]
            x[i, a + 1] = state[i, a + 1] + r * state[i, a + 2]
            x[i, a + 2] = d * state[i, a + 2]
            for b in range(a, 9, 3):
                for c in range(b, b + 3):
                    p0, p1, p2 = covariance[i, a, c], covariance[i, a + 1, c], covariance[i, a + 2, c]
                    P[i, a, c], P[i, a + 1, c], P[i, a + 2, c] = p0 + t * p1 + f * p2, p1 + r * p2, d * p2
                for c in range(a, a + 3):
                    p0, p1, p2 = P[i, c, b], P[i, c, b + 1], P[i, c, b + 2]
                    P[i, c, b], P[i, c, b + 1], P[i, c, b + 2] = p0 + t * p1 + f * p2, p1 + r * p2, d * p2
            for b in range(3):
                for c in range(3):
                    P[i, a + b, a + c] += Q[b, c]
        for a in range(9):
            for b in range(a):
                P[i, a, b] = P[i, b, a]


@njit(cache=True, nogil=True)
def _gate(x: Floats, P: Floats, measured: _Measured, gate: float, cost: Floats) -> None:
    """Write the cost of each pairing (N, M); the box around the gate's ellipsoid settles it for most."""
    z, R, time_variance = measured
    S, V = np.empty((3, 3)), np.empty((3, 3))
    for i in range(cost.shape[0]):
        for j in range(cost.shape[1]):
            cost[i, j] = NO_PAIR
            for a in range(3):
                variance = P[i, 3 * a, 3 * a] + R[j, a, a] + time_variance * x[i, 3 * a + 1] ** 2
                if not (z[j, a] - x[i, 3 * a]) ** 2 <= gate * variance:  # or not a number
                    break
            else:
                _innovation_covariance(S, x[i], P[i], measured, j)
                d2, log_det = _mahalanobis(x[i], S, V, z[j])
                if d2 <= gate:
                    cost[i, j] = d2 + log_det


@njit(cache=True, nogil=True)
def _innovation_covariance(S: Floats, x: Floats, P: Floats, measured: _Measured, j: int) -> None:
    """Write S = H P H' + R into S; H picks x, y, z (E-K-21). A wrong time shifts a moving object along its way."""
    for a in range(3):
        for b in range(3):
            S[a, b] = P[3 * a, 3 * b] + measured[1][j, a, b] + measured[2] * x[3 * a + 1] * x[3 * b + 1]


@njit(cache=True, nogil=True)
def _mahalanobis(x: Floats, S: Floats, V: Floats, z: Floats) -> tuple[float, float]:
    """Write the inverse of S into V; return the squared Mahalanobis distance (eq 6.14, E-K-20) and log det S."""
    det = _invert(S, V)
    d2 = 0.0
    for a in range(3):
        for b in range(3):
            d2 += (z[a] - x[3 * a]) * V[a, b] * (z[b] - x[3 * b])
    return d2, math.log(det)


@njit(cache=True, nogil=True)
def _invert(S: Floats, V: Floats) -> float:
    """Write the inverse of the symmetric positive S (3, 3) into V and return its determinant."""
    V[0, 0] = S[1, 1] * S[2, 2] - S[1, 2] * S[1, 2]
    V[0, 1] = S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
    V[0, 2] = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]
    V[1, 1] = S[0, 0] * S[2, 2] - S[0, 2] * S[0, 2]
    V[1, 2] = S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2]
    V[2, 2] = S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    det = S[0, 0] * V[0, 0] + S[0, 1] * V[0, 1] + S[0, 2] * V[0, 2]
    for a in range(3):
        for b in range(a, 3):
            V[a, b] /= det
            V[b, a] = V[a, b]
    return float(det)


def _update(
    tracks: Tracks,
    estimate: tuple[Floats, Floats, Floats],
    took: Ints,
    seen: _Seen,
    time_s: float,
    settings: TrackingSettings,
) -> Tracks:
    """Return the tracks with what they took, without those that end; `estimate` is their prediction and the R."""
    n, (state, covariance, R) = len(tracks), estimate
    age, hits, misses, status, segment = (np.empty(n, np.int64) for _ in range(5))
    size_m, near_offset_m, n_pixels, nis = np.empty((n, 3)), np.empty(n), np.empty(n), np.empty(n)
    _update_states(took, state, covariance, (seen[0], R, settings.frame_time_sigma_s**2), nis)
    lives = (tracks.status, tracks.age, tracks.hits, tracks.misses)
    rules = (settings.confirm_hits, settings.confirm_frames, settings.max_misses, settings.max_position_sigma_m**2)
    gone = _update_lives(took, lives, covariance, rules, (status, age, hits, misses))
    shapes = (tracks.size_m, tracks.near_offset_m, tracks.n_pixels)
    _update_shapes(took, shapes, seen, settings.shape_weight, (segment, size_m, near_offset_m, n_pixels))
    older = Tracks(
        track_id=tracks.track_id,
        status=status,
        state=state,
        covariance=covariance,
        age=age,
        hits=hits,
        misses=misses,
        size_m=size_m,
        near_offset_m=near_offset_m,
        n_pixels=n_pixels,
        segment=segment,
        class_probability=tracks.class_probability,
        nis=nis,
        time_s=time_s,
        next_id=tracks.next_id,
    )
    return _map(lambda values: values[status != _GONE], older) if gone else older


@njit(cache=True, nogil=True)
def _update_states(took: Ints, state: Floats, covariance: Floats, measured: _Measured, nis: Floats) -> None:
    """Write the measurement update (König 2008, fig 6.9) of every track that took a segment, and its NIS."""
    S, V, K, AP = np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 3)), np.empty((9, 9))
    for i in range(took.size):
        nis[i] = np.nan
        if took[i] < 0:
            continue
        x, P, z = state[i], covariance[i], measured[0][took[i]]
        _innovation_covariance(S, x, P, measured, took[i])
        nis[i], _ = _mahalanobis(x, S, V, z)
        for a in range(9):
            for b in range(3):
                K[a, b] = P[a, 0] * V[0, b] + P[a, 3] * V[1, b] + P[a, 6] * V[2, b]
        for a in range(3):
            for b in range(3):
                S[a, b] -= P[3 * a, 3 * b]  # S is R from here on
        _joseph(P, K, S, AP)
        step_x, step_y, step_z = z[0] - x[0], z[1] - x[3], z[2] - x[6]
        for a in range(9):
            x[a] += K[a, 0] * step_x + K[a, 1] * step_y + K[a, 2] * step_z


@njit(cache=True, nogil=True)
def _joseph(P: Floats, K: Floats, R: Floats, AP: Floats) -> None:
    """Write A P A' + K R K' with A = I - K H into P: symmetric, and positive whatever the rounding; AP is scratch."""
    for a in range(9):
        for b in range(9):
            AP[a, b] = P[a, b] - K[a, 0] * P[0, b] - K[a, 1] * P[3, b] - K[a, 2] * P[6, b]
    for a in range(9):
        kr_0 = K[a, 0] * R[0, 0] + K[a, 1] * R[1, 0] + K[a, 2] * R[2, 0] - AP[a, 0]
        kr_1 = K[a, 0] * R[0, 1] + K[a, 1] * R[1, 1] + K[a, 2] * R[2, 1] - AP[a, 3]
        kr_2 = K[a, 0] * R[0, 2] + K[a, 1] * R[1, 2] + K[a, 2] * R[2, 2] - AP[a, 6]
        for b in range(a, 9):
            P[a, b] = P[b, a] = AP[a, b] + kr_0 * K[b, 0] + kr_1 * K[b, 1] + kr_2 * K[b, 2]


@njit(cache=True, nogil=True)
def _update_lives(
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
def _update_shapes(
    took: Ints,
    old: tuple[Floats, Floats, Floats],
    seen: _Seen,
    weight: float,
    new: tuple[Ints, Floats, Floats, Floats],
) -> None:
    """Write the label of the segment each track took, and the running means of size, nearest point and pixels."""
    new_label, new_size, new_offset, new_pixels = new
    size, offset, pixels = old
    position, _, label, seen_size, near, seen_pixels = seen
    for i in range(took.size):
        j = took[i]
        new_label[i], new_offset[i], new_pixels[i] = 0, offset[i], pixels[i]
        for a in range(3):
            new_size[i, a] = size[i, a]
        if j >= 0:
            new_label[i] = label[j]
            new_offset[i] += weight * (position[j, 0] - near[j] - offset[i])
            new_pixels[i] += weight * (seen_pixels[j] - pixels[i])
            for a in range(3):
                new_size[i, a] += weight * (seen_size[j, a] - size[i, a])


@njit(cache=True, nogil=True)
def _unclaimed(took: Ints, z: Floats, R: Floats) -> Ints:
    """Return the indices of the segments that no track took, without those that are not finite."""
    free, n = np.empty(z.shape[0], np.int64), 0
    for j in range(z.shape[0]):
        total = 0.0
        for a in range(3):
            total += z[j, a] + R[j, a, 0] + R[j, a, 1] + R[j, a, 2]
        claimed = not math.isfinite(total)
        for i in range(took.size):
            claimed = claimed or took[i] == j
        if not claimed:
            free[n] = j
            n += 1
    return free[:n]


def _initiate(tracks: Tracks, seen: _Seen, R: Floats, first: Ints, settings: TrackingSettings) -> Tracks:
    """Return the tracks and a new one for each of the segments `first`: at rest until seen to move, class unknown."""
    n = len(first)
    z, _, label, size_m, near_m, n_pixels = (values[first] for values in seen)
    state, covariance, unknown = np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, len(CLASSES)))
    state[:, POSITION] = z
    covariance[np.ix_(range(n), POSITION, POSITION)] = R[first]
    covariance[:, VELOCITY, VELOCITY] = settings.speed_sigma_mps**2
    covariance[:, ACCELERATION, ACCELERATION] = settings.acceleration_sigma_mps2**2
    unknown[:, CLASSES.index("unknown")] = 1.0
    once = np.ones(n, np.int64)
    new = Tracks(
        track_id=tracks.next_id + np.arange(n),
        status=np.full(n, _CONFIRMED if settings.confirm_hits == 1 else _TENTATIVE),
        state=state,
        covariance=covariance,
        age=once,
        hits=once,
        misses=np.zeros(n, np.int64),
        size_m=size_m,
        near_offset_m=z[:, 0] - near_m,
        n_pixels=n_pixels,
        segment=label,
        class_probability=unknown,
        nis=np.full(n, np.nan),
    )
    both = _map(lambda *values: np.concatenate(values), tracks, new)
    return dataclasses.replace(both, next_id=tracks.next_id + n)


def _map(function: Callable[..., Any], tracks: Tracks, *others: Tracks) -> Tracks:
    """Return `tracks` with `function` applied to each of its arrays, and to those of the `others` beside it."""
    fields = [name for name, value in vars(tracks).items() if isinstance(value, np.ndarray)]
    arrays = {name: function(*(getattr(t, name) for t in (tracks, *others))) for name in fields}
    return dataclasses.replace(tracks, **arrays)
