"""How far a segment may slide along a surface that goes on at its ends: its middle is that of no thing."""

import math
from typing import Any

from numba import njit

from rangecam.types import Why

_ISOLATED = int(Why.ISOLATED)


@njit(cache=True, nogil=True)
def slides(labels: Any, points: Any, planes: Any, sums: Any, box: Any, limits: Any, slide: Any) -> None:
    """Write by how much the middle of each segment may be off along its surface: (N, 2) x and y in m; a kernel.

    planes: range, sigma, why (H, W); sums (N, 10) of the points, see `measure`; limits: `occluder_step_m` and
    `occluder_sigmas` of `SegmentSettings`. What is grown by range ends where that is too far from its mean: a rail, or
    a wall at a grazing angle, falls into pieces, and where they end is chance. A piece of the length L that may lie
    anywhere along the surface is off by L / sqrt(12) along x, the standard deviation of its points, and across by as
    much as the surface runs aside meanwhile: the regression of y over x. Where it goes on at one side only, one end
    alone is chance, and the middle is off by half of that.
    """
    for k in range(len(box)):
        number = sums[k, 0]
        x, y = sums[k, 1] / number, sums[k, 2] / number
        apart = sums[k, 4] / number - x * x
        spread = apart - sums[k, 8] / number  # without the noise
        slide[k, 0], slide[k, 1] = 0.0, 0.0
        if not spread > limits[0] ** 2:
            continue
        goes_on, depth = 0, (sums[k, 7] / number, math.sqrt(spread))
        for side in range(2):
            goes_on += _goes_on(labels, planes, k + 1, box[k], side, depth, limits)
        if goes_on > 0:
            together = 0.0
            for row in range(box[k, 0], box[k, 2]):
                for column in range(box[k, 1], box[k, 3]):
                    if labels[row, column] == k + 1:
                        together += (points[row, column, 0] - x) * (points[row, column, 1] - y)
            slide[k, 0] = math.sqrt(spread) * goes_on / 2
            slide[k, 1] = slide[k, 0] * together / number / apart


@njit(cache=True, nogil=True)
def _goes_on(labels: Any, planes: Any, label: int, box: Any, side: int, depth: Any, limits: Any) -> bool:
    """Return whether the surface of a segment goes on beyond its left (0) or right (1) side, in most of its rows.

    depth: mean range and standard deviation of the depth. So it does where the next pixel is not its own, measures a
    range of the same surface, and is farther from the mean than that deviation: at an end in depth, not aside.
    """
    range_m, sigma_m, why = planes
    outward = -1 if side == 0 else 1
    lines, count = 0, 0
    for row in range(box[0], box[2]):
        column = box[1] if side == 0 else box[3] - 1
        while box[1] <= column < box[3] and labels[row, column] != label:
            column -= outward
        if not box[1] <= column < box[3]:
            continue
        lines, other = lines + 1, column + outward
        if not 0 <= other < labels.shape[1] or (why[row, other] != 0 and why[row, other] != _ISOLATED):
            continue
        noise = math.sqrt(sigma_m[row, column] ** 2 + sigma_m[row, other] ** 2)
        same = abs(range_m[row, other] - range_m[row, column]) <= limits[0] + limits[1] * noise
        count += same and abs(range_m[row, other] - depth[0]) > depth[1]
    return 2 * count > lines
