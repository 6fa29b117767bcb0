"""Tracking: the filter against references, the association against brute force, the life of tracks, and quality."""

import dataclasses
import itertools
import typing
from functools import cache

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import chi2, multivariate_normal

from rangecam.errors import DataError
from rangecam.motion import MOTION, TURNS, Mode, MotionSettings, mode_switching
from rangecam.studies.study import Study
from rangecam.studies.tracking_models import tracking_models
from rangecam.tracking import ASSOCIATION, TrackingSettings, update_tracks
from rangecam.tracking.association import NO_PAIR
from rangecam.tracking.filter import take_only_candidates
from rangecam.tracking.rules import gate_threshold
from rangecam.types import POSITION, VELOCITY, Ego, Refused, Segments, Tracks, TrackStatus

H = np.kron(np.eye(3), [1.0, 0.0, 0.0])
PLAIN = TrackingSettings(position_sigma_m=0.0, extent_sigma=0.0)


def seen(positions: object, covariance: object = 0.01, **fields: object) -> Segments:
    """Segments at these positions; a number as covariance means so many m2 along each axis."""
    z = np.asarray(positions, float).reshape(-1, 3)
    n = len(z)
    R = np.eye(3) * covariance if np.isscalar(covariance) else np.asarray(covariance)
    whole = {
        "label": np.arange(1, n + 1),
        "position_m": z,
        "covariance_m2": np.broadcast_to(R, (n, 3, 3)).copy(),
        "size_m": np.full((n, 3), 0.5),
        "near_m": z[:, 0] - 0.2,
        "n_pixels": np.full(n, 30),
        "box": np.zeros((n, 4), int),
        "range_m": z[:, 0].copy(),
        "sigma_range_m": np.full(n, 0.1),
        "amplitude": np.ones(n),
        "cut": np.zeros(n, np.uint8),
        "nearest_m": z - [0.2, 0.0, 0.0],
    }
    return Segments(**{**whole, **fields})  # type: ignore[arg-type]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20080301)


NOTHING = seen(np.zeros((0, 3)))


def follow(frames: object, settings: TrackingSettings = PLAIN, dt: float = 0.02) -> list[Tracks]:
    """Tracks after each of the frames."""
    steps, tracks = [], Tracks.empty()
    for k, segments in enumerate(frames):  # type: ignore[arg-type, var-annotated]
        tracks = update_tracks(tracks, segments, k * dt, settings)
        steps.append(tracks)
    return steps


def still(n: int, position: object = (5.0, 1.0, 0.5)) -> list[Segments]:
    return [seen([position])] * n


# -- the filter -------------------------------------------------------------------------------------------------------


