"""Tuning: the likelihood is that of the model, its maximum is the noise that made the data, wherever it is computed."""

import dataclasses
import json
import math
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from rangecam.cli import main
from rangecam.cli.tune import _describe
from rangecam.errors import DataError, UsageError
from rangecam.motion import MOTION, Mode, MotionSettings
from rangecam.tracking import TrackingSettings, update_tracks
from rangecam.tracking.rules import gate_threshold
from rangecam.tuning import (
    Paths,
    follow,
    likelihood,
    mapping,
    paths_of,
    process_noise,
    toml_of,
    tune,
    value_of,
    with_values,
    workers,
)
from rangecam.types import Segments, Tracks

FRAME_S, SIGMA_M = 0.04, 0.05
PLAIN = TrackingSettings(position_sigma_m=0.0, extent_sigma=0.0, motion=MotionSettings(drift_mps2=2.0))
DRIFT = "tracking.motion.drift_mps2"
SMALL = ["--set", "camera.rows=40", "--set", "camera.columns=56"]
MODES = MotionSettings(modes=(Mode(model="constant_velocity", velocity_drift_mps=0.1), Mode(model="singer")))


def segments(position_m: Any, size_m: float = 0.0) -> Segments:
    """Return a segment at each place, measured with `SIGMA_M` along each axis."""
    place = np.array(position_m, float).reshape(-1, 3)
    n = len(place)
    zero, covariance = np.zeros(n), np.broadcast_to(SIGMA_M**2 * np.eye(3), (n, 3, 3)).copy()
    return Segments(
        label=np.arange(1, n + 1),
        position_m=place,
        covariance_m2=covariance,
        size_m=np.full((n, 3), size_m),
        near_m=place[:, 0].copy(),
        n_pixels=np.ones(n, int),
        box=np.zeros((n, 4), int),
        range_m=zero,
        sigma_range_m=zero,
        amplitude=zero,
        cut=np.zeros(n, np.uint8),
        nearest_m=place,
    )


def followed(
    places: Any, settings: TrackingSettings, seen: Any = None, size_m: float = 0.0
) -> tuple[Paths, list[Tracks]]:
    """Return the paths of objects at `places` (frames, objects, 3) and the tracks; seen (frames, objects) bool."""
    tracks, frames = Tracks.empty(), []
    for k, place in enumerate(places):
        one = segments(place if seen is None else place[seen[k]], size_m)
        tracks = update_tracks(tracks, one, FRAME_S * k, settings)
        frames.append(SimpleNamespace(tracks=tracks, segments=one, image=SimpleNamespace(time_s=FRAME_S * k)))
    return paths_of("test", frames, settings), [frame.tracks for frame in frames]  # type: ignore[arg-type]


def drifting(drift_mps2: float, objects: int, frames: int, rng: np.random.Generator) -> Any:
    """Return measured places (frames, objects, 3) of objects, 100 m apart, whose accelerations drift."""
    F, Q = MOTION["constant_acceleration"](FRAME_S, Mode(drift_mps2=drift_mps2))
    root = np.linalg.cholesky(Q + 1e-18 * np.eye(3))
    state = rng.standard_normal((objects, 3, 3)) * [0.0, 3.0, 1.0]
    places = []
    for _ in range(frames):
        places.append(state[..., 0] + SIGMA_M * rng.standard_normal((objects, 3)))
        state = state @ F.T + rng.standard_normal((objects, 3, 3)) @ root.T
    return np.array(places) + np.outer(np.arange(objects), [0.0, 100.0, 0.0])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def drifters(rng: np.random.Generator) -> Paths:
    return followed(drifting(2.0, 40, 80, rng), PLAIN)[0]


# -- the likelihood ---------------------------------------------------------------------------------------------------


