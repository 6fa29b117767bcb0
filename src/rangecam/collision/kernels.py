"""The prediction of collisions, track by track, as loops over arrays that the caller made.

Times in here count from the moment that the image shows, `lag` before its time stamp.
"""

import math

import numpy as np

from rangecam.collision.arrival import axis_variance, moved, quantiles, time_sigma, time_to_reach
from rangecam.collision.outline import Outline, Path, closest, contact
from rangecam.collision.touch import p_contact
from rangecam.compiled import kernel
from rangecam.types import Floats, Ints, Side, TrackStatus

_TENTATIVE, _CONFIRMED = int(TrackStatus.TENTATIVE), int(TrackStatus.CONFIRMED)
_NONE, _FRONT, _LEFT, _RIGHT, _REAR = (int(side) for side in Side)


@kernel
def look(
    status: Ints,
    state: Floats,
    covariance: Floats,
    size: Floats,
    wide: Floats,
    near_offset: Floats,
    n_pixels: Floats,
    track_id: Ints,
    class_probability: Floats,
    hits: Ints,
    age: Ints,
    nis: Floats,
    limits: Floats,
    min_probability: float,
    yaw_rate: float,
    speed: float,
    points: Floats,
    z: Floats,
    new: Floats,
    path: Floats,
) -> int:
    """Write the collisions and, into the first rows of path, what is in the path; return how many these are.

    limits: see `predict._limits`; z (5,): quantiles in standard deviations. new (12, N): time, its sigma, lateral
    position, probability, side, closest approach, its time, quantiles of the time.
    """
    width, front, lag, use_a = limits[0], limits[2], limits[9], limits[5]
    found = 0
    for i in range(status.size):
        x, P = state[i], covariance[i]
        depth = max(size[i, 0], near_offset[i], 0.0)
        distance = x[0] - near_offset[i] - front
        bend = _bend(x[1], yaw_rate, speed)
        where = distance + (depth + limits[1]) / 2, x[3], x[1], x[4], use_a * x[2], use_a * x[5] + bend
        outline = (depth + limits[1]) / 2, (width + max(wide[i], 0.0)) / 2, limits[3]
        p_lateral = _collision(P, distance, where, outline, limits, points, z, new[:, i])
        now = distance + x[1] * lag
        # where nothing was seen, a track goes on with a speed that nobody measures: it may not drift into the path;
        # nor may it jump there, by what hardly agrees with it
        surplus = max(nis[i] / 3, 1.0) if math.isfinite(nis[i]) else 1.0
        doubt = surplus - 1 if status[i] == _CONFIRMED else 1.0
        drifts = limits[10] * math.sqrt(doubt * P[3, 3])
        aside = abs(x[3] - _way_aside(distance, yaw_rate, speed))
        inside = aside + drifts <= outline[1]
        if aside > outline[1] and new[3, i] >= min_probability:
            seen = hits[i] if status[i] == _CONFIRMED and hits[i] >= limits[12] * age[i] else 0
            inside = _crosses(x, P, seen, surplus, limits, yaw_rate)
        if inside and now + depth > 0 and math.isfinite(now) and status[i] != _TENTATIVE:
            at = found
            while at > 0 and path[at - 1, 0] > now:  # keeps the nearest first
                path[at] = path[at - 1]
                at -= 1
            row = path[at]
            row[0], row[1], row[2], row[3], row[4] = now, x[1], math.sqrt(P[1, 1]), n_pixels[i], track_id[i]
            row[5] = np.argmax(class_probability[i])
            row[6] = math.sqrt(max(P[0, 0] + 2 * lag * P[0, 1] + lag**2 * P[1, 1] + limits[7], 0.0))
            row[7], row[8], row[9] = P[0, 1] + lag * P[1, 1], x[2], math.sqrt(P[2, 2])
            row[10], row[11], row[12], row[13] = p_lateral, new[0, i], new[1, i], new[3, i]
            row[14], row[15] = hits[i], age[i]
            found += 1
    return found


@kernel
def _way_aside(distance: float, yaw_rate: float, speed: float) -> float:
    """Return y of our own way, the arc of the present turn, so far ahead; straight on where the speed is unknown.

    What is farther ahead than the arc reaches is beside it.
    """
    if yaw_rate == 0 or not speed > 0 or not distance > 0:
        return 0.0
    radius = speed / yaw_rate
    ahead = min(distance, abs(radius))
    return radius - math.copysign(math.sqrt(radius * radius - ahead * ahead), radius)


@kernel
def _crosses(x: Floats, P: Floats, hits: int, surplus: float, limits: Floats, yaw_rate: float) -> bool:
    """Return whether what is beside the corridor was seen to move across our way.

    Across our way a standing object moves by our own turn alone. A speed that agrees with that, or that was measured in
    a few frames only, is taken for it: that of something which is cut by the image's edge while we pass it, or whose
    outermost pixels come and go, points into the path as often as out of it. Such tracks contradict themselves, too:
    where the last innovation is larger than its covariance says, the speed is so much less certain.
    hits: frames in which it was seen, 0 if it is not seen now, or seldom; surplus: of its innovation.
    """
    apart = abs(x[4] + yaw_rate * x[0])
    return hits > 0 and hits >= limits[11] and apart > limits[10] * math.sqrt(surplus * P[4, 4])


@kernel
def _bend(v: float, yaw_rate: float, speed: float) -> float:
    """Return the lateral acceleration, in turning axes, of an object that moves straight on: Coriolis minus our own."""
    return -2 * yaw_rate * v - yaw_rate * (speed if math.isfinite(speed) else -v)


@kernel
def _collision(
    P: Floats, distance: float, where: Path, outline: Outline, limits: Floats, points: Floats, z: Floats, new: Floats
) -> float:
    """Write the collision of one track; return the probability that it hits us if it gets as far as our front."""
    horizon, use_a, lag = limits[4] + limits[9], limits[5], limits[9]
    met, side = contact(where, outline)
    if distance > 0 and side != _LEFT and side != _RIGHT and side != _REAR:
        t, face, gap, v, a, base = time_to_reach(distance, where[2], where[4]), _FRONT, distance, where[2], where[4], 0
    else:
        sign = -1.0 if side in (_RIGHT, _REAR) else 1.0
        base = 0 if side in (_REAR, _FRONT) else 3
        k = 0 if base == 0 else 1
        t, face = met, side
        gap, v, a = sign * where[k] - outline[k], sign * where[2 + k], sign * where[4 + k]
    variance = axis_variance(P, base, min(t, horizon), limits)
    new[0], new[1], new[2] = max(t - lag, 0.0), math.nan, math.nan
    if 0 < t < math.inf:
        new[1] = time_sigma(variance, P, base, t, v, a, use_a)
    if t < math.inf:
        new[2] = moved(where[1], where[3], where[5], t)
    quantiles((gap, v, a), variance, (P, base, use_a), face != _NONE or t < math.inf, points, z, lag, new[7:])
    if met > horizon:
        side = _NONE
    new[3], p_lateral, likeliest = p_contact(P, where, outline, limits, points)
    new[4] = side if side != _NONE else likeliest
    new[5], new[6] = closest(where, outline, lag, horizon)
    return p_lateral
