"""Pulse, windows and their correlation (König 2008, chapter 3.3 and 4.2.3.2)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import correlate as scipy_correlate

from rangecam.errors import UsageError
from rangecam.pulsed import PulsedCamera
from rangecam.pulsed.signal import (
    collected_s,
    correlate,
    correlation_curve,
    gate_windows,
    pulse_shape,
    shutter_windows,
    trapezoid,
)

IDEAL = PulsedCamera()
SOFT = PulsedCamera(pulse_rise_s=60e-9, pulse_fall_s=30e-9, shutter_edge_s=65e-9)
NANOSECONDS = st.floats(20, 400).map(lambda x: x * 1e-9)


@settings(deadline=None)
@given(pulse_s=NANOSECONDS, width_s=NANOSECONDS, opens_s=st.floats(-1e-7, 1e-7), delay_s=st.floats(-1e-6, 1e-6))
def test_an_ideal_window_collects_its_overlap_with_the_pulse(pulse_s, width_s, opens_s, delay_s):
    camera = replace(IDEAL, pulse_width_s=pulse_s)
    overlap_s = max(0.0, min(delay_s + pulse_s, opens_s + width_s) - max(delay_s, opens_s))
    got_s = collected_s(np.array(delay_s), (opens_s, opens_s + width_s), camera)
    assert got_s == pytest.approx(overlap_s, abs=1e-20)


def test_signal_falls_in_window_a_rises_in_b_and_stays_in_c():
    """König 2008, fig 3.6 (K-SHU-05)."""
    windows, delay_s = shutter_windows(IDEAL), np.linspace(1e-9, 179e-9, 50)
    a, b, c = (collected_s(delay_s, windows[name], IDEAL) for name in "abc")
    assert (np.diff(a) < 0).all()
    assert (np.diff(b) > 0).all()
    np.testing.assert_allclose(c, 180e-9, rtol=1e-12)


@pytest.mark.parametrize("camera", [IDEAL, SOFT, replace(SOFT, shutter_a_width_s=250e-9, shutter_delay_s=-20e-9)])
def test_windows_a_and_b_share_what_window_c_collects(camera):
    windows, delay_s = shutter_windows(camera), np.linspace(-400e-9, 600e-9, 300)
    a, b, c = (collected_s(delay_s, windows[name], camera) for name in "abc")
    np.testing.assert_allclose(a + b, c, atol=2e-13)


def test_soft_shapes_give_the_correlation_integral():
    """Oracle: adaptive quadrature of the product of both shapes."""
    window = shutter_windows(SOFT)["a"]

    def integral_s(delay_s):
        def product(t):
            pulse = trapezoid(np.array(t - delay_s), (0.0, 180e-9), 60e-9, 30e-9)
            return float(pulse * trapezoid(np.array(t), window, 65e-9, 65e-9))

        corners = [delay_s, delay_s + 180e-9, *window]
        return quad(product, -400e-9, 500e-9, limit=500, points=corners, epsabs=1e-16, epsrel=1e-9)[0]

    delays_s = np.array([-150e-9, -60e-9, 10e-9, 70e-9, 130e-9, 190e-9])
    np.testing.assert_allclose(collected_s(delays_s, window, SOFT), [integral_s(d) for d in delays_s], atol=2e-13)


@pytest.mark.parametrize("edge", ["pulse_rise_s", "pulse_fall_s", "shutter_edge_s"])
def test_a_short_edge_changes_little_and_a_long_edge_much(edge):
    delays_s = np.linspace(-200e-9, 200e-9, 400)
    ideal_s = collected_s(delays_s, (0.0, 180e-9), IDEAL)

    def change_s(edge_s):
        return np.abs(collected_s(delays_s, (0.0, 180e-9), replace(IDEAL, **{edge: edge_s})) - ideal_s).max()

    assert change_s(1e-9) < 0.2e-9
    assert change_s(60e-9) > 5e-9


def test_edges_keep_the_energy_of_the_pulse():
    delays_s, values_s = correlation_curve((0.0, 500e-9), SOFT)
    assert np.interp(150e-9, delays_s, values_s) == pytest.approx(180e-9, rel=1e-6)


def test_correlate_is_the_correlation_of_scipy():
    rng = np.random.default_rng(3)
    pulse, sensitivity = rng.random(40), rng.random(70)
    np.testing.assert_allclose(
        correlate(pulse, sensitivity, 2.0), 2 * scipy_correlate(sensitivity, pulse, mode="full"), rtol=1e-12
    )


def test_a_very_short_pulse_samples_the_window():
    """K-SHU-06: the measurement of the shutter function with 100 ps pulses (König 2008, 4.2.1.2)."""
    camera = replace(IDEAL, pulse_width_s=100e-12, shutter_edge_s=65e-9)
    window, delays_s = (0.0, 390e-9), np.linspace(-100e-9, 450e-9, 200)
    sampled = collected_s(delays_s, window, camera) / 100e-12
    np.testing.assert_allclose(sampled, trapezoid(delays_s, window, 65e-9, 65e-9), atol=2e-3)


def test_longest_linear_part_of_the_measured_shapes_is_126_ns():
    """N-K-048: pulse 180 ns with edges of 60 and 30 ns, shutter 390 ns with 65 ns; within 5 mV of a line at 1 V."""
    delays_s = np.arange(150e-9, 420e-9, 1e-9)
    volts = collected_s(delays_s, (0.0, 390e-9), SOFT) / 180e-9

    def deviates_v(first, count):
        x, y = delays_s[first : first + count] * 1e9, volts[first : first + count]
        return np.abs(np.polyval(np.polyfit(x, y, 1), x) - y).max()

    def is_linear(length_ns):
        return any(deviates_v(first, length_ns + 1) < 5e-3 for first in range(40, 120, 2))

    assert is_linear(122)
    assert not is_linear(130)


def test_gates_follow_each_other_and_are_as_long_as_the_pulse_unless_said():
    assert gate_windows(IDEAL) == {"1": (-180e-9, 0.0), "2": (0.0, 180e-9), "3": (180e-9, 360e-9)}
    assert gate_windows(replace(IDEAL, gate_width_s=1e-7))["3"] == (1e-7, 2e-7)


@pytest.mark.parametrize("wrong", [{"pulse_rise_s": 200e-9, "pulse_fall_s": 170e-9}, {"shutter_edge_s": 181e-9}])
def test_edges_longer_than_the_shape_are_refused_by_name(wrong):
    with pytest.raises(UsageError, match=f"camera.{next(iter(wrong))}"):
        collected_s(np.array(0.0), (0.0, 180e-9), replace(IDEAL, **wrong))


# --- measured shapes ---------------------------------------------------------------------------------------------


def test_the_older_sensor_begins_to_see_300_ns_before_its_switch():
    """K-SHU-02, E-K-31: the opening edge, not the closing one."""
    old = replace(SOFT, shutter_opening_s=300e-9, shutter_a_width_s=390e-9, shutter_b_width_s=390e-9)
    window = shutter_windows(old)["b"]
    assert window == pytest.approx((390e-9 - 150e-9, 780e-9 - 32.5e-9))
    dirac = replace(old, pulse_width_s=100e-12, pulse_rise_s=0.0, pulse_fall_s=0.0)
    delays_s = np.linspace(50e-9, 850e-9, 300)
    sampled = collected_s(delays_s, window, dirac) / 100e-12
    np.testing.assert_allclose(sampled, trapezoid(delays_s, window, 300e-9, 65e-9), atol=3e-3)
    assert sampled[delays_s < 90e-9].max() == 0
    assert np.interp(390e-9, delays_s, sampled) == pytest.approx(1, abs=3e-3)
    assert shutter_windows(replace(SOFT, shutter_opening_s=65e-9)) == shutter_windows(SOFT)


def test_an_opening_edge_of_300_ns_lets_window_b_see_what_is_in_window_a_already():
    """5.1.3: why only MDSI1, whose windows a and c close on the pulse, could be used with the older sensor."""
    old = replace(SOFT, shutter_opening_s=300e-9, shutter_a_width_s=390e-9, shutter_b_width_s=390e-9)
    new = replace(old, shutter_opening_s=None)
    delays_s = np.linspace(150e-9, 400e-9, 100)
    a, b, c = (
        np.array([collected_s(delays_s, shutter_windows(camera)[name], camera) for camera in (old, new)])
        for name in "abc"
    )
    np.testing.assert_allclose(a[0], a[1], atol=1e-12)
    assert np.abs(a + b - c)[1].max() < 1e-12
    assert (a + b - c)[0].max() > 0.3 * 180e-9


def test_rounded_edges_keep_the_energy_and_have_no_corners():
    rounded = replace(SOFT, pulse_edges="rounded")
    wide = (-100e-9, 500e-9)
    assert collected_s(np.array(100e-9), wide, rounded) == pytest.approx(180e-9, rel=1e-4)
    time_s = np.linspace(-40e-9, 220e-9, 4001)
    straight, smooth = (pulse_shape(time_s, camera) for camera in (SOFT, rounded))
    assert np.abs(np.diff(smooth, 2)).max() < 0.05 * np.abs(np.diff(straight, 2)).max()
    for at_s in (0.0, 180e-9):
        assert np.interp(at_s, time_s, smooth) == pytest.approx(0.5, abs=1e-3)


def test_a_rounded_plateau_is_lower_at_its_ends_and_loses_a_third_of_that_in_energy():
    camera = replace(IDEAL, pulse_rounding=0.3)
    inside_s = np.array([1e-9, 90e-9, 179e-9])
    np.testing.assert_allclose(pulse_shape(inside_s, camera), [0.7, 1.0, 0.7], atol=0.01)
    assert collected_s(np.array(50e-9), (0.0, 500e-9), camera) == pytest.approx(180e-9 * (1 - 0.1), rel=1e-3)


def test_a_long_opening_edge_needs_a_longer_window():
    wrong = replace(IDEAL, shutter_opening_s=400e-9)
    with pytest.raises(UsageError, match=r"camera\.shutter_edge_s = 0, camera\.shutter_opening_s = 4e-07"):
        collected_s(np.array(0.0), (0.0, 180e-9), wrong)
