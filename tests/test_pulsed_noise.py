"""The parts of the noise, the read-outs of one run, and the fixed pattern (König 2008, 4.1.1.4, 4.2.3.1, 4.3.1)."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.stats import chi2_contingency, ks_2samp, norm

from rangecam.config import load_config
from rangecam.errors import UsageError
from rangecam.pulsed.noise import readout_parts_v, sensor_parts_v
from rangecam.pulsed.pixel import accumulated, damping, dark_noise, noise_variance, offsets, read_out
from rangecam.pulsed.settings import Pixel, ReadoutNoise, SensorNoise

PIXEL = Pixel()
ROUGH = replace(PIXEL, adc_bits=0)
NONE = np.zeros((1, 100, 2000))


def chosen(single_v, pixel, ambient_v=0.0, averages=1, seed=0):
    """Values (N,) V of many equal pixels of one shutter, and their accumulations (N,)."""
    offset_v = np.zeros((len(pixel.accumulations), *NONE.shape))
    rng = np.random.default_rng(seed)
    values_v, n_acc = read_out(NONE + single_v, NONE + ambient_v, offset_v, pixel, averages, rng)
    return values_v.ravel(), n_acc.ravel()


def runs(single_v, pixel, ambient_v=0.0):
    """Values of many equal pixels at each number of accumulations, (K, N) V, each as if there were no other."""
    singles = [replace(pixel, accumulations=(n,)) for n in pixel.accumulations]
    return np.array([chosen(single_v, each, ambient_v, seed=k)[0] for k, each in enumerate(singles)])


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


NOISY = replace(ROUGH, damping=0.0, sensor_noise_v=0.1, readout_noise_v=0.0, photon_noise=False, accumulations=(1, 4))


def test_read_outs_of_a_run_share_the_noise_of_their_pulses():
    """K-PIX-11: reading does not destroy. Four pulses that fill a pixel were strong, on average, from the first on.

    With noise x of one and y of four pulses, cov = sigma^2 and var(y) = 4 sigma^2: E(x | y > t) = sigma / 2 times the
    mean of a standard normal variable above t / (2 sigma).
    """
    sigma, signal = NOISY.sensor_noise_v, 0.35
    values_v, n_acc = chosen(signal, NOISY)
    above = (NOISY.saturation_v - 4 * signal) / (2 * sigma)
    expected = signal + sigma / 2 * norm.pdf(above) / norm.sf(above)
    assert (n_acc == 1).mean() == pytest.approx(norm.sf(above), abs=0.012)
    first = values_v[n_acc == 1]
    assert first.mean() == pytest.approx(expected, abs=4 * sigma / np.sqrt(first.size))


def simply_chosen(single_v, ambient_v, pixel, averages, rng):
    """Values (S, N) V and accumulations (N,) of whole runs, pulse by pulse from the first on; S images (N,) given."""
    steps, full_v = np.array(sorted(pixel.accumulations)), pixel.saturation_v
    of_pulses = replace(pixel, damping=0.0, readout_noise_v=0.0)
    pulse_v = np.sqrt(noise_variance(single_v, 1, ambient_v, of_pulses))
    pulses = single_v + pulse_v * rng.standard_normal((averages, steps[-1], *single_v.shape))
    read_v = dark_noise(0, pixel) * rng.standard_normal((averages, len(steps), *single_v.shape))
    sums_v = pulses.cumsum(axis=1)[:, steps - 1] + read_v
    values_v = np.minimum(damping(steps, pixel)[:, None, None] * sums_v, full_v)
    free = ~(values_v >= full_v).any(axis=(0, 2))
    last = np.where(free.any(axis=0), len(steps) - 1 - free[::-1].argmax(axis=0), 0)
    taken_v = values_v[:, last, :, np.arange(single_v.shape[1])].transpose(1, 2, 0)
    return np.where((taken_v >= full_v).any(axis=0), full_v, taken_v.mean(axis=0)), steps[last]


@pytest.mark.parametrize("averages", [1, 2])
def test_what_is_drawn_backwards_is_chosen_as_often_and_spread_as_runs_from_the_first_pulse_on(averages):
    pixel = replace(ROUGH, sensor_noise_v=0.2, readout_noise_v=0.2, damping=0.01, accumulations=(1, 2, 3, 4))
    single_v = np.array([0.4, 0.25])[:, None] * np.ones(30_000)
    ambient_v = 0.05 * np.ones_like(single_v)
    offset_v = np.zeros((4, 2, 1, 30_000))
    shape, rng = (2, 1, 30_000), np.random.default_rng(5)
    values_v, n_acc = read_out(single_v.reshape(shape), ambient_v.reshape(shape), offset_v, pixel, averages, rng)
    found, expected = (values_v[:, 0], n_acc[0]), simply_chosen(single_v, ambient_v, pixel, averages, rng)
    counts = [[(number == n).sum() for n in pixel.accumulations] for _, number in (found, expected)]
    assert min(counts[1]) > 100
    assert chi2_contingency(counts).pvalue > 1e-3
    for n in pixel.accumulations:
        for s in (0, 1):
            ours, simple = (each_v[s, number == n] for each_v, number in (found, expected))
            assert ks_2samp(ours, simple).pvalue > 1e-3
            assert ours.mean() == pytest.approx(simple.mean(), abs=4.5 * simple.std() * np.sqrt(2 / min(counts[0])))
        ours, simple = (np.corrcoef(each_v[:, number == n])[0, 1] for each_v, number in (found, expected))
        assert ours == pytest.approx(simple, abs=4.5 * np.sqrt(2 / min(counts[0])))


SILENT = replace(ROUGH, damping=0.0, sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False)


def silently(values_v, accumulations):
    """What is read out where the values at each number of accumulations, (averages, K, S, 1, N) V, are these."""
    steps = np.sort(accumulations).reshape(1, -1, 1, 1, 1)
    none_v = np.zeros(values_v.shape[2:])
    pixel, offset_v = replace(SILENT, accumulations=accumulations), np.zeros(values_v.shape[1:])
    return read_out(values_v / steps, none_v, offset_v, pixel, len(values_v), np.random.default_rng(0))


def test_the_control_takes_the_last_read_out_at_which_no_shutter_is_full():
    values_v = np.zeros((1, 3, 2, 1, 3))
    values_v[0, :, 0, 0] = [[0.1, 0.1, 1.5], [0.4, 0.4, 1.5], [1.4, 1.5, 1.5]]
    values_v[0, :, 1, 0] = [[0.2, 0.2, 0.2], [0.3, 0.3, 0.5], [0.5, 0.5, 1.5]]
    chosen_v, n_acc = silently(values_v, (16, 1, 4))
    np.testing.assert_array_equal(n_acc, [[16, 4, 1]])
    np.testing.assert_allclose(chosen_v[:, 0], [[1.4, 0.4, 1.5], [0.5, 0.3, 0.2]])


def test_values_are_means_of_the_averaged_images_and_one_full_image_counts():
    values_v = np.array([0.2, 0.4]).reshape(2, 1, 1, 1, 1) * np.ones((2, 2, 1, 1, 1))
    values_v[1, 1] = 1.5
    chosen_v, n_acc = silently(values_v, (1, 4))
    assert chosen_v[0, 0, 0] == pytest.approx(0.3)
    assert n_acc[0, 0] == 1
    assert silently(values_v[:, 1:], (1,))[0][0, 0, 0] == 1.5


def test_a_signal_that_falls_from_read_out_to_read_out_has_the_noise_of_the_last():
    """Jitter of the laser may make a mean of more pulses smaller; the noise cannot fall."""
    pixel = replace(ROUGH, damping=0.0, sensor_noise_v=0.0, readout_noise_v=0.0, accumulations=(1, 2))
    means_v = np.array([0.8, 0.3]).reshape(1, 2, 1, 1, 1) * np.ones((1, 2, *NONE.shape))
    none_v = np.zeros((2, *NONE.shape))
    values_v, n_acc = read_out(means_v, none_v[0], none_v, pixel, 1, np.random.default_rng(0))
    assert (n_acc == 2).all()
    assert values_v.std() == pytest.approx(np.sqrt(noise_variance(0.6, 2, 0.0, pixel)), rel=0.02)


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
