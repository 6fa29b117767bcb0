"""The rule collision_probability: its probability against Monte Carlo, whole manoeuvres, and what must not brake."""

import dataclasses
import math
import typing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rangecam.brake.decision import decide
from rangecam.brake.probability import lost_way, p_too_late
from rangecam.brake.rule import RULES, Threat, keeps_braking, must_brake_surely, stopping_distance, too_late
from rangecam.brake.settings import DecisionSettings, full_deceleration
from rangecam.config import load_config
from rangecam.types import Decision, Ego
from test_brake import MODEL_CAR, decided, tracks_of

SURE = dataclasses.replace(MODEL_CAR, rule="collision_probability")
EXACT = dataclasses.replace(SURE, deceleration_sigma=0.0, standstill_gap_m=0.0)


def simulated_loss(u: float, w: float, b: float, a: float, delay: float) -> float:
    """Largest loss of gap until we stand, by small steps."""
    t = np.linspace(0, delay + u / a, 40_001)
    ours = np.clip(u - a * np.maximum(t - delay, 0), 0, None)
    theirs = np.clip(w - b * t, 0, None) if w > 0 else np.full_like(t, w)
    lost = np.concatenate([[0], np.cumsum(((ours - theirs)[1:] + (ours - theirs)[:-1]) / 2 * np.diff(t))])
    return float(lost.max())


# -- the way that is lost ---------------------------------------------------------------------------------------------


@hypothesis_settings(deadline=None)
@given(st.floats(0.5, 20), st.floats(-10, 25), st.floats(0, 9), st.floats(1, 9), st.floats(0, 1))
def test_the_way_that_is_lost_is_that_of_the_whole_manoeuvre(u: float, w: float, b: float, a: float, t: float) -> None:
    assert lost_way(u, w, b, a, t) == pytest.approx(max(simulated_loss(u, w, b, a, t), 0), abs=2e-3)


@pytest.mark.parametrize("object_mps", [0.0, 1.0, -2.0])
def test_closed_forms_of_an_object_that_keeps_its_speed(object_mps: float) -> None:
    u, a, t, c = 3.0, 2.943, 0.25, 3.0 - object_mps
    expected = c * t + c * c / (2 * a) if object_mps >= 0 else u * t + u * u / (2 * a) - object_mps * (t + u / a)
    assert lost_way(u, object_mps, 0.0, a, t) == pytest.approx(expected)


def test_behind_an_object_that_brakes_as_we_do_the_loss_is_the_stopping_distance() -> None:
    a, t = full_deceleration(MODEL_CAR), MODEL_CAR.reaction_time_s
    assert lost_way(3.0, 2.0, a, a, t) == pytest.approx(stopping_distance(3.0, 2.0, MODEL_CAR))


def test_the_gap_may_be_smallest_before_both_stand() -> None:
    """A fast car ahead that brakes gently pulls away at the end: looking at the ends alone would miss the contact."""
    loss = lost_way(14.0, 12.0, 1.0, 6.0, 1.0)
    at_end = simulated_loss(14.0, 12.0, 1.0, 6.0, 1.0)
    t = 1.0 + 14.0 / 6.0
    end = 14.0 + 14.0**2 / 12.0 - (12 * t - t * t / 2)
    assert loss == pytest.approx(at_end, abs=1e-3)
    assert loss > 2.0 > end


def test_an_object_as_fast_as_we_that_keeps_going_takes_no_way() -> None:
    assert lost_way(10.0, 10.0, 0.0, 6.0, 0.3) == 0.0
    assert lost_way(10.0, 12.0, 0.0, 6.0, 0.3) == 0.0


# -- the probability --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("object_mps2", [0.0, 2.0])
@pytest.mark.parametrize("gap_m", [1.9, 2.2, 2.5])
@pytest.mark.parametrize("covariance", [-0.02, 0.0, 0.02])
def test_the_probability_of_being_too_late_is_that_of_monte_carlo(
    gap_m: float, covariance: float, object_mps2: float
) -> None:
    n, rng = 40_000, np.random.default_rng(2)
    spread, own = (0.15, 0.25, covariance), (3.0, 2.943, 0.3)
    cov = [[spread[0] ** 2, covariance], [covariance, spread[1] ** 2]]
    gaps, closing = rng.multivariate_normal([gap_m, 2.8], cov, n).T
    decelerations = np.maximum(rng.normal(own[1], own[2], n), own[1] / 10)
    late = np.mean(
        [g < lost_way(3.0, 3.0 - c, object_mps2, a, 0.25) for g, c, a in zip(gaps, closing, decelerations, strict=True)]
    )
    p = p_too_late(gap_m, 2.8, spread, object_mps2, own, 0.25)
    assert p == pytest.approx(late, abs=0.005 + 4 * 0.5 / math.sqrt(n))


