"""The time to collision as a distribution, the outline of the vehicle and the whole way, against Monte Carlo."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm

from rangecam.collision import CorridorSettings, look_ahead
from rangecam.collision.gaussian import both_above
from rangecam.collision.points import gaussian_points
from rangecam.types import QUANTILES, Collisions, Ego, Side, Tracks
from test_collision import CERTAIN, correlated, one_track, predict, samples

BOX = (1.0, 0.8, 1.0)


def mirrored(tracks: Tracks) -> Tracks:
    flip = np.diag([1.0, 1, 1, -1, -1, -1, 1, 1, 1])
    return dataclasses.replace(tracks, state=tracks.state @ flip, covariance=flip @ tracks.covariance @ flip)


# -- when -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", [[10, -5, 0, 0, 0, 0], [4, -1.2, 0, 0.3, 0.1, 0], [2, -0.4, 0, 0, 0, 0]])
def test_at_each_quantile_that_share_has_arrived(state: list[float]) -> None:
    tracks = one_track(state, correlated(0.05))
    x, v = samples(tracks, 100_000)[:, :2].T
    for share, t in zip(QUANTILES, predict(tracks).ttc_quantiles_s[0], strict=True):
        arrived = np.mean(x + v * t <= 0) if math.isfinite(t) else np.mean(v < 0)
        assert arrived == pytest.approx(share, abs=0.005) if math.isfinite(t) else arrived < share + 0.005


def test_quantiles_of_an_acceleration_are_those_of_monte_carlo() -> None:
    tracks = one_track([10, -5, -0.5, 0, 0, 0], correlated(0.05))
    x, v, a = samples(tracks)[:, :3].T
    times = 2 * x / (np.sqrt(np.maximum(v * v - 2 * a * x, 0)) - v)
    found = predict(tracks, use_acceleration=True).ttc_quantiles_s[0]
    np.testing.assert_allclose(found[1:4], np.quantile(times, QUANTILES)[1:4], rtol=0.02)
    np.testing.assert_allclose(found[[0, 4]], np.quantile(times, QUANTILES)[[0, 4]], rtol=0.05)


def test_where_it_may_never_come_quantiles_beyond_that_are_infinite() -> None:
    P = np.diag([1e-4, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
    found = predict(one_track([10, -1.0, 0, 0, 0, 0], P)).ttc_quantiles_s[0]
    assert norm.cdf(-1.0) == pytest.approx(0.16, abs=0.002)  # chance of moving away
    assert np.isfinite(found).tolist() == [True, True, True, True, False]


def test_the_median_is_the_time_to_collision_and_certainty_has_no_width() -> None:
    found = predict(one_track([10, -5, 0, 0, 0, 0], 1e-16))
    np.testing.assert_allclose(found.ttc_quantiles_s[0], 2.0, atol=1e-6)
    assert found.ttc_sigma_s[0] == pytest.approx(0.0, abs=1e-6)


def test_where_it_is_well_known_quantiles_are_those_of_a_gaussian_of_the_sigma() -> None:
    found = predict(one_track([10, -5, 0, 0, 0, 0], 1e-4))
    expected = 2.0 + found.ttc_sigma_s[0] * norm.ppf(QUANTILES)
    np.testing.assert_allclose(found.ttc_quantiles_s[0], expected, atol=1e-3)


@pytest.mark.parametrize("name", ["drift_mps", "surface_sigma_m"])
def test_each_uncertainty_beyond_the_track_widens_the_time(name: str) -> None:
    tracks = one_track([10, -5, 0, 0, 0, 0], 1e-4)
    plain, more = predict(tracks), predict(tracks, **{name: 0.5})
    assert more.ttc_sigma_s[0] > 2 * plain.ttc_sigma_s[0]
    assert more.ttc_quantiles_s[0, 4] > plain.ttc_quantiles_s[0, 4]


def test_a_velocity_that_drifts_moves_the_arrival_as_a_simulated_random_walk_does() -> None:
    rng, step, q = np.random.default_rng(5), 0.01, 0.2
    v = -5.0 + np.cumsum(rng.normal(0, q * math.sqrt(step), (4000, 400)), axis=1)
    x = 10.0 + np.cumsum(v * step, axis=1)
    times = np.argmax(x <= 0, axis=1) * step
    found = predict(one_track([10, -5, 0, 0, 0, 0], 1e-9), drift_mps=q)
    assert found.ttc_sigma_s[0] == pytest.approx(times.std(), rel=0.08)


def test_an_image_that_is_older_than_its_stamp_leaves_less_time() -> None:
    tracks = one_track([10, -5, 0, 0, 1.0, 0], 1e-4)
    now, late = predict(tracks), predict(tracks, lag_s=0.1)
    assert late.ttc_s[0] == pytest.approx(now.ttc_s[0] - 0.1)
    np.testing.assert_allclose(late.ttc_quantiles_s, now.ttc_quantiles_s - 0.1)
    assert late.lateral_m[0] == now.lateral_m[0]
    path = look_ahead(tracks, Ego(), CorridorSettings(lag_s=0.1, **CERTAIN), 0.5)[1]
    assert path[0].distance_m == pytest.approx(9.5)
    assert path[0].distance_sigma_m == pytest.approx(math.sqrt(1e-4 * 1.01))
    assert path[0].covariance == pytest.approx(0.1 * 1e-4)


# -- where ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "side", "t", "lateral"),
    [
        ([5.0, -2, 0, 0.2, 0, 0], Side.FRONT, 2.5 - 0.25, 0.2),
        ([-1.5, 0, 0, 4.0, -1, 0], Side.LEFT, 2.6, 1.4),
        ([-1.5, 0, 0, -4.0, 1, 0], Side.RIGHT, 2.6, -1.4),
        ([-9.0, 2, 0, 0, 0, 0], Side.REAR, 2.25, 0.0),
        ([3.5, -1, 0, 3.4, -0.5, 0], Side.LEFT, 4.0, 1.4),  # passes the front at 3 s, 0.5 m beside it
        ([5.0, -2, 0, 3.0, 0, 0], Side.NONE, 2.25, 3.0),
        ([-1.5, 0, 0, 4.0, 1, 0], Side.NONE, math.inf, math.nan),
    ],
)
def test_the_side_that_is_hit_and_when(state: list[float], side: Side, t: float, lateral: float) -> None:
    tracks = one_track(state, 1e-8, size=BOX, near_offset=0.5)
    found = predict(tracks, width_m=2.0, length_m=4.0)
    assert found.side[0] == side
    assert found.ttc_s[0] == pytest.approx(t)
    assert found.lateral_m[0] == pytest.approx(lateral, nan_ok=True)
    assert found.p_collision[0] == pytest.approx(float(side != Side.NONE), abs=0.01)


def touches(states: np.ndarray, horizon_s: float, half: tuple[float, float], radius: float) -> np.ndarray:
    """Whether each state (x, vx, y, vy) from the middle of a rounded outline touches it, by small steps of time."""
    hit = np.zeros(len(states), bool)
    for t in np.linspace(0, horizon_s, 800):
        x, y = states[:, 0] + states[:, 1] * t, states[:, 2] + states[:, 3] * t
        u, w = np.maximum(np.abs(x) - half[0] + radius, 0), np.maximum(np.abs(y) - half[1] + radius, 0)
        hit |= np.hypot(u, w) <= radius if radius else (np.abs(x) <= half[0]) & (np.abs(y) <= half[1])
    return hit


@pytest.mark.parametrize("radius", [0.0, 0.8])
@pytest.mark.parametrize(
    "state",
    [[8, -4, 0, 1.6, 0.1, 0], [6, -2, 0, 3.5, -1, 0], [-1.5, 0.1, 0, 4, -1.2, 0], [-8, 2.5, 0, -1.2, 0, 0]],
)
def test_the_probability_of_touching_the_rounded_outline_is_that_of_monte_carlo(
    state: list[float], radius: float
) -> None:
    tracks = one_track(state, correlated(0.12), size=BOX, near_offset=0.5)
    s = samples(tracks, 10_000)[:, [0, 1, 3, 4]]
    s[:, 0] += 2.0
    hit = touches(s, 5.0, (2.5, 1.4), radius)
    found = predict(tracks, width_m=2.0, length_m=4.0, corner_radius_m=radius)
    assert 0.05 < hit.mean() < 0.95
    assert found.p_collision[0] == pytest.approx(hit.mean(), abs=0.02 + 4 * 0.5 / 100)


def test_a_rounded_corner_is_missed_by_what_just_hits_a_sharp_one() -> None:
    tracks = one_track([4.0, -2, 0, 1.35, 0.3, 0], 1e-8, size=BOX, near_offset=0.5)
    sharp, round_ = (predict(tracks, width_m=2.0, length_m=2.0, corner_radius_m=r) for r in (0.0, 1.0))
    tracks = one_track([4.0, -2, 0, 1.0, 0.1, 0], 1e-8, size=BOX, near_offset=0.5)
    later = predict(tracks, width_m=2.0, length_m=2.0, corner_radius_m=1.0)
    assert sharp.side[0] == Side.NONE == round_.side[0]
    assert later.side[0] == Side.FRONT
    tracks = one_track([2.0, -1.0, 0, -0.2, 1.0, 0], 1e-8, size=BOX, near_offset=0.5)
    sharp, round_ = (predict(tracks, width_m=2.0, length_m=2.0, corner_radius_m=r) for r in (0.0, 1.0))
    assert (sharp.side[0], round_.side[0]) == (Side.FRONT, Side.NONE)
    assert round_.closest_m[0] > 0 == sharp.closest_m[0]


def test_a_rounded_front_is_reached_later_beside_the_middle() -> None:
    """A point at 0.8 of the radius from the middle meets the circle 0.4 radii behind the line of the front."""
    tracks = one_track([5.0, -1.0, 0, 0.8, 0, 0], 1e-8)
    found = predict(tracks, width_m=2.0, length_m=2.0, corner_radius_m=1.0, horizon_s=6.0)
    assert found.closest_m[0] == 0.0
    assert found.closest_s[0] == pytest.approx(5.0 + (1 - 0.6))


def test_the_uncertain_width_blurs_a_near_miss() -> None:
    tracks = one_track([5.0, -2, 0, 1.5, 0, 0], 1e-8, size=BOX, near_offset=0.5)
    assert predict(tracks, width_m=2.0).p_collision[0] == pytest.approx(0.0, abs=1e-6)
    found = predict(tracks, width_m=2.0, size_sigma_m=0.2).p_collision[0]
    assert found == pytest.approx(norm.cdf(-0.1 / 0.1), abs=0.01)  # half a width misses 0.1 m, sigma of a half is 0.1


@pytest.mark.parametrize("use_acceleration", [False, True])
@pytest.mark.parametrize("state", [[8, -4, 0.3, 1.6, 0.1, 0.1], [-1.5, 0.1, 0, 4, -1.2, 0], [3, 0, 0, 0, 0, 0]])
def test_left_is_as_right(state: list[float], use_acceleration: bool) -> None:
    tracks = one_track(state, correlated(0.12), size=BOX, near_offset=0.5)
    options = {"width_m": 2.0, "length_m": 4.0, "use_acceleration": use_acceleration, "corner_radius_m": 0.3}
    left = predict(tracks, Ego(yaw_rate_radps=0.05), **options)
    right = predict(mirrored(tracks), Ego(yaw_rate_radps=-0.05), **options)
    for name in ("ttc_s", "ttc_sigma_s", "p_collision", "ttc_quantiles_s", "closest_m", "closest_s"):
        np.testing.assert_allclose(getattr(left, name), getattr(right, name), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(left.lateral_m, -right.lateral_m)
    swap = {Side.LEFT: Side.RIGHT, Side.RIGHT: Side.LEFT}
    assert swap.get(Side(left.side[0]), Side(left.side[0])) == right.side[0]


def test_points_stand_for_a_normal_distribution_and_left_for_right() -> None:
    points = gaussian_points(256)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(points.T @ points / 256, np.eye(3), atol=1e-9)
    assert sorted(map(tuple, np.round(-points, 9))) == sorted(map(tuple, np.round(points, 9)))
    flat = gaussian_points(64, 2)
    np.testing.assert_allclose(flat.T @ flat / 64, np.diag([1, 1, 0]), atol=1e-9)


@pytest.mark.parametrize("y_m", [1.3, 1.6, 2.0, 2.4])
def test_what_drifts_beside_us_still_hits_our_side_as_often_as_simulated_random_walks_do(y_m: float) -> None:
    """A car of 4.3 m; what passes its front goes on drifting, and comes into its side."""
    rng, step, q, n = np.random.default_rng(6), 0.02, 0.3, 6000
    speed = rng.normal(0, 0.1, (2, n, 1)) + np.cumsum(rng.normal(0, q * math.sqrt(step), (2, n, 150)), axis=2)
    (x, y), t = np.cumsum(speed * step, axis=2), (np.arange(150) + 1) * step
    x, y = 8.0 - 6 * t + x, y_m + y
    hit = ((x <= 0) & (x + BOX[0] + 4.3 >= 0) & (np.abs(y) <= 1.0 + BOX[1] / 2)).any(axis=1).mean()
    tracks = one_track([8.5, -6, 0, y_m, 0, 0], np.diag([1e-8, 0.01, 1e-8, 1e-8, 0.01, 1e-8]), BOX, 0.5)
    found = predict(tracks, width_m=2.0, length_m=4.3, drift_mps=q, horizon_s=3.0)
    assert found.p_collision[0] == pytest.approx(hit, abs=0.01 + 4 * math.sqrt(hit * (1 - hit) / n))
    assert 0.01 < hit < 0.9


@pytest.mark.parametrize("r", [-0.99, -0.5, 0.0, 0.4, 0.79, 0.81, 0.9, 0.97, 0.999, 1.0])
def test_two_correlated_variables_are_both_above_their_limits_as_often_as_scipy_says(r: float) -> None:
    both = multivariate_normal(cov=[[1, r], [r, 1]], allow_singular=True)
    for h, k in np.random.default_rng(7).uniform(-4, 4, (20, 2)):
        assert both_above(h, k, r) == pytest.approx(both.cdf([-h, -k]), abs=3e-4)
        near = h + 0.5 * math.sqrt(1 - r * r)  # where it differs from both being the same, and from none of both
        assert both_above(h, near, r) == pytest.approx(both.cdf([-h, -near]), abs=3e-4)
    assert both_above(9.0, 0.0, r) == pytest.approx(0.0, abs=1e-9)
    assert both_above(-9.0, 0.5, r) == pytest.approx(norm.cdf(-0.5), abs=1e-9)


# -- how near ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", [0.0, 0.1])
def test_the_closest_approach_is_that_of_the_whole_way_not_of_its_ends(acceleration: float) -> None:
    """One who crosses just before our front: at both ends far away, in between near."""
    tracks = one_track([3.3, -1.0, acceleration, -5.0, 2.0, 0], 1e-8, size=(0.4, 0.4, 1.7), near_offset=0.2)
    found = predict(tracks, width_m=1.0, length_m=2.0, use_acceleration=acceleration > 0)
    t = np.linspace(0, 5, 50_001)
    x, y = 3.3 + 1.0 - t + acceleration * t * t / 2, -5 + 2 * t
    gaps = np.hypot(np.maximum(np.abs(x) - 1.2, 0), np.maximum(np.abs(y) - 0.7, 0))
    assert 0 < gaps.min() < 0.2 * min(gaps[0], gaps[-1])
    assert found.closest_m[0] == pytest.approx(gaps.min(), abs=1e-3)
    assert found.closest_s[0] == pytest.approx(t[gaps.argmin()], abs=0.01)


def test_what_moves_away_is_nearest_now_and_what_comes_too_late_at_the_horizon() -> None:
    away, late = (predict(one_track([4.0, v, 0, 0, 0, 0], 1e-8), horizon_s=2.0) for v in (1.0, -1.0))
    assert (away.closest_m[0], away.closest_s[0]) == (4.0, 0.0)
    assert (late.closest_m[0], late.closest_s[0]) == (2.0, 2.0)
    assert late.side[0] == Side.NONE


# -- never nonsense ---------------------------------------------------------------------------------------------------

ANY = st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1e-300, -1e-300, 1e9])


@hypothesis_settings(deadline=None)
@example([-318.4470064766315, 1e9, 0.0, 0.0, 0.0, 0.0], 0.0, 0.0, False)
@example([1e9, -50.0, 0.0, 0.0, 0.0, 0.0], 1e-20, 0.0, False)
@given(st.lists(ANY, min_size=6, max_size=6), st.sampled_from([0.0, 1e-20, 1.0, 1e6]), ANY, st.booleans())
def test_whatever_the_track_is_what_is_said_of_it_is_possible(
    state: list[float], variance: float, yaw_rate: float, use_acceleration: bool
) -> None:
    found = predict(
        one_track(state, variance, BOX, 0.5),
        Ego(yaw_rate_radps=yaw_rate),
        use_acceleration=use_acceleration,
        corner_radius_m=0.2,
    )
    possible(found)


def possible(found: Collisions) -> None:
    assert found.ttc_s[0] >= 0
    assert 0 <= found.p_collision[0] <= 1
    assert found.closest_m[0] >= 0
    assert 0 <= found.closest_s[0] <= 5.0
    assert not np.isnan(found.ttc_quantiles_s).any()
    assert (np.diff(np.where(np.isinf(found.ttc_quantiles_s), 1e300, found.ttc_quantiles_s)) >= -1e-6).all()
    assert found.ttc_sigma_s[0] >= 0 or math.isnan(found.ttc_sigma_s[0])
    assert Side(found.side[0]) in Side


def test_a_covariance_that_is_none_breaks_nothing() -> None:
    possible(predict(one_track([5, -1, 0, 0, 0, 0], -np.eye(6))))
