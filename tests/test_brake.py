"""The brake rule: stopping distances of the thesis, its truth table, and what the decision makes of tracks."""

import dataclasses
import itertools
import math
import typing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangecam.brake import DecisionSettings, decide
from rangecam.brake.decision import _reason, _threat, closing_speed
from rangecam.brake.rule import (
    RULES,
    Threat,
    full_deceleration,
    is_object,
    keeps_braking,
    must_brake,
    needed_deceleration,
    stopping_distance,
)
from rangecam.collision import CorridorSettings, InPath
from rangecam.tracking import TrackingSettings, update_tracks
from rangecam.types import MEMORY, Decision, Ego, Segments, Tracks, TrackStatus

MODEL_CAR = DecisionSettings()


def tracks_of(*rows: dict[str, float]) -> Tracks:
    """Confirmed tracks: x, vx, y, vy and the like of each; what is not named is that of a box seen well."""
    n = len(rows)
    usual = {"x": 5.0, "vx": 0.0, "y": 0.0, "vy": 0.0, "sigma_v": 0.05, "width": 0.4, "near": 0.0, "pixels": 200.0}
    usual |= {"status": float(TrackStatus.CONFIRMED), "depth": 0.3, "class": 0.0}
    usual |= {"age": 9.0, "hits": 9.0, "nis": 1.0}
    column = {key: np.array([row.get(key, value) for row in rows]) for key, value in usual.items()}
    state, covariance = np.zeros((n, 9)), np.zeros((n, 9, 9))
    for place, key in ((0, "x"), (1, "vx"), (3, "y"), (4, "vy")):
        state[:, place] = column[key]
    for place in (0, 3, 6):
        covariance[:, place, place] = 1e-4
        covariance[:, place + 1, place + 1] = column["sigma_v"] ** 2
    return Tracks(
        track_id=np.arange(1, n + 1),
        status=column["status"].astype(int),
        state=state,
        covariance=covariance,
        age=column["age"].astype(int),
        hits=column["hits"].astype(int),
        misses=np.zeros(n, int),
        size_m=np.column_stack([column["depth"], column["width"], np.full(n, 0.5)]),
        near_offset_m=column["near"],
        n_pixels=column["pixels"],
        segment=np.arange(1, n + 1),
        class_probability=np.eye(4)[column["class"].astype(int)],
        nis=column["nis"],
        mode_probability=np.ones((n, 0)),
        mode_state=np.ones((n, 0, 9)),
        mode_covariance=np.ones((n, 0, 9, 9)),
        time_s=2.5,
        next_id=n + 1,
    )


def decided(*rows: dict[str, float], ego: Ego | None = None, **settings: typing.Any) -> Decision:
    return decide(tracks_of(*rows), ego or Ego(), dataclasses.replace(MODEL_CAR, **settings))


# -- stopping ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kmh", "way_m"), [(10, 0.562), (20, 2.247), (30, 5.056), (50, 14.046)])
def test_braking_distances_of_the_thesis_on_asphalt(kmh: float, way_m: float) -> None:
    settings = DecisionSettings(friction=0.7, reaction_time_s=0.0)
    assert stopping_distance(kmh / 3.6, 0.0, settings) == pytest.approx(way_m, abs=5e-4)


def in_path(**changed: float) -> InPath:
    """A track in the path, 2 m ahead, that comes closer at 1 m/s."""
    usual = dict.fromkeys(InPath._fields, 0.0) | {"distance_m": 2.0, "speed_x_mps": -1.0, "hits": 9.0, "age": 9.0}
    return InPath(**{**usual, **changed})


def test_the_rules_are_told_how_a_track_closes_in_and_how_hard_it_surely_brakes() -> None:
    settings = DecisionSettings(deceleration_mps2=3.0, speed_sigmas=2.0)
    threat = _threat(in_path(covariance=0.01, distance_sigma_m=0.1, speed_sigma_mps=0.2), None, settings)
    assert threat == Threat(2.0, 1.0, 0.0, 1.0, 0.1, 0.2, -0.01, 0.0, 0.0, 9.0, 9.0)
    for acceleration, sigma, certain in ((-2.0, 0.5, 1.0), (-9.0, 0.5, 3.0), (-1.0, 0.5, 0.0), (2.0, 0.0, 0.0)):
        brakes = {"acceleration_mps2": acceleration, "acceleration_sigma_mps2": sigma}
        assert _threat(in_path(**brakes), None, settings).braking_mps2 == certain
        assert _threat(in_path(speed_x_mps=0.0, **brakes), None, settings).braking_mps2 == 0.0


