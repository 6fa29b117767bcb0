"""Where the segments say that whole objects are, and how surely, as loops over arrays that the caller made."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.types import MEMORY, Cut, Floats, Ints

ACROSS, UP = int(Cut.LEFT | Cut.RIGHT | Cut.OCCLUDED), int(Cut.TOP | Cut.BOTTOM | Cut.HIDDEN_UP)
"""What cuts an object short beside it, and above or below it."""
LEFT, RIGHT = int(Cut.LEFT | Cut.HIDDEN_LEFT), int(Cut.RIGHT | Cut.HIDDEN_RIGHT)
"""What cuts it short at one side."""
BESIDE = int(Cut.LEFT | Cut.RIGHT)
"""What leaves the image at a side, or comes into it."""
BETWEEN = int(Cut.HIDDEN_LEFT | Cut.HIDDEN_RIGHT)
"""What is seen between two nearer things."""
BOTH = 2.0
"""In the place of the side that is open: hidden on both sides by something nearer."""
_SPREAD, _PLACED, _SIDE = (MEMORY.index(name) for name in ("log_width_variance", "placed_width", "placed_side"))


@kernel
def complete(covariance: Floats, size: Floats, cut: Ints, rules: Floats, R: Floats) -> None:
    """Write the covariances of the positions, errors that the camera cannot know of included."""
    common, extent, unseen = rules[1] if rules[19] == 0 else 0.0, rules[2], rules[16]
    for j in range(size.shape[0]):
        across, up = cut[j] & ACROSS != 0, cut[j] & UP != 0
        for a in range(3):
            for b in range(3):
                R[j, a, b] = covariance[j, a, b]
            R[j, a, a] += common + extent * size[j, a] ** 2
            if (a == 2 and up) or (a < 2 and across):
                R[j, a, a] += unseen * size[j, a] ** 2


@kernel
def unseen(
    x: Floats, P: Floats, memory: Floats, seen: tuple[Floats, Floats, Ints], rules: Floats, R: Floats, by_ends: bool
) -> None:
    """Change the covariances of what is cut short and may be part of a larger track, in place.

    seen: position, size, cut of the segments. Seen is w of a width W: the centre lies anywhere within (W - w) / 2 of
    what is seen. by_ends: what is cut at one side is placed by its other end, see `ends`; and where the image ends
    beside it, the middle of its depth is as unknown as the share of its width that is missing: a thing ahead that is
    about to fill the image does not cease to close in.
    """
    position, size, cut = seen
    for j in range(cut.size):
        if by_ends and cut[j] & BESIDE != 0:
            R[j, 0, 0] -= rules[16] * size[j, 0] ** 2 * (1 - _share(x, P, memory, position[j], R[j], size[j]) ** 2)
        for a in range(1, 3):
            if cut[j] & (ACROSS if a == 1 else UP) != 0 and not (by_ends and a == 1 and one_sided(cut[j])):
                R[j, a, a] += rules[16] * _missing(x, P, memory, position[j], R[j], size[j], a) ** 2


@kernel
def ends(covariance: Floats, seen: tuple[Floats, Ints, Ints, Floats], rules: Floats, R: Floats) -> Floats:
    """Return for each segment that is open at one side where its other end is, the side that is open, the width seen.

    (M, 4): y, side (1 left, -1 right, 0: none), width, and as much of it as is sure by two standard deviations (ends
    that err by s each move the middle by s / sqrt(2) and change the width by twice as much), 0 of what is seen between
    two nearer things. seen: size, pixels, cut, `Segments.ends_m`; see `open_side`. What is open at one side says of its
    track where the other end is, as surely as that is known, which is written into R; how wide the track is beyond it,
    nothing says, and its position is that of the middle of the width that it has had so far (`placed_width`). So what
    comes into sight moves as its end does, not as its middle seems to. What is hidden on both sides has side 2, and in
    place of y the variance of the middle of what is seen: see `within`.
    """
    size, pixels, cut, sides = seen
    end = np.zeros((cut.size, 4))
    for j in range(cut.size):
        end[j, 2] = max(sides[j, 0] - sides[j, 1], 0.0) if pixels[j] > 0 else 0.0
        side = open_side(cut[j], sides[j, 0], sides[j, 1], rules[23]) if pixels[j] > 0 else 0.0
        if pixels[j] > 0 and not between(cut[j]):
            sure = 4 * covariance[j, 1, 1] + (rules[20] if side != 0 else 0.0)
            end[j, 3] = (end[j, 2] if side != 0 else size[j, 1]) - 2 * math.sqrt(sure)
        if side != 0:
            end[j, 0], end[j, 1] = sides[j, 1 if side > 0 else 0], side
            # an end errs twice as much as the middle of it and one that is sure
            R[j, 1, 1] += 3 * covariance[j, 1, 1] + rules[20]
            R[j, 1, 1] -= rules[16] * size[j, 1] ** 2 if one_sided(cut[j]) and cut[j] & ACROSS != 0 else 0.0
        elif between(cut[j]) and pixels[j] > 0:
            end[j, 0], end[j, 1] = covariance[j, 1, 1] + rules[16] * size[j, 1] ** 2, BOTH
            end[j, 2] = size[j, 1]
    return end


@kernel
def grows(end: Floats, memory: Floats, weight: float) -> float:
    """Return by how much the middle of a track moves because it is seen to be wider than it was placed by."""
    return end[1] * widened(end[2], memory[_PLACED], weight) / 2 if abs(end[1]) == 1 else 0.0


@kernel
def widened(seen: float, placed: float, weight: float) -> float:
    """Return by how much the width grows that a track is placed by, when it is seen to be so wide."""
    return weight * (seen - placed) if seen > placed else 0.0


@kernel
def emerged(end: Floats, memory: Floats, restless: float) -> float:
    """Return by how much y of a track is less known as it was placed by a piece of what is seen now.

    end (4,): of the segment, see `ends`; restless: variance by which the track's middle wanders. What is wider than the
    track was, by more than two standard deviations of how its ends err, has come into sight, pixel by pixel out of the
    noise or from behind something. One end may have moved alone, so that the middle of the piece was off by half of
    what it lacked: an error of where the track was said to be, and no way that it has gone since.
    """
    lacked: float = max(end[3] - 4 * math.sqrt(restless) - memory[_PLACED], 0.0)
    return lacked * lacked / 4


@kernel
def aside(end: Floats, memory: Floats, restless: float, weight: float) -> tuple[float, float, float]:
    """Return y of a track's middle by the end that its segment shows, how it wanders, and by how much y is less known.

    end (4,): of the segment, see `ends`; memory: of the track; restless: wander of its middle, which is not that of one
    end; weight: of the newest width. What is wider than it was before has come into sight, or the end that it is placed
    by errs; of what is restless one end may have moved alone, and the middle by half of what the width changed. Where
    it is another end than before, or the middle again, what is not known of its width moves it, but says nothing of its
    speed.
    """
    side, before, placed, y, wanders, less = end[1], memory[_SIDE], memory[_PLACED], math.nan, restless, 0.0
    if side == BOTH:
        side = 0.0
    if side != before:
        less = (side - before) ** 2 * placed**2 * memory[_SPREAD] / 4
    if side != 0:
        y = end[0] + side * placed / 2
        wanders = grows(end, memory, weight) ** 2
    elif restless > 0 and end[1] == 0 and end[2] > 0:
        wanders = max(restless, (end[2] - placed) ** 2 / 4)
    return y, wanders, less


@kernel
def within(x: Floats, P: Floats, less: float, end: Floats, memory: Floats, seen: float) -> tuple[float, float]:
    """Return what a sight between two nearer things says of the middle of a track: y and its variance.

    x, P: of the track, whose y is by `less` less known; seen: y of the middle of what is seen. Of a width W it shows w,
    so that the middle is within (W - w) / 2 of what is seen, and anywhere in there. That is no error that each frame
    has anew: while something moves on behind a gap, what is seen of it does not. So the track is told no more than
    that: the Gaussian cut off outside of it has a mean and a variance; returned is the measurement that would lead to
    them. A track that is well inside learns nothing.
    """
    whole = math.exp(memory[0])
    half = max((whole - end[2]) / 2, 0.0)
    sure = end[0] + whole**2 / 4 * memory[_SPREAD]
    prior = P[3, 3] + less + sure
    sigma = math.sqrt(prior)
    low, high = (seen - half - x[3]) / sigma, (seen + half - x[3]) / sigma
    if low > _OUTSIDE or high < -_OUTSIDE:
        return seen - half if low > 0 else seen + half, sure
    if high - low < _NARROW:
        mean, left = (low + high) / 2, (high - low) ** 2 / 12
    else:
        at_low, at_high = math.exp(-low * low / 2) / _ROOT, math.exp(-high * high / 2) / _ROOT
        share = (math.erf(high / math.sqrt(2)) - math.erf(low / math.sqrt(2))) / 2
        mean = (at_low - at_high) / share
        left = 1 + (low * at_low - high * at_high) / share - mean * mean
    lost = max(1 - left, 1e-9)
    return x[3] + sigma * mean / lost, sure + prior * (1 - lost) / lost


_OUTSIDE, _NARROW = 5.0, 0.1  # standard deviations
_ROOT = math.sqrt(2 * math.pi)


@kernel
def between(cut: int) -> bool:
    """Return whether both sides of a segment are hidden by something nearer."""
    return bool(cut & BETWEEN == BETWEEN)


@kernel
def open_side(cut: int, left: float, right: float, beside: float) -> float:
    """Return the side of a segment at which it may go on, or is of no interest: 1 left, -1 right, 0 none or both.

    left, right: y of its ends. It is the one that is cut, or the far one of what lies wholly beside our way, by more
    than `beside`: only the near end can meet us, and it is what is known best. Passing a thing, we see less and less of
    its far end, and the flank beside the near one more and more, so that its middle seems to come towards us.
    """
    if one_sided(cut):
        return 1.0 if cut & LEFT != 0 else -1.0
    if cut & (LEFT | RIGHT) != 0:
        return 0.0
    return 1.0 if right > beside else -1.0 if left < -beside else 0.0


@kernel
def one_sided(cut: int) -> bool:
    """Return whether one side of a segment is cut by the image or by something nearer, and the other is its own."""
    return bool((cut & LEFT != 0) != (cut & RIGHT != 0))


@kernel
def _missing(x: Floats, P: Floats, memory: Floats, position: Floats, R: Floats, size: Floats, a: int) -> float:
    """Return how much wider (a = 1) or higher (2) than a segment the widest track is that it may be part of."""
    missing = 0.0
    for i in range(len(x)):
        whole = math.exp(memory[i, a - 1])
        reach = (whole + size[a]) / 2 + 2 * math.sqrt(P[i, 3 * a, 3 * a] + R[a, a])
        beside = abs(x[i, 3 * a] - position[a]) <= reach
        ahead = abs(x[i, 0] - position[0]) <= 0.5 + 2 * math.sqrt(P[i, 0, 0] + R[0, 0])
        if beside and ahead:
            missing = max(missing, whole - size[a])
    return missing


@kernel
def _share(x: Floats, P: Floats, memory: Floats, position: Floats, R: Floats, size: Floats) -> float:
    """Return which share of the widest track a segment may lack that it may be part of; 1 if there is none."""
    widest = 0.0
    for i in range(len(x)):
        whole = math.exp(memory[i, 0])
        reach = (whole + size[1]) / 2 + 2 * math.sqrt(P[i, 3, 3] + R[1, 1])
        beside = abs(x[i, 3] - position[1]) <= reach
        ahead = abs(x[i, 0] - position[0]) <= 0.5 + 2 * math.sqrt(P[i, 0, 0] + R[0, 0])
        if beside and ahead:
            widest = max(widest, whole)
    return min(max(1 - size[1] / widest, 0.0), 1.0) if widest > 0 else 1.0


@kernel
def wander(memory: Floats, share: float) -> Floats:
    """Return the variances (N, 3) by which each track's centroid wanders as its outline changes, along each axis.

    The ends of an outline that err on their own by s each move the middle by s / sqrt(2) and change the width by
    s sqrt(2): the middle by half as much as the width. share: the square of that half.
    """
    variance = np.zeros((len(memory), 3))
    for i in range(len(memory) if share > 0 else 0):
        for a in range(2):
            variance[i, a + 1] = share * math.exp(2 * memory[i, a]) * memory[i, _SPREAD + a]
    return variance
