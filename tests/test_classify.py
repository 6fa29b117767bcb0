"""Classes: the examples of the thesis, what it owns up to, and that probabilities are probabilities."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangecam.classify import ClassificationSettings, classify
from rangecam.types import CLASSES, Ego, Segments, Track, Tracks, TrackStatus

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
