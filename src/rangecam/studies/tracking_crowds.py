"""Who is who in a crowd: people who hide each other, merge and part, beside nearest-neighbour tracking and peers."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rangecam.metrics.scores import Moment, clear_mot, gospa, hota, moment
from rangecam.motion import MotionSettings
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.tracking_crowds_peers import PEERS, Seen, Tracked, installed
from rangecam.studies.tracking_crowds_scene import CROWDS, Bodies, seen_of
from rangecam.tracking import TrackingSettings, update_tracks
from rangecam.types import Tracks, TrackStatus

_OURS = TrackingSettings(
    motion=MotionSettings(model="constant_velocity", velocity_drift_mps=1.0, vertical_share=0.2),
    speed_sigma_mps=1.5,
    max_misses=30,
)
_NEAREST = replace(_OURS, association="greedy", use_shape=False, recognise_merges=False)
WAYS = {
    "rangecam": _OURS,
    "rangecam, joint": replace(_OURS, association="joint_probabilistic"),
    "nearest, told of what is cut": _NEAREST,
    "nearest": replace(_NEAREST, cut_sigma=0.0),
}
"""Settings by name; nearest: the nearest pair first, without shape, merges and splits, all else as ours."""
_RUNS, _LIMIT_M = 3, 1.0


class Score(NamedTuple):
    """Sum of identity switches, means of GOSPA (m) and HOTA."""

    switches: int
    gospa_m: float
    hota: float


def tracking_crowds(rng: np.random.Generator) -> Study:
    """Identities in a crowd, of people who meet and part, pass close, and walk behind a pole; beside peers."""
    theirs, claims, panels = installed(), list[Claim](), list[Panel]()
    switches = dict.fromkeys([*WAYS, *theirs], 0)
    for scene, make in CROWDS.items():
        cases = [_case(make(rng), rng) for _ in range(_RUNS)]
        scores = {name: _score(cases, [tracked(frames, WAYS[name]) for _, frames in cases]) for name in WAYS}
        scores |= {name: _score(cases, [track(frames) for _, frames in cases]) for name, track in theirs.items()}
        for name, score in scores.items():
            switches[name] += score.switches
            of = f"{scene}, {name}"
            claims.append(derived("K-FUT-06", f"{of}: identity switches in {_RUNS} runs", score.switches, ""))
            claims.append(derived("K-FUT-06", f"{of}: GOSPA", score.gospa_m, "m"))
            claims.append(derived("K-FUT-06", f"{of}: HOTA", score.hota, ""))
        way = cases[0][0].place_m[:, cases[0][0].walks]
        shown = [Series("", way[:, k, 0], way[:, k, 1]) for k in range(way.shape[1])]
        panels.append(Panel(scene, "x / m", "y / m", shown))
    ratio, why = switches["nearest"] / max(switches["rangecam"], 1), "at least 5 is asked, on the same segments"
    text = "all scenes: switches of nearest-neighbour tracking over ours"
    claims.append(judged("K-FUT-06", text, None, ratio, "", ratio >= 5, why))
    for name in switches:
        claims.append(derived("K-FUT-06", f"all scenes, {name}: identity switches", switches[name], ""))
    for name in sorted(PEERS.keys() - theirs.keys()):
        claims.append(derived("K-FUT-06", f"{name}: compared runs (pip install --no-deps {PEERS[name][0]})", 0, ""))
    return Study("tracking-crowds", "König 2008, 6.4.2 and 8", claims, panels)


def _case(bodies: Bodies, rng: np.random.Generator) -> tuple[Bodies, Seen]:
    return bodies, [(float(t), seen_of(bodies, k, rng)) for k, t in enumerate(bodies.time_s)]


def tracked(frames: Seen, settings: TrackingSettings) -> Tracked:
    """Return numbers and places of the confirmed tracks of each frame."""
    tracks, result = Tracks.empty(), list[tuple[list[int], np.ndarray]]()
    for time_s, segments in frames:
        tracks = update_tracks(tracks, segments, time_s, settings)
        lives = tracks.status != TrackStatus.TENTATIVE
        result.append((tracks.track_id[lives].tolist(), tracks.state[lives][:, [0, 3]]))
    return result


def _score(cases: list[tuple[Bodies, Seen]], results: list[Tracked]) -> Score:
    runs = [_moments(bodies, result) for (bodies, _), result in zip(cases, results, strict=True)]
    switches = sum(clear_mot(run, _LIMIT_M).switches for run in runs)
    mean = float(np.mean([gospa(frame, _LIMIT_M).total for run in runs for frame in run]))
    return Score(switches, mean, float(np.mean([hota(run, _LIMIT_M).hota for run in runs])))


def _moments(bodies: Bodies, result: Tracked) -> list[Moment]:
    truth = np.arange(len(bodies.width_m))
    return [moment(truth, place, *found) for place, found in zip(bodies.place_m, result, strict=True)]
