"""Where and when a path touches the outline of the vehicle, or how close it comes to it."""

import math

from rangecam.collision.arrival import moved, time_to_reach
from rangecam.compiled import kernel
from rangecam.types import Side

_NONE = int(Side.NONE)

Path = tuple[float, float, float, float, float, float]
"""x, y, vx, vy, ax, ay of an object's middle, from that of our outline."""
Outline = tuple[float, float, float]
"""Half the length, half the width and corner radius of what a point must not enter: both outlines together."""


@kernel
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
        u, w = moved(x, vx, ax, t), moved(y, vy, ay, t)
        if abs(w if along else u) > (hy if along else hx):
            continue
        if radius > 0:
            t += _to_corner(u, w, vx + ax * t, vy + ay * t, outline)
        if t < first:
            first, side = t, k + 1
    return first, side


@kernel
def _corner_gap(x: float, y: float, outline: Outline) -> float:
    """Return the distance to the rounded outline of a point, negative inside."""
    hx, hy, radius = outline
    u, w = abs(x) - hx + radius, abs(y) - hy + radius
    if u > 0 and w > 0:
        return math.hypot(u, w) - radius
    return max(u, w) - radius


@kernel
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


@kernel
def closest(where: Path, outline: Outline, start: float, horizon: float) -> tuple[float, float]:
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


@kernel
def _gap(where: Path, outline: Outline, t: float) -> float:
    x, y = moved(where[0], where[2], where[4], t), moved(where[1], where[3], where[5], t)
    hx, hy, radius = outline
    u, w = max(abs(x) - hx + radius, 0.0), max(abs(y) - hy + radius, 0.0)
    return max(math.sqrt(u * u + w * w) - radius, 0.0)
