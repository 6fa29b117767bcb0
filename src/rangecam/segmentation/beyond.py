"""How far the surface of a segment goes on beside its outermost pixels, in refused ones, and where it ends."""

import math
from typing import Any

from rangecam.compiled import kernel
from rangecam.types import Why

_OUTSIDE, _DIM, _ISOLATED = int(Why.OUTSIDE_AREA), int(Why.LOW_AMPLITUDE), int(Why.ISOLATED)
_LEAST_M = 1e-3  # standard deviation of a range


@kernel(forceinline=True)
def end_of(y: Any, range_m: Any, outer: int, beside: int, inner: int, camera_y: float) -> float:
    """Return y of the end of a row: in the direction of half a pixel beyond the outermost, as far away as `inner`.

    beside: the pixel before it. The outermost one may see something else as well, so that its own range is of neither,
    and what is too dim to be used is noisy.
    """
    there = camera_y + (y[outer] - camera_y) * range_m[inner] / range_m[outer]
    here = camera_y + (y[beside] - camera_y) * range_m[inner] / range_m[beside]
    return float(there + (there - here) / 2)


@kernel
def reach_of(flat: Any, label: int, x: Any, z: Any, ranges: Any, why: Any, side: Any, limits: Any) -> int:
    """Return how many columns beside the box of a segment show the same surface, all rows of the box together.

    side: first row, rows, outermost column, columns of the box, columns of the image, step inwards, columns beside it.
    They show it if most of their pixels lie outside the area of interest or are too dim to be used, and are as deep as
    the outermost ones of the segment in the mean. Columns that are deeper all together are a flank of the thing.
    """
    first, lines, start, depth, width, inward, room = side
    range_m, sigma_m = ranges
    number, x_sum, range_sum = 0, 0.0, 0.0
    for row in range(first, first + lines):
        pixel, walked = row * width + start, 0
        while walked < depth and flat[pixel] != label:
            pixel, walked = pixel + inward, walked + 1
        if walked < depth:
            inner = pixel + inward if walked + 1 < depth and flat[pixel + inward] == label else pixel
            number, x_sum, range_sum = number + 1, x_sum + x[inner], range_sum + range_m[inner]
    x_m, away_m, all_weights, all_depths, reach = x_sum / number, range_sum / number, 0.0, 0.0, 0
    while reach < room:
        shown, weight, deeper = 0, 0.0, 0.0
        for row in range(first, first + lines):
            other = row * width + start - (reach + 1) * inward
            above = limits[0] + (z[other] - limits[0]) * away_m / range_m[other] if range_m[other] > 0 else 0.0
            if _may_show(why[other], range_m[other], sigma_m[other], limits) and (
                why[other] == _OUTSIDE or _above_floor(away_m, above, limits[2] * sigma_m[other], limits)
            ):
                precision = 1 / max(sigma_m[other], _LEAST_M) ** 2
                shown, weight, deeper = shown + 1, weight + precision, deeper + precision * (x[other] - x_m)
        if 2 * shown < number or abs(deeper) > weight * limits[1] / 2 + 2 * math.sqrt(weight):
            break
        all_weights, all_depths, reach = all_weights + weight, all_depths + deeper, reach + 1
    return 0 if abs(all_depths) > all_weights * limits[1] / 4 + 2 * math.sqrt(all_weights) else reach


@kernel
def further(
    x: Any, ranges: Any, why: Any, pixel: int, inner: int, outward: int, most: int, above: float, limits: Any
) -> int:
    """Return how many pixels, at most, outwards of an outermost one show the same surface as `inner`; -1: unknown.

    above: z of the surface.
    """
    range_m, sigma_m = ranges
    more, other = 0, pixel + outward
    while more < most and _may_show(why[other], range_m[other], sigma_m[other], limits):
        noise = limits[2] * math.sqrt(sigma_m[inner] ** 2 + sigma_m[other] ** 2)
        if not abs(x[other] - x[inner]) <= limits[1] / 2 + noise:
            break
        if why[other] != _OUTSIDE and not _above_floor(range_m[inner], above, noise, limits):
            return -1
        more, other = more + 1, other + outward
    return more


@kernel(forceinline=True)
def _may_show(reason: int, range_m: float, sigma_m: float, limits: Any) -> bool:
    """Return whether a pixel that was refused measures a range, if the surface is outside the area or dim."""
    dim = (reason == _DIM or reason == _ISOLATED) and sigma_m <= limits[5]  # noqa: SIM109
    return bool((dim or reason == _OUTSIDE) and range_m > 0)


@kernel(forceinline=True)
def _above_floor(range_m: float, above: float, noise: float, limits: Any) -> bool:
    """Return whether the noise tells a surface, z above the floor, from the floor behind it on the same ray.

    A ray that goes down meets it by z over the rest of the height of the camera farther away.
    """
    return bool(above >= limits[0] or range_m * above > 2 * noise * (limits[0] - above))
