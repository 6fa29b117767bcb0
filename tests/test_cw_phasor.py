"""Claims about phasors: any phase steps, their noise, and the average over neighbours of the same surface."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rangecam.cw import CwCamera
from rangecam.cw.phasor import harmonic_weights
from rangecam.cw.ranging import cw_four_phase, cw_multi_frequency, cw_phases
from rangecam.cw.sequence import plane_name, single_frequencies
from rangecam.cw.signal import metres_per_radian
from rangecam.errors import DataError, UsageError
from rangecam.types import RawFrame, Why

CAMERA = CwCamera(read_noise_lsb=2.0, shot_noise_lsb2_per_lsb=0.0, black_level_lsb=100.0)
THREE = replace(CAMERA, modulations_hz=(80e6, 16e6, 120e6), phase_steps_deg=(0, 120, 240), max_phase_sigma_rad=0.5)


def frame_of(camera, range_m, amplitude=200.0, noise_lsb=0.0, rng=None, level=0.0):
    """Samples of the forward model, level + amplitude cos(phase + step), at every frequency and step of the camera."""
    range_m, planes = np.asarray(range_m, float), {}
    for k, single in enumerate(single_frequencies(camera)):
        phase = single.phase_sign * (range_m - single.offset_m) / metres_per_radian(single)
        for step in camera.phase_steps_deg:
            sample = camera.black_level_lsb + level + amplitude * np.cos(phase + np.radians(step))
            if rng is not None:
                sample = sample + noise_lsb * rng.standard_normal(range_m.shape)
            planes[plane_name(step, k if camera.modulations_hz else None)] = sample.astype(np.float32)
    return RawFrame(0.0, planes)


@pytest.mark.parametrize("n", [3, 4, 5, 6, 8])
def test_equally_spaced_steps_weigh_by_two_nths_of_cosine_and_sine(n):
    steps = tuple(360.0 * i / n for i in range(n))
    expected = 2 / n * np.array([np.cos(np.radians(steps)), -np.sin(np.radians(steps))])
    np.testing.assert_allclose(harmonic_weights(steps), expected, atol=1e-7)


@given(
    steps=st.lists(st.integers(0, 35), min_size=3, max_size=9, unique=True),
    phase=st.floats(0.1, 6.2),
    amplitude=st.floats(50, 1000),
    level=st.floats(-500, 500),
)
@hypothesis_settings(max_examples=60, deadline=None)
def test_any_three_steps_or_more_give_back_the_phasor_whatever_the_level(steps, phase, amplitude, level):
    radians = np.radians(10.0 * np.array(steps))
    weights = harmonic_weights(tuple(10.0 * s for s in steps)).astype(float)
    found = weights @ (level + amplitude * np.cos(phase + radians))
    worst = 1e-6 * (abs(level) + amplitude) * np.abs(weights).sum()
    np.testing.assert_allclose(found, amplitude * np.array([np.cos(phase), np.sin(phase)]), atol=worst)


@pytest.mark.parametrize("steps", [(0.0, 120.0), (0.0, 90.0, 90.0), (0.0, 180.0, 180.0000001)])
def test_steps_that_do_not_determine_a_phase_are_refused(steps):
    with pytest.raises(UsageError, match="three different steps"):
        harmonic_weights(steps)


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
def test_four_steps_by_least_squares_are_the_four_phase_method(pixel):
    camera = replace(CAMERA, pixel=pixel, shot_noise_lsb2_per_lsb=0.05, offset_m=1.3)
    rng = np.random.default_rng(1)
    raw = frame_of(camera, rng.uniform(0.1, 8.7, (13, 17)), 200.0, 3.0, rng, level=300.0)
    one, other = cw_four_phase(raw, camera), cw_phases(raw, camera)
    np.testing.assert_allclose(other.range_m, one.range_m, atol=1e-5)
    np.testing.assert_allclose(other.sigma_m, one.sigma_m, rtol=1e-2 if pixel == "single_ended" else 1e-5)
    np.testing.assert_allclose(other.amplitude, one.amplitude, rtol=1e-5)
    np.testing.assert_array_equal(other.why, one.why)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    "steps", [(0, 120, 240), (240, 0, 120), (10, 100, 190, 280), (0, 40, 110, 200, 310), (0, 90, 180)]
)
def test_ranging_inverts_the_forward_model_for_any_steps_sign_and_offset(steps, sign):
    camera = replace(CAMERA, phase_steps_deg=steps, phase_sign=sign, offset_m=0.7)
    range_m = np.linspace(0.1, 8.7, 60).reshape(6, 10)
    image = cw_phases(frame_of(camera, range_m), camera)
    assert image.valid.all()
    np.testing.assert_allclose(image.range_m, range_m, atol=1e-4)
    np.testing.assert_allclose(image.amplitude, 200.0, rtol=1e-5)


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
@pytest.mark.parametrize("steps", [(0, 120, 240), (0, 30, 90, 200, 310)])
def test_sigma_is_the_scatter_of_the_range_for_any_steps(steps, pixel):
    camera = replace(CAMERA, phase_steps_deg=steps, pixel=pixel, shot_noise_lsb2_per_lsb=0.5, black_level_lsb=0.0)
    rng = np.random.default_rng(2)
    range_m, n = np.full((40, 500), 2.0) + np.linspace(0, 5, 40)[:, None], 500
    clean = frame_of(camera, range_m, 150.0, level=400.0 if pixel == "single_ended" else 0.0)
    planes = {}
    for name, plane in clean.planes.items():
        light = plane if pixel == "single_ended" else 150.0 / camera.demodulation_contrast
        planes[name] = (plane + np.sqrt(4.0 + 0.5 * light) * rng.standard_normal(plane.shape)).astype(np.float32)
    image = cw_phases(RawFrame(0.0, planes), camera)
    ratio = (image.range_m - range_m).std(axis=1) / image.sigma_m.mean(axis=1)
    assert np.abs(ratio - 1).max() < 4 / np.sqrt(2 * n) + 0.02


def test_binned_samples_have_the_noise_of_their_mean():
    raw = frame_of(CAMERA, np.full((2, 2), 3.0))
    one, four = (cw_phases(raw, replace(CAMERA, binning=b)).sigma_m[0, 0] for b in (1, 2))
    assert one / four == pytest.approx(2.0, rel=1e-4)  # N-S-042


def oracle(camera, raw, reach):
    """The joint filter on whole images in double precision: mean phasors, their variance and count."""
    weights = harmonic_weights(camera.phase_steps_deg).astype(float)
    several = bool(camera.modulations_hz)
    z, v = [], []
    for k in range(len(single_frequencies(camera))):
        c = np.stack([raw.planes[plane_name(s, k if several else None)].astype(float) for s in camera.phase_steps_deg])
        z.append(np.tensordot(weights[0] + 1j * weights[1], c, 1))
        v.append(camera.read_noise_lsb**2 * (weights[0] @ weights[0]) * np.ones(z[-1].shape))
    z, v = np.array(z), np.array(v)
    unit, tau, total = z / np.abs(z), (v / np.abs(z) ** 2).sum(axis=0), np.abs(z).sum(axis=0)
    mean, variance, count = np.zeros_like(z), np.zeros_like(v), np.zeros(tau.shape)
    height, width = tau.shape
    for y, x in np.ndindex(height, width):
        near = (slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1))
        apart = (np.abs(unit[(slice(None), *near)] - unit[:, y, x][:, None, None]) ** 2).sum(axis=0)
        take = apart <= camera.phasor_filter_sigmas**2 * (tau[near] + tau[y, x])
        take &= (total[near] <= camera.phasor_filter_contrast * total[y, x]) & (
            total[y, x] <= camera.phasor_filter_contrast * total[near]
        )
        count[y, x] = take.sum()
        mean[:, y, x] = (z[(slice(None), *near)] * take).sum(axis=(1, 2)) / take.sum()
        variance[:, y, x] = (v[(slice(None), *near)] * take).sum(axis=(1, 2)) / take.sum() ** 2
    return mean, variance, count


@pytest.mark.parametrize(("name", "reach"), [("3x3", 1), ("5x5", 2)])
def test_the_filter_is_that_of_whole_images_in_double_precision(name, reach):
    rng = np.random.default_rng(3)
    camera = replace(CAMERA, phasor_filter=name, read_noise_lsb=15.0, max_phase_sigma_rad=0.5)
    range_m = np.where(np.arange(23) < 11, 2.0, 4.0) + np.zeros((12, 1))
    raw = frame_of(camera, range_m, np.where(np.arange(12)[:, None] < 5, 100.0, 400.0), 15.0, rng)
    mean, variance, _ = oracle(camera, raw, reach)
    factor = metres_per_radian(camera)
    for method in (cw_phases, cw_four_phase):
        image = method(raw, camera)
        expected = np.mod(np.angle(mean[0]) * factor, 2 * np.pi * factor)
        np.testing.assert_allclose(image.range_m, expected, atol=1e-4)
        np.testing.assert_allclose(image.amplitude, np.abs(mean[0]), rtol=1e-4)
        np.testing.assert_allclose(image.sigma_m, factor * np.sqrt(variance[0]) / np.abs(mean[0]), rtol=1e-4)


@pytest.mark.parametrize("modulations", [(60e6, 80e6), (80e6, 16e6, 120e6)])
def test_all_frequencies_are_filtered_together(modulations):
    rng = np.random.default_rng(4)
    camera = replace(THREE, modulations_hz=modulations, phasor_filter="3x3", read_noise_lsb=12.0)
    range_m = np.where(np.arange(20) < 9, 2.0, 2.6) + np.zeros((10, 1))
    raw = frame_of(camera, range_m, 200.0, 12.0, rng)
    image = cw_multi_frequency(raw, replace(camera, unwrap_phase_error_rad=0.0))
    mean, variance, _ = oracle(camera, raw, 1)
    steps = np.array([metres_per_radian(single) for single in single_frequencies(camera)])[:, None, None]
    sigma = 1 / np.sqrt((np.abs(mean) ** 2 / variance / steps**2).sum(axis=0))
    np.testing.assert_allclose(image.sigma_m, sigma, rtol=1e-4)
    assert image.valid.mean() > 0.99
    assert np.abs(image.range_m - range_m)[image.valid].max() < 0.1


def test_the_filter_averages_across_the_wrap():
    wrap_m = 2 * np.pi * metres_per_radian(CAMERA)
    camera = replace(CAMERA, read_noise_lsb=20.0, phasor_filter="3x3", max_phase_sigma_rad=0.5)
    image = cw_phases(frame_of(camera, np.zeros((40, 40)), 200.0, 20.0, np.random.default_rng(5)), camera)
    error = (image.range_m + wrap_m / 2) % wrap_m - wrap_m / 2
    assert np.abs(error).max() < 6 * image.sigma_m.max()
    assert image.valid.all()


@pytest.mark.parametrize("name", ["3x3", "5x5"])
@pytest.mark.parametrize("camera", [CAMERA, THREE], ids=["one frequency", "three"])
def test_after_the_filter_one_and_two_sigma_hold_the_truth_as_often_as_they_say(camera, name):
    rng = np.random.default_rng(6)
    noise_lsb = 12.0
    camera = replace(camera, read_noise_lsb=noise_lsb, phasor_filter=name)
    method = cw_multi_frequency if camera.modulations_hz else cw_phases
    inside = []
    for amplitude in (120.0, 250.0, 600.0):
        image = method(frame_of(camera, np.full((150, 150), 3.0), amplitude, noise_lsb, rng), camera)
        inside.append(np.abs(image.range_m - 3.0)[image.valid] / image.sigma_m[image.valid])
        assert image.valid.mean() > 0.98
    errors = np.concatenate(inside)
    # neighbouring means share samples: about 150^2 / 25 of each condition are independent, 4 sigma of these are 3.6 %
    assert np.mean(errors < 1) == pytest.approx(0.683, abs=0.03)
    assert np.mean(errors < 2) == pytest.approx(0.954, abs=0.02)


def test_the_filter_lowers_sigma_by_the_root_of_the_samples_and_keeps_edges():
    rng = np.random.default_rng(7)
    camera = replace(CAMERA, read_noise_lsb=4.0)
    range_m = np.where(np.arange(30) < 15, 2.0, 3.0) + np.zeros((20, 1))
    raw = frame_of(camera, range_m, 200.0, 4.0, rng)
    bare, filtered = cw_phases(raw, camera), cw_phases(raw, replace(camera, phasor_filter="3x3"))
    inner = filtered.sigma_m[1:-1, 2:13] / bare.sigma_m[1:-1, 2:13]
    assert np.median(inner) == pytest.approx(1 / 3, rel=0.02)
    assert np.abs(filtered.range_m - range_m).max() < 6 * bare.sigma_m.max()
    at_edge = filtered.sigma_m[1:-1, 14] / bare.sigma_m[1:-1, 14]
    assert np.median(at_edge) == pytest.approx(1 / np.sqrt(6), rel=0.02)


def test_a_pixel_unlike_all_its_neighbours_is_flying_where_support_is_asked_for():
    camera = replace(CAMERA, phasor_filter="3x3", phasor_min_support=0.3)
    range_m = np.full((7, 7), 2.0)
    range_m[3, 3] = 2.7
    raw = frame_of(camera, range_m, 200.0)
    image = cw_phases(raw, camera)
    assert image.why[3, 3] == Why.FLYING
    assert image.valid.sum() == 48
    assert cw_phases(raw, replace(camera, phasor_min_support=0.0)).valid.all()


def test_the_tolerance_lets_an_inclined_surface_be_averaged():
    camera = replace(CAMERA, phasor_filter="3x3", phasor_min_support=0.5)
    raw = frame_of(camera, 2.0 + 0.05 * np.arange(12) * np.ones((8, 1)), 1000.0)
    assert (cw_phases(raw, camera).why == Why.FLYING).mean() > 0.9
    image = cw_phases(raw, replace(camera, phasor_filter_tolerance_m=0.08))
    assert image.valid.all()
    np.testing.assert_allclose(image.range_m[:, 1:-1], raw_ranges(image)[:, 1:-1], atol=1e-4)


def raw_ranges(image):
    return 2.0 + 0.05 * np.arange(image.shape[1]) * np.ones((image.shape[0], 1))


def test_more_sigmas_let_more_neighbours_in_and_less_contrast_fewer():
    rng = np.random.default_rng(8)
    camera = replace(CAMERA, phasor_filter="3x3", read_noise_lsb=10.0)
    amplitude = np.where(np.arange(20) % 2, 100.0, 250.0) * np.ones((20, 1))
    raw = frame_of(camera, np.full((20, 20), 3.0), amplitude, 10.0, rng)
    wide, narrow, even = (
        cw_phases(raw, replace(camera, **{"max_phase_sigma_rad": 0.5, **change})).sigma_m.mean()
        for change in ({}, {"phasor_filter_sigmas": 0.5}, {"phasor_filter_contrast": 1.5})
    )
    assert narrow > 1.2 * wide
    assert even > 1.2 * wide


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # NaN, in the kernels without compilation
@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
@pytest.mark.parametrize("pseudo_rows", [0, 2])
def test_pseudo_rows_take_no_part_in_the_average(pseudo_rows):
    camera = replace(CAMERA, phasor_filter="5x5", pseudo_rows=pseudo_rows)
    raw = frame_of(camera, np.full((8, 8), 3.0))
    for plane in raw.planes.values():
        plane[:2] = 5000.0 * np.arange(8)
    image = cw_phases(raw, camera)
    if pseudo_rows:
        assert (image.why[:2] == Why.SENSOR_FLAG).all()
    assert image.valid[2:].all()
    np.testing.assert_allclose(image.range_m[2:], 3.0, atol=1e-4)


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # NaN, in the kernels without compilation
@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
@pytest.mark.parametrize(
    ("value", "limits", "why"),
    [
        (np.nan, {}, Why.NOT_FINITE),
        (np.inf, {}, Why.NOT_FINITE),
        (4095.0, {"full_scale_lsb": 4095.0}, Why.SATURATED),
        (-5.0, {"lower_limit_lsb": 0.0}, Why.SATURATED),
    ],
)
@pytest.mark.parametrize("name", ["off", "3x3"])
def test_a_faulty_pixel_has_its_reason_and_spoils_no_neighbour(name, value, limits, why):
    camera = replace(CAMERA, phasor_filter=name, black_level_lsb=1000.0, phase_steps_deg=(0, 120, 240), **limits)
    raw = frame_of(camera, np.full((6, 7), 3.0))
    raw.planes["phase_120"][2, 3] = value
    image = cw_phases(raw, camera)
    assert image.why[2, 3] == why
    assert image.valid.sum() == 41
    np.testing.assert_allclose(image.range_m[image.valid], 3.0, atol=1e-4)


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # NaN, in the kernels without compilation
@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
def test_equal_samples_are_no_signal_and_weak_ones_low_amplitude():
    raw = frame_of(CAMERA, np.full((3, 3), 3.0), np.diag([0.0, 3.0, 0.0]) + 200 * (1 - np.eye(3)))
    image = cw_phases(raw, CAMERA)
    assert [Why(int(w)) for w in np.diag(image.why)] == [Why.NO_SIGNAL, Why.LOW_AMPLITUDE, Why.NO_SIGNAL]
    assert (cw_phases(raw, replace(CAMERA, min_amplitude=201.0)).why != Why.VALID).all()


def test_one_frequency_is_asked_for_by_name():
    with pytest.raises(UsageError, match="cw_multi_frequency"):
        cw_phases(frame_of(THREE, np.full((2, 2), 1.0)), THREE)


def test_a_missing_or_misshapen_plane_is_named():
    raw = frame_of(THREE, np.full((2, 2), 1.0))
    rest = {name: plane for name, plane in raw.planes.items() if name != "f1_phase_120"}
    with pytest.raises(DataError, match="plane 'f1_phase_120' is missing"):
        cw_multi_frequency(RawFrame(0.0, rest), THREE)
    with pytest.raises(DataError, match="f2_phase_0"):
        cw_multi_frequency(RawFrame(0.0, {**raw.planes, "f2_phase_0": np.zeros((2, 3))}), THREE)


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.int32, np.float64])
def test_whole_numbers_decode_as_their_floats_do(dtype):
    camera = replace(THREE, black_level_lsb=1000.0)
    raw = frame_of(camera, np.linspace(1, 9, 30).reshape(5, 6))
    whole = {name: plane.round() for name, plane in raw.planes.items()}
    one = cw_multi_frequency(RawFrame(0.0, whole), camera)
    other = cw_multi_frequency(RawFrame(0.0, {name: plane.astype(dtype) for name, plane in whole.items()}), camera)
    np.testing.assert_array_equal(one.range_m, other.range_m)
