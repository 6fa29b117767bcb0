"""Whether what is stated of collisions holds: simulated drives through the whole chain, against their truth."""

import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import beta

from rangecam.cameras.simulated import frames
from rangecam.config import Config, load_config
from rangecam.metrics import chi_square_bounds
from rangecam.pipeline import run
from rangecam.scene.paths import EgoMotion, Path, WayPoint, motion
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, SceneObject
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.tracking import update_tracks
from rangecam.types import Floats, Frame, Segments, Tracks, TrackStatus

_STEP_S = 0.1
"""The velocity of an object drifts from one way-point to the next."""
_DRIFT_MPS = 0.3
WELL_MODELLED: dict[str, Any] = {
    "tracking": {"motion": {"model": "constant_velocity", "velocity_drift_mps": _DRIFT_MPS}},
    "decision": {"corridor": {"drift_mps": _DRIFT_MPS, "length_m": 4.3}},
}
"""What the tracker expects is how the objects of the drives move: their velocity drifts."""
OVERCONFIDENT: dict[str, Any] = {
    "tracking": {"gate_probability": 1.0, "extent_sigma": 0.0, "motion": {"velocity_drift_mps": 0.0}},
    "segments": {"sigma_systematic_m": 0.0, "edge_step": 0.0, "edge_jitter": 0.0},
}
"""A model that is wrong on purpose: nothing moves but steadily, and nothing is measured badly but by noise. With the
gate open, for else the tracks would be seen no more."""


@dataclass(frozen=True, eq=False)
class Drive:
    """A random drive towards one object, and what will become of it.

    seen_s: until when it is seen. arrives_s: when the object's nearest surface crosses the line of our front. hits:
    whether the outlines touch within the horizon.
    """

    scenario: Scenario
    seen_s: float
    arrives_s: float
    hits: bool


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was stated in the last frame of a drive, beside the truth.

    ttc_s: true time to collision, quantiles_s (5,): stated, p_collision: stated, hits: true. nis: of all frames;
    nis_as_modelled: had the errors of the camera been as the tracker takes them to be, each frame on its own.
    distance_error_m: of the nearest surface, speed_error_mps; distance_m: true.
    """

    ttc_s: float
    quantiles_s: Floats
    p_collision: float
    hits: bool
    nis: Floats
    nis_as_modelled: Floats
    distance_m: float
    distance_error_m: float
    speed_error_mps: float


def draw_drive(rng: np.random.Generator, config: Config) -> Drive:
    """Return a drive with random speeds, offset, size, reflectivity and time at which it is looked at.

    The object stays within the field of view until then; its velocity is a random walk.
    """
    while True:
        size = rng.uniform(0.3, 2.0), rng.uniform(0.4, 1.8), rng.uniform(0.8, 1.8)
        closing, ttc_s, seen_s = rng.uniform(4, 12), rng.uniform(0.5, 1.5), rng.uniform(0.4, 1.0)
        beside = rng.choice([-1, 1]) * ((config.decision.corridor.width_m + size[1]) / 2 + rng.normal(0, 0.5))
        lateral_m, lateral_mps = beside if rng.random() < 0.7 else rng.uniform(-2.5, 2.5), rng.normal(0, 0.8)
        own = rng.uniform(0.3, 1.0) * closing
        start = closing * (ttc_s + seen_s), lateral_m - lateral_mps * (ttc_s + seen_s)
        knots = _drift(start, (own - closing, lateral_mps), round((seen_s + ttc_s + 3.0) / _STEP_S), rng)
        time_s = np.linspace(0, (len(knots[0]) - 1) * _STEP_S, 50 * len(knots[0]))
        place = _between(knots, time_s) - np.outer(own * time_s, [1, 0])
        before = place[time_s <= seen_s]
        edge = math.tan(math.radians(config.camera.lens.horizontal_fov_deg / 2)) * 0.95
        if before[:, 0].max() < 20 and (np.abs(before[:, 1]) + size[1] / 2 < edge * before[:, 0]).all():
            break
    box = Box(center_m=(size[0] / 2, 0.0, size[2] / 2), size_m=size, reflectivity=rng.uniform(0.1, 0.8))
    thing = SceneObject(name="object", boxes=(box,), path=_path(knots))
    named: dict[str, Any] = {"name": "drive", "description": "", "preset": "usercams", "duration_s": seen_s}
    scenario = Scenario(**named, ground_reflectivity=0.2, ego=EgoMotion(speed_mps=own), objects=(thing,))
    corridor = config.decision.corridor
    gap_m = place[:, 0] - corridor.front_m
    come = np.flatnonzero(gap_m <= 0)
    arrives_s = float(time_s[come[0]]) if len(come) else math.inf
    touching = (gap_m <= 0) & (gap_m + size[0] + corridor.length_m >= 0)
    touching &= np.abs(place[:, 1]) <= (corridor.width_m + size[1]) / 2
    return Drive(scenario, seen_s, arrives_s, bool((touching & (time_s <= seen_s + corridor.horizon_s)).any()))


def _drift(
    start: tuple[float, float], velocity: tuple[float, float], count: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return positions and velocities (count + 1, 2) along x and y, `_STEP_S` apart: the velocity is a random walk."""
    steps = rng.normal(0, _DRIFT_MPS * math.sqrt(_STEP_S), (count, 2))
    v = np.array(velocity) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    p = np.array(start) + np.concatenate([np.zeros((1, 2)), np.cumsum((v[1:] + v[:-1]) / 2 * _STEP_S, axis=0)])
    return p, v


