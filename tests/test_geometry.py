"""Pixels, rays, points and their covariances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rangecam.geometry import (
    Lens,
    Mounting,
    pixel_pitch,
    point_covariance,
    polar,
    position,
    rays,
    rotation,
    to_world,
    vehicle_rays,
)
from rangecam.types import RangeImage

ANGLES = st.floats(-180, 180)
LENSES = [
    Lens(horizontal_fov_deg=60),
    Lens(horizontal_fov_deg=80, vertical_fov_deg=60, projection="equiangular"),
    Lens(horizontal_fov_deg=30, vertical_fov_deg=9),
    Lens(horizontal_fov_deg=45, projection="equiangular"),
]


def image(range_m):
    range_m = np.asarray(range_m, np.float32)
    ones = np.ones_like(range_m)
    return RangeImage(0.0, range_m, 0.01 * ones, ones, np.zeros(range_m.shape, np.uint8))


def cartesian(azimuth, elevation, range_m):
    """Eq 6.5 of König 2008."""
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1) * range_m[..., None]


def printed_rotation(phi, theta, psi):
    """Eq 6.9 of König 2008 as printed."""
    (cf, sf), (ct, stt), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (phi, theta, psi))
    return np.array(
        [
            [ct * cp, ct * sp, -sf],
            [sf * stt * cp - cf * sp, sf * stt * sp - cf * cp, sf * ct],
            [cf * stt * cp - sf * sp, cf * stt * sp - sf * cp, cf * ct],
        ]
    )


def corrected_rotation(phi, theta, psi):
    """Eq 6.9 with E-K-18: vehicle axes to camera axes."""
    (cf, sf), (ct, stt), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (phi, theta, psi))
    return np.array(
        [
            [ct * cp, ct * sp, -stt],
            [sf * stt * cp - cf * sp, sf * stt * sp + cf * cp, sf * ct],
            [cf * stt * cp + sf * sp, cf * stt * sp - sf * cp, cf * ct],
        ]
    )


@given(ANGLES, ANGLES, ANGLES)
def test_rotation_is_a_rotation_and_the_transpose_of_the_corrected_thesis_matrix(roll, pitch, yaw):
    matrix = rotation(Mounting(roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw))
    assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)
    assert_allclose(matrix.T, corrected_rotation(*np.radians([roll, pitch, yaw])), atol=1e-12)


def test_printed_rotation_is_no_rotation_even_at_zero_angles():
    assert np.linalg.det(printed_rotation(0.0, 0.0, 0.0)) == pytest.approx(-1)
    skew = printed_rotation(0.2, 0.3, 0.4)
    assert np.abs(skew @ skew.T - np.eye(3)).max() > 0.1


def test_pitch_tilts_the_view_down_and_yaw_turns_it_left():
    ahead = np.array([1.0, 0.0, 0.0])
    assert_allclose(rotation(Mounting(pitch_deg=90)) @ ahead, [0, 0, -1], atol=1e-15)
    assert_allclose(rotation(Mounting(yaw_deg=90)) @ ahead, [0, 1, 0], atol=1e-15)
    assert_allclose(rotation(Mounting(roll_deg=90)) @ [0, 1, 0], [0, 0, 1], atol=1e-15)


def test_camera_centre_is_the_origin_of_the_camera_but_not_with_the_printed_translation():
    mounting = Mounting(x_m=1.5, y_m=-0.3, z_m=1.2, pitch_deg=5, yaw_deg=20)
    to_camera = rotation(mounting).T
    centre = position(mounting)
    assert_allclose(to_world(image([[0.0]]), Lens(), mounting)[0, 0], centre, rtol=1e-6)
    assert_allclose(to_camera @ (centre - centre), 0)  # P_C = R (P_W - T), E-K-19
    assert np.linalg.norm(to_camera @ centre + centre) > 1  # P_C = R P_W + T as printed in eq 6.6


@pytest.mark.parametrize("lens", LENSES, ids=repr)
@pytest.mark.parametrize("shape", [(8, 64), (60, 80), (1, 5)])
def test_points_in_camera_axes_are_ray_times_range(lens, shape):
    mounting = Mounting(x_m=2.0, y_m=0.5, z_m=1.0, roll_deg=3, pitch_deg=10, yaw_deg=-25)
    range_m = np.random.default_rng(1).uniform(0.5, 20, shape)
    points = to_world(image(range_m), lens, mounting)
    assert points.shape == (*shape, 3)
    assert points.dtype == np.float32
    back = (points - position(mounting)) @ rotation(mounting)
    assert_allclose(back, rays(lens, shape) * range_m[..., None], atol=2e-5)
    azimuth, elevation, radius = polar(back)
    assert_allclose(radius, range_m, rtol=1e-5)
    assert_allclose(cartesian(azimuth, elevation, radius), back, atol=1e-9)


def test_pixels_without_a_range_have_no_point_and_the_image_stays_as_it_was():
    range_m = np.array([[1.0, np.nan]], np.float32)
    source = image(range_m)
    points = to_world(source, Lens(), Mounting())
    assert np.isfinite(points[0, 0]).all()
    assert np.isnan(points[0, 1]).all()
    assert np.array_equal(source.range_m, range_m, equal_nan=True)


def test_to_world_takes_other_types_and_strides():
    range_m = np.arange(1.0, 25.0).reshape(4, 6)
    source = image(range_m)
    turned = RangeImage(0.0, range_m.T.copy().T, source.sigma_m, source.amplitude, source.why)
    assert_allclose(to_world(turned, Lens(), Mounting()), to_world(source, Lens(), Mounting()))


@pytest.mark.parametrize("lens", LENSES, ids=repr)
def test_first_pixel_looks_up_and_left_and_the_image_is_symmetric(lens):
    ray = rays(lens, (6, 8))
    assert ray[0, 0, 1] > 0
    assert ray[0, 0, 2] > 0
    assert_allclose(np.linalg.norm(ray, axis=-1), 1)
    assert_allclose(ray[::-1, ::-1] * [1, -1, -1], ray, atol=1e-15)
    assert not vehicle_rays(lens, Mounting(), (6, 8)).flags.writeable


@pytest.mark.parametrize(
    ("fov_deg", "printed_deg", "exact_deg", "error_m"), [(29.95, 4.413, 4.263, 0.052), (59.4, 9.335, 8.128, 0.416)]
)
def test_elevation_counts_from_the_plane_of_the_horizontal_angle(fov_deg, printed_deg, exact_deg, error_m):
    # N-K-091: the upper corner of two lenses; eq 6.3 prints arctan(y_S / f)
    tan_h = np.tan(np.radians(fov_deg / 2))
    tan_v = np.tan(np.radians(printed_deg))
    corner = np.array([1.0, tan_h, tan_v])
    azimuth, elevation, _ = polar(corner)
    assert np.degrees(elevation) == pytest.approx(exact_deg, abs=2e-3)
    exact = 20 * corner / np.linalg.norm(corner)
    assert_allclose(cartesian(azimuth, elevation, np.array(20.0)), exact, rtol=1e-12)
    wrong = cartesian(azimuth, np.radians(printed_deg), np.array(20.0))
    assert wrong[2] - exact[2] == pytest.approx(error_m, abs=2e-3)


def test_covariance_in_camera_axes_has_the_signs_of_the_jacobian():
    # N-K-082: phi = 12, theta = 3 deg, 15 m, 0.29 px of a 29.95 x 8.83 deg lens, sigma_d 10 cm
    pitch = 2 * np.tan(np.radians([29.95 / 2, 8.83 / 2])) / [64, 8]
    across, down = np.degrees(pitch * [64, 8])
    lens = Lens(horizontal_fov_deg=across, vertical_fov_deg=down, projection="equiangular")
    point = cartesian(*np.radians([[12.0], [3.0]]), np.array([15.0]))
    sigmas = np.array([[0.29, 0.29, 0.1]])
    covariance = point_covariance(point, sigmas, lens, Mounting(), (8, 64))[0]
    assert covariance[0, 1] == pytest.approx(1.76e-3, rel=0.01)
    assert covariance[0, 2] == pytest.approx(1.51e-4, rel=0.02)
    assert covariance[1, 2] == pytest.approx(3.21e-5, rel=0.02)


def test_covariance_with_the_printed_signs_is_not_that_of_many_noisy_angles():
    # E-K-22: N-K-082's angles and range, scattered; table 6.2 prints all angular terms with a plus
    rng, mean, sigma = np.random.default_rng(6), np.array([*np.radians([12.0, 3.0]), 15.0]), np.array([0.01, 0.01, 0.1])
    azimuth, elevation, range_m = (mean + sigma * rng.standard_normal((400_000, 3))).T
    scattered = np.cov(cartesian(azimuth, elevation, range_m).T)
    (ca, sa), (ce, se) = ((np.cos(a), np.sin(a)) for a in mean[:2])
    columns = [[-15 * sa * ce, -15 * ca * se, ca * ce], [15 * ca * ce, -15 * sa * se, sa * ce], [0.0, 15 * ce, se]]
    corrected, printed = np.array(columns) * sigma, np.abs(columns) * sigma
    assert_allclose(corrected @ corrected.T, scattered, atol=3e-4)
    assert np.abs(printed @ printed.T - scattered).max() > 2e-3


def test_the_printed_angles_of_a_pixel_are_those_of_the_image_turned_on_its_side():
    # E-S-02: alpha = (x - 60) / 2 with x across 160 columns leaves the lens of 60 degrees; rows belong to 60
    lens = Lens(horizontal_fov_deg=80, vertical_fov_deg=60, projection="equiangular")
    azimuth, elevation, _ = polar(rays(lens, (120, 160)))
    rows, columns = np.indices((120, 160))
    assert_allclose(np.degrees(elevation), -(rows - 59.5) * 0.5, atol=1e-9)
    assert_allclose(np.degrees(azimuth), -(columns - 79.5) * 0.5, atol=1e-9)
    assert np.max((columns - 60) * 0.5) == 49.5 > np.degrees(elevation).max()


def test_the_product_of_cosines_is_no_depth_of_a_perspective_pixel():
    # E-S-03: -5.3 % in the corner for angles of each axis, -21 cm on a plane at 4 m
    ray = rays(Lens(horizontal_fov_deg=80, vertical_fov_deg=60), (120, 160))[0, 0]
    exact = 1 / np.linalg.norm(ray / ray[0])
    printed = np.cos(np.arctan2(ray[1], ray[0])) * np.cos(np.arctan2(ray[2], ray[0]))
    assert ray[0] == pytest.approx(exact)
    assert printed / exact - 1 == pytest.approx(-0.053, abs=0.003)


@pytest.mark.parametrize("lens", LENSES, ids=repr)
def test_covariance_is_that_of_many_noisy_pixels(lens):
    """Pixel position and range scattered 100,000 times, for points within 20 degrees of the axis of a turned camera."""
    shape, mounting = (60, 80), Mounting(x_m=1.0, z_m=1.5, roll_deg=4, pitch_deg=30, yaw_deg=50)
    rng = np.random.default_rng(2)
    pitch = np.array(pixel_pitch(lens, shape))
    for across, up in ((0.0, 0.0), (0.12, 0.05), (-0.2, 0.06)):
        noise = rng.standard_normal((100_000, 3)) * [0.4, 0.3, 0.05]
        a, b = across + noise[:, 0] * pitch[0], up + noise[:, 1] * pitch[1]
        if lens.projection == "perspective":
            direction = np.stack([np.ones_like(a), a, b], -1)
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            centre = np.array([1.0, across, up]) / np.linalg.norm([1.0, across, up])
        else:
            direction = cartesian(a, b, np.ones_like(a))
            centre = cartesian(np.array(across), np.array(up), np.array(1.0))
        points = (direction * (6 + noise[:, 2:])) @ rotation(mounting).T + position(mounting)
        expected = np.cov(points.T)
        point = (6 * centre @ rotation(mounting).T + position(mounting))[None]
        found = point_covariance(point, np.array([[0.4, 0.3, 0.05]]), lens, mounting, shape)[0]
        # of independent angles: the cross term of a perspective lens is below a hundredth of the variances here
        assert_allclose(found, expected, atol=0.015 * np.trace(expected))
        assert_allclose(found, found.T)


@pytest.mark.parametrize(("sigma_px", "on_axis_urad", "edge_urad"), [(0.015, 125.4, 117.0), (0.05, 418.0, 390.0)])
def test_angular_sigma_of_a_pixel_is_smaller_at_the_edge_of_a_perspective_lens(sigma_px, on_axis_urad, edge_urad):
    # N-K-081
    lens, shape = Lens(horizontal_fov_deg=29.95, vertical_fov_deg=8.83), (8, 64)
    edge = np.radians(29.95 / 2)
    points = np.array([[15.0, 0.0, 0.0], [15 * np.cos(edge), 15 * np.sin(edge), 0.0]])
    covariance = point_covariance(points, np.full((2, 3), [sigma_px, 0, 0]), lens, Mounting(), shape)
    assert np.sqrt(covariance[0, 1, 1]) / 15 * 1e6 == pytest.approx(on_axis_urad, rel=2e-3)
    assert np.sqrt(np.trace(covariance[1])) / 15 * 1e6 == pytest.approx(edge_urad, rel=2e-3)


def test_pitch_of_square_pixels_is_the_same_both_ways():
    for projection in ("perspective", "equiangular"):
        across, down = pixel_pitch(Lens(horizontal_fov_deg=50, projection=projection), (30, 40))
        assert across == down


def test_no_points_have_no_covariance():
    assert point_covariance(np.empty((0, 3)), np.empty((0, 3)), Lens(), Mounting(), (4, 4)).shape == (0, 3, 3)