def test_the_likelihood_is_the_joint_density_of_all_measurements_after_the_first(rng: np.random.Generator) -> None:
    settings = dataclasses.replace(PLAIN, speed_sigma_mps=3.0, acceleration_sigma_mps2=1.0)
    places = drifting(2.0, 2, 12, rng)
    seen = np.ones((12, 2), bool)
    seen[5:7, 1] = seen[0, 0] = False  # one is lost for two frames, the other comes later
    paths, _ = followed(places, settings, seen)
    F, Q = MOTION["constant_acceleration"](FRAME_S, settings.motion)
    total = 0.0
    for i in range(2):
        (times,) = np.nonzero(seen[:, i])
        steps = times[1:] - times[0]
        # x_k = F^k x_0 + the sum of F^(k-l) w_l; what is measured is its first element
        P = np.diag([SIGMA_M**2, 9.0, 1.0])
        powers = [np.linalg.matrix_power(F, k)[0] for k in range(steps[-1] + 1)]
        joint = np.array(
            [
                [
                    powers[a] @ P @ powers[b] + sum(powers[a - u] @ Q @ powers[b - u] for u in range(1, min(a, b) + 1))
                    for b in steps
                ]
                for a in steps
            ]
        )
        joint += SIGMA_M**2 * np.eye(len(steps))
        for axis in range(3):
            z = places[times, i, axis]
            total += multivariate_normal(np.full(len(steps), z[0]), joint).logpdf(z[1:])
    score = likelihood(paths, settings)
    assert paths.gap == 2
    assert score.measurements == 9 + 10 - 1 + 2 - 0 - 1  # seen 11 and 10 times, without the first of each
    assert score.total == pytest.approx(total, rel=1e-7)


@pytest.mark.parametrize("motion", [PLAIN.motion, MODES, MotionSettings(model="singer", vertical_share=0.1)])
def test_the_nis_is_that_of_the_tracker_with_all_its_noises(motion: MotionSettings, rng: np.random.Generator) -> None:
    settings = TrackingSettings(
        motion=motion, position_sigma_m=0.02, extent_sigma=0.1, frame_time_sigma_s=0.01, gate_probability=1 - 1e-12
    )
    paths, tracks = followed(drifting(1.0, 5, 30, rng), settings, size_m=0.7)
    score = likelihood(paths, settings)
    assert (paths.count, score.measurements) == (5, 5 * 29)
    assert score.nis == pytest.approx(sum(np.nansum(one.nis) for one in tracks), rel=1e-6)


def test_rules_of_life_and_gates_change_nothing(drifters: Paths) -> None:
    strict = dataclasses.replace(
        PLAIN, confirm_hits=5, max_misses=0, gate_probability=0.3, max_position_sigma_m=1e-3, association="by_age"
    )
    assert likelihood(drifters, strict) == likelihood(drifters, PLAIN)


def test_a_gate_of_certainty_is_a_thousand_standard_deviations_wide() -> None:
    assert gate_threshold(1.0) == 1e6
    settings = dataclasses.replace(PLAIN, gate_probability=1.0, speed_sigma_mps=0.1)
    far = 900 * math.hypot(SIGMA_M, SIGMA_M)
    tracks = update_tracks(Tracks.empty(), segments([0, 0, 0]), 0.0, settings)
    assert len(update_tracks(tracks, segments([far, 0, 0]), FRAME_S, settings)) == 1


def jumping(paths: Paths, from_frame: int, to_frame: int) -> Paths:
    """Return paths of which some frames are 500 m off."""
    starts = np.concatenate([[0], paths.ends])
    moved = paths.segments.position_m.copy()
    moved[starts[from_frame] : starts[to_frame]] += 500.0
    return dataclasses.replace(paths, segments=dataclasses.replace(paths.segments, position_m=moved))


def test_what_a_thousand_standard_deviations_cannot_explain_has_no_likelihood() -> None:
    paths, _ = followed(np.zeros((6, 1, 3)), PLAIN)
    assert likelihood(jumping(paths, 4, 6), PLAIN).total == -math.inf