def _between(knots: tuple[Floats, Floats], time_s: Floats) -> Floats:
    """Return positions (N, 2) at times between, with a steady acceleration from one to the next, as `_path` has."""
    p, v = knots
    k = np.clip((time_s / _STEP_S).astype(int), 0, len(p) - 2)
    t = (time_s - k * _STEP_S)[:, None]
    return np.asarray(p[k] + v[k] * t + (v[k + 1] - v[k]) / _STEP_S * t**2 / 2)


def _path(knots: tuple[Floats, Floats]) -> Path:
    points = [
        WayPoint(time_s=k * _STEP_S, position_m=(*p.tolist(), 0.0), velocity_mps=(*v.tolist(), 0.0))
        for k, (p, v) in enumerate(zip(*knots, strict=True))
    ]
    return Path(waypoints=tuple(points))


def drive(seed: int, layers: Sequence[dict[str, Any]]) -> Outcome | None:
    """Return what is stated of one random drive and what becomes of it, None where the object has no track yet."""
    config = load_config("usercams", *layers)
    drawn = draw_drive(np.random.default_rng(seed), config)
    rng, tracks, frame = np.random.default_rng([seed, 1]), Tracks.empty(), None
    nis, nis_as_modelled = [], []
    for frame in run(frames(drawn.scenario, config, seed), config):
        nis.append(_confirmed_nis(frame.tracks))
        time_s = frame.tracks.time_s
        seen = _as_modelled(frame.segments, drawn, time_s, config.tracking.extent_sigma, rng)
        tracks = update_tracks(tracks, seen, time_s, config.tracking)
        nis_as_modelled.append(_confirmed_nis(tracks))
    assert frame is not None  # a scenario has at least one frame
    return _judged(frame, drawn, config, (np.concatenate(nis), np.concatenate(nis_as_modelled)))


def _confirmed_nis(tracks: Tracks) -> Floats:
    its = tracks.nis[tracks.status == TrackStatus.CONFIRMED]
    return np.asarray(its[np.isfinite(its)])


def _as_modelled(
    segments: Segments, drawn: Drive, time_s: float, extent_sigma: float, rng: np.random.Generator
) -> Segments:
    """Return the largest segment where the object is, but for an error that is drawn from what is stated of it.

    That is the segment's covariance, and how far its middle wanders, a share of its size (`extent_sigma`).
    """
    largest = np.argsort(-segments.n_pixels)[:1]
    its = motion(drawn.scenario.objects[0].path, time_s).position_m - (drawn.scenario.ego.speed_mps * time_s, 0.0, 0.0)
    kept = {key: values[largest] for key, values in vars(segments).items()}
    stated = [
        R + np.diag((extent_sigma * size) ** 2) for R, size in zip(kept["covariance_m2"], kept["size_m"], strict=True)
    ]
    errors = [rng.multivariate_normal(np.zeros(3), covariance) for covariance in stated]
    position_m = its + np.array([0.0, 0.0, 0.7]) + np.array(errors).reshape(-1, 3)
    changed = {"position_m": position_m, "near_m": position_m[:, 0], "cut": np.zeros(len(largest), np.uint8)}
    return Segments(**{**kept, **changed})


