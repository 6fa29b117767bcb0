"""Whose segment is it, judged by width, height and fill (K-FUT-05)."""

import math

import numpy as np

from rangecam.tracking.filter import Seen
from rangecam.tracking.living import describe
from rangecam.types import MEMORY, Floats, Ints, Tracks

SHAPE_SPREAD = 3
"""Column of a track's memory, and of `shapes`, where the variances of the three logarithms begin."""


def shapes(seen: Seen) -> Floats:
    """Return the shape (M, 7) of each segment: see `living.describe`."""
    shape = np.empty((len(seen[0]), 7))
    describe(seen[3], seen[5], *seen[6:], shape)
    return shape


def shape_cost(memory: Floats, shape: Floats) -> Floats:
    """Return what a shape adds to the cost of a pairing: memory (..., 11) of the track, shape (..., 7) of the segment.

    Twice the negative logarithm of how much likelier it is among the track's own shapes than among any: each logarithm
    is normal about the track's mean, with its own running variance and that of the segment's pixels; those of other
    objects spread by a factor of e about it. So a shape counts as much as track and pixels let it: that of a few pixels
    hardly at all.
    """
    variance = memory[..., SHAPE_SPREAD:6] + shape[..., SHAPE_SPREAD:6]
    apart = memory[..., :SHAPE_SPREAD] - shape[..., :SHAPE_SPREAD]
    cost: Floats = (apart**2 / variance + np.log(variance)).sum(axis=-1)
    return cost


def first_memory(shape: Floats, sigma: float) -> Floats:
    """Return the memory (N, 11) of tracks that were seen once, with these shapes."""
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


def pair_shapes(cost: Floats, memory: Floats, shape: Floats, inside: tuple[Ints, Ints]) -> Floats:
    """Return the costs (N, M) of the pairings with those of the shapes, where they are in the gate."""
    rows, columns = inside
    together = cost.copy()
    together[rows, columns] += shape_cost(memory[rows], shape[columns])
    return together
