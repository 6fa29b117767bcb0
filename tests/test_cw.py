"""Claims about continuous-wave cameras: the pixel's forward model and its inverse."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rangecam.clean import clean
from rangecam.config import load_config, parse
from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.light import correlate
from rangecam.cw.ranging import PLANES, cw_four_phase
from rangecam.cw.sequence import exposure_times_s
from rangecam.cw.signal import metres_per_radian, reference_amplitude, sample_variance
from rangecam.errors import DataError, UsageError
from rangecam.geometry import Lens, rays
from rangecam.scene.view import View
from rangecam.types import SPEED_OF_LIGHT, RawFrame, Why

CAMERA = load_config("scaled_car").camera
"""12 bits, differential, first row without light."""
EXACT = replace(CAMERA, quantisation_lsb=0.0, full_scale_lsb=None, lower_limit_lsb=None, pseudo_rows=0)
STEPS = (0, 90, 180, 270)


def frame(*planes, dtype=None):
    return RawFrame(1.5, {name: np.atleast_2d(np.asarray(p, dtype)) for name, p in zip(PLANES, planes, strict=True)})


def samples_of(phase_rad, amplitude, level=0.0):
    """The four correlation samples of Steinbäck 2016, 2.2.1: c(tau) = level + amplitude cos(phase + tau)."""
    return [level + amplitude * np.cos(phase_rad + np.radians(step)) for step in STEPS]


def reference_decode(raw, camera):
    """The same formulas in float64 NumPy: range, sigma and amplitude."""
    c0, c90, c180, c270 = (np.asarray(raw.planes[name], float) for name in PLANES)
    real, imaginary = c0 - c180, c270 - c90
    factor = camera.speed_of_light_mps / (4 * np.pi * camera.modulation_hz)
    wrap = camera.speed_of_light_mps / (2 * camera.modulation_hz)
    range_m = np.mod(factor * camera.phase_sign * np.arctan2(imaginary, real) + camera.offset_m, wrap)
    amplitude = np.hypot(real, imaginary) / 2
    if camera.pixel == "single_ended":
        light = np.maximum((c0 + c90 + c180 + c270) / 4 - camera.black_level_lsb, 0)
    else:
        light = amplitude / camera.demodulation_contrast + camera.ambient_lsb
    of_pixel = camera.read_noise_lsb**2 + camera.shot_noise_lsb2_per_lsb * light
    variance = of_pixel / camera.binning**2 + camera.quantisation_lsb**2 / 12
    sigma = factor * np.sqrt(real**2 * 2 * variance + imaginary**2 * 2 * variance) / (real**2 + imaginary**2)
    return range_m, sigma, amplitude


def flat_view(range_m, reflectivity=1.0, shape=(4, 5), cos_incidence=1.0, ambient_wpm2=0.0):
    full = [np.full((1, *shape), a, np.float32) for a in (range_m, reflectivity, cos_incidence)]
    return View(*full, ambient_wpm2)


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.int32, np.float32, np.float64])
def test_ranging_agrees_with_the_formulas_in_double_precision_for_any_number_type(dtype):
    rng = np.random.default_rng(1)
    planes = [rng.integers(1000, 3000, (13, 17)) for _ in range(4)]
    camera = replace(EXACT, offset_m=1.3, ambient_lsb=12.0, max_phase_sigma_rad=0.5)
    raw = frame(*planes, dtype=dtype)
    image, (range_m, sigma, amplitude) = cw_four_phase(raw, camera), reference_decode(raw, camera)
    strong = amplitude > 20
    wrap = SPEED_OF_LIGHT / (2 * camera.modulation_hz)
    difference = (image.range_m - range_m + wrap / 2) % wrap - wrap / 2
    assert np.abs(difference).max() / metres_per_radian(camera) < 1e-5
    np.testing.assert_allclose(image.sigma_m[strong], sigma[strong], rtol=1e-5)
    np.testing.assert_allclose(image.amplitude, amplitude, rtol=1e-6)
    assert image.valid[strong].all()
    assert image.time_s == raw.time_s
    assert {a.dtype.name for a in (image.range_m, image.sigma_m, image.amplitude)} == {"float32"}


def test_the_polynomial_arctangent_is_right_all_around_the_circle_and_on_the_axes():
    angle = np.concatenate([np.arange(0, 2 * np.pi, 1e-3), np.radians(np.arange(0, 360, 45))])
    real, imaginary = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    image = cw_four_phase(frame(real, np.zeros_like(real), np.zeros_like(real), imaginary), EXACT)
    ours = image.range_m[0] / metres_per_radian(EXACT)
    error = np.angle(np.exp(1j * (ours - np.arctan2(imaginary, real))))
    assert np.abs(error).max() < 2e-6


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("method", ["cw_four_phase", "cw_phases"])
def test_ranging_inverts_the_forward_model(method, sign):
    camera = replace(EXACT, phase_sign=sign, offset_m=0.7)
    range_m = np.linspace(0.2, 8.7, 40, dtype=np.float32).reshape(1, 5, 8)
    view = View(range_m, np.full_like(range_m, 0.5), np.full_like(range_m, 0.9))
    raw = RawFrame(0.0, {f"phase_{step}": correlate(view, camera, step)[0] for step in STEPS})
    image = RANGING[method](raw, replace(camera, max_phase_sigma_rad=0.5))
    np.testing.assert_allclose(image.range_m, range_m[0], atol=5e-4)  # float32 samples around 2048
    expected = reference_amplitude(camera, (5, 8)) / rays(camera.lens, (5, 8))[..., 0] ** 3 * 0.45 / range_m[0] ** 2
    np.testing.assert_allclose(image.amplitude, expected, rtol=2e-3)


@given(
    phase=st.floats(0, 2 * np.pi - 1e-3),
    amplitude=st.floats(30, 1500),
    factor=st.floats(1.1, 5),
)
@hypothesis_settings(max_examples=30, deadline=None)
def test_range_depends_neither_on_amplitude_nor_on_ambient_light(phase, amplitude, factor):
    one = cw_four_phase(frame(*samples_of(phase, amplitude)), EXACT)
    other = cw_four_phase(frame(*samples_of(phase, amplitude * factor, level=777.0)), EXACT)
    wrap = 2 * np.pi * metres_per_radian(EXACT)
    assert abs((one.range_m[0, 0] - other.range_m[0, 0] + wrap / 2) % wrap - wrap / 2) < 1e-4


@pytest.mark.parametrize(
    ("modulation_hz", "wrap_m"), [(30e6, 5.0), (20e6, 7.5), (17e6, 8.8235), (12e6, 12.5), (10e6, 15.0)]
)
def test_a_range_beyond_half_the_modulation_wavelength_wraps(modulation_hz, wrap_m):
    camera = replace(EXACT, modulation_hz=modulation_hz, speed_of_light_mps=3e8)  # N-S-001, N-S-003
    near, far = (
        cw_four_phase(frame(*samples_of(r / metres_per_radian(camera), 500.0)), camera) for r in (1.0, 1.0 + wrap_m)
    )
    assert near.range_m[0, 0] == pytest.approx(1.0, abs=1e-4)
    assert far.range_m[0, 0] == pytest.approx(1.0, abs=2e-4)


def test_the_exact_speed_of_light_shifts_the_range_by_seven_parts_in_ten_thousand():
    raw = frame(*samples_of(2.0, 500.0))
    exact, thesis = (cw_four_phase(raw, replace(EXACT, speed_of_light_mps=c)) for c in (SPEED_OF_LIGHT, 3e8))
    assert thesis.range_m[0, 0] == pytest.approx(2 * 1.404308, rel=1e-6)  # N-S-005
    assert thesis.range_m[0, 0] / exact.range_m[0, 0] == pytest.approx(3e8 / SPEED_OF_LIGHT, rel=1e-6)


def test_the_global_offset_is_compensated_within_the_unambiguous_range():
    camera = replace(EXACT, modulation_hz=30e6, speed_of_light_mps=3e8, offset_m=1.0)  # d_global = -1 m
    image = cw_four_phase(frame(*samples_of(4.5 / metres_per_radian(camera), 500.0)), camera)
    assert image.range_m[0, 0] == pytest.approx(0.5, abs=1e-5)  # N-S-006: 4.5 -> 5.5 -> 0.5


def test_the_phase_noise_is_that_of_a_sample_over_root_two_amplitudes():
    camera = replace(EXACT, shot_noise_lsb2_per_lsb=0.0, read_noise_lsb=1.0, binning=1)
    image = cw_four_phase(frame(*samples_of(0.3, 145.0)), camera)
    assert image.sigma_m[0, 0] * 1000 == pytest.approx(7, abs=0.5)  # N-S-052.1.1
    assert image.sigma_m[0, 0] / metres_per_radian(camera) == pytest.approx(1 / (np.sqrt(2) * 145.0), rel=1e-5)


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
def test_simulated_samples_scatter_with_exactly_the_variance_that_ranging_reckons_with(pixel):
    camera = replace(EXACT, pixel=pixel, shot_noise_lsb2_per_lsb=0.05, ambient_lsb=300.0, read_noise_lsb=2.0)
    ambient_wpm2 = 300.0 / camera.ambient_lsb_per_wpm2
    view = flat_view(1.2, shape=(1, 1), ambient_wpm2=ambient_wpm2)
    rng = np.random.default_rng(5)
    raws = [simulate(lambda _: view, camera, 0.0, rng) for _ in range(4000)]
    samples = np.array([[raw.planes[name][0, 0] for name in PLANES] for raw in raws])
    light = [correlate(view, camera, step)[1][0, 0] for step in STEPS]
    # chi-square with 3999 degrees of freedom: 4 sigma are 9 %
    np.testing.assert_allclose(samples.var(axis=0), sample_variance(np.array(light), camera), rtol=0.09)
    image = cw_four_phase(frame(*samples.mean(axis=0)), camera)
    mean_variance = float(np.mean(sample_variance(np.array(light), camera)))
    assumed = 2 * (image.sigma_m[0, 0] / metres_per_radian(camera) * image.amplitude[0, 0]) ** 2
    assert assumed == pytest.approx(mean_variance, rel=5e-3)


def test_sigma_is_the_scatter_of_the_range():
    view, rng = flat_view(1.5, reflectivity=0.4, shape=(6, 8)), np.random.default_rng(6)
    images = [cw_four_phase(simulate(lambda _: view, CAMERA, 0.0, rng), CAMERA) for _ in range(400)]
    scatter = np.std([image.range_m[1:] for image in images], axis=0)
    mean = np.mean([image.sigma_m[1:] for image in images], axis=0)
    assert np.mean(scatter / mean) == pytest.approx(1, abs=0.03)  # 42 pixels of 3.5 % each: 4 sigma are 2.2 %


@pytest.mark.parametrize(("modulation_hz", "ratio"), [(30e6, 17 / 30), (12e6, 17 / 12)])
def test_range_noise_falls_as_the_modulation_frequency_rises(modulation_hz, ratio):
    raw = frame(*samples_of(1.0, 200.0))
    other = cw_four_phase(raw, replace(EXACT, modulation_hz=modulation_hz))
    assert other.sigma_m[0, 0] / cw_four_phase(raw, EXACT).sigma_m[0, 0] == pytest.approx(ratio, rel=1e-5)  # N-S-044


def test_rounding_adds_a_twelfth_of_a_squared_step():
    raw = frame(*samples_of(0.4, 200.0))
    coarse = replace(EXACT, quantisation_lsb=16.0, shot_noise_lsb2_per_lsb=0.0)
    ratio = cw_four_phase(raw, coarse).sigma_m / cw_four_phase(raw, replace(coarse, quantisation_lsb=0.0)).sigma_m
    assert ratio[0, 0] == pytest.approx(np.sqrt(1 + 16**2 / 12), rel=1e-5)


@pytest.mark.parametrize(
    ("planes", "settings", "why"),
    [
        ([10.0, np.nan, 30.0, 40.0], {}, Why.NOT_FINITE),
        ([10.0, np.inf, 30.0, 40.0], {}, Why.NOT_FINITE),
        ([2048.0] * 4, {}, Why.NO_SIGNAL),
        ([0.0] * 4, {"lower_limit_lsb": 0.0}, Why.NO_SIGNAL),
        ([4095.0] * 4, {"full_scale_lsb": 4095.0}, Why.SATURATED),
        ([4095.0, 2000.0, 100.0, 2000.0], {"full_scale_lsb": 4095.0}, Why.SATURATED),
        ([4094.0, 2000.0, 1.0, 2000.0], {"full_scale_lsb": 4095.0, "lower_limit_lsb": 0.0}, Why.VALID),
        ([4000.0, 2000.0, 0.0, 2000.0], {"lower_limit_lsb": 0.0}, Why.SATURATED),
        ([2060.0, 2048.0, 2036.0, 2048.0], {"min_amplitude": 12.1}, Why.LOW_AMPLITUDE),
        ([2060.0, 2048.0, 2036.0, 2048.0], {"min_amplitude": 11.9}, Why.VALID),
        ([2060.0, 2048.0, 2036.0, 2048.0], {"max_phase_sigma_rad": 0.05}, Why.LOW_AMPLITUDE),
        ([2060.0, 2048.0, 2036.0, 2048.0], {"pseudo_rows": 1}, Why.SENSOR_FLAG),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # NaN, in the kernel without compilation
def test_each_fault_of_a_pixel_has_its_reason(planes, settings, why):
    image = cw_four_phase(frame(*planes), replace(EXACT, **settings))
    assert Why(int(image.why[0, 0])) is why
    if why is Why.NOT_FINITE:
        assert np.isnan([image.range_m, image.sigma_m, image.amplitude]).all()
    if why is Why.VALID:
        assert image.sigma_m[0, 0] > 0


def test_the_reason_in_pseudo_rows_covers_those_rows_only():
    full = [np.full((4, 3), c) for c in samples_of(1.0, 100.0)]
    image = cw_four_phase(frame(*full), replace(EXACT, pseudo_rows=2))
    assert (image.why == [[Why.SENSOR_FLAG]] * 2 + [[Why.VALID]] * 2).all()


@pytest.mark.parametrize(
    ("planes", "message"),
    [
        ({"phase_0": np.zeros((2, 2))}, "plane 'phase_90' is missing; this method needs phase_0, phase_90"),
        ({}, "plane 'phase_0' is missing"),
        (
            {**{n: np.zeros((2, 2)) for n in PLANES}, "phase_180": np.zeros((2, 3))},
            r"plane 'phase_180' has shape \(2, 3\); it must be an image \(rows, columns\) of the shape of 'phase_0'",
        ),
        ({n: np.zeros(4) for n in PLANES}, r"plane 'phase_0' has shape \(4,\)"),
        ({n: np.full((2, 2), "x") for n in PLANES}, "holds <U1; it must hold real numbers"),
        ({n: np.zeros((2, 2), complex) for n in PLANES}, "must hold real numbers"),
    ],
)
def test_a_frame_that_is_not_four_phase_images_is_refused_by_name(planes, message):
    with pytest.raises(DataError, match=message):
        cw_four_phase(RawFrame(0.0, planes), EXACT)


def test_ranging_leaves_its_input_as_it_was():
    raw = frame(*(np.random.default_rng(0).normal(size=(3, 4)) for _ in range(4)))
    before = {name: plane.copy() for name, plane in raw.planes.items()}
    cw_four_phase(raw, EXACT)
    assert all(np.array_equal(raw.planes[name], before[name]) for name in PLANES)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("modulation_hz", 0.0),
        ("phase_sign", 2),
        ("pixel", "quantum"),
        ("max_phase_sigma_rad", 0.9),
        ("capture_order", ["first"]),
    ],
)
def test_impossible_settings_are_refused_by_name(setting, value):
    with pytest.raises(UsageError, match=setting):
        parse(CwCamera, {setting: value}, "camera")


def test_the_reference_amplitude_is_that_of_the_thesis():
    thesis = 10 + 135 * np.outer(
        np.cos(np.radians(0.5 * np.abs(np.arange(120) - 59.5))) ** 7,
        np.cos(np.radians(0.5 * np.abs(np.arange(160) - 79.5))) ** 7,
    )  # A.5 with the symmetric centre of E-S-02
    ours = reference_amplitude(CAMERA, (120, 160))
    np.testing.assert_allclose(ours, thesis, rtol=1e-12)
    assert ours.max() == pytest.approx(145.0, abs=0.02)  # N-S-028
    assert ours.min() == pytest.approx(18.0, abs=0.4)


def test_a_white_plane_at_one_metre_makes_the_reference_image():
    shape, cos_axis = (12, 16), rays(CAMERA.lens, (12, 16))[..., 0]
    view = View(1 / cos_axis[None], np.ones((1, *shape)), cos_axis[None])
    c0, c90, c180, c270 = (correlate(view, EXACT, step)[0] for step in STEPS)
    np.testing.assert_allclose(np.hypot(c0 - c180, c270 - c90) / 2, reference_amplitude(EXACT, shape), rtol=1e-4)


def test_the_settings_of_the_reference_shape_it():
    camera = replace(CAMERA, reference_amplitude_lsb=200.0, reference_floor_lsb=50.0, reference_exponent=0.0)
    np.testing.assert_allclose(reference_amplitude(camera, (3, 4)), 200.0)
    assert reference_amplitude(replace(camera, reference_exponent=1e3), (120, 160))[0, 0] == pytest.approx(50.0)


def amplitude_of(camera, view):
    c0, c90, c180, c270 = (correlate(view, camera, step)[0] for step in STEPS)
    return np.hypot(c0 - c180, c270 - c90) / 2


def test_amplitude_goes_with_reflectivity_incidence_exposure_and_one_over_range_squared():
    base = amplitude_of(EXACT, flat_view(2.0))
    np.testing.assert_allclose(amplitude_of(EXACT, flat_view(4.0)), base / 4, rtol=1e-3)
    np.testing.assert_allclose(amplitude_of(EXACT, flat_view(2.0, 0.3)), base * 0.3, rtol=1e-3)
    np.testing.assert_allclose(amplitude_of(EXACT, flat_view(2.0, cos_incidence=0.5)), base / 2, rtol=1e-3)
    np.testing.assert_allclose(
        amplitude_of(replace(EXACT, illumination_time_s=1e-3), flat_view(2.0)), base / 2, rtol=1e-3
    )


def test_a_pixel_on_an_edge_adds_the_phasors_of_both_surfaces():
    ranges, shares = np.array([1.0, 2.5], np.float32), np.array([0.8, 0.6], np.float32)
    both = View(*(a.reshape(2, 1, 1) for a in (ranges, shares, np.ones(2, np.float32))))
    single = [View(*(a.reshape(1, 1, 1) for a in (r, s, np.ones(1)))) for r, s in zip(ranges, shares, strict=True)]
    for step in STEPS:
        parts = [correlate(view, EXACT, step)[0] for view in single]
        np.testing.assert_allclose(correlate(both, EXACT, step)[0], np.mean(parts, axis=0), rtol=1e-6)


def test_a_ray_into_the_void_gives_black_level_and_no_light():
    view = View(np.full((1, 2, 2), np.inf), np.zeros((1, 2, 2)), np.zeros((1, 2, 2)), ambient_wpm2=50.0)
    sample, light = correlate(view, EXACT, 90)
    np.testing.assert_array_equal(sample, EXACT.black_level_lsb)
    np.testing.assert_array_equal(light, 0)


def test_ambient_light_lifts_single_ended_samples_and_only_the_noise_of_differential_ones():
    dark, bright = flat_view(2.0), flat_view(2.0, ambient_wpm2=5.0)
    single = replace(EXACT, pixel="single_ended")
    for camera in (EXACT, single):
        assert (correlate(bright, camera, 0)[1] > correlate(dark, camera, 0)[1] + 100).all()
    np.testing.assert_array_equal(correlate(bright, EXACT, 0)[0], correlate(dark, EXACT, 0)[0])
    lift = correlate(bright, single, 0)[0] - correlate(dark, single, 0)[0]
    assert lift.max() == pytest.approx(5.0 * EXACT.ambient_lsb_per_wpm2, rel=0.15)


def test_the_active_light_is_the_amplitude_over_the_contrast():
    camera = replace(EXACT, demodulation_contrast=0.5)
    np.testing.assert_allclose(
        correlate(flat_view(2.0), camera, 0)[1], 2 * amplitude_of(camera, flat_view(2.0)), rtol=1e-3
    )


def test_the_four_exposures_take_twelve_milliseconds_around_the_frame_time():
    times = exposure_times_s(CAMERA, 1.0)
    assert np.mean(times) == pytest.approx(1.0)
    assert times[-1] - times[0] + CAMERA.illumination_time_s == pytest.approx(11.69e-3)  # N-S-019.2
    assert exposure_times_s(replace(CAMERA, readout_time_s=0.0), 0.0)[3] == pytest.approx(3e-3)


def test_phase_images_are_exposed_in_the_order_of_capture():
    def view(time_s):
        seen.append(time_s)
        return flat_view(2.0 + time_s, shape=(1, 1))

    seen: list[float] = []
    camera = replace(EXACT, read_noise_lsb=0.0, shot_noise_lsb2_per_lsb=0.0, capture_order=(270, 0, 180, 90))
    raw = simulate(view, camera, 3.0, np.random.default_rng(0))
    assert seen == exposure_times_s(camera, 3.0)
    for step, time_s in zip(camera.capture_order, seen, strict=True):
        expected = correlate(flat_view(2.0 + time_s, shape=(1, 1)), camera, step)[0]
        np.testing.assert_allclose(raw.planes[f"phase_{step}"], expected)
    assert tuple(raw.planes) == PLANES
    assert raw.time_s == 3.0


def test_a_moving_surface_is_measured_where_it_was_in_the_middle_of_the_exposures():
    camera = replace(EXACT, read_noise_lsb=0.0, shot_noise_lsb2_per_lsb=0.0)
    raw = simulate(lambda t: flat_view(2.0 - 3.0 * t, shape=(2, 2)), camera, 0.1, np.random.default_rng(0))
    # 3 m/s over 11.69 ms: the artefact of sequential phases stays below the way travelled meanwhile
    assert np.abs(cw_four_phase(raw, camera).range_m - 1.7).max() < 3.0 * 11.69e-3


def test_a_capture_order_that_repeats_a_step_is_refused():
    with pytest.raises(UsageError, match=r"capture_order = \[0, 0, 90, 180\]: expected 0, 90"):
        simulate(
            lambda _: flat_view(1.0), replace(CAMERA, capture_order=(0, 0, 90, 180)), 0.0, np.random.default_rng(0)
        )


def test_a_frame_rate_that_the_exposures_do_not_allow_is_refused():
    with pytest.raises(UsageError, match=r"frame_rate_hz = 78: .* no more than 77.4 Hz"):  # N-S-019.2
        simulate(lambda _: flat_view(1.0), replace(CAMERA, frame_rate_hz=78.0), 0.0, np.random.default_rng(0))


def test_the_converter_rounds_to_its_step_and_saturates_at_its_limits():
    camera = replace(CAMERA, quantisation_lsb=4.0, pseudo_rows=1)
    raw = simulate(lambda _: flat_view(0.15), camera, 0.0, np.random.default_rng(0))
    image = cw_four_phase(raw, camera)
    assert all(plane.dtype == np.uint16 for plane in raw.planes.values())
    assert max(plane.max() for plane in raw.planes.values()) == 4095
    assert (image.why[1:] == Why.SATURATED).all()
    assert (image.why[0] == Why.SENSOR_FLAG).all()
    unsaturated = simulate(lambda _: flat_view(2.0), camera, 0.0, np.random.default_rng(0))
    assert all((plane % 4 == 0).all() for plane in unsaturated.planes.values())
    floats = simulate(lambda _: flat_view(2.0), EXACT, 0.0, np.random.default_rng(0))
    assert all(plane.dtype == np.float32 for plane in floats.planes.values())


def test_simulation_is_the_same_for_the_same_generator():
    one, other = (simulate(lambda _: flat_view(2.0), CAMERA, 0.0, np.random.default_rng(7)) for _ in range(2))
    assert all(np.array_equal(one.planes[name], other.planes[name]) for name in PLANES)


def test_lens_of_the_camera_shapes_the_light():
    narrow = replace(CAMERA, lens=Lens(horizontal_fov_deg=10.0))
    assert reference_amplitude(narrow, (9, 9)).min() > 0.9 * narrow.reference_amplitude_lsb


def test_a_real_recording_gives_the_range_of_its_camera_and_keeps_its_good_pixels():
    folder = os.environ.get("RANGECAM_DATA")
    if folder is None:
        pytest.skip("RANGECAM_DATA does not name the folder of recordings")
    recording = np.load(Path(folder) / "cw_mlx75027" / "tools_scene.npz")
    facts = {"modulation_hz": float(recording["modulation_hz"]), "phase_sign": int(recording["phase_sign"])}
    config = load_config("generic_cw", {"camera": facts})
    measured = cw_four_phase(RawFrame(0.0, {name: recording[name] for name in PLANES}), config.camera)
    image = clean(measured, config.camera.lens, config.mounting, config.clean)
    good = (recording["camera_amplitude"] > 100) & (recording["camera_amplitude"] < 2800)
    used = good & image.valid & (recording["camera_range_m"] > 0)
    assert used.sum() >= 0.97 * good.sum()
    wrap = SPEED_OF_LIGHT / 2 / facts["modulation_hz"]
    turn = np.exp(2j * np.pi * (recording["camera_range_m"] - image.range_m)[used] / wrap)
    rest = np.angle(turn / turn.mean()) * wrap / (2 * np.pi)
    assert 1.4826 * np.median(np.abs(rest - np.median(rest))) <= 0.015
    assert np.corrcoef(image.amplitude[used], recording["camera_amplitude"][used])[0, 1] > 0.999
    assert np.isfinite(image.sigma_m[used]).all()
    assert (image.sigma_m[used] > 0).all()
