"""Gradient methods, gating, CSI and DCSI: inversion, noise, reasons (König 2008, 3.4.2, 3.4.3, 5.1, 5.2.1.3)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from rangecam.config import load_config
from rangecam.errors import DataError, UsageError
from rangecam.pipeline import process_frame
from rangecam.pulsed import RANGING, PulsedCamera, delays, simulate
from rangecam.pulsed.delays import gating_ranges_m, zero_crossing
from rangecam.pulsed.pixel import noise_variance
from rangecam.pulsed.settings import Laser, Pixel
from rangecam.pulsed.signal import exposures, laser_delays
from rangecam.scene.view import View
from rangecam.types import Ego, RawFrame, Tracks, Why

C = 3e8
T_PW = 180e-9
SILENT = Pixel(photon_noise=False, adc_bits=0, sensor_noise_v=0.0, readout_noise_v=0.0, saturation_v=1e9)
# Equal noise of all shutters, as the thesis has it (eq 5.3), without damping.
EQUAL = Pixel(photon_noise=False, adc_bits=0, damping=0.0, saturation_v=100.0)
CAMERA = PulsedCamera(speed_of_light_mps=C, pixel=EQUAL)
SHUTTERS = {
    "mdsi1": "ac", "mdsi2": "bc", "mdsi3": "ab", "mdsi4": "ab",
    "gradient1": "aa", "gradient2": "bb", "csi": "a_delayed", "dcsi": "ab_delayed",
}  # fmt: skip
METHODS = [*delays.RANGING]


def camera_of(name, **changes):
    """A camera for a method; the laser of gradient2 is late enough for it to measure from 0 m on."""
    late = {"laser_delay_s": 30e-9} if name == "gradient2" else {}
    return replace(CAMERA, shutters=SHUTTERS[name], **{**late, **changes})


def planes_of(range_m, camera, volts=1.0, n_acc=1):
    """Noise-free planes: overlaps of pulse and windows, the windows laid out by hand."""
    range_m, pulse = np.atleast_2d(np.asarray(range_m, float)), camera.pulse_width_s
    t0, width, step = camera.shutter_delay_s, camera.shutter_a_width_s or pulse, camera.gradient_step_s
    a, b = (t0, t0 + width), (t0 + width, t0 + width + (camera.shutter_b_width_s or pulse))
    late, g = camera.laser_delay_s, camera.gating_s
    shots = {
        "aa": {"a1": (a, late), "a2": ((a[0], a[1] - step), late)},
        "bb": {"b1": ((b[0] + g, b[1] + g), late), "b2": ((b[0] + g + step, b[1] + g + step), late)},
        "ab": {"a": (a, late), "b": (b, late)}, "ac": {"a": (a, late), "c": ((a[0], b[1]), late)},
        "bc": {"b": (b, late), "c": ((a[0], b[1]), late)},
    }  # fmt: skip
    for k in range(camera.delay_count):
        delay = late + camera.delay_first_s + k * camera.delay_step_s
        for taken in ("a_delayed", "ab_delayed"):
            shots.setdefault(taken, {})[f"a_{k}"] = (a, delay)
        shots["ab_delayed"][f"b_{k}"] = (b, delay)
    planes = {}
    for name, ((opens, closes), delay) in shots[camera.shutters].items():
        start = delay + 2 * range_m / C
        overlap = np.clip(np.minimum(start + pulse, closes) - np.maximum(start, opens), 0, None)
        planes[f"shutter_{name}"] = volts * overlap / pulse
    return planes | {"n_acc": np.full(range_m.shape, n_acc, np.uint8)}


def decode(name, planes, camera):
    return RANGING[name](RawFrame(1.5, planes), camera)


def sigma_of(name, range_m, camera=None, **signal):
    camera = camera or camera_of(name)
    return decode(name, planes_of(range_m, camera, **signal), camera).sigma_m[0].astype(float)


def wall(range_m, camera, reflectivity=0.5, ambient_wpm2=0.0):
    ones = np.ones((1, camera.rows, camera.columns))
    view = View(ones * range_m, ones * reflectivity, ones, ambient_wpm2)
    return lambda time_s: view


# --- inversion ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", METHODS)
@settings(deadline=None)
@given(range_m=st.floats(0.1, 21.0), volts=st.floats(0.1, 3.0))
def test_range_does_not_depend_on_power_or_reflectivity(name, range_m, volts):
    """K-RNG-06 to -10, N-K-022."""
    camera = camera_of(name, min_snr=1.0, far_margin_sigmas=0.0)
    image = decode(name, planes_of(range_m, camera, volts), camera)
    assert image.range_m[0, 0] == pytest.approx(range_m, abs=4e-6)
    assert image.valid.all()
    assert image.amplitude[0, 0] == pytest.approx(volts, rel=1e-5)
    assert image.time_s == 1.5


@pytest.mark.parametrize("name", METHODS)
def test_unequal_windows_and_delays_leave_the_range_alone(name):
    camera = camera_of(
        name, shutter_a_width_s=200e-9, shutter_b_width_s=200e-9, shutter_delay_s=12e-9, laser_delay_s=25e-9,
        gradient_step_s=20e-9, delay_first_s=-230e-9, delay_step_s=10e-9, delay_count=45, offset_m=0.25,
    )  # fmt: skip
    if name == "csi":  # a top as flat as the window is longer than the pulse has no maximum
        camera = replace(camera, shutter_a_width_s=None)
    range_m = np.linspace(4.3, 20.0, 60)
    image = decode(name, planes_of(range_m, camera), camera)
    np.testing.assert_allclose(image.range_m[0], range_m + 0.25, atol=1e-5)
    assert image.valid.all()


@pytest.mark.parametrize(("range_m", "printed_m"), [(6.0, 42.0), (12.0, 36.0), (20.0, 28.0)])
def test_the_printed_gradient_method_2_fails(range_m, printed_m):
    """E-K-04: eq 3.24 as printed gives 42, 36, 28 m for 6, 12, 20 m with windows of 320 ns."""
    camera = replace(CAMERA, shutters="bb", shutter_b_width_s=320e-9, gradient_step_s=30e-9)
    planes = planes_of(range_m, camera)
    b1, b2 = planes["shutter_b1"][0, 0], planes["shutter_b2"][0, 0]
    assert C / 2 * (320e-9 - 30e-9 * b1 / (b1 - b2)) == pytest.approx(printed_m)
    assert decode("gradient2", planes, camera).range_m[0, 0] == pytest.approx(range_m, abs=4e-6)


def test_the_printed_dcsi_fails_with_the_difference_of_the_openings():
    """E-K-05: a difference where the sum belongs."""
    camera = camera_of("dcsi")
    planes = planes_of(9.0, camera)
    apart = [planes[f"shutter_a_{k}"][0, 0] - planes[f"shutter_b_{k}"][0, 0] for k in range(camera.delay_count)]
    k = next(k for k, v in enumerate(apart) if v <= 0 and max(apart[:k], default=0) > 0.5)
    delay_s = laser_delays(camera)[k - 1] + camera.delay_step_s * apart[k - 1] / (apart[k - 1] - apart[k])
    assert C / 2 * ((0.0 - T_PW) / 2 - delay_s) == pytest.approx(9.0 - 27.0)
    assert decode("dcsi", planes, camera).range_m[0, 0] == pytest.approx(9.0, abs=2e-6)


@pytest.mark.parametrize(("step_s", "full_m"), [(5e-9, 2.25), (20e-9, 4.5), (50e-9, 9.0)])
def test_gating_moves_the_measurement_range_away(step_s, full_m):
    """N-K-073, N-K-074 (K-ENV-05, eqs 5.11-5.13): d_G, d_T, d_max; between the first two the quotient says nothing."""
    camera = replace(CAMERA, shutters="bb", gating_s=10e-9, gradient_step_s=step_s, far_margin_sigmas=0.0, min_snr=1e-3)
    np.testing.assert_allclose(gating_ranges_m(camera), [1.5, full_m, 28.5], rtol=1e-12)
    range_m = [1.4, full_m - 0.1, full_m + 0.1, 28.4, 28.7]
    image = decode("gradient2", planes_of(range_m, camera), replace(camera, far_margin_sigmas=2.0))
    assert image.why[0, 0] == Why.LOW_AMPLITUDE
    assert image.range_m[0, 1] == pytest.approx(full_m, abs=1e-5)
    assert image.why[0, 1] == Why.OUT_OF_RANGE
    np.testing.assert_array_equal(decode("gradient2", planes_of(range_m, camera), camera).valid[0, 2:4], [True, True])
    assert not image.valid[0, 4]


def test_a_window_longer_than_the_pulse_does_not_see_farther():
    """E-K-15: 28.5 m, not 46.5 m."""
    assert gating_ranges_m(replace(CAMERA, gating_s=10e-9, shutter_b_width_s=300e-9))[2] == pytest.approx(28.5)


def test_a_drop_before_the_gated_range_leaves_gradient2_alone():
    """K-ENV-06: what returns within T_G is not collected, however bright it is."""
    camera = replace(CAMERA, shutters="bb", gating_s=3.4e-9, gradient_step_s=15e-9)
    target, drop = planes_of(5.0, camera), planes_of(0.5, camera, 3.0)
    both = {k: target[k] + (drop[k] if k != "n_acc" else 0) for k in target}
    assert decode("gradient2", both, camera).range_m[0, 0] == pytest.approx(5.0, abs=2e-6)
    open_ = replace(camera, gating_s=0.0)
    target, drop = planes_of(5.0, open_), planes_of(0.5, open_, 3.0)
    both = {k: target[k] + (drop[k] if k != "n_acc" else 0) for k in target}
    assert decode("gradient2", both, open_).range_m[0, 0] < 4.5


def test_beyond_window_a2_gradient1_says_nothing():
    camera = camera_of("gradient1")
    image = decode("gradient1", planes_of([20.0, 22.49, 23.0, 26.0, 30.0], camera), camera)
    assert list(image.why[0]) == [Why.VALID, *[Why.OUT_OF_RANGE] * 3, Why.LOW_AMPLITUDE]


@pytest.mark.parametrize(("name", "near_m", "far_m"), [("csi", 1.0, 26.5), ("dcsi", 1.0, 26.5)])
def test_objects_beyond_the_delays_are_out_of_range(name, near_m, far_m):
    """Delays from -120 to 60 ns: csi sees 0 to 16.5 m, dcsi of five points 10.5 to 25.5 m."""
    camera = camera_of(name, delay_first_s=-120e-9, delay_count=10, linear_part_s=100e-9)
    image = decode(name, planes_of([near_m, 12.0, 16.0, far_m], camera), camera)
    near = Why.VALID if name == "csi" else Why.OUT_OF_RANGE
    assert list(image.why[0]) == [near, Why.VALID, Why.VALID, Why.OUT_OF_RANGE]


# --- annex C -----------------------------------------------------------------------------------------------------

X = np.array([7.0, 9.0, 10.5, 12.0, 14.0])
Y = np.array([6.3, 1.8, -1.2, -3.6, -8.3])


def test_the_crossing_of_a_fitted_line_and_its_derivatives_are_those_of_annex_c():
    """E-K-27 against numeric derivatives; the crossing against polyfit."""
    crossing, by_y, slope = zero_crossing(X, Y)
    m, b = np.polyfit(X, Y, 1)
    assert crossing == pytest.approx(-b / m)
    assert slope == pytest.approx(m)
    numeric = [(zero_crossing(X, Y + 1e-6 * e)[0] - zero_crossing(X, Y - 1e-6 * e)[0]) / 2e-6 for e in np.eye(len(X))]
    np.testing.assert_allclose(by_y, numeric, rtol=1e-6)
    mean, n = np.mean, len(X)
    bottom = mean(X * Y) - mean(X) * mean(Y)
    top = mean(X) * mean(X * Y) - mean(X**2) * mean(Y)
    printed = (bottom * (mean(X) * X / n - mean(X**2) / n) - top * (mean(X) * X / n - mean(X) / n)) / bottom**2
    assert np.abs(printed - numeric).max() > 0.01


def test_the_sum_over_pairs_equals_the_fit_only_as_corrected():
    """E-K-26: eq C.7 with y_i - s x_i and the squared distances of x."""

    def pairs(offset_of, weight):
        top = bottom = 0.0
        for i in range(len(X)):
            for j in range(i + 1, len(X)):
                s = (Y[i] - Y[j]) / (X[i] - X[j])
                top += (Y[i] - s * X[offset_of(i, j)]) * weight(i, j)
                bottom += s * weight(i, j)
        return -top / bottom

    crossing = zero_crossing(X, Y)[0]
    assert pairs(lambda i, j: i, lambda i, j: (X[i] - X[j]) ** 2) == pytest.approx(crossing)
    assert pairs(lambda i, j: j, lambda i, j: (i - j) ** 2) != pytest.approx(crossing, rel=1e-3)


def test_a_line_that_does_not_fall_has_no_crossing():
    crossing, by_y, slope = zero_crossing(X, -Y)
    assert crossing == 0
    assert not by_y.any()
    assert slope > 0


@pytest.mark.parametrize("length_s", [39e-9, 401e-9])
def test_a_linear_part_that_holds_too_few_or_too_many_delays_is_refused(length_s):
    camera = camera_of("dcsi", linear_part_s=length_s)
    with pytest.raises(UsageError, match=r"camera\.linear_part_s"):
        decode("dcsi", planes_of(9.0, camera), camera)


def test_a_step_as_long_as_window_a_is_refused():
    camera = camera_of("gradient1", gradient_step_s=180e-9)
    with pytest.raises(UsageError, match=r"camera\.gradient_step_s"):
        decode("gradient1", planes_of(9.0, camera_of("gradient1")), camera)


# --- noise -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step_s", "ratios", "printed"),
    [
        (10e-9, (24.0, 21.0, 14.9), (0.03, 0.04, 0.07)),
        (30e-9, (7.5, 6.4, 4.4), (0.10, 0.15, 0.24)),
        (50e-9, (4.2, 3.6, 2.4), (0.18, 0.28, 0.50)),
    ],
)
def test_gradient_methods_are_noisier_than_mdsi3_by_the_known_ratios(step_s, ratios, printed):
    """N-K-063 (E-K-12); the printed eq 5.8 would make them the best of all."""
    range_m = np.array([5.0, 10.0, 15.0])
    best = sigma_of("mdsi3", range_m)
    camera = camera_of("gradient1", gradient_step_s=step_s)
    np.testing.assert_allclose(sigma_of("gradient1", range_m, camera) / best, ratios, atol=0.051)
    planes = planes_of(range_m, camera)
    a1, a2 = planes["shutter_a1"][0], planes["shutter_a2"][0]
    as_printed = C / 2 * step_s * np.hypot(a1, a2) / (a1 + a2) ** 2 * np.hypot(0.379e-3, 0.442e-3)
    np.testing.assert_allclose(as_printed / best, printed, atol=0.0051)
    # gradient method 2 sees the same from the other end
    mirrored = camera_of("gradient2", gradient_step_s=step_s, laser_delay_s=0.0)
    there = 27.0 - range_m
    np.testing.assert_allclose(sigma_of("gradient2", there, mirrored) / best, ratios, atol=0.051)


@pytest.mark.parametrize(("points", "sigma"), [(2, 0.5), (5, 0.316), (10, 0.224), (20, 0.158)])
def test_sigma_of_dcsi_falls_with_the_root_of_the_points(points, sigma):
    """N-K-064: in units of c/2 T_Pw sigma_U / U_c; MDSI3 has 0.707 to 1."""
    step_s = 4e-9
    camera = camera_of(
        "dcsi", delay_first_s=-120e-9, delay_step_s=step_s, delay_count=61, linear_part_s=points * step_s
    )
    # the crossing in the middle of the points: between two delays for an even number, at one for an odd number
    range_m = C / 2 * (0.0 if points % 2 else step_s / 2) + 13.5
    unit_m = C / 2 * T_PW * np.hypot(0.379e-3, 0.442e-3)
    assert sigma_of("dcsi", range_m, camera)[0] / unit_m == pytest.approx(sigma, abs=6e-4)
    assert sigma_of("mdsi3", 13.5)[0] / unit_m == pytest.approx(0.7071, abs=1e-4)


@pytest.mark.parametrize(("points", "n_acc", "sigma"), [(5, 20, 0.726), (10, 10, 0.749), (20, 5, 0.792)])
def test_with_as_many_pulses_dcsi_is_no_better_than_mdsi3(points, n_acc, sigma):
    """N-K-064b: 100 pulses a shutter in all; in units of the noise of 100 accumulations."""
    step_s = 4e-9
    camera = camera_of(
        "dcsi", delay_first_s=-120e-9, delay_step_s=step_s, delay_count=61, linear_part_s=points * step_s
    )
    range_m = C / 2 * (0.0 if points % 2 else step_s / 2) + 13.5
    found = sigma_of("dcsi", range_m, camera, volts=n_acc, n_acc=n_acc)[0]
    unit_m = sigma_of(
        "mdsi3", 13.5, volts=100, n_acc=100, camera=replace(CAMERA, pixel=replace(EQUAL, saturation_v=1e3))
    )
    assert found / (unit_m[0] / np.sqrt(0.5)) == pytest.approx(sigma, abs=2e-3)


LIT = Pixel(adc_bits=0, saturation_v=1e9, accumulations=(16,))
CONFIDENT = chi2.ppf([0.0005, 0.9995], 8191) / 8191


@pytest.mark.parametrize("range_m", [3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 21.0])
@pytest.mark.parametrize("name", SHUTTERS)
def test_closed_form_equals_monte_carlo_equals_the_simulated_camera(name, range_m):
    """99 % confidence for all methods and ranges together (K-CMP-06), with shot noise, damping and ambient light."""
    laser = Laser(peak_power_w=1e5)
    camera = camera_of(name, rows=64, columns=128, frame_rate_hz=1.0, laser=laser, pixel=LIT)
    view = wall(range_m, camera, 0.5, 300.0)
    clean = simulate(view, replace(camera, pixel=replace(SILENT, accumulations=(16,))), 0.0, np.random.default_rng(0))
    expected = RANGING[name](clean, camera)
    assert expected.valid.all()
    np.testing.assert_allclose(expected.range_m, range_m, atol=1e-4)

    rng, noisy = np.random.default_rng(3), dict(clean.planes)
    for key, (window, _) in exposures(camera).items():
        ambient_v = clean.planes["ambient"] * (window[1] - window[0])
        sigma_v = np.sqrt(noise_variance(clean.planes[key], 16, ambient_v, LIT))
        noisy[key] = clean.planes[key] + sigma_v * rng.standard_normal(clean.shape)
    simulated = simulate(view, camera, 0.0, np.random.default_rng(4))
    for raw in (RawFrame(0.0, noisy), simulated):
        image = RANGING[name](raw, camera)
        ratio = ((image.range_m - expected.range_m) / expected.sigma_m)[image.valid]
        assert image.valid.all()
        assert CONFIDENT[0] < np.var(ratio) < CONFIDENT[1]
        assert abs(ratio.mean()) < 4 / np.sqrt(ratio.size)


@pytest.mark.parametrize("n_acc", [1, 4, 16, 64, 100])
def test_mdsi3_is_less_noisy_than_mdsi1_at_every_range_and_accumulation(n_acc):
    """With all noise and damping, at the light of the camera off 50 %."""
    pixel = replace(LIT, accumulations=(n_acc,))
    sigma = {}
    for name in ("mdsi1", "mdsi3"):
        camera = replace(CAMERA, shutters=SHUTTERS[name], rows=1, columns=1, pixel=pixel, min_snr=1e-3)
        sigma[name] = [
            RANGING[name](simulate(wall(r, camera), replace(camera, pixel=replace(SILENT, accumulations=(n_acc,))), 0.0,
                                   np.random.default_rng(0)), camera).sigma_m[0, 0]
            for r in np.arange(1.0, 26.6, 0.5)
        ]  # fmt: skip
    assert (np.array(sigma["mdsi3"]) < np.array(sigma["mdsi1"])).all()


@pytest.mark.parametrize("name", METHODS)
def test_averages_ambient_light_and_rounding_change_sigma(name):
    camera = camera_of(name, pixel=Pixel(adc_bits=0))
    planes = planes_of(9.0, camera, 0.5, 16)
    sigma = decode(name, planes, camera).sigma_m
    assert decode(name, planes, replace(camera, averages=4)).sigma_m == pytest.approx(sigma / 2, rel=1e-6)
    assert decode(name, planes | {"ambient": np.full((1, 1), 1e6)}, camera).sigma_m > 1.02 * sigma
    assert decode(name, planes, replace(camera, pixel=Pixel(adc_bits=8))).sigma_m > 1.5 * sigma


# --- systematic errors of CSI ------------------------------------------------------------------------------------


def test_soft_shapes_spoil_the_maximum_and_csi_says_so():
    """K-RNG-08: without noise, csi errs by decimetres and its sigma tells; dcsi, on its delays, by centimetres."""
    soft = {"pulse_rise_s": 60e-9, "pulse_fall_s": 30e-9, "shutter_edge_s": 65e-9, "rows": 1, "columns": 1}
    errors, sigma = {}, {}
    for name in ("csi", "dcsi"):
        camera = camera_of(name, pixel=SILENT, frame_rate_hz=1.0, **soft)
        ranges = np.arange(5.0, 11.0, 0.1)
        images = [
            RANGING[name](simulate(wall(r, camera), camera, 0.0, np.random.default_rng(0)), camera) for r in ranges
        ]
        errors[name] = np.array([image.range_m[0, 0] for image in images]) - ranges
        sigma[name] = images[0].sigma_m[0, 0]
    rms = {name: np.sqrt(np.mean(error**2)) for name, error in errors.items()}
    assert rms["csi"] == pytest.approx(sigma["csi"], rel=0.02)
    assert np.ptp(errors["csi"]) > 0.4
    assert np.ptp(errors["dcsi"]) < 0.04


# --- reasons -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", METHODS)
def test_each_invalid_pixel_says_why(name):
    camera = camera_of(name, pixel=Pixel())
    planes = {k: np.repeat(v, 9, axis=1) for k, v in planes_of(9.0, camera, 1.0, 4).items()}
    planes = {k: v.astype(np.float32 if k != "n_acc" else np.int64) for k, v in planes.items()}
    planes["ambient"] = np.zeros((1, 9))
    for k in planes:
        if k.startswith("shutter"):
            planes[k][0, 1] = np.nan
            planes[k][0, 2] = 1.5
            planes[k][0, 3] *= 1e-4
            planes[k][0, 4] = -0.1
    planes["n_acc"][0, 5], planes["n_acc"][0, 6] = 0, 256
    planes["ambient"][0, 7] = np.inf
    image = decode(name, planes, camera)
    expected = [
        Why.VALID, Why.NOT_FINITE, Why.SATURATED, Why.LOW_AMPLITUDE, Why.LOW_AMPLITUDE, Why.NO_SIGNAL,
        Why.SENSOR_FLAG, Why.NOT_FINITE, Why.VALID,
    ]  # fmt: skip
    assert list(image.why[0]) == expected
    assert np.isnan(image.range_m[0, [1, 4, 5, 6, 7]]).all()
    assert np.isfinite(image.sigma_m[0, [0, 3]]).all()
    planes["n_acc"] = np.where(np.arange(9) == 8, np.nan, 4.0)[None]
    assert decode(name, planes, camera).why[0, 8] == Why.NOT_FINITE
    strict = replace(camera, pixel=Pixel(noise_threshold_v=1.1))
    assert decode(name, planes_of(9.0, strict, 1.0, 4), strict).why[0, 0] == Why.LOW_AMPLITUDE
    limited = decode(name, planes_of([1.0, 6.0, 12.0], camera), replace(camera, min_range_m=5.0, max_range_m=10.0))
    assert list(limited.why[0]) == [Why.OUT_OF_RANGE, Why.VALID, Why.OUT_OF_RANGE]


@pytest.mark.parametrize("name", METHODS)
def test_a_missing_plane_is_named(name):
    camera = camera_of(name)
    planes = planes_of(9.0, camera)
    with pytest.raises(DataError, match="'n_acc' is missing"):
        decode(name, {k: v for k, v in planes.items() if k != "n_acc"}, camera)


def test_a_long_list_of_planes_is_not_told_in_full():
    two = planes_of(9.0, replace(CAMERA, shutters="ab"))
    with pytest.raises(DataError, match=r"needs shutter_a_0, shutter_a_1, \.\.\., shutter_b_18, n_acc, the frame has"):
        decode("dcsi", two, camera_of("dcsi"))


@pytest.mark.parametrize("name", METHODS)
def test_each_method_runs_through_the_whole_chain(name):
    changes = {"shutters": SHUTTERS[name], "frame_rate_hz": 2.0}
    config = load_config("usercams", {"ranging": name, "camera": changes, "clean": {"floor": "off"}})
    view = wall(8.0, config.camera, 0.8)
    raw = simulate(view, config.camera, 0.0, np.random.default_rng(1))
    assert set(raw.planes) == {*exposures(config.camera), "n_acc", "ambient"}
    frame = process_frame(raw, Tracks.empty(), Ego(), config)
    assert frame.segments[0].range_m == pytest.approx(8.0, abs=0.1)