def test_a_reason_says_what_speaks_against_braking_only_where_there_is_too_little_way() -> None:
    settings = DecisionSettings(deceleration_mps2=2.0, reaction_time_s=0.5, margin=1.5, min_speed_mps=0.5)
    few, enough = "but it is seen with 0 pixels only", Threat(3.0, 2.0, 800.0)
    for distance_m, told in ((3.0, False), (2.9, True)):  # stopping from 2 m/s takes 2 m
        assert (few in _reason("box", Threat(distance_m, 2.0, 0.0), 2.0, 2.0, True, settings)) is told
    for own_mps, slow in ((0.5, True), (0.6, False)):
        assert ("but we are slow" in _reason("box", enough, 3.0, own_mps, True, settings)) is slow


@pytest.mark.parametrize(
    ("speed", "way_m"), [(1.0, 0.403), (2.0, 1.146), (3.0, 2.229), (4.0, 3.652), (20 / 3.6, 6.540)]
)
def test_stopping_distances_of_the_model_car(speed: float, way_m: float) -> None:
    assert stopping_distance(speed, 0.0, MODEL_CAR) == pytest.approx(way_m, abs=6e-4)


def test_the_reaction_takes_four_frames_and_the_brakes() -> None:
    assert MODEL_CAR.reaction_time_s == pytest.approx(0.2333, abs=1e-4)


def test_the_speed_from_which_braking_takes_longer_than_a_human_reaction() -> None:
    settings = DecisionSettings(friction=0.7, reaction_time_s=1.5)
    speed = 74.2 / 3.6
    assert stopping_distance(speed, 0.0, settings) == pytest.approx(2 * speed * 1.5, rel=1e-3)


def test_a_deceleration_replaces_friction() -> None:
    settings = DecisionSettings(deceleration_mps2=5.0, friction=0.1)
    assert full_deceleration(settings) == 5.0
    assert full_deceleration(MODEL_CAR) == pytest.approx(0.3 * 9.81)
    assert stopping_distance(10.0, 0.0, settings) == pytest.approx(10 * settings.reaction_time_s + 10.0)


def closest(gap_m: float, own_mps: float, ahead_mps: float, ahead_brakes: bool, settings: DecisionSettings) -> float:
    """Smallest gap while we brake fully after the reaction and the object ahead brakes at once or never."""
    t = np.linspace(0, 30, 60_001)
    brake = full_deceleration(settings)
    ours = np.clip(own_mps - brake * np.maximum(t - settings.reaction_time_s, 0), 0, None)
    theirs = np.clip(ahead_mps - brake * t, 0, None) if ahead_brakes else np.full_like(t, ahead_mps)
    theirs = np.where(ours > 0, theirs, 0.0) if not ahead_brakes else theirs
    step = np.diff(t)
    gap = gap_m + np.cumsum((theirs[1:] - ours[1:] + theirs[:-1] - ours[:-1]) / 2 * step)
    return float(gap.min())


@pytest.mark.parametrize("own", [2.0, 5.0, 14.0])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 1.0, -0.5])
def test_from_the_stopping_distance_on_a_simulated_stop_ends_just_before_the_object(own: float, share: float) -> None:
    settings = DecisionSettings(friction=0.7)
    way_m = stopping_distance(own, share * own, settings)
    assert closest(way_m, own, share * own, share >= 0, settings) == pytest.approx(0.0, abs=0.01)


def test_behind_a_car_as_fast_as_we_only_the_reaction_takes_way() -> None:
    assert stopping_distance(10.0, 10.0, MODEL_CAR) == pytest.approx(10 * MODEL_CAR.reaction_time_s)


def test_behind_a_braking_car_braking_begins_while_it_still_helps() -> None:
    settings, gap, ahead = DecisionSettings(friction=0.7, reaction_time_s=0.18), 18.0, 14.0
    while not must_brake(Threat(gap, 14 - ahead, 500.0), 14.0, True, settings):
        gap, ahead = gap - (14 - ahead) * 0.02, ahead - 0.02 * full_deceleration(settings)
    assert closest(gap, 14.0, ahead, True, settings) > 1.0
    assert gap < 17.0


