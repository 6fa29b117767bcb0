"""The study of the thesis' tuning: its ways and pixels are what they say, and its verdicts do not hang on the seed."""

import numpy as np
import pytest

from rangecam.studies import run_study
from rangecam.studies.tracking_tuning import (
    crossing_person,
    filtered,
    frames_of,
    lowest_of,
    phases,
    seen_person,
    smooth_car,
    stepping_car,
    twice_stopping_person,
)

PIXEL_M = 15 * np.tan(np.radians(30 / 64))


@pytest.mark.parametrize("path", [smooth_car, stepping_car, crossing_person, twice_stopping_person])
def test_velocity_and_acceleration_are_the_derivatives_of_the_way(path) -> None:
    time_s = np.linspace(0.0, 6.4, 64001) if path is not twice_stopping_person else np.linspace(0.0, 20.0, 200001)
    x, v, a = path(time_s).state.T
    assert np.abs(np.gradient(x, time_s) - v)[1:-1].max() < 1e-3
    smooth = np.abs(np.gradient(a)) == 0 if path is not smooth_car else np.ones(len(a), bool)
    np.testing.assert_allclose(np.gradient(v, time_s)[1:-1][smooth[1:-1]], a[1:-1][smooth[1:-1]], atol=1e-3)


def test_the_person_stands_where_and_when_the_thesis_says() -> None:
    at_15 = twice_stopping_person(np.arange(300) / 15).state
    assert at_15[224, 0] == pytest.approx(at_15[236, 0]) == pytest.approx(18.0)  # between step 220 and 240
    standing = np.flatnonzero((np.abs(at_15[:, 1]) < 1e-9) & (np.abs(at_15[:, 0] - 11.0) < 1e-6))
    assert len(standing) / 15 == pytest.approx(1.0, abs=0.08)
    assert at_15[285:, 0].max() > 23.0
    x, v, a = phases(np.array([0.0, 1.0, 3.0]), (2.0, 1.0), (2.0, -0.5)).state.T
    assert (x.tolist(), v.tolist(), a.tolist()) == ([2.0, 2.75, 3.0], [1.0, 0.5, 0.0], [-0.5, -0.5, 0.0])


def test_pixels_give_the_middle_of_a_person_without_bias_but_in_steps() -> None:
    rng = np.random.default_rng(1)
    y = np.linspace(-0.5, 0.5, 400)
    error = seen_person(y, 15.0, 40, rng) - y
    assert abs(error.mean()) < 0.02 * PIXEL_M
    assert 0.03 * PIXEL_M < error.std() < 0.3 * PIXEL_M
    still = seen_person(np.full(50, 0.02), 15.0, 40, rng) - 0.02
    assert abs(still.mean()) > 5 * still.std() / np.sqrt(
        still.size
    )  # what stands still is off by the same in each frame


def test_a_filter_without_process_noise_fits_a_parabola_to_all_it_has_seen() -> None:
    rng = np.random.default_rng(2)
    way = phases(np.arange(60) / 25, (20.0, -2.0), (10.0, 0.7))
    measured = way.state[:, 0] + 0.02 * rng.standard_normal((3, 60))
    error = filtered(frames_of(measured, 0.02), way, 1e-9)
    for run, found in zip(measured, error, strict=True):
        # the prior of a new track (0 +- 5 m/s, 0 +- 3 m/s2) as two more measurements, at the first frame
        t = way.time_s - way.time_s[-1]
        rows = np.stack([np.ones(60), t, t**2 / 2], axis=1) / 0.02
        prior = np.array([[0.0, 1.0, t[0]], [0.0, 0.0, 1.0]]) / [[5.0], [3.0]]
        fitted, *_ = np.linalg.lstsq(np.vstack([rows, prior]), np.concatenate([run / 0.02, [0.0, 0.0]]), rcond=None)
        np.testing.assert_allclose(way.state[-1] + found[-1], fitted, rtol=1e-5)


def test_the_lowest_point_of_a_parabola_in_logarithms_is_found_between_the_points() -> None:
    x = np.geomspace(0.01, 100.0, 9)
    assert lowest_of(x, np.exp(3 + (np.log(x) - np.log(0.7)) ** 2)) == pytest.approx(0.7)
    assert lowest_of(x, 1 / x) == pytest.approx(100.0)
    assert lowest_of(x, x) == pytest.approx(0.01)


def test_the_verdicts_of_the_tuning_do_not_hang_on_the_seed() -> None:
    claims = run_study("tracking-tuning", 1).claims
    assert [claim.text for claim in claims if claim.agrees is False] == [
        "person: best sigma_u of y over that of its velocity"
    ]
    assert {0.1, 1.0} >= {claim.computed for claim in claims if "best of the five" in claim.text}
    assert {claim.id for claim in claims} == {"N-K-085.smooth", "N-K-085.steps", "N-K-086", "N-K-087", "K-TUN-08"}
