"""What the tracker uses of a frame's segments, in the types that its kernels are compiled for."""

from typing import NamedTuple

import numpy as np

from rangecam.types import Floats, Ints, Segments


class Seen(NamedTuple):
    """Fields of `Segments`: label and n_pixels int64, the others float64."""

    label: Ints
    position_m: Floats
    covariance_m2: Floats
    size_m: Floats
    near_m: Floats
    n_pixels: Ints


def seen_in(segments: Segments) -> Seen:
    """Return what the tracker uses of the segments."""
    return Seen(
        np.asarray(segments.label, np.int64),
        np.asarray(segments.position_m, np.float64),
        np.asarray(segments.covariance_m2, np.float64),
        np.asarray(segments.size_m, np.float64),
        np.asarray(segments.near_m, np.float64),
        np.asarray(segments.n_pixels, np.int64),
    )