@given(st.floats(0.1, 20.0))
def test_the_needed_deceleration_at_the_stopping_distance_is_full_braking(speed: float) -> None:
    way_m = stopping_distance(speed, 0.0, MODEL_CAR)
    assert needed_deceleration(way_m, speed, MODEL_CAR) == pytest.approx(full_deceleration(MODEL_CAR))


def test_within_the_reaction_no_deceleration_is_enough_and_without_closing_none_is_needed() -> None:
    assert needed_deceleration(0.2, 1.0, MODEL_CAR) == math.inf
    assert needed_deceleration(1.0 * MODEL_CAR.reaction_time_s, 1.0, MODEL_CAR) == math.inf
    assert needed_deceleration(0.2, 0.0, MODEL_CAR) == 0.0
    assert needed_deceleration(-1.0, -1.0, MODEL_CAR) == 0.0


# -- the rule ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("over_min_area", [True, False])
@pytest.mark.parametrize("over_large", [True, False])
@pytest.mark.parametrize("over_small", [True, False])
@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("forward", [True, False])
def test_the_truth_table_of_algorithm_4_4(
    near: bool, over_min_area: bool, over_large: bool, over_small: bool, fast: bool, forward: bool
) -> None:
    pixels = 100.0
    settings = dataclasses.replace(
        MODEL_CAR,
        min_object_m=0.1 if over_min_area else 10.0,  # at 2 m: 33 pixels, or 330,000
        large_object_px=99.0 if over_large else 101.0,
        min_object_px=99.0 if over_small else 101.0,
        min_speed_mps=2.9 if fast else 3.0,
    )
    way_m = 1.5 * stopping_distance(3.0, 0.0, settings) + (-1e-9 if near else 1e-9)
    demanded = must_brake(Threat(way_m, 3.0, pixels), 3.0, forward, settings)
    assert demanded == (near and (over_min_area or over_large) and over_small and fast and forward)


@pytest.mark.parametrize(
    ("distance", "pixels"), [(0.3, 1459.0), (0.5, 525.2), (1.0, 131.3), (2.0, 32.8), (3.0, 14.6), (4.0, 8.2)]
)
def test_the_least_area_is_that_of_a_square_of_ten_centimetres(distance: float, pixels: float) -> None:
    settings = dataclasses.replace(MODEL_CAR, min_object_px=0.0, large_object_px=1e9)
    assert is_object(Threat(distance, 1.0, pixels + 0.06), settings)
    assert not is_object(Threat(distance, 1.0, pixels - 0.06), settings)


def test_at_contact_only_a_large_object_is_one() -> None:
    assert is_object(Threat(0.0, 1.0, 751.0), MODEL_CAR)
    assert not is_object(Threat(0.0, 1.0, 749.0), MODEL_CAR)


def test_the_margin_stretches_the_stopping_distance() -> None:
    threat = Threat(1.2 * stopping_distance(3.0, 0.0, MODEL_CAR), 3.0, 500.0)
    assert must_brake(threat, 3.0, True, MODEL_CAR)
    assert not must_brake(threat, 3.0, True, dataclasses.replace(MODEL_CAR, margin=1.1))


@pytest.mark.parametrize("name", sorted(RULES))
def test_no_rule_brakes_for_what_is_far_or_not_closing(name: str) -> None:
    assert not RULES[name](Threat(1e3, 3.0, 500.0), 3.0, True, MODEL_CAR)
    assert not RULES[name](Threat(1.0, 0.0, 500.0), 3.0, True, MODEL_CAR)


def test_every_rule_can_be_chosen_by_name() -> None:
    assert set(typing.get_args(typing.get_type_hints(DecisionSettings)["rule"])) == set(RULES)


