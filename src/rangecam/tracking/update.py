"""One step of all tracks: `update_tracks`."""

import dataclasses
import math
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from rangecam.errors import DataError
from rangecam.motion import MOTION
from rangecam.tracking.association import ASSOCIATION
from rangecam.tracking.filter import predict_and_gate, update
from rangecam.tracking.life import age, initiate
from rangecam.tracking.seen import Seen, seen_in
from rangecam.tracking.settings import TrackingSettings
from rangecam.types import Floats, Segments, Tracks


def update_tracks(tracks: Tracks, segments: Segments, time_s: float, settings: TrackingSettings) -> Tracks:
    """Carry the tracks on to the frame of `time_s` and take its segments in (K-TRK, K-KAL).

    Predict (König 2008, fig 6.8) over the true time since the last frame (eq 6.12), gate by the Mahalanobis distance
    with the innovation covariance (eq 6.14 and E-K-20), associate, update, confirm, delete, and start a track for
    each segment left over. A missed track is only predicted (K-KAL-11). Two frames of one time are both used. A late
    frame leaves the tracks as they are; after a step back of the clock (`max_late_s`) all tracks are dropped, but
    their numbers are not used again. Segments whose position or covariance is not finite are ignored.

    Raises DataError if `time_s` is not finite.
    """
    if not math.isfinite(time_s):
        raise DataError(f"the frame's time is {time_s}; expected seconds on the camera's clock")
    dt_s = time_s - tracks.time_s if math.isfinite(tracks.time_s) else 0.0
    if dt_s < -settings.max_late_s:
        tracks, dt_s = dataclasses.replace(Tracks.empty(), next_id=tracks.next_id), 0.0
    elif dt_s < 0:
        return tracks
    seen = seen_in(segments)
    state, covariance, R, cost = _predict(tracks, seen, dt_s, settings)
    took = ASSOCIATION[settings.association](cost, tracks.age)
    nis = np.empty(len(tracks))
    update(state, covariance, took, (seen.position_m, R, settings.frame_time_sigma_s**2), nis)
    tracks = age(tracks, (state, covariance, nis), took, seen, time_s, settings)
    return initiate(tracks, took, seen, R, settings)


def _predict(tracks: Tracks, seen: Seen, dt_s: float, settings: TrackingSettings) -> tuple[Floats, ...]:
    """Return predicted states (N, 9) and covariances (N, 9, 9), R (M, 3, 3), and the cost of each pairing (N, M)."""
    n, m = len(tracks.track_id), len(seen.label)
    new = np.empty((n, 9)), np.empty((n, 9, 9)), np.empty((m, 3, 3)), np.empty((n, m))
    model = MOTION[settings.motion.model](dt_s, settings.motion)
    noise = settings.position_sigma_m**2, settings.extent_sigma**2, settings.frame_time_sigma_s**2
    measured = seen.position_m, seen.covariance_m2, seen.size_m
    predict_and_gate(
        (tracks.state, tracks.covariance), model, measured, noise, gate_threshold(settings.gate_probability), new
    )
    return new


@lru_cache(maxsize=16)
def gate_threshold(probability: float) -> float:
    """Return the squared Mahalanobis distance within which a three-dimensional measurement lies with `probability`.

    The quantile of chi-square with three degrees of freedom (König 2008, appendix B).
    """
    return float(chdtri(3, 1 - probability))
