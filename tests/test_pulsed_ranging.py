"""Ranging of pulsed cameras: inversion, noise, reasons, and a real recording."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from rangecam.errors import DataError, UsageError
from rangecam.pulsed import PulsedCamera
from rangecam.pulsed.pixel import convert, noise_variance
from rangecam.pulsed.ranging import RANGING
from rangecam.pulsed.settings import Pixel, Taps
from rangecam.types import RawFrame, Why

C = 3e8
MDSI = ["mdsi1", "mdsi2", "mdsi3", "mdsi4"]
QUIET = Pixel(photon_noise=False, adc_bits=0, damping=0.0, saturation_v=100.0)
CAMERA = PulsedCamera(speed_of_light_mps=C)
TAPS = PulsedCamera(speed_of_light_mps=C, pulse_width_s=30e-9, readout="three_tap")


def overlap(start, width, opens, closes):
    return np.clip(np.minimum(start + width, closes) - np.maximum(start, opens), 0, None)


def shutters(range_m, camera, volts=1.0, n_acc=1):
    """Noise-free shutter planes of an object at `range_m`, from windows laid out by hand."""
    range_m = np.atleast_2d(np.asarray(range_m, float))
    pulse = camera.pulse_width_s
    opens = camera.shutter_delay_s
    middle = opens + (camera.shutter_a_width_s or pulse)
    closes = middle + (camera.shutter_b_width_s or pulse)
    start = camera.laser_delay_s + 2 * range_m / C
    planes = {
        f"shutter_{name}": volts * overlap(start, pulse, *window) / pulse
        for name, window in {"a": (opens, middle), "b": (middle, closes), "c": (opens, closes)}.items()
    }
    return planes | {"n_acc": np.full(range_m.shape, n_acc, np.uint8)}


def taps(range_m, camera, counts=1000.0):
    """Noise-free taps, without background, of an object at `range_m`."""
    start = 2 * np.atleast_2d(np.asarray(range_m, float)) / C - camera.pulse_lead_s
    gate = camera.gate_width_s or camera.pulse_width_s
    return {
        f"tap_{i}": counts * overlap(start, camera.pulse_width_s, (i - 2) * gate, (i - 1) * gate) / camera.pulse_width_s
        for i in (1, 2, 3)
    }


def planes_of(name, range_m, camera, signal=1.0):
    return taps(range_m, camera, 1000 * signal) if name == "three_tap" else shutters(range_m, camera, signal)


def decode(name, planes, camera):
    return RANGING[name](RawFrame(1.5, planes), camera)


def camera_of(name):
    return TAPS if name == "three_tap" else replace(CAMERA, pixel=QUIET)


# --- inversion ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RANGING)
@settings(deadline=None)  # the first call compiles
@given(fraction=st.floats(0.01, 0.9), signal=st.floats(0.1, 3.0))
def test_range_does_not_depend_on_power_or_reflectivity(name, fraction, signal):
    """K-RNG-10, and inversion to a micrometre beside the steps of float32."""
    camera = camera_of(name)
    range_m = fraction * C / 2 * camera.pulse_width_s
    image = decode(name, planes_of(name, range_m, camera, signal), camera)
    assert image.range_m[0, 0] == pytest.approx(range_m, abs=1e-6 + float(np.spacing(np.float32(range_m))))
    assert image.valid.all()
    assert image.time_s == 1.5


@pytest.mark.parametrize("name", MDSI)
def test_all_variants_agree_with_unequal_windows_and_delays(name):
    """N-K-021, with the general forms of E-K-02 and E-K-03."""
    camera = PulsedCamera(
        speed_of_light_mps=C, shutter_a_width_s=200e-9, shutter_b_width_s=230e-9, laser_delay_s=30e-9,
        shutter_delay_s=12e-9, pixel=QUIET,
    )  # fmt: skip
    nearest_m = C / 2 * (200e-9 - 180e-9 - 18e-9)
    range_m = np.linspace(nearest_m + 0.01, nearest_m + 26.5, 100)
    image = decode(name, shutters(range_m, camera), camera)
    np.testing.assert_allclose(image.range_m[0], range_m, atol=1e-6 + 1e-7 * 27)
    assert image.valid.all()


def test_the_printed_mdsi3_fails_where_window_a_is_longer_than_the_pulse():
    """E-K-03: 12 m instead of 15 m for T_Int,a = 200 ns."""
    camera = replace(CAMERA, shutter_a_width_s=200e-9, pixel=QUIET)
    planes = shutters(15.0, camera)
    a, b = planes["shutter_a"][0, 0], planes["shutter_b"][0, 0]
    printed_m = C / 2 * (180e-9 - 180e-9 * a / (a + b))
    assert printed_m == pytest.approx(12.0)
    assert decode("mdsi3", planes, camera).range_m[0, 0] == pytest.approx(15.0, abs=1e-6)


def test_the_printed_mdsi2_fails_with_the_absolute_opening_of_window_b():
    """E-K-02: 37 m instead of 10 m."""
    planes = shutters(10.0, CAMERA)
    quotient, opens_b_s = planes["shutter_b"][0, 0] / planes["shutter_c"][0, 0], 180e-9
    printed_m = C / 2 * (180e-9 * quotient - (0.0 - opens_b_s))
    assert printed_m == pytest.approx(37.0)
    for name in ("mdsi2", "mdsi4"):
        assert decode(name, planes, CAMERA).range_m[0, 0] == pytest.approx(10.0, abs=1e-6)


def test_pulse_of_180_ns_measures_up_to_27_m():
    """N-K-020 and König 2008, eq 3.22; beyond, the quotient stays at its end and says nothing."""
    camera = replace(CAMERA, pixel=QUIET, far_margin_sigmas=0.0)
    image = decode("mdsi3", shutters([26.99, 27.01, 27.5, 60.0], camera), camera)
    np.testing.assert_array_equal(image.valid[0], [True, True, True, False])
    image = decode("mdsi3", shutters([26.9, 27.01, 27.5, 60.0], camera), replace(camera, far_margin_sigmas=2.0))
    assert list(image.why[0]) == [Why.VALID, Why.OUT_OF_RANGE, Why.OUT_OF_RANGE, Why.LOW_AMPLITUDE]


def test_windows_shorter_than_the_pulse_shorten_the_range():
    """E-K-15: window b ends the range at c/2 (T_Int,a - T_Pw + T_Int,b); window a cannot see the nearest pulses."""
    camera = replace(CAMERA, pixel=QUIET, shutter_b_width_s=100e-9, far_margin_sigmas=0.0)
    assert list(decode("mdsi2", shutters([14.9, 15.1, 16.0], camera), camera).valid[0]) == [True, False, False]
    assert list(decode("mdsi3", shutters([14.9, 15.1, 16.0], camera), camera).valid[0]) == [True, False, False]
    short = replace(CAMERA, pixel=QUIET, shutter_a_width_s=100e-9, laser_delay_s=-30e-9)
    image = decode("mdsi1", shutters([4.0, 5.0], short), short)
    assert image.range_m[0, 1] == pytest.approx(5.0, abs=1e-6)
    assert list(image.valid[0]) == [False, True]


@pytest.mark.parametrize("name", MDSI)
def test_damping_and_accumulation_leave_the_range_alone(name):
    """E-K-44, and the amplitude is that of one pulse."""
    camera = replace(CAMERA, pixel=Pixel(saturation_v=100.0))
    single = shutters(9.0, camera, 0.01)
    d = (1 - np.exp(-0.0153 * 64)) / ((1 - np.exp(-0.0153)) * 64)
    planes = {k: v * 64 * d for k, v in single.items()} | {"n_acc": np.full((1, 1), 64, np.uint8)}
    image = decode(name, planes, camera)
    assert image.range_m[0, 0] == pytest.approx(9.0, abs=2e-6)
    assert image.amplitude[0, 0] == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize("name", RANGING)
def test_offset_is_added_and_limits_are_kept(name):
    camera = camera_of(name)
    planes = planes_of(name, [1.0, 2.0, 3.0], camera)
    image = decode(name, planes, replace(camera, offset_m=0.5, min_range_m=2.0, max_range_m=3.0))
    np.testing.assert_allclose(image.range_m[0], [1.5, 2.5, 3.5], atol=1e-5)
    assert list(image.why[0]) == [Why.OUT_OF_RANGE, Why.VALID, Why.OUT_OF_RANGE]


@pytest.mark.parametrize("name", RANGING)
def test_speed_of_light_scales_the_range(name):
    camera = camera_of(name)
    planes = planes_of(name, 3.0, camera)
    got = decode(name, planes, replace(camera, speed_of_light_mps=2e8)).range_m[0, 0]
    assert got == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("name", RANGING)
def test_inputs_stay_and_their_number_type_does_not_matter(name):
    camera = camera_of(name)
    planes = {k: np.round(60 * v) for k, v in planes_of(name, [1.0, 2.0, 3.0], camera).items()}
    planes |= {"n_acc": np.full((1, 3), 4)}
    before = {k: v.copy() for k, v in planes.items()}
    wide = decode(
        name, planes, replace(camera, pixel=replace(QUIET, saturation_v=1e6), taps=Taps(saturation_counts=1e9))
    )
    for k, v in planes.items():
        np.testing.assert_array_equal(v, before[k])
    for kind in (np.float32, np.int32, np.uint16):
        image = decode(name, {k: v.astype(kind) for k, v in planes.items()}, camera)
        np.testing.assert_array_equal(image.range_m, wide.range_m)


# --- noise -------------------------------------------------------------------------------------------------------


def analytic(name, distance_m, n_acc=16, reflectivity=0.5):
    """sigma_m of a camera whose white target at 2 m gives 1.5 V, without damping, as N-K-065 has it."""
    camera = replace(CAMERA, pixel=QUIET)
    volts = n_acc * 1.5 * reflectivity * (2 / distance_m) ** 2
    return decode(name, shutters(distance_m, camera, volts, n_acc), camera).sigma_m[0, 0]


@pytest.mark.parametrize(
    ("name", "distance_m", "sigma_cm"),
    [
        ("mdsi1", 5, 2.864), ("mdsi1", 12, 14.632), ("mdsi1", 20, 36.705),
        ("mdsi3", 5, 1.856), ("mdsi3", 12, 9.100), ("mdsi3", 20, 27.884),
    ],
)  # fmt: skip
def test_sigma_is_that_of_the_propagation_of_uncertainties(name, distance_m, sigma_cm):
    """N-K-065 (König 2008, eqs 5.4 and 5.6)."""
    assert 100 * analytic(name, distance_m) == pytest.approx(sigma_cm, abs=6e-4)


@pytest.mark.parametrize(
    ("distance_m", "ratio_1", "ratio_2"),
    [
        (3, 1.494, 1.123), (5, 1.544, 1.217), (8, 1.601, 1.366), (10, 1.618, 1.460), (13.5, 1.581, 1.581),
        (16, 1.502, 1.616), (18, 1.414, 1.612), (20, 1.316, 1.586), (21, 1.266, 1.566),
    ],
)  # fmt: skip
def test_mdsi1_and_mdsi2_are_noisier_than_mdsi3_by_the_known_ratios(distance_m, ratio_1, ratio_2):
    """N-K-060."""
    best = analytic("mdsi3", distance_m)
    assert analytic("mdsi1", distance_m) / best == pytest.approx(ratio_1, abs=6e-4)
    assert analytic("mdsi2", distance_m) / best == pytest.approx(ratio_2, abs=6e-4)


@pytest.mark.parametrize("n_acc", [1, 4, 16, 64, 100])
def test_mdsi3_equals_mdsi4_and_is_the_best_at_every_range(n_acc):
    """N-K-061, N-K-062: the others reach 1.618 times its noise, the golden ratio, and never twice."""
    ranges = np.linspace(0.2, 26.5, 120)
    sigma = {name: np.array([analytic(name, r, n_acc) for r in ranges]) for name in MDSI}
    np.testing.assert_allclose(sigma["mdsi3"], sigma["mdsi4"], rtol=1e-5)
    for name in ("mdsi1", "mdsi2"):
        ratio = sigma[name] / sigma["mdsi3"]
        assert ratio.min() > 1
        assert ratio.max() == pytest.approx(1.618, abs=1e-3)


@pytest.mark.parametrize(("before_m", "after_m", "n", "sigma_cm"), [(2.65, 2.70, 1, (3.34, 1.30))])
def test_sigma_drops_when_the_accumulations_step_up(before_m, after_m, n, sigma_cm):
    """N-K-053: the sawtooth of König 2008, fig 4.19."""
    assert 100 * analytic("mdsi3", before_m, n) == pytest.approx(sigma_cm[0], abs=6e-3)
    assert 100 * analytic("mdsi3", after_m, 4 * n) == pytest.approx(sigma_cm[1], abs=6e-3)


@pytest.mark.parametrize("bits", [0, 12])
@pytest.mark.parametrize("name", MDSI)
@pytest.mark.parametrize(("range_m", "n_acc", "volts"), [(3.0, 1, 1.2), (12.0, 16, 0.6), (22.0, 100, 0.2)])
def test_sigma_is_the_spread_of_many_noisy_measurements(name, range_m, n_acc, volts, bits):
    """Closed form against Monte Carlo, 99 % confidence (K-CMP-06); damping, shot noise and ambient light are on."""
    pixel, count, ambient_vps = Pixel(adc_bits=bits), 8000, 1e5
    camera = replace(CAMERA, pixel=pixel)
    rng = np.random.default_rng(int(10 * range_m) + bits)
    clean = {k: v for k, v in shutters(range_m, camera, volts).items() if k != "n_acc"}
    planes = {"n_acc": np.full((1, count), n_acc, np.uint8), "ambient": np.full((1, count), ambient_vps)}
    for key, value in clean.items():
        ambient_v = ambient_vps * (360e-9 if key == "shutter_c" else 180e-9)
        sigma_v = np.sqrt(noise_variance(value, n_acc, ambient_v, pixel))
        planes[key] = convert(value + sigma_v * rng.standard_normal((1, count)), pixel)
    image = decode(name, planes, camera)
    truth = decode(name, clean | {"n_acc": planes["n_acc"][:, :1], "ambient": planes["ambient"][:, :1]}, camera)
    ratio2 = np.var(image.range_m) / truth.sigma_m[0, 0] ** 2
    low, high = chi2.ppf([0.0005, 0.9995], count - 1) / (count - 1)
    assert low < ratio2 < high
    assert np.median(image.sigma_m) == pytest.approx(truth.sigma_m[0, 0], rel=0.02)


@pytest.mark.parametrize("name", MDSI)
def test_averaging_four_images_halves_sigma(name):
    planes = shutters(9.0, CAMERA, 0.5)
    one, four = (decode(name, planes, replace(CAMERA, averages=n)).sigma_m[0, 0] for n in (1, 4))
    assert four == pytest.approx(one / 2, rel=1e-6)


@pytest.mark.parametrize("name", MDSI)
def test_ambient_light_and_every_part_of_the_noise_widen_sigma(name):
    planes = shutters(9.0, CAMERA, 0.5, 16)
    base = Pixel(photon_noise=False, adc_bits=0, sensor_noise_v=0.0, readout_noise_v=1e-5)
    least = decode(name, planes, replace(CAMERA, pixel=base)).sigma_m[0, 0]
    for more in ({"photon_noise": True}, {"adc_bits": 10}, {"sensor_noise_v": 1e-3}, {"readout_noise_v": 1e-3}):
        assert decode(name, planes, replace(CAMERA, pixel=replace(base, **more))).sigma_m[0, 0] > 1.5 * least
    bright = planes | {"ambient": np.full((1, 1), 1e6)}
    ratio = decode(name, bright, CAMERA).sigma_m[0, 0] / decode(name, planes, CAMERA).sigma_m[0, 0]
    assert ratio > 1.05


# --- reasons -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MDSI)
def test_each_invalid_shutter_pixel_says_why(name):
    planes = {k: np.repeat(v, 9, axis=1) for k, v in shutters(9.0, CAMERA, 1.0, 4).items()}
    planes = {k: v.astype(np.float32 if k != "n_acc" else np.int64) for k, v in planes.items()}
    planes["ambient"] = np.zeros((1, 9))
    names = [k for k in planes if k.startswith("shutter")]
    for k in names:
        planes[k][0, 1] = np.nan
        planes[k][0, 2] = 1.5
        planes[k][0, 3] *= 1e-4
        planes[k][0, 4] = -0.1
    planes["shutter_a"][0, 5], planes["shutter_b"][0, 5], planes["shutter_c"][0, 5] = 1.2, -0.4, 0.8
    planes["n_acc"][0, 6], planes["n_acc"][0, 7] = 0, 256
    planes["ambient"][0, 8] = np.inf
    image = decode(name, planes, CAMERA)
    expected = [
        Why.VALID, Why.NOT_FINITE, Why.SATURATED, Why.LOW_AMPLITUDE, Why.LOW_AMPLITUDE, Why.OUT_OF_RANGE,
        Why.NO_SIGNAL, Why.SENSOR_FLAG, Why.NOT_FINITE,
    ]  # fmt: skip
    assert list(image.why[0]) == expected
    assert np.isnan(image.range_m[0, [1, 4, 6, 7, 8]]).all()
    assert np.isfinite(image.sigma_m[0, [0, 2, 3, 5]]).all()


def test_each_invalid_tap_pixel_says_why():
    planes = {k: np.repeat(v, 6, axis=1) for k, v in taps(2.0, TAPS).items()}
    for k in planes:
        planes[k][0, 1] = np.nan
        planes[k][0, 2] = 0.0
        planes[k][0, 3] *= 1e-3
    planes["tap_2"][0, 4] = 4100.0
    planes["tap_3"][0, 5] = -300.0
    image = decode("three_tap", planes, TAPS)
    expected = [Why.VALID, Why.NOT_FINITE, Why.NO_SIGNAL, Why.LOW_AMPLITUDE, Why.SATURATED, Why.OUT_OF_RANGE]
    assert list(image.why[0]) == expected


@pytest.mark.parametrize("name", RANGING)
def test_thresholds_refuse_weak_signals(name):
    camera, planes = camera_of(name), planes_of(name, 2.0, camera_of(name))
    assert decode(name, planes, camera).valid.all()
    strict = [
        replace(camera, min_snr=1e4),
        replace(camera, pixel=replace(QUIET, noise_threshold_v=1.1), taps=Taps(noise_threshold_counts=1001.0)),
    ]
    for harder in strict:
        assert decode(name, planes, harder).why[0, 0] == Why.LOW_AMPLITUDE


@pytest.mark.parametrize("name", RANGING)
def test_a_missing_or_misshapen_plane_is_named(name):
    camera = camera_of(name)
    planes = planes_of(name, [1.0, 2.0], camera)
    missing = "tap_2" if name == "three_tap" else "n_acc"
    with pytest.raises(DataError, match=f"'{missing}' is missing; this method needs .*{missing}"):
        decode(name, {k: v for k, v in planes.items() if k != missing}, camera)
    with pytest.raises(DataError, match=rf"'{missing}' has shape \(2, 2\)"):
        decode(name, planes | {missing: np.zeros((2, 2))}, camera)
    with pytest.raises(DataError, match=f"'{missing}' holds <U1"):
        decode(name, planes | {missing: np.array([["a", "b"]])}, camera)


def test_a_dark_or_std_plane_alone_is_refused():
    planes = taps(2.0, TAPS)
    with pytest.raises(DataError, match="'dark_2' is missing"):
        decode("three_tap", planes | {"dark_1": planes["tap_1"]}, TAPS)


# --- three taps --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gate_width_s", [30e-9, 26e-9, 34e-9])
def test_three_taps_give_the_range_also_with_gates_unlike_the_pulse(gate_width_s):
    camera = replace(TAPS, gate_width_s=gate_width_s)
    farthest_m = C / 2 * min(gate_width_s, 2 * gate_width_s - 30e-9)
    range_m = np.linspace(max(0.0, C / 2 * (gate_width_s - 30e-9)) + 0.01, farthest_m - 0.3, 50)
    image = decode("three_tap", taps(range_m, camera), camera)
    np.testing.assert_allclose(image.range_m[0], range_m, atol=2e-6)
    assert image.valid.all()


def test_an_early_pulse_measures_near_objects_with_tap_1():
    camera = replace(TAPS, gate_width_s=26e-9, pulse_lead_s=8e-9)
    range_m = np.linspace(0.0, C / 2 * (8e-9 + 2 * 26e-9 - 30e-9) - 0.3, 80)
    image = decode("three_tap", taps(range_m, camera), camera)
    np.testing.assert_allclose(image.range_m[0], range_m, atol=2e-6)
    assert image.valid.all()


def test_an_early_pulse_with_gates_longer_than_itself_is_refused():
    with pytest.raises(UsageError, match=r"camera\.gate_width_s"):
        decode("three_tap", taps(2.0, TAPS), replace(TAPS, gate_width_s=31e-9, pulse_lead_s=8e-9))


def test_background_and_dark_image_leave_the_range_alone():
    planes = taps(2.0, TAPS)
    lit = {k: v + 400 for k, v in planes.items()}
    assert decode("three_tap", lit, TAPS).range_m[0, 0] == pytest.approx(2.0, abs=1e-5)
    dark = {f"dark_{i}": np.full((1, 1), 100.0 * i) for i in (1, 2, 3)}
    offset = {f"tap_{i}": planes[f"tap_{i}"] + 100 * i for i in (1, 2, 3)}
    assert decode("three_tap", offset | dark, TAPS).range_m[0, 0] == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize(("lead_s", "range_m"), [(0.0, 1.0), (0.0, 3.0), (8e-9, 0.5), (8e-9, 3.0)])
@pytest.mark.parametrize("planes", ["model", "dark", "std"])
def test_tap_sigma_is_the_spread_of_many_noisy_measurements(lead_s, range_m, planes):
    """Monte Carlo, 99 % confidence, with the noise model and with measured standard deviations."""
    camera = replace(TAPS, pulse_lead_s=lead_s, taps=Taps(dark_frames=2))
    count, rng, level = 8000, np.random.default_rng(5), 270.0
    frame = {}
    for i in (1, 2, 3):
        value = level + taps(range_m, camera, 800.0)[f"tap_{i}"][0, 0]
        sigma = 2.0 * i if planes == "std" else np.sqrt(3.05**2 + 0.025 * (value - level))
        frame[f"tap_{i}"] = value + sigma * rng.standard_normal((1, count))
        if planes == "std":
            frame[f"tap_std_{i}"] = np.full((1, count), sigma)
        frame[f"dark_{i}"] = level + (3.05 / np.sqrt(2) * rng.standard_normal((1, count)) if planes == "dark" else 0.0)
        frame[f"dark_{i}"] = np.broadcast_to(frame[f"dark_{i}"], (1, count))
    if planes != "dark":
        camera = replace(camera, taps=Taps(dark_frames=1_000_000))
    image = decode("three_tap", frame, camera)
    ratio2 = np.var(image.range_m) / np.median(image.sigma_m) ** 2
    low, high = chi2.ppf([0.0005, 0.9995], count - 1) / (count - 1)
    assert low * 0.97 < ratio2 < high * 1.03  # sigma reckons with the rounding of a count, these taps are not rounded


# --- a real recording --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording():
    path = Path(os.environ.get("RANGECAM_DATA", "")) / "pulsed_bec80t" / "clear_standard.npz"
    if not path.is_file():
        pytest.skip("RANGECAM_DATA does not name a folder with pulsed_bec80t/clear_standard.npz")
    return dict(np.load(path))


@pytest.mark.parametrize("with_std", [True, False])
def test_a_real_recording_gives_the_closed_form_and_its_own_spread(recording, with_std):
    """BEC80T: range within 1 mm, 95 % of the bright pixels valid, sigma within 0.7-1.4 of the measured spread."""
    n1, n2, n3 = (recording[f"tap_{i}"].astype(float) - recording[f"dark_{i}"] for i in (1, 2, 3))
    v1, v2, v3 = (recording[f"tap_std_{i}"].astype(float) ** 2 for i in (1, 2, 3))
    a, b, scale = n2 - n1, n3 - n1, 299792458.0 * float(recording["pulse_width_s"]) / 2
    with np.errstate(all="ignore"):
        want = scale * b / (a + b)
        spread = scale / (a + b) ** 2 * np.sqrt(b**2 * v2 + a**2 * v3 + (a - b) ** 2 * v1)
    bright = (a + b > 60) & (want > 0.05) & (want < scale - 0.05)
    wanted = ("tap_", "dark_") if with_std else ("tap_1", "tap_2", "tap_3", "dark_")
    planes = {k: v for k, v in recording.items() if k.startswith(wanted)}
    image = decode("three_tap", planes, PulsedCamera(pulse_width_s=float(recording["pulse_width_s"])))
    used = bright & image.valid
    assert used.sum() >= 0.95 * bright.sum()
    assert np.mean(np.abs(image.range_m - want)[used] < 1e-3) >= 0.99
    assert 0.7 < np.median(image.sigma_m[used] / spread[used]) < 1.4
    full = (recording["tap_3"] >= 4000) & np.isfinite(image.range_m)
    assert (image.why[full] == Why.SATURATED).all()
