"""Claims about lens and radiometry."""

import numpy as np
import pytest

from rangecam.errors import UsageError
from rangecam.geometry import Lens, rays
from rangecam.optics import (
    SMALL_SOURCE_RAD,
    Objective,
    ambient_on_sensor,
    blur_radius_m,
    diffraction,
    footprint_m,
    image_distance_m,
    irradiance_on_sensor,
    lit_area_m2,
    module_power_w,
    mpe_jpm2,
    natural_vignetting,
)

FRONT_VIEW = Objective()
WIDE = Objective(focal_length_m=7.30e-3, aperture_m=7.60e-3)
INFRARED_M = 905e-9


def on_axis(power_w, range_m, reflectivity=1.0, objective=FRONT_VIEW):
    one = np.ones(1)
    return float(irradiance_on_sensor(power_w, range_m * one, reflectivity * one, one, one, objective)[0])


@pytest.mark.parametrize(("range_m", "expected"), [(2.0, 2356.0), (20.0, 23.56)])
def test_two_kilowatts_on_white_give_the_irradiance_of_the_radiometric_budget(range_m, expected):
    assert on_axis(2000.0, range_m) == pytest.approx(expected, rel=5e-4)  # N-K-043


def test_a_plane_across_the_axis_is_seen_with_the_cosine_to_the_fourth():
    cos_axis = rays(Lens(horizontal_fov_deg=60, vertical_fov_deg=18), (8, 64))[..., 0]
    depth_m, power_w, reflectivity = 7.0, 2000.0, 0.3
    ours = irradiance_on_sensor(
        power_w, depth_m / cos_axis, np.full(cos_axis.shape, reflectivity), cos_axis, cos_axis, FRONT_VIEW
    )
    area = FRONT_VIEW.sensor_area_m2 * (depth_m / FRONT_VIEW.focal_length_m) ** 2  # eq 3.10
    printed = power_w / area * reflectivity * cos_axis**4 / (4 * FRONT_VIEW.f_number**2)  # eq 3.9
    np.testing.assert_allclose(ours, printed, rtol=1e-12)


def test_light_falls_with_the_square_of_the_range_and_nothing_comes_from_infinity():
    assert on_axis(1.0, 3.0) / on_axis(1.0, 6.0) == pytest.approx(4.0)
    assert on_axis(1.0, np.inf, reflectivity=0.0) == 0.0


def test_light_is_proportional_to_power_reflectivity_transmission_and_incidence():
    base = on_axis(10.0, 4.0)
    assert on_axis(20.0, 4.0) == pytest.approx(2 * base)
    assert on_axis(10.0, 4.0, 0.25) == pytest.approx(base / 4)
    assert on_axis(10.0, 4.0, objective=Objective(transmission=0.6)) == pytest.approx(0.6 * base)
    one = np.ones(1)
    assert irradiance_on_sensor(10.0, 4 * one, one, 0.5 * one, one, FRONT_VIEW)[0] == pytest.approx(base / 2)


@pytest.mark.parametrize(
    ("objective", "f_number", "fov_deg"),
    [
        (FRONT_VIEW, 0.8015, (29.95, 8.83)),
        (WIDE, 0.9605, (59.35, 18.67)),
    ],
)
def test_the_two_lenses_have_the_printed_f_number_and_opening_angles(objective, f_number, fov_deg):
    assert objective.f_number == pytest.approx(f_number, abs=5e-5)  # N-K-011
    np.testing.assert_allclose(np.degrees(objective.opening_angles_rad), fov_deg, atol=0.005)
    assert FRONT_VIEW.sensor_area_m2 * 1e6 == pytest.approx(19.968)  # N-K-010


def test_full_sun_on_white_gives_the_known_irradiance_at_any_range():
    one = np.ones(1)
    assert ambient_on_sensor(1000.0, one, one, FRONT_VIEW)[0] == pytest.approx(389.0, rel=1e-3)  # N-K-098


def test_ambient_light_is_vignetted_like_any_other():
    cos_axis = np.array([1.0, 0.9, 0.5])
    seen = ambient_on_sensor(50.0, np.ones(3), cos_axis, FRONT_VIEW)
    np.testing.assert_allclose(seen / seen[0], natural_vignetting(cos_axis))
    np.testing.assert_allclose(natural_vignetting(cos_axis), [1, 0.6561, 0.0625])


def test_object_and_image_obey_the_lens_law():
    u = np.geomspace(0.02, 1000, 50)
    v = image_distance_m(u, FRONT_VIEW)
    np.testing.assert_allclose(1 / u + 1 / v, 1 / FRONT_VIEW.focal_length_m, rtol=1e-12)
    assert image_distance_m(np.inf, FRONT_VIEW) == pytest.approx(FRONT_VIEW.focal_length_m)


@pytest.mark.parametrize("function", [image_distance_m, blur_radius_m])
def test_an_object_within_the_focal_length_has_no_image(function):
    with pytest.raises(UsageError, match=r"object_distance_m = 0\.01: must exceed the focal length"):
        function([2.0, 0.01], FRONT_VIEW)


