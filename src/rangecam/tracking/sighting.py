"""Where the segments say that whole objects are, and how surely, as loops over arrays that the caller made."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.types import MEMORY, Cut, Floats, Ints

ACROSS, UP = int(Cut.LEFT | Cut.RIGHT | Cut.OCCLUDED), int(Cut.TOP | Cut.BOTTOM | Cut.OCCLUDED)
"""What cuts an object short beside it, and above or below it."""
LEFT, RIGHT = int(Cut.LEFT | Cut.HIDDEN_LEFT), int(Cut.RIGHT | Cut.HIDDEN_RIGHT)
"""What cuts it short at one side."""
_SPREAD = MEMORY.index("log_width_variance")


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
    x: Floats, P: Floats, memory: Floats, seen: tuple[Floats, Floats, Ints], rules: Floats, R: Floats, z: Floats | None
) -> None:
    """Raise the covariances of what is cut short and may be part of a larger track, in place.

    seen: position, size, cut of the segments. Seen is w of a width W: the centre lies anywhere within (W - w) / 2 of
    what is seen. If z (M, 3) is given, it becomes the positions, and of what is cut at one side the centre of the
    whole: half of W from the end that is seen, as surely as W is known.
    """
    position, size, cut = seen
    if z is not None:
        for j in range(cut.size):
            for a in range(3):
                z[j, a] = position[j, a]
    for j in range(cut.size):
        for a in range(1, 3):
            if cut[j] & (ACROSS if a == 1 else UP) == 0:
                continue
            missing, spread = _missing(x, P, memory, position[j], R[j], size[j], a)
            if z is not None:  # noqa: SIM102 - Numba leaves it out where there is none
                if a == 1 and one_sided(cut[j]):
                    counted = rules[16] * size[j, 1] ** 2 if spread > 0 else 0.0  # by `complete`
                    _centre(z[j], R[j], cut[j], missing, spread / 4 - counted)
                    continue
            R[j, a, a] += rules[16] * missing**2


@kernel
def widen(
    z: Floats, R: Floats, width: Floats, cut: Ints, missing: Floats, log_variance: Floats, cut_variance: float
) -> None:
    """Let segments that are cut short be the visible parts of objects that are wider by `missing` (M,), in place.

    As `unseen` does where there is a track: log_variance (M,) is that of the logarithm of the whole width; cut_variance
    that of the centroid as a share of the squared width, where both sides are cut.
    """
    for j in range(cut.size):
        if missing[j] > 0:
            if one_sided(cut[j]):
                _centre(z[j], R[j], cut[j], missing[j], (width[j] + missing[j]) ** 2 * log_variance[j] / 4)
            else:
                R[j, 1, 1] += cut_variance * missing[j] ** 2


@kernel
def _centre(z: Floats, R: Floats, cut: int, missing: float, variance: float) -> None:
    """Put what is cut at one side to the centre of a whole that is so much wider, and add the variance, in place."""
    z[1] += missing / 2 if cut & LEFT != 0 else -missing / 2
    R[1, 1] += variance


@kernel
def one_sided(cut: int) -> bool:
    """Return whether one side of a segment is cut by the image or by something nearer, and the other is its own."""
    return bool((cut & LEFT != 0) != (cut & RIGHT != 0))


@kernel
def _missing(
    x: Floats, P: Floats, memory: Floats, position: Floats, R: Floats, size: Floats, a: int
) -> tuple[float, float]:
    """Return how much wider (a = 1) or higher (2) than a segment the widest track is that it may be part of.

    And the variance of that track's own width or height.
    """
    missing, spread = 0.0, 0.0
    for i in range(len(x)):
        whole = math.exp(memory[i, a - 1])
        reach = (whole + size[a]) / 2 + 2 * math.sqrt(P[i, 3 * a, 3 * a] + R[a, a])
        beside = abs(x[i, 3 * a] - position[a]) <= reach
        ahead = abs(x[i, 0] - position[0]) <= 0.5 + 2 * math.sqrt(P[i, 0, 0] + R[0, 0])
        if beside and ahead and whole - size[a] > missing:
            missing, spread = whole - size[a], whole**2 * memory[i, _SPREAD + a - 1]
    return missing, spread


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