# -- which speed counts -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vx", "sigma", "own", "closing"),
    [
        (-3.0, 0.1, None, 3.0),
        (-3.0, 1.6, None, 0.0),  # may as well be at rest
        (2.0, 0.1, None, 0.0),
        (-2.9, 0.1, 3.0, 3.0),  # a standing object: the own speed is known better
        (0.0, 5.0, 3.0, 0.0),  # a new track: it may as well drive ahead of us
        (0.0, 0.1, 3.0, 0.0),  # drives ahead of us
        (-1.0, 0.1, 3.0, 1.0),  # drives ahead more slowly
        (-6.0, 0.1, 3.0, 6.0),  # comes towards us
        (1.0, 0.1, 3.0, 0.0),
    ],
)
def test_the_closing_speed(vx: float, sigma: float, own: float | None, closing: float) -> None:
    assert closing_speed(vx, sigma, own, MODEL_CAR) == closing


def test_how_sure_a_speed_must_be_can_be_set() -> None:
    assert closing_speed(-3.0, 1.6, None, dataclasses.replace(MODEL_CAR, speed_sigmas=1.0)) == 3.0


# -- the decision -----------------------------------------------------------------------------------------------------


def test_a_box_in_the_path_is_braked_for_and_the_decision_says_why() -> None:
    decision = decided({"x": 2.5, "vx": -3.0, "near": 0.2, "class": 3.0}, ego=Ego(speed_mps=3.0))
    assert decision.brake
    assert decision.reason == "obstacle at 2.3 m closing at 3.0 m/s: stopping needs 2.2 m"
    assert (decision.track_id, decision.time_s) == (1, 2.5)
    assert decision.distance_m == pytest.approx(2.3)
    assert decision.closing_speed_mps == 3.0
    assert decision.stopping_distance_m == pytest.approx(stopping_distance(3.0, 0.0, MODEL_CAR))
    assert decision.needed_deceleration_mps2 == pytest.approx(9 / 2 / (2.3 - 3 * MODEL_CAR.reaction_time_s))
    assert decision.ttc_s == pytest.approx(2.3 / 3)
    assert decision.ttc_sigma_s > 0
    assert decision.p_collision > 0.9
    assert len(decision.collisions) == 1


def test_where_nobody_measures_the_own_speed_the_closing_speed_decides() -> None:
    row = {"x": 2.3, "vx": -3.0}
    for ego in (Ego(), Ego(speed_mps=math.nan)):
        assert decided(row, ego=ego).brake
    assert not decided({"x": 2.3, "vx": -0.4}).brake
    assert decided({"x": 0.1, "vx": -0.6, "pixels": 800.0}).brake
    assert not decided({"x": 0.1, "vx": -0.5, "pixels": 800.0}).brake  # slow


def test_where_the_friction_is_known_it_replaces_that_of_the_settings() -> None:
    row = {"x": 2.5, "vx": -3.0, "near": 0.2}
    usual, slippery = (decided(row, ego=Ego(speed_mps=3.0, friction=each)) for each in (None, 0.1))
    assert usual.stopping_distance_m < slippery.stopping_distance_m
    told = decided(row, ego=Ego(speed_mps=3.0), friction=0.1, deceleration_mps2=None)
    assert slippery.stopping_distance_m == told.stopping_distance_m


@pytest.mark.parametrize(
    ("row", "ego", "ending"),
    [
        ({"x": 2.3, "vx": -3.0, "pixels": 9.0}, Ego(speed_mps=3.0), ", but it is seen with 9 pixels only"),
        ({"x": 2.3, "vx": -3.0, "hits": 5.0}, Ego(speed_mps=3.0), ", but it was seen in 5 of 9 frames only"),
        ({"x": 2.3, "vx": -3.0}, Ego(speed_mps=3.0, forward=False), ", but we drive backwards"),
        ({"x": 0.2, "vx": -1.0, "pixels": 800.0}, Ego(speed_mps=0.3), ", but we are slow"),
        ({"x": 8.0, "vx": -3.0}, Ego(speed_mps=3.0), "stopping needs 2.2 m"),
        ({"x": 2.3, "vx": 0.0}, Ego(speed_mps=3.0), "object at 2.3 m, not closing"),
    ],
)
def test_what_speaks_against_braking_is_said(row: dict[str, float], ego: Ego, ending: str) -> None:
    decision = decided(row, ego=ego)
    assert not decision.brake
    assert decision.track_id == 1
    assert decision.reason.endswith(ending)


