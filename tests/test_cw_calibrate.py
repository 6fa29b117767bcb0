"""Claims about the calibration of continuous-wave cameras: what it corrects, how well, and what it refuses."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rangecam.calibration import Calibration, Recording, attach, load_calibration, save_calibration
from rangecam.cli import main
from rangecam.config import load_config
from rangecam.cw import CALIBRATE, RANGING, simulate
from rangecam.cw.calibrate import fitted_plane_m
from rangecam.cw.effects import FixedPattern, Temperature, Waveform
from rangecam.cw.imperfections import IMPERFECTIONS
from rangecam.cw.pixel import fixed_pattern, temperature_c
from rangecam.cw.wiggling import harmonic_basis, straightened, table_basis, unambiguous_m, wiggling
from rangecam.cw.wiggling_fit import errors_of, fit_wiggling, mean_offset_m, mean_range
from rangecam.errors import DataError, UsageError
from rangecam.geometry import rays
from rangecam.io import Recorder, open_source
from rangecam.pipeline import run
from rangecam.scene.view import View
from rangecam.types import Capture, RangeImage, RawFrame, Why

FOLDER = Path(os.environ.get("RANGECAM_DATA", "")) / "cw_mlx75027"
recorded = pytest.mark.skipif(
    not (FOLDER / "tools_scene.npz").is_file(), reason="RANGECAM_DATA does not name a folder with cw_mlx75027"
)
SQUARE = Waveform(illumination="square", reference="square", bandwidth_hz=68e6)
PRESET = load_config("scaled_car").camera
CAMERA = replace(PRESET, rows=24, columns=32, pseudo_rows=0, read_noise_lsb=0.5, shot_noise_lsb2_per_lsb=0.01)
PATTERN = FixedPattern(seed=3, global_offset_m=0.1, range_sigma_m=0.02)
WALLS_M = np.geomspace(0.15, 9.0, 40)


def wall(depth_m, camera):
    """A wall across the axis, grey enough for the same amplitude at every distance."""
    along = rays(camera.lens, (camera.rows, camera.columns))[..., 0]
    range_m = (depth_m / along)[None].astype(np.float32)
    return View(range_m, np.full_like(range_m, 0.8 * depth_m**2), along[None].astype(np.float32))


def recording(depth_m, camera, count=1, seed=0, known=None, method="cw_four_phase"):
    view, rng = wall(depth_m, camera), np.random.default_rng([seed, round(depth_m * 1e4)])
    frames = [simulate(lambda _: view, camera, 0.1 * k, rng) for k in range(count)]
    return Recording(f"wall-{depth_m:g}", frames, camera, method, RANGING[method], known)


def walls(camera, count=4, method="cw_four_phase", depths_m=WALLS_M):
    return [recording(d, camera, count, known=float(d), method=method) for d in depths_m]


def with_settings(camera, calibration):
    return replace(camera, **{name: _tuples(value) for name, value in calibration.settings.items()})


def _tuples(value):
    return tuple(_tuples(each) for each in value) if isinstance(value, list) else value


def systematic_mm(camera, calibration, depth_m, method="cw_four_phase"):
    """The error (H, W) that is left without noise, mm; the calibration had noise and other walls."""
    quiet = camera
    for name in ("shot_noise", "read_noise", "quantisation", "converter_limits"):
        quiet = IMPERFECTIONS[name](quiet)
    (raw,) = recording(depth_m, quiet).frames
    seen = replace(with_settings(camera, calibration), lower_limit_lsb=None, full_scale_lsb=None)
    image = RANGING[method](attach(raw, calibration), seen)
    period_m = 1e3 * unambiguous_m(camera)
    return (1e3 * (image.range_m - wall(depth_m, camera).range_m[0]) + period_m / 2) % period_m - period_m / 2


# --- wiggling ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wiggly():
    return replace(CAMERA, waveform=SQUARE)


@pytest.fixture(scope="module")
def wiggly_walls(wiggly):
    return walls(wiggly)


def test_a_table_leaves_less_than_two_millimetres_of_wiggling_at_walls_it_was_not_made_of(wiggly, wiggly_walls):
    calibration = CALIBRATE["wiggling"](wiggly_walls, Calibration({}))
    for depth_m in (0.5, 1.23, 2.9, 4.44, 7.77):
        assert np.abs(systematic_mm(wiggly, Calibration({}), depth_m)).max() > 20
        assert np.abs(systematic_mm(wiggly, calibration, depth_m)).max() < 2


@pytest.mark.parametrize(("size", "left_mm"), [(4, 40.0), (8, 15.0), (20, 5.0)])
def test_more_harmonics_leave_less(wiggly, wiggly_walls, size, left_mm):
    calibration = CALIBRATE["wiggling"](wiggly_walls, Calibration({}), model="harmonics", size=size)
    left = [np.abs(systematic_mm(wiggly, calibration, depth_m)).max() for depth_m in (0.5, 1.23, 2.9, 4.44, 7.77)]
    assert max(left) < left_mm


def test_the_default_of_the_harmonics_holds_the_fourth_of_square_signals(wiggly, wiggly_walls):
    calibration = CALIBRATE["wiggling"](wiggly_walls, Calibration({}), model="harmonics")
    sizes = np.hypot(*np.array(calibration.settings["wiggling_harmonics_m"][0]).T)
    assert len(sizes) == 4
    assert sizes[3] > 10 * sizes[:3].max()
    assert calibration.settings["wiggling_table_m"] == []


def test_harmonics_that_were_put_in_are_found_again():
    rng = np.random.default_rng(1)
    true_m = rng.uniform(0.0, 8.8, (30, 40, 50))
    values = np.array([[5e-3, -3e-3], [0.0, 0.0], [1e-3, 2e-3], [60e-3, 20e-3]])
    period_m = unambiguous_m(CAMERA)
    measured_m = true_m.copy()
    for _ in range(50):  # the error is a function of the measured phase
        error = harmonic_basis(np.mod(measured_m / period_m, 1.0).ravel(), 4) @ values.ravel()
        measured_m = true_m + error.reshape(true_m.shape)
    own_m = rng.normal(0, 0.01, (40, 50))
    noisy = measured_m + own_m + 0.3 + rng.normal(0, 1e-3, true_m.shape)
    # what is the same for all pixels moves the phase at which the error is looked up
    turned = np.exp(1j * np.arange(1, 5) * 2 * np.pi * 0.3 / period_m) * (values[:, 0] + 1j * values[:, 1])
    expected = np.stack([turned.real, turned.imag], axis=1)
    errors = [errors_of(m, np.full(m.shape, 1e6), t, period_m) for m, t in zip(noisy, true_m, strict=True)]
    fit = fit_wiggling(errors, period_m, "harmonics", 4)
    np.testing.assert_allclose(fit.values, expected, atol=2e-3)
    assert fit.offset_m == pytest.approx(0.3, abs=1e-3)
    assert fit.before_m > 0.04
    assert fit.after_m < 2e-3


def test_the_spline_of_a_table_goes_through_its_values_and_is_periodic():
    values = np.random.default_rng(2).normal(size=16)
    at_nodes = table_basis(np.arange(16) / 16, 16) @ values
    np.testing.assert_allclose(at_nodes, values, atol=1e-12)
    around = table_basis(np.array([-1e-9, 1 - 1e-9, 1e-9]), 16) @ values
    np.testing.assert_allclose(around, values[0], atol=1e-6)


def test_sigma_goes_with_the_slope_of_the_correction_and_coverage_stays(wiggly, wiggly_walls):
    calibration = CALIBRATE["wiggling"](wiggly_walls, Calibration({}))
    camera = with_settings(wiggly, calibration)
    # where the table is steepest the noise changes most
    table = wiggling(camera)[0][:-1]
    slopes = 1 - np.diff(table) * 1024 / unambiguous_m(camera)
    assert slopes.min() < 0.85
    assert slopes.max() > 1.15
    for turn in (np.argmin(slopes), np.argmax(slopes)):
        ratios = {name: _spread_over_sigma(turn / 1024 * unambiguous_m(camera), wiggly, seen)
                  for name, seen in (("corrected", camera), ("bare", wiggly))}  # fmt: skip
        # square signals alone move the noise model by some per cent: their samples have another amplitude
        assert ratios["corrected"] == pytest.approx(ratios["bare"], abs=0.02)
        assert ratios["corrected"] == pytest.approx(1.0, abs=0.08)


def _spread_over_sigma(range_m, camera, seen):
    ones = np.ones((1, camera.rows, camera.columns), np.float32)
    view, rng = View(ones * np.float32(range_m), ones * np.float32(range_m**2), ones), np.random.default_rng(4)
    images = [RANGING["cw_four_phase"](simulate(lambda _: view, camera, 0.0, rng), seen) for _ in range(60)]
    return np.median(np.std([image.range_m for image in images], axis=0) / images[0].sigma_m)


@pytest.mark.parametrize("method", ["cw_four_phase", "cw_phases", "cw_emulation"])
def test_every_method_of_one_frequency_is_straightened_and_offset_follows(method, wiggly, wiggly_walls):
    calibration = CALIBRATE["wiggling"](wiggly_walls, Calibration({}))
    seen = with_settings(wiggly, calibration)
    shifted = replace(seen, offset_m=seen.offset_m + 0.5)
    (raw,) = recording(2.0, wiggly).frames
    image, moved = RANGING[method](raw, seen), RANGING[method](raw, shifted)
    good = image.valid & moved.valid
    assert np.median((moved.range_m - image.range_m)[good]) == pytest.approx(0.5, abs=2e-3)
    assert abs(np.median((image.range_m - wall(2.0, wiggly).range_m[0])[good])) < 8e-3


def test_several_frequencies_are_straightened_before_they_are_unwrapped():
    camera = replace(CAMERA, modulations_hz=(60e6, 80e6), frame_rate_hz=5.0, unwrap_phase_error_rad=0.0)
    camera = replace(camera, waveform=replace(SQUARE, bandwidth_hz=None), unwrap_residual_sigmas=4.0)
    targets = walls(camera, 3, "cw_multi_frequency", np.linspace(0.3, 6.0, 40))
    calibration = CALIBRATE["wiggling"](targets, Calibration({}))
    assert np.shape(calibration.settings["wiggling_table_m"]) == (2, 64)
    seen = with_settings(camera, calibration)
    view = wall(2.345, camera)
    frames = [simulate(lambda _: view, camera, 0.0, np.random.default_rng(i)) for i in range(40)]
    before = [RANGING["cw_multi_frequency"](raw, camera) for raw in frames]
    after = [RANGING["cw_multi_frequency"](raw, seen) for raw in frames]
    valid = [np.mean([image.valid for image in images]) for images in (before, after)]
    assert valid[0] < 0.5 < 0.9 < valid[1]  # the phases of square signals contradict each other
    stack = np.stack([np.where(image.valid, image.range_m, np.nan) for image in after])
    good = np.isfinite(stack).all(axis=0)
    assert np.abs(stack.mean(axis=0) - view.range_m[0])[good].max() < 6e-3
    sigma = np.mean([image.sigma_m for image in after], axis=0)
    assert np.median((stack.std(axis=0) / sigma)[good]) == pytest.approx(1.0, abs=0.1)


def test_tables_hold_the_different_offsets_of_frequencies_and_harmonics_refuse_them():
    camera = replace(CAMERA, modulations_hz=(60e6, 80e6), frame_rate_hz=5.0)
    delayed = []
    for each in walls(camera, 2, "cw_multi_frequency", np.linspace(0.3, 4.0, 30)):
        other = walls(replace(camera, offset_m=-0.05), 2, "cw_multi_frequency", [each.known])[0]
        frames = [
            replace(a, planes={k: (b if k.startswith("f1") else a).planes[k] for k in a.planes})
            for a, b in zip(each.frames, other.frames, strict=True)
        ]
        delayed.append(replace(each, frames=frames))
    calibration = CALIBRATE["wiggling"](delayed, Calibration({}), size=16)
    first, second = np.array(calibration.settings["wiggling_table_m"])
    assert np.abs(first).max() < 1e-3
    np.testing.assert_allclose(second, 0.05, atol=1e-3)
    seen = with_settings(camera, calibration)
    image = RANGING["cw_multi_frequency"](delayed[3].frames[0], seen)
    assert image.valid.mean() > 0.99
    assert np.abs(np.median(image.range_m - wall(delayed[3].known, camera).range_m[0])) < 1e-3
    with pytest.raises(DataError, match="offset of frequency 1 differs from that of the first by 50"):
        CALIBRATE["wiggling"](delayed, Calibration({}), model="harmonics")


def test_samples_at_the_limits_of_the_converter_stay_as_they_are():
    camera = replace(CAMERA, modulations_hz=(60e6, 80e6), wiggling_table_m=((0.02,) * 4, (0.03, 0.0, 0.01, 0.0)))
    high = RawFrame(0.0, {f"f{k}_phase_{s}": np.full((2, 3), v, np.uint16)
                          for k in (0, 1) for s, v in ((0, 4095), (90, 2048), (180, 0), (270, 2000))})  # fmt: skip
    assert (RANGING["cw_multi_frequency"](high, camera).why == Why.SATURATED).all()
    near = replace(high, planes={k: np.clip(v, 1, 4094) for k, v in high.planes.items()})
    assert not (RANGING["cw_multi_frequency"](near, camera).why == Why.SATURATED).any()
    with pytest.raises(DataError, match="f1_phase_270' is missing"):
        RANGING["cw_multi_frequency"](replace(high, planes=dict(list(high.planes.items())[:-1])), camera)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"wiggling_table_m": ((0.0,) * 8,), "wiggling_harmonics_m": (((0.1, 0.0),),)}, "set one of them"),
        ({"wiggling_table_m": ((0.0,) * 8,) * 2}, "has 2 rows; the camera has 1 modulation frequencies"),
        ({"wiggling_table_m": ((0.0, 0.1),)}, "a wiggling table of 2 values; it needs 4 or more"),
        ({"wiggling_harmonics_m": (((0.0, 1.5),),)}, r"wiggling_harmonics_m: row 0 grows by 1\.\d+ m in a metre"),
    ],
)
def test_wiggling_that_cannot_be_is_refused(settings, message):
    (raw,) = recording(1.0, CAMERA).frames
    with pytest.raises(UsageError, match=message):
        RANGING["cw_four_phase"](raw, replace(CAMERA, **settings))


def test_a_gap_says_which_distances_are_missing(wiggly, wiggly_walls):
    without = [each for each in wiggly_walls if not 2.2 < each.known < 4.6]
    with pytest.raises(DataError, match=r"has a gap: no target at .* and 3\.\d+ to 4\.\d+ m \(modulo 8\.82 m\); rec"):
        CALIBRATE["wiggling"](without, Calibration({}))
    with pytest.raises(DataError, match="fewer harmonics than 20"):
        CALIBRATE["wiggling"](without, Calibration({}), model="harmonics", size=20)
    partly = CALIBRATE["wiggling"](without, Calibration({}), partial=True)
    assert partly.taken["wiggling"]["unseen_m"]
    assert np.abs(systematic_mm(wiggly, partly, 1.23)).max() < 3
    assert np.abs(np.array(partly.settings["wiggling_table_m"])).max() < 0.2


def test_many_gaps_are_not_all_listed(wiggly):
    with pytest.raises(DataError, match="and more"):
        CALIBRATE["wiggling"](walls(wiggly, 1, depths_m=np.arange(0.3, 8.0, 0.9)), Calibration({}), size=256)


def test_a_gap_around_zero_is_one_gap():
    period_m, turns = 2.0, np.linspace(0.2, 0.8, 1000).reshape(20, 50)
    errors = errors_of(turns * period_m, np.ones(turns.shape), turns * period_m, period_m)
    fit = fit_wiggling([errors], period_m, "table", 10, partial=True)
    assert fit.unseen_m == [(pytest.approx(1.6), pytest.approx(2.4))]


def test_ranges_that_nobody_knows_do_not_calibrate(wiggly):
    unknown = recording(1.0, wiggly)
    with pytest.raises(UsageError, match=r"distance of its target is not said; write NUMBER=wall-1"):
        CALIBRATE["wiggling"]([unknown], Calibration({}))
    blind = replace(unknown, known=1.0, camera=replace(wiggly, min_amplitude=1e6))
    with pytest.raises(DataError, match="no valid pixel at a known range"):
        CALIBRATE["wiggling"]([blind], Calibration({}))
    with pytest.raises(DataError, match="no images of something at rest"):
        CALIBRATE["wiggling"]([replace(unknown, known=1.0, frames=[])], Calibration({}))
    nothing, one = np.zeros((2, 2)), np.eye(2)
    with pytest.raises(DataError, match=r"wiggling has a gap: no target at 0\.00 to 8\.82"):
        fit_wiggling([errors_of(nothing, one, nothing, 8.8175)], 8.8175)


def test_ranges_by_another_instrument_serve_as_well_as_known_distances(wiggly, wiggly_walls):
    by_distance = CALIBRATE["wiggling"](wiggly_walls, Calibration({}))
    targets = []
    for each in wiggly_walls:
        reference_m = wall(each.known, wiggly).range_m[0].copy()
        reference_m[0, :5] = 0.0  # the instrument saw nothing there
        frames = [replace(raw, planes={**raw.planes, "reference_range_m": reference_m}) for raw in each.frames]
        targets.append(replace(each, frames=frames, known=None))
    by_reference = CALIBRATE["wiggling"](targets, Calibration({}))
    one, other = (np.array(each.settings["wiggling_table_m"]) for each in (by_distance, by_reference))
    np.testing.assert_allclose(other, one, atol=1e-3)
    assert not np.array_equal(one, other)


def test_a_mean_of_ranges_is_right_across_the_wrap_and_needs_half_of_the_images():
    def image(range_m, why=0):
        plane = np.full((1, 2), range_m, np.float32)
        return RangeImage(0.0, plane, plane * 0 + 0.1, plane, np.array([[0, why]], np.uint8))

    measured_m, weight = mean_range([image(1.95), image(0.05, 4), image(0.03, 4)], 2.0)
    assert measured_m[0, 0] == pytest.approx(0.01, abs=1e-3)
    assert weight[0] == pytest.approx([300, 0])
    errors = errors_of(measured_m, weight, np.array([[1.99, np.nan]]), 2.0)
    assert errors.error_m[0, 0] == pytest.approx(0.02, abs=1e-3)
    assert mean_offset_m([errors], 2.0) == pytest.approx(0.02, abs=1e-3)


# --- fixed pattern -----------------------------------------------------------------------------------------------


def test_a_pattern_is_found_below_a_millimetre_and_its_mean_goes_to_all(tmp_path):
    camera = replace(CAMERA, fixed_pattern=PATTERN)
    targets = [recording(d, camera, 300, known=d) for d in (0.8, 1.0)]
    calibration = CALIBRATE["pattern"](targets, Calibration({}))
    assert calibration.planes["range_offset_m"].mean() == pytest.approx(0.0, abs=1e-9)
    assert calibration.settings["offset_m"] == pytest.approx(-fixed_pattern(camera, (24, 32)).range_m.mean(), abs=2e-4)
    error = systematic_mm(camera, calibration, 1.37)
    before = systematic_mm(camera, Calibration({}), 1.37)
    assert np.std(before) > 9
    assert np.std(error) < 1
    assert abs(error.mean()) < 0.3
    save_calibration(tmp_path / "c.npz", calibration)
    again = load_calibration(tmp_path / "c.npz")
    assert again.settings == calibration.settings
    np.testing.assert_array_equal(again.planes["range_offset_m"], calibration.planes["range_offset_m"])


def test_without_a_distance_the_fitted_plane_tells_the_pattern_and_not_the_offset():
    camera = replace(CAMERA, fixed_pattern=replace(PATTERN, global_offset_m=0.0))
    calibration = CALIBRATE["pattern"]([recording(0.9, camera, 200)], Calibration({}))
    assert "offset_m" not in calibration.settings
    assert np.std(systematic_mm(camera, calibration, 1.37)) < 1.2
    both = CALIBRATE["pattern"]([recording(0.9, camera, 100), recording(0.7, camera, 100, known=0.7)], Calibration({}))
    assert abs(systematic_mm(camera, both, 1.37).mean()) < 0.3


def test_a_plane_at_an_angle_is_fitted_past_what_stands_before_it():
    ray = rays(CAMERA.lens, (24, 32))
    plane_m = 1 / (ray @ np.array([0.8, 0.1, -0.05]))
    seen_m = plane_m.copy()
    seen_m[:3, :4] = 0.2
    np.testing.assert_allclose(fitted_plane_m(seen_m, np.ones((24, 32)), CAMERA), plane_m, rtol=1e-6)
    with pytest.raises(DataError, match="2 valid pixels of a target; a plane needs three"):
        fitted_plane_m(seen_m, np.eye(24, 32) * (np.arange(24)[:, None] < 2), CAMERA)


def test_pixels_that_nothing_shows_get_no_offset():
    camera = replace(CAMERA, fixed_pattern=PATTERN, pseudo_rows=1)
    calibration = CALIBRATE["pattern"]([recording(1.0, camera, 20, known=1.0)], Calibration({}))
    assert (calibration.planes["range_offset_m"][0] == 0).all()
    assert calibration.taken["pattern"]["unseen_pixels"] == 32


@pytest.mark.parametrize("modulations_hz", [(), (60e6, 80e6)])
def test_what_is_taken_off_leaves_the_range_in_the_unambiguous_interval(modulations_hz):
    camera = replace(CAMERA, modulations_hz=modulations_hz, frame_rate_hz=5.0)
    method = "cw_multi_frequency" if modulations_hz else "cw_four_phase"
    (raw,) = recording(0.3, camera).frames
    offset_m = np.full(raw.shape, 1.0, np.float32)
    shifted = RANGING[method](replace(raw, planes={**raw.planes, "range_offset_m": offset_m}), camera)
    whole_m = 7.4948 if modulations_hz else 8.8174
    np.testing.assert_allclose(shifted.range_m, RANGING[method](raw, camera).range_m - 1 + whole_m, atol=1e-3)


@pytest.mark.parametrize("name", ["range_offset_m", "temperature_c"])
def test_a_plane_of_another_shape_is_refused(name):
    (raw,) = recording(1.0, CAMERA).frames
    with pytest.raises(DataError, match=f"plane '{name}' has shape .*; calibration needs"):
        RANGING["cw_four_phase"](
            replace(raw, planes={**raw.planes, name: np.zeros((2, 2))}), replace(CAMERA, drift_m_per_k=1e-3)
        )


# --- temperature -------------------------------------------------------------------------------------------------


def warm(degrees_c, **more):
    return replace(CAMERA, temperature=Temperature(drift_m_per_k=2e-3, temperature_c=degrees_c, **more))


def test_drift_is_found_from_one_scene_at_several_temperatures_and_taken_off():
    targets = [replace(recording(1.0, warm(t), 30), known=t) for t in (15.0, 25.0, 40.0)]
    start = Calibration({}, {"offset_m": -0.01}, {"temperature_c": 30.0})
    calibration = CALIBRATE["temperature"](targets, start)
    assert calibration.settings["drift_m_per_k"] == pytest.approx(2e-3, rel=0.02)
    error = calibration.taken["temperature"]["error_m_per_k"]
    assert abs(calibration.settings["drift_m_per_k"] - 2e-3) < 4 * error < 1e-4
    assert calibration.settings["drift_reference_c"] == 30.0
    seen = replace(with_settings(CAMERA, calibration), temperature_c=40.0)
    (hot,), (cold,) = recording(1.0, warm(40.0)).frames, recording(1.0, warm(30.0)).frames
    with_drift, without = (
        RANGING["cw_four_phase"](raw, each).range_m
        for raw, each in ((hot, seen), (cold, replace(seen, temperature_c=30.0)))
    )
    assert abs(np.median(with_drift - without)) < 1e-3


def test_a_camera_that_measures_its_temperature_is_calibrated_while_it_warms_up():
    camera = warm(20.0, self_heating_k=20.0, heating_time_s=600.0, measured=True)
    view, rng = wall(1.0, camera), np.random.default_rng(5)
    frames = [simulate(lambda _: view, camera, t, rng) for t in np.linspace(0, 3000, 80)]
    assert frames[-1].planes["temperature_c"][3, 4] == pytest.approx(temperature_c(camera, 3000.0))
    one = Recording("warm-up", frames, camera, "cw_four_phase", RANGING["cw_four_phase"])
    calibration = CALIBRATE["temperature"]([one], Calibration({}))
    assert calibration.settings["drift_m_per_k"] == pytest.approx(2e-3, rel=0.02)
    assert calibration.settings["drift_reference_c"] == 25.0
    seen = with_settings(camera, calibration)
    medians = [np.median(RANGING["cw_four_phase"](raw, seen).range_m) for raw in frames]
    bare = [np.median(RANGING["cw_four_phase"](raw, camera).range_m) for raw in frames]
    assert np.ptp(bare) > 0.035
    assert np.ptp(medians) < 0.01
    # a calibration at another temperature is told where its offsets hold
    later = CALIBRATE["pattern"]([replace(one, frames=frames[-5:], known=1.0)], calibration)
    assert later.taken["temperature_c"] == pytest.approx(40.0, abs=0.5)
    again = CALIBRATE["temperature"]([one], later)
    assert again.settings["drift_reference_c"] == 25.0


def test_the_offset_of_wiggling_holds_at_the_reference_temperature(wiggly):
    warmer = replace(wiggly, temperature=Temperature(drift_m_per_k=2e-3, temperature_c=45.0, measured=True))
    start = Calibration({}, {"drift_m_per_k": 2e-3, "drift_reference_c": 25.0})
    calibration = CALIBRATE["wiggling"](walls(warmer, 2), start)
    assert calibration.settings["offset_m"] == pytest.approx(0.0, abs=1e-3)
    assert calibration.taken["temperature_c"] == 45.0


def test_drift_that_cannot_be_told_is_refused():
    one = recording(1.0, CAMERA, 3)
    with pytest.raises(DataError, match="3 frames at temperatures within 0 K; drift needs some 2 K apart"):
        CALIBRATE["temperature"]([replace(one, known=25.0)], Calibration({}))
    with pytest.raises(UsageError, match="temperature of the camera is not said"):
        CALIBRATE["temperature"]([one], Calibration({}))
    dim = replace(one.frames[1], planes={k: p * 0 + 2048 for k, p in one.frames[1].planes.items()}, frame_id=7)
    with pytest.raises(DataError, match="frame 7 has no valid pixel in common"):
        CALIBRATE["temperature"]([replace(one, frames=[one.frames[0], dim], known=25.0)], Calibration({}))


# --- darkness and noise ------------------------------------------------------------------------------------------


def stairs(camera, count, seed=0):
    """A staircase of grey at rest."""
    grey = np.geomspace(0.01, 8.0, camera.columns) * np.ones((1, camera.rows, 1))
    view, rng = View(np.ones_like(grey), grey, np.ones_like(grey)), np.random.default_rng(seed)
    frames = [simulate(lambda _: view, camera, 0.0, rng) for _ in range(count)]
    return Recording("stairs", frames, camera, "cw_four_phase", RANGING["cw_four_phase"])


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
def test_read_noise_and_shot_noise_are_found_from_a_scene_at_rest(pixel):
    camera = replace(PRESET, rows=60, columns=80, pseudo_rows=1, pixel=pixel, black_level_lsb=2048.0)
    if pixel == "single_ended":
        camera = replace(camera, black_level_lsb=100.0)
    assumed = replace(camera, read_noise_lsb=9.0, shot_noise_lsb2_per_lsb=1.0)
    found = CALIBRATE["noise"]([replace(stairs(camera, 60), camera=assumed)], Calibration({}))
    assert found.settings["read_noise_lsb"] == pytest.approx(camera.read_noise_lsb, rel=0.04)
    assert found.settings["shot_noise_lsb2_per_lsb"] == pytest.approx(camera.shot_noise_lsb2_per_lsb, rel=0.05)
    assert found.taken["noise"]["line_before"] == [81 / 4, 1 / 4]


def test_noise_of_several_frequencies_and_other_steps_is_found_alike():
    camera = replace(
        PRESET, rows=60, columns=80, modulations_hz=(60e6, 80e6), phase_steps_deg=(0, 120, 240), capture_order=(),
        frame_rate_hz=5.0,
    )  # fmt: skip
    found = CALIBRATE["noise"]([stairs(camera, 40)], Calibration({})).settings
    assert found["read_noise_lsb"] == pytest.approx(camera.read_noise_lsb, rel=0.05)
    assert found["shot_noise_lsb2_per_lsb"] == pytest.approx(camera.shot_noise_lsb2_per_lsb, rel=0.07)


def test_darkness_tells_black_level_and_read_noise():
    camera = replace(PRESET, rows=60, columns=80, pixel="single_ended", black_level_lsb=130.4)
    nothing = np.zeros((1, 60, 80))
    view, rng = View(nothing + np.inf, nothing, nothing + 1), np.random.default_rng(0)
    frames = [simulate(lambda _: view, camera, 0.0, rng) for _ in range(50)]
    one = Recording("dark", frames, camera, "cw_four_phase", RANGING["cw_four_phase"])
    found = CALIBRATE["dark"]([one], Calibration({})).settings
    assert found["black_level_lsb"] == pytest.approx(130.4, abs=0.05)
    assert found["read_noise_lsb"] == pytest.approx(camera.read_noise_lsb, rel=0.02)
    with pytest.raises(DataError, match="one frame has no variance"):
        CALIBRATE["dark"]([replace(one, frames=frames[:1])], Calibration({}))


# --- files and the shell -----------------------------------------------------------------------------------------

WALL = """description = "a wall"
preset = "scaled_car"
duration_s = {duration}
[[objects]]
name = "wall"
path.start_m = [{distance}, 0.0, 0.2]
boxes = [{{ center_m = [0.05, 0.0, 0.0], size_m = [0.1, 100.0, 100.0], reflectivity = {grey} }}]
"""
ACTUAL = """[camera]
rows = 24
columns = 32
pseudo_rows = 0
frame_rate_hz = 20.0
read_noise_lsb = 0.5
shot_noise_lsb2_per_lsb = 0.01
waveform.illumination = "square"
waveform.reference = "square"
waveform.bandwidth_hz = 68e6
fixed_pattern.range_sigma_m = 0.02
fixed_pattern.global_offset_m = 0.1
temperature.drift_m_per_k = 2e-3
temperature.measured = true
[mounting]
z_m = 0.2
"""


def rangecam(*arguments):
    assert main([str(each) for each in arguments]) == 0


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cw-bench")
    (folder / "actual.toml").write_text(ACTUAL)
    calibrating = [(d, 0.2, 25) for d in np.geomspace(0.15, 9.0, 36).round(3)]
    others = [(1.1, 4.0, 25), (1.2, 1.0, 25), (1.2, 1.0, 45), (1.9, 4.0, 45)]
    for seed, (distance_m, duration_s, degrees_c) in enumerate(calibrating + others):
        scene = folder / "scene.toml"
        scene.write_text(WALL.format(duration=duration_s, distance=distance_m, grey=0.8 * distance_m**2))
        warmth = f"camera.temperature.temperature_c={degrees_c}"
        output = folder / f"wall-{distance_m:g}-{degrees_c}.mcap"
        rangecam("simulate", scene, "--config", folder / "actual.toml", "--set", warmth, "--seed", seed, "-o", output)
    return folder


def run_error_mm(folder, name, distance_m, *more):
    rangecam("run", folder / name, "--images", folder / "images.npz", "--json", "--set", "clean.filter=off", *more)
    camera = replace(CAMERA, rows=24, columns=32)
    with np.load(folder / "images.npz") as file:
        mean = file["range_m"].mean(axis=0)  # what cleaning refuses as floor has a range, too
    return 1e3 * (mean - wall(distance_m, camera).range_m[0])


def test_a_camera_is_calibrated_from_the_shell_step_by_step(bench, capsys):
    """The sum of all: square signals, a fixed pattern, an offset and 20 K more, on a wall that is none of them."""
    folder, files = bench, [bench / f"{k}.npz" for k in range(3)]
    targets = [f"{d:g}={folder}/wall-{d:g}-25.mcap" for d in np.geomspace(0.15, 9.0, 36).round(3)]
    rangecam("calibrate", "wiggling", *targets, "-o", files[0])
    rangecam("calibrate", "pattern", f"1.1={folder}/wall-1.1-25.mcap", "--from", files[0], "-o", files[1])
    one, other = f"{folder}/wall-1.2-25.mcap", f"{folder}/wall-1.2-45.mcap"
    assert main(["calibrate", "temperature", f"45={other}", "--from", str(files[1]), "-o", str(files[2])]) == 1
    assert "drift needs some 2 K apart" in capsys.readouterr().err
    rangecam("calibrate", "temperature", f"25={one}", f"45={other}", "--from", files[1], "-o", files[2], "--json")
    assert json.loads(capsys.readouterr().out)["found"]["drift_m_per_k"] == pytest.approx(2e-3, rel=0.03)
    rangecam("calibrate", "temperature", one, other, "--from", files[1], "-o", files[2])  # the frames say it, too
    before = run_error_mm(folder, "wall-1.9-45.mcap", 1.9)
    after = run_error_mm(folder, "wall-1.9-45.mcap", 1.9, "--set", f"camera.calibration={files[1]}")
    all_off = run_error_mm(folder, "wall-1.9-45.mcap", 1.9, "--set", f"camera.calibration={files[2]}")
    centre = (slice(6, 18), slice(8, 24))
    assert np.abs(np.median(before[centre])) > 50
    assert np.median(after[centre]) == pytest.approx(40, abs=5)
    assert np.abs(np.median(all_off[centre])) < 2
    assert np.std(all_off[centre]) < 0.4 * np.std(before[centre])


def test_the_shell_says_what_was_found(bench, capsys, tmp_path):
    walls_ = [f"{bench}/wall-1.1-25.mcap", f"{bench}/wall-1.9-45.mcap"]
    rangecam("calibrate", "pattern", *walls_, "-o", tmp_path / "p.npz", "--json")
    said = json.loads(capsys.readouterr().out)
    assert said["step"] == "pattern"
    assert said["found"]["unseen_pixels"] == 0
    assert said["settings"] == {}
    figure = tmp_path / "n.png"
    rangecam("calibrate", "noise", f"{bench}/wall-1.9-45.mcap", "-o", tmp_path / "n.npz", "--figure", figure)
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["camera.phase_sign=-1"], "a calibration for phase_sign = 1, but here phase_sign = -1"),
        (["camera.modulation_hz=30e6"], "for modulation_hz = 17000000.0, but here modulation_hz = 30000000.0"),
        (["ranging=cw_phases"], "for method = cw_four_phase, but here method = cw_phases"),
        (["camera.columns=160"], "for columns = 32, but here columns = 160"),
    ],
)
def test_a_calibration_of_another_camera_size_or_method_is_refused(bench, capsys, tmp_path, settings, message):
    path = tmp_path / "p.npz"
    rangecam("calibrate", "pattern", f"1.1={bench}/wall-1.1-25.mcap", "-o", path)
    more = [part for each in settings for part in ("--set", each)]
    source = "scenario:test-scene" if "columns" in settings[0] else f"{bench}/wall-1.1-25.mcap"
    arguments = ["run", source, *more, "--set", f"camera.calibration={path}"]
    if source.startswith("scenario"):
        arguments += ["--config", str(bench / "actual.toml")]
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def test_a_recording_keeps_the_calibration_that_it_was_made_with(tmp_path):
    camera = replace(CAMERA, fixed_pattern=PATTERN)
    calibration = CALIBRATE["pattern"]([recording(1.0, camera, 20, known=1.0)], Calibration({}))
    save_calibration(tmp_path / "c.npz", calibration)
    (raw,) = recording(1.2, camera).frames
    config = load_config("scaled_car")
    tuned = replace(camera, calibration=str(tmp_path / "c.npz"), offset_m=calibration.settings["offset_m"])
    config = replace(config, camera=tuned)
    recorder = Recorder(tmp_path / "a.mcap", config)
    list(run([Capture(attach(raw, calibration))], config, [recorder]))
    recorder.close()
    (tmp_path / "c.npz").unlink()
    source = open_source(tmp_path / "a.mcap")
    (capture,) = source.captures
    np.testing.assert_allclose(capture.raw.planes["range_offset_m"], calibration.planes["range_offset_m"], atol=1e-6)
    assert source.config.camera.offset_m == calibration.settings["offset_m"]


def test_a_calibration_taken_at_another_temperature_is_noted(tmp_path):
    camera = replace(CAMERA, fixed_pattern=PATTERN)
    calibration = CALIBRATE["pattern"]([recording(1.0, camera, 5, known=1.0)], Calibration({}))
    save_calibration(tmp_path / "c.npz", calibration)
    size = {"rows": 24, "columns": 32, "pseudo_rows": 0}
    layers = [{"camera": {**size, "calibration": str(tmp_path / "c.npz"), "temperature_c": 45.0}}]
    notes = open_source("scenario:test-scene", preset="scaled_car", layers=layers).notes
    assert any("was taken at 25 C, the camera is at 45 C" in note for note in notes)


# --- without corrections, and real data ----------------------------------------------------------------------------


@pytest.mark.parametrize("method", RANGING)
def test_without_corrections_calibrated_ranging_is_ranging(method):
    several = {"modulations_hz": (60e6, 80e6), "frame_rate_hz": 5.0} if "multi" in method else {}
    camera = replace(CAMERA, **several)
    (raw,) = recording(1.0, camera).frames
    once, other = (RANGING[method](raw, camera) for _ in range(2))
    bare = RANGING[method].__wrapped__(raw, camera)
    for name in ("range_m", "sigma_m", "amplitude", "why"):
        np.testing.assert_array_equal(getattr(once, name), getattr(bare, name))
        np.testing.assert_array_equal(getattr(once, name), getattr(other, name))


def test_the_kernel_runs_without_the_compiler():
    image = RangeImage(
        0.0,
        np.array([[0.1, np.nan, 8.8]], np.float32),
        np.full((1, 3), 0.01, np.float32),
        np.ones((1, 3), np.float32),
        np.zeros((1, 3), np.uint8),
    )
    camera = replace(CAMERA, wiggling_harmonics_m=(((0.02, 0.01), (0.0, 0.03)),), offset_m=-0.05)
    result = straightened(image, camera)
    turns = (image.range_m.astype(float) + 0.05) / unambiguous_m(camera)
    expected = image.range_m - harmonic_basis(turns[0], 2) @ np.ravel(camera.wiggling_harmonics_m)
    np.testing.assert_allclose(result.range_m, np.mod(expected, unambiguous_m(camera)), atol=1e-4)
    assert np.isnan(result.range_m[0, 1])


@recorded
def test_a_harmonic_correction_fitted_on_half_of_the_pixels_lowers_the_spread_of_the_other_half():
    source = open_source(FOLDER / "tools_scene.npz", preset="generic_cw")
    (capture,) = source.captures
    camera = source.config.camera
    half = np.indices(capture.raw.shape).sum(axis=0) % 2 == 0
    reference_m = capture.raw.planes["reference_range_m"]
    taken = replace(capture.raw, planes={**capture.raw.planes, "reference_range_m": np.where(half, reference_m, 0)})
    one = Recording("tools", [taken], camera, "cw_four_phase", RANGING["cw_four_phase"])
    spreads = {}
    for model in ("harmonics", "table"):
        calibration = CALIBRATE["wiggling"]([one], Calibration({}), model=model, partial=True)
        for name, seen in (("before", camera), (model, with_settings(camera, calibration))):
            image = RANGING["cw_four_phase"](capture.raw, seen)
            errors = errors_of(image.range_m, image.valid * 1.0, reference_m, unambiguous_m(camera))
            error_mm = (
                1e3 * (errors.error_m - mean_offset_m([errors], unambiguous_m(camera)))[~half & (reference_m > 0)]
            )
            spreads[name] = 1.4826 * np.median(np.abs(error_mm - np.median(error_mm)))
    assert spreads["before"] == pytest.approx(13.3, abs=0.3)
    assert spreads["harmonics"] < 4.5
    assert spreads["table"] < 4.5
