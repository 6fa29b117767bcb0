"""Time to collision and its probability against hand-worked cases and Monte Carlo."""

import dataclasses
import math

import numpy as np
import pytest

from rangecam.collision import CorridorSettings, look_ahead, time_to_reach
from rangecam.types import POSITION, Collisions, Ego, Tracks, TrackStatus

NO_SIZE = (0.0, 0.0, 0.0)


def one_track(state: object, covariance: object = 1e-8, size: object = NO_SIZE, near_offset: float = 0.0) -> Tracks:
    """A confirmed track; state as x, vx, ax, y, vy, ay; a number as covariance means that variance everywhere."""
    P = np.zeros((9, 9))
    P[:6, :6] = np.eye(6) * covariance if np.isscalar(covariance) else covariance
    fields = {
        "track_id": np.array([7]),
        "status": np.array([int(TrackStatus.CONFIRMED)]),
        "state": np.concatenate([np.asarray(state, float), np.zeros(3)])[None],
        "covariance": P[None],
        "age": np.array([9]),
        "hits": np.array([9]),
        "misses": np.array([0]),
        "size_m": np.asarray(size, float)[None],
        "near_offset_m": np.array([near_offset]),
        "n_pixels": np.array([100.0]),
        "segment": np.array([1]),
        "class_probability": np.array([[1.0, 0.0, 0.0, 0.0]]),
        "nis": np.array([1.0]),
        "mode_probability": np.ones((1, 0)),
        "mode_state": np.ones((1, 0, 9)),
        "mode_covariance": np.ones((1, 0, 9, 9)),
    }
    return Tracks(**fields, time_s=1.0, next_id=8)  # type: ignore[arg-type]


CERTAIN = {"drift_mps": 0.0, "surface_sigma_m": 0.0, "size_sigma_m": 0.0}
"""Nothing is uncertain but what the track says."""


def predict(tracks: Tracks, ego: Ego | None = None, **settings: object) -> Collisions:
    settings = CERTAIN | settings
    return look_ahead(tracks, ego or Ego(), CorridorSettings(**settings), 0.5)[0]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("dx", "dv", "da", "t"),
    [(10, -5, 0, 2.0), (10, -5, -1, 1.7082), (10, -5, 1, 2.7639), (10, -5, 2, math.inf), (20, -15, 0, 1.3333)],
)
def test_time_to_collision_of_the_worked_cases(dx: float, dv: float, da: float, t: float) -> None:
    tracks = one_track([dx, dv, da, 0, 0, 0])
    assert predict(tracks, use_acceleration=True).ttc_s[0] == pytest.approx(t, abs=5e-5)
    steady = predict(tracks, use_acceleration=False).ttc_s[0]
    assert steady == pytest.approx(dx / -dv)


@pytest.mark.parametrize("speed", [-5.0, -0.1, 0.0, 3.0])
@pytest.mark.parametrize("acceleration", [-2.0, -1e-9, 0.0, 1e-9, 0.4])
def test_the_time_is_the_smallest_root_where_there_is_one(speed: float, acceleration: float) -> None:
    roots = np.roots([acceleration / 2, speed, 4.0]) if speed or acceleration else np.zeros(0)
    real = [r.real for r in roots if abs(r.imag) < 1e-12 and 0 < r.real < 1e9]  # later is never
    assert time_to_reach(4.0, speed, acceleration) == pytest.approx(min(real, default=math.inf), rel=1e-6)


def test_what_moves_away_or_stands_never_comes() -> None:
    for speed in (0.0, 2.0):
        collisions = predict(one_track([10, speed, 0, 0, 0, 0]))
        assert collisions.ttc_s[0] == math.inf
        assert math.isnan(collisions.ttc_sigma_s[0])
        assert math.isnan(collisions.lateral_m[0])
        assert collisions.p_collision[0] < 1e-9


def test_the_nearest_surface_and_our_own_front_count_not_the_centres() -> None:
    tracks = one_track([10, -2, 0, 0, 0, 0], size=(2.0, 0.5, 1.0), near_offset=1.0)
    assert predict(tracks, front_m=1.5).ttc_s[0] == pytest.approx((10 - 1 - 1.5) / 2)


def test_the_tracks_move_relative_to_us_so_the_own_speed_is_not_subtracted_again() -> None:
    tracks = one_track([10, -2, 0, 0, 0, 0])
    np.testing.assert_array_equal(predict(tracks, Ego(speed_mps=2.0)).ttc_s, predict(tracks).ttc_s)