@pytest.mark.parametrize(
    "row",
    [
        {"x": 2.3, "vx": -3.0, "y": 0.6},  # beside the path
        {"x": 2.3, "vx": -3.0, "status": float(TrackStatus.TENTATIVE)},
        {"x": -0.4, "vx": -3.0},  # behind us
    ],
)
def test_what_is_not_in_the_path_does_not_count(row: dict[str, float]) -> None:
    decision = decided(row, ego=Ego(speed_mps=3.0))
    assert (decision.brake, decision.track_id, decision.reason) == (False, 0, "no object in the path")
    assert math.isnan(decision.distance_m)
    assert len(decision.collisions) == 1


def test_without_tracks_the_path_is_free() -> None:
    decision = decide(Tracks.empty(), Ego(), MODEL_CAR)
    assert (decision.brake, decision.reason) == (False, "no object in the path")


def test_a_confirmed_track_counts_while_it_coasts() -> None:
    assert decided({"x": 2.3, "vx": -3.0, "status": float(TrackStatus.COASTING)}).brake


def test_one_who_walks_into_the_path_counts_before_he_is_in_it() -> None:
    walker = {"x": 3.0, "vx": -3.0, "y": -1.2, "vy": 1.2, "sigma_v": 0.1}
    assert decided(walker, ego=Ego(speed_mps=3.0)).brake
    assert not decided(walker, ego=Ego(speed_mps=3.0), min_probability=1.0).brake
    assert not decided({**walker, "vy": 0.0}, ego=Ego(speed_mps=3.0)).brake


@pytest.mark.parametrize(("hits", "age"), [(6.0, 9.0), (9.0, 9.0), (10.0, 90.0)])
def test_what_is_seen_most_of_the_time_or_has_been_for_long_is_braked_for(hits: float, age: float) -> None:
    assert decided({"x": 2.3, "vx": -3.0, "hits": hits, "age": age}, ego=Ego(speed_mps=3.0)).brake


def test_how_often_an_object_must_be_seen_can_be_set() -> None:
    flicker = {"x": 2.3, "vx": -3.0, "hits": 5.0}
    assert decided(flicker, ego=Ego(speed_mps=3.0), min_seen=0.5).brake
    assert decided(flicker, ego=Ego(speed_mps=3.0), sure_hits=5).brake


WALKER = {"x": 3.0, "vx": -3.0, "y": -1.2, "vy": 1.2, "sigma_v": 0.2}


@pytest.mark.parametrize(
    "doubt",
    [
        {"sigma_v": 0.5},  # as if it stood, within three standard deviations
        {"nis": 15.0},  # its innovations say that the speed is less certain
        {"hits": 5.0, "age": 5.0},
        {"hits": 11.0, "age": 20.0},  # it comes and goes
        {"status": float(TrackStatus.COASTING)},
    ],
)
def test_what_is_beside_the_path_must_have_been_seen_to_move_into_it(doubt: dict[str, float]) -> None:
    ego, trusting = Ego(speed_mps=3.0), CorridorSettings(crossing_sigmas=0.0, crossing_hits=0, crossing_share=0.0)
    assert decided(WALKER, ego=ego).brake
    doubtful = decided({**WALKER, **doubt}, ego=ego)
    assert (doubtful.brake, doubtful.reason) == (False, "no object in the path")
    in_path = decided({**WALKER, **doubt, "y": 0.0, "vy": 0.0}, ego=ego)
    assert in_path.brake
    if "status" not in doubt:
        assert decided({**WALKER, **doubt}, ego=ego, corridor=trusting, min_probability=0.3).brake


def test_where_a_part_is_hidden_the_corridor_counts_what_the_position_is_the_middle_of() -> None:
    car = tracks_of({"x": 2.3, "vx": -3.0, "y": 0.8, "width": 1.8})
    assert decide(car, Ego(speed_mps=3.0), MODEL_CAR).brake
    memory = np.zeros((1, len(MEMORY)))
    memory[0, MEMORY.index("placed_width")] = 0.4
    assert not decide(dataclasses.replace(car, memory=memory), Ego(speed_mps=3.0), MODEL_CAR).brake


