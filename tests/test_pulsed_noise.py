"""The parts of the noise, the read-outs of one run, and the fixed pattern (König 2008, 4.1.1.4, 4.2.3.1, 4.3.1)."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.errors import UsageError
from rangecam.pulsed.noise import readout_parts_v, sensor_parts_v
from rangecam.pulsed.pixel import accumulated, adapt, damping, dark_noise, noise_variance, offsets, read_out
from rangecam.pulsed.settings import Pixel, ReadoutNoise, SensorNoise

PIXEL = Pixel()
ROUGH = replace(PIXEL, adc_bits=0)
NONE = np.zeros((1, 1, 2000))


def runs(single_v, pixel, ambient_v=0.0, averages=20, seed=0):
    """Values of many equal pixels at each read-out of a run, (K, N) V."""
    offset_v = np.zeros((len(pixel.accumulations), *NONE.shape))
    values_v = read_out(NONE + single_v, NONE + ambient_v, offset_v, pixel, averages, np.random.default_rng(seed))
    return np.moveaxis(values_v[:, :, 0, 0], 1, 0).reshape(len(pixel.accumulations), -1)


# --- parts -------------------------------------------------------------------------------------------------------


def test_the_parts_add_up_to_what_was_measured():
    """K-NOI-02."""
    assert np.sqrt(sum(v**2 for v in sensor_parts_v(PIXEL).values())) == pytest.approx(0.379e-3)
    assert np.sqrt(sum(v**2 for v in readout_parts_v(PIXEL).values())) == pytest.approx(0.442e-3)


def test_reset_and_shutter_are_the_thermal_noise_of_their_capacitors_and_the_amplifier_the_largest_of_the_others():
    """kT/C of 6.1 pF is 26 uV, of 1 pF behind 5.1 pF 59 uV; 3.4 times at the output, and twice."""
    parts = sensor_parts_v(PIXEL)
    assert parts["reset"] == pytest.approx(np.sqrt(2) * 3.4 * 25.98e-6, rel=1e-3)
    assert parts["shutter"] == pytest.approx(np.sqrt(2) * 3.4 * 58.67e-6, rel=1e-3)
    others = {name: v for name, v in parts.items() if name not in ("reset", "shutter")}
    assert others["amplifier"] == pytest.approx(5 / 4 * others["follower"])
    assert len({round(v, 12) for v in others.values()}) == 2


@pytest.mark.parametrize("name", [*get_args(SensorNoise), *get_args(ReadoutNoise)])
def test_a_part_that_is_off_lowers_the_noise_by_itself_alone(name):
    without = replace(ROUGH, noise_off=(name,))
    part_v = {**sensor_parts_v(PIXEL), **readout_parts_v(PIXEL)}[name]
    for n in (1, 100):
        share = n if name in get_args(SensorNoise) else 1
        assert dark_noise(n, PIXEL) ** 2 - dark_noise(n, without) ** 2 == pytest.approx(share * part_v**2)


def test_the_simulation_knows_what_is_off():
    without = replace(ROUGH, noise_off=("shutter", "buffer", "board"), accumulations=(1, 100))
    spread = runs(0.0, without).std(axis=1)
    np.testing.assert_allclose(spread, damping([1, 100], without) * dark_noise([1, 100], without), rtol=0.02)
    everything = replace(ROUGH, noise_off=get_args(SensorNoise) + get_args(ReadoutNoise))
    assert not runs(0.0, everything).any()


def test_a_circuit_quieter_than_its_capacitors_still_has_the_noise_that_was_measured():
    quiet = replace(PIXEL, sensor_noise_v=0.1e-3)
    parts = sensor_parts_v(quiet)
    assert np.sqrt(sum(v**2 for v in parts.values())) == pytest.approx(0.1e-3)
    assert parts["follower"] == 0
    assert not any(sensor_parts_v(replace(PIXEL, sensor_noise_v=0.0)).values())


def test_a_part_that_there_is_not_is_refused():
    with pytest.raises(UsageError, match=r"camera\.pixel\.noise_off"):
        load_config("usercams", {"camera": {"pixel": {"noise_off": ["magic"]}}})


# --- the read-outs of a run --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ambient_v", [0.0, 0.02])
def test_every_read_out_has_the_noise_that_ranging_expects(ambient_v):
    values_v = runs(4e-3, ROUGH, ambient_v)
    n = np.array(ROUGH.accumulations)
    np.testing.assert_allclose(values_v.mean(axis=1), accumulated(4e-3, n, ROUGH), rtol=1e-3)
    expected = np.sqrt(noise_variance(accumulated(4e-3, n, ROUGH), n, ambient_v, ROUGH))
    np.testing.assert_allclose(values_v.std(axis=1), expected, rtol=0.02)


def test_read_outs_of_a_run_share_the_noise_of_their_pulses_but_not_that_of_reading():
    """K-PIX-11: reading does not destroy; the covariance of two read-outs is the noise of the fewer pulses."""
    ideal = replace(ROUGH, damping=0.0, photon_noise=False)
    covariance = np.cov(runs(0.0, ideal)) / ideal.sensor_noise_v**2
    expected = np.minimum.outer(ideal.accumulations, ideal.accumulations)
    ratio = (ideal.readout_noise_v / ideal.sensor_noise_v) ** 2
    np.testing.assert_allclose(covariance, expected + ratio * np.eye(5), rtol=0.05, atol=0.15)


def test_the_control_takes_the_last_read_out_at_which_no_shutter_is_full():
    values_v = np.zeros((1, 3, 2, 1, 3))
    pixel = replace(PIXEL, accumulations=(16, 1, 4))
    values_v[0, :, 0, 0] = [[0.1, 0.1, 1.5], [0.4, 0.4, 1.5], [1.4, 1.5, 1.5]]
    values_v[0, :, 1, 0] = [[0.2, 0.2, 0.2], [0.3, 0.3, 0.5], [0.5, 0.5, 1.5]]
    chosen_v, n_acc = adapt(values_v, pixel)
    np.testing.assert_array_equal(n_acc, [[16, 4, 1]])
    np.testing.assert_allclose(chosen_v[:, 0], [[1.4, 0.4, 1.5], [0.5, 0.3, 0.2]])


def test_adapt_returns_means_of_the_averaged_images_and_one_full_image_counts():
    values_v = np.array([0.2, 0.4]).reshape(2, 1, 1, 1, 1) * np.ones((2, 2, 1, 1, 1))
    values_v[1, 1] = 1.5
    chosen_v, n_acc = adapt(values_v, replace(PIXEL, accumulations=(1, 4)))
    assert chosen_v[0, 0, 0] == pytest.approx(0.3)
    assert n_acc[0, 0] == 1
    assert adapt(values_v[:, 1:], replace(PIXEL, accumulations=(1,)))[0][0, 0, 0] == 1.5


# --- fixed pattern -----------------------------------------------------------------------------------------------

SHAPE, WIDTHS_S = (2, 8, 64), (180e-9, 360e-9)


def test_offsets_drift_with_the_temperature_all_alike_and_each_by_itself():
    """K-PIX-16, K-ENV-02."""
    pixel = replace(PIXEL, offset_drift_vpk=0.2e-3, offset_drift_spread_vpk=0.05e-3)
    assert not offsets(SHAPE, WIDTHS_S, 25.0, pixel).any()
    warm, hot = (offsets(SHAPE, WIDTHS_S, celsius, pixel) for celsius in (35.0, 45.0))
    np.testing.assert_allclose(hot, 2 * warm)
    assert warm.mean() == pytest.approx(2e-3, rel=0.05)
    assert warm[0].std() == pytest.approx(0.5e-3, rel=0.08)


def test_each_number_of_accumulations_can_have_a_pattern_of_its_own():
    pixel = replace(PIXEL, fixed_pattern_per_step_v=1e-3)
    pattern = offsets(SHAPE, WIDTHS_S, 25.0, pixel).reshape(5, -1)
    np.testing.assert_allclose(np.cov(pattern) / 1e-6, np.eye(5), atol=0.15)
    assert (pattern != offsets(SHAPE, WIDTHS_S, 25.0, replace(pixel, fixed_pattern_seed=1)).reshape(5, -1)).all()


def test_a_pattern_can_grow_with_the_length_of_the_shutter_and_the_pulses():
    pixel = replace(PIXEL, fixed_pattern_vps=1e3)
    spread = offsets(SHAPE, WIDTHS_S, 25.0, pixel).std(axis=(2, 3))
    np.testing.assert_allclose(spread[0], 1e3 * np.array(WIDTHS_S), rtol=0.1)
    np.testing.assert_allclose(spread[:, 0] / spread[0, 0], accumulated(1.0, PIXEL.accumulations, PIXEL))
