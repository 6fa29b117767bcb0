"""Classes: the examples of the thesis, what it owns up to, and that probabilities are probabilities."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangecam.classify import CLASSIFICATION, ClassificationSettings, classify
from rangecam.classify.features import FEATURES, MEMORY, is_resolved, observe
from rangecam.classify.learned import Model, load_model, probabilities, save_model
from rangecam.errors import DataError
from rangecam.types import ACTIONS, CLASSES, Ego, Segments, Track, Tracks, TrackStatus

AT_ONCE = ClassificationSettings(memory=0.0)
UNMEASURED = Ego()


def track(
    width: float = 0.5,
    height: float = 1.7,
    lateral_mps: float = 0.0,
    sigma_mps: float = 0.1,
    status: TrackStatus = TrackStatus.CONFIRMED,
) -> Tracks:
    state, covariance = np.zeros((1, 9)), np.eye(9)[None] * sigma_mps**2
    state[0, 0], state[0, 4] = 8.0, lateral_mps
    return dataclasses.replace(
        Tracks.empty(),
        track_id=np.array([1]),
        status=np.array([int(status)]),
        state=state,
        covariance=covariance,
        age=np.array([9]),
        hits=np.array([9]),
        misses=np.array([0]),
        size_m=np.array([[0.3, width, height]]),
        near_offset_m=np.array([0.1]),
        n_pixels=np.array([50.0]),
        segment=np.array([1]),
        class_probability=np.array([[1.0, 0.0, 0.0, 0.0]]),
        nis=np.array([1.0]),
    )


def nothing() -> Segments:
    return segments_of(0)


def segments_of(count: int = 1, **fields: object) -> Segments:
    """Segments of a person 8 m ahead."""
    whole = {
        "label": np.arange(1, count + 1),
        "position_m": np.tile([8.0, 0.0, 0.9], (count, 1)),
        "covariance_m2": np.tile(1e-4 * np.eye(3), (count, 1, 1)),
        "size_m": np.tile([0.3, 0.5, 1.7], (count, 1)),
        "near_m": np.full(count, 7.85),
        "n_pixels": np.full(count, 120),
        "box": np.tile([40, 70, 65, 78], (count, 1)),
        "range_m": np.full(count, 8.0),
        "sigma_range_m": np.full(count, 0.01),
        "amplitude": np.full(count, 50.0),
        "cut": np.zeros(count, np.uint8),
        "nearest_m": np.tile([7.85, 0.0, 0.9], (count, 1)),
    }
    return Segments(**{**whole, **fields})  # type: ignore[arg-type]


def profile_of(*rows: tuple[float, ...]) -> np.ndarray:
    """How wide, how full and how far behind the four parts of one segment are."""
    return np.array([[*rows, (0.0,) * 4][:3]])


def test_segments_that_nobody_measured_have_the_profile_of_a_full_box() -> None:
    full = segments_of(profile=profile_of((1.0,) * 4, (1.0,) * 4))
    one, other = (observe(track(), Ego(speed_mps=0.0), each)[1] for each in (segments_of(), full))
    np.testing.assert_array_equal(one, other)


def test_segments_whose_surface_nobody_measured_are_smooth_boards_that_face_us() -> None:
    board = segments_of(surface=np.array([[0.0] * 6 + [1.0, 1.0]]))
    one, other = (observe(track(), Ego(speed_mps=0.0), each)[1] for each in (segments_of(), board))
    np.testing.assert_array_equal(one, other)


def test_the_bends_of_a_surface_are_told_by_how_far_its_sides_and_ends_lie_behind_its_middle() -> None:
    surface = np.array([[0.02, -0.3, 0.1, 2.0, -0.5, -4.0, 0.7, 1.2]])
    told = observe(track(), Ego(speed_mps=0.0), segments_of(surface=surface))[1][0]
    at = {name: told[FEATURES.index(name)] for name in FEATURES}
    assert at["sag_across"] == pytest.approx(2.0 * 0.25**2)
    assert at["sag_up_now"] == pytest.approx(-0.5 * 0.85**2)
    assert at["shade_across"] == pytest.approx(-4.0 * 0.25**2)
    assert (at["lean_across"], at["lean_up"], at["inner"], at["pieces_now"]) == pytest.approx((0.3, 0.1, 0.7, 1.2))
    assert at["log_rough"] == pytest.approx(np.log(0.025))


def first(tracks: Tracks, settings: ClassificationSettings = AT_ONCE, ego: Ego = UNMEASURED) -> Track:
    return classify(tracks, ego, settings, nothing())[0]


def p(name: str, tracks: Tracks, settings: ClassificationSettings = AT_ONCE) -> float:
    return float(first(tracks, settings).class_probability[CLASSES.index(name)])


def test_something_forty_centimetres_wide_that_moves_is_a_vru() -> None:
    assert first(track(width=0.4, lateral_mps=1.4)).class_name == "vru"
    assert first(track(width=0.4, lateral_mps=-1.4)).class_name == "vru"


def test_a_standing_person_cannot_be_told_from_a_tree() -> None:
    assert first(track(width=0.4)).class_name == "obstacle"
    assert 0.1 < p("vru", track(width=0.4)) < 0.5


def test_a_car_is_a_vehicle_and_a_wall_an_obstacle() -> None:
    assert first(track(width=1.8, height=1.5)).class_name == "vehicle"
    assert first(track(width=6.0, height=2.5)).class_name == "obstacle"


def test_what_moves_and_has_the_size_of_nothing_known_stays_unknown() -> None:
    assert p("unknown", track(width=6.0, height=2.5, lateral_mps=2.0)) > 0.95


@pytest.mark.parametrize("status", [TrackStatus.TENTATIVE, TrackStatus.COASTING])
def test_what_is_not_seen_well_keeps_its_class(status: TrackStatus) -> None:
    assert first(track(lateral_mps=1.4, status=status)).class_name == "unknown"


def test_a_speed_that_is_not_known_well_is_no_evidence_of_moving() -> None:
    sure, unsure = (p("vru", track(lateral_mps=1.0, sigma_mps=sigma)) for sigma in (0.1, 5.0))
    assert sure > 0.8
    assert unsure < 0.45


def test_a_class_is_believed_after_some_frames_not_after_one() -> None:
    tracks, settings = track(width=1.8, height=1.5), ClassificationSettings(memory=0.8)
    vehicle = []
    for _ in range(20):
        tracks = classify(tracks, Ego(), settings, nothing())
        vehicle.append(tracks.class_probability[0, CLASSES.index("vehicle")])
    assert vehicle == sorted(vehicle)
    assert vehicle[0] == pytest.approx(0.2 * p("vehicle", track(width=1.8, height=1.5)))
    assert vehicle[-1] == pytest.approx(p("vehicle", track(width=1.8, height=1.5)), rel=0.02)


@given(st.floats(0, 50), st.floats(0, 50), st.floats(-20, 20), st.floats(0, 10))
def test_the_probabilities_of_every_object_sum_to_one(width: float, height: float, speed: float, sigma: float) -> None:
    probability = first(track(width, height, speed, sigma)).class_probability
    assert probability.sum() == pytest.approx(1.0)
    assert (probability >= 0).all()


@pytest.mark.parametrize(
    ("change", "of", "row"),
    [
        ({"vru_width_m": (1.5, 2.0)}, "vru", {"lateral_mps": 1.4}),
        ({"vru_height_m": (4.0, 5.0)}, "vru", {"lateral_mps": 1.4}),
        ({"vehicle_width_m": (3.0, 4.0)}, "vehicle", {"width": 1.8, "height": 1.5}),
        ({"vehicle_height_m": (3.0, 4.0)}, "vehicle", {"width": 1.8, "height": 1.5}),
        ({"size_tolerance": 0.01}, "vru", {"width": 1.2, "lateral_mps": 1.4}),
        ({"moving_mps": 2.0}, "vru", {"lateral_mps": 1.4}),
        ({"standing_weight": 0.0}, "vru", {}),
        ({"obstacle_weight": 0.01}, "obstacle", {}),
        ({"unknown_weight": 5.0}, "obstacle", {}),
    ],
)
def test_each_setting_has_its_effect(change: dict[str, object], of: str, row: dict[str, float]) -> None:
    settings = dataclasses.replace(AT_ONCE, **change)  # type: ignore[arg-type]
    assert p(of, track(**row), settings) < 0.7 * p(of, track(**row))  # type: ignore[arg-type]


def test_inputs_are_not_modified_and_nothing_is_a_class_too() -> None:
    tracks = track(lateral_mps=1.4)
    classify(tracks, Ego(), AT_ONCE, nothing())
    np.testing.assert_array_equal(tracks.class_probability, [[1, 0, 0, 0]])
    assert len(classify(Tracks.empty(), Ego(), AT_ONCE, nothing())) == 0


# ---- motion over ground and actions


def test_what_stands_while_we_drive_is_no_road_user_and_what_keeps_our_pace_moves() -> None:
    standing, pacing = track(), track()
    standing.state[0, 1] = -8.0
    ego = Ego(speed_mps=8.0)
    assert first(standing, ego=ego).class_name == "obstacle"
    assert first(pacing, ego=ego).class_name == "vru"
    assert first(pacing).class_name == "obstacle"  # nobody says that we drive


@pytest.mark.parametrize(
    ("velocity", "action"),
    [
        ((0.0, 0.0), "standing"),
        ((-1.4, 0.0), "approaching"),
        ((1.4, 0.0), "leaving"),
        ((0.0, 1.4), "crossing"),
        ((0.0, -1.4), "crossing"),
        ((-1.0, 1.0), "walking"),
    ],
)
@pytest.mark.parametrize("own_mps", [0.0, 5.0, -2.0])
def test_what_a_track_does_is_told_by_its_velocity_over_ground(
    velocity: tuple[float, float], action: str, own_mps: float
) -> None:
    tracks = track(sigma_mps=0.02)
    tracks.state[0, [1, 4]] = velocity[0] - own_mps, velocity[1]
    done = first(tracks, ego=Ego(speed_mps=abs(own_mps), forward=own_mps >= 0))
    assert done.action_name == action
    assert done.action_probability is not None
    assert done.action_probability.max() > 0.99
    assert track()[0].action_name == ""


def test_the_probability_of_standing_is_that_of_a_speed_below_the_limit() -> None:
    tracks, settings = track(sigma_mps=0.4), ClassificationSettings(moving_mps=0.5)
    standing = classify(tracks, Ego(speed_mps=0.0), settings, nothing()).action_probability
    assert standing is not None
    assert standing.sum() == pytest.approx(1.0)
    # the speed of a normal velocity about zero is Rayleigh distributed
    assert standing[0, ACTIONS.index("standing")] == pytest.approx(1 - np.exp(-(0.5**2) / (2 * 0.4**2)), abs=0.08)


# ---- the learned classifier

LEARNED = ClassificationSettings(method="learned")


def seen(tracks: Tracks, segments: Segments, times: int = 20, ego: Ego = Ego(speed_mps=0.0)) -> Tracks:  # noqa: B008
    """Tracks after their segment was seen so often, ten times a second."""
    for k in range(times):
        now = dataclasses.replace(tracks, time_s=0.1 * k, segment=np.array([1]))
        tracks = classify(now, ego, LEARNED, segments)
    return tracks


def test_every_method_gives_probabilities_and_leaves_tentative_tracks_unknown() -> None:
    for method in CLASSIFICATION:
        settings = ClassificationSettings(method=method)  # type: ignore[arg-type]
        for status in TrackStatus:
            row = classify(track(status=status), Ego(), settings, segments_of())
            assert row.class_probability.sum() == pytest.approx(1.0)
            if status != TrackStatus.CONFIRMED:
                assert row[0].class_name == "unknown"


def test_the_trees_know_a_driving_car_and_a_walking_person() -> None:
    car = {
        "size_m": np.array([[1.5, 1.8, 1.4]]),
        "n_pixels": np.array([900]),
        "box": np.array([[50, 50, 80, 92]]),
        "position_m": np.array([[8.5, 0.0, 0.75]]),
        "profile": profile_of((0.8, 0.85, 1.0, 0.95), (0.8, 0.85, 1.0, 0.7), (0.7, 0.6, -0.4, -0.4)),
        "surface": np.array([[0.05, 0.17, 0.0, 0.01, 0.04, -0.02, 0.73, 1.3]]),
    }
    driving = track()
    driving.state[0, 1] = 6.0
    assert seen(driving, segments_of(**car))[0].class_name == "vehicle"
    person = segments_of(  # whose limbs do not swing
        profile=profile_of((0.4, 0.9, 0.75, 0.6), (0.4, 0.9, 0.7, 0.5)),
        surface=np.array([[0.06, 0.3, -0.04, 0.37, 0.1, -0.35, 0.49, 1.2]]),
    )
    walking = seen(track(lateral_mps=1.3, sigma_mps=0.05), person)[0]
    assert walking.class_probability[CLASSES.index("vru")] > 3 * walking.class_probability[[2, 3]].max()


def test_the_memory_holds_running_means_and_a_frame_counts_once() -> None:
    tracks = dataclasses.replace(track(), time_s=0.0)
    ones, twos = segments_of(), segments_of(size_m=np.array([[0.3, 1.0, 1.7]]))
    once = classify(tracks, Ego(speed_mps=0.0), LEARNED, ones)
    again = classify(once, Ego(speed_mps=0.0), LEARNED, twos)  # the same time: a frame that was refused
    np.testing.assert_array_equal(once.class_memory, again.class_memory)
    later = classify(dataclasses.replace(once, time_s=0.1), Ego(speed_mps=0.0), LEARNED, twos)
    assert later.class_memory is not None
    mean = later.class_memory[0, MEMORY.index("log_width")]
    assert mean == pytest.approx((np.log(0.5) + np.log(1.0)) / 2)
    variance = later.class_memory[0, MEMORY.index("log_width_variance")]
    assert variance == pytest.approx(np.var([np.log(0.5), np.log(1.0)]))
    assert later.class_memory[0, MEMORY.index("log_width_now")] == 0.0
    unseen = classify(dataclasses.replace(later, time_s=0.2, segment=np.array([0])), Ego(), LEARNED, ones)
    np.testing.assert_array_equal(unseen.class_memory, later.class_memory)


def test_what_once_moved_for_sure_is_remembered_and_an_unknown_own_speed_proves_nothing() -> None:
    moving, still = track(lateral_mps=1.4, sigma_mps=0.1), track()
    tracks = seen(moving, segments_of(), 2)
    tracks = seen(dataclasses.replace(tracks, state=still.state), segments_of(), 5)
    assert tracks.class_memory is not None
    assert tracks.class_memory[0, MEMORY.index("moved_mps")] == pytest.approx(1.2)
    unmeasured = seen(moving, segments_of(), 2, Ego())
    assert unmeasured.class_memory is not None
    assert unmeasured.class_memory[0, MEMORY.index("moved_mps")] == 0.0


def test_unknown_is_said_below_the_probability_that_is_asked_for() -> None:
    for below in (0.5, 0.85, 0.97):
        settings = dataclasses.replace(LEARNED, unknown_below=below)
        assert is_resolved(observe(track(), Ego(speed_mps=0.0), segments_of())[1][0])
        tracks = dataclasses.replace(track(), time_s=0.0)
        row = classify(tracks, Ego(speed_mps=0.0), settings, segments_of())
        most = float(probabilities(observe(tracks, Ego(speed_mps=0.0), segments_of())[1], load_model()).max())
        assert (row[0].class_name == "unknown") == (most < below)


def leaf_model() -> Model:
    """Three stumps: wide things are vehicles, others road users."""
    wide = FEATURES.index("log_width")
    return Model(
        feature=np.array([wide, -1, -1, wide, -1, -1, -1]),
        threshold=np.array([0.0] * 7),
        left=np.array([1, 0, 0, 4, 0, 0, 0]),
        right=np.array([2, 0, 0, 5, 0, 0, 0]),
        value=np.array([0.0, 2.0, -2.0, 0.0, -2.0, 2.0, 0.0]),
        roots=np.array([0, 3, 6]),
        base=np.zeros(3),
        temperature=2.0,
    )


def test_a_model_comes_back_from_its_file_and_says_what_its_trees_say(tmp_path: Path) -> None:
    save_model(leaf_model(), tmp_path / "m.npz")
    features = np.zeros((2, len(FEATURES)))
    features[1, FEATURES.index("log_width")] = 0.1
    votes = np.exp(np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]]))
    told = probabilities(features, load_model(str(tmp_path / "m.npz")))
    np.testing.assert_allclose(told, votes / votes.sum(axis=1, keepdims=True), rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"roots": np.array([0, 3])}, "its trees are broken"),
        ({"left": np.array([0, 0, 0, 4, 0, 0, 0])}, "its trees are broken"),
        ({"feature": np.array([99, -1, -1, 0, -1, -1, -1])}, "its trees are broken"),
        ({"threshold": np.zeros(2)}, "its trees are broken"),
        ({"temperature": 0.0}, "its temperature above 0"),
        ({"base": np.array([0.0, np.nan, 0.0])}, "must be finite"),
    ],
)
def test_a_broken_model_is_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    save_model(dataclasses.replace(leaf_model(), **change), tmp_path / "m.npz")
    with pytest.raises(DataError, match=message):
        load_model(str(tmp_path / "m.npz"))


def test_a_file_that_is_no_model_is_refused_with_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot read the model"):
        load_model(str(tmp_path / "absent.npz"))
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(DataError, match="`rangecam train` writes one"):
        load_model(str(tmp_path / "text.npz"))
    np.savez(tmp_path / "other.npz", names=np.array(["a"]))
    with pytest.raises(DataError, match="it lacks feature, threshold"):
        load_model(str(tmp_path / "other.npz"))
    save_model(leaf_model(), tmp_path / "old.npz")
    with np.load(tmp_path / "old.npz") as old:
        np.savez(tmp_path / "older.npz", **{**old, "names": np.array(["size"])})
    with pytest.raises(DataError, match="other features"):
        load_model(str(tmp_path / "older.npz"))
