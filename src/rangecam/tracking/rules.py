"""What the kernels are told: which part of a step, by which rules, about which segments."""

import math
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from rangecam.tracking.settings import TrackingSettings
from rangecam.types import Floats, Ints

WHOLE, PAIRING, PAIRED = 0, 1, 2
"""What to do of a step: all, if nothing competes; up to the costs; all, with the pairing given."""
GONE = -1
"""In the place of a status: the track ends with this frame."""

RULES = (
    *("gate", "common", "extent", "time_variance", "weight", "vertical", "confirm_hits", "confirm_frames"),
    *("max_misses", "max_misses_vru", "max_misses_vehicle", "max_misses_obstacle", "max_variance"),
    *("euclidean", "adapt_s", "adapt_limit", "cut", "max_parts", "outline"),
    *("lasts_s", "end", "lateral", "new", "beside"),
)
"""What the kernels are told by the settings, as one array: largest squared distance, variance of every position, of the
centroid as a share of the squared size, of the time, weight of new shapes, share of the vertical Q, rules of life,
largest variance of a position; variance of a Euclidean distance, 0 for Mahalanobis'; adaptive process noise;
variance of the centroid of what is cut short, as a share of the squared size; frames in parts after which they are no
longer one; variance of the centroid as a share of that of the size; how long an error lasts; variance of an end; share
of the lateral Q; density of new objects; y beyond which a thing is placed by its near end."""

Seen = tuple[Ints, Floats, Floats, Floats, Floats, Ints, Ints, Floats, Floats, Floats, Ints, Floats]
"""label, position_m, covariance_m2, size_m, near_m, n_pixels, box, range_m, amplitude, sigma_range_m, cut and ends_m of
`Segments`: int64 and float64. One of no pixels is no segment, but what `groups` makes of one: it teaches neither shape
nor NIS."""


@lru_cache(maxsize=16)
def rules_of(settings: TrackingSettings) -> Floats:
    """Return `RULES` by the settings, once for all frames."""
    motion, misses = (
        settings.motion,
        (settings.max_misses_vru, settings.max_misses_vehicle, settings.max_misses_obstacle),
    )
    gate = gate_threshold(settings.gate_probability)
    euclidean = settings.euclidean_gate_m**2 / gate if settings.distance == "euclidean" else 0.0
    rules = {
        "gate": gate,
        "common": settings.position_sigma_m**2,
        "extent": settings.extent_sigma**2,
        "time_variance": settings.frame_time_sigma_s**2,
        "weight": settings.shape_weight,
        "vertical": motion.vertical_share**2,
        "confirm_hits": settings.confirm_hits,
        "confirm_frames": settings.confirm_frames,
        "max_misses": settings.max_misses,
        "max_misses_vru": settings.max_misses if misses[0] is None else misses[0],
        "max_misses_vehicle": settings.max_misses if misses[1] is None else misses[1],
        "max_misses_obstacle": settings.max_misses if misses[2] is None else misses[2],
        "max_variance": settings.max_position_sigma_m**2,
        "euclidean": euclidean,
        "adapt_s": motion.adapt_s,
        "adapt_limit": motion.adapt_limit,
        "cut": settings.cut_sigma**2,
        "max_parts": settings.max_parts_frames,
        "outline": settings.outline_sigma**2,
        "lasts_s": settings.position_lasts_s,
        "end": settings.end_sigma_m**2,
        "lateral": motion.lateral_share**2,
        "new": settings.new_density_per_m3,
        "beside": math.inf if settings.beside_m is None else settings.beside_m,
    }
    return np.array([float(rules[name]) for name in RULES])


def gate_threshold(probability: float) -> float:
    """Return the squared Mahalanobis distance within which a three-dimensional measurement lies with `probability`.

    The quantile of chi-square with three degrees of freedom (König 2008, appendix B); at most 1000 squared.
    """
    return min(float(chdtri(3, 1 - probability)), 1e6)
