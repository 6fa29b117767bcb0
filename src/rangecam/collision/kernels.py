"""The prediction of collisions, track by track, as loops over arrays that the caller made.

All kernels are in one file because Numba's cache on disk notices changes of the file that a kernel is in, not of
others. Times in here count from the moment that the image shows, `lag` before its time stamp.
"""

import math

import numpy as np
from numba import njit

from rangecam.types import Floats, Ints, Side, TrackStatus

_TENTATIVE, _CONFIRMED = int(TrackStatus.TENTATIVE), int(TrackStatus.CONFIRMED)
_NONE, _FRONT, _LEFT, _RIGHT, _REAR = (int(side) for side in Side)
_NEVER = 1e-9  # closing rate, 1/s: what takes decades to come does not come
_EXCLUDED = 4.0  # standard deviations

Path = tuple[float, float, float, float, float, float]
"""x, y, vx, vy, ax, ay of an object's middle, from that of our outline."""
Outline = tuple[float, float, float]
"""Half the length, half the width and corner radius of what a point must not enter: both outlines together."""


@njit(cache=True, nogil=True)
def time_to_reach(distance_m: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Return the smallest t >= 0 with distance + speed t + acceleration t^2 / 2 <= 0, inf if there is none (E-K-24)."""
    if distance_m <= 0:
        return 0.0
    discriminant = speed_mps * speed_mps - 2 * acceleration_mps2 * distance_m
    if not discriminant >= 0:
        return math.inf
    denominator = math.sqrt(discriminant) - speed_mps  # this form of the root needs no case for acceleration 0
    return 2 * distance_m / denominator if denominator > _NEVER * distance_m else math.inf


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _way_aside(distance: float, yaw_rate: float, speed: float) -> float:
    """Return y of our own way, the arc of the present turn, so far ahead; straight on where the speed is unknown.

    What is farther ahead than the arc reaches is beside it.
    """
    if yaw_rate == 0 or not speed > 0 or not distance > 0:
        return 0.0
    radius = speed / yaw_rate
    ahead = min(distance, abs(radius))
    return radius - math.copysign(math.sqrt(radius * radius - ahead * ahead), radius)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _bend(v: float, yaw_rate: float, speed: float) -> float:
    """Return the lateral acceleration, in turning axes, of an object that moves straight on: Coriolis minus our own."""
    return -2 * yaw_rate * v - yaw_rate * (speed if math.isfinite(speed) else -v)


@njit(cache=True, nogil=True)
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
    variance = _longitudinal(P, base, min(t, horizon), limits)
    new[0], new[1], new[2] = max(t - lag, 0.0), math.nan, math.nan
    if 0 < t < math.inf:
        new[1] = _time_sigma(variance, P, base, t, v, a, use_a)
    if t < math.inf:
        new[2] = _at(where[1], where[3], where[5], t)
    _quantiles((gap, v, a), variance, (P, base, use_a), face != _NONE or t < math.inf, points, z, lag, new[7:])
    if met > horizon:
        side = _NONE
    new[3], p_lateral, likeliest = _p_contact(P, where, outline, limits, points)
    new[4] = side if side != _NONE else likeliest
    new[5], new[6] = _closest(where, outline, lag, horizon)
    return p_lateral


@njit(cache=True, nogil=True)
def _at(x: float, v: float, a: float, t: float) -> float:
    return x + v * t + a * t * t / 2


@njit(cache=True, nogil=True)
def _longitudinal(P: Floats, base: int, t: float, limits: Floats) -> tuple[float, float, float]:
    """Return the variances of distance, of both, of speed; base: 0 along, 3 across.

    What the speed drifts until t moves the object by a variance of q t^3 / 3 (`motion.constant_velocity`), as if the
    speed were so much less certain now.
    """
    fixed = limits[7] if base == 0 else limits[8] ** 2 / 4
    dd, vv = max(P[base, base] + fixed, 0.0), max(P[base + 1, base + 1] + limits[6] * t / 3, 0.0)
    most = math.sqrt(dd * vv)
    return dd, min(max(P[base, base + 1], -most), most), vv


@njit(cache=True, nogil=True)
def _time_sigma(
    variance: tuple[float, float, float], P: Floats, base: int, t: float, v: float, a: float, use_a: float
) -> float:
    """Return the standard deviation of the time by error propagation: from d + v t + a t^2/2 = 0."""
    slope = v + a * t
    c = use_a * t * t / 2
    total = variance[0] + 2 * t * variance[1] + t * t * variance[2]
    total += 2 * c * (P[base, base + 2] + t * P[base + 1, base + 2]) + c * c * P[base + 2, base + 2]
    return math.sqrt(max(total, 0.0)) / abs(slope) if slope != 0 else math.inf


@njit(cache=True, nogil=True)
def _quantiles(
    motion: tuple[float, float, float],
    variance: tuple[float, float, float],
    source: tuple[Floats, int, float],
    comes: bool,
    points: Floats,
    z: Floats,
    lag: float,
    new: Floats,
) -> None:
    """Write the quantiles of the time in which d + v t + a t^2/2 reaches 0; motion: d, v, a."""
    d, v, a = motion
    if not comes:
        new[:] = math.inf
    elif a == 0 and source[2] == 0:
        for k in range(z.size):
            new[k] = max(arrival_quantile(d, v, variance, z[k]) - lag, 0.0)
    else:
        _sampled_quantiles(motion, variance, source, points, z, lag, new)


@njit(cache=True, nogil=True)
def arrival_quantile(d: float, v: float, variance: tuple[float, float, float], z: float) -> float:
    """Return t with Phi(-(d + v t) / s(t)) = Phi(z), s(t)^2 the variance of d + v t; inf where it never gets there.

    d + v t = -z s(t), squared, is a quadratic equation; of its roots, that with the sign of -z on the left counts. Its
    discriminant is written so that what b^2 and a c have in common, almost all where s is small, is not subtracted.
    """
    dd, dv, vv = variance
    if d + z * math.sqrt(max(dd, 0.0)) <= 0:  # already here
        return 0.0
    a, b, c = v * v - z * z * vv, d * v - z * z * dv, d * d - z * z * dd
    if z == 0:
        return -d / v if v < -_NEVER * d else math.inf
    discriminant = z * z * (v * v * dd + d * d * vv - 2 * d * v * dv - z * z * max(dd * vv - dv * dv, 0.0))
    if discriminant < 0:
        return math.inf
    root = math.sqrt(discriminant)
    q = -b - root if b > 0 else -b + root  # both roots without cancellation
    best = math.inf
    for t in (q / a if a != 0 else math.inf, c / q if q != 0 else math.inf):
        rounding = 1e-12 * abs(z) * (abs(d) + abs(v * t))
        if 0 <= t < best and (d + v * t) * z <= rounding and t < 1 / _NEVER:
            best = t
    return best


@njit(cache=True, nogil=True)
def _sampled_quantiles(
    motion: tuple[float, float, float],
    variance: tuple[float, float, float],
    source: tuple[Floats, int, float],
    points: Floats,
    z: Floats,
    lag: float,
    new: Floats,
) -> None:
    P, base, use_a = source
    block = np.zeros((3, 3))
    block[0, 0], block[1, 0], block[1, 1] = variance[0], variance[1], variance[2]
    if use_a != 0:
        block[2, 0], block[2, 1], block[2, 2] = P[base, base + 2], P[base + 1, base + 2], P[base + 2, base + 2]
    _cholesky(block)
    n = points.shape[0]
    times = np.empty(n)
    for k in range(n):
        e = points[k]
        d = motion[0] + block[0, 0] * e[0]
        v = motion[1] + block[1, 0] * e[0] + block[1, 1] * e[1]
        a = motion[2] + block[2, 0] * e[0] + block[2, 1] * e[1] + block[2, 2] * e[2]
        times[k] = time_to_reach(d, v, a)
    times.sort()
    for k in range(z.size):
        place = min(max(_normal(z[k]) * n - 0.5, 0.0), n - 1.0)
        low = int(place)
        high, part = min(low + 1, n - 1), place - low
        if math.isfinite(times[high]):
            new[k] = max(times[low] + part * (times[high] - times[low]) - lag, 0.0)
        else:
            new[k] = max(times[low if part < 0.5 else high] - lag, 0.0)


@njit(cache=True, nogil=True)
def contact(path: Path, outline: Outline) -> tuple[float, int]:
    """Return when a point on a path first touches an outline around the origin, inf if it does not, and which side.

    A point inside touches at once, at the side that it is least deep in.
    """
    x, y, vx, vy, ax, ay = path
    hx, hy, radius = outline
    gaps = x - hx, y - hy, -y - hy, -x - hx
    best, deepest = 0, gaps[0]
    for k in range(1, 4):
        if gaps[k] > deepest:
            best, deepest = k, gaps[k]
    if deepest <= 0 and (radius == 0 or _corner_gap(x, y, outline) <= 0):
        return 0.0, best + 1
    first, side = math.inf, _NONE
    for k in range(4):
        if gaps[k] < 0 or (gaps[k] == 0 and deepest > 0):
            continue
        sign = 1.0 if k < 2 else -1.0
        along = k == 0 or k == 3
        t = time_to_reach(gaps[k], sign * (vx if along else vy), sign * (ax if along else ay))
        if t >= first:
            continue
        u, w = _at(x, vx, ax, t), _at(y, vy, ay, t)
        if abs(w if along else u) > (hy if along else hx):
            continue
        if radius > 0:
            t += _to_corner(u, w, vx + ax * t, vy + ay * t, outline)
        if t < first:
            first, side = t, k + 1
    return first, side


@njit(cache=True, nogil=True)
def _corner_gap(x: float, y: float, outline: Outline) -> float:
    """Return the distance to the rounded outline of a point, negative inside."""
    hx, hy, radius = outline
    u, w = abs(x) - hx + radius, abs(y) - hy + radius
    if u > 0 and w > 0:
        return math.hypot(u, w) - radius
    return max(u, w) - radius


@njit(cache=True, nogil=True)
def _to_corner(x: float, y: float, vx: float, vy: float, outline: Outline) -> float:
    """Return how long a point on a face of the rectangle still takes to the rounded corner; inf if it passes by."""
    hx, hy, radius = outline
    u, w = abs(x) - hx + radius, abs(y) - hy + radius
    if u <= 0 or w <= 0:
        return 0.0
    u, w = math.copysign(u, x), math.copysign(w, y)
    square = vx * vx + vy * vy
    b, c = u * vx + w * vy, u * u + w * w - radius * radius
    discriminant = b * b - square * c
    if c <= 0:
        return 0.0
    if b >= 0 or discriminant < 0:
        return math.inf
    return c / (math.sqrt(discriminant) - b)


@njit(cache=True, nogil=True)
def _p_contact(P: Floats, where: Path, outline: Outline, limits: Floats, points: Floats) -> tuple[float, float, int]:
    """Return the probability of a contact within the horizon, that of one if our front is reached, the likeliest side.

    Seen from the face ahead of which the object is (the front, else a side, else the rear): each point of the
    distribution of the motion across the face gives the time at which the face is reached, and the time at which the
    other end of the outline is. Given the point, where the object is along the face at both times is Gaussian, with
    what its speed drifts until then. The path touches the face if it is there between the corners, and one of the next
    sides if it comes in before the other end.
    """
    horizon, use_a = limits[4] + limits[9], limits[5]
    k, sign, face = _face_ahead(where, outline)
    gap = sign * where[k] - outline[k]
    t = min(horizon, time_to_reach(gap, sign * where[2 + k], sign * where[4 + k]))
    if use_a == 0 and where[5] == 0:
        far = _longitudinal(P, 0, horizon, limits), _longitudinal(P, 3, horizon, limits)
        if _is_excluded(where, outline, far[0], far[1], horizon):
            return 0.0, 0.0, _NONE
    L = _root(P, k, _longitudinal(P, 3 * k, t, limits), _longitudinal(P, 3 - 3 * k, 0.0, limits), use_a)
    n, hits, reached, sides = points.shape[0], 0.0, 0, np.zeros(5)
    for m in range(n):
        e = points[m]
        gap_here = gap + sign * L[0, 0] * e[0]
        v = where[2 + k] + L[1, 0] * e[0] + L[1, 1] * e[1]
        a = where[4 + k] + L[2, 0] * e[0] + L[2, 1] * e[1] + L[2, 2] * e[2]
        first = time_to_reach(gap_here, sign * v, sign * a)
        if first > horizon:
            continue
        last = min(time_to_reach(gap_here + 2 * outline[k], sign * v, sign * a), horizon)
        reached += 1
        chances = _chances(_along_face(L, e, where, k, (first, last, limits[6])), v + a * first, outline, k)
        hits += chances[0] + chances[1] + chances[2]
        sides[face] += chances[0]
        sides[_LEFT if k == 0 else _FRONT] += chances[1]
        sides[_RIGHT if k == 0 else _REAR] += chances[2]
    likeliest = int(np.argmax(sides)) if hits > 0.5 / n else _NONE
    return min(hits / n, 1.0), min(hits / max(reached, 1), 1.0), likeliest


@njit(cache=True, nogil=True)
def _face_ahead(where: Path, outline: Outline) -> tuple[int, float, int]:
    """Return the axis, its sign and the side of the face of the outline that an object comes to."""
    if where[0] > outline[0]:
        return 0, 1.0, _FRONT
    if abs(where[1]) > outline[1]:
        return (1, 1.0, _LEFT) if where[1] > 0 else (1, -1.0, _RIGHT)
    return (0, -1.0, _REAR) if where[0] < -outline[0] else (0, 1.0, _FRONT)


@njit(cache=True, nogil=True)
def _root(
    P: Floats, k: int, mine: tuple[float, float, float], other: tuple[float, float, float], use_a: float
) -> Floats:
    """Return the Cholesky root (6, 6) of: across a face position, speed, acceleration; along it the same.

    k: axis across the face; mine, other: what `_longitudinal` says of it, and of the other axis.
    """
    L = np.zeros((6, 6))
    for a in range(6):
        for b in range(a + 1):
            if use_a != 0 or (a != 2 and a != 5 and b != 2 and b != 5):
                L[a, b] = P[(3 * k + a) % 6, (3 * k + b) % 6]
    L[0, 0], L[1, 1], L[3, 3], L[4, 4] = mine[0], mine[2], other[0], other[2]
    _cholesky(L)
    return L


@njit(cache=True, nogil=True)
def _along_face(
    L: Floats, e: Floats, where: Path, k: int, times: tuple[float, float, float]
) -> tuple[float, float, float, float, float, float]:
    """Return where an object is along a face at two times, given a point: means, sigmas, correlation; and how fast.

    times: both, and the variance that the speed drifts in a second. A speed that walks at random with q moves the
    object by a variance of q t^3 / 3, of which q first^2 (3 last - first) / 6 is common to both times.
    """
    first, last, q = times
    u, w, b = where[1 - k], where[3 - k], where[5 - k]
    for c in range(3):
        u, w, b = u + L[3, c] * e[c], w + L[4, c] * e[c], b + L[5, c] * e[c]
    here, there, both = q * first**3 / 3, q * last**3 / 3, q * first * first * (3 * last - first) / 6
    spread, shared = 1e-24, 0.0
    for c in range(3, 6):
        one = L[3, c] + first * L[4, c] + first * first / 2 * L[5, c]
        two = L[3, c] + last * L[4, c] + last * last / 2 * L[5, c]
        here, there, both = here + one * one, there + two * two, both + one * two
        spread, shared = spread + L[4, c] ** 2, shared + L[4, c] * one
    here, there = math.sqrt(max(here, 1e-24)), math.sqrt(max(there, 1e-24))
    common = min(max(both / (here * there), -1.0), 1.0)
    s = math.sqrt(max(spread - (shared / here) ** 2, 1e-24))  # of the speed of what comes to one place of the face
    speed = s * math.sqrt(2 / math.pi) * math.exp(-w * w / (2 * s * s)) + w * (2 * _normal(w / s) - 1)
    return _at(u, w, b, first), here, _at(u, w, b, last), there, common, speed


@njit(cache=True, nogil=True)
def _chances(
    free: tuple[float, float, float, float, float, float], v: float, outline: Outline, k: int
) -> tuple[float, float, float]:
    """Return the probabilities that a path touches a face, and each of the sides next to it.

    free: see `_along_face`; v: speed across. Rounded corners take away what their support function lacks: |v| h(n) with
    n across the path, which is r (|v| + |w| - |(v, w)|) less, for the mean of |w|.
    """
    here, sigma, there, later, common, w = free
    half = outline[1 - k]
    across = min(abs(w / v), 1e9) if v != 0 else 0.0  # infinite, it would be less than itself
    cut = outline[2] * (across + 1 - math.hypot(1.0, across)) if outline[2] > 0 and v != 0 else 0.0
    beyond, before = _normal((here - half) / sigma), _normal((-half - here) / sigma)
    edge = half - cut
    stays_beyond = _both_above((edge - here) / sigma, (edge - there) / later, common)
    stays_before = _both_above((edge + here) / sigma, (edge + there) / later, common)
    at_face = max(1 - beyond - before, 0.0)
    left, right = beyond - stays_beyond, before - stays_before
    lost = min(left, 0.0) + min(right, 0.0)
    return max(at_face + lost, 0.0), max(left, 0.0), max(right, 0.0)


@njit(cache=True, nogil=True)
def _both_above(h: float, k: float, r: float) -> float:
    """Return the probability that two standard normal variables of correlation r are above h and above k.

    Its derivative by r is the density at (h, k) (Plackett 1954), integrated from what is known: the product at r = 0,
    or the smaller of both at r = 1. Good to 3e-4, to 1e-5 where r < 0.8 or r > 0.95.
    """
    alone = _normal(-h), _normal(-k)
    smaller = min(alone[0], alone[1])
    if smaller < _NEGLIGIBLE or 1 - max(alone[0], alone[1]) < _NEGLIGIBLE:
        return smaller
    if r > _ALIKE:
        return min(max(smaller - _missing(h, k, 1 - r * r), 0.0), smaller)
    angle = math.asin(r)
    total = 0.0
    for i in range(len(_NODES)):
        sine = math.sin(angle * _NODES[i, 0])
        total += _NODES[i, 1] * math.exp(-((h - k) ** 2 / (1 - sine * sine) / 2 + h * k / (1 + sine)))
    return min(max(alone[0] * alone[1] + total * angle / (2 * math.pi), 0.0), smaller)


@njit(cache=True, nogil=True)
def _missing(h: float, k: float, x2: float) -> float:
    """Return how much less probable it is than at r = 1 that both are above: x2 = 1 - r^2.

    With r = sqrt(1 - t^2) it is 1 / 2 pi times the integral up to x of exp(-d^2 / 2 t^2) g(t), d = h - k, where g(t) =
    exp(-m / (1 + sqrt(1 - t^2))) / sqrt(1 - t^2) with m = h k is smooth, exp(-m / 2) (1 + (1/2 - m/8) t^2 + ..). With
    E = exp(-d^2 / 2 x^2) the integrals of its powers are I0 = x E - d sqrt(2 pi) Phi(-d / x) and, as the derivative of
    x^n E is (n x^(n-1) + d^2 x^(n-3)) E, I2 = (x^3 E - d^2 I0) / 3 and I4 = (x^5 E - d^2 I2) / 5.
    """
    d2, m = (h - k) ** 2, h * k
    if d2 >= 24 * x2:  # less than exp(-12)
        return 0.0
    x, d = math.sqrt(x2), abs(h - k)
    e = x * math.exp(-d2 / x2 / 2)
    i0 = e - d * math.sqrt(2 * math.pi) * _normal(-d / x)
    i2 = (x2 * e - d2 * i0) / 3
    i4 = (x2 * x2 * e - d2 * i2) / 5
    return math.exp(-m / 2) / (2 * math.pi) * (i0 + (1 / 2 - m / 8) * i2 + (3 / 8 - m / 8 + m * m / 128) * i4)


_ALIKE = 0.8
_NEGLIGIBLE = 1e-5
_NODES: Floats = np.stack(np.polynomial.legendre.leggauss(8), axis=1) / 2 + [0.5, 0.0]
"""Places and weights of Gauss and Legendre between 0 and 1."""


@njit(cache=True, nogil=True)
def _is_excluded(
    where: Path,
    outline: Outline,
    along: tuple[float, float, float],
    across: tuple[float, float, float],
    horizon: float,
) -> bool:
    """Return whether one axis alone keeps the object off, by 4 standard deviations, until the horizon.

    The distance to a face less so many standard deviations is concave over time: its least is at one of the ends.
    """
    for axis in range(2):
        dd, dv, vv = along if axis == 0 else across
        now = _EXCLUDED * math.sqrt(max(dd, 0.0))
        then = _EXCLUDED * math.sqrt(max(dd + 2 * horizon * dv + horizon * horizon * vv, 0.0))
        end = where[axis] + where[2 + axis] * horizon
        for sign in (1.0, -1.0):
            if min(sign * where[axis] - now, sign * end - then) > outline[axis]:
                return True
    return False


@njit(cache=True, nogil=True)
def _closest(where: Path, outline: Outline, start: float, horizon: float) -> tuple[float, float]:
    """Return the smallest gap to our outline on the whole way until the horizon, 0 at a contact, and when it is.

    On a straight path the gap is convex over time, so that halving the interval by the golden section finds it; a
    bent one is looked at 32 times before.
    """
    low, high = start, horizon
    if where[4] != 0 or where[5] != 0:
        step, best = (horizon - start) / 32, 0
        for k in range(33):
            if _gap(where, outline, start + k * step) < _gap(where, outline, start + best * step):
                best = k
        low, high = max(start, start + (best - 1) * step), min(horizon, start + (best + 1) * step)
    met = contact(where, outline)[0]
    if met <= high:
        return 0.0, max(met - start, 0.0)
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = _gap(where, outline, left), _gap(where, outline, right)
    for _ in range(24):
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - _GOLDEN * (high - low)
            at_left = _gap(where, outline, left)
        else:
            low, left, at_left = left, right, at_right
            right = low + _GOLDEN * (high - low)
            at_right = _gap(where, outline, right)
    t = low if low == start else high if high == horizon else (low + high) / 2
    return _gap(where, outline, t), t - start


_GOLDEN = (math.sqrt(5) - 1) / 2


@njit(cache=True, nogil=True)
def _gap(where: Path, outline: Outline, t: float) -> float:
    x, y = _at(where[0], where[2], where[4], t), _at(where[1], where[3], where[5], t)
    hx, hy, radius = outline
    u, w = max(abs(x) - hx + radius, 0.0), max(abs(y) - hy + radius, 0.0)
    return max(math.sqrt(u * u + w * w) - radius, 0.0)


@njit(cache=True, nogil=True)
def _cholesky(L: Floats) -> None:
    """Turn the lower half of a covariance into its root in place; rows without variance become zero."""
    n = L.shape[0]
    for a in range(n):
        for b in range(a + 1):
            total = L[a, b]
            for c in range(b):
                total -= L[a, c] * L[b, c]
            if a == b:
                L[a, a] = math.sqrt(total) if total > 0 else 0.0
            else:
                L[a, b] = total / L[b, b] if L[b, b] > 0 else 0.0
        for b in range(a + 1, n):
            L[a, b] = 0.0


@njit(cache=True, nogil=True)
def _normal(u: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-u / math.sqrt(2.0))
