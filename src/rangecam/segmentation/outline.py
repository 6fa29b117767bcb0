"""What cuts a segment short: the edge of the image or of the area of interest, or something nearer in front of it."""

import math
from typing import Any

from rangecam.compiled import kernel
from rangecam.segmentation.beyond import end_of, further, reach_of
from rangecam.types import Cut, Why


@kernel
def cut_short(
    labels: Any, points: Any, planes: Any, box: Any, bounds: Any, limits: Any, cut: Any, ends: Any, further_m: Any
) -> None:
    """Write the bits of `Cut` of each segment: (N,) uint8, and where it ends at its sides: (N, 2) y in m; a kernel.

    planes: range, sigma, why (H, W); box (N, 4) of each segment, bounds (N, 6) of its points; limits: height of the
    camera (m), what `SegmentSettings.occluder_*` say, y of the camera, `dim_sigma_m`. The outline of a segment is the
    first and last of its pixels in each row and each column of its box. It touches an edge of the image where nothing,
    or only the discarded border, or one last pixel that measured nothing, lies beyond it. So it does where most of its
    left or right side goes on outside the area of interest, without a step in range that could hide the end of it. It
    is occluded where the first pixel beyond it that has a range (of at most three: flying pixels lie between) is nearer
    by more than a step and the noise; the part of the outline for which this holds must be more than a few stray
    pixels. The floor in front of an object is nearer too: a point below the lowest of the segment, on a ray that goes
    down, is no occluder. The ends are means over the rows. Where the same surface goes on beside the outermost pixel
    of a row (`beyond.further`), this counts as the outermost one, and the thing ends where the surface does: further_m
    (N, 2) is how much of it that is, in m.
    """
    height, width = labels.shape
    flat, why = labels.reshape(-1), planes[2].reshape(-1)
    x, y, z = points.reshape(-1)[::3], points.reshape(-1)[1::3], points.reshape(-1)[2::3]
    ranges = planes[0].reshape(-1), planes[1].reshape(-1)
    for k in range(len(box)):
        outline, occluded, bits, beside = 0, 0, 0, 0
        for side in range(4):  # left, right, top, bottom: the bits of Cut in their order
            across, from_end = side < 2, side % 2 == 1
            first, lines = (box[k, 0], box[k, 2] - box[k, 0]) if across else (box[k, 1], box[k, 3] - box[k, 1])
            start, depth = (box[k, 1], box[k, 3] - box[k, 1]) if across else (box[k, 0], box[k, 2] - box[k, 0])
            size, line_step, step = (width, width, 1) if across else (height, 1, width)
            start = start + depth - 1 if from_end else start
            room = size - 1 - start if from_end else start  # pixels between the box and the edge of the image
            inward = -step if from_end else step
            seen, hidden, goes_on, unclear, aside_m, more_m, reach = outline, occluded, 0, 0, 0.0, 0.0, 0
            if across and limits[5] > 0:
                reach = reach_of(
                    flat, k + 1, x, z, ranges, why, (first, lines, start, depth, width, inward, room), limits
                )
            for line in range(first, first + lines):
                pixel, walked = line * line_step + start * step, 0
                while walked < depth and flat[pixel] != k + 1:
                    pixel, walked = pixel + inward, walked + 1
                if walked < depth:
                    outline += 1
                    left, more = room + walked, 0
                    if across:
                        inner = pixel + inward if walked + 1 < depth and flat[pixel + inward] == k + 1 else pixel
                        end_m = end_of(y, ranges[0], pixel, inner, inner, limits[4])
                        aside_m += end_m
                        if limits[5] > 0:
                            more = further(x, ranges, why, pixel, inner, -inward, walked + reach, z[inner], limits)
                            unclear += more < 0
                        if more > 0:
                            pixel, left = pixel - more * inward, left - more
                            more_m += abs(end_of(y, ranges[0], pixel, pixel + inward, inner, limits[4]) - end_m)
                    beyond = why[pixel - inward] if left > 0 else _BORDER
                    unknown = beyond not in (0, _OUTSIDE, _FLOOR)
                    if beyond == _BORDER or (left == 1 and unknown):
                        bits |= 1 << side
                    elif across and beyond == _OUTSIDE and _goes_on(ranges, pixel, pixel - inward, limits):
                        goes_on += 1
                    else:
                        far = min(left, _FAR)
                        occluded += _hidden(flat, z, ranges, why, pixel, -inward, far, bounds[k, 2], limits)
            if across and 2 * (occluded - hidden) > outline - seen:
                beside |= _HIDDEN_RIGHT if from_end else _HIDDEN_LEFT
            if not across and occluded - hidden > max(1.0, limits[3] * (outline - seen)):
                beside |= _HIDDEN_UP
            if 2 * goes_on > outline - seen:
                bits |= 1 << side
            if across:
                open_end = bits & 1 << side != 0  # nobody sees where it ends
                further_m[k, side] = 0.0 if open_end else more_m / max(outline - seen - unclear, 1)
                ends[k, side] = aside_m / (outline - seen) + further_m[k, side] * (-1 if from_end else 1)
        cut[k] = bits | _OCCLUDED | beside if occluded > max(1.0, limits[3] * outline) else bits


_OCCLUDED, _HIDDEN_UP = int(Cut.OCCLUDED), int(Cut.HIDDEN_UP)
_HIDDEN_LEFT, _HIDDEN_RIGHT = int(Cut.HIDDEN_LEFT), int(Cut.HIDDEN_RIGHT)
_BORDER, _OUTSIDE, _FLOOR = int(Why.BORDER), int(Why.OUTSIDE_AREA), int(Why.FLOOR)
_FAR = 3  # pixels beyond the outline that are looked at


@kernel(forceinline=True)
def _goes_on(ranges: Any, pixel: int, other: int, limits: Any) -> bool:
    """Return whether two neighbouring pixels may show the same surface."""
    range_m, sigma_m = ranges
    noise = math.sqrt(sigma_m[pixel] ** 2 + sigma_m[other] ** 2)
    return bool(abs(range_m[pixel] - range_m[other]) <= limits[1] + limits[2] * noise)


@kernel(forceinline=True)
def _hidden(
    flat: Any, z: Any, ranges: Any, why: Any, pixel: int, outward: int, far: int, lowest: float, limits: Any
) -> bool:
    """Return whether the first of `far` pixels outwards of an outermost one that has a range is an occluder."""
    range_m, sigma_m = ranges
    other = pixel
    for _ in range(far):
        other += outward
        reason = why[other]
        if reason in (_FLOOR, _BORDER):
            return False
        if reason == 0 or reason == _OUTSIDE:
            difference = range_m[pixel] - range_m[other] - limits[1]
            if not difference > 0 or flat[pixel] == flat[other]:
                return False
            noise = math.sqrt(sigma_m[pixel] ** 2 + sigma_m[other] ** 2)
            return difference > limits[2] * noise and not (z[other] < lowest and z[pixel] < limits[0])
    return False