def test_an_object_over_our_front_collides_now_and_one_behind_it_never() -> None:
    over = predict(one_track([1.0, -1, 0, 0, 0, 0], size=(2.0, 0.5, 1.0), near_offset=1.0), front_m=0.5)
    assert (over.ttc_s[0], over.p_collision[0]) == (0.0, pytest.approx(1.0))
    behind = predict(one_track([-3.0, -1, 0, 0, 0, 0], size=(2.0, 0.5, 1.0), near_offset=1.0))
    assert (behind.ttc_s[0], behind.p_collision[0]) == (math.inf, 0.0)


def samples(tracks: Tracks, n: int = 200_000) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.multivariate_normal(tracks.state[0, :6], tracks.covariance[0, :6, :6], n)


def correlated(scale: float) -> np.ndarray:
    root = np.random.default_rng(1).normal(size=(6, 6)) * scale
    return root @ root.T


@pytest.mark.parametrize("use_acceleration", [False, True])
def test_the_sigma_of_the_time_is_that_of_monte_carlo(use_acceleration: bool) -> None:
    tracks = one_track([10, -5, -0.5, 0.3, 0.1, 0.2], correlated(0.01))
    s = samples(tracks)
    times = np.array([time_to_reach(x, v, a * use_acceleration) for x, v, a in s[:20_000, :3]])
    collisions = predict(tracks, use_acceleration=use_acceleration)
    assert collisions.ttc_s[0] == pytest.approx(times.mean(), rel=1e-3)
    assert collisions.ttc_sigma_s[0] == pytest.approx(times.std(), rel=0.03)


@pytest.mark.parametrize(
    "state",
    [[10, -5, 0, 0.6, 0.1, 0], [10, -5, 0, -1.0, 0.2, 0], [10, -3.3, 0, 0.0, 0.0, 0], [10, -5, 0, 1.0, -2.0, 0]],
)
@pytest.mark.parametrize("use_acceleration", [False, True])
def test_the_probability_is_that_of_monte_carlo(state: list[float], use_acceleration: bool) -> None:
    tracks = one_track(state, correlated(0.05), size=(0.0, 0.5, 1.0))
    x, v, a, y, vy, ay = samples(tracks, 20_000).T
    a, ay = a * use_acceleration, ay * use_acceleration
    hit = np.zeros(len(x), bool)
    for t in np.linspace(0, 3.0, 600):
        along, across = x + v * t + a * t * t / 2, y + vy * t + ay * t * t / 2
        hit |= (along < 0) & (along > -1.0) & (np.abs(across) < (1.0 + 0.5) / 2)
    collisions = predict(tracks, width_m=1.0, horizon_s=3.0, use_acceleration=use_acceleration)
    assert collisions.p_collision[0] == pytest.approx(hit.mean(), abs=0.02 + 4 * 0.5 / np.sqrt(20_000))


def test_a_walker_who_will_have_left_is_no_collision_and_one_who_will_be_there_is() -> None:
    leaving = predict(one_track([10, -5, 0, 0.0, 1.5, 0], 1e-4, size=(0.3, 0.5, 1.7)), width_m=1.0)
    coming = predict(one_track([10, -5, 0, -3.0, 1.5, 0], 1e-4, size=(0.3, 0.5, 1.7)), width_m=1.0)
    assert leaving.lateral_m[0] == pytest.approx(3.0)
    assert leaving.p_collision[0] < 0.001
    assert coming.lateral_m[0] == pytest.approx(0.0)
    assert coming.p_collision[0] > 0.999


def test_the_wider_the_corridor_or_the_longer_the_horizon_the_likelier_the_collision() -> None:
    tracks = one_track([10, -3, 0, 1.0, 0, 0], 0.05)
    by_width = [predict(tracks, width_m=w).p_collision[0] for w in (0.5, 1.0, 2.0, 4.0)]
    by_time = [predict(tracks, width_m=4.0, horizon_s=h).p_collision[0] for h in (1.0, 3.0, 3.5, 6.0)]
    assert by_width == sorted(by_width)
    assert by_time == sorted(by_time)
    assert by_time[0] < 0.01 < 0.85 < by_time[-1]


@pytest.mark.parametrize("speed_known", [True, False])
def test_a_post_on_our_arc_hits_us_in_the_middle(speed_known: bool) -> None:
    speed, yaw_rate = 5.0, 0.1
    angle = 0.2  # of the arc ahead, on which we drive with radius 50 m to the left
    x, y = 50 * np.sin(angle), 50 * (1 - np.cos(angle))
    tracks = one_track([x, -speed + yaw_rate * y, 0, y, -yaw_rate * x, 0])
    collisions = predict(tracks, Ego(speed_mps=speed if speed_known else None, yaw_rate_radps=yaw_rate))
    straight = predict(tracks, Ego(speed_mps=speed))
    assert abs(collisions.lateral_m[0]) < 0.05
    assert straight.lateral_m[0] < -0.9