def _judged(frame: Frame, drawn: Drive, config: Config, nis: tuple[Floats, Floats]) -> Outcome | None:
    time_s, tracks, said = frame.tracks.time_s, frame.tracks, frame.decision.collisions
    own = drawn.scenario.ego.speed_mps
    its = motion(drawn.scenario.objects[0].path, time_s)
    place = its.position_m[:2] - np.array([own * time_s, 0.0])
    apart = np.hypot(tracks.state[:, 0] - tracks.near_offset_m - place[0], tracks.state[:, 3] - place[1])
    apart[tracks.status == TrackStatus.TENTATIVE] = np.inf
    if not len(apart) or apart.min() > 2.0:
        return None
    i = int(np.argmin(apart))
    corridor = config.decision.corridor
    lag = corridor.lag_s * tracks.state[i, 1]
    return Outcome(
        drawn.arrives_s - time_s,
        said.ttc_quantiles_s[i],
        float(said.p_collision[i]),
        drawn.hits,
        *nis,
        float(place[0]),
        float(tracks.state[i, 0] - tracks.near_offset_m[i] + lag - place[0]),
        float(tracks.state[i, 1] - its.velocity_mps[0] + own),
    )


def drives(
    count: int, seed: int = 0, layers: Sequence[dict[str, Any]] = (WELL_MODELLED,), jobs: int = 1
) -> list[Outcome]:
    """Return the outcomes of `count` random drives; those whose object has no track yet are left out."""
    one, seeds = partial(drive, layers=tuple(layers)), range(seed, seed + count)
    if jobs == 1:
        found = [one(each) for each in seeds]
    else:
        with ProcessPoolExecutor(jobs) as pool:
            found = list(pool.map(one, seeds, chunksize=8))
    return [outcome for outcome in found if outcome is not None]


def honesty(rng: np.random.Generator, count: int = 80, jobs: int = 1) -> Study:
    """Whether time to collision, collision probability and innovations hold what they state, over simulated drives."""
    seed = int(rng.integers(2**31))
    told = drives(count, seed, jobs=jobs)
    wrong = drives(max(count // 8, 6), seed, (WELL_MODELLED, OVERCONFIDENT), jobs)
    covered, intervals = _intervals(told)
    calibrated, reliability = _reliability(told)
    return Study(
        "honesty",
        "König 2008, section 6.5: prediction of collisions (K-CLS-03, K-CLS-04)",
        [*covered, *calibrated, *_innovations(told, wrong)],
        [intervals, reliability, _surface(told)],
    )


_CONFIDENCE = 0.99


def binomial_bounds(hits: int, count: int, confidence: float) -> tuple[float, float]:
    """Return between which rates `hits` of `count` leave the true one at this confidence (Clopper and Pearson 1934)."""
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, hits, count - hits + 1)) if hits > 0 else 0.0
    high = float(beta.ppf(1 - tail, hits + 1, count - hits)) if hits < count else 1.0
    return low, high


def _intervals(told: Sequence[Outcome]) -> tuple[list[Claim], Panel]:
    """Return whether the quantiles of the time to collision are exceeded as often as they say."""
    quantiles, ttc_s = np.array([each.quantiles_s for each in told]), np.array([each.ttc_s for each in told])
    claims = []
    for low, high, share in ((1, 3, 0.68), (0, 4, 0.95)):
        inside = int(((ttc_s >= quantiles[:, low]) & (ttc_s <= quantiles[:, high])).sum())
        bounds = binomial_bounds(inside, len(told), _CONFIDENCE)
        text = f"true time to collision within its {share:.0%} interval, {len(told)} drives"
        why = f"{share:g} between {bounds[0]:.3f} and {bounds[1]:.3f}, which the count leaves at 99 %"
        agrees = bounds[0] <= share <= bounds[1]
        claims.append(judged("K-CLS-03", text, None, inside / len(told), "", agrees, why))
    shares = np.linspace(0.02, 0.98, 25)
    half_width = np.maximum((quantiles[:, 3] - quantiles[:, 1]) / 2, 1e-9)
    place = np.sort(np.abs(ttc_s - quantiles[:, 2]) / half_width)
    known = place[np.minimum((shares * len(place)).astype(int), len(place) - 1)]
    stated = np.array([math.erf(each / math.sqrt(2)) for each in known])
    series = [Series("drives", stated, shares, None, "o-"), Series("as stated", [0, 1], [0, 1], None, "--")]
    return claims, Panel("Time to collision", "stated share of its interval", "share of drives within", series)


