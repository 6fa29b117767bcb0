"""Claims about what a design report says of a camera before it is built."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rangecam import design
from rangecam.cli import main
from rangecam.config import load_config, parse
from rangecam.design.analysis import distances_m
from rangecam.design.experiment import TRIED_FROM_M, expected_sigma_m, measure, observe, reach_m, regions
from rangecam.design.facts import eye_safety, facts, field_of_view_deg, pulsed_light, unwrapping
from rangecam.design.families import DESIGNED, finite, quiet
from rangecam.design.figures import accuracy, light, spread_and_bias
from rangecam.design.limits import find_limits, passes, saturated_below_m
from rangecam.design.settings import Plan
from rangecam.design.statistics import error_estimates, share_estimate
from rangecam.errors import UsageError
from rangecam.geometry import rays
from rangecam.pulsed.limits import expected_sigma_m as expected_of_pulsed
from rangecam.types import SPEED_OF_LIGHT, Why

SMALL = Plan(frames=8, side=4, reflectivities=(0.2,))
SURE = Plan(frames=60, side=10, reflectivities=(0.2,))
LIMITS_OF_THE_THESIS = 8.0


def seen(config, target, plan=SURE, region=0, seed=0):
    return observe(config, regions(config.camera, plan)[region], target, plan, np.random.default_rng(seed))


def usercams(**camera):
    return load_config("usercams", {"camera": camera})


# -- intervals ---------------------------------------------------------------------------------------------------------


def gaussian(rng):
    return 0.1 + 0.5 * rng.standard_normal((30, 20)), (0.1, 0.5, np.hypot(0.1, 0.5))


def heavy_tailed(rng):
    return 0.5 * rng.laplace(size=(40, 30)), (0.0, 0.5 * np.sqrt(2), 0.5 * np.sqrt(2))


def of_pixels_and_images(rng):
    """Errors that all values of a pixel, and all of an image, have in common."""
    shared = 0.3 * rng.standard_normal((1, 40)) + 0.2 * rng.standard_normal((40, 1))
    return 0.1 + shared + 0.4 * rng.standard_normal((40, 40)), (0.1, np.sqrt(0.29), np.sqrt(0.30))


@pytest.mark.parametrize("made", [gaussian, heavy_tailed, of_pixels_and_images])
@pytest.mark.parametrize("confidence", [0.68, 0.95])
def test_the_intervals_hold_the_truth_as_often_as_they_say(made, confidence):
    rng, repeats = np.random.default_rng(3), 600
    inside = np.zeros(3)
    for _ in range(repeats):
        error, truths = made(rng)
        estimates = error_estimates(error, np.ones(error.shape, bool), confidence)
        inside += [one.low <= truth <= one.high for one, truth in zip(estimates, truths, strict=True)]
    # three standard errors of a coverage; where nothing is shared the intervals may be a little too long
    margin = 3 * np.sqrt(confidence * (1 - confidence) / repeats)
    assert (inside / repeats > confidence - margin - 0.01).all(), inside / repeats
    assert (inside / repeats < confidence + margin + 0.06).all(), inside / repeats


@pytest.mark.parametrize("share", [0.03, 0.5, 0.97])
def test_the_interval_of_a_share_holds_the_truth_as_often_as_it_says(share):
    rng, repeats = np.random.default_rng(4), 600
    found = [share_estimate(rng.random((20, 30)) < share, 0.95) for _ in range(repeats)]
    assert np.mean([one.low <= share <= one.high for one in found]) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / repeats) - 0.01


def test_a_share_of_none_or_all_still_has_an_interval():
    assert share_estimate(np.ones((10, 10), bool), 0.95).low == pytest.approx(1 / (1 + 2.262**2 / 100), rel=1e-3)
    assert share_estimate(np.zeros((10, 10), bool), 0.95).low == 0


def test_pixels_that_err_together_make_the_intervals_longer():
    rng = np.random.default_rng(0)
    alone = rng.standard_normal((50, 50))
    valid = np.ones(alone.shape, bool)
    short, long = (
        error_estimates(error, valid, 0.95)[0] for error in (alone, alone + 3 * rng.standard_normal((50, 1)))
    )
    assert long.high - long.low > 5 * (short.high - short.low)
    few = error_estimates(alone + 3 * rng.standard_normal((1, 50)), valid, 0.95, few_pixels=True)[0]
    assert few.high - few.low < 5 * (short.high - short.low)  # the pixels' own errors are no chance then


def test_of_less_than_two_valid_ranges_nothing_is_known():
    valid = np.zeros((8, 4), bool)
    assert all(np.isnan(one.value) for one in error_estimates(np.zeros((8, 4)), valid, 0.95))
    valid[0, :2] = True
    assert error_estimates(np.zeros((8, 4)), valid, 0.95)[1].high == 0


CAMERAS = {
    "usercams": ("usercams", {}, (10.0, 0.2)),
    "fixed pattern": ("usercams", {"pixel": {"fixed_pattern_v": 2e-3}}, (6.0, 0.5)),
    "scaled_car": ("scaled_car", {}, (1.5, 0.5)),
    "three taps": ("generic_pulsed", {}, (2.0, 0.5)),
    "processed": ("vl53l5cx", {}, (2.0, 0.5)),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_the_error_bars_of_a_camera_hold_what_a_hundred_times_more_images_find(name):
    preset, camera, target = CAMERAS[name]
    config, plan, repeats = load_config(preset, {"camera": camera}), Plan(frames=12, side=8), 100
    many = [seen(config, target, plan, seed=k) for k in range(repeats)]
    if name == "fixed pattern":  # every camera of a series has a pattern of its own
        pixel = config.camera.pixel
        made = [
            replace(config, camera=replace(config.camera, pixel=replace(pixel, fixed_pattern_seed=k)))
            for k in range(repeats)
        ]
        many = [seen(one, target, plan, seed=k) for k, one in enumerate(made)]
    truth = {
        "bias": np.mean([p.bias.value for p in many]),
        "spread": np.sqrt(np.mean([p.spread.value**2 for p in many])),
        "error": np.sqrt(np.mean([p.error.value**2 for p in many])),
    }
    for kind, value in truth.items():
        held = np.mean([getattr(p, kind).low <= value <= getattr(p, kind).high for p in many])
        assert held >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / repeats), (kind, held)


# -- targets -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["usercams", "scaled_car", "generic_pulsed", "vl53l5cx"])
def test_the_measured_spread_is_the_one_that_the_chain_says_and_expects(preset):
    config = load_config(preset)
    range_m = {"usercams": 10.0, "scaled_car": 1.0, "generic_pulsed": 2.0, "vl53l5cx": 2.0}[preset]
    for region in (0, 1):
        point = seen(config, (range_m, 0.5), region=region)
        assert point.valid.value == 1
        assert point.sigma_m == pytest.approx(point.expected_m, rel=0.02)
        assert point.spread.low * 0.97 < point.expected_m < point.spread.high * 1.03
        assert point.bias.low - 1e-3 < 0 < point.bias.high + 1e-3


def test_the_expected_sigma_of_a_pulsed_camera_is_the_closed_form_over_all_ranges():
    config, at_m = usercams(), np.linspace(3, 24, 15)
    centre = regions(config.camera, SMALL)[0]
    closed, n_acc = expected_of_pulsed(at_m, 0.2, config.camera)
    np.testing.assert_allclose(expected_sigma_m(config, centre, at_m, 0.2, SMALL), closed, rtol=1e-6)
    assert [seen(config, (float(r), 0.2), SMALL).n_acc for r in at_m[::7]] == pytest.approx(n_acc[::7])


@pytest.mark.parametrize(
    "lens",
    [
        {"horizontal_fov_deg": 40.0, "projection": "perspective"},
        {"horizontal_fov_deg": 80.0, "vertical_fov_deg": 50.0, "projection": "perspective"},
        {"horizontal_fov_deg": 80.0, "vertical_fov_deg": 60.0, "projection": "equiangular"},
        {"horizontal_fov_deg": 50.0, "projection": "equiangular"},
    ],
)
def test_the_four_corner_pixels_look_where_the_corners_of_the_image_look(lens):
    camera = load_config("scaled_car", {"camera": {"rows": 30, "columns": 50}}).camera
    camera = replace(camera, lens=replace(camera.lens, **{"vertical_fov_deg": None, **lens}))
    corners = regions(camera, SMALL)[1].camera
    whole = rays(camera.lens, (30, 50))
    np.testing.assert_allclose(rays(corners.lens, (2, 2)), whole[::29, ::49], atol=1e-12)


def test_the_centre_looks_along_the_axis_and_no_row_of_data_is_taken_for_dark():
    camera = load_config("scaled_car").camera
    assert camera.pseudo_rows == 1
    centre, corners = regions(camera, SMALL)
    assert (centre.camera.rows, centre.camera.columns, corners.camera.rows) == (4, 4, 2)
    assert rays(centre.camera.lens, (4, 4))[..., 0].min() > 1 - 1e-9
    assert centre.camera.pseudo_rows == corners.camera.pseudo_rows == 0


def test_corners_get_less_light_and_scatter_more():
    config = load_config("scaled_car")
    middle, corner = (seen(config, (0.8, 0.8), region=k) for k in (0, 1))
    assert corner.electrons < 0.5 * middle.electrons
    assert corner.spread.low > middle.spread.high


def test_a_beam_with_more_light_in_the_middle_helps_the_middle_at_the_cost_of_the_corners():
    even, uneven = (usercams(laser={"beams": beams}) for beams in ([[-1, 1]], [[-1, 0.5], [-0.5, 1]]))
    for region, gain in ((0, 4 / 3), (1, 2 / 3)):  # two beams of three quarters of the width
        before, after = (seen(config, (12.0, 0.2), SMALL, region).electrons for config in (even, uneven))
        assert after / before == pytest.approx(gain, rel=1e-3)
    with pytest.raises(UsageError, match="no light falls into column 32"):
        regions(usercams(laser={"beams": [[-1, -0.5]]}).camera, SMALL)


def test_electrons_are_those_of_the_signal_without_noise():
    point = seen(usercams(), (20.0, 0.05), SMALL)
    one_pulse_v = 0.05 * 1.110 * (2 / 20.0) ** 2  # N-K-043
    assert point.electrons == pytest.approx(100 * one_pulse_v / 89.3e-9, rel=2e-3)  # N-K-023
    car = load_config("scaled_car")
    near, far = (seen(car, (range_m, 0.05), SMALL).electrons for range_m in (0.5, 5.0))
    assert near / far == pytest.approx(100, rel=1e-3)
    assert seen(load_config("generic_range"), (2.0, 0.5), SMALL).electrons is None
    silent = {"shot_noise_lsb2_per_lsb": 0.0}
    assert seen(load_config("scaled_car", {"camera": silent}), (1.0, 0.5), SMALL).electrons is None
    taps = {"taps": {"shot_noise_counts2_per_count": 0.0}}
    assert seen(load_config("generic_pulsed", {"camera": taps}), (2.0, 0.5), SMALL).electrons is None


def test_the_reason_of_most_invalid_pixels_is_told():
    config = usercams()
    assert seen(config, (0.3, 0.8), SMALL).refused == "SATURATED"
    assert seen(config, (26.0, 0.8), SMALL).refused == "OUT_OF_RANGE"
    assert seen(config, (5.0, 0.8), SMALL).refused == ""
    assert seen(load_config("scaled_car"), (5.0, 0.05), SMALL).refused == "LOW_AMPLITUDE"


def test_cleaning_is_judged_if_asked_for_wherever_the_target_stands():
    car = load_config("scaled_car")
    raw, cleaned = (seen(car, (1.2, 0.8), replace(SURE, clean=clean)) for clean in (False, True))
    assert cleaned.valid.value > 0.99
    assert cleaned.spread.high < 0.7 * raw.spread.low
    assert seen(car, (1.2, 0.8), replace(SURE, clean=True), region=1).refused != Why.FLOOR.name


def test_ambient_light_makes_ranges_worse():
    dark, bright = (seen(usercams(), (12.0, 0.5), replace(SURE, ambient_wpm2=e)) for e in (0.0, 3000.0))
    assert bright.spread.low > dark.spread.high
    assert bright.sigma_m == pytest.approx(bright.spread.value, rel=0.03)


# -- limits ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("preset", "camera", "nearest_m", "farthest_m"),
    [
        ("usercams", {"max_range_m": None, "min_range_m": 0.0}, TRIED_FROM_M, SPEED_OF_LIGHT / 2 * 180e-9),
        ("usercams", {"max_range_m": None, "pulse_width_s": 90e-9}, 0.2, SPEED_OF_LIGHT / 2 * 90e-9),
        ("usercams", {"max_range_m": None, "shutter_delay_s": 40e-9}, 6.0, SPEED_OF_LIGHT / 2 * 220e-9),
        ("usercams", {}, 0.2, 25.0),
        ("scaled_car", {}, TRIED_FROM_M, 8.817),
        ("scaled_car", {"modulation_hz": 30e6}, TRIED_FROM_M, 4.997),
        ("generic_pulsed", {}, TRIED_FROM_M, SPEED_OF_LIGHT / 2 * 29.15e-9),
        ("scaled_car_emulation", {}, TRIED_FROM_M, 8.817),
        ("vl53l5cx", {"min_range_m": 0.3}, 0.3, 5.0),
    ],
)
def test_the_measurement_range_is_found_by_trial(preset, camera, nearest_m, farthest_m):
    reach = reach_m(load_config(preset, {"camera": camera}), SMALL)
    assert reach == pytest.approx((nearest_m, farthest_m), rel=6e-3)


def test_soft_edges_and_stray_light_leave_a_measurement_range_although_its_ranges_are_off():
    edges = {"pulse_rise_s": 60e-9, "pulse_fall_s": 30e-9, "shutter_edge_s": 65e-9}
    nearest_m, farthest_m = reach_m(usercams(**edges, crosstalk={"stray_fraction": 0.02, "blur": True}), SMALL)
    assert nearest_m < 0.5
    assert farthest_m > 24


def test_pixels_at_the_border_of_what_is_simulated_do_not_count():
    point = seen(load_config("scaled_car_emulation"), (1.0, 0.8), SMALL)
    assert point.samples == 8 * 2 * 2  # of 4 x 4 pixels the inner ones
    assert point.valid.value == 1


def test_a_camera_that_ranges_nothing_has_no_measurement_range():
    config = usercams(pixel={"noise_threshold_v": 10.0})
    assert np.isnan(reach_m(config, SMALL)).all()
    judged = design.judge("deaf", config, replace(SMALL, distances_m=(5.0,)))
    assert judged.limits[0].far.startswith("nowhere; at best, at 5 m, 100 % of the pixels are refused")
    assert "no target of whatever brightness" in design.describe([judged])
    assert distances_m(SMALL, (np.nan, np.nan))[-1] == 10.0
    json.dumps(design.as_json(judged), allow_nan=False)


@pytest.mark.parametrize("reflectivity", [0.05, 0.8])
def test_a_pulsed_camera_is_saturated_where_one_pulse_fills_window_a(reflectivity):
    config = usercams(min_range_m=0.0)
    found = saturated_below_m(config, regions(config.camera, SMALL)[0], reflectivity, (0.02, 25.0), SMALL)
    signal_v = reflectivity * 1.110 * (2 / found) ** 2 * (1 - found / 26.98)
    assert signal_v == pytest.approx(1.5, rel=0.02)


def test_a_camera_that_never_saturates_is_saturated_nowhere():
    config = load_config("generic_cw")
    assert saturated_below_m(config, regions(config.camera, SMALL)[0], 0.8, (0.02, 8.8), SMALL) == 0.0


def limits_of(config, reflectivity, at_m, plan=SURE, region=0, seed=0):
    chosen = regions(config.camera, plan)[region]
    points = [seen(config, (float(r), reflectivity), plan, region, seed=100 * seed + k) for k, r in enumerate(at_m)]
    return find_limits(config, chosen, points, plan, np.random.default_rng(1 + seed))


def test_the_far_limit_is_where_the_closed_form_crosses_the_target():
    """A search ends 0.07 m beside it (1 standard deviation): a step is decided by 6000 ranges."""
    searches = [limits_of(usercams(), 0.05, [4.0, 6.0, 8.0, 10.0, 12.0], seed=k) for k in range(5)]
    at_m = np.linspace(6, 12, 1000)
    sigma_m, _ = expected_of_pulsed(at_m, 0.05, usercams().camera)
    found, farthest_m = searches[0], np.mean([each.farthest_m for each in searches])
    assert farthest_m == pytest.approx(at_m[sigma_m < 0.03 * at_m][-1], rel=0.012)
    assert found.farthest_m == pytest.approx(LIMITS_OF_THE_THESIS, abs=1)  # N-K-052: beyond 8 m measured
    assert found.near == "not reached within the simulated ranges"
    assert found.far.startswith("the error exceeds 3 % of the range; sensor noise 9")
    assert found.complete


def test_a_gap_within_the_limits_is_told():
    found = limits_of(usercams(), 0.05, [0.4, 0.7, 1.1, 1.3, 3.0, 5.0, 12.0])
    assert not found.complete
    assert found.nearest_m < 1 < found.farthest_m


def test_far_limits_name_what_refuses_the_pixels():
    found = limits_of(usercams(), 0.8, [20.0, 24.0, 26.0])
    assert 24 < found.farthest_m < 25
    assert "most as OUT_OF_RANGE: outside of the range that the method measures" in found.far
    assert ";" not in found.far  # no noise is to blame
    dark = limits_of(load_config("generic_cw"), 0.5, [2.0, 4.0, 6.0])
    assert "too little light; read-out noise 9" in dark.far


def test_the_shares_of_the_noise_are_those_of_the_model():
    pixel = usercams().camera.pixel
    far = limits_of(usercams(), 0.05, [6.0, 12.0]).far_shares
    at_100 = 100 * pixel.sensor_noise_v**2
    assert far["sensor noise"] == pytest.approx(at_100 / (at_100 + pixel.readout_noise_v**2), abs=0.03)
    once = usercams(pixel={"accumulations": [1]})
    one = limits_of(once, 0.5, [1.5, 2.0, 3.0, 6.0]).far_shares
    both = pixel.sensor_noise_v**2 + pixel.readout_noise_v**2
    assert one["read-out noise"] == pytest.approx(pixel.readout_noise_v**2 / both, abs=0.03)
    assert one["sensor noise"] == pytest.approx(pixel.sensor_noise_v**2 / both, abs=0.03)
    assert one["fixed pattern"] == one["laser jitter"] == 0
    assert one["bias"] < 0.01


def test_ambient_light_is_named_where_it_is_to_blame():
    pixel = {"sensor_noise_v": 1e-5, "readout_noise_v": 1e-5}
    found = limits_of(usercams(pixel=pixel), 0.2, [6.0, 24.0], replace(SURE, ambient_wpm2=3000.0, accuracy=0.005))
    assert found.far_shares["ambient light"] > 0.5
    assert "ambient light" in found.far


def test_a_bias_counts_as_error_and_is_named():
    soft = usercams(pulse_rise_s=60e-9, pulse_fall_s=30e-9, shutter_edge_s=65e-9)
    found = limits_of(soft, 0.8, [2.0, 4.0, 8.0, 14.0, 20.0], replace(SURE, accuracy=0.015))
    shares = {**found.near_shares, **found.far_shares}
    assert shares["bias"] > 0.3
    assert "bias" in found.near + found.far


def test_a_target_passes_with_enough_pixels_and_a_small_error():
    point, plan = seen(usercams(), (10.0, 0.2)), SURE
    assert passes(point, plan)
    assert not passes(point, replace(plan, accuracy=0.001))
    assert not passes(replace(point, valid=replace(point.valid, value=0.9)), plan)


@pytest.mark.parametrize("preset", ["usercams", "scaled_car", "generic_pulsed", "vl53l5cx", "azure_kinect"])
def test_a_quiet_camera_has_no_noise_but_rounding(preset):
    config = load_config(preset, {"camera": {"pixel": {"fixed_pattern_v": 1e-3}}} if preset == "usercams" else {})
    centre = regions(config.camera, SMALL)[0]
    images, _ = measure(config, centre, (2.0, 0.5), SMALL, np.random.default_rng(0), quiet(centre.camera))
    found = np.array([image.range_m for image in images])
    noise = seen(config, (2.0, 0.5), SMALL).spread.value
    assert found.std() < (0.05 if preset == "generic_pulsed" else 1e-3) * noise
    assert len(DESIGNED[config.camera.kind].noise(config.camera)) >= 2


# -- numbers -----------------------------------------------------------------------------------------------------------


def numbers(config, plan=SMALL):
    judged = design.judge("x", config, replace(plan, distances_m=(3.0,)))
    return judged.numbers


def test_the_numbers_of_the_pulsed_camera_are_those_of_the_thesis():
    n = numbers(load_config("usercams"), replace(SMALL, reflectivities=(0.05, 1.0)))
    assert n["fastest_frame_rate_hz"] == pytest.approx(50)  # N-K-049.100.1.10
    assert n["field_of_view_deg"] == pytest.approx([29.95, 8.83])
    assert n["eye_safety"]["pulse_energy_j"] == pytest.approx(360e-6)  # N-K-042
    assert n["eye_safety"]["mean_power_w"] == pytest.approx(3.6)
    assert n["light"]["nee_sensor_jpm2"] * 1e9 == pytest.approx(144.82, abs=0.02)  # N-K-031
    assert n["light"]["nee_system_jpm2"] * 1e9 == pytest.approx(222.48, abs=0.02)  # N-K-032
    assert n["light"]["nee_system_most_accumulations_jpm2"] * 1e9 == pytest.approx(1458, abs=0.5)  # N-K-039
    assert n["light"]["full_scale_electrons"] == pytest.approx(1.68e7, rel=2e-3)  # N-K-025
    assert n["light"]["dynamic_range_db"] == pytest.approx(91.89, abs=0.005)  # N-K-034
    wide = n["pixel_footprints"][-1]
    assert wide["range_m"] == pytest.approx(25, rel=1e-3)
    assert wide["width_m"] / 25 == pytest.approx(0.167 / 20, rel=5e-3)  # N-K-015.20
    assert wide["height_m"] / 25 == pytest.approx(0.386 / 20, rel=5e-3)


def test_the_needed_input_range_is_that_of_the_thesis_for_its_ranges():
    config, plan = load_config("usercams"), Plan(reflectivities=(0.05, 1.0))
    light_numbers = pulsed_light(config.camera, plan, (2.0, 20.0))
    assert light_numbers["needed_input_range_db"] == pytest.approx(96.48, abs=0.005)  # N-K-037
    assert pulsed_light(config.camera, plan, (np.nan, np.nan))["needed_input_range_db"] is None


def test_the_data_rate_counts_the_raw_planes_of_the_whole_image():
    n = numbers(load_config("scaled_car"))
    assert n["raw_planes"] == ["phase_0", "phase_90", "phase_180", "phase_270"]
    assert n["bytes_per_frame"] == 4 * 2 * 160 * 120  # four planes of uint16
    assert n["mbit_per_s"] == pytest.approx(4 * 16 * 160 * 120 * 30 / 1e6)
    assert "eye_safety" not in n
    assert "light" not in n


def test_the_vertical_angle_of_square_pixels_follows_from_the_horizontal():
    camera = load_config("generic_cw").camera  # 640 x 480, 60 degrees, perspective
    assert field_of_view_deg(camera)[1] == pytest.approx(2 * np.degrees(np.arctan(np.tan(np.radians(30)) * 0.75)))
    even = replace(camera, lens=replace(camera.lens, projection="equiangular"))
    assert field_of_view_deg(even)[1] == pytest.approx(45)
    assert field_of_view_deg(load_config("usercams").camera) == (29.95, 8.83)


def test_the_margin_to_class_1_grows_with_the_square_of_the_distance_and_with_the_source():
    camera = usercams(lens={"horizontal_fov_deg": 30.0, "vertical_fov_deg": 9.0}).camera
    point, large = (eye_safety(camera, Plan(source_m=size)) for size in (0.0, 0.5e-3))
    margins = [row["margin"] for row in point["at"]]
    assert margins[1] / margins[0] == pytest.approx(9)
    assert point["at"][0]["exposure_jpm2"] == pytest.approx(0.427, rel=0.01)  # N-K-045
    assert point["class_1_from_m"] == pytest.approx(0.1 / np.sqrt(margins[0]))
    assert large["at"][0]["margin"] > 3 * margins[0]
    assert large["at"][2]["margin"] == pytest.approx(margins[2])  # from afar it is a point as well
    assert large["class_1_from_m"] is None
    assert "0.5 mm" in large["assumed"]


def test_a_repetition_rate_above_the_thermal_limit_is_warned_of():
    config = usercams(laser={"repetition_hz": 11e3})
    judged = design.judge("hot", config, replace(SMALL, distances_m=(5.0,)))
    assert len(judged.warnings) == 1
    assert "thermal limit" in judged.warnings[0]
    assert "warning            camera.laser.repetition_hz = 11000" in design.describe([judged])
    assert design.as_json(judged)["warnings"] == list(judged.warnings)


def test_eye_safety_says_where_its_limits_are_not_known():
    n = numbers(load_config("generic_pulsed"))
    assert n["eye_safety"]["at"] == []
    assert "repetition_hz" in n["eye_safety"]["unknown"]
    assert "light" not in n


def test_numbers_that_json_does_not_know_become_none():
    assert [finite(value) for value in (1.5, float("nan"), float("inf"), None)] == [1.5, None, None, None]
    config = load_config("scaled_car")
    raw = design.analysis.SIMULATE["cw"]  # any frame has the planes that count
    assert callable(raw)
    assert facts(config, SMALL, (float("nan"), float("nan")), _frame())["pixel_footprints"] == []


def _frame():
    from rangecam.types import RawFrame

    return RawFrame(0.0, {"phase_0": np.zeros((2, 2), np.uint16)})


# -- the whole ---------------------------------------------------------------------------------------------------------

QUICK = ["--plan", "frames=8", "--plan", "side=3", "--plan", "reflectivities=[0.2]", "--plan", "distances_m=[5,20]"]


@pytest.fixture(scope="module")
def two():
    plan = replace(SMALL, distances_m=(2.0, 6.0, 18.0), reflectivities=(0.05, 0.5))
    short = usercams(pulse_width_s=100e-9, max_range_m=None)
    return [design.judge("long", usercams(), plan), design.judge("short", short, plan)]


def test_a_design_is_the_same_for_the_same_seed(two):
    again = design.judge("long", usercams(), two[0].plan)
    assert design.as_json(again) == design.as_json(two[0])
    other = design.judge("long", usercams(), two[0].plan, seed=1)
    assert other.points != again.points


def test_a_shorter_pulse_shortens_the_range_and_sharpens_what_is_near(two):
    long, short = two
    assert short.numbers["measurement_range_m"][1] < 15.1 < long.numbers["measurement_range_m"][1]
    # sigma goes with the pulse over its light: the same light in 100 ns as in 180 ns would be better
    brighter = usercams(pulse_width_s=100e-9, laser={"peak_power_w": 3600.0}, max_range_m=None)
    near_long, near_short = (seen(config, (6.0, 0.2)) for config in (usercams(), brighter))
    assert near_short.spread.high < near_long.spread.low


def test_every_target_is_seen_in_the_centre_and_in_the_corners(two):
    points = two[0].points
    assert len(points) == 2 * 2 * 3
    assert {p.region for p in points} == {"centre", "corners"}
    assert [one.reflectivity for one in two[0].limits] == [0.05, 0.5, 0.05, 0.5]
    assert list(two[0].saturated_m) == [0.05, 0.5]


def test_json_holds_every_number_and_no_nan(two):
    plain = json.loads(json.dumps([design.as_json(one) for one in two], allow_nan=False))
    assert plain[0]["plan"]["accuracy"] == 0.03
    assert {"range_m", "valid", "bias", "spread", "error", "sigma_m", "expected_m", "refused"} <= set(
        plain[0]["points"][0]
    )
    assert set(plain[0]["points"][0]["error"]) == {"value", "low", "high"}


@pytest.mark.parametrize("draw", [accuracy, spread_and_bias, light])
def test_the_figures_lay_designs_over_each_other(draw, two):
    one, both = draw(two[:1]), draw(two)
    assert one.startswith(b"\x89PNG")
    assert len(both) != len(one)


def test_figures_bear_targets_of_which_nothing_is_seen():
    plan = replace(SMALL, distances_m=(40.0, 50.0))
    judged = [design.judge("blind", usercams(), plan), design.judge("toy", load_config("generic_range"), plan)]
    assert all(draw(judged).startswith(b"\x89PNG") for draw in (accuracy, spread_and_bias, light))


def test_the_page_opens_offline_and_names_all_designs(two):
    page = design.html(two).decode("utf-8")
    assert page.count("data:image/png;base64,") == 3
    assert not [word for word in ("http://", "https://", "<script") if word in page]
    assert "Design: long, short" in page
    assert "OUT_OF_RANGE" in page


def test_the_command_line_writes_a_page_and_says_what_limits(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["design", *QUICK]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["design.html"]
    out = capsys.readouterr().out
    assert "measurement range  0.2 m to 25 m (mdsi3)" in out
    assert "far end" in out


def test_the_command_line_prints_one_json_object_and_compares_files(tmp_path: Path, capsys):
    for name, width in (("wide", "180e-9"), ("narrow", "100e-9")):
        text = f'[camera]\nkind = "pulsed"\npulse_width_s = {width}\n'
        (tmp_path / f"{name}.toml").write_text(text)
    files = [str(tmp_path / f"{name}.toml") for name in ("wide", "narrow")]
    target = tmp_path / "both.html"
    assert main(["design", files[0], "--config", files[1], *QUICK, "--json", "-o", str(target)]) == 0
    designs = json.loads(capsys.readouterr().out)["designs"]
    assert [one["name"] for one in designs] == ["wide", "narrow"]
    assert [one["preset"] for one in designs] == ["usercams", "usercams"]
    assert designs[1]["numbers"]["measurement_range_m"][1] == pytest.approx(14.99, rel=1e-2)
    assert target.exists()


def test_a_file_without_a_preset_starts_from_one_of_its_family(tmp_path: Path, capsys):
    (tmp_path / "cw.toml").write_text('[camera]\nkind = "cw"\nmodulation_hz = 30e6\n')
    (tmp_path / "named.toml").write_text('preset = "vl53l5cx"\n')
    files = [str(tmp_path / name) for name in ("cw.toml", "named.toml")]
    assert main(["design", *files, "generic_range", *QUICK, "--json"]) == 0
    designs = json.loads(capsys.readouterr().out)["designs"]
    assert [one["preset"] for one in designs] == ["scaled_car", "vl53l5cx", "generic_range"]
    assert not (tmp_path / "design.html").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["usercams", "--set", "camera.averages=4"], ["camera.frame_rate_hz = 50", "12.5 Hz"]),
        (["usercams", "--set", "camera.pulse_width_s=-1"], ["camera.pulse_width_s"]),
        (["--plan", "acuracy=0.1"], ["--plan: unknown setting 'acuracy'", "did you mean 'accuracy'"]),
        (["--plan", "frames=1"], ["--plan: frames = 1"]),
        (["nowhere.toml"], ["nowhere.toml"]),
        (["usercams", "-o", "nowhere/x.html"], ["the folder nowhere does not exist"]),
        (["usercams", "--set", "camera.pulse_rise_s=400e-9"], ["camera.pulse_rise_s"]),
    ],
)
def test_an_impossible_design_is_one_line_and_exit_code_two(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["design", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert all(word in captured.err for word in words), captured.err
    assert not list(tmp_path.iterdir())


def test_targets_are_spread_over_the_measurement_range_unless_they_are_listed():
    spread = distances_m(SMALL, (0.2, 25.0))
    assert spread[0] == 0.25
    assert spread[-1] == 25.0
    assert len(spread) == 24
    np.testing.assert_array_equal(distances_m(replace(SMALL, distances_m=(5.0, 2.0, 5.0)), (0.2, 25.0)), [2.0, 5.0])


def test_a_plan_is_checked():
    with pytest.raises(UsageError, match="reflectivities"):
        parse(Plan, {"reflectivities": []}, "--plan")


def test_of_several_frequencies_a_design_says_how_far_and_how_surely_they_reach():
    two = load_config("scaled_car", {"camera": {"modulations_hz": [60e6, 80e6]}, "ranging": "cw_multi_frequency"})
    few = replace(SMALL, distances_m=(2.0,))
    lines = design.describe([design.judge("two", two, few)])
    assert f"60 + 80 MHz, unambiguous to {SPEED_OF_LIGHT / 2 / 20e6:.4g} m" in lines
    rows = unwrapping(two.camera)["at"]
    assert [row["gross"] for row in rows] == sorted(row["gross"] for row in rows)
    assert all(row["accepted_gross"] <= row["gross"] for row in rows)
    three = load_config("kinect2_like").camera
    assert "rejected" not in unwrapping(three)["at"][0]
    one_mm = SPEED_OF_LIGHT / (4 * np.pi * 1e6) * 0.1 * 1000
    expected = one_mm / np.sqrt(80**2 + 16**2 + 120**2)
    assert 1000 * unwrapping(three)["at"][1]["sigma_m"] == pytest.approx(expected, rel=1e-6)