def test_a_track_is_that_of_filterpy(rng: np.random.Generator) -> None:
    R = np.diag([0.01, 0.02, 0.03])
    peer = KalmanFilter(dim_x=9, dim_z=3)
    peer.H, peer.R = H, R
    tracks = Tracks.empty()
    for k, dt in enumerate([0.0, 0.02, 0.02, 0.05, 0.1, 0.02, 0.02, 0.02]):
        z = np.array([10 - 2 * k * 0.02, 1.0, 0.5]) + rng.normal(0, 0.02, 3)
        tracks = update_tracks(tracks, seen(z, R), dt + (0 if k == 0 else tracks.time_s), PLAIN)
        if k == 0:
            peer.x, peer.P = tracks.state[0][:, None].copy(), tracks.covariance[0].copy()
            continue
        F, Q = (np.kron(np.eye(3), block) for block in MOTION["constant_acceleration"](dt, PLAIN.motion))
        peer.predict(F=F, Q=Q)
        peer.update(z[:, None])
        np.testing.assert_allclose(tracks.state[0], peer.x[:, 0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(tracks.covariance[0], peer.P, rtol=0, atol=1e-9)
        assert tracks.nis[0] == pytest.approx((peer.y.T @ peer.SI @ peer.y).item(), rel=1e-9)


def reference(
    tracks: Tracks, z: np.ndarray, R: np.ndarray, dt: float, motion: MotionSettings
) -> tuple[np.ndarray, ...]:
    """Plain NumPy step in Joseph's form; segment i belongs to track i."""
    F, Q = (np.kron(np.eye(3), block) for block in MOTION[motion.model](dt, motion))
    x = tracks.state @ F.T
    P = F @ tracks.covariance @ F.T + Q
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    innovation = z - x @ H.T
    A = np.eye(9) - K @ H
    new_p = A @ P @ A.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1)
    nis = np.einsum("ni,nij,nj->n", innovation, np.linalg.inv(S), innovation)
    return x + np.einsum("nij,nj->ni", K, innovation), new_p, nis


@pytest.mark.parametrize("model", sorted(set(MOTION) - {TURNS}))
def test_twenty_tracks_with_correlated_noise_are_those_of_the_textbook(model: str, rng: np.random.Generator) -> None:
    settings = dataclasses.replace(PLAIN, motion=MotionSettings(model=model))  # type: ignore[arg-type]
    place = np.stack(np.meshgrid([4.0, 8.0, 12.0, 16.0], [-4.0, -2.0, 0.0, 2.0, 4.0]), -1).reshape(-1, 2)
    z = np.column_stack([place, np.full(20, 0.8)])
    tracks = update_tracks(Tracks.empty(), seen(z), 0.0, settings)
    for k in range(1, 6):
        B = rng.normal(0, 0.05, (20, 3, 3))
        R = B @ B.transpose(0, 2, 1) + 1e-3 * np.eye(3)
        z = z + rng.normal([-0.05, 0.01, 0], 0.02, z.shape)
        x, P, nis = reference(tracks, z, R, 0.04, settings.motion)
        tracks = update_tracks(tracks, seen(z, covariance_m2=R), 0.04 * k, settings)
        np.testing.assert_allclose(tracks.state, x, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(tracks.covariance, P, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(tracks.nis, nis, rtol=1e-8)


MODES = MotionSettings(
    modes=(
        Mode(model="constant_velocity", velocity_drift_mps=0.3),
        Mode(model="constant_acceleration", drift_mps2=5.0),
        Mode(model="singer", drift_mps2=20.0, memory_s=0.4),
    ),
    mode_memory_s=0.8,
    lateral_share=0.5,
    vertical_share=0.2,
)


def interacting_reference(
    tracks: Tracks, z: np.ndarray, R: np.ndarray, dt: float, motion: MotionSettings
) -> tuple[np.ndarray, ...]:
    """Plain NumPy step of one track by Blom and Bar-Shalom (1988): probability, state and covariance of each mode."""
    mu, x, P = tracks.mode_probability[0], tracks.mode_state[0], tracks.mode_covariance[0]
    count = len(mu)
    switching = expm(
        dt / motion.mode_memory_s * (np.ones((count, count)) / (count - 1) - np.eye(count) * count / (count - 1))
    )
    predicted = mu @ switching
    new_x, new_p, likelihood = np.empty_like(x), np.empty_like(P), np.empty(count)
    for k, mode in enumerate(motion.modes):
        weight = mu * switching[:, k] / predicted[k]
        start = weight @ x
        spread = sum(w * (p + np.outer(e - start, e - start)) for w, p, e in zip(weight, P, x, strict=True))
        F, Q = MOTION[mode.model](dt, mode)
        F, Q = np.kron(np.eye(3), F), np.kron(np.diag([1, motion.lateral_share**2, motion.vertical_share**2]), Q)
        m, C = F @ start, F @ spread @ F.T + Q
        S = H @ C @ H.T + R
        K = C @ H.T @ np.linalg.inv(S)
        new_x[k], new_p[k] = m + K @ (z - H @ m), C - K @ S @ K.T
        likelihood[k] = multivariate_normal(H @ m, S).pdf(z)
    mu = predicted * likelihood
    return mu / mu.sum(), new_x, new_p


def test_the_interacting_model_is_that_of_the_textbook(rng: np.random.Generator) -> None:
    settings = dataclasses.replace(PLAIN, motion=MODES)
    tracks = update_tracks(Tracks.empty(), seen([9.0, 1.0, 0.5]), 0.0, settings)
    for k in range(1, 30):
        z = np.array([9 - 0.2 * k + 0.004 * max(k - 10, 0) ** 2, 1.0, 0.5]) + rng.normal(0, 0.03, 3)
        B = rng.normal(0, 0.03, (3, 3))
        R = B @ B.T + 1e-3 * np.eye(3)
        mu, x, P = interacting_reference(tracks, z, R, 0.03, MODES)
        tracks = update_tracks(tracks, seen(z, R), 0.03 * k, settings)
        np.testing.assert_allclose(tracks.mode_probability[0], mu, rtol=1e-7, atol=1e-12)
        np.testing.assert_allclose(tracks.mode_state[0], x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(tracks.mode_covariance[0], P, rtol=0, atol=1e-9)
        mean = mu @ x
        np.testing.assert_allclose(tracks.state[0], mean, rtol=0, atol=1e-9)
        apart = np.einsum("k,ka,kb->ab", mu, x - mean, x - mean)
        np.testing.assert_allclose(tracks.covariance[0], np.tensordot(mu, P, 1) + apart, rtol=0, atol=1e-9)
    assert not np.allclose(mu, 1 / 3, atol=0.1)


def test_modes_that_are_all_alike_are_the_one_model(rng: np.random.Generator) -> None:
    frames = [seen(np.array([5 - 0.1 * k, 1.0, 0.5]) + rng.normal(0, 0.02, 3)) for k in range(20)]
    alike = dataclasses.replace(PLAIN, motion=MotionSettings(modes=(Mode(), Mode())))
    for one, both in zip(follow(frames), follow(frames, alike), strict=True):
        np.testing.assert_allclose(both.state, one.state, rtol=0, atol=1e-9)
        np.testing.assert_allclose(both.covariance, one.covariance, rtol=0, atol=1e-9)
        np.testing.assert_allclose(both.nis, one.nis, rtol=1e-7)
        np.testing.assert_allclose(both.mode_probability, 0.5)


def test_without_a_measurement_only_the_switching_moves_the_probabilities_of_the_modes() -> None:
    settings = dataclasses.replace(PLAIN, motion=MODES)
    frames = [seen([9 - 0.2 * k + 0.01 * k**2, 1.0, 0.5]) for k in range(15)]
    before = follow(frames, settings)[-1]
    missed = update_tracks(before, NOTHING, before.time_s + 0.1, settings)
    expected = before.mode_probability @ mode_switching(0.1, 3, MODES.mode_memory_s)
    np.testing.assert_allclose(missed.mode_probability, expected, rtol=1e-12)
    assert abs(before.mode_probability - expected).max() > 1e-3


def test_tracks_of_one_model_can_be_carried_on_with_several() -> None:
    one = follow(still(10))[-1]
    settings = dataclasses.replace(PLAIN, motion=MODES)
    several = update_tracks(one, still(1)[0], one.time_s + 0.02, settings)
    assert several.mode_state.shape == (1, 3, 9)
    assert np.isfinite(several.mode_covariance).all()


def test_competing_tracks_with_several_modes_keep_their_identities(rng: np.random.Generator) -> None:
    settings = dataclasses.replace(PLAIN, motion=MODES, gate_probability=0.9999)
    pair = np.array([[8.0, 0.2, 1.0], [8.0, -0.2, 1.0]])
    frames = [seen(pair + rng.normal(0, 0.05, (2, 3)), 0.01) for _ in range(30)]
    last = follow(frames, settings)[-1]
    assert last.track_id.tolist() == [1, 2]
    np.testing.assert_allclose(last.state[:, 3], [0.2, -0.2], atol=0.1)


def test_the_vertical_share_scales_noise_and_first_guess_of_the_vertical_axis_alone() -> None:
    plain, flat = (
        update_tracks(follow(still(1), settings)[-1], NOTHING, 0.1, settings)
        for settings in (PLAIN, dataclasses.replace(PLAIN, motion=MotionSettings(vertical_share=0.1)))
    )
    np.testing.assert_array_equal(flat.covariance[0, :6, :6], plain.covariance[0, :6, :6])
    R = 0.01
    expected = 0.01 * (plain.covariance[0, 6:, 6:] - np.diag([R, 0, 0])) + np.diag([R, 0, 0])
    np.testing.assert_allclose(flat.covariance[0, 6:, 6:], expected, rtol=1e-12)


@pytest.mark.parametrize("model", ["constant_acceleration", "coordinated_turn"])
def test_the_lateral_share_scales_noise_and_first_acceleration_across_our_way_alone(model: typing.Any) -> None:
    plain, narrow = (
        update_tracks(follow(still(1), settings)[-1], NOTHING, 0.1, settings).covariance[0]
        for share in (1.0, 0.1)
        for settings in [dataclasses.replace(PLAIN, motion=MotionSettings(model=model, lateral_share=share))]
    )
    changes = np.zeros((9, 9), bool)
    changes[3:6, 3:6] = True
    np.testing.assert_array_equal(narrow[~changes], plain[~changes])
    R, v = 0.01, PLAIN.speed_sigma_mps**2  # these stay: what is left is a hundredth
    stays = np.array([[R + 0.01 * v, 0.1 * v, 0.0], [0.1 * v, v, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(narrow[3:6, 3:6], 0.01 * plain[3:6, 3:6] + 0.99 * stays, rtol=1e-12)


@pytest.mark.parametrize("variance", [1e-10, 1e-4, 1.0])
def test_covariances_stay_symmetric_and_positive_over_thousands_of_steps(variance: float) -> None:
    settings = dataclasses.replace(PLAIN, motion=MotionSettings(drift_mps2=0.1), speed_sigma_mps=30.0)
    P = follow([seen([5.0, 1.0, 0.5], variance)] * 3000, settings, 0.001)[-1].covariance[0]
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0


def test_the_innovations_of_a_true_model_are_chi_square(rng: np.random.Generator) -> None:
    motion = MotionSettings(drift_mps2=2.0)
    F, Q = (np.kron(np.eye(3), block) for block in MOTION["constant_acceleration"](0.05, motion))
    root = np.linalg.cholesky(Q)
    settings = dataclasses.replace(PLAIN, motion=motion, gate_probability=1 - 1e-12)
    x, tracks, nis = np.zeros((40, 9)), Tracks.empty(), []
    x[:, POSITION] = np.column_stack([np.full(40, 100.0), np.arange(40) * 50.0, np.zeros(40)])
    for k in range(60):
        tracks = update_tracks(tracks, seen(x[:, POSITION] + rng.normal(0, 0.1, (40, 3))), 0.05 * k, settings)
        nis += list(tracks.nis) if k > 20 else []
        x = x @ F.T + rng.normal(size=(40, 9)) @ root.T
    low, high = chi2.ppf([0.001, 0.999], 3 * len(nis)) / len(nis)
    assert low < np.mean(nis) < high
    assert len(tracks) == 40


def test_a_dropped_frame_changes_nothing_but_the_missing_measurement() -> None:
    start = follow(still(4))[-1]
    once = update_tracks(start, NOTHING, start.time_s + 0.3, PLAIN)
    twice = update_tracks(update_tracks(start, NOTHING, start.time_s + 0.1, PLAIN), NOTHING, start.time_s + 0.3, PLAIN)
    np.testing.assert_allclose(once.state, twice.state, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(once.covariance, twice.covariance, rtol=1e-9, atol=1e-12)


def test_a_repeated_frame_is_not_used_twice_and_the_tracks_say_so() -> None:
    one = update_tracks(Tracks.empty(), seen([5, 0, 0]), 1.0, PLAIN)
    two = update_tracks(one, seen([[5.1, 0, 0], [9, 0, 0]]), 1.0, PLAIN)
    assert (one.refused, two.refused) == (Refused.NOTHING, Refused.REPEATED)
    assert two.state is one.state
    assert update_tracks(two, seen([5, 0, 0]), 1.1, PLAIN).refused == Refused.NOTHING


def test_two_frames_within_a_nanosecond_count_as_two_measurements() -> None:
    one = update_tracks(Tracks.empty(), seen([5, 0, 0]), 1.0, PLAIN)
    two = update_tracks(one, seen([5.1, 0, 0]), 1.0 + 1e-9, PLAIN)
    assert two.state[0, 0] == pytest.approx(5.05)
    assert two.covariance[0, 0, 0] == pytest.approx(0.005)


# -- what a measurement is worth --------------------------------------------------------------------------------------


def test_the_common_position_error_and_the_extent_add_to_the_noise() -> None:
    settings = TrackingSettings(position_sigma_m=0.3, extent_sigma=0.1)
    tracks = update_tracks(Tracks.empty(), seen([5, 0, 0], size_m=np.array([[1.0, 2.0, 3.0]])), 0.0, settings)
    variances = tracks.covariance[0][POSITION, POSITION]
    np.testing.assert_allclose(variances, 0.01 + 0.09 + 0.01 * np.array([1.0, 4.0, 9.0]))


@pytest.mark.parametrize("motion", [MotionSettings(drift_mps2=0.5), MotionSettings(modes=(Mode(drift_mps2=0.5),) * 2)])
def test_the_innovations_are_chi_square_where_an_error_lasts_and_is_told_to(
    motion: MotionSettings, rng: np.random.Generator
) -> None:
    dt_s, lasts_s, sigma_m, count = 0.05, 5.0, 0.1, 20
    F, Q = (np.kron(np.eye(3), block) for block in MOTION["constant_acceleration"](dt_s, Mode(drift_mps2=0.5)))
    root, kept = np.linalg.cholesky(Q), np.exp(-dt_s / lasts_s)
    lasting = TrackingSettings(
        motion=motion, position_sigma_m=sigma_m, position_lasts_s=lasts_s, extent_sigma=0.0, gate_probability=1 - 1e-12
    )
    ways = {"lasting": lasting, "each on its own": dataclasses.replace(lasting, position_lasts_s=0.0)}
    tracks, nis = dict.fromkeys(ways, Tracks.empty()), {name: list[float]() for name in ways}
    x, bias = np.zeros((count, 9)), rng.normal(0, sigma_m, (count, 3))
    x[:, POSITION] = np.column_stack([np.full(count, 100.0), np.arange(count) * 50.0, np.zeros(count)])
    for k in range(120):
        segments = seen(x[:, POSITION] + bias + rng.normal(0, 0.02, (count, 3)), 0.02**2)
        for name, settings in ways.items():
            tracks[name] = update_tracks(tracks[name], segments, dt_s * k, settings)
            nis[name] += list(tracks[name].nis) if k > 20 else []
        x = x @ F.T + rng.normal(size=(count, 9)) @ root.T
        bias = kept * bias + sigma_m * np.sqrt(1 - kept**2) * rng.normal(size=(count, 3))
    assert np.mean(nis["lasting"]) / 3 == pytest.approx(1.0, abs=0.06)
    assert np.mean(nis["each on its own"]) / 3 < 0.2
    first = update_tracks(Tracks.empty(), seen([5, 0, 0]), 0.0, lasting)
    np.testing.assert_allclose(first.covariance[0][POSITION, POSITION], 0.01 + sigma_m**2)


def ends(count: int, sigma_m: float, rng: np.random.Generator, still: bool) -> list[Segments]:
    """Something 1 m wide and high at rest, whose four ends err on their own; still: by the same in each frame."""
    frames, error = [], rng.normal(0, sigma_m, (2, 2))
    for _ in range(count):
        error = error if still else rng.normal(0, sigma_m, (2, 2))
        low, high = -0.5 + error[0], 0.5 + error[1]
        size = np.array([[0.1, *(high - low)]])
        frames.append(seen([5.0, *(high + low) / 2], 1e-6, size_m=size, box=np.array([[0, 0, 300, 300]])))
    return frames


def test_the_centroid_is_as_uncertain_as_the_ends_of_the_outline_are_restless(rng: np.random.Generator) -> None:
    motion = MotionSettings(drift_mps2=0.01)
    told = dataclasses.replace(
        PLAIN, motion=motion, outline_sigma=0.5, speed_sigma_mps=0.01, gate_probability=1 - 1e-12
    )
    steps = follow(ends(400, 0.05, rng, still=False), told)
    assert np.mean([each.nis[0] for each in steps[50:]]) / 3 == pytest.approx(0.75, abs=0.25)  # x hardly errs
    quiet = follow(ends(60, 0.05, rng, still=True), told)
    assert quiet[0].covariance[0, 3, 3] == pytest.approx(1e-6 + (0.5 * 0.3) ** 2, rel=0.4)  # how wide is not yet known
    assert quiet[-1].covariance[0, 3, 3] < steps[-1].covariance[0, 3, 3] / 20


def pieces(count: int, rng: np.random.Generator) -> list[Segments]:
    """A car at rest, 1.8 m wide, that comes out of the noise: a piece, a larger one, all of it; ends err by 8 cm."""
    frames, low, high = [], *np.sort(rng.uniform(-0.9, 0.9, 2))
    for k in range(count):
        if k == 2:
            low, high = -0.9, 0.9
        elif k:
            low, high = rng.uniform(-0.9, low), rng.uniform(high, 0.9)
        right, left = np.array([low, high]) + rng.normal(0, 0.08, 2)
        size = np.array([[0.5, max(left - right, 0.1), 0.5]])
        R = np.diag([0.1, 0.08**2 / 2, 0.01])
        frames.append(seen(rng.multivariate_normal([20.0, (left + right) / 2, 0.0], R * [1, 0, 1]), R, size_m=size))
    return frames


@pytest.mark.parametrize("modes", [(), (Mode(), Mode(model="wiener_acceleration", step_mps2=1.0))])
def test_what_comes_out_of_the_noise_piece_by_piece_is_not_taken_to_move(
    modes: tuple[Mode, ...], rng: np.random.Generator
) -> None:
    motion = MotionSettings(model="wiener_acceleration", step_mps2=1.0, modes=modes)
    settings = dataclasses.replace(PLAIN, motion=motion, speed_sigma_mps=8.0, gate_probability=0.999)
    of_both, of_speed = [], []
    for _ in range(150):
        tracks = follow(pieces(15, rng), settings)[-1]
        e, P = tracks.state[0, 3:5], tracks.covariance[0, 3:5, 3:5]
        of_both.append(e @ np.linalg.solve(P, e) / 2)
        of_speed.append(e[1] ** 2 / P[1, 1])
    assert np.mean(of_both) < 1.5
    assert np.mean(np.array(of_speed) > 3**2) < 0.02


def test_ends_that_err_by_as_much_as_is_said_make_nobody_less_sure(rng: np.random.Generator) -> None:
    widths = 0.5 + 4 * 0.1 * np.concatenate([[0.0], rng.uniform(-0.5, 0.5, 30)])
    jittering = [seen([5.0, 0.0, 0.0], size_m=np.array([[0.5, w, 0.5]])) for w in widths]
    as_wide = follow([seen([5.0, 0.0, 0.0])] * len(widths))[-1]
    np.testing.assert_allclose(follow(jittering)[-1].covariance[0], as_wide.covariance[0], rtol=1e-12)
    jittering[20] = seen([5.0, 0.0, 0.0], size_m=np.array([[0.5, 2.0, 0.5]]))
    assert follow(jittering[:21])[-1].covariance[0, 3, 3] > 2 * follow(jittering[:20])[-1].covariance[0, 3, 3]


def test_a_jitter_of_the_time_stamps_blurs_only_what_moves() -> None:
    def final(speed: float, jitter: float) -> Tracks:
        settings = dataclasses.replace(PLAIN, frame_time_sigma_s=jitter)
        return follow([seen([20 - 0.05 * speed * k, 0, 0], 1e-4) for k in range(30)], settings, 0.05)[-1]

    moving, standing = final(4.0, 0.02).covariance[0], final(0.0, 0.02).covariance[0]
    exact = final(4.0, 0.0).covariance[0]
    assert moving[0, 0] > 10 * exact[0, 0]
    assert moving[3, 3] == pytest.approx(exact[3, 3], rel=1e-3)
    assert standing[0, 0] == pytest.approx(exact[0, 0], rel=1e-3)


def test_size_nearest_point_and_pixels_are_running_means() -> None:
    first = seen([5, 0, 0], size_m=np.array([[1.0, 1.0, 1.0]]), near_m=np.array([4.8]), n_pixels=np.array([10]))
    second = seen([5, 0, 0], size_m=np.array([[2.0, 1.0, 3.0]]), near_m=np.array([4.4]), n_pixels=np.array([20]))
    tracks = follow([first, second], dataclasses.replace(PLAIN, shape_weight=0.25))[-1]
    np.testing.assert_allclose(tracks.size_m[0], [1.25, 1.0, 1.5])
    assert tracks.near_offset_m[0] == pytest.approx(0.75 * 0.2 + 0.25 * 0.6)
    assert tracks.n_pixels[0] == pytest.approx(12.5)


# -- gate and association ---------------------------------------------------------------------------------------------


def test_the_gate_is_the_quantile_of_chi_square_with_three_degrees_of_freedom() -> None:
    assert gate_threshold(0.999) == pytest.approx(chi2.ppf(0.999, 3))
    assert gate_threshold(0.683) < 3.6 < gate_threshold(0.999)


def test_the_gate_refuses_as_many_true_measurements_as_it_says(rng: np.random.Generator) -> None:
    n, accepted = 400, 0
    settings = dataclasses.replace(PLAIN, gate_probability=0.9)
    place = np.column_stack([np.full(n, 50.0), np.arange(n) * 100.0, np.zeros(n)])
    for _ in range(10):
        tracks = update_tracks(Tracks.empty(), seen(place + rng.normal(0, 0.1, (n, 3))), 0.0, settings)
        tracks = update_tracks(tracks, seen(place + rng.normal(0, 0.1, (n, 3))), 1e-9, settings)
        accepted += int((tracks.segment[:n] > 0).sum())
    sigma = np.sqrt(0.9 * 0.1 / (10 * n))
    assert accepted / (10 * n) == pytest.approx(0.9, abs=4 * sigma)


def test_the_squared_distance_of_true_matches_has_mean_three_but_not_with_the_printed_weights(
    rng: np.random.Generator,
) -> None:
    # E-K-20: eq 6.15 prints 1 / sigma on the diagonal of the inverse covariance; in centimetres or metres
    for unit in (1.0, 100.0):
        sigma = unit * np.array([0.1, 0.3, 0.05])
        off = sigma * rng.standard_normal((4000, 3))
        place, wide = [50 * unit, 0, 0], dataclasses.replace(PLAIN, gate_probability=1.0, max_position_sigma_m=1e3)
        tracks = update_tracks(Tracks.empty(), seen(place, np.diag(sigma**2) / 2), 0.0, wide)
        nis = [update_tracks(tracks, seen(z + place, np.diag(sigma**2) / 2), 1e-9, wide).nis[0] for z in off[:500]]
        assert np.mean(nis) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 500))
        assert abs((off**2 / sigma).sum(axis=1).mean() - 3.0) > 1.0


def test_the_printed_measurement_matrix_cannot_see_two_of_the_three_axes() -> None:
    # E-K-21: eq 6.23 picks states 1, 2 and 3; observable are those of which H F^k tells, k = 0 to 8
    F = np.kron(np.eye(3), MOTION["constant_acceleration"](0.02, PLAIN.motion)[0])

    def rank(H: np.ndarray) -> int:
        rows = np.concatenate([H @ np.linalg.matrix_power(F, 10 * k) for k in range(9)])
        return int(np.linalg.matrix_rank(rows))

    assert rank(H) == 9
    assert rank(np.eye(9)[:3]) == 3
    # so with H of a person who steps aside the tracker sees the step
    last = follow([seen([5, 0, 0])] * 5 + [seen([5, 0.5, 0.3])] * 40)[-1]
    np.testing.assert_allclose(last.state[0, POSITION], [5, 0.5, 0.3], atol=0.05)


def test_the_edge_of_the_gate_is_an_ellipsoid_of_the_innovation_covariance() -> None:
    tracks = update_tracks(Tracks.empty(), seen([5, 0, 0], np.diag([0.01, 0.04, 0.01])), 0.0, PLAIN)
    radius = np.sqrt(gate_threshold(0.999))
    sigma = np.sqrt([0.02, 0.05, 0.02])  # of the innovation: P + R
    direction = np.array([0.6, 0.48, 0.64])
    for share, taken in ((0.999, 1), (1.001, 0)):
        z = np.array([5, 0, 0]) + share * radius * sigma * direction
        after = update_tracks(tracks, seen(z), 1e-9, PLAIN)
        assert int(after.segment[0]) == taken
        assert len(after) == 2 - taken


@st.composite
def costs(draw: st.DrawFn) -> np.ndarray:
    n, m = draw(st.integers(0, 4)), draw(st.integers(0, 4))
    value = st.one_of(st.just(NO_PAIR), st.integers(-40, 40).map(float))
    return np.array(draw(st.lists(value, min_size=n * m, max_size=n * m)), float).reshape(n, m)


def total(cost: np.ndarray, took: typing.Sequence[int]) -> tuple[int, float]:
    """Unpaired tracks and the cost of the pairs: what the best association makes small, in this order."""
    pairs = [(i, j) for i, j in enumerate(took) if j >= 0]
    return len(took) - len(pairs), sum(cost[i, j] for i, j in pairs)


@given(costs())
def test_the_global_association_is_the_best_of_all(cost: np.ndarray) -> None:
    n, m = cost.shape
    took = ASSOCIATION["global"](cost, np.ones(n, int))
    every = (
        choice
        for choice in itertools.product(range(-1, m), repeat=n)
        if len([j for j in choice if j >= 0]) == len({j for j in choice if j >= 0})
        and all(j < 0 or cost[i, j] < NO_PAIR for i, j in enumerate(choice))
    )
    assert total(cost, list(took)) == min(total(cost, choice) for choice in every)


@pytest.mark.parametrize("name", sorted(ASSOCIATION))
@given(costs())
def test_where_nothing_competes_every_association_takes_every_candidate(name: str, cost: np.ndarray) -> None:
    took, candidates = np.empty(len(cost), int), cost < NO_PAIR
    alone = bool((candidates.sum(axis=0) <= 1).all() and (candidates.sum(axis=1) <= 1).all())
    unseen = np.arange(len(cost)) % 2
    missed = bool(candidates[unseen > 0].any())
    assert take_only_candidates(cost, unseen, True, took) == (alone and not missed)
    assert take_only_candidates(cost, unseen, False, took) == alone
    if alone:
        np.testing.assert_array_equal(took, ASSOCIATION[name](cost, np.arange(len(cost))))


@pytest.mark.parametrize("name", sorted(ASSOCIATION))
@given(costs())
def test_no_association_takes_a_segment_twice_or_from_outside_the_gate(name: str, cost: np.ndarray) -> None:
    before = cost.copy()
    took = ASSOCIATION[name](cost, np.arange(len(cost)))
    taken = took[took >= 0]
    assert took.shape == (len(cost),)
    assert len(set(taken)) == len(taken)
    assert all(cost[i, j] < NO_PAIR for i, j in enumerate(took) if j >= 0)
    np.testing.assert_array_equal(cost, before)


def test_by_age_the_oldest_chooses_first_and_globally_both_are_served() -> None:
    cost = np.array([[1.0, 2.0], [0.0, NO_PAIR]])
    np.testing.assert_array_equal(ASSOCIATION["by_age"](cost, np.array([9, 3])), [0, -1])
    np.testing.assert_array_equal(ASSOCIATION["global"](cost, np.array([9, 3])), [1, 0])


def test_the_association_is_chosen_by_name() -> None:
    assert set(typing.get_args(typing.get_type_hints(TrackingSettings)["association"])) == set(ASSOCIATION)


def test_the_named_association_is_the_one_that_is_used() -> None:
    frames = [seen([5, 0, 0])] * 3 + [seen([[5, 0, 0], [5, 0.8, 0]])] * 9 + [seen([[5, 0.4, 0], [5, -0.42, 0]])]
    alone = dataclasses.replace(PLAIN, recognise_merges=False)
    last = {name: follow(frames, dataclasses.replace(alone, association=name))[-1] for name in ASSOCIATION}
    np.testing.assert_array_equal(last["by_age"].segment, [1, 0, 2])  # the oldest takes the nearest
    assert len(last["greedy"]) >= 2
    np.testing.assert_array_equal(last["global"].segment, [2, 1])
    np.testing.assert_array_equal(last["joint_probabilistic"].segment, [2, 1])
    assert abs(last["joint_probabilistic"].state - last["global"].state).max() > 0.005


def test_two_objects_that_cross_keep_their_identities() -> None:
    frames = [seen([[8, -1 + 0.04 * k, 0], [8.2, 1 - 0.04 * k, 0]], 1e-4) for k in range(50)]
    tracks = follow(frames, dt=0.04)[-1]
    np.testing.assert_array_equal(tracks.track_id, [1, 2])
    assert tracks.state[0, VELOCITY[1]] == pytest.approx(1.0, abs=0.1)
    assert tracks.state[0, POSITION[1]] > 0.9


def test_a_walker_keeps_the_identity_through_half_a_second_behind_a_pole() -> None:
    frames = [NOTHING if 20 <= k < 32 else seen([8, -1 + 0.05 * k, 0], 1e-3) for k in range(60)]
    steps = follow(frames, dataclasses.replace(PLAIN, max_misses=15), 0.04)
    np.testing.assert_array_equal(steps[-1].track_id, [1])
    assert steps[31].status[0] == TrackStatus.COASTING
    assert steps[31].misses[0] == 12
    assert np.isnan(steps[31].nis[0])
    assert steps[32].status[0] == TrackStatus.CONFIRMED


# -- life -------------------------------------------------------------------------------------------------------------


def test_a_new_track_stands_still_knows_nothing_and_is_tentative() -> None:
    settings = dataclasses.replace(PLAIN, speed_sigma_mps=7.0, acceleration_sigma_mps2=2.0)
    track = update_tracks(Tracks.empty(), seen([5, 1, 0.5]), 3.0, settings)[0]
    assert (track.track_id, track.status, track.age, track.hits, track.misses) == (1, TrackStatus.TENTATIVE, 1, 1, 0)
    np.testing.assert_array_equal(track.velocity_mps, 0)
    np.testing.assert_allclose(np.diag(track.covariance), [0.01, 49, 4] * 3)
    assert track.class_name == "unknown"
    assert track.near_offset_m == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("pattern", "confirmed_at"),
    [("111", 2), ("1011", 3), ("10101", 4), ("10011", 4), ("100011", None), ("1000", None)],
)
def test_three_of_the_first_five_frames_confirm(pattern: str, confirmed_at: int | None) -> None:
    steps = follow([still(1)[0] if hit == "1" else NOTHING for hit in pattern])
    alive = [[int(s) for i, s in zip(t.track_id, t.status, strict=True) if i == 1] for t in steps]
    confirmed = [k for k, status in enumerate(alive) if status == [TrackStatus.CONFIRMED]]
    assert (confirmed[0] if confirmed else None) == confirmed_at
    if confirmed_at is None:
        assert 1 not in steps[-1].track_id


def test_one_hit_can_be_enough_to_confirm() -> None:
    tracks = update_tracks(Tracks.empty(), still(1)[0], 0.0, dataclasses.replace(PLAIN, confirm_hits=1))
    assert tracks.status[0] == TrackStatus.CONFIRMED


def test_a_confirmed_track_ends_after_its_last_allowed_miss() -> None:
    settings = dataclasses.replace(PLAIN, max_misses=4)
    steps = follow(still(5) + [NOTHING] * 6, settings)
    assert [len(t) for t in steps[4:]] == [1, 1, 1, 1, 1, 0, 0]


def test_a_track_ends_when_nobody_knows_any_more_where_it_is() -> None:
    start = follow(still(5))[-1]
    assert len(update_tracks(start, NOTHING, start.time_s + 0.1, PLAIN)) == 1
    assert len(update_tracks(start, NOTHING, start.time_s + 20.0, PLAIN)) == 0
    lenient = dataclasses.replace(PLAIN, max_position_sigma_m=1e4)
    assert len(update_tracks(start, NOTHING, start.time_s + 20.0, lenient)) == 1


def test_numbers_are_never_given_twice() -> None:
    frames = [seen([5 + 10 * (k // 3), 0, 0]) if k % 3 == 0 else NOTHING for k in range(30)]
    steps = follow(frames, dt=0.5)
    born = [i for a, b in itertools.pairwise(steps) for i in set(b.track_id) - set(a.track_id)]
    assert len(born) == len(set(born)) == 9


def test_segments_that_are_not_finite_are_ignored() -> None:
    bad_place, bad_noise = seen([[np.nan, 0, 0], [5, 0, 0]]), seen([[5, 3, 0], [5, 0, 0]])
    bad_noise.covariance_m2[0, 1, 1] = np.inf
    for segments in (bad_place, bad_noise):
        tracks = follow([segments] * 4)[-1]
        np.testing.assert_array_equal(tracks.segment, [2])
        assert np.isfinite(tracks.state).all()
        assert np.isfinite(tracks.covariance).all()
        assert tracks.ignored == 1


# -- time -------------------------------------------------------------------------------------------------------------


def test_a_late_frame_changes_nothing() -> None:
    tracks = follow(still(5), dt=0.1)[-1]
    late = update_tracks(tracks, seen([9, 9, 9]), tracks.time_s - 0.05, PLAIN)
    assert late.refused == Refused.LATE
    assert {k: v for k, v in vars(late).items() if k != "refused"} == {
        k: v for k, v in vars(tracks).items() if k != "refused"
    }


def test_when_the_clock_is_set_back_tracking_starts_anew() -> None:
    tracks = follow(still(5), dt=1.0)[-1]
    again = update_tracks(tracks, still(1)[0], 0.0, dataclasses.replace(PLAIN, max_late_s=0.5))
    assert (again.time_s, len(again), again.next_id) == (0.0, 1, tracks.next_id + 1)
    assert again.track_id[0] == tracks.next_id
    assert again.status[0] == TrackStatus.TENTATIVE
    assert again.refused == Refused.CLOCK_SET_BACK


@pytest.mark.parametrize("time_s", [np.nan, np.inf])
def test_a_time_that_is_none_is_refused(time_s: float) -> None:
    with pytest.raises(DataError, match="expected seconds"):
        update_tracks(Tracks.empty(), NOTHING, time_s, PLAIN)


def test_inputs_are_not_modified() -> None:
    tracks, segments = follow([seen([[5, 0, 0], [7, 2, 0]])] * 3)[-1], seen([[5.1, 0, 0], [3, 3, 3]])
    before = [{k: np.copy(v) for k, v in vars(x).items() if isinstance(v, np.ndarray)} for x in (tracks, segments)]
    update_tracks(tracks, segments, 1.0, PLAIN)
    for x, arrays in zip((tracks, segments), before, strict=True):
        for name, values in arrays.items():
            np.testing.assert_array_equal(getattr(x, name), values)


def test_integer_and_single_precision_segments_are_welcome() -> None:
    segments = seen([5, 0, 0])
    single = seen([5, 0, 0], position_m=np.array([[5, 0, 0]], np.float32), label=np.array([1], np.int32))
    one, other = (update_tracks(Tracks.empty(), s, 0.0, PLAIN) for s in (segments, single))
    np.testing.assert_array_equal(one.state, other.state)
    assert other.segment.dtype == np.int64


# -- quality ----------------------------------------------------------------------------------------------------------


@cache
def another_study_of_models() -> Study:
    return tracking_models(np.random.default_rng(3))


def test_the_interacting_model_is_as_good_as_is_asked_and_honest_about_it() -> None:
    study = another_study_of_models()
    asked = [claim for claim in study.claims if claim.agrees is not None]
    assert len(asked) == 4
    assert all(claim.agrees for claim in asked), [claim for claim in asked if not claim.agrees]


def test_on_a_braking_car_the_models_stand_in_the_order_of_their_flexibility() -> None:
    study = another_study_of_models()
    error = {claim.text: claim.computed for claim in study.claims}
    order = ["interacting", "Singer", "constant acceleration", "constant velocity"]
    errors = [error[f"braking, {name}: of the velocity"] for name in order]
    assert errors == sorted(errors)


def polar_measurement(truth: np.ndarray, rng: np.random.Generator) -> Segments:
    """A point measured with 0.1 m in range and 0.02 rad in azimuth and elevation, and its covariance."""
    d, azimuth, elevation = (
        np.linalg.norm(truth),
        np.arctan2(truth[1], truth[0]),
        np.arcsin(truth[2] / np.linalg.norm(truth)),
    )
    d, azimuth, elevation = np.array([d, azimuth, elevation]) + rng.normal(0, [0.1, 0.02, 0.02])
    ray = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    left = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(ray, left)
    R = 0.01 * np.outer(ray, ray) + (0.02 * d) ** 2 * (np.outer(left, left) + np.outer(up, up))
    return seen(d * ray, R)


def braking(t: float) -> tuple[np.ndarray, np.ndarray]:
    """20 m ahead, closing at 10 m/s, after 0.7 s braking with 6 m/s2: position and velocity."""
    late = max(t - 0.7, 0.0)
    return np.array([20 - 10 * t + 3 * late**2, 1.0, 0.5]), np.array([-10 + 6 * late, 0.0, 0.0])


def walking(t: float) -> tuple[np.ndarray, np.ndarray]:
    """A pedestrian 15 m ahead who crosses at 5 km/h and stops for a second in the middle."""
    speed = 5 / 3.6
    moving = min(t, 1.5) + max(t - 2.5, 0.0)
    return np.array([15.0, -2 + speed * moving, 0.9]), np.array([0.0, 0.0 if 1.5 < t < 2.5 else speed, 0.0])


@pytest.mark.parametrize(("path", "duration_s", "limits"), [(braking, 2.3, (0.13, 0.90)), (walking, 4.0, (0.19, 0.90))])
def test_errors_are_as_small_as_published_and_the_covariance_owns_up_to_them(
    path: typing.Callable[[float], tuple[np.ndarray, np.ndarray]], duration_s: float, limits: tuple[float, float]
) -> None:
    settings = TrackingSettings(
        position_sigma_m=0.0,
        extent_sigma=0.0,
        speed_sigma_mps=8.0,
        acceleration_sigma_mps2=5.0,
        gate_probability=1 - 1e-9,
        motion=MotionSettings(drift_mps2=np.sqrt(10)),
    )
    errors, nees = [], []
    for run in range(40):
        rng, tracks = np.random.default_rng(run), Tracks.empty()
        for k in range(int(duration_s * 50)):
            position, velocity = path(k / 50)
            tracks = update_tracks(tracks, polar_measurement(position, rng), k / 50, settings)
            if k >= 25:  # after half a second
                e = tracks.state[0][[0, 3, 6, 1, 4, 7]] - np.concatenate([position, velocity])
                P = tracks.covariance[0][np.ix_([0, 3, 6, 1, 4, 7], [0, 3, 6, 1, 4, 7])]
                errors.append([e[:3] @ e[:3], e[3:] @ e[3:]])
                nees.append(e @ np.linalg.solve(P, e) / 6)
    rmse = np.sqrt(np.mean(errors, axis=0))
    assert (rmse < limits).all(), rmse
    assert 0.6 < np.mean(nees) < 1.25


def test_while_we_brake_tracks_follow_a_deceleration_that_nobody_has_told_them() -> None:
    """A box ahead, seen within 2 mm, while we brake with 7 m/s2 from one frame to the next and then stand."""
    worst = []
    for allowed in (0.0, 3.0):
        settings = dataclasses.replace(
            PLAIN, position_sigma_m=0.002, extent_sigma=0.0, own_braking_mps2=allowed, gate_probability=1.0
        )
        tracks, gap_m, speed_mps, nis = Tracks.empty(), 5.0, 3.0, []
        for k in range(60):
            ego = Ego(k / 30, braking=k >= 30)
            tracks = update_tracks(tracks, seen([(gap_m, 0.0, 0.5)], 1e-6), k / 30, settings, ego)
            slower_mps = max(speed_mps - 7.0 / 30, 0.0) if k >= 30 else speed_mps
            gap_m, speed_mps = gap_m - (speed_mps + slower_mps) / 60, slower_mps
            nis.append(float(tracks.nis[0]))
        worst.append(max(nis[20:]))
    assert worst[0] > gate_threshold(0.95) > 2 * worst[1]
