"""Claims about lens and radiometry."""

import numpy as np
import pytest

from rangecam.geometry import Lens, rays
from rangecam.optics import Objective, ambient_on_sensor, irradiance_on_sensor, natural_vignetting

FRONT_VIEW = Objective()


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
        (Objective(focal_length_m=7.30e-3, aperture_m=7.60e-3), 0.9605, (59.35, 18.67)),
    ],
)
def test_the_two_lenses_have_the_printed_f_number_and_opening_angles(objective, f_number, fov_deg):
    assert objective.f_number == pytest.approx(f_number, abs=5e-5)  # N-K-011
    size = np.array([objective.sensor_width_m, objective.sensor_height_m])
    angles = np.degrees(2 * np.arctan(size / 2 / objective.focal_length_m))
    np.testing.assert_allclose(angles, fov_deg, atol=0.005)
    assert FRONT_VIEW.sensor_area_m2 * 1e6 == pytest.approx(19.968)  # N-K-010


def test_full_sun_on_white_gives_the_known_irradiance_at_any_range():
    one = np.ones(1)
    assert ambient_on_sensor(1000.0, one, one, FRONT_VIEW)[0] == pytest.approx(389.0, rel=1e-3)  # N-K-098


def test_ambient_light_is_vignetted_like_any_other():
    cos_axis = np.array([1.0, 0.9, 0.5])
    seen = ambient_on_sensor(50.0, np.ones(3), cos_axis, FRONT_VIEW)
    np.testing.assert_allclose(seen / seen[0], natural_vignetting(cos_axis))
    np.testing.assert_allclose(natural_vignetting(cos_axis), [1, 0.6561, 0.0625])
