"""Cameras that compute the range themselves."""

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from rangecam.config import load_config
from rangecam.errors import DataError
from rangecam.geometry import Lens, rays
from rangecam.processed import RANGING, ProcessedCamera, noise_model, processed, simulate
from rangecam.scene.view import View
from rangecam.types import RawFrame, Why

LENS = Lens(horizontal_fov_deg=60)
FLIGHTS = Path(os.environ.get("RANGECAM_DATA", "")) / "vl53l5cx_flights"


def frame(**planes):
    return RawFrame(1.5, {name: np.atleast_2d(plane) for name, plane in planes.items()})


def why(camera, **planes):
    return [Why(code).name for code in processed(frame(**planes), camera).why.ravel()]


def plane_view(depth_m, camera, samples=1, reflectivity=0.5):
    ray = rays(camera.lens, (camera.rows, camera.columns))
    range_m = np.repeat((depth_m / ray[..., 0])[None], samples, axis=0)
    return View(range_m, np.full_like(range_m, reflectivity), np.repeat(ray[None, ..., 0], samples, axis=0))


def test_radial_range_is_taken_as_it_is_and_depth_follows_the_ray():
    values = np.full((6, 8), 2.0)
    axis = rays(LENS, (6, 8))[..., 0]
    for name, measures, expected in (
        ("range_m", "as_named", values),
        ("depth_m", "as_named", values / axis),
        ("range_m", "depth", values / axis),
        ("depth_m", "range", values),
    ):
        image = processed(frame(**{name: values}), ProcessedCamera(lens=LENS, measures=measures))
        assert_allclose(image.range_m, expected, rtol=1e-6)
        assert image.valid.all()
        assert image.time_s == 1.5


def test_range_wins_over_depth_where_both_are_there():
    image = processed(frame(range_m=[2.0], depth_m=[7.0]), ProcessedCamera())
    assert image.range_m[0, 0] == 2


def test_frame_without_range_is_an_error_that_names_what_is_there():
    with pytest.raises(DataError, match="amplitude; needed is range_m or depth_m"):
        processed(frame(amplitude=[1.0]), ProcessedCamera())


def test_zero_is_no_signal_and_nan_is_not_finite():
    image = processed(frame(range_m=[0.0, np.nan, np.inf, 1.0]), ProcessedCamera())
    assert_array_equal(image.why, [[Why.NO_SIGNAL, Why.NOT_FINITE, Why.NOT_FINITE, Why.VALID]])
    assert np.isnan(image.range_m[0, :3]).all()


def test_range_limits_keep_the_estimate():
    camera = ProcessedCamera(min_range_m=0.5, max_range_m=4.0)
    image = processed(frame(range_m=[0.4, 0.5, 4.0, 4.1]), camera)
    assert_array_equal(image.why, [[Why.OUT_OF_RANGE, 0, 0, Why.OUT_OF_RANGE]])
    assert_allclose(image.range_m[0], [0.4, 0.5, 4.0, 4.1], rtol=1e-6)


def test_status_and_targets_count_only_where_the_camera_knows_them():
    planes = {"range_m": np.ones(4), "status": np.array([5, 9, 6, 5]), "targets": np.array([1, 1, 1, 2])}
    assert why(ProcessedCamera(), **planes) == ["VALID"] * 4
    assert why(ProcessedCamera(valid_status=(5, 9)), **planes) == ["VALID", "VALID", "SENSOR_FLAG", "VALID"]
    both = ProcessedCamera(valid_status=(5, 9), valid_targets=1)
    assert why(both, **planes) == ["VALID", "VALID", "SENSOR_FLAG", "SENSOR_FLAG"]
    assert why(both, range_m=np.ones(2)) == ["VALID", "VALID"]


