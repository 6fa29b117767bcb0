"""What cuts a segment short: the edge of the image or of the area of interest, or something nearer in front of it."""

import math
from typing import Any

from numba import njit

from rangecam.types import Cut, Why


@njit(cache=True, nogil=True)
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
    of a row (`_further`), this counts as the outermost one, and the thing ends where the surface does: further_m (N, 2)
    is how much of it that is, in m.
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
                reach = _reach(
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
                        end_m = _end(y, ranges[0], pixel, inner, limits[4])
                        aside_m += end_m
                        if limits[5] > 0:
                            more = _further(x, ranges, why, pixel, inner, -inward, walked + reach, z[inner], limits)
                            unclear += more < 0
                        if more > 0:
                            pixel, left = pixel - more * inward, left - more
                            more_m += abs(_far_end(y, ranges[0], pixel, pixel + inward, inner, limits[4]) - end_m)
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
_DIM, _ISOLATED = int(Why.LOW_AMPLITUDE), int(Why.ISOLATED)
_LEAST_M = 1e-3  # standard deviation of a range
_FAR = 3  # pixels beyond the outline that are looked at


@njit(cache=True, nogil=True, forceinline=True)
def _end(y: Any, range_m: Any, outer: int, inner: int, camera_y: float) -> float:
    """Return y of the end of a row in the direction of its last pixel and half of one more, as far as the one before.

    The last pixel sees something else as well, so that its own range is of neither.
    """
    there = camera_y + (y[outer] - camera_y) * range_m[inner] / range_m[outer]
    return float(there + (there - y[inner]) / 2)


@njit(cache=True, nogil=True)
def _reach(flat: Any, label: int, x: Any, z: Any, ranges: Any, why: Any, side: Any, limits: Any) -> int:
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


@njit(cache=True, nogil=True, forceinline=True)
def _may_show(reason: int, range_m: float, sigma_m: float, limits: Any) -> bool:
    """Return whether a pixel that was refused measures a range, if the surface is outside the area or dim."""
    dim = (reason == _DIM or reason == _ISOLATED) and sigma_m <= limits[5]  # noqa: SIM109
    return bool((dim or reason == _OUTSIDE) and range_m > 0)


@njit(cache=True, nogil=True, forceinline=True)
def _above_floor(range_m: float, above: float, noise: float, limits: Any) -> bool:
    """Return whether the noise tells a surface, z above the floor, from the floor behind it on the same ray.

    A ray that goes down meets it by z over the rest of the height of the camera farther away.
    """
    return bool(above >= limits[0] or range_m * above > 2 * noise * (limits[0] - above))


@njit(cache=True, nogil=True)
def _further(
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


@njit(cache=True, nogil=True, forceinline=True)
def _far_end(y: Any, range_m: Any, outer: int, beside: int, inner: int, camera_y: float) -> float:
    """Return `_end` of a row in the direction of two pixels whose own ranges may be noisy, as far away as `inner`."""
    there = camera_y + (y[outer] - camera_y) * range_m[inner] / range_m[outer]
    here = camera_y + (y[beside] - camera_y) * range_m[inner] / range_m[beside]
    return float(there + (there - here) / 2)


@njit(cache=True, nogil=True, forceinline=True)
def _goes_on(ranges: Any, pixel: int, other: int, limits: Any) -> bool:
    """Return whether two neighbouring pixels may show the same surface."""
    range_m, sigma_m = ranges
    noise = math.sqrt(sigma_m[pixel] ** 2 + sigma_m[other] ** 2)
    return bool(abs(range_m[pixel] - range_m[other]) <= limits[1] + limits[2] * noise)


@njit(cache=True, nogil=True, forceinline=True)
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
