"""What cuts a segment short: the edge of the image, or something nearer in front of it."""

import math
from typing import Any

from numba import njit

from rangecam.types import Cut, Why

_LEFT, _RIGHT, _TOP, _BOTTOM = int(Cut.LEFT), int(Cut.RIGHT), int(Cut.TOP), int(Cut.BOTTOM)
_OCCLUDED = int(Cut.OCCLUDED)
_EDGE, _NEARER, _NOTHING = 0, 1, 2
_BORDER, _OUTSIDE, _FLOOR = int(Why.BORDER), int(Why.OUTSIDE_AREA), int(Why.FLOOR)
_FAR = 3  # pixels beyond the outline that are looked at


@njit(cache=True, nogil=True)
def cut_short(labels: Any, points: Any, planes: Any, box: Any, bounds: Any, limits: Any, cut: Any) -> None:
    """Write the bits of `Cut` of each segment: (N,) uint8; a kernel.

    planes: range, sigma, why (H, W); box (N, 4) of each segment, bounds (N, 6) of its points; limits: height of the
    camera (m), what `SegmentSettings.occluder_*` say. The outline of a segment is the first and last of its pixels in
    each row and each column of its box. It touches an edge of the image where nothing, or only the discarded border,
    lies beyond it. It is occluded where the first pixel beyond it that has a range (of at most three: flying pixels lie
    between) is nearer by more than a step and the noise; the part of the outline for which this holds must be more than
    a few stray pixels. The floor in front of an object is nearer too: a point below the lowest of the segment, on a ray
    that goes down, is no occluder.
    """
    walks = (0, -1, _LEFT), (0, 1, _RIGHT), (-1, 0, _TOP), (1, 0, _BOTTOM)
    for k in range(len(box)):
        outline, occluded, bits = 0, 0, 0
        for down, right, edge in walks:
            rows, columns = box[k, 2] - box[k, 0], box[k, 3] - box[k, 1]
            lines, depth = (rows, columns) if down == 0 else (columns, rows)
            top = box[k, 0] if down <= 0 else box[k, 2] - 1
            left = box[k, 1] if right <= 0 else box[k, 3] - 1
            for line in range(lines):
                row, column = (top + line, left) if down == 0 else (top, left + line)
                walked = 0
                while walked < depth and labels[row, column] != k + 1:
                    row, column, walked = row - down, column - right, walked + 1
                if walked == depth:
                    continue
                outline += 1
                beyond = _beyond(labels, points, planes, (row, column), (down, right), bounds[k, 2], limits)
                if beyond == _EDGE:
                    bits |= edge
                elif beyond == _NEARER:
                    occluded += 1
        if occluded > max(1.0, limits[3] * outline):
            bits |= _OCCLUDED
        cut[k] = bits


@njit(cache=True, nogil=True)
def _beyond(labels: Any, points: Any, planes: Any, pixel: Any, step: Any, lowest: Any, limits: Any) -> int:
    """Return what lies beyond an outermost pixel: the edge of the image, something nearer, or nothing of the kind."""
    range_m, sigma_m, why = planes
    row, column = pixel
    height, width = why.shape
    for far in range(1, _FAR + 1):
        y, x = row + far * step[0], column + far * step[1]
        if not (0 <= y < height and 0 <= x < width) or why[y, x] == _BORDER:
            return _EDGE if far == 1 else _NOTHING
        reason = why[y, x]
        if reason == _FLOOR:
            return _NOTHING
        if reason == 0 or reason == _OUTSIDE:
            difference = range_m[row, column] - range_m[y, x] - limits[1]
            if not difference > 0 or labels[y, x] == labels[row, column]:
                return _NOTHING
            noise = math.sqrt(sigma_m[row, column] ** 2 + sigma_m[y, x] ** 2)
            floor = points[y, x, 2] < lowest and points[row, column, 2] < limits[0]
            return _NEARER if difference > limits[2] * noise and not floor else _NOTHING
    return _NOTHING
