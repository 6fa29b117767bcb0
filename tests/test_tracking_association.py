"""Competing tracks: joint probabilities, priorities, shape, merges and splits, own motion, turns, noise that adapts."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import truncnorm

from rangecam.brake import DecisionSettings, decide
from rangecam.collision import CorridorSettings
from rangecam.motion import MOTION, Mode, MotionSettings
from rangecam.tracking import ASSOCIATION, TrackingSettings, update_tracks
from rangecam.tracking.association import NO_PAIR, priorities
from rangecam.tracking.joint import by_belief_propagation, marginals, of_cluster
from rangecam.tracking.moving import turning
from rangecam.tracking.shape import first_memory, pair_shapes, shapes
from rangecam.tracking.sighting import within
from rangecam.tracking.update import _seen_in
from rangecam.types import CLASSES, MEMORY, Cut, Ego, Segments, Tracks, TrackStatus

PLAIN = TrackingSettings(position_sigma_m=0.0, extent_sigma=0.0, end_sigma_m=0.03)
GROUP, NOISE = MEMORY.index("merged"), MEMORY.index("process_noise")


def seen(
    places: object, width: object = 0.5, height: object = 1.7, variance: float = 4e-4, cut: object = 0
) -> Segments:
    z = np.asarray(places, float).reshape(-1, 3)
    n = len(z)
    size = np.stack([np.full(n, 0.2), np.broadcast_to(width, n), np.broadcast_to(height, n)], axis=1)
    columns, rows = np.maximum(size[:, 1] / 0.05, 1).astype(int), np.maximum(size[:, 2] / 0.05, 1).astype(int)
    return Segments(
        label=np.arange(1, n + 1),
        position_m=z,
        covariance_m2=np.tile(np.eye(3) * variance, (n, 1, 1)),
        size_m=size,
        near_m=z[:, 0] - 0.1,
        n_pixels=columns * rows,
        box=np.stack([0 * rows, 0 * rows, rows, columns], axis=1),
        range_m=np.linalg.norm(z, axis=1),
        sigma_range_m=np.full(n, 0.05),
        amplitude=np.full(n, 10.0),
        cut=np.broadcast_to(np.asarray(cut, np.uint8), n).copy(),
        nearest_m=z,
    )


NOTHING = seen(np.zeros((0, 3)))


def follow(frames: list[Segments], settings: TrackingSettings = PLAIN, dt: float = 0.05) -> list[Tracks]:
    steps, tracks = [], Tracks.empty()
    for k, segments in enumerate(frames):
        tracks = update_tracks(tracks, segments, k * dt, settings)
        steps.append(tracks)
    return steps


# -- joint probabilistic ----------------------------------------------------------------------------------------------


def enumerated(log_ratio: np.ndarray) -> np.ndarray:
    """Marginals by brute force: every joint event, its weight, and who is whose in it."""
    n, m = log_ratio.shape
    total, weights = 0.0, np.zeros((n, m))
    for event in itertools.product(range(-1, m), repeat=n):
        pairs = [(i, j) for i, j in enumerate(event) if j >= 0]
        if len({j for _, j in pairs}) == len(pairs):
            weight = float(np.exp(sum(log_ratio[i, j] for i, j in pairs)))
            total += weight
            for pair in pairs:
                weights[pair] += weight
    return weights / total


@st.composite
def clusters(draw: st.DrawFn) -> np.ndarray:
    n, m = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    value = st.one_of(st.just(-np.inf), st.floats(-8, 8))
    return np.array(draw(st.lists(value, min_size=n * m, max_size=n * m)), float).reshape(n, m)


@given(clusters())
def test_the_joint_probabilities_are_those_of_every_event_enumerated(log_ratio: np.ndarray) -> None:
    np.testing.assert_allclose(of_cluster(log_ratio), enumerated(log_ratio), rtol=1e-9, atol=1e-12)


@given(st.lists(st.floats(-6, 6), min_size=5, max_size=5))
def test_without_a_loop_belief_propagation_is_exact(values: list[float]) -> None:
    chain = np.full((3, 3), -np.inf)
    chain[[0, 0, 1, 1, 2], [0, 1, 1, 2, 2]] = values
    np.testing.assert_allclose(by_belief_propagation(chain), enumerated(chain), rtol=1e-6, atol=1e-9)


def test_where_events_are_too_many_the_probabilities_are_nearly_the_exact_ones() -> None:
    log_ratio = np.random.default_rng(1).normal(0, 2, (5, 5))
    exact = of_cluster(log_ratio)
    approximate = of_cluster(log_ratio, largest=3)
    assert 0 < abs(exact - approximate).max() < 0.1


def test_only_tracks_that_compete_share_segments() -> None:
    cost = np.array([[0.0, 1.0, NO_PAIR], [1.0, 0.0, NO_PAIR], [NO_PAIR, NO_PAIR, 2.0]])
    weights = marginals(cost, 0.9, 0.999, 0.01)
    assert (weights[2] == 0).all()
    scale = 0.9 / 0.01 / (1 - 0.9 * 0.999) / (2 * np.pi) ** 1.5
    expected = enumerated(np.log(scale) - cost[:2, :2] / 2)
    np.testing.assert_allclose(weights[:2, :2], expected, rtol=1e-9)


@pytest.mark.parametrize("modes", [(), (Mode(model="constant_velocity"), Mode())])
def test_a_blended_update_is_the_mixture_of_the_updates_by_each_segment(modes: tuple[Mode, ...]) -> None:
    settings = dataclasses.replace(
        PLAIN,
        association="joint_probabilistic",
        use_shape=False,
        recognise_merges=False,
        motion=MotionSettings(modes=modes),
    )
    start = follow([seen([5, 0, 0])] * 6, settings)[-1]
    both = seen([[5, 0.05, 0], [5, -0.03, 0]], variance=2e-3)
    blended = update_tracks(start, both, start.time_s + 0.05, settings)
    alone = [
        update_tracks(start, each, start.time_s + 0.05, settings)
        for each in (seen([5, 0.05, 0], variance=2e-3), seen([5, -0.03, 0], variance=2e-3), NOTHING)
    ]
    cost = []
    for one in alone[:2]:
        S = alone[2].covariance[0][::3, ::3] + 2e-3 * np.eye(3)
        cost.append(one.nis[0] + np.linalg.slogdet(S)[1])
    first = marginals(np.array([cost]), settings.detection_probability, settings.gate_probability, 0.01)[0]
    weight = np.array([*first, 1 - first.sum()])
    states = np.array([one.state[0] for one in alone])
    mean = weight @ states
    np.testing.assert_allclose(blended.state[0], mean, rtol=0, atol=1e-9)
    apart = states - mean
    P = sum(w * (one.covariance[0] + np.outer(a, a)) for w, one, a in zip(weight, alone, apart, strict=True))
    np.testing.assert_allclose(blended.covariance[0], P, rtol=0, atol=1e-9)
    assert np.isnan(blended.nis[0])


@pytest.mark.parametrize("name", sorted(ASSOCIATION))
def test_a_thousand_segments_at_once_neither_hang_nor_grow(name: str) -> None:
    rng, settings = np.random.default_rng(5), dataclasses.replace(PLAIN, association=name)  # type: ignore[arg-type]
    tracks, counts = Tracks.empty(), []
    for k in range(5):
        crowd = seen(rng.uniform([5, -40, 0], [85, 40, 0.5], (1000, 3)), variance=1e-2)
        tracks = update_tracks(tracks, crowd, 0.05 * k, settings)
        counts.append(len(tracks))
        assert np.isfinite(tracks.state).all()
        assert np.isfinite(tracks.covariance).all()
    assert max(counts) <= 5000
    for k in range(5, 60):
        tracks = update_tracks(tracks, NOTHING, 0.05 * k, settings)
    assert len(tracks) == 0


# -- priority, distance, shape ----------------------------------------------------------------------------------------


def test_age_pixels_and_reliability_raise_the_priority_alike() -> None:
    memory = np.ones((4, len(MEMORY)))
    memory[3, MEMORY.index("reliability")] = 2.0
    value = priorities(np.array([5, 10, 5, 5]), np.array([20.0, 20.0, 40.0, 20.0]), memory)
    np.testing.assert_allclose(value[1:] - value[0], np.log(2))


def test_the_cheapest_pair_goes_first_where_the_method_is_greedy() -> None:
    cost = np.array([[1.0, 2.0], [0.0, 9.0]])
    np.testing.assert_array_equal(ASSOCIATION["greedy"](cost, np.zeros(2)), [1, 0])
    np.testing.assert_array_equal(ASSOCIATION["greedy"](np.array([[1.0], [0.0]]), np.zeros(2)), [-1, 0])


@pytest.mark.parametrize(("off_m", "taken"), [(0.39, 1), (0.41, 0)])
def test_the_euclidean_gate_is_a_sphere_whatever_the_noise(off_m: float, taken: int) -> None:
    settings = dataclasses.replace(PLAIN, distance="euclidean", euclidean_gate_m=0.4, recognise_merges=False)
    for variance in (1e-6, 1.0):
        start = update_tracks(Tracks.empty(), seen([5, 0, 0], variance=variance), 0.0, settings)
        place = np.array([5, 0, 0]) + off_m * np.array([0.6, 0.48, 0.64])
        assert int(update_tracks(start, seen(place, variance=variance), 1e-3, settings).segment[0]) == taken


def test_shape_tells_apart_who_cannot_be_told_apart_by_place() -> None:
    apart = seen([[8, -0.3, 0], [8, 0.3, 0]], width=[0.8, 0.3], variance=1e-2)
    swapped = seen([[8, -0.05, 0], [8, 0.05, 0]], width=[0.3, 0.8], variance=1e-2)
    last = {}
    for use_shape in (True, False):
        settings = dataclasses.replace(PLAIN, use_shape=use_shape, speed_sigma_mps=1.0)
        last[use_shape] = update_tracks(follow([apart] * 8, settings)[-1], swapped, 0.6, settings).segment.tolist()
    assert last == {True: [2, 1], False: [1, 2]}


def test_a_sliver_beside_what_hides_the_rest_is_not_held_against_its_track() -> None:
    wide = first_memory(shapes(_seen_in(seen([8, 0, 0.9], width=0.6))), 0.05)
    added = {}
    for cut in (0, int(Cut.OCCLUDED)):
        sliver, wider = (_seen_in(seen([8, 0, 0.9], width=w, cut=cut)) for w in (0.1, 1.2))
        added[cut] = [float(pair_shapes(np.zeros((1, 1)), wide, shapes(s), s[10])[0, 0]) for s in (sliver, wider)]
    assert added[0][0] > added[int(Cut.OCCLUDED)][0] + 10
    assert added[int(Cut.OCCLUDED)][1] > added[int(Cut.OCCLUDED)][0]  # more than all of it cannot be seen
    outside = np.full((1, 1), NO_PAIR)
    assert pair_shapes(outside, wide, shapes(sliver), sliver[10])[0, 0] == NO_PAIR


# -- merges and splits ------------------------------------------------------------------------------------------------


def meeting(gap_m: float) -> Segments:
    """Two people beside each other; nearer than their widths they are one segment."""
    wide, narrow = 0.6, 0.4
    low, high = -gap_m / 2 - wide / 2, gap_m / 2 + narrow / 2
    if gap_m > (wide + narrow) / 2 + 0.03:
        return seen([[7, -gap_m / 2, 0.9], [7, gap_m / 2, 0.8]], width=[wide, narrow], height=[1.9, 1.6])
    return seen([7, -0.1 * gap_m, 0.88], width=high - low, height=1.9)


def test_two_who_meet_walk_together_and_part_keep_their_identities() -> None:
    gaps = np.interp(np.arange(120), [0, 30, 80, 119], [2.0, 0.48, 0.48, 2.2])
    steps = follow([meeting(gap) for gap in gaps], TrackingSettings(max_misses=5))
    together = steps[60]
    assert together.status.tolist() == [TrackStatus.COASTING] * 2
    assert (together.memory[:, GROUP] == 1).all()  # type: ignore[index]
    assert (together.hits == together.age).all()  # whoever is seen together with another is seen
    np.testing.assert_allclose(together.state[:, 3], [-0.24, 0.24], atol=0.08)
    last = steps[-1]
    assert last.track_id.tolist() == [1, 2]
    np.testing.assert_allclose(last.state[:, 3], [-1.1, 1.1], atol=0.1)
    np.testing.assert_allclose(last.size_m[:, 1], [0.6, 0.4], atol=0.05)
    assert (last.memory[:, GROUP] == 0).all()  # type: ignore[index]


def test_the_pixels_of_what_is_not_seen_are_those_that_it_would_have_where_it_is_now() -> None:
    near = follow([seen([8.0 - 0.2 * k, 0, 0.9]) for k in range(10)] + [NOTHING] * 8)
    before, after = near[9], near[-1]
    assert after.status[0] == TrackStatus.COASTING
    away = [float(np.linalg.norm(step.state[0, ::3])) for step in (before, after)]
    assert after.n_pixels[0] == pytest.approx(before.n_pixels[0] * (away[0] / away[1]) ** 2)
    assert after.n_pixels[0] > 1.3 * before.n_pixels[0]


def test_without_recognition_the_same_meeting_loses_one_of_them() -> None:
    gaps = np.interp(np.arange(120), [0, 30, 80, 119], [2.0, 0.48, 0.48, 2.2])
    steps = follow([meeting(gap) for gap in gaps], TrackingSettings(max_misses=5, recognise_merges=False))
    assert steps[-1].track_id.tolist() != [1, 2]


def test_an_object_in_two_parts_for_a_few_frames_stays_one_track() -> None:
    whole = seen([7, 0, 0.9], width=0.6)
    parts = seen([[7, -0.2, 0.9], [7, 0.2, 0.9]], width=0.2)
    steps = follow([whole] * 10 + [parts] * 6 + [whole] * 5, TrackingSettings())
    assert [len(step) for step in steps] == [1] * len(steps)
    np.testing.assert_allclose(steps[15].state[0, 3], 0.0, atol=0.02)
    alone = follow([whole] * 10 + [parts] * 6, TrackingSettings(recognise_merges=False))
    assert len(alone[-1]) > 1


def test_parts_that_stay_apart_become_two() -> None:
    whole, parts = seen([7, 0, 0.9], width=0.6), seen([[7, -0.2, 0.9], [7, 0.2, 0.9]], width=0.2)
    last = follow([whole] * 10 + [parts] * 12, TrackingSettings(max_parts_frames=4))[-1]
    assert (last.status == TrackStatus.CONFIRMED).sum() == 2


def test_what_is_cut_short_says_less_of_the_centre_and_nothing_of_the_size() -> None:
    start = follow([seen([7, 0, 0.9], width=0.6)] * 10)[-1]
    after = {
        cut: update_tracks(start, seen([7, 0.02, 0.9], width=0.3, cut=cut), 0.5, PLAIN)
        for cut in (0, int(Cut.LEFT), int(Cut.TOP))
    }
    assert after[Cut.LEFT].covariance[0, 3, 3] > 1.5 * after[0].covariance[0, 3, 3]
    assert after[Cut.TOP].covariance[0, 6, 6] > after[0].covariance[0, 6, 6]
    assert after[Cut.LEFT].size_m[0, 1] == pytest.approx(0.6)
    assert after[0].size_m[0, 1] < 0.55


# -- life -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "lives"), [("unknown", 3), ("vru", 5), ("vehicle", 8), ("obstacle", 1)])
def test_each_class_coasts_as_long_as_is_set_for_it(name: str, lives: int) -> None:
    settings = dataclasses.replace(
        PLAIN, max_misses=3, max_misses_vru=5, max_misses_vehicle=8, max_misses_obstacle=1, max_position_sigma_m=99.0
    )
    start = follow([seen([9, 0, 0])] * 5, settings)[-1]
    tracks = dataclasses.replace(start, class_probability=np.eye(4)[[CLASSES.index(name)]])
    frames = 0
    while len(tracks):
        tracks, frames = update_tracks(tracks, NOTHING, tracks.time_s + 0.01, settings), frames + 1
    assert frames == lives + 1


@pytest.mark.parametrize("distance_m", [0.5, 2.0, 8.0])
def test_what_a_new_track_is_given_for_its_speed_never_brakes(distance_m: float) -> None:
    rule = DecisionSettings(corridor=CorridorSettings(width_m=2.0), min_object_px=1.0)
    tracks = update_tracks(Tracks.empty(), seen([distance_m, 0, 0.5]), 0.0, PLAIN)
    assert not decide(tracks, Ego(speed_mps=15.0), rule).brake  # tentative
    known = update_tracks(Tracks.empty(), seen([distance_m, 0, 0.5]), 0.0, dataclasses.replace(PLAIN, confirm_hits=1))
    assert known.status[0] == TrackStatus.CONFIRMED
    assert not decide(known, Ego(), rule).brake  # its speed is 0, whatever its standard deviation


def test_nothing_at_all_and_measurements_without_noise_give_no_number_that_is_none() -> None:
    tracks = follow([NOTHING, seen([5, 0, 0], variance=0.0)] * 3 + [seen([5, 0, 0], variance=0.0)] * 4, dt=1e-9)[-1]
    assert np.isfinite(tracks.state).all()
    assert np.isfinite(tracks.covariance).all()


# -- motion -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("w", [0.0, 1e-4, 0.3, -2.0])
def test_the_turn_is_the_solution_of_its_differential_equation(w: float) -> None:
    F, dF, T = np.empty((3, 3)), np.empty((3, 3)), 0.4
    turning(T, w, F, dF)
    np.testing.assert_allclose(F, expm(T * np.array([[0, 1, 0], [0, 0, 1], [0, -w * w, 0]])), atol=1e-9)
    above, below, unused = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    turning(T, w + 1e-5, above, unused)
    turning(T, w - 1e-5, below, unused)
    np.testing.assert_allclose(dF, (above - below) / 2e-5, atol=1e-6)


def turn(t: float, rate: float = 0.8) -> np.ndarray:
    """State of an object that circles at 4 m/s."""
    a, r = rate * t, 4 / rate
    place, speed = r * np.array([np.sin(a), 1 - np.cos(a)]), 4 * np.array([np.cos(a), np.sin(a)])
    pull = 4 * rate * np.array([-np.sin(a), np.cos(a)])
    return np.array([10 + place[0], speed[0], pull[0], place[1], speed[1], pull[1], 0, 0, 0])


def test_a_predicted_turn_goes_round_and_its_covariance_is_that_of_a_linearised_one() -> None:
    settings = dataclasses.replace(PLAIN, motion=MotionSettings(model="coordinated_turn"), max_position_sigma_m=1e3)
    start = follow([seen([10, 0, 0])] * 3, settings)[-1]
    P = np.diag([1e-4, 1e-6, 1e-6] * 3)
    known = dataclasses.replace(start, state=turn(0.0)[None], covariance=P[None])
    T = 1.0
    after = update_tracks(known, NOTHING, known.time_s + T, settings)
    np.testing.assert_allclose(after.state[0], turn(T), atol=1e-4)
    straight = dataclasses.replace(settings, motion=MotionSettings())
    assert abs(update_tracks(known, NOTHING, known.time_s + T, straight).state[0] - turn(T)).max() > 0.3

    def moved(state: np.ndarray) -> np.ndarray:
        tracks = dataclasses.replace(known, state=state[None])
        return update_tracks(tracks, NOTHING, known.time_s + T, settings).state[0]

    J = np.stack([(moved(turn(0) + d) - moved(turn(0) - d)) / 2e-5 for d in 1e-5 * np.eye(9)], axis=1)
    expected = J @ P @ J.T + np.kron(np.eye(3), MOTION["coordinated_turn"](T, settings.motion)[1])
    np.testing.assert_allclose(after.covariance[0], expected, rtol=1e-5, atol=1e-6)


def test_a_turn_is_a_mode_of_an_interacting_model_and_wins_on_a_circle() -> None:
    modes = Mode(model="constant_velocity", velocity_drift_mps=0.1), Mode(model="coordinated_turn", drift_mps2=0.5)
    settings = dataclasses.replace(PLAIN, motion=MotionSettings(modes=modes))
    frames = [seen(turn(0.05 * k)[::3], variance=1e-4) for k in range(40)]
    tracks = follow(frames, settings)[-1]
    assert tracks.mode_probability[0, 1] > 0.8
    np.testing.assert_allclose(tracks.state[0, [1, 4]], turn(39 * 0.05)[[1, 4]], atol=0.2)


def test_process_noise_follows_the_innovations_up_down_and_no_further_than_set() -> None:
    rng = np.random.default_rng(2)
    motion = MotionSettings(model="constant_velocity", velocity_drift_mps=0.3, adapt_s=0.3, adapt_limit=50.0)
    settings = dataclasses.replace(PLAIN, motion=motion, gate_probability=1 - 1e-12)
    factor = {}
    for drift in (0.003, 0.3, 3.0):
        v = np.cumsum(drift * np.sqrt(0.05) * rng.standard_normal((300, 3)), axis=0)
        places = np.array([50.0, 0, 0]) + np.cumsum(0.05 * v, axis=0) + 0.02 * rng.standard_normal((300, 3))
        steps = follow([seen(place) for place in places], settings)
        factor[drift] = float(np.mean([np.log(step.memory[0, NOISE]) for step in steps[100:]]))  # type: ignore[index]
    assert factor[0.003] < -1.0
    assert abs(factor[0.3]) < 1.0
    assert factor[3.0] > 2.5
    assert all(abs(value) <= np.log(50.0) + 1e-9 for value in factor.values())
    still = follow([seen(place) for place in places], dataclasses.replace(PLAIN, motion=MotionSettings()))[-1]
    assert still.memory[0, NOISE] == 1.0  # type: ignore[index]


# -- own motion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rear_axle_m", [0.0, -2.5])
@pytest.mark.parametrize("modes", [(), (Mode(model="constant_velocity"), Mode(model="coordinated_turn"))])
def test_over_the_ground_a_pole_stands_for_a_car_that_turns_and_brakes(
    modes: tuple[Mode, ...], rear_axle_m: float
) -> None:
    motion = MotionSettings(model="constant_velocity", velocity_drift_mps=0.1, modes=modes)
    still = {}
    for frame in ("ground", "vehicle"):
        settings = dataclasses.replace(
            PLAIN, motion=motion, frame=frame, rear_axle_m=rear_axle_m, gate_probability=1 - 1e-12
        )  # type: ignore[arg-type]
        tracks, axle, heading, speed, worst = Tracks.empty(), np.zeros(2), 0.0, 12.0, 0.0
        for k in range(40):
            turned = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
            pole = turned @ (np.array([25.0, 3.0]) - axle) + [rear_axle_m, 0.0]
            ego = Ego(speed_mps=speed, yaw_rate_radps=0.5)
            tracks = update_tracks(tracks, seen([*pole, 0.5], variance=1e-4), 0.05 * k, settings, ego)
            over_ground = tracks.state[0, [1, 4]] + [speed, -0.5 * rear_axle_m]
            sigma = np.sqrt(tracks.covariance[0][[1, 4], [1, 4]])
            worst = max(worst, float((abs(over_ground) / sigma).max())) if k > 15 else worst
            for _ in range(500):  # the car's own way, in small steps
                axle = axle + 1e-4 * speed * np.array([np.cos(heading), np.sin(heading)])
                heading, speed = heading + 1e-4 * 0.5, speed - 1e-4 * 5.0
        still[frame] = worst
    assert still["ground"] < 1.0
    assert still["vehicle"] > 3.0


def test_where_the_wheel_is_turned_the_tracks_turn_with_our_axes_at_once() -> None:
    settings, pole = dataclasses.replace(PLAIN, position_sigma_m=0.0), np.array([20.0, -2.0])
    tracks, heading, speed_mps, yaw_rate = Tracks.empty(), 0.0, 10.0, 0.25
    at = np.zeros(2)
    for k in range(60):
        yaw = yaw_rate if k >= 40 else 0.0
        turned = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        x, y = turned @ (pole - at)
        before, ego = tracks, Ego(speed_mps=speed_mps, yaw_rate_radps=yaw)
        tracks = update_tracks(tracks, seen([x, y, 0.5], variance=1e-4), 0.02 * k, settings, ego)
        true = np.array([-speed_mps + yaw * y, -yaw * x])
        if 38 <= k <= 41:  # 12 m ahead the pole moves across by 3 m/s from one frame to the next
            np.testing.assert_allclose(tracks.state[0, [1, 4]], true, atol=0.3)
        for _ in range(20):
            at = at + 1e-3 * speed_mps * np.array([np.cos(heading), np.sin(heading)])
            heading += 1e-3 * yaw
    assert np.linalg.eigvalsh(tracks.covariance[0]).min() > 0
    for now in (Ego(yaw_rate_radps=0.1), Ego(speed_mps=None, yaw_rate_radps=0.1)):  # nobody knows how fast we turned
        unknown = update_tracks(dataclasses.replace(before, ego=Ego()), NOTHING, before.time_s + 0.02, settings, now)
        straight = update_tracks(dataclasses.replace(before, ego=now), NOTHING, before.time_s + 0.02, settings, now)
        np.testing.assert_array_equal(unknown.state, straight.state)


def test_without_an_own_speed_the_ground_is_that_of_the_vehicle() -> None:
    frames = [seen([9 - 0.1 * k, 0.1, 0]) for k in range(8)]
    ground = follow(frames, dataclasses.replace(PLAIN, frame="ground"))[-1]
    np.testing.assert_array_equal(ground.state, follow(frames)[-1].state)


def passing(side: float, cut: int) -> list[Tracks]:
    """Tracks of something 2 m wide beside our way, whose outer end the edge of the image cuts further and further."""
    steps, tracks = [], Tracks.empty()
    for k in range(40):
        width = 2.0 if k < 20 else 2.0 - 0.08 * (k - 20)
        place = [10.0, side * (2.0 + width / 2), 0.9]
        tracks = update_tracks(tracks, seen([place], width=width, cut=cut if k >= 20 else 0), 0.02 * k, PLAIN)
        steps.append(tracks)
    return steps


HIDDEN_LEFT, HIDDEN_RIGHT = Cut.OCCLUDED | Cut.HIDDEN_LEFT, Cut.OCCLUDED | Cut.HIDDEN_RIGHT


@pytest.mark.parametrize(
    ("side", "cut"), [(1.0, Cut.LEFT), (-1.0, Cut.RIGHT), (1.0, HIDDEN_LEFT), (-1.0, HIDDEN_RIGHT)]
)
def test_what_is_cut_or_hidden_at_its_outer_side_is_placed_by_its_inner_end(side: float, cut: Cut) -> None:
    steps = passing(side, int(cut))
    assert all(len(each) == 1 for each in steps)
    assert np.abs([each.state[0, 3] - 3 * side for each in steps]).max() < 0.05
    assert np.abs([each.state[0, 4] for each in steps[20:]]).max() < 0.3
    assert steps[-1].memory is not None
    assert steps[-1].memory[0, MEMORY.index("placed_width")] == pytest.approx(2.0, rel=0.05)


def test_what_is_hidden_nobody_knows_where_is_placed_where_it_is_seen() -> None:
    last = passing(1.0, int(Cut.OCCLUDED))[-1]
    assert last.memory is not None
    assert last.memory[0, MEMORY.index("placed_width")] == pytest.approx(0.6, abs=0.2)
    assert last.state[0, 3] < 2.9


BETWEEN = HIDDEN_LEFT | HIDDEN_RIGHT


WALKING = MotionSettings(model="constant_velocity", velocity_drift_mps=0.3)


@pytest.mark.parametrize("modes", [(), (WALKING, WALKING)])
def test_who_walks_on_behind_a_gap_is_as_fast_as_before_though_the_gap_stands(modes: tuple[MotionSettings]) -> None:
    """0.5 m wide, at 1 m/s across; from the 20th frame on only what a gap of 0.05 m shows is seen."""
    settings = dataclasses.replace(PLAIN, motion=dataclasses.replace(WALKING, modes=modes))
    frames = [seen([8.0, -1.15 + 0.05 * k, 0.9]) for k in range(20)]
    frames += [seen([8.0, 0.0, 0.9], width=0.05, cut=int(BETWEEN)) for _ in range(20, 26)]
    steps = follow(frames, settings)
    for k, step in enumerate(steps[20:], start=20):
        assert len(step.age) == 1
        assert step.state[0, 3] == pytest.approx(-1.15 + 0.05 * k, abs=0.03)
        assert step.state[0, 4] == pytest.approx(1.0, abs=0.2)
    memory = steps[-1].memory
    assert memory is not None
    assert memory[0, MEMORY.index("placed_width")] == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("off_m", [0.0, 0.19, 0.3, 1.0])
@pytest.mark.parametrize("sigma_m", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("width_m", [0.1, 0.48, 0.5])
def test_a_sight_between_two_things_cuts_off_where_its_middle_cannot_be(
    off_m: float, sigma_m: float, width_m: float
) -> None:
    x, P, memory = np.zeros(9), np.zeros((9, 9)), np.zeros(len(MEMORY))
    x[3], P[3, 3], memory[0] = 0.0, sigma_m**2, np.log(0.5)
    y, variance = within(x, P, 0.0, np.array([1e-12, 2.0, width_m]), memory, off_m)
    gain = sigma_m**2 / (sigma_m**2 + variance)
    half = (0.5 - width_m) / 2
    low, high = (off_m - half) / sigma_m, (off_m + half) / sigma_m
    if low > 5:
        assert gain * y == pytest.approx(off_m - half, abs=1e-6)
    else:
        mean, left = truncnorm.stats(low, high, scale=sigma_m) if half > 0 else (off_m, 0.0)
        assert gain * y == pytest.approx(mean, abs=0.01 * sigma_m)
        assert sigma_m**2 * (1 - gain) == pytest.approx(left, abs=1e-3 * sigma_m**2)


def test_a_sight_that_may_be_anywhere_in_a_track_says_nothing() -> None:
    x, P, memory = np.zeros(9), np.eye(9) * 1e-4, np.zeros(len(MEMORY))
    memory[0] = np.log(2.0)
    y, variance = within(x, P, 0.0, np.array([1e-4, 2.0, 0.1]), memory, 0.3)
    assert abs(y * 2e-4 / (2e-4 + variance)) < 1e-9
    assert variance > 1e3 * P[3, 3]


def test_the_height_of_who_is_hidden_at_a_side_is_learnt_and_of_whom_below_not() -> None:
    for cut, learns in ((HIDDEN_LEFT, True), (BETWEEN, True), (Cut.OCCLUDED | Cut.HIDDEN_UP, False)):
        start = follow([seen([8.0, 0.0, 0.9], height=1.7)] * 10)[-1]
        lower = seen([8.0, 0.0, 0.9], height=1.6, cut=int(cut))
        memory = update_tracks(start, lower, 0.5, PLAIN).memory
        assert memory is not None
        assert np.exp(memory[0, 1]) == pytest.approx(1.67 if learns else 1.7, abs=1e-3)


@pytest.mark.parametrize("association", ["global", "joint_probabilistic"])
@pytest.mark.parametrize(("height", "sigmas", "own"), [(1.7, 1.0, True), (1.4, 1.0, False), (1.7, 6.0, False)])
def test_who_was_hidden_takes_only_what_is_likelier_his_than_a_new_ones(
    association: Any, height: float, sigmas: float, own: bool
) -> None:
    settings = dataclasses.replace(PLAIN, association=association, gate_probability=1 - 1e-9)
    hidden = follow([seen([8.0, 0.0, 0.9])] * 30 + [NOTHING] * 8, settings)[-1]
    shown = seen([8.0 + sigmas * np.sqrt(hidden.covariance[0, 0, 0]), 0.0, 0.9], height=height)
    for density, takes in ((0.05, own), (0.0, True)):
        last = update_tracks(hidden, shown, 1.9, dataclasses.replace(settings, new_density_per_m3=density))
        assert len(last.age) == (1 if takes else 2)
        assert (last.misses[0] == 0) == takes


def peeping(side: float, settings: TrackingSettings, cut: Cut, count: int = 8) -> Tracks:
    """Something 0.5 m wide at rest, first seen as one edge beside something nearer that moves away to the side."""
    frames = []
    for k in range(count):
        width = 0.1 + 0.04 * k
        frames.append(seen([8.0, side * (0.25 - width / 2), 0.9], width=width, cut=int(cut)))
    return follow(frames, settings)[-1]


@pytest.mark.parametrize(("side", "cut"), [(1.0, HIDDEN_RIGHT), (-1.0, HIDDEN_LEFT)])
def test_an_edge_that_is_seen_first_does_not_move_with_what_hides_the_rest(side: float, cut: Cut) -> None:
    expecting = dataclasses.replace(PLAIN, cut_width_m=0.5)
    known, blind = peeping(side, expecting, cut), peeping(side, PLAIN, cut)
    assert abs(known.state[0, 3]) < 0.03
    assert abs(known.state[0, 4]) < 0.1
    assert abs(blind.state[0, 4]) < 0.1  # though its centre moves as the rest comes into sight
    first = peeping(side, expecting, cut, 1)
    assert first.memory is not None
    np.testing.assert_allclose(np.exp(first.memory[0, 0]), 0.5)
    assert first.memory[0, MEMORY.index("placed_width")] == pytest.approx(0.5)
    both = peeping(side, expecting, HIDDEN_LEFT | HIDDEN_RIGHT, 1)
    assert both.state[0, 3] == pytest.approx(side * 0.2)  # on either side there may be more
    assert both.covariance[0, 3, 3] > (0.29 * 0.4) ** 2


def coming(mps: float, side: float, noise_m: float = 0.0, seed: int = 0, count: int = 24) -> list[Tracks]:
    """Something 0.4 m wide that comes from one side, cut by the edge of what is looked at, 1 m aside, and then whole.

    noise_m: standard deviation of where it ends.
    """
    rng, frames = np.random.default_rng(seed), []
    for k in range(count):
        end = 0.9 - mps * k * 0.05 + rng.normal(0, noise_m)
        far = max(min(end + 0.4, 1.0), end + 0.01)
        cut = int(Cut.LEFT if side > 0 else Cut.RIGHT) if end + 0.4 > 1.0 else 0
        frames.append(seen([6.0, side * (end + far) / 2, 0.9], width=far - end, cut=cut))
    return follow(frames, PLAIN)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_comes_into_sight_is_as_fast_as_its_leading_end_and_goes_on_so_when_all_of_it_is_seen(side: float) -> None:
    steps = coming(0.5, side)
    speeds = np.array([-side * step.state[0, 4] for step in steps])
    assert abs(speeds[4:] - 0.5).max() < 0.06  # its centre moves at half that speed while it is cut
    assert [len(step) for step in steps] == [1] * len(steps)
    memory = steps[-1].memory
    assert memory is not None
    assert memory[0, MEMORY.index("placed_side")] == 0
    assert memory[0, MEMORY.index("placed_width")] == pytest.approx(0.4, abs=0.02)
    cut = steps[2].memory
    assert cut is not None
    assert cut[0, MEMORY.index("placed_side")] == side


def test_the_speed_of_what_comes_into_sight_is_as_uncertain_as_it_says() -> None:
    errors = []
    for seed in range(60):
        step = coming(0.5, 1.0, noise_m=0.05, seed=seed, count=6)[-1]
        errors.append((step.state[0, 4] + 0.5) / np.sqrt(step.covariance[0, 4, 4]))
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 1.2  # its process noise is not there


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_box_beside_our_way_whose_far_end_gets_dim_stands_still(side: float) -> None:
    """0.4 m wide, its near end 0.8 m aside; of its far end we see 6 mm less in each frame."""
    frames = [seen([3.0, side * (1.0 - 0.003 * k), 0.2], width=0.4 - 0.006 * k) for k in range(20)]
    by_middle = follow(frames)[-1]
    by_end = follow(frames, dataclasses.replace(PLAIN, beside_m=0.2))[-1]
    on_the_way = follow(frames, dataclasses.replace(PLAIN, beside_m=0.81))[-1]
    assert -side * by_middle.state[0, 4] > 0.04
    assert abs(by_end.state[0, 4]) < 0.01
    assert by_end.state[0, 3] == pytest.approx(side * 1.0, abs=0.01)
    np.testing.assert_array_equal(on_the_way.state, by_middle.state)


def test_what_crosses_our_way_is_placed_by_its_near_end_then_its_middle_then_the_other_end() -> None:
    frames = [seen([3.0, 0.79 - 0.05 * k, 0.2], width=0.4) for k in range(33)]
    steps = follow(frames, dataclasses.replace(PLAIN, beside_m=0.2))
    sides = [step.memory[0, MEMORY.index("placed_side")] for step in steps if step.memory is not None]
    assert sides == [1.0] * 8 + [0.0] * 16 + [-1.0] * 9
    speeds = np.array([step.state[0, 4] for step in steps])
    assert abs(speeds[10:] + 1.0).max() < 0.03
    assert abs(steps[-1].state[0, 3] + 0.81) < 0.01


@pytest.mark.parametrize("missing", [0.1, 0.5, 1.0])
def test_of_what_leaves_the_image_the_depth_is_as_uncertain_as_the_share_of_its_width_that_is_missing(
    missing: float,
) -> None:
    """0.5 m wide and 0.2 m deep; what is seen for the first time may be missing anything."""
    start = follow([seen([3.0, 0.3, 0.9])] * 8)[-1] if missing < 1 else Tracks.empty()
    width = 0.5 * (1 - missing) if missing < 1 else 0.5
    cut = seen([3.0, 0.05 + width / 2, 0.9], width=width, cut=int(Cut.LEFT))
    expected = seen([3.0, 0.3, 0.9])
    expected.covariance_m2[0, 0, 0] += (PLAIN.cut_sigma * 0.2 * missing) ** 2
    one, other = (update_tracks(start, each, 0.4, PLAIN) for each in (cut, expected))
    assert len(one.age) == len(other.age) == 1
    assert one.covariance[0, 0, 0] == pytest.approx(other.covariance[0, 0, 0], rel=0.02)


def test_what_fills_the_image_more_and_more_goes_on_closing_in() -> None:
    """A car ahead, 0.34 m wide and 0.3 m deep, that we come up to at 0.4 m/s until half of it is beside the image."""
    frames = []
    for k in range(60):
        x, width = 1.0 - 0.4 * k / 30, 0.34 * min(1.0, 1.5 - k / 60)
        frames.append(seen([x, 0.2 - (0.34 - width) / 2, 0.2], width, 0.2, 1e-4, int(Cut.LEFT) if width < 0.34 else 0))
    steps = follow(frames, dataclasses.replace(PLAIN, end_sigma_m=0.02), 1 / 30)
    assert len(steps[-1].age) == 1
    for step in steps[40:]:
        assert -step.state[0, 1] > 2 * np.sqrt(step.covariance[0, 1, 1])


def test_the_filter_of_several_modes_follows_an_end_as_one_does() -> None:
    both = dataclasses.replace(PLAIN, motion=MotionSettings(modes=(PLAIN.motion, PLAIN.motion)))
    frames = [seen([6.0, 0.9 - 0.02 * k, 0.9], width=0.1 + 0.02 * k, cut=int(Cut.LEFT)) for k in range(6)]
    one, two = follow(frames, PLAIN)[-1], follow(frames, both)[-1]
    np.testing.assert_allclose(two.state, one.state, atol=1e-9)
    np.testing.assert_allclose(two.covariance, one.covariance, atol=1e-9)


def test_what_is_seen_whole_or_wider_than_expected_is_as_wide_as_it_is_seen() -> None:
    expecting = dataclasses.replace(PLAIN, cut_width_m=0.5)
    for width, cut in ((0.1, Cut(0)), (0.8, HIDDEN_LEFT)):
        segments = seen([8.0, 0.2, 0.9], width=width, cut=int(cut))
        new = [update_tracks(Tracks.empty(), segments, 0.0, settings) for settings in (PLAIN, expecting)]
        np.testing.assert_array_equal(new[0].covariance, new[1].covariance)
        np.testing.assert_array_equal(new[0].state, new[1].state)
    beside = [dataclasses.replace(each, beside_m=0.2) for each in (PLAIN, expecting)]  # nothing cuts it short
    new = [update_tracks(Tracks.empty(), seen([8.0, 1.0, 0.9]), 0.0, settings) for settings in beside]
    np.testing.assert_array_equal(new[0].state, new[1].state)
    assert new[0].state[0, 3] == 1.0
