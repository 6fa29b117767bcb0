"""Who is who in a crowd: people who hide each other, merge and part, beside nearest-neighbour tracking and peers.

All see the same segments. Gate, distance, patience (frames without a segment) and noise of each were chosen on twenty
runs and more of each scene, from other random numbers than those of the study, for the fewest switches, over small
grids.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rangecam.metrics.scores import Moment, clear_mot, gospa, hota, moment
from rangecam.motion import MotionSettings
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.tracking_crowds_peers import PEERS, Seen, Tracked, installed
from rangecam.studies.tracking_crowds_scene import CROWDS, Bodies, seen_of
from rangecam.tracking import TrackingSettings, update_tracks
from rangecam.types import Cut, Tracks, TrackStatus

_WALKING = MotionSettings(model="constant_velocity", velocity_drift_mps=0.3, vertical_share=0.2)
_OURS = TrackingSettings(
    motion=_WALKING, gate_probability=1 - 1e-7, detection_probability=0.8, speed_sigma_mps=1.0, position_sigma_m=0.02,
    shape_sigma=0.15, cut_width_m=0.5, max_misses=80, new_density_per_m3=0.05,
)  # fmt: skip
_NEAREST = TrackingSettings(
    motion=_WALKING, gate_probability=1 - 1e-7, speed_sigma_mps=1.5, association="greedy", use_shape=False,
    recognise_merges=False, cut_sigma=0.0, max_misses=30,
)  # fmt: skip
WAYS = {
    "rangecam": _OURS,
    "nearest": replace(_NEAREST, distance="euclidean", euclidean_gate_m=1.2),
    "nearest, noise chosen": replace(_NEAREST, position_sigma_m=0.2),
    "nearest, told of what is cut": replace(
        _NEAREST, motion=replace(_WALKING, velocity_drift_mps=1.0), cut_sigma=_OURS.cut_sigma
    ),
}
"""Settings by name; nearest: the nearest pair first, without shape, merges and splits. It believes the covariances of
the segments (noise chosen: and 0.2 m more; told: and more where something is cut short). Where the middle of somebody
is of whom one side is hidden, only their width tells: those without shape do not know which side that is."""
_SIDES = ~np.uint8(Cut.HIDDEN_LEFT | Cut.HIDDEN_RIGHT)
_RUNS, _LIMIT_M = 12, 1.0
_WHY = (
    "at least 5 is asked, surely, that is by one standard deviation of the counts; where twelve hide each other, some "
    "are taken for others who are hidden before anybody knows how fast they go, or turn round unseen"
)


class Score(NamedTuple):
    """Identity switches a run, means of GOSPA (m) and HOTA, and the number of runs."""

    switches: float
    gospa_m: float
    hota: float
    runs: int


def tracking_crowds(rng: np.random.Generator) -> Study:
    """Identities in a crowd, of people who meet and part, pass close, and walk behind a pole; beside peers."""
    theirs, claims, panels = installed(), list[Claim](), list[Panel]()
    ways: dict[str, tuple[Callable[[Seen], Tracked], int]] = {
        name: (partial(tracked, settings=settings), _RUNS) for name, settings in WAYS.items()
    }
    ways |= {name: (peer.track, peer.runs) for name, peer in theirs.items()}
    switches = dict.fromkeys(ways, 0.0)
    for scene, make in CROWDS.items():
        cases = [_case(make(rng), rng) for _ in range(_RUNS)]
        for name, (track, runs) in ways.items():
            score = _score(cases[:runs], [track(frames) for _, frames in cases[:runs]])
            switches[name] += score.switches
            of = f"{scene}, {name}"
            claims.append(derived("K-FUT-06", f"{of}: identity switches a run, of {runs}", score.switches, ""))
            claims.append(derived("K-FUT-06", f"{of}: GOSPA", score.gospa_m, "m"))
            claims.append(derived("K-FUT-06", f"{of}: HOTA", score.hota, ""))
        way = cases[0][0].place_m[:, cases[0][0].walks]
        shown = [Series("", way[:, k, 0], way[:, k, 1]) for k in range(way.shape[1])]
        panels.append(Panel(scene, "x / m", "y / m", shown))
    claims += _compared(switches)
    for name in sorted(PEERS.keys() - theirs.keys()):
        text = f"{name}: compared runs (pip install --no-deps {PEERS[name].package})"
        claims.append(derived("K-FUT-06", text, 0, ""))
    return Study("tracking-crowds", "König 2008, 6.4.2 and 8", claims, panels)


def _compared(switches: dict[str, float]) -> list[Claim]:
    """Return the claims about all scenes: switches of each way, and those of others over ours."""
    claims, ours = list[Claim](), max(switches["rangecam"], 1 / _RUNS)
    for name, count in switches.items():
        claims.append(derived("K-FUT-06", f"all scenes, {name}: identity switches in a run of each", count, ""))
        ratio, text = count / ours, f"all scenes: switches of {name} over ours"
        if name.startswith("nearest"):
            sigma = ratio * math.sqrt(1 / (ours * _RUNS) + 1 / max(count * _RUNS, 1))
            claims.append(judged("K-FUT-06", text, None, ratio, "", ratio - sigma >= 5, _WHY))
            claims.append(derived("K-FUT-06", "... its standard deviation", sigma, ""))
        elif name != "rangecam":
            claims.append(derived("K-FUT-06", text, ratio, ""))
    return claims


def _case(bodies: Bodies, rng: np.random.Generator) -> tuple[Bodies, Seen]:
    return bodies, [(float(t), seen_of(bodies, k, rng)) for k, t in enumerate(bodies.time_s)]


def tracked(frames: Seen, settings: TrackingSettings) -> Tracked:
    """Return numbers and places of the confirmed tracks of each frame."""
    tracks, result = Tracks.empty(), list[tuple[list[int], np.ndarray]]()
    for time_s, segments in frames:
        if not settings.use_shape:
            segments = replace(segments, cut=segments.cut & _SIDES)
        tracks = update_tracks(tracks, segments, time_s, settings)
        lives = tracks.status != TrackStatus.TENTATIVE
        result.append((tracks.track_id[lives].tolist(), tracks.state[lives][:, [0, 3]]))
    return result


def _score(cases: list[tuple[Bodies, Seen]], results: list[Tracked]) -> Score:
    runs = [_moments(bodies, result) for (bodies, _), result in zip(cases, results, strict=True)]
    switches = sum(clear_mot(run, _LIMIT_M).switches for run in runs) / len(runs)
    mean = float(np.mean([gospa(frame, _LIMIT_M).total for run in runs for frame in run]))
    return Score(switches, mean, float(np.mean([hota(run, _LIMIT_M).hota for run in runs])), len(runs))


def _moments(bodies: Bodies, result: Tracked) -> list[Moment]:
    truth = np.arange(len(bodies.width_m))
    return [moment(truth, place, *found) for place, found in zip(bodies.place_m, result, strict=True)]
