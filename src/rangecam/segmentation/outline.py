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
            seen, hidden, goes_on, unclear = outline, occluded, 0, 0
            aside_m, more_m, weight, deeper = 0.0, 0.0, 0.0, 0.0
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
                            more, w, d = _further(x, ranges, why, pixel, inner, -inward, left, z[inner], limits)
                            weight, deeper, unclear = weight + w, deeper + d, unclear + (more < 0)
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
            if 2 * goes_on > outline - seen:
                bits |= 1 << side
            if across:
                # that of which no end is seen has none; and what is deeper is a flank, seen at a grazing angle
                flank = abs(deeper) > weight * limits[1] / 2 + limits[2] * math.sqrt(weight)
                none = flank or bits & 1 << side != 0
                further_m[k, side] = 0.0 if none else more_m / max(outline - seen - unclear, 1)
                ends[k, side] = aside_m / (outline - seen) + further_m[k, side] * (-1 if from_end else 1)
        cut[k] = bits | _OCCLUDED | beside if occluded > max(1.0, limits[3] * outline) else bits


_OCCLUDED, _HIDDEN_LEFT, _HIDDEN_RIGHT = int(Cut.OCCLUDED), int(Cut.HIDDEN_LEFT), int(Cut.HIDDEN_RIGHT)
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
def _further(
    x: Any, ranges: Any, why: Any, pixel: int, inner: int, outward: int, left: int, above: float, limits: Any
) -> tuple[int, float, float]:
    """Return how many pixels outwards of an outermost one show the same surface, as deep as `inner`; -1: unknown.

    They lie outside the area of interest, or are too dim to be used. And the sum of their weights, and of their
    weighted depths from `inner`. above: z of the surface. A ray that goes down and passes it sees the floor, by z over
    the rest of the height of the camera farther away: where the noise does not tell the two apart, nobody knows.
    """
    range_m, sigma_m = ranges
    floor_m = range_m[inner] * above / (limits[0] - above) if above < limits[0] else math.inf
    more, other, weight, depth = 0, pixel + outward, 0.0, 0.0
    while more < left:
        reason, sigma = why[other], sigma_m[other]
        dim = reason in (_DIM, _ISOLATED) and sigma <= limits[5]
        apart, noise = x[other] - x[inner], limits[2] * math.sqrt(sigma_m[inner] ** 2 + sigma**2)
        if not ((dim or reason == _OUTSIDE) and range_m[other] > 0 and abs(apart) <= limits[1] / 2 + noise):
            break
        if dim and not floor_m > 2 * noise:
            return -1, 0.0, 0.0
        precision = 1 / max(sigma, _LEAST_M) ** 2
        weight, depth = weight + precision, depth + precision * apart
        more, other = more + 1, other + outward
    return more, weight, depth


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