def test_what_is_not_seen_does_not_drift_into_the_path() -> None:
    at_the_edge = {"x": 2.3, "vx": -3.0, "y": 0.48, "status": float(TrackStatus.COASTING)}
    assert not decided(at_the_edge, ego=Ego(speed_mps=3.0)).brake
    assert decided({**at_the_edge, "status": float(TrackStatus.CONFIRMED)}, ego=Ego(speed_mps=3.0)).brake
    assert decided({**at_the_edge, "y": 0.46}, ego=Ego(speed_mps=3.0)).brake


def test_our_own_bend_takes_us_to_what_stands_beside_the_way() -> None:
    yaw_rate, x, y = 0.8, 2.2, 0.75
    stands = {"x": x, "vx": -3.0 + yaw_rate * y, "y": y, "vy": -yaw_rate * x}
    assert decided(stands, ego=Ego(speed_mps=3.0, yaw_rate_radps=yaw_rate)).brake
    turned_away = {**stands, "vx": -3.0 - yaw_rate * y, "vy": yaw_rate * x}
    assert not decided(turned_away, ego=Ego(speed_mps=3.0, yaw_rate_radps=-yaw_rate)).brake


def test_the_corridor_can_be_widened_and_moved_to_the_bumper() -> None:
    wide, bumper = CorridorSettings(width_m=1.2), CorridorSettings(front_m=1.0)
    assert decided({"x": 2.3, "vx": -3.0, "y": 0.6}, corridor=wide).brake
    assert decided({"x": 4.2, "vx": -3.0}, corridor=bumper).distance_m == pytest.approx(3.2)
    assert decided({"x": 4.2, "vx": -3.0}, corridor=bumper).brake


def test_the_nearest_that_demands_braking_decides_else_the_nearest() -> None:
    sign, box, wall = {"x": 1.0, "vx": -3.0, "pixels": 8.0}, {"x": 2.3, "vx": -3.0}, {"x": 3.0, "vx": -3.0}
    for rows in itertools.permutations([sign, box, wall]):
        decision = decided(*rows)
        assert decision.brake
        assert decision.distance_m == pytest.approx(2.3)
    assert decided({"x": 9.0, "vx": -3.0}, {"x": 8.0, "vx": -3.0}).distance_m == pytest.approx(8.0)


def test_contact_is_braked_for_at_any_speed_above_the_least() -> None:
    decision = decided({"x": 0.0, "near": 0.1, "vx": -0.6, "pixels": 800.0})
    assert decision.brake
    assert decision.needed_deceleration_mps2 == math.inf


@pytest.mark.parametrize("confirm_hits", [1, 2])
def test_the_velocity_of_a_track_of_one_frame_cannot_brake(confirm_hits: int) -> None:
    position = np.array([[1.0, 0.0, 0.3]])
    segments = Segments(
        label=np.array([1]),
        position_m=position,
        covariance_m2=1e-4 * np.eye(3)[None],
        size_m=np.full((1, 3), 0.5),
        near_m=position[:, 0] - 0.2,
        n_pixels=np.array([900]),
        box=np.zeros((1, 4), int),
        range_m=position[:, 0],
        sigma_range_m=np.array([0.01]),
        amplitude=np.ones(1),
        cut=np.zeros(1, np.uint8),
        nearest_m=position - [0.2, 0.0, 0.0],
    )
    tracks = update_tracks(Tracks.empty(), segments, 0.0, TrackingSettings(confirm_hits=confirm_hits))
    assert not decide(tracks, Ego(), MODEL_CAR).brake


@given(
    st.floats(0.05, 10),
    st.floats(0.0, 8.0),
    st.floats(-1, 1),
    st.floats(0, 2000),
)
def test_without_knowledge_of_the_own_speed_a_nearer_object_is_never_less_dangerous(
    x: float, speed: float, y: float, pixels: float
) -> None:
    row = {"x": x, "vx": -speed, "y": y, "pixels": pixels}
    settings = {"min_object_m": 1e-6}
    if decided(row, **settings).brake:
        assert decided({**row, "x": 0.8 * x}, **settings).brake


def test_inputs_are_not_modified() -> None:
    tracks = tracks_of({"x": 2.3, "vx": -3.0}, {"x": 1.0})
    before = {k: v.copy() for k, v in vars(tracks).items() if isinstance(v, np.ndarray)}
    decide(tracks, Ego(speed_mps=3.0), MODEL_CAR)
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(tracks, name), values)


