"""Motion models: F and Q against closed forms, numerical integration and each other."""

import typing

import numpy as np
import pytest
from scipy.linalg import expm

from rangecam.motion import (
    MOTION,
    MotionSettings,
    constant_acceleration,
    constant_velocity,
    mode_switching,
    singer,
    wiener_acceleration,
)

CONTINUOUS = ["constant_acceleration", "singer"]


def van_loan(rate: float, q: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """F and Q of dx/dt = v, dv/dt = a, da/dt = -rate a + jerk, by the matrix exponential."""
    A = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -rate]])
    G = np.diag([0, 0, q])
    big = expm(np.block([[-A, G], [np.zeros((3, 3)), A.T]]) * dt)
    F = big[3:, 3:].T
    return F, F @ big[:3, 3:]


@pytest.mark.parametrize(
    ("dt", "digits"),
    [
        (1 / 50, [[4.0e-08, 4.0e-06, 2.0e-04], [4.0e-06, 4.0e-04, 2.0e-02], [2.0e-04, 2.0e-02, 1.0]]),
        (
            1 / 15,
            [
                [4.938272e-06, 1.481481e-04, 2.222222e-03],
                [1.481481e-04, 4.444444e-03, 6.666667e-02],
                [2.222222e-03, 6.666667e-02, 1.0],
            ],
        ),
    ],
)
def test_the_thesis_q_has_the_printed_digits_and_rank_one(dt: float, digits: list[list[float]]) -> None:
    _, Q = wiener_acceleration(dt, MotionSettings(step_mps2=1.0))
    np.testing.assert_allclose(Q, digits, rtol=1e-6)
    assert np.linalg.matrix_rank(Q) == 1


@pytest.mark.parametrize("name", sorted(set(MOTION) - {"constant_velocity"}))
def test_f_moves_a_constant_acceleration_as_school_physics_does(name: str) -> None:
    F, _ = MOTION[name](0.1, MotionSettings(memory_s=1e6))
    np.testing.assert_allclose(F @ [2.0, -3.0, 4.0], [2 - 0.3 + 0.02, -3 + 0.4, 4.0], rtol=1e-6)


@pytest.mark.parametrize("name", sorted(MOTION))
@pytest.mark.parametrize("dt", [0.0, 1e-4, 0.02, 1.0, 5.0])
def test_q_is_symmetric_and_never_negative_and_f_triangular(name: str, dt: float) -> None:
    F, Q = MOTION[name](dt, MotionSettings())
    np.testing.assert_array_equal(Q, Q.T)
    assert np.linalg.eigvalsh(Q).min() >= -1e-12 * np.trace(Q)
    np.testing.assert_array_equal(np.tril(F, -1), 0)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_in_no_time_nothing_happens(name: str) -> None:
    F, Q = MOTION[name](0.0, MotionSettings())
    np.testing.assert_array_equal(F, np.eye(3))
    np.testing.assert_array_equal(Q, 0)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_two_short_steps_are_one_long_step(name: str) -> None:
    (F1, Q1), (F2, Q2), (F, Q) = (MOTION[name](dt, MotionSettings()) for dt in (0.03, 0.2, 0.23))
    np.testing.assert_allclose(F2 @ F1, F, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(F2 @ Q1 @ F2.T + Q2, Q, rtol=1e-10)


def test_the_thesis_q_of_a_long_step_is_not_that_of_two_short_ones() -> None:
    (F, Q1), (_, Q2) = (wiener_acceleration(dt, MotionSettings()) for dt in (0.1, 0.2))
    assert (F @ Q1 @ F.T + Q1)[2, 2] == pytest.approx(2 * Q2[2, 2])


@pytest.mark.parametrize("memory_s", [0.05, 0.5, 20.0, 1e5])
@pytest.mark.parametrize("dt", [1e-3, 0.02, 0.5])
def test_singer_is_the_integral_of_its_differential_equation(memory_s: float, dt: float) -> None:
    F, Q = singer(dt, MotionSettings(drift_mps2=2.0, memory_s=memory_s))
    expected_f, expected_q = van_loan(1 / memory_s, 4.0, dt)
    np.testing.assert_allclose(F, expected_f, rtol=1e-7, atol=1e-15)
    np.testing.assert_allclose(Q, expected_q, rtol=1e-5, atol=1e-13)


def test_constant_acceleration_is_the_integral_of_its_differential_equation() -> None:
    F, Q = constant_acceleration(0.3, MotionSettings(drift_mps2=2.0))
    expected_f, expected_q = van_loan(0.0, 4.0, 0.3)
    np.testing.assert_allclose(F, expected_f, rtol=1e-12)
    np.testing.assert_allclose(Q, expected_q, rtol=1e-9)


def test_singer_with_a_long_memory_is_constant_acceleration() -> None:
    long, constant = singer(0.1, MotionSettings(memory_s=1e7)), constant_acceleration(0.1, MotionSettings())
    for one, other in zip(long, constant, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_singer_with_a_short_memory_is_constant_velocity_with_white_acceleration() -> None:
    F, Q = singer(1.0, MotionSettings(drift_mps2=3.0, memory_s=1e-3))
    np.testing.assert_allclose(F[:2, 2], 0, atol=2e-3)
    q = (3.0 * 1e-3) ** 2  # spectral density of the acceleration
    np.testing.assert_allclose(Q[:2, :2], q * np.array([[1 / 3, 1 / 2], [1 / 2, 1]]), rtol=1e-2)


def test_each_noise_setting_scales_q_of_its_models_with_its_square() -> None:
    for name, key in (
        ("constant_acceleration", "drift_mps2"),
        ("singer", "drift_mps2"),
        ("wiener_acceleration", "step_mps2"),
        ("constant_velocity", "velocity_drift_mps"),
    ):
        (_, one), (_, three) = (MOTION[name](0.1, MotionSettings(**{key: value})) for value in (1.0, 3.0))
        np.testing.assert_allclose(three, 9 * one, rtol=1e-12)


def test_every_model_can_be_chosen_by_name() -> None:
    assert set(typing.get_args(typing.get_type_hints(MotionSettings)["model"])) == set(MOTION)


def test_constant_velocity_forgets_the_acceleration_and_is_the_integral_of_a_drifting_velocity() -> None:
    F, Q = constant_velocity(0.2, MotionSettings(velocity_drift_mps=3.0))
    np.testing.assert_allclose(F @ [2.0, -3.0, 4.0], [2 - 0.6, -3, 0])
    np.testing.assert_allclose(Q[:2, :2], 9 * np.array([[0.2**3 / 3, 0.2**2 / 2], [0.2**2 / 2, 0.2]]))
    assert not Q[2].any()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_switching_of_two_short_frames_is_that_of_a_long_one_and_leaves_a_mode_at_the_stated_rate(
    count: int,
) -> None:
    one, two, both = (mode_switching(dt, count, 1.5) for dt in (0.03, 0.2, 0.23))
    np.testing.assert_allclose(one @ two, both, rtol=1e-12)
    np.testing.assert_allclose(both.sum(axis=1), 1)
    kept = mode_switching(1e-6, count, 1.5)[0, 0]
    assert (1 - kept) / 1e-6 == pytest.approx(1 / 1.5 if count > 1 else 0.0, rel=1e-5)