def test_only_confirmed_tracks_count_and_late_frames_do_not(rng: np.random.Generator) -> None:
    places = drifting(1.0, 3, 10, rng)
    seen = np.ones((10, 3), bool)
    seen[2:, 0] = False  # seen twice only
    paths, _ = followed(places, PLAIN, seen)
    assert paths.count == 2
    assert paths.ends.tolist() == list(range(2, 21, 2))
    tracks = update_tracks(Tracks.empty(), segments(places[0]), 1.0, PLAIN)
    refused = update_tracks(tracks, segments(places[0][:1]), 0.5, PLAIN)
    late = SimpleNamespace(tracks=refused, segments=segments(places[0][:1]), image=SimpleNamespace(time_s=0.5))
    with pytest.raises(DataError, match="late: no frame"):
        paths_of("late", [late], PLAIN)  # type: ignore[list-item]


# -- the search -------------------------------------------------------------------------------------------------------


def test_the_noise_that_made_the_data_is_found_within_its_stated_uncertainty(drifters: Paths) -> None:
    start = with_values(PLAIN, {DRIFT: 30.0})
    found = tune([dataclasses.replace(drifters, tracking=start)])
    assert (found.parameters, found.before, found.at_edge) == ((DRIFT,), (30.0,), (False,))
    assert found.best[0] == pytest.approx(2.0, rel=0.15)
    assert abs(math.log(found.best[0] / 2.0)) < 3 * found.sigma[0] < 0.15
    assert found.new.total > found.old.total
    assert found.new.total >= max(total for _, total in found.grid)
    assert found.new.nis / (3 * found.new.measurements) == pytest.approx(1.0, abs=0.05)
    assert value_of(found.settings, DRIFT) == found.best[0]


def test_the_stated_uncertainty_is_the_spread_of_what_is_found() -> None:
    tuned = [tune([followed(drifting(2.0, 10, 40, np.random.default_rng(k)), PLAIN)[0]]) for k in range(12)]
    pulls = np.array([math.log(one.best[0] / 2.0) / one.sigma[0] for one in tuned])
    assert np.abs(pulls).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.7  # chi-square of 12, beyond 99 %


def test_process_and_measurement_noise_are_found_together(rng: np.random.Generator) -> None:
    blurred = drifting(2.0, 30, 60, rng) + 0.1 * rng.standard_normal((60, 30, 3))
    paths, _ = followed(blurred, dataclasses.replace(PLAIN, position_sigma_m=0.1))
    extra = "tracking.position_sigma_m"
    found = tune([paths], (DRIFT, extra), low=0.01, high=50.0)
    assert found.best == pytest.approx((2.0, 0.1), rel=0.15)
    assert len(found.grid) == 81
    assert toml_of(found) == f"{DRIFT} = {found.best[0]:g}\n{extra} = {found.best[1]:g}"


def test_two_sources_count_together(drifters: Paths, rng: np.random.Generator) -> None:
    other, _ = followed(drifting(8.0, 40, 80, rng), with_values(PLAIN, {DRIFT: 1.0}))
    single, both = tune([drifters]), tune([drifters, other])
    assert single.best[0] < both.best[0] < 8.5
    assert math.isnan(both.before[0])
    assert both.old.total == likelihood(drifters, PLAIN).total + likelihood(other, other.tracking).total


def test_sources_with_different_models_are_tuned_each_by_its_own_noise(rng: np.random.Generator) -> None:
    walk = TrackingSettings(motion=MotionSettings(model="constant_velocity"))
    other, _ = followed(drifting(2.0, 5, 30, rng), walk)
    few, _ = followed(drifting(2.0, 5, 30, rng), PLAIN)
    found = tune([other, few])
    assert found.parameters == (DRIFT, "tracking.motion.velocity_drift_mps")
    assert found.best[0] == pytest.approx(tune([few]).best[0], rel=0.05)
    assert found.best[1] == pytest.approx(tune([other]).best[0], rel=0.05)