def test_the_blur_disc_is_that_of_similar_triangles_and_not_the_printed_one():
    u = 2.0
    v = float(image_distance_m(u, FRONT_VIEW))
    printed_m = FRONT_VIEW.aperture_m / 2 * (v - FRONT_VIEW.focal_length_m) / FRONT_VIEW.focal_length_m
    assert printed_m * 1e6 == pytest.approx(76.01, abs=0.005)  # N-K-012, eq 4.19
    assert float(blur_radius_m(u, FRONT_VIEW)) * 1e6 == pytest.approx(75.42, abs=0.005)  # E-K-06
    # A marginal ray from the rim of the lens to the image at v crosses the sensor, at f, at this height.
    height_m = FRONT_VIEW.aperture_m / 2 * (1 - FRONT_VIEW.focal_length_m / v)
    assert blur_radius_m(u, FRONT_VIEW) == pytest.approx(height_m)
    assert float(blur_radius_m(u, WIDE)) * 1e6 == pytest.approx(13.9, abs=0.05)  # N-K-013
    assert float(blur_radius_m(2.32, FRONT_VIEW)) == pytest.approx(65e-6, rel=3e-3)  # N-K-013: half a pixel


def test_diffraction_has_its_first_zero_at_1_22_lambda_f_number_and_is_negligible_beyond_three_micrometres():
    zero_m = 1.2196699 * INFRARED_M * FRONT_VIEW.f_number
    assert diffraction(zero_m, INFRARED_M, FRONT_VIEW) == pytest.approx(0, abs=1e-12)
    assert diffraction(0.0, INFRARED_M, FRONT_VIEW) == 1
    beyond = diffraction(np.linspace(3e-6, 50e-6, 50_001), INFRARED_M, FRONT_VIEW)
    assert beyond.max() * 100 == pytest.approx(0.0779, abs=5e-5)  # N-K-014


def test_a_pixel_covers_as_much_of_the_scene_as_the_numbers_say():
    covered_cm = [float(footprint_m(size_m, 20.0, FRONT_VIEW)) * 100 for size_m in (130e-6, 300e-6)]
    np.testing.assert_allclose(covered_cm, [16.7, 38.6], atol=0.05)  # N-K-015.20


def test_power_of_a_module_and_the_area_it_lights():
    assert module_power_w(0.245, 5.03e-7, 3.85e-3) == pytest.approx(1875.2, abs=0.05)  # N-K-040
    narrow, wide = (float(lit_area_m2(0.1, *np.radians(angles))) for angles in ((30, 9), (60, 18)))
    assert narrow * 1e3 == pytest.approx(0.844, abs=5e-4)  # N-K-041
    assert wide * 1e3 == pytest.approx(3.658, abs=5e-4)
    # Seen through its own lens, the sensor is lit evenly over what it images (eq 3.10).
    imaged_m2 = FRONT_VIEW.sensor_area_m2 * (7.0 / FRONT_VIEW.focal_length_m) ** 2
    assert float(lit_area_m2(7.0, *FRONT_VIEW.opening_angles_rad)) == pytest.approx(imaged_m2)


def test_what_an_eye_may_get_of_a_point_source_and_how_large_a_source_the_stated_limit_needs():
    assert float(mpe_jpm2(180e-9, 20e3, INFRARED_M)) == pytest.approx(6.077e-4, abs=5e-8)  # N-K-044
    assert float(mpe_jpm2(180e-9, 20e3, INFRARED_M, 5.06e-3)) == pytest.approx(0.00205, abs=5e-6)
    one_pulse = mpe_jpm2(180e-9, 0.05, INFRARED_M)
    assert float(one_pulse) == pytest.approx(0.01285, abs=5e-6)


def test_what_an_eye_may_get_grows_with_the_source_and_falls_with_the_rate():
    limits = mpe_jpm2(180e-9, 10e3, INFRARED_M, np.array([0.0, 0.5, 1, 2, 50, 100]) * SMALL_SOURCE_RAD)
    np.testing.assert_allclose(limits / limits[0], [1, 1, 1, 2, 50, 100 / 1.5])
    slow, fast = (float(mpe_jpm2(180e-9, rate_hz, INFRARED_M)) for rate_hz in (1e3, 16e3))
    assert slow / fast == pytest.approx(2.0)  # N^-1/4


def test_at_the_highest_rate_the_mean_of_all_pulses_is_the_limit():
    rate_hz, c4 = 55.5e3, 10**0.41
    assert float(mpe_jpm2(1e-6, rate_hz, INFRARED_M)) == pytest.approx(18 * 10**0.75 * c4 / (rate_hz * 10))


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((180e-9, 20e3, 1550e-9), "wavelength_m"),
        ((50e-6, 20e3, INFRARED_M), "pulse_width_s"),
        ((180e-9, 1e6, INFRARED_M), "repetition_hz"),
    ],
)
def test_limits_of_eye_safety_are_not_guessed_where_others_hold(arguments, name):
    with pytest.raises(UsageError, match=f"{name} = .*: the limits of eye safety are known from"):
        mpe_jpm2(*arguments)


def test_a_larger_sensor_sees_more_and_shares_the_light_among_more_area() -> None:
    large = Objective(sensor_width_m=2 * FRONT_VIEW.sensor_width_m, sensor_height_m=3 * FRONT_VIEW.sensor_height_m)
    assert large.sensor_area_m2 == pytest.approx(6 * FRONT_VIEW.sensor_area_m2)
    wide, narrow = (np.tan(np.divide(each.opening_angles_rad, 2)) for each in (large, FRONT_VIEW))
    np.testing.assert_allclose(wide / narrow, [2.0, 3.0])
    # as the beam fills what is imaged
    assert on_axis(10.0, 5.0, objective=large) == pytest.approx(on_axis(10.0, 5.0) / 6)
