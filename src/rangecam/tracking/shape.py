"""Whose segment is it, judged by width, height and fill (K-FUT-05)."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.tracking.association import NO_PAIR
from rangecam.tracking.living import describe
from rangecam.tracking.rules import Seen
from rangecam.tracking.sighting import ACROSS, UP
from rangecam.types import MEMORY, Floats, Ints, Tracks

SHAPE_SPREAD = 3
"""Column of a track's memory, and of `shapes`, where the variances of the three logarithms begin."""


def shapes(seen: Seen) -> Floats:
    """Return the shape (M, 7) of each segment: see `living.describe`."""
    shape = np.empty((len(seen[0]), 7))
    describe(seen[3], seen[5], *seen[6:11], shape)
    return shape


def first_memory(shape: Floats, sigma: float) -> Floats:
    """Return the memory (N, 12) of tracks that were seen once, with these shapes."""
    memory = np.zeros((len(shape), len(MEMORY)))
    memory[:, :SHAPE_SPREAD] = shape[:, :SHAPE_SPREAD]
    memory[:, SHAPE_SPREAD:6] = sigma**2 + shape[:, SHAPE_SPREAD:6]
    memory[:, MEMORY.index("reliability")] = shape[:, 6]
    memory[:, MEMORY.index("process_noise")] = 1.0
    memory[:, MEMORY.index("placed_width")] = np.exp(shape[:, 0])
    return memory


def memory_of(tracks: Tracks, sigma: float) -> Floats:
    """Return the memory of the tracks, made up from their sizes where they have none."""
    if tracks.memory is not None and len(tracks.memory) == len(tracks.age):
        return tracks.memory
    n = len(tracks.age)
    box = np.tile(np.array([0, 0, 1, 1]), (n, 1))
    range_m = np.linalg.norm(tracks.state[:, ::3], axis=1)
    shape, pixels = np.empty((n, 7)), np.maximum(np.rint(tracks.n_pixels), 1).astype(int)
    describe(
        np.asarray(tracks.size_m, float),
        pixels,
        box,
        range_m,
        np.ones(n),
        np.full(n, math.inf),
        np.zeros(n, np.uint8),
        shape,
    )
    return first_memory(shape, sigma)


def pair_shapes(cost: Floats, memory: Floats, shape: Floats, cut: Ints) -> Floats:
    """Return the costs (N, M) of the pairings with those of the shapes, where they are in the gate.

    Twice the negative logarithm of how much likelier a shape (M, 7) is among the track's own (its memory (N, 12)) than
    among any: each logarithm is normal about the track's mean, with its own running variance and that of the segment's
    pixels; those of other objects spread by a factor of e about it. So a shape counts as much as track and pixels let
    it: that of a few pixels hardly at all. Of what is cut short anything may be missing: that it is narrower, or lower,
    than the track speaks neither for the track nor against it.
    """
    together = np.empty_like(cost)
    _add_shapes(cost, memory, shape, cut, together)
    return together


@kernel
def _add_shapes(cost: Floats, memory: Floats, shape: Floats, cut: Ints, together: Floats) -> None:
    for i in range(cost.shape[0]):
        for j in range(cost.shape[1]):
            together[i, j] = cost[i, j]
            for a in range(SHAPE_SPREAD if cost[i, j] < NO_PAIR else 0):
                variance = memory[i, SHAPE_SPREAD + a] + shape[j, SHAPE_SPREAD + a]
                apart = memory[i, a] - shape[j, a]
                if a < 2 and cut[j] & (ACROSS if a == 0 else UP) != 0:
                    apart = min(apart, 0.0)
                together[i, j] += apart * apart / variance + math.log(variance)
