"""Scores of tracks against the truth: their definitions on small cases, peers on real sequences, and a whole run."""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from rangecam import pipeline
from rangecam.cli import main
from rangecam.errors import UsageError
from rangecam.io import open_source
from rangecam.metrics import (
    Moment,
    amse,
    chi_square_bounds,
    clear_mot,
    gospa,
    honesty,
    hota,
    moment,
    nees,
    quality,
    rmse,
)

SEQUENCES = ("TUD-Campus", "TUD-Stadtmitte")
NAN = float("nan")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


# -- consistency ------------------------------------------------------------------------------------------------------


def test_nees_is_chi_square_where_the_covariance_is_true_and_not_where_it_is_half(rng: np.random.Generator) -> None:
    root = rng.standard_normal((6, 6))
    covariance = root @ root.T
    error = rng.standard_normal((4000, 6)) @ root.T
    low, high = chi_square_bounds(6, 4000, 0.999)
    spread = np.broadcast_to(covariance, (4000, 6, 6))
    assert low < nees(error, spread).mean() < high
    assert not low < nees(error, spread / 2).mean() < high
    assert nees(np.array([3.0, 4.0]), np.diag([9.0, 4.0])) == pytest.approx(1 + 4)


def test_the_bounds_of_the_mean_are_those_of_the_sum() -> None:
    assert chi_square_bounds(3) == pytest.approx((0.2157953, 9.3484036))  # tables of chi-square
    low, high = chi_square_bounds(2, 100, 0.9)
    assert chi2.cdf(200 * high / 2, 200) - chi2.cdf(200 * low / 2, 200) == pytest.approx(0.9)
    assert high - low == pytest.approx(2 * 1.645 * np.sqrt(4 / 100), rel=0.01)  # normal for many


@pytest.mark.parametrize(
    ("arguments", "words"),
    [((3, 1, 0.0), "probability = 0.0"), ((3, 1, 1.0), "between 0 and 1"), ((0, 1), "dof = 0"), ((3, 0), "count = 0")],
)
def test_impossible_bounds_are_refused(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        chi_square_bounds(*arguments)


def test_amse_is_the_mean_square_error_of_all_runs_and_steps(rng: np.random.Generator) -> None:
    error = rng.standard_normal((50, 121, 3)) + np.arange(3)
    np.testing.assert_allclose(amse(error), (error**2).mean(axis=(0, 1)))
    np.testing.assert_allclose(rmse(error, axis=(0, 1)), np.sqrt(amse(error)))
    assert rmse(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))


def test_nis_of_a_true_model_is_honest_and_of_a_wrong_one_is_not(rng: np.random.Generator) -> None:
    nis = rng.chisquare(3, 5000)
    good, bad = honesty(np.append(nis, NAN)), honesty(2 * nis)
    assert good is not None
    assert bad is not None
    assert good["bounds"][0] < good["mean"] < good["bounds"][1]
    assert good["inside"] == pytest.approx(0.95, abs=0.01)
    assert bad["mean"] > bad["bounds"][1]
    assert bad["inside"] < 0.9
    assert honesty(np.array([NAN])) is None


# -- GOSPA ------------------------------------------------------------------------------------------------------------


def test_gospa_adds_what_is_off_what_is_missed_and_what_is_false() -> None:
    one = moment([1, 2], [[0.0, 0.0], [10.0, 0.0]], [7, 8, 9], [[0.3, 0.4], [50.0, 0.0], [60.0, 0.0]])
    score = gospa(one, cutoff=2.0)
    assert score == pytest.approx((np.sqrt(0.25 + 2 + 4), 0.25, 2.0, 4.0))
    assert gospa(one, cutoff=2.0, order=1.0) == pytest.approx((0.5 + 1 + 2, 0.5, 1.0, 2.0))


def test_gospa_is_zero_only_for_the_truth_itself_and_of_nothing() -> None:
    assert gospa(moment([1], [[3.0, 4.0]], [9], [[3.0, 4.0]]), 1.0).total == 0
    assert gospa(moment([], np.zeros((0, 2)), [], np.zeros((0, 2))), 1.0) == (0, 0, 0, 0)
    assert gospa(moment([1], [[0.0]], [], np.zeros((0, 1))), 3.0).missed == pytest.approx(9 / 2)


places = st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), max_size=4)


@given(places, places, places)
def test_gospa_is_a_metric(x: list[Any], y: list[Any], z: list[Any]) -> None:
    def apart(a: list[Any], b: list[Any]) -> float:
        one = moment(range(len(a)), np.reshape(a, (-1, 2)), range(len(b)), np.reshape(b, (-1, 2)))
        return gospa(one, 1.5).total

    assert apart(x, y) == pytest.approx(apart(y, x))
    assert apart(x, z) <= apart(x, y) + apart(y, z) + 1e-9


# -- CLEAR MOT and HOTA -----------------------------------------------------------------------------------------------


def line(truth: dict[int, float], tracks: dict[int, float]) -> Moment:
    """Return a frame of objects and tracks on a line."""
    sides = [(list(side), np.reshape(list(side.values()), (-1, 1))) for side in (truth, tracks)]
    return moment(*sides[0], *sides[1])