def test_without_uncertainty_it_is_yes_or_no_at_the_way_that_is_lost() -> None:
    way = lost_way(3.0, 0.0, 0.0, 2.943, 0.25)
    exact = (0.0, 0.0, 0.0), 0.0, (3.0, 2.943, 0.0), 0.25
    assert p_too_late(way + 1e-6, 3.0, *exact) == 0.0
    assert p_too_late(way - 1e-6, 3.0, *exact) == pytest.approx(1.0)


def test_however_uncertain_our_deceleration_a_tenth_of_it_is_reckoned_with() -> None:
    exact, own = (0.0, 0.0, 0.0), (3.0, 2.943, 2.943 / 2)
    way = lost_way(3.0, 0.0, 0.0, 2.943 / 10, 0.25)
    assert p_too_late(way + 1e-6, 3.0, exact, 0.0, own, 0.25) == 0.0
    assert 0 < p_too_late(way - 1e-6, 3.0, exact, 0.0, own, 0.25) < 0.02


@pytest.mark.parametrize("closing_mps", [-1.0, 0.0])
def test_what_does_not_close_in_is_never_too_late_however_little_is_known_of_the_gap(closing_mps: float) -> None:
    assert p_too_late(0.01, closing_mps, (0.1, 0.0, 0.0), 0.0, (3.0, 2.943, 0.3), 0.25) == 0.0


@hypothesis_settings(deadline=None)
@given(st.floats(0.1, 10), st.floats(0.5, 8), st.floats(0, 1), st.floats(0, 2))
def test_a_nearer_object_is_never_less_late(gap: float, speed: float, sigma: float, speed_sigma: float) -> None:
    far, near = (p_too_late(g, speed, (sigma, speed_sigma, 0.0), 0.0, (speed, 3.0, 0.1), 0.3) for g in (gap, 0.9 * gap))
    assert 0 <= far <= near + 1e-12 <= 1 + 1e-9


# -- the rule ---------------------------------------------------------------------------------------------------------


def threat(distance_m: float, speed: float = 3.0, **uncertain: float) -> Threat:
    return Threat(distance_m, speed, 500.0, speed, **uncertain)


def test_it_brakes_in_the_last_frame_in_which_braking_still_avoids_the_collision() -> None:
    period = EXACT.frame_period_s
    last = lost_way(3.0, 0.0, 0.0, full_deceleration(EXACT), EXACT.reaction_time_s + period)
    assert must_brake_surely(threat(last - 1e-6), 3.0, True, EXACT)
    assert not must_brake_surely(threat(last + 1e-6), 3.0, True, EXACT)
    assert last - 3.0 * period == pytest.approx(stopping_distance(3.0, 0.0, EXACT))


@pytest.mark.parametrize("allowed", [0.02, 0.1, 0.3, 0.5])
def test_brakings_are_premature_as_often_as_is_stated(allowed: float) -> None:
    """Of many objects with an estimate at which the rule just brakes, that share could have been braked for later."""
    settings = dataclasses.replace(EXACT, false_brake_probability=allowed)
    uncertain = {"distance_sigma_m": 0.1, "speed_sigma_mps": 0.2, "covariance": 0.005}
    low, high = 0.1, 10.0
    for _ in range(50):
        middle = (low + high) / 2
        demanded = must_brake_surely(threat(middle, **uncertain), 3.0, True, settings)
        low, high = (middle, high) if demanded else (low, middle)
    rng, delay = np.random.default_rng(4), settings.reaction_time_s + settings.frame_period_s
    gap, speed = rng.multivariate_normal([low, 3.0], [[0.01, 0.005], [0.005, 0.04]], 20_000).T
    needed = np.array([lost_way(3.0, 3.0 - c, 0.0, full_deceleration(settings), delay) for c in speed])
    assert np.mean(gap > needed) == pytest.approx(allowed, abs=4 * math.sqrt(allowed * (1 - allowed) / 20_000))