def _reliability(told: Sequence[Outcome]) -> tuple[list[Claim], Panel]:
    """Return whether of the drives with a stated probability that share ends in a collision, in ten bins."""
    p, hits = np.array([each.p_collision for each in told]), np.array([each.hits for each in told])
    claims, rows = [], []
    for k in range(10):
        those = (p >= k / 10) & ((p < (k + 1) / 10) | (k == 9))
        if not those.any():
            continue
        said, n, hit = float(p[those].mean()), int(those.sum()), int(hits[those].sum())
        low, high = binomial_bounds(hit, n, 1 - (1 - _CONFIDENCE) / 10)
        rows.append((said, hit / n, n, low - 0.02 <= said <= high + 0.02, low, high))
        text = f"collisions of {n} drives stated with {k / 10:.1f} to {k / 10 + 0.1:.1f}, {said:.3f} on the average"
        why = f"{low:.3f} to {high:.3f} at 99 % for all bins, and 0.02 that the method is good to"
        claims.append(judged("K-CLS-04", text, None, hit / n, "", rows[-1][3], why))
    said, came, n, _, low, high = np.array(rows).T
    series = [
        Series("drives", said, came, (high - low) / 4),
        Series("as stated", [0, 1], [0, 1], None, "--"),
    ]
    return claims, Panel("Collision probability", "stated", "share that collides", series)


def _innovations(told: Sequence[Outcome], wrong: Sequence[Outcome]) -> list[Claim]:
    """Return whether innovations are as large as their covariance says, and that a wrong model shows."""
    low, high = chi_square_bounds(3, probability=0.95)
    claims = []
    for what, all_nis in (
        ("with errors as modelled", [each.nis_as_modelled for each in told]),
        ("of the camera", [each.nis for each in told]),
        ("wrong on purpose", [each.nis for each in wrong]),
    ):
        nis = np.concatenate(all_nis)
        within, above, mean = float(np.mean((nis >= low) & (nis <= high))), float(np.mean(nis > high)), nis.mean() / 3
        text, count = f"innovations squared within the 95 % bounds of chi-square, {what}", f"{len(nis)} frames; "
        if what == "with errors as modelled":
            why = count + "95 %, give or take 2: errors of the object's place drawn from the covariance of its segment"
            claims.append(judged("K-KAL-08", text, None, within, "", abs(within - 0.95) < 0.02, why))
        elif what == "of the camera":
            why = (
                count + "the rest is below: rows of pixels hold an edge still, so that errors are alike in many frames"
            )
            claims.append(derived("K-KAL-08", text, within, "", why))
            text = f"innovations squared above these bounds, {what}"
            claims.append(judged("K-KAL-08", text, None, above, "", above < 0.04, "at most 4 %: 2.5 % and a margin"))
        else:
            claims.append(judged("K-KAL-08", text, None, within, "", within < 0.8, count + "far from 95 %"))
        text, agrees = f"mean of the same over its three degrees of freedom, {what}", mean < 1.2
        why = "at most 1.2; less than 1 is on the safe side"
        if what == "wrong on purpose":
            agrees, why = mean > 2, "far above 1"
        claims.append(judged("K-KAL-08", text, None, float(mean), "", bool(agrees), why))
    return claims


def _surface(told: Sequence[Outcome]) -> Panel:
    """Return how far off the nearest surface is, over its distance."""
    at_m = [each.distance_m for each in told]
    series = [
        Series("nearest surface / m", at_m, [each.distance_error_m for each in told], None, "."),
        Series("closing speed / (m/s)", at_m, [each.speed_error_mps for each in told], None, "."),
    ]
    return Panel("Errors of distance and speed", "distance / m", "estimated less true", series)
