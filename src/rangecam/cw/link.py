"""The parallel interface between sensor and processor, and its faults (S-PIF-01, S-EFF-15; Steinbäck 2016, A.1)."""

import numpy as np

from rangecam.cw.effects import Link
from rangecam.types import Image


def transfer(plane: Image, link: Link, rng: np.random.Generator) -> Image:
    """Return a plane (H, W) as it arrives over the interface; what is wrong follows from `rng` alone."""
    if link.bit_error_probability:
        plane = _with_bit_errors(plane, link, rng)
    if link.missed_clock_probability:
        plane = _with_missed_clocks(plane, link.missed_clock_probability, rng)
    return plane


def _with_bit_errors(plane: Image, link: Link, rng: np.random.Generator) -> Image:
    """Turn over bits of the nearest whole number; what a sample without rounding has beyond that stays."""
    count = rng.binomial(link.bits * plane.size, link.bit_error_probability)
    if count == 0:
        return plane
    places = rng.choice(link.bits * plane.size, count, replace=False, shuffle=False)
    turned = np.zeros(plane.size, np.int64)
    np.bitwise_xor.at(turned, places // link.bits, 1 << (places % link.bits))
    pixels = np.flatnonzero(turned)
    result = plane.copy()
    before = result.reshape(-1)[pixels]
    sent = np.clip(np.round(before), 0, 2**link.bits - 1).astype(np.int64)
    result.reshape(-1)[pixels] = (before + ((sent ^ turned[pixels]) - sent)).astype(plane.dtype)
    return result


def _with_missed_clocks(plane: Image, probability: float, rng: np.random.Generator) -> Image:
    """Move together to the left, in the rows concerned, the pixels whose clock edge was seen."""
    count = rng.binomial(plane.size, probability)
    if count == 0:
        return plane
    clocked = np.ones(plane.shape, bool)
    clocked.reshape(-1)[rng.choice(plane.size, count, replace=False, shuffle=False)] = False
    result = plane.copy()
    for row in np.flatnonzero(~clocked.all(axis=1)):
        seen = plane[row, clocked[row]]
        result[row, : len(seen)], result[row, len(seen) :] = seen, 0
    return result