@pytest.mark.parametrize(
    ("changed", "option"),
    [
        ({}, {"false_brake_probability": 0.4}),
        ({}, {"standstill_gap_m": 0.5}),
        ({}, {"frame_period_s": 0.2}),
        ({}, {"reaction_time_s": 0.4}),
        ({"braking_mps2": 2.0, "speed": 1.5}, {}),
    ],
)
def test_what_makes_it_brake_earlier(changed: dict[str, float], option: dict[str, float]) -> None:
    uncertain = {"distance_sigma_m": 0.1, "speed_sigma_mps": 0.1, **changed}
    speed = uncertain.pop("speed", 3.0)
    plain = {key: value for key, value in uncertain.items() if key != "braking_mps2"}
    reach = [d for d in np.arange(0.2, 6, 0.02) if must_brake_surely(threat(d, speed, **plain), 3.0, True, SURE)]
    settings = dataclasses.replace(SURE, **option)
    more = [d for d in np.arange(0.2, 6, 0.02) if must_brake_surely(threat(d, speed, **uncertain), 3.0, True, settings)]
    assert max(more) > max(reach) + 0.03


def test_an_uncertain_deceleration_makes_it_less_certain() -> None:
    way = lost_way(3.0, 0.0, 0.0, full_deceleration(SURE), SURE.reaction_time_s + SURE.frame_period_s)
    exact, rough = (dataclasses.replace(EXACT, deceleration_sigma=s) for s in (0.01, 0.3))
    assert too_late(threat(way - 0.1), 3.0, exact) > 0.99 > too_late(threat(way - 0.1), 3.0, rough) > 0.5


def test_one_who_may_pass_by_is_braked_for_only_as_surely_as_he_will_not() -> None:
    assert too_late(threat(1.0, p_lateral=0.6), 3.0, SURE) == pytest.approx(0.6, abs=0.01)
    assert not must_brake_surely(threat(1.0, p_lateral=0.6), 3.0, True, SURE)


# -- what must not brake, by every rule -------------------------------------------------------------------------------


def decided_by(rule: str, *rows: dict[str, float], ego: Ego, **settings: typing.Any) -> Decision:
    return decided(*rows, ego=ego, rule=rule, **settings)


@pytest.mark.parametrize("rule", sorted(RULES))
def test_both_rules_brake_for_a_wall_ahead(rule: str) -> None:
    assert decided_by(rule, {"x": 1.8, "vx": -3.0}, ego=Ego(speed_mps=3.0)).brake


@pytest.mark.parametrize("rule", sorted(RULES))
@pytest.mark.parametrize("own", [1.0, 3.0, 5.5])
@pytest.mark.parametrize("sigma", [0.05, 0.5, 4.0])
def test_a_car_ahead_at_our_speed_never_stops_us(rule: str, own: float, sigma: float) -> None:
    for gap in (0.3, 1.0, 3.0):
        row = {"x": gap, "vx": 0.0, "sigma_v": sigma, "pixels": 900.0}
        assert not decided_by(rule, row, ego=Ego(speed_mps=own)).brake


@pytest.mark.parametrize("rule", sorted(RULES))
@pytest.mark.parametrize("speed", [0.0, -3.0, -8.0])
def test_a_velocity_nobody_has_measured_does_not_brake(rule: str, speed: float) -> None:
    """As after its first frame: 0 +- 5 m/s, or any value that the noise of two frames gives."""
    row = {"x": 1.5, "vx": speed, "sigma_v": 5.0}
    assert not decided_by(rule, row, ego=Ego(speed_mps=3.0)).brake


@pytest.mark.parametrize("rule", sorted(RULES))
def test_an_acceleration_alone_does_not_brake(rule: str) -> None:
    settings = dataclasses.replace(MODEL_CAR, rule=rule)
    tracks = tracks_of({"x": 1.0, "vx": 0.0})
    tracks.state[0, 2], tracks.covariance[0, 2, 2] = -8.0, 0.01
    assert not decide(tracks, Ego(speed_mps=3.0), settings).brake


