"""Claims about what a pulsed camera can do at best."""

from dataclasses import replace

import numpy as np
import pytest

from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import (
    dynamic_range_photodiode_db,
    dynamic_range_system_db,
    expected_sigma_m,
    nee_sensor_jpm2,
    nee_system_jpm2,
    required_input_range_db,
    required_snr,
    targets_on_axis,
)
from rangecam.pulsed.pixel import dark_noise, responsivity
from rangecam.pulsed.ranging import RANGING
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.studies.thesis_camera import thesis_camera

CAMERA = PulsedCamera()
END_M = 27.0  # of the measurement range, with the light speed of the thesis


def whole_v(range_m, reflectivity):
    """Return the whole signal of one pulse of the thesis' camera, V: 1.5 V at 2 m on white."""
    return 1.5 * reflectivity * (2.0 / np.asarray(range_m)) ** 2


def test_the_noise_equivalent_exposures_follow_from_noise_and_responsivity():
    assert nee_sensor_jpm2(CAMERA.pixel) * 1e9 == pytest.approx(144.8, abs=0.05)  # N-K-031
    one, most = nee_system_jpm2([1, 100], CAMERA.pixel) * 1e9
    assert one == pytest.approx(222.48, abs=0.05)  # N-K-032
    assert most == pytest.approx(1458, abs=0.5)  # N-K-039
    assert abs(one - 225) > 0.5  # as printed (E-K-08)


def test_the_dynamic_ranges_are_those_of_the_thesis():
    assert dynamic_range_photodiode_db(CAMERA.pixel) == pytest.approx(71.95, abs=0.005)  # N-K-033
    found = [dynamic_range_system_db(replace(CAMERA, averages=n)) for n in (1, 3, 4)]
    np.testing.assert_allclose(found, [91.89, 96.66, 97.91], atol=0.005)  # N-K-034, 035


def test_the_dynamic_range_with_the_noise_of_one_accumulation_would_be_too_large():
    full_jpm2 = CAMERA.pixel.saturation_v / responsivity(CAMERA.pixel)
    printed_db = 20 * np.log10(full_jpm2 / (nee_system_jpm2(1, CAMERA.pixel) / 100))
    assert printed_db == pytest.approx(108.2, abs=0.05)  # eq 4.36 with 4.31 (E-K-07)
    assert printed_db - dynamic_range_system_db(CAMERA) > 16


def test_the_needed_input_range_is_larger_at_20_m_than_at_the_end_of_the_measurement_range():
    spans = {"range_m": (2.0, 20.0), "reflectivity": (0.05, 1.0)}
    at_end, at_20 = required_snr(0.03), required_snr(0.03, 20 / END_M)
    assert at_end == pytest.approx(33.33, abs=0.005)  # N-K-036
    assert at_20 == pytest.approx(35.32, abs=0.005)  # N-K-038
    assert required_input_range_db(**spans, snr=at_end) == pytest.approx(96.48, abs=0.005)  # N-K-037
    needed_db = required_input_range_db(**spans, snr=at_20)
    assert needed_db == pytest.approx(96.98, abs=0.005)
    assert dynamic_range_system_db(replace(CAMERA, averages=3)) < needed_db  # the print says enough (E-K-09)
    assert dynamic_range_system_db(replace(CAMERA, averages=4)) > needed_db


@pytest.mark.parametrize("range_m", [2.0, 9.0, 20.0])
def test_a_camera_with_the_required_snr_reaches_the_accuracy(range_m):
    camera = thesis_camera()
    sigma_m, n_acc = expected_sigma_m([range_m], 0.05, camera)
    snr = n_acc[0] * whole_v(range_m, 0.05) / dark_noise(n_acc[0], camera.pixel)
    assert required_snr(sigma_m[0] / range_m, range_m / END_M) == pytest.approx(snr, rel=1e-4)


@pytest.mark.parametrize("method", ["mdsi1", "mdsi2", "mdsi3", "mdsi4"])
def test_the_expected_sigma_is_the_closed_form_of_the_method(method):
    range_m = np.linspace(3, 24, 30)
    camera = thesis_camera("abc")
    camera = replace(camera, pixel=replace(camera.pixel, accumulations=(4,), saturation_v=50.0))
    sigma_m, n_acc = expected_sigma_m(range_m, 0.5, camera, method)
    assert (n_acc == 4).all()
    u_c, sigma_v = 4 * whole_v(range_m, 0.5), dark_noise(4, camera.pixel)
    u_b = u_c * range_m / END_M
    u_a = u_c - u_b
    closed = {
        "mdsi1": np.sqrt(1 + (u_a / u_c) ** 2) / u_c,  # eq 5.4
        "mdsi2": np.sqrt(1 + (u_b / u_c) ** 2) / u_c,  # eq 5.5
        "mdsi3": np.hypot(u_a, u_b) / (u_a + u_b) ** 2,  # eq 5.6
        "mdsi4": np.hypot(u_a, u_b) / (u_a + u_b) ** 2,  # eq 5.7
    }
    np.testing.assert_allclose(sigma_m, END_M * sigma_v * closed[method], rtol=2e-5)


@pytest.mark.parametrize("averages", [1, 4])
def test_simulated_images_scatter_as_expected(averages):
    range_m, repeats = np.array([2.0, 6.0, 14.0]), 4000
    camera = replace(CAMERA, averages=averages)
    sigma_m, n_acc = expected_sigma_m(range_m, 0.3, camera)
    many, view = targets_on_axis(range_m, 0.3, camera, repeats)
    raw = simulate(lambda _: view, many, 0.0, np.random.default_rng(5))
    image = RANGING["mdsi3"](raw, many)
    assert image.valid.all()
    assert (raw.planes["n_acc"] == n_acc).all()
    # Four standard errors, and 1 % for the curvature of the quotient.
    np.testing.assert_allclose(image.range_m.std(axis=0), sigma_m, rtol=4 / np.sqrt(2 * repeats) + 0.01)


def test_the_accuracy_is_a_sawtooth_that_drops_with_each_step_of_the_accumulations():
    camera = thesis_camera()
    camera = replace(camera, pixel=replace(camera.pixel, accumulations=(1, 4, 16, 64)))
    range_m = np.arange(40, 421) / 20
    sigma_m, n_acc = expected_sigma_m(range_m, 0.5, camera)
    before = np.flatnonzero(np.diff(n_acc.astype(int)))
    np.testing.assert_allclose(range_m[before + 1], [2.70, 5.10, 9.20])  # N-K-053
    np.testing.assert_allclose(sigma_m[before] * 100, [3.34, 4.20, 5.52], atol=0.006)
    np.testing.assert_allclose(sigma_m[before + 1] * 100, [1.30, 1.92, 2.71], atol=0.006)


def test_targets_on_the_axis_are_lit_alike_in_every_column_and_leave_the_camera_as_fast_as_it_can_be():
    camera, view = targets_on_axis(np.full(40, 5.0), 0.7, replace(CAMERA, averages=4), rows=3)
    assert (camera.rows, camera.columns) == (3, 40)
    assert camera.frame_rate_hz == pytest.approx(12.5)  # N-K-049.100.4.10
    quiet = Pixel(sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0)
    raw = simulate(lambda _: view, replace(camera, pixel=quiet), 0.0, np.random.default_rng(0))
    assert np.ptp(raw.planes["shutter_a"]) < 1e-6 * raw.planes["shutter_a"].max()
