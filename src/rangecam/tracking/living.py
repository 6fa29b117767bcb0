"""Age, shape and end of all tracks after their update, as loops over arrays that the caller made.

One kernel for one motion model and for several: it knows states only by their variance.
"""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.tracking.filter import largest
from rangecam.tracking.rules import GONE
from rangecam.tracking.sighting import ACROSS, UP, between, open_side, widened
from rangecam.types import MEMORY, Floats, Ints, TrackStatus

_TENTATIVE, _CONFIRMED, _COASTING = (int(s) for s in TrackStatus)
_RELIABILITY, _NOISE, _PLACED, _SIDE, _GROUP, _PARTS = (MEMORY.index(name) for name in MEMORY[6:])


Before = tuple[Ints, Ints, Ints, Ints, Floats, Floats, Floats, Floats, Floats]
"""Of the tracks: status, age, hits, misses, size_m, near_offset_m, n_pixels, class_probability, memory."""
_Shown = tuple[Ints, Floats, Floats, Floats, Ints, Ints, Floats, Floats, Floats, Ints, Floats]
"""`Seen` without the covariances."""


@kernel
def live(
    before: Before,
    seen: _Shown,
    covariance: Floats,
    rules: Floats,
    dt_s: float,
    took: Ints,
    motion: tuple[Floats, Floats, Floats],
    new: tuple[Ints, Floats, Floats, Floats],
) -> tuple[bool, int, int, int, int]:
    """Age the tracks and take the shapes of their segments in.

    covariance (M, 3, 3): of the segments; took (N,): the segment of each track; motion: states (N, 9) before and after
    the update, P (N, 9, 9) after it; rules: `RULES`. Written, in `new`: counts (5, N): status (`GONE` for the end),
    age, hits, misses, label of the segment; means (3, N): near_offset, n_pixels, and NIS, which is there already;
    size (N, 3), memory.

    Return that this is done, how many tracks end, how many finite segments are left over, how many tracks that are not
    tentative took none, how many segments are not finite.
    """
    status, age, hits, misses, size, near_offset, n_pixels, class_probability, memory = before
    counts, means, new_size, new_memory = new
    _reshape(took, (size, near_offset, n_pixels, memory), seen, rules, (counts[4], new_size, means, new_memory))
    _expect(took, seen[4], motion[0], motion[1], means[1])
    _adapt(means[2], dt_s, rules, new_memory)
    ended = _count(took, seen[4], (status, age, hits, misses, class_probability), motion[2], rules, counts)
    position = seen[1]
    left, taken, lost = left_over(took, position, covariance, seen[2], np.empty(len(position), np.int64)), 0, 0
    for i in range(took.size):
        if took[i] >= 0:
            taken += 1
        elif status[i] != _TENTATIVE:
            lost += 1
    return True, ended, left, lost, len(position) - left - taken


@kernel
def _count(
    took: Ints,
    pixels: Ints,
    old: tuple[Ints, Ints, Ints, Ints, Floats],
    covariance: Floats,
    rules: Floats,
    new: Ints,
) -> int:
    """Write the new status (`GONE` for the end), age, hits and misses; return how many tracks end.

    One seen only together with others coasts, but was seen, and is not missed. How long others coast is a matter of
    their class.
    """
    confirm_hits, confirm_frames, max_variance = rules[6], rules[7], rules[12]
    gone = 0
    for i in range(took.size):
        hit = 1 if took[i] >= 0 and pixels[took[i]] > 0 else 0
        together = took[i] >= 0 and hit == 0
        age, hits = old[1][i] + 1, old[2][i] + (1 if together else hit)
        misses = 0 if hit else old[3][i] + (0 if together else 1)
        if old[0][i] != _TENTATIVE:
            fate = _CONFIRMED if hit else _COASTING
            if fate == _COASTING and misses > rules[8 + largest(old[4][i])]:
                fate = GONE
        elif hits >= confirm_hits:
            fate = _CONFIRMED
        else:  # can it still be seen often enough within its first frames?
            fate = _TENTATIVE if confirm_hits - hits <= confirm_frames - age else GONE
        for a in (0, 3, 6):
            if not covariance[i, a, a] <= max_variance:
                fate = GONE
        new[0, i], new[1, i], new[2, i], new[3, i] = fate, age, hits, misses
        gone += fate == GONE
    return gone


@kernel
def _expect(took: Ints, pixels: Ints, before: Floats, after: Floats, n_pixels: Floats) -> None:
    """Let the pixels of tracks that were not seen alone be those that they would have where they are now, in place."""
    for i in range(took.size):
        if took[i] < 0 or pixels[took[i]] == 0:
            was, now = 0.0, 0.0
            for a in (0, 3, 6):
                was, now = was + before[i, a] ** 2, now + after[i, a] ** 2
            if 0 < now < math.inf and was < math.inf:
                n_pixels[i] *= min(max(was / now, 0.5), 2.0)


@kernel
def _adapt(nis: Floats, T: float, rules: Floats, memory: Floats) -> None:
    """Let each track's process noise follow its innovations (K-FUT-08), in place.

    d log(factor) = (NIS / 3 - 1) dt / adapt_s: it stands still where the innovations are as large as their covariance
    says, whatever the frame rate; after long gaps as one measurement may move it, 1 - exp(-dt / adapt_s).
    """
    if rules[14] > 0:
        gain, limit = -math.expm1(-T / rules[14]), rules[15]
        for i in range(nis.size):
            if math.isfinite(nis[i]):
                factor = memory[i, _NOISE] * math.exp(gain * min(nis[i] / 3 - 1, 10.0))
                memory[i, _NOISE] = min(max(factor, 1 / limit), limit)