def test_confidence_may_be_good_when_large_or_small_or_without_a_bit():
    planes = {"range_m": np.ones(3), "confidence": np.array([0, 7, 17], np.uint8)}
    assert why(ProcessedCamera(min_confidence=7), **planes) == ["SENSOR_FLAG", "VALID", "VALID"]
    assert why(ProcessedCamera(max_confidence=7), **planes) == ["VALID", "VALID", "SENSOR_FLAG"]
    assert why(ProcessedCamera(invalid_confidence_bits=16), **planes) == ["VALID", "VALID", "SENSOR_FLAG"]
    assert why(ProcessedCamera(), **planes) == ["VALID"] * 3


def test_noise_that_the_camera_reports_is_sigma_and_must_be_positive():
    planes = {"range_m": np.ones(4), "noise_m": np.array([0.02, 0.0, np.nan, -1.0])}
    image = processed(frame(**planes), ProcessedCamera())
    assert_array_equal(image.why, [[0, Why.SENSOR_FLAG, Why.SENSOR_FLAG, Why.SENSOR_FLAG]])
    assert image.sigma_m[0, 0] == np.float32(0.02)


def test_noise_of_depth_grows_along_the_ray():
    camera = ProcessedCamera(lens=LENS)
    image = processed(frame(depth_m=np.full((3, 4), 2.0), noise_m=np.full((3, 4), 0.02)), camera)
    assert_allclose(image.sigma_m / image.range_m, 0.01, rtol=1e-6)


def test_noise_model_has_a_floor_a_relative_part_and_one_that_light_makes_smaller():
    camera = ProcessedCamera(noise_floor_m=0.03, noise_relative=0.02, noise_amplitude_m=0.6)
    sigma = noise_model(np.array([2.0, 2.0, 0.0]), np.array([5.0, np.inf, np.inf]), camera)
    assert_allclose(sigma, [0.13, 0.05, 0.03], rtol=0.01, atol=1e-12)
    assert noise_model(np.ones(1), np.zeros(1), camera)[0] == np.inf


def test_pixel_without_light_has_no_finite_sigma_and_is_refused():
    camera = ProcessedCamera(noise_amplitude_m=0.6)
    assert why(camera, range_m=[1.0, 1.0], amplitude=[0.0, 9.0]) == ["SENSOR_FLAG", "VALID"]


def test_weak_pixels_are_refused_and_unknown_amplitude_is_not_weak():
    camera = ProcessedCamera(min_amplitude=3.0)
    image = processed(frame(range_m=[1.0, 1.0], amplitude=[2.0, 3.0]), camera)
    assert_array_equal(image.why, [[Why.LOW_AMPLITUDE, 0]])
    unknown = processed(frame(range_m=[1.0]), camera)
    assert unknown.valid.all()
    assert np.isnan(unknown.amplitude).all()


def test_inputs_are_not_changed():
    values = np.array([[0.0, np.nan, 2.0]])
    processed(frame(range_m=values, amplitude=values), ProcessedCamera(measures="depth"))
    assert_array_equal(values, [[0.0, np.nan, 2.0]])


@pytest.mark.parametrize("name", RANGING)
@pytest.mark.parametrize(
    "preset", ["generic_range", "vl53l5cx", "terabee_overhead", "adtf3175", "azure_kinect", "ifm_o3r"]
)
def test_simulated_ranges_scatter_about_the_truth_as_sigma_says(name, preset):
    camera = load_config(preset).camera
    view, errors = plane_view(1.7, camera), []
    for seed in range(max(1, 20_000 // (camera.rows * camera.columns))):
        image = RANGING[name](simulate(view, camera, 2.5, np.random.default_rng(seed)), camera)
        valid = image.valid
        assert image.time_s == 2.5
        assert valid.mean() > 0.99
        errors.append(((image.range_m - view.range_m[0]) / image.sigma_m)[valid])
    z = np.concatenate(errors)
    four_sigma = 4 / np.sqrt(len(z))
    assert abs(z.mean()) < four_sigma + 0.02  # sigma follows the measured range: a second-order bias
    assert z.std() == pytest.approx(1, abs=four_sigma + 0.01)
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.6827, abs=0.03)
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.03)


