"""Other trackers on the same segments: norfair and Stone Soup, where they are installed."""

from collections.abc import Callable
from datetime import datetime, timedelta
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from rangecam.types import Floats, Segments

Seen = list[tuple[float, Segments]]
Tracked = list[tuple[list[int], Floats]]
"""Of each frame: numbers of the confirmed tracks, and their places (n, 2)."""


def norfair_tracks(frames: Seen) -> Tracked:
    """Return what norfair makes of the centroids: its own Kalman filter, pairs by Euclidean distance."""
    from norfair import Detection, Tracker

    tracker: Any = Tracker(
        distance_function="euclidean", distance_threshold=0.9, hit_counter_max=20, initialization_delay=3
    )
    result: Tracked = []
    for _, segments in frames:
        found = [Detection(points=place[None, :2].copy()) for place in segments.position_m]
        lives = [each for each in tracker.update(detections=found) if each.id is not None]
        result.append(([each.id for each in lives], np.array([each.estimate[0] for each in lives]).reshape(-1, 2)))
    return result


def stone_soup_tracks(frames: Seen) -> Tracked:
    """Return what Stone Soup makes of them: Kalman filter, global nearest neighbour by Mahalanobis distance."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    motion: Any = CombinedLinearGaussianTransitionModel([ConstantVelocity(1.0), ConstantVelocity(1.0)])
    noise: Any = LinearGaussian(4, (0, 2), np.eye(2) * 0.1**2)
    predictor: Any = KalmanPredictor(motion)
    updater: Any = KalmanUpdater(noise)
    pairing: Any = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4))
    deleter: Any = UpdateTimeStepsDeleter(20)
    prior: Any = GaussianState(np.zeros((4, 1)), np.diag([0.0, 2.25, 0.0, 2.25]))
    initiator: Any = MultiMeasurementInitiator(prior, deleter, pairing, updater, min_points=3)
    start, tracks, result = datetime(2008, 1, 1), set[Any](), list[Any]()
    numbers: dict[str, int] = {}
    for time_s, segments in frames:
        now = start + timedelta(seconds=time_s)
        found = {Detection(place[:2, None], timestamp=now, measurement_model=noise) for place in segments.position_m}
        left = set(found)
        for track, hypothesis in pairing.associate(tracks, found, now).items():
            if hypothesis:
                track.append(updater.update(hypothesis))
                left.discard(hypothesis.measurement)
            else:
                track.append(hypothesis.prediction)
        tracks -= deleter.delete_tracks(tracks)
        tracks |= initiator.initiate(left, now)
        lives = [(numbers.setdefault(track.id, len(numbers) + 1), track.state_vector) for track in tracks]
        places = np.array([[float(x[0, 0]), float(x[2, 0])] for _, x in lives]).reshape(-1, 2)
        result.append(([number for number, _ in lives], places))
    return result


class Peer(NamedTuple):
    """A tracker that is not ours: its package, what makes tracks of segments, and how many runs of a scene it gets."""

    package: str
    track: Callable[[Seen], Tracked]
    runs: int


PEERS = {
    "norfair": Peer("norfair", norfair_tracks, 3),
    "Stone Soup": Peer("stonesoup", stone_soup_tracks, 1),  # a hundred times as long as ours
}
"""Peers by name."""


def installed() -> dict[str, Peer]:
    """Return the peers that are installed."""
    return {name: peer for name, peer in PEERS.items() if find_spec(peer.package) is not None}