def test_what_the_range_does_not_hold_is_said_to_be_at_its_edge(drifters: Paths) -> None:
    found = tune([drifters], low=10.0, high=50.0)
    assert found.at_edge == (True,)
    assert found.best[0] == pytest.approx(10.0, rel=0.03)
    assert math.isnan(found.sigma[0])


@pytest.mark.parametrize(
    ("model", "name"),
    [
        ("constant_velocity", "velocity_drift_mps"),
        ("constant_acceleration", "drift_mps2"),
        ("wiener_acceleration", "step_mps2"),
        ("singer", "drift_mps2"),
    ],
)
def test_each_model_has_its_process_noise(model: Any, name: str, drifters: Paths) -> None:
    settings = TrackingSettings(motion=MotionSettings(model=model))
    assert process_noise(settings) == f"tracking.motion.{name}"
    low, high = (likelihood(drifters, with_values(settings, {process_noise(settings): v})).total for v in (0.1, 10.0))
    assert low != high


def test_modes_are_tuned_by_their_place_and_pasted_as_a_whole(rng: np.random.Generator) -> None:
    name = "tracking.motion.modes.1.drift_mps2"
    settings = with_values(dataclasses.replace(PLAIN, motion=MODES), {name: 30.0})
    paths, _ = followed(drifting(2.0, 10, 40, rng), settings)
    found = tune([paths], (name,))
    assert found.settings.motion.modes[1].drift_mps2 == found.best[0]
    assert found.settings.motion.modes[0] == MODES.modes[0]
    assert found.new.total > found.old.total
    pasted = tomllib.loads(toml_of(found))["tracking"]["motion"]["modes"]
    assert pasted[1]["drift_mps2"] == found.best[0]
    assert pasted[0]["model"] == "constant_velocity"
    with pytest.raises(UsageError, match=r"several modes.*modes\.0\.velocity_drift_mps, modes\.1\.drift_mps2"):
        process_noise(settings)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("camera.rows",), r"expected a number of \[tracking\]"),
        (("tracking",), r"expected a number of \[tracking\]"),
        (("tracking.motion.drift",), "there is no 'drift'; known here: .*drift_mps2"),
        (("tracking.motion.modes.0.drift_mps2",), "there is no '0'; known here: nothing"),
        (("tracking.motion.model",), "expected the name of a number"),
        (("tracking.motion.model.x",), "there is no 'x'"),
        (("tracking.motion",), "expected the name of a number"),
        ((DRIFT, DRIFT), "one parameter, or two that differ"),
        ((DRIFT, "tracking.position_sigma_m", "tracking.extent_sigma"), "one parameter, or two"),
        (("tracking.motion.step_mps2",), "without effect"),
        (("tracking.gate_probability",), "gate_probability = "),
    ],
)
def test_what_cannot_be_tuned_is_refused(names: tuple[str, ...], words: str, drifters: Paths) -> None:
    with pytest.raises(UsageError, match=words):
        tune([drifters], names)


@pytest.mark.parametrize("ends", [(0.0, 1.0), (2.0, 1.0), (1.0, math.inf), (math.nan, 1.0)])
def test_the_range_must_be_one(ends: tuple[float, float], drifters: Paths) -> None:
    with pytest.raises(UsageError, match="expected 0 < low < high"):
        tune([drifters], (), *ends)


def test_nothing_followed_and_nothing_explained_are_errors_of_the_data() -> None:
    nobody, _ = followed(np.zeros((4, 0, 3)), PLAIN)
    with pytest.raises(DataError, match="no confirmed track"):
        tune([nobody])
    settings = dataclasses.replace(PLAIN, speed_sigma_mps=0.01, acceleration_sigma_mps2=0.01)
    paths, _ = followed(np.zeros((8, 1, 3)), settings)
    with pytest.raises(DataError, match="no value in the range"):
        tune([jumping(paths, 3, 5)], low=0.01, high=0.1)


