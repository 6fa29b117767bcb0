"""Ranging of saturated pixels by shifted pulses: inversion, noise, reasons (König 2008, 5.2.2)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from rangecam.errors import UsageError
from rangecam.pulsed import RANGING, PulsedCamera, simulate
from rangecam.pulsed.limits import expected_sigma_m, targets_on_axis
from rangecam.pulsed.settings import Pixel
from rangecam.types import RawFrame, Why

C = 3e8
RETRO = 300.0
FAINT = Pixel(sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0, accumulations=(1,))
IDEAL = PulsedCamera(
    speed_of_light_mps=C, shutters="b_delayed", delay_first_s=-150e-9, delay_step_s=0.25e-9, delay_count=600,
    pixel=Pixel(accumulations=(1,)),
)  # fmt: skip
MEASURED = replace(
    IDEAL, pulse_rise_s=60e-9, pulse_fall_s=30e-9, shutter_edge_s=65e-9, delay_first_s=-220e-9, delay_step_s=8e-9,
    delay_count=30,
)  # fmt: skip
CAMERAS = {"ideal": IDEAL, "measured": MEASURED}
AT_M = np.arange(3.0, 21.5, 1.0)


def looked_at(at_m, reflectivity, camera, rows=1, seed=0, method="shifted"):
    many, view = targets_on_axis(np.atleast_1d(at_m), reflectivity, camera, rows)
    return RANGING[method](simulate(lambda _: view, many, 0.0, np.random.default_rng(seed)), many)


def planes_of(range_m, camera, volts):
    """Overlaps of an ideal pulse and window b by hand; volts: of the whole pulse."""
    range_m, pulse = np.atleast_2d(np.asarray(range_m, float)), camera.pulse_width_s
    planes = {"n_acc": np.ones(range_m.shape, np.uint8)}
    for k in range(camera.delay_count):
        start = camera.delay_first_s + k * camera.delay_step_s + 2 * range_m / C
        overlap = np.clip(np.minimum(start + pulse, 2 * pulse) - np.maximum(start, pulse), 0, None)
        planes[f"shutter_b_{k}"] = np.minimum(volts * overlap / pulse, camera.pixel.saturation_v)
    return planes


# --- inversion ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("volts", [0.5, 1.4, 30.0, 450.0])
def test_the_range_does_not_depend_on_how_bright_the_target_is(volts):
    camera = replace(IDEAL, pixel=FAINT, min_snr=1e-9)
    range_m = np.linspace(2.0, 18.0, 321)
    image = RANGING["shifted"](RawFrame(0.0, planes_of(range_m, camera, volts)), camera)
    np.testing.assert_allclose(image.range_m[0], range_m, atol=2e-4)
    np.testing.assert_allclose(image.amplitude[0], volts, rtol=3e-3)
    assert image.valid.all()


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("reflectivity", [0.8, 20.0, RETRO])
def test_a_noise_free_target_of_any_brightness_is_found_where_it_is(name, reflectivity):
    camera = replace(CAMERAS[name], pixel=FAINT, min_snr=1e-9)
    image = looked_at(AT_M, reflectivity, camera)
    assert image.valid.all()
    np.testing.assert_allclose(image.range_m[0], AT_M, atol=1e-3)


def test_two_delays_of_an_ideal_pulse_are_the_gradient_method():
    """Eq 3.24 as E-K-04 has it, with the later window replaced by the earlier pulse."""
    camera = replace(IDEAL, delay_first_s=-55e-9, delay_step_s=5e-9, delay_count=3, pixel=FAINT, min_snr=1e-9)
    first, second = 0.9, 0.5
    values = dict(zip(("shutter_b_0", "shutter_b_1", "shutter_b_2"), (second, first, 1.5), strict=True))
    planes = {name: np.full((1, 1), value) for name, value in values.items()} | {"n_acc": np.ones((1, 1))}
    image = RANGING["shifted"](RawFrame(0.0, planes), camera)
    by_hand = C / 2 * (50e-9 + 5e-9 * first / (first - second))
    assert image.range_m[0, 0] == pytest.approx(by_hand, abs=2e-4)


def test_a_retro_reflector_that_no_other_method_measures_is_ranged():
    """K-ENV-07: 300 times as bright as white."""
    usual = replace(PulsedCamera(), speed_of_light_mps=C)
    assert np.all(looked_at(AT_M, RETRO, usual, method="mdsi3").why == Why.SATURATED)
    for camera in CAMERAS.values():
        image = looked_at(AT_M, RETRO, camera, rows=50)
        assert image.valid.all()
        assert np.abs(image.range_m.mean(axis=0) - AT_M).max() < 0.01


# --- noise --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CAMERAS)
def test_calculation_and_simulated_camera_agree_on_sigma_from_3_to_21_m(name):
    """The variance of 1500 simulated ranges lies in the 99 % interval of the calculated one, jointly for all ranges."""
    camera, at_m = CAMERAS[name], AT_M + 0.037
    image = looked_at(at_m, RETRO, camera, rows=1500, seed=3)
    expected_m = expected_sigma_m(at_m, RETRO, camera, "shifted")[0]
    ratio = image.range_m.astype(np.float64).var(axis=0, ddof=1) / expected_m**2
    low, high = chi2.ppf([0.005 / len(at_m), 1 - 0.005 / len(at_m)], 1499) / 1499
    assert np.all((ratio > low) & (ratio < high))


def test_sigma_is_the_propagation_of_both_values():
    """Against small differences of the range by each of the two values that it comes from."""
    camera = replace(MEASURED, min_snr=1e-9)
    many, view = targets_on_axis(np.array([9.3]), RETRO, replace(camera, pixel=FAINT))
    raw = simulate(lambda _: view, many, 0.0, np.random.default_rng(0))

    def range_of(planes):
        return float(RANGING["shifted"](RawFrame(0.0, planes), many).range_m[0, 0])

    base, squares = range_of(raw.planes), []
    noisy = replace(many, pixel=Pixel(accumulations=(1,), photon_noise=False, adc_bits=0))
    for name, plane in raw.planes.items():
        if name.startswith("shutter") and 0.02 < plane[0, 0] < 1.49:
            changed = np.asarray(plane, np.float64) * (1 + 1e-3)
            squares.append((range_of({**raw.planes, name: changed}) - base) / (1e-3 * plane[0, 0]))
    sigma_v = np.hypot(0.379e-3, 0.442e-3)
    expected = sigma_v * np.linalg.norm(squares)
    assert RANGING["shifted"](raw, noisy).sigma_m[0, 0] == pytest.approx(expected, rel=0.02)


# --- reasons ------------------------------------------------------------------------------------------------------


def test_what_fills_the_pixel_even_at_the_first_delays_is_saturated():
    camera = replace(IDEAL, delay_first_s=0.0, delay_count=20)
    assert looked_at(10.0, RETRO, camera).why[0, 0] == Why.SATURATED


def test_a_target_that_the_window_never_meets_has_no_signal_worth_a_range():
    camera = replace(IDEAL, delay_first_s=-200e-9, delay_count=20)
    assert looked_at(10.0, RETRO, camera).why[0, 0] in (Why.LOW_AMPLITUDE, Why.OUT_OF_RANGE)


def test_a_signal_that_grows_less_than_its_noise_with_each_step_is_low():
    assert looked_at(15.0, 0.05, IDEAL).why[0, 0] == Why.LOW_AMPLITUDE


def test_a_range_beyond_the_wanted_ones_is_out_of_range():
    assert looked_at(10.0, RETRO, replace(MEASURED, max_range_m=9.0)).why[0, 0] == Why.OUT_OF_RANGE
    assert looked_at(10.0, RETRO, replace(MEASURED, min_range_m=11.0)).why[0, 0] == Why.OUT_OF_RANGE


def test_steps_longer_than_the_edge_are_refused():
    with pytest.raises(UsageError, match=r"delay_step_s = 2e-07: must be less than the edge .* 1.8e-07 s"):
        looked_at(10.0, RETRO, replace(IDEAL, delay_step_s=200e-9, delay_count=3))


def test_shifted_pulses_are_not_the_default_of_any_preset():
    """K-ENV-07: they cost frame rate."""
    assert PulsedCamera().shutters == "ab"