@kernel
def _reshape(
    took: Ints,
    old: tuple[Floats, Floats, Floats, Floats],
    seen: _Shown,
    rules: Floats,
    new: tuple[Ints, Floats, Floats, Floats],
) -> None:
    """Write the label of the segment each track took, and the running means of size, nearest point, pixels, shape.

    What is cut short says only how large the object is at least. While tracks compete, the counts of frames in parts
    stay of those that are no longer one.
    """
    weight, max_parts = rules[4], rules[17]
    label, position, size, near, pixels, box, range_m, amplitude, sigma, cut, sides = seen
    new_label, new_size, means, memory = new
    shape = np.empty((len(label), 7))
    describe(size, pixels, box, range_m, amplitude, sigma, cut, shape)
    for i in range(took.size):
        j = took[i]
        new_label[i], means[0, i], means[1, i] = label[j] if j >= 0 else 0, old[1][i], old[2][i]
        for a in range(3):
            new_size[i, a] = old[0][i, a]
        for a in range(_GROUP):
            memory[i, a] = old[3][i, a]
        memory[i, _GROUP], memory[i, _PARTS] = 0.0, old[3][i, _PARTS] if old[3][i, _PARTS] >= max_parts else 0.0
        if j >= 0 and pixels[j] > 0:
            means[0, i] += weight * (position[j, 0] - near[j] - old[1][i])
            means[1, i] += weight * (pixels[j] - old[2][i])
            memory[i, _RELIABILITY] += weight * (shape[j, 6] - memory[i, _RELIABILITY])
            for a in range(3):
                short = cut[j] & (UP if a == 2 else ACROSS) != 0 and a > 0
                if not short or size[j, a] > old[0][i, a]:
                    new_size[i, a] += weight * (size[j, a] - old[0][i, a])
            memory[i, _SIDE] = open_side(cut[j], sides[j, 0], sides[j, 1], rules[23])
            if memory[i, _SIDE] != 0:
                memory[i, _PLACED] += widened(sides[j, 0] - sides[j, 1], memory[i, _PLACED], weight)
            elif not between(cut[j]):
                memory[i, _PLACED] += weight * (size[j, 1] - memory[i, _PLACED])
            for a in range(3):
                apart = shape[j, a] - memory[i, a]
                short = cut[j] & (ACROSS if a == 0 else UP if a == 1 else ACROSS | UP) != 0
                if not short or (a < 2 and apart > 0):
                    memory[i, a] += weight * apart
                if not short:
                    memory[i, 3 + a] += weight * (apart * apart - memory[i, 3 + a])


@kernel
def describe(
    size: Floats,
    pixels: Ints,
    box: Ints,
    range_m: Floats,
    amplitude: Floats,
    sigma: Floats,
    cut: Ints,
    shape: Floats,
) -> None:
    """Write the shape of each segment (M, 7): logarithms of width, height and fill, their variances, reliability.

    Fill is pixels times squared range over width and height: what the pixels tell beside width and height. The
    variances are those of pixels: each edge lies anywhere in its pixel (1/12 of its square), and each pixel of the
    outline is in or out. Of what is cut short, anything up to as much as is seen may be missing.
    """
    for j in range(len(shape)):
        width, height, n = _at_least(size[j, 1], 1e-3), _at_least(size[j, 2], 1e-3), max(pixels[j], 1)
        rows, columns = max(box[j, 2] - box[j, 0], 1), max(box[j, 3] - box[j, 1], 1)
        shape[j, 0], shape[j, 1] = math.log(width), math.log(height)
        shape[j, 2] = math.log(n * _at_least(range_m[j], 1e-3) ** 2 / (width * height))
        shape[j, 3], shape[j, 4] = 1 / (6 * columns**2), 1 / (6 * rows**2)
        shape[j, 3] += _CUT_SHORT if cut[j] & ACROSS else 0.0
        shape[j, 4] += _CUT_SHORT if cut[j] & UP else 0.0
        shape[j, 5] = shape[j, 3] + shape[j, 4] + (rows + columns) / (2 * n**2)
        shape[j, 6] = _at_least(amplitude[j], 0.0) / sigma[j] if sigma[j] > 0 else 0.0


_CUT_SHORT = 2 * math.log(2) ** 2 - 4 * math.log(2) + 2
"""Mean square of log(1 + u) for u evenly between 0 and 1."""


@kernel
def _at_least(value: float, least: float) -> float:
    return value if least < value < 1e9 else least  # not so if it is not a number


@kernel
def left_over(took: Ints, position: Floats, covariance: Floats, size: Floats, first: Ints) -> int:
    """Write the indices of the finite segments that no track took into the first of `first`; return how many."""
    n = 0
    taken = np.zeros(first.size, np.bool_)
    for i in range(took.size):
        if took[i] >= 0:
            taken[took[i]] = True
    for j in range(first.size):
        total = 0.0
        for a in range(3):
            total += position[j, a] + covariance[j, a, 0] + covariance[j, a, 1] + covariance[j, a, 2] + size[j, a]
        if math.isfinite(total) and not taken[j]:
            first[n] = j
            n += 1
    return n