def test_clear_mot_counts_misses_false_tracks_and_switches() -> None:
    frames = [
        line({1: 0.0, 2: 5.0}, {10: 0.1, 20: 5.1}),
        line({1: 0.0, 2: 5.0}, {10: 0.1}),  # 2 is missed
        line({1: 0.0, 2: 5.0}, {10: 0.1, 30: 5.3, 40: 9.0}),  # 2 comes back as 30; 40 is false
        line({1: 0.0}, {30: 0.5}),  # 1 is now 30
    ]
    score = clear_mot(frames, limit=1.0)
    assert (score.switches, score.misses, score.false_positives, score.matches) == (2, 1, 1, 6)
    assert score.mota == pytest.approx(1 - 4 / 7)
    assert score.motp == pytest.approx((0.1 + 0.1 + 0.1 + 0.1 + 0.3 + 0.5) / 6)


def test_a_match_is_kept_while_it_can_be_even_if_another_track_is_nearer() -> None:
    frames = [line({1: 0.0}, {10: 0.1}), line({1: 0.0}, {10: 0.8, 20: 0.0}), line({1: 0.0}, {10: 1.1, 20: 0.0})]
    assert clear_mot(frames[:2], limit=1.0).switches == 0
    assert clear_mot(frames, limit=1.0).switches == 1


def test_hota_of_a_track_that_changes_its_number_halfway_is_that_of_the_paper() -> None:
    perfect = [line({1: 0.0}, {10: 0.0}) for _ in range(8)]
    assert hota(perfect, 1.0) == pytest.approx((1, 1, 1, 1))
    halves = [*perfect[:4], *(line({1: 0.0}, {20: 0.0}) for _ in range(4))]
    # each match sees 4 of the 8 frames associated as it is: 4 / (4 + 4 + 0)
    assert hota(halves, 1.0) == pytest.approx((np.sqrt(0.5), 1, 0.5, 1))
    # a quarter of the frames without its track, and never a false one: DetA = 6 / 8, AssA = 6 / 8
    missed = [*perfect[:6], *(line({1: 0.0}, {}) for _ in range(2))]
    assert hota(missed, 1.0) == pytest.approx((0.75, 0.75, 0.75, 1))


def test_hota_counts_a_match_up_to_the_threshold_of_its_similarity() -> None:
    score = hota([line({1: 0.0}, {10: 0.42})], 1.0)  # alike by 0.58: 11 of the 19 thresholds
    assert (score.hota, score.detection) == pytest.approx((11 / 19, 11 / 19))
    assert score.localisation == pytest.approx((11 * 0.58 + 8) / 19)  # 1 where nothing matches, as the peers have it


def test_scores_of_nothing_are_not_a_number_and_of_nobody_reported_zero() -> None:
    assert np.isnan(hota([], 1.0)).all()
    assert np.isnan(hota([line({}, {})], 1.0)).all()
    assert hota([line({1: 0.0}, {})], 1.0).hota == 0
    assert clear_mot([line({1: 0.0}, {})], 1.0)[:1] == (0.0,)
    assert np.isnan(clear_mot([line({1: 0.0}, {})], 1.0).motp)
    assert np.isnan(clear_mot([line({}, {3: 1.0})], 1.0).mota)


@pytest.mark.parametrize("score", [gospa, lambda one, limit: clear_mot([one], limit), lambda o, c: hota([o], c)])
@pytest.mark.parametrize("limit", [0.0, -1.0, NAN])
def test_a_limit_must_be_a_distance(score: Any, limit: float) -> None:
    with pytest.raises(UsageError, match="expected a distance above 0"):
        score(line({1: 0.0}, {1: 0.0}), limit)


def test_ids_and_places_must_belong_together() -> None:
    with pytest.raises(UsageError, match="1 truth ids for 2 places"):
        moment([1], [[0.0], [1.0]], [], [])
    with pytest.raises(UsageError, match="a track id comes twice"):
        moment([], [], [1, 1], [[0.0], [1.0]])


# -- peers on real sequences ------------------------------------------------------------------------------------------


def boxes(name: str) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return ids and boxes (left, top, width, height) by frame of a file in the format of MOTChallenge."""
    if "RANGECAM_DATA" not in os.environ:
        pytest.skip("RANGECAM_DATA is not set")
    rows = np.loadtxt(Path(os.environ["RANGECAM_DATA"]) / "mot_tud" / f"{name}.txt", delimiter=",")
    return {int(k): (rows[rows[:, 0] == k, 1].astype(int), rows[rows[:, 0] == k, 2:6]) for k in np.unique(rows[:, 0])}


def overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the intersection over union of each pair of boxes."""
    a, b = a[:, None], b[None]
    low = np.maximum(a[..., :2], b[..., :2])
    high = np.minimum(a[..., :2] + a[..., 2:], b[..., :2] + b[..., 2:])
    both = np.prod(np.maximum(high - low, 0), axis=-1)
    return np.asarray(both / (np.prod(a[..., 2:], axis=-1) + np.prod(b[..., 2:], axis=-1) - both))


