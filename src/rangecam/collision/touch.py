"""The probability that an object touches the outline of the vehicle, and on which side."""

import math

import numpy as np

from rangecam.collision.arrival import axis_variance, moved, time_to_reach
from rangecam.collision.gaussian import both_above, cholesky, normal
from rangecam.collision.outline import Outline, Path
from rangecam.compiled import kernel
from rangecam.types import Floats, Side

_NONE, _FRONT, _LEFT, _RIGHT, _REAR = (int(side) for side in Side)
_EXCLUDED = 4.0  # standard deviations


@kernel
def p_contact(P: Floats, where: Path, outline: Outline, limits: Floats, points: Floats) -> tuple[float, float, int]:
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
        far = axis_variance(P, 0, horizon, limits), axis_variance(P, 3, horizon, limits)
        if _is_excluded(where, outline, far[0], far[1], horizon):
            return 0.0, 0.0, _NONE
    L = _root(P, k, axis_variance(P, 3 * k, t, limits), axis_variance(P, 3 - 3 * k, 0.0, limits), use_a)
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


@kernel
def _face_ahead(where: Path, outline: Outline) -> tuple[int, float, int]:
    """Return the axis, its sign and the side of the face of the outline that an object comes to."""
    if where[0] > outline[0]:
        return 0, 1.0, _FRONT
    if abs(where[1]) > outline[1]:
        return (1, 1.0, _LEFT) if where[1] > 0 else (1, -1.0, _RIGHT)
    return (0, -1.0, _REAR) if where[0] < -outline[0] else (0, 1.0, _FRONT)


@kernel
def _root(
    P: Floats, k: int, mine: tuple[float, float, float], other: tuple[float, float, float], use_a: float
) -> Floats:
    """Return the Cholesky root (6, 6) of: across a face position, speed, acceleration; along it the same.

    k: axis across the face; mine, other: what `axis_variance` says of it, and of the other axis.
    """
    L = np.zeros((6, 6))
    for a in range(6):
        for b in range(a + 1):
            if use_a != 0 or (a != 2 and a != 5 and b != 2 and b != 5):
                L[a, b] = P[(3 * k + a) % 6, (3 * k + b) % 6]
    L[0, 0], L[1, 1], L[3, 3], L[4, 4] = mine[0], mine[2], other[0], other[2]
    cholesky(L)
    return L


@kernel
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
    speed = s * math.sqrt(2 / math.pi) * math.exp(-w * w / (2 * s * s)) + w * (2 * normal(w / s) - 1)
    return moved(u, w, b, first), here, moved(u, w, b, last), there, common, speed


@kernel
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
    beyond, before = normal((here - half) / sigma), normal((-half - here) / sigma)
    edge = half - cut
    stays_beyond = both_above((edge - here) / sigma, (edge - there) / later, common)
    stays_before = both_above((edge + here) / sigma, (edge + there) / later, common)
    at_face = max(1 - beyond - before, 0.0)
    left, right = beyond - stays_beyond, before - stays_before
    lost = min(left, 0.0) + min(right, 0.0)
    return max(at_face + lost, 0.0), max(left, 0.0), max(right, 0.0)


@kernel
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