def test_simulated_pixel_that_sees_nothing_has_no_target():
    camera = ProcessedCamera(rows=1, columns=2, valid_status=(5, 9), valid_targets=1)
    view = View(np.array([[[np.inf, 2.0]]]), np.array([[[0.0, 0.5]]]), np.ones((1, 1, 2)))
    raw = simulate(view, camera, 0.0, np.random.default_rng(0))
    assert_array_equal(raw.planes["status"], [[255, 5]])
    assert_array_equal(raw.planes["targets"], [[0, 1]])
    assert_array_equal(processed(raw, camera).why, [[Why.NO_SIGNAL, 0]])


def test_simulated_edge_pixel_reads_between_the_surfaces_or_the_nearest():
    view = View(np.array([[[1.0]], [[2.0]]]), np.full((2, 1, 1), 0.5), np.ones((2, 1, 1)))
    quiet = {"rows": 1, "columns": 1, "noise_floor_m": 1e-9, "noise_relative": 0.0}
    rng = np.random.default_rng(0)
    mean = simulate(view, ProcessedCamera(**quiet), 0.0, rng).planes["range_m"]
    assert_allclose(mean, (1 * 4 + 2 * 1) / 5)  # light falls with the square of the range
    nearest = simulate(view, ProcessedCamera(**quiet, mixing="nearest"), 0.0, rng).planes["range_m"]
    assert_allclose(nearest, 1.0)


def test_simulated_amplitude_falls_with_the_square_of_the_range():
    camera = ProcessedCamera(rows=2, columns=2, lens=Lens(horizontal_fov_deg=1e-3), amplitude_at_1m=400.0)
    raw = simulate(plane_view(2.0, camera), camera, 0.0, np.random.default_rng(0))
    assert_allclose(raw.planes["amplitude"], 400 * 0.5 / 4, rtol=1e-6)


def test_simulation_repeats_with_its_seed():
    camera = ProcessedCamera(rows=4, columns=4)
    one, same = (simulate(plane_view(2.0, camera), camera, 0.0, np.random.default_rng(3)) for _ in range(2))
    assert_array_equal(one.planes["range_m"], same.planes["range_m"])


@pytest.mark.skipif(not FLIGHTS.is_dir(), reason="RANGECAM_DATA does not name a folder with vl53l5cx_flights")
def test_wall_in_flight_scatters_as_the_vl53l5cx_preset_says():
    """Residuals of the middle rows from a plane, at 0.7-2.4 m, pooled: the spread over sigma is near 1."""
    camera, spread = load_config("vl53l5cx").camera, []
    axis = rays(camera.lens, (8, 8))[1:6, :, 0]
    column, row = np.meshgrid(np.arange(8.0), np.arange(5.0))
    for name in ("A0", "A2", "A4"):
        flight = np.load(FLIGHTS / f"{name}.npz")
        for range_mm, status, targets in zip(flight["range_mm"], flight["status"], flight["targets"], strict=True):
            raw = RawFrame(0.0, {"range_m": range_mm / 1000, "status": status, "targets": targets})
            image = processed(raw, camera)
            valid, depth, sigma = image.valid[1:6], image.range_m[1:6] * axis, image.sigma_m[1:6] * axis
            middle = np.median(depth[valid]) if valid.sum() > 15 else np.nan
            wall = valid & (np.abs(depth / middle - 1) < 0.1)
            if wall.sum() > 15 and 0.7 < middle < 2.4:
                design = np.stack([np.ones_like(row), row, column], -1)[wall]
                fit = np.linalg.lstsq(design, depth[wall], rcond=None)[0]
                spread.append(1.4826 * np.median(np.abs(depth[wall] - design @ fit) / sigma[wall]))
    assert len(spread) > 100
    assert 0.7 < np.median(spread) < 1.4