def test_a_sure_deceleration_counts_once_the_gap_shrinks() -> None:
    settings = dataclasses.replace(SURE, false_brake_probability=0.3)
    tracks = tracks_of({"x": 1.2, "vx": -1.0, "sigma_v": 0.1})
    assert not decide(tracks, Ego(speed_mps=3.0), settings).brake
    tracks.state[0, 2], tracks.covariance[0, 2, 2] = -3.0, 0.04
    assert decide(tracks, Ego(speed_mps=3.0), settings).brake
    tracks.covariance[0, 2, 2] = 4.0
    assert not decide(tracks, Ego(speed_mps=3.0), settings).brake


@pytest.mark.parametrize("rule", sorted(RULES))
def test_nothing_beyond_the_range_of_the_camera_brakes(rule: str) -> None:
    row = {"x": 6.3, "vx": -5.56, "pixels": 900.0}
    near = decided_by(rule, row, ego=Ego(speed_mps=5.56), range_m=6.4, standstill_gap_m=1.0)
    far = decided_by(rule, row, ego=Ego(speed_mps=5.56), range_m=6.0, standstill_gap_m=1.0)
    assert near.brake
    assert not far.brake
    assert far.reason.endswith("but the camera cannot see so far")


def test_the_range_is_that_of_the_camera_and_its_area_of_interest() -> None:
    assert load_config("scaled_car").decision.range_m == 6.0  # E-S-21: 8.8 m unambiguous, the area ends before
    whole = load_config("scaled_car", {"clean": {"x_max_m": 20.0}}).decision
    assert whole.range_m == pytest.approx(8.82, abs=0.01)
    moved = load_config("usercams", {"decision": {"corridor": {"front_m": 1.5}}}).decision
    assert moved.range_m == pytest.approx(25.0 - 1.5)
    assert load_config("generic_pulsed").decision.range_m is None
    assert load_config("scaled_car", {"decision": {"range_m": 3.0}}).decision.range_m == 3.0
    assert load_config("usercams").decision.frame_period_s == pytest.approx(1 / 50)


# -- while it brakes --------------------------------------------------------------------------------------------------


def test_braking_that_has_begun_goes_on_beyond_the_limit_until_little_is_needed() -> None:
    ego, braking = Ego(speed_mps=2.0), Ego(speed_mps=2.0, braking=True)
    demands = {d: [decided({"x": d, "vx": -2.0}, ego=e).brake for e in (ego, braking)] for d in (1.6, 2.0, 2.4)}
    assert demands == {
        1.6: [True, True],
        2.0: [False, True],  # 2^2 / (2 * 2.0) = 1.0 of 2.9 m/s2
        2.4: [False, False],
    }
    assert not decided({"x": 2.0, "vx": 0.0}, ego=braking).brake
    assert not decided({"x": 2.0, "vx": -2.0}, ego=braking, release_share=0.4).brake


def test_at_contact_braking_goes_on() -> None:
    assert keeps_braking(Threat(0.0, 0.4, 5.0), DecisionSettings())
    assert not keeps_braking(Threat(0.0, 0.0, 5.0), DecisionSettings())


def test_the_speed_is_that_of_the_track_and_where_it_has_none_that_at_which_the_gap_shrinks() -> None:
    spread = {"distance_sigma_m": 0.2, "speed_sigma_mps": 0.2}
    ways = {
        speed: too_late(Threat(2.3, 2.8, 900.0, speed_mps=speed, **spread), 3.0, SURE) for speed in (math.nan, 2.8, 3.0)
    }
    assert ways[math.nan] == ways[2.8] != ways[3.0]


def test_our_deceleration_is_uncertain_by_its_share() -> None:
    threat = Threat(2.3, 3.0, 900.0, speed_mps=3.0, distance_sigma_m=0.1, speed_sigma_mps=0.1)
    full = full_deceleration(SURE)
    own, delay_s = (3.0, full, SURE.deceleration_sigma * full), SURE.reaction_time_s + SURE.frame_period_s
    gap_m = 2.3 - SURE.standstill_gap_m
    assert full > 2
    assert too_late(threat, 3.0, SURE) == p_too_late(gap_m, 3.0, (0.1, 0.1, 0.0), 0.0, own, delay_s)


def test_a_probability_that_is_just_what_is_asked_for_brakes() -> None:
    threat = Threat(0.5, 3.0, 900.0, p_lateral=0.75)
    p = too_late(threat, 3.0, EXACT)
    for false, brakes in ((1 - p, True), (1 - p - 1e-9, False)):
        assert must_brake_surely(threat, 3.0, True, dataclasses.replace(EXACT, false_brake_probability=false)) == brakes
