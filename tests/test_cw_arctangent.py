"""Claims about the ways to get a phase from real and imaginary part."""

import numpy as np
import pytest

from rangecam.cw.arctangent import (
    ANGLE_BITS,
    ARCTANGENTS,
    EIGHTH_TURN,
    FRACTION_BITS,
    INTEGER_TABLE,
    TABLE_SIZE,
    TURN,
    integer_angle,
)

# Largest error, rad: of the table by its curvature (N-S-025), of its nearest entry half a step, of CORDIC its last
# turn, of the series their first neglected term, of single precision some roundings of 2 pi.
STEP = 1 / (TABLE_SIZE - 1)
CURVATURE = 3 * np.sqrt(3) / 8
BOUNDS = {
    "table": STEP**2 / 8 * CURVATURE,
    "table_alone": STEP / 2,
    "integer_table": STEP**2 / 8 * CURVATURE + 2.0**-FRACTION_BITS * STEP + 2 * 2.0**-ANGLE_BITS,
    "cordic": 2.0**-23,
    "taylor": np.tan(np.pi / 8) ** 17 / 17,
    "chebyshev": 2 * (np.sqrt(2) - 1) ** 17 / 17 / (1 - (np.sqrt(2) - 1) ** 2),
    "libm": 0.0,
    "polynomial": 1e-6,
}
AXES = np.array([0, 1, 1, 1, 0, -1, -1, -1]), np.array([1, 1, 0, -1, -1, -1, 0, 1])


def around_the_circle(count=200_001):
    angle = np.linspace(0, 2 * np.pi, count)[:-1]
    size = np.random.default_rng(1).uniform(1e3, 6e4, angle.size)
    return np.round(size * np.sin(angle)), np.round(size * np.cos(angle))


def error(name, imaginary, real):
    """The difference to the arctangent of NumPy, the short way around."""
    difference = ARCTANGENTS[name](imaginary, real) - np.arctan2(imaginary, real)
    return (difference + np.pi) % (2 * np.pi) - np.pi


def test_every_arctangent_has_a_bound():
    assert set(BOUNDS) == set(ARCTANGENTS)


@pytest.mark.parametrize("name", ARCTANGENTS)
def test_the_error_stays_within_its_bound_all_around_the_circle(name):
    worst = np.abs(error(name, *around_the_circle())).max()
    assert worst <= BOUNDS[name] + 1e-14
    assert name == "libm" or worst > BOUNDS[name] / 100


def test_the_table_comes_within_a_hundredth_of_its_bound_of_1249_nrad():
    worst = np.abs(error("table", *around_the_circle())).max()
    assert BOUNDS["table"] == pytest.approx(1.249e-6, abs=5e-10)
    assert worst == pytest.approx(1.249e-6, rel=0.01)
    assert np.abs(error("table_alone", *around_the_circle())).max() == pytest.approx(1.96e-3, rel=0.01)


def test_the_integer_table_errs_by_no_more_than_the_table_but_for_its_rounding():
    assert np.abs(error("integer_table", *around_the_circle())).max() < 1.3e-6


@pytest.mark.parametrize("name", ARCTANGENTS)
def test_the_borders_of_the_octants_are_multiples_of_an_eighth_turn(name):
    imaginary, real = AXES
    tolerance = max(BOUNDS[name] * (name != "table_alone"), 1e-14)
    np.testing.assert_allclose(ARCTANGENTS[name](imaginary, real), np.arange(8) * np.pi / 4, atol=tolerance)


@pytest.mark.parametrize("name", ARCTANGENTS)
def test_the_phase_is_zero_where_both_parts_are_and_never_leaves_one_turn(name):
    assert ARCTANGENTS[name](np.zeros(1), np.zeros(1))[0] == 0
    phase = ARCTANGENTS[name](*around_the_circle())
    assert phase.min() >= 0
    assert phase.max() <= np.float32(2 * np.pi)


@pytest.mark.parametrize("name", ARCTANGENTS)
def test_images_keep_their_shape_and_the_parts_stay_as_they_are(name):
    parts = [np.arange(-6, 6).reshape(3, 4) * k for k in (7, -5)]
    before = [part.copy() for part in parts]
    phase = ARCTANGENTS[name](*parts)
    assert phase.shape == (3, 4)
    np.testing.assert_array_equal(parts, before)
    np.testing.assert_array_equal(phase, ARCTANGENTS[name](*(part.ravel() for part in parts)).reshape(3, 4))


def test_eight_eighths_are_a_turn_and_the_table_ends_at_one_of_them():
    assert 8 * EIGHTH_TURN == TURN
    assert INTEGER_TABLE[-1] == EIGHTH_TURN
    assert INTEGER_TABLE.size == 256
    assert 2 * TURN < 2**31


def test_the_last_angle_before_a_whole_turn_is_less_than_a_turn():
    for real in (1, 3, 65520, 2**29):
        assert TURN - 2 ** (ANGLE_BITS - 1) < integer_angle(-1, max(real, 2), INTEGER_TABLE) < TURN


def test_a_mirrored_or_turned_point_has_the_mirrored_or_turned_angle():
    rng = np.random.default_rng(3)
    for y, x in rng.integers(1, 65520, (200, 2)).tolist():
        angle = integer_angle(y, x, INTEGER_TABLE)
        assert integer_angle(-y, -x, INTEGER_TABLE) == angle + TURN // 2
        assert integer_angle(x, -y, INTEGER_TABLE) == angle + TURN // 4
        assert abs(integer_angle(-y, x, INTEGER_TABLE) - (TURN - angle)) < 2.6e-6 * 2**ANGLE_BITS


def test_the_printed_turn_by_an_eighth_is_the_mirror_image_and_stays_in_the_second_octant():
    y, x = 3.0, 1.0
    assert np.arctan2(y - x, x + y) == pytest.approx(np.arctan2(y, x) - np.pi / 4)  # N-S-026, E-S-09
    assert np.arctan2(x + y, y - x) > np.pi / 4
