"""People before a camera, as the segments that region growing makes of them: they hide, merge and are cut in parts.

A camera of one row of columns looks along x: each column sees the nearest body, neighbouring columns whose ranges
differ by less than a threshold are one segment.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rangecam.types import Cut, Floats, Ints, Segments

PITCH_RAD = math.radians(0.4)
_HALF_COLUMNS = 90
_GROWING_M = 0.35
_SIGMA_RANGE_M, _SIGMA_PX, _BODY_DEPTH_M = 0.03, 0.25, 0.25
_RATE_HZ = 20.0


class Bodies(NamedTuple):
    """What stands and walks there."""

    time_s: Floats
    """(T,)"""
    place_m: Floats
    """(T, K, 2): x and y."""
    width_m: Floats
    height_m: Floats
    walks: Ints
    """(K,) bool: a person, not a pole."""


def crowd(rng: np.random.Generator, count: int = 12, seconds: float = 12.0) -> Bodies:
    """Return people who walk to and fro across the image, each about at a depth of its own: they hide each other."""
    time_s = np.arange(round(seconds * _RATE_HZ)) / _RATE_HZ
    reach, top_mps = rng.uniform(1.5, 3.0, count), rng.uniform(0.7, 1.3, count)
    phase = rng.uniform(0, 2 * np.pi, (2, count))
    y = reach * np.sin(top_mps / reach * time_s[:, None] + phase[0])
    depth = 5.0 + 0.7 * rng.permutation(count)
    x = depth + 0.2 * np.sin(0.5 * time_s[:, None] + phase[1])
    place = np.stack([x, y], axis=2)
    return Bodies(time_s, place, rng.uniform(0.4, 0.6, count), rng.uniform(1.5, 1.9, count), np.ones(count, bool))


def merge_and_part(rng: np.random.Generator) -> Bodies:
    """Return two people, one large and one small, who meet, walk shoulder to shoulder, and part again."""
    time_s = np.arange(round(9.0 * _RATE_HZ)) / _RATE_HZ
    apart = np.interp(time_s, [0, 2, 6, 9], [1.6, 0.22, 0.22, 1.8])
    y = rng.uniform(-0.8, 0.8) + 0.15 * (time_s - 4.5)
    x = 7.0 - 0.2 * time_s
    place = np.stack([np.stack([x, y - apart], 1), np.stack([x + rng.uniform(-0.08, 0.08), y + apart], 1)], axis=1)
    return Bodies(time_s, place, np.array([0.58, 0.42]), np.array([1.9, 1.5]), np.ones(2, bool))


def cross_close(rng: np.random.Generator) -> Bodies:
    """Return two people who walk past each other so close that they are one segment meanwhile."""
    time_s = np.arange(round(6.0 * _RATE_HZ)) / _RATE_HZ
    way = rng.uniform(0.7, 1.1) * (time_s - 3.0)
    x = 6.0 + rng.uniform(-0.5, 0.5)
    place = np.stack([np.stack([x + 0 * way, way], 1), np.stack([x + 0.3 + 0 * way, -way], 1)], axis=1)
    return Bodies(time_s, place, np.array([0.58, 0.42]), np.array([1.9, 1.5]), np.ones(2, bool))


def behind_a_pole(rng: np.random.Generator) -> Bodies:
    """Return a person who walks behind a pole, which first cuts the body in two, and another behind the first."""
    time_s = np.arange(round(7.0 * _RATE_HZ)) / _RATE_HZ
    speed = rng.uniform(0.8, 1.3)
    first = np.stack([np.full(len(time_s), 7.0), -2.6 + speed * time_s], 1)
    second = np.stack([np.full(len(time_s), 8.2), 2.4 - 0.8 * speed * time_s], 1)
    pole = np.tile([4.0, rng.uniform(-0.3, 0.3)], (len(time_s), 1))
    place = np.stack([first, second, pole], axis=1)
    return Bodies(time_s, place, np.array([0.5, 0.5, 0.15]), np.array([1.75, 1.65, 2.5]), np.array([True, True, False]))


CROWDS: dict[str, Callable[[np.random.Generator], Bodies]] = {
    "crowd of 12": crowd,
    "meet and part": merge_and_part,
    "pass close": cross_close,
    "behind a pole": behind_a_pole,
}
"""Scenes by name."""


def seen_of(bodies: Bodies, k: int, rng: np.random.Generator) -> Segments:
    """Return what the camera sees of frame k."""
    place, half = bodies.place_m[k], bodies.width_m / 2
    azimuth = (np.arange(-_HALF_COLUMNS, _HALF_COLUMNS) + 0.5) * PITCH_RAD
    front = place[:, 0] - _BODY_DEPTH_M / 2
    inside = np.abs(front[:, None] * np.tan(azimuth)[None] - place[:, 1][:, None]) <= half[:, None]
    depth = np.where(inside, front[:, None], np.inf)
    who = np.where(inside.any(axis=0), depth.argmin(axis=0), -1)
    nearest = depth.min(axis=0)
    with np.errstate(invalid="ignore"):
        joins = (np.abs(np.diff(nearest)) < _GROWING_M) & (who[1:] >= 0) & (who[:-1] >= 0)
    runs = np.concatenate([[0], np.cumsum(~joins)])
    rows = [_segment(bodies, who, nearest, np.flatnonzero((runs == run) & (who >= 0)), azimuth, rng)
            for run in np.unique(runs[who >= 0])]  # fmt: skip
    return _segments(rows)


def _segment(
    bodies: Bodies, who: Ints, nearest: Floats, columns: Ints, azimuth: Floats, rng: np.random.Generator
) -> dict[str, object]:
    """Return one segment: its columns, all of the height of whom they see."""
    range_m, height = nearest[columns], bodies.height_m[who[columns]]
    pixels = np.maximum(np.rint(height / (range_m * PITCH_RAD)), 1)
    weight = pixels / pixels.sum()
    x = float(weight @ range_m) + _SIGMA_RANGE_M * rng.standard_normal()
    across_m = _SIGMA_PX * PITCH_RAD * x
    tall = float(height.max()) + across_m * rng.standard_normal()
    y = float(weight @ (range_m * np.tan(azimuth[columns]))) + across_m * rng.standard_normal()
    cut = 0
    for beside, image, hidden in (
        (columns[0] - 1, Cut.RIGHT, Cut.HIDDEN_RIGHT), (columns[-1] + 1, Cut.LEFT, Cut.HIDDEN_LEFT),
    ):  # fmt: skip
        if not 0 <= beside < len(azimuth):
            cut |= int(image)
        elif nearest[beside] < range_m.min():
            cut |= int(Cut.OCCLUDED | hidden)
    width = len(columns) * PITCH_RAD * x
    return {
        "position_m": [x, y, tall / 2],
        "covariance_m2": np.diag([_SIGMA_RANGE_M**2, across_m**2, across_m**2 / 4]),
        "size_m": [_BODY_DEPTH_M, width, tall],
        "near_m": x,
        "n_pixels": int(pixels.sum()),
        "box": [0, columns[0], int(pixels.max()), columns[-1] + 1],
        "range_m": math.hypot(x, y),
        "cut": cut,
        "nearest_m": [x, y, tall / 2],
    }


def _segments(rows: list[dict[str, object]]) -> Segments:
    n = len(rows)
    column = {key: [row[key] for row in rows] for key in (rows[0] if rows else ())}

    def table(key: str, *shape: int) -> Floats:
        return np.array(column.get(key, []), float).reshape(n, *shape)

    return Segments(
        label=np.arange(1, n + 1),
        position_m=table("position_m", 3),
        covariance_m2=table("covariance_m2", 3, 3),
        size_m=table("size_m", 3),
        near_m=table("near_m"),
        n_pixels=table("n_pixels").astype(int),
        box=table("box", 4).astype(int),
        range_m=table("range_m"),
        sigma_range_m=np.full(n, _SIGMA_RANGE_M),
        amplitude=np.full(n, 100.0),
        cut=table("cut").astype(np.uint8),
        nearest_m=table("nearest_m", 3),
    )