def sequence(name: str) -> list[Moment]:
    truth, tracks = boxes(f"{name}_gt"), boxes(f"{name}_test")
    nobody = np.zeros(0, int), np.zeros((0, 4))
    frames = []
    for k in sorted(truth.keys() | tracks.keys()):
        (ids, where), (own, reported) = truth.get(k, nobody), tracks.get(k, nobody)
        frames.append(Moment(ids, own, 1 - overlap(where, reported)))
    return frames


@pytest.mark.parametrize("name", SEQUENCES)
def test_clear_mot_and_hota_are_those_of_trackeval_on_real_sequences(name: str) -> None:
    frames = sequence(name)
    with_peer = pytest.importorskip("trackeval", reason="TrackEval is not installed")
    ids = [np.unique(np.concatenate([getattr(one, key) for one in frames])) for key in ("truth_id", "track_id")]
    data = {
        "num_timesteps": len(frames),
        "num_gt_ids": len(ids[0]),
        "num_tracker_ids": len(ids[1]),
        "num_gt_dets": sum(len(one.truth_id) for one in frames),
        "num_tracker_dets": sum(len(one.track_id) for one in frames),
        "gt_ids": [np.searchsorted(ids[0], one.truth_id) for one in frames],
        "tracker_ids": [np.searchsorted(ids[1], one.track_id) for one in frames],
        "similarity_scores": [1 - one.distance for one in frames],
    }
    peer = with_peer.metrics.HOTA().eval_sequence(data)
    names = ("HOTA", "DetA", "AssA", "LocA")
    assert hota(frames, 1.0) == pytest.approx([float(np.mean(peer[key])) for key in names], rel=1e-12)
    peer = with_peer.metrics.CLEAR({"THRESHOLD": 0.5, "PRINT_CONFIG": False}).eval_sequence(data)
    score = clear_mot(frames, 0.5)
    assert score.mota == pytest.approx(peer["MOTA"], rel=1e-12)
    assert 1 - score.motp == pytest.approx(peer["MOTP"], rel=1e-12)
    counts = (score.switches, score.misses, score.false_positives, score.matches)
    assert counts == tuple(int(peer[key]) for key in ("IDSW", "CLR_FN", "CLR_FP", "CLR_TP"))


@pytest.mark.parametrize(
    ("name", "published"),
    [("TUD-Campus", (39.1, 41.8, 36.9, 52.6, 0.277)), ("TUD-Stadtmitte", (39.8, 39.2, 40.9, 56.4, 0.346))],
)
def test_scores_of_the_real_sequences_are_those_that_py_motmetrics_publishes(
    name: str, published: tuple[float, ...]
) -> None:
    frames = sequence(name)
    whole, clear = hota(frames, 1.0), clear_mot(frames, 0.5)
    assert [round(100 * each, 1) for each in (*whole[:3], clear.mota)] == list(published[:4])
    assert clear.motp == pytest.approx(published[4], abs=5e-4)
    assert clear.switches == 7


# -- a run of the chain ------------------------------------------------------------------------------------------------


def test_a_simulated_run_says_how_well_it_follows_the_truth(capsys: pytest.CaptureFixture[str]) -> None:
    opened = open_source("scenario:crossing-person")
    captures = list(opened.captures)[:150]
    frames = list(pipeline.run(captures, opened.config))
    found = quality(captures, frames, opened.config)
    assert found is not None
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert (found["frames"], found["objects"]) == (150, 1)
    assert found["clear"]["mota"] > 0.85
    assert found["rmse_position_m"] < 0.25
    parts = found["gospa_m"]
    assert parts["total"] ** 2 == pytest.approx(sum(parts[k] for k in parts if k != "total"), abs=1e-4)

    # whoever stands two metres beside where the truth is, follows nobody
    moved = [
        dataclasses.replace(f, tracks=dataclasses.replace(f.tracks, state=f.tracks.state + 2.0 * np.eye(9)[0]))
        for f in frames
    ]
    worse = quality(captures, moved, opened.config)
    assert worse is not None
    assert worse["clear"]["matches"] == 0
    assert worse["rmse_position_m"] is None
    wide = quality(captures, moved, opened.config, limit_m=3.0)
    assert wide is not None
    assert wide["rmse_position_m"] == pytest.approx(2.0, abs=0.15)
    # nobody is there for whom hardly any object is large enough
    none = quality(captures, frames, opened.config, min_pixels=10_000)
    assert none is not None
    assert none["objects"] == 0

    unknown = [dataclasses.replace(capture, truth=None) for capture in captures]
    assert quality(unknown, frames, opened.config) is None


def test_the_summary_of_a_simulated_run_has_its_quality(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "scenario:test-scene", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {"gospa_m", "clear", "hota", "rmse_position_m", "rmse_velocity_mps", "velocity_nees"} <= set(
        result["quality"]
    )
    assert set(result["nis"]) == {"mean", "bounds", "inside"}
    assert main(["run", "scenario:test-scene"]) == 0
    out = capsys.readouterr().out
    assert "truth      RMS error" in out
    assert "HOTA" in out
    assert "NIS        " in out