# -- who works --------------------------------------------------------------------------------------------------------


def watched(items: Any, total: int) -> Iterator[Any]:
    return iter(items)


def test_processes_find_the_same_as_nobody_else(drifters: Paths) -> None:
    alone = tune([drifters], mapper=mapping(None, watched))
    with workers(2) as pool:
        assert tune([drifters], mapper=mapping(pool, watched)).best == alone.best
    with workers(1) as nobody:
        assert nobody is None


@pytest.mark.filterwarnings("ignore")
def test_a_dask_scheduler_finds_the_same(drifters: Paths) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    with (
        distributed.LocalCluster(1, processes=False, threads_per_worker=1, dashboard_address=None) as cluster,
        workers(scheduler=cluster.scheduler_address) as pool,
    ):
        found = tune([drifters], mapper=mapping(pool, watched))
    assert found.best == tune([drifters]).best


def test_wrong_workers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="jobs = 0"), workers(0):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install 'rangecam\[cluster\]'"), workers(scheduler="tcp://nobody:1"):
        pass


@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_does_not_answer_is_said() -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    with pytest.raises(UsageError, match="no Dask scheduler answers at nowhere://x"), workers(scheduler="nowhere://x"):
        pass


# -- the command line -------------------------------------------------------------------------------------------------


def test_the_command_tunes_a_scenario_and_draws_the_likelihood(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = tmp_path / "tune.png"
    call = ["tune", "scenario:approach-box", "--parameter", DRIFT, "--low", "0.1", "--high", "30", *SMALL]
    assert main([*call, "--json", "--figure", str(figure)]) == 0
    result = json.loads(capsys.readouterr().out)
    (found,) = result["parameters"]
    assert found["name"] == DRIFT
    assert result["log_likelihood"]["tuned"] >= result["log_likelihood"]["before"]
    assert len(result["grid"]) == 13
    assert result["sources"][0]["tracks"] >= 1
    assert result["toml"] == f"{DRIFT} = {found['tuned']:g}"
    assert figure.read_bytes()[:4] == b"\x89PNG"
    assert main([*call, "--set", f"{DRIFT}=0.3", "--figure", str(figure)]) == 0
    out = capsys.readouterr().out
    assert f"{DRIFT}: 0.3 -> {found['tuned']:.2g}" in out
    assert out.splitlines()[-1] == f"figure     {figure}"
    assert "NIS" in out


def test_the_lines_for_people_say_what_differs_and_what_is_at_the_edge(drifters: Paths) -> None:
    other = dataclasses.replace(drifters, tracking=with_values(PLAIN, {DRIFT: 5.0}))
    lines = _describe(tune([drifters, other], low=0.01, high=0.5), [drifters, other])
    assert f"{DRIFT}: one each -> 0.498 (at the edge of the range tried)" in lines
    assert lines.startswith("test: 40 confirmed tracks")


def test_following_a_source_is_the_same_anywhere() -> None:
    first, second = follow("scenario:approach-box", seed=1), follow("scenario:approach-box", seed=1)
    assert likelihood(first, first.tracking) == likelihood(second, second.tracking)
    changed = follow("scenario:approach-box", preset="scaled_car", layers=[{"tracking": {"extent_sigma": 0.5}}])
    assert changed.tracking.extent_sigma == 0.5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tune"], "tune needs a source"),
        (["tune", "scenario:approach-box", "--figure", "nowhere/x.png"], "the folder nowhere does not exist"),
        (["tune", "scenario:approach-bx"], "unknown scenario"),
        (["tune", "scenario:approach-box", "--jobs", "0"], "jobs = 0"),
    ],
)
def test_a_wrong_call_is_one_line(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert words in captured.err
