"""The collisions of all tracks with the own vehicle: `look_ahead`."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from rangecam.collision.kernels import look
from rangecam.collision.points import gaussian_points
from rangecam.collision.settings import CorridorSettings
from rangecam.types import MEMORY, QUANTILES, Collisions, Ego, Floats, Tracks


class InPath(NamedTuple):
    """A confirmed track that is in the corridor or will be when it reaches us."""

    distance_m: float
    """Free way to its nearest surface."""
    speed_x_mps: float
    """Relative to us."""
    speed_sigma_mps: float
    n_pixels: float
    track_id: float
    class_index: float
    """Of the most probable of `CLASSES`."""
    distance_sigma_m: float
    covariance: float
    """Of distance and speed, m2/s."""
    acceleration_mps2: float
    """Along x, relative to us."""
    acceleration_sigma_mps2: float
    p_lateral: float
    """Probability that it hits us if it gets as far as our front."""
    ttc_s: float
    ttc_sigma_s: float
    p_collision: float
    hits: float
    """Frames in which it was seen."""
    age: float
    """Frames since its first, which counts."""


_COLUMNS = len(InPath._fields)
_POINTS = gaussian_points(64, 2), gaussian_points(256)
"""Of velocities, and of accelerations as well: one more direction to look into."""


def look_ahead(
    tracks: Tracks, ego: Ego, settings: CorridorSettings, min_probability: float
) -> tuple[Collisions, list[InPath]]:
    """Return the collision of every track with us (K-CLS-03, K-CLS-04), and the tracks in the path, nearest first.

    The nearest surface of the object lies d = x - near_offset_m - front_m ahead. It reaches us at the smallest
    positive root t of d + v t + a t^2 / 2 (König 2008, eq 6.49 corrected by E-K-24; the tracks' axes are fixed to the
    vehicle, so v and a are relative already). Where the path leads into a side or the rear of the outline first, the
    time is that of this contact. An object that overlaps our outline now collides at t = 0; one that lies behind our
    front and does not come to a side, never. In a turn the path bends with the yaw rate; where the own speed is
    unknown, as for a standing object.

    With distance and speed Gaussian, the surface has come by t with the probability Phi(-(d + v t) / s(t)),
    s(t)^2 = P_dd + 2 t P_dv + t^2 P_vv, and the quantiles are roots of (d + v t)^2 = z^2 s(t)^2. As t grows this tends
    to Phi(-v / s_v) < 1: with the rest of the probability it never comes, and quantiles beyond are infinite. With an
    acceleration they are those of 256 points of the distribution.

    p_collision: that the object touches our outline, both ends and sides included, within the horizon, from position,
    speed and width together: see `touch.p_contact`. Good to 0.02; 0 where one axis excludes it by 4 standard
    deviations.

    In the path: confirmed tracks, also while they coast through missed frames, that overlap the corridor now or will
    collide with at least `min_probability`, and are not behind our front. What is beside the corridor must have been
    seen to move into it (`crossing_sigmas`, `crossing_hits`), unless our own bend takes us to it.
    """
    n = tracks.status.size
    new, path = np.empty((_ROWS, n)), np.empty((n, _COLUMNS))
    turning = float(ego.yaw_rate_radps), math.nan if ego.speed_mps is None else float(ego.speed_mps)
    # fmt: off
    found = look(
        tracks.status, tracks.state, tracks.covariance, tracks.size_m, _width(tracks), tracks.near_offset_m,
        tracks.n_pixels, tracks.track_id, tracks.class_probability, tracks.hits, tracks.age, tracks.nis,
        _limits(settings), float(min_probability), *turning, _POINTS[settings.use_acceleration], _Z, new, path,
    )
    # fmt: on
    collisions = Collisions(new[0], new[1], new[2], new[3], new[7:].T, new[4].astype(np.int64), new[5], new[6])
    return collisions, [InPath(*row) for row in path[:found].tolist()]


def _width(tracks: Tracks) -> Floats:
    """Return the width (N,) m whose middle the position of each track is: without what is hidden."""
    memory = tracks.memory
    if memory is None or len(memory) != len(tracks.age):
        return tracks.size_m[:, 1]
    return memory[:, _PLACED]


_PLACED = MEMORY.index("placed_width")
_Z = ndtri(np.array(QUANTILES))
_ROWS = 7 + len(QUANTILES)


@lru_cache(maxsize=16)
def _limits(settings: CorridorSettings) -> Floats:
    """Return what the kernels are told by the settings, as one array: each further argument costs every frame."""
    s = settings
    radius_m = min(s.corner_radius_m, s.width_m / 2, s.length_m / 2)
    expected = s.horizon_s, float(s.use_acceleration), s.drift_mps**2, s.surface_sigma_m**2, s.size_sigma_m, s.lag_s
    crossing = s.crossing_sigmas, float(s.crossing_hits), s.crossing_share
    return np.array([s.width_m, s.length_m, s.front_m, radius_m, *expected, *crossing])
