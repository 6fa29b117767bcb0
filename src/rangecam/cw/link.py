"""The parallel interface between sensor and processor, and its faults (S-PIF-01, S-EFF-15; Steinbäck 2016, A.1)."""

import numpy as np

from rangecam.cw.effects import Link
from rangecam.errors import UsageError
from rangecam.types import Image


def transfer(plane: Image, link: Link, bits: int, rng: np.random.Generator) -> Image:
    """Return a plane (H, W) as it arrives over the interface.

    bits: width of the data lines, each of which may be wrong. Raises UsageError if the samples are not whole numbers
    of a converter, of which alone single bits can be wrong.
    """
    if link.bit_error_probability:
        plane = _with_bit_errors(plane, link.bit_error_probability, bits, rng)
    if link.missed_clock_probability:
        plane = _with_missed_clocks(plane, link.missed_clock_probability, rng)
    return plane


def _with_bit_errors(plane: Image, probability: float, bits: int, rng: np.random.Generator) -> Image:
    if plane.dtype != np.uint16:
        raise UsageError(
            "camera.link.bit_error_probability: only whole numbers have bits; set quantisation_lsb, lower_limit_lsb "
            "and full_scale_lsb to those of a converter"
        )
    count = rng.binomial(bits * plane.size, probability)
    places = rng.choice(bits * plane.size, count, replace=False, shuffle=False)
    result = plane.ravel().copy()
    np.bitwise_xor.at(result, places // bits, (1 << (places % bits)).astype(np.uint16))
    return result.reshape(plane.shape)


def _with_missed_clocks(plane: Image, probability: float, rng: np.random.Generator) -> Image:
    """Keep the pixels whose clock edge was seen, moved together to the left of each row."""
    seen = rng.random(plane.shape, np.float32) >= probability
    result = np.zeros_like(plane)
    column = np.cumsum(seen, axis=1) - 1
    rows = np.broadcast_to(np.arange(len(plane))[:, None], plane.shape)
    result[rows[seen], column[seen]] = plane[seen]
    return result