# -- exactly at the limits --------------------------------------------------------------------------------------------


EXACT = dataclasses.replace(MODEL_CAR, margin=1.0, deceleration_mps2=2.0, reaction_time_s=0.5, large_object_px=750.0)


def test_a_way_that_is_just_long_enough_demands_nothing() -> None:
    assert stopping_distance(2.0, 0.0, EXACT) == 2.0
    assert not must_brake(Threat(2.0, 2.0, 900.0), 2.0, True, EXACT)
    assert must_brake(Threat(1.999, 2.0, 900.0), 2.0, True, EXACT)


def test_as_many_pixels_as_are_asked_for_are_not_yet_more() -> None:
    pitch_deg = 0.5
    side_m = 4 * math.radians(pitch_deg)  # 4 x 4 pixels at 1 m
    settings = dataclasses.replace(EXACT, pixel_pitch_deg=pitch_deg, min_object_m=side_m, min_object_px=3.0)
    assert not is_object(Threat(1.0, 1.0, 16.0), settings)
    assert is_object(Threat(1.0, 1.0, 17.0), settings)
    assert not is_object(Threat(0.0, 1.0, 750.0), settings)
    strict = dataclasses.replace(settings, min_object_px=17.0)
    assert not is_object(Threat(1.0, 1.0, 17.0), strict)


def test_a_demand_ends_when_no_more_than_the_share_is_needed() -> None:
    settings = dataclasses.replace(EXACT, deceleration_mps2=4.0, release_share=0.5)
    assert not keeps_braking(Threat(1.0, 2.0, 900.0), settings)
    assert keeps_braking(Threat(0.999, 2.0, 900.0), settings)


def test_at_the_end_of_the_range_nothing_counts_and_as_often_as_is_asked_is_often_enough() -> None:
    settings = dataclasses.replace(EXACT, range_m=2.5, margin=2.0, min_seen=0.5, sure_hits=10, deceleration_mps2=1.0)
    for distance_m, brakes in ((2.5, False), (2.49, True)):
        assert must_brake(Threat(distance_m, 2.0, 900.0), 2.0, True, settings) == brakes
    for hits, brakes in ((4.0, True), (3.9, False)):
        assert must_brake(Threat(2.0, 2.0, 900.0, hits=hits, age=8.0), 2.0, True, settings) == brakes


def test_what_comes_up_to_a_car_that_has_stopped_for_it_does_not_brake_it() -> None:
    row = {"x": 1.0, "vx": -2.0}
    stands, rolls = (Ego(speed_mps=speed, braking=True) for speed in (0.0, 0.1))
    slow = {"min_speed_mps": 0.5}
    assert not decided(row, ego=stands, **slow).brake
    assert decided(row, ego=rolls, **slow).brake
    assert not decided(row, ego=Ego(speed_mps=0.1), **slow).brake
    assert not decided({"x": 4.0, "vx": -0.3}, ego=rolls, **slow).brake


def test_what_stands_at_contact_needs_no_deceleration() -> None:
    assert needed_deceleration(0.0, 0.0, EXACT) == 0.0


def test_a_closing_speed_at_the_limit_of_what_is_certain_is_none_and_that_of_a_standing_object_ours() -> None:
    settings = dataclasses.replace(EXACT, speed_sigmas=2.0)
    assert closing_speed(-2.0, 1.0, None, settings) == 0.0
    assert closing_speed(-2.5, 0.25, 3.0, settings) == 3.0
    assert closing_speed(-2.5, 0.25, 3.01, settings) == 2.5


def test_an_empty_scene_does_not_brake() -> None:
    decision = decided(ego=Ego(speed_mps=3.0))
    assert not decision.brake
    assert (decision.reason, decision.track_id) == ("no object in the path", 0)


def test_of_what_is_not_told_of_a_threat_nothing_speaks_against_braking() -> None:
    threat = Threat(1.0, 2.0, 900.0)
    assert math.isnan(threat.speed_mps)
    assert (threat.p_lateral, threat.hits, threat.age) == (1.0, math.inf, 1.0)
    assert (threat.distance_sigma_m, threat.speed_sigma_mps, threat.covariance, threat.braking_mps2) == (0.0,) * 4