def in_path(tracks: Tracks, ego: Ego) -> bool:
    settings = CorridorSettings(width_m=2.0, length_m=4.3, **CERTAIN)
    return bool(look_ahead(tracks, ego, settings, 0.5)[1])


def standing(x: float, y: float, ego: Ego) -> list[float]:
    """The state of what stands there."""
    speed, yaw_rate = float(ego.speed_mps or 0.0), ego.yaw_rate_radps
    return [x, yaw_rate * y - speed, 0, y, -yaw_rate * x, 0]


def test_in_a_bend_the_corridor_is_our_arc_not_the_straight_on() -> None:
    for side in (1.0, -1.0):
        straight, bend = Ego(speed_mps=5.0), Ego(speed_mps=5.0, yaw_rate_radps=side * 0.125)  # radius 40 m
        on_arc = side * (40 - math.sqrt(40**2 - 15**2))  # 2.9 m
        for y, ahead, on_our_arc in ((0.0, True, False), (on_arc, False, True)):
            assert in_path(one_track(standing(15, y, straight), 1e-4), straight) == ahead
            assert in_path(one_track(standing(15, y, bend), 1e-4), bend) == on_our_arc
        # farther away than the arc reaches
        assert not in_path(one_track(standing(45, 0.0, bend), 1e-4), bend)


def test_what_jumps_into_the_corridor_is_not_there_before_it_agrees_with_itself() -> None:
    ego = Ego(speed_mps=5.0)
    for nis, y, there in ((1.0, 0.8, True), (10.0, 0.8, False), (10.0, 0.2, True), (math.nan, 0.8, True)):
        track = one_track(standing(6.0, y, ego), 0.01)
        assert in_path(dataclasses.replace(track, nis=np.array([nis])), ego) == there


def test_a_track_of_one_frame_is_no_likely_collision() -> None:
    P = np.diag([0.01, 25.0, 9.0, 0.01, 25.0, 9.0])
    assert predict(one_track([3, 0, 0, 0, 0, 0], P, size=(0.3, 0.5, 1.0)), horizon_s=2.0).p_collision[0] < 0.2


def test_each_track_is_predicted_on_its_own_and_nothing_is_modified() -> None:
    states = [[10, -5, 0, 0, 0, 0], [5, 1, 0, 0, 0, 0], [20, -15, 0, 3, 0, 0]]
    single = [one_track(s) for s in states]
    arrays = [f.name for f in dataclasses.fields(Tracks) if isinstance(getattr(single[0], f.name), np.ndarray)]
    together = Tracks(**{name: np.concatenate([getattr(t, name) for t in single]) for name in arrays})
    before = {name: getattr(together, name).copy() for name in arrays}
    collisions = predict(together)
    assert len(collisions) == 3
    for i, track in enumerate(single):
        for name in ("ttc_s", "ttc_sigma_s", "lateral_m", "p_collision"):
            np.testing.assert_array_equal(getattr(collisions, name)[i], getattr(predict(track), name)[0])
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(together, name), values)
    assert len(predict(Tracks.empty())) == 0
    assert together.state[0][POSITION].tolist() == [10, 0, 0]


def test_the_tracks_in_the_path_come_nearest_first_with_what_is_known_of_them() -> None:
    states = [
        [9, -2, 0, 0.1, 0, 0],
        [4, -1, 0, 0, 0, 0],
        [6, -2, 0, 5.0, 0, 0],
        [-3, 0, 0, 0, 0, 0],
        [5, 0, 0, 0, 0, 0],
    ]
    single = [one_track(s, 0.04) for s in states]
    names = [f.name for f in dataclasses.fields(Tracks) if isinstance(getattr(single[0], f.name), np.ndarray)]
    tracks = Tracks(**{name: np.concatenate([getattr(t, name) for t in single]) for name in names})
    tracks.track_id[:] = range(1, 6)
    tracks.class_probability[1] = [0.1, 0.6, 0.2, 0.1]
    tracks.status[4] = TrackStatus.TENTATIVE
    collisions, in_path = look_ahead(tracks, Ego(), CorridorSettings(front_m=0.5), 0.5)
    assert [each.track_id for each in in_path] == [2, 1]
    nearest = in_path[0]
    assert (nearest.distance_m, nearest.speed_x_mps, nearest.n_pixels, nearest.class_index) == (3.5, -1, 100, 1)
    assert nearest.speed_sigma_mps == pytest.approx(0.2)
    expected = nearest.ttc_s, nearest.ttc_sigma_s, nearest.p_collision
    assert expected == (collisions.ttc_s[1], collisions.ttc_sigma_s[1], collisions.p_collision[1])
