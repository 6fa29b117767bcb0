"""Lenses that distort, and rays from a table, against OpenCV and against each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rangecam.config import load_config, overrides, parse
from rangecam.errors import DataError, UsageError
from rangecam.geometry import Lens, Mounting, pixel_of, pixel_pitch, pixel_steps, point_covariance, position, rays
from rangecam.geometry import rotation as turned
from rangecam.geometry.distortion import distort, undistort
from rangecam.segmentation import SegmentSettings, measure_segments
from rangecam.types import RangeImage

SHAPE = (60, 80)
BARREL = Lens(
    horizontal_fov_deg=75, k1=-0.28, k2=0.09, k3=-0.015, p1=0.003, p2=-0.002, axis_right=0.03, axis_down=-0.02
)
PINCUSHION = Lens(horizontal_fov_deg=60, k1=0.1, k2=0.05, p1=-0.002)
BENT = pytest.mark.parametrize("lens", [BARREL, PINCUSHION], ids=["barrel", "pincushion"])


def opencv_of(lens, shape):
    """Camera matrix and coefficients in OpenCV's order k1, k2, p1, p2, k3; its pixels are whole at their centres."""
    (height, width), (across, down) = shape, pixel_pitch(lens, shape)
    cx, cy = width * (0.5 + lens.axis_right) - 0.5, height * (0.5 + lens.axis_down) - 0.5
    return np.array([[1 / across, 0, cx], [0, 1 / down, cy], [0, 0, 1]]), np.array(
        [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
    )


@BENT
def test_rays_are_the_undistorted_points_of_opencv(lens):
    cv2 = pytest.importorskip("cv2")
    rows, columns = np.indices(SHAPE)
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(float)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 300, 1e-12)
    undistorted = cv2.undistortPoints(pixels, *opencv_of(lens, SHAPE), criteria=criteria).reshape(*SHAPE, 2)
    ray = rays(lens, SHAPE)
    assert_allclose(-ray[..., 1:] / ray[..., :1], undistorted, atol=1e-8)


@BENT
def test_pixels_are_the_projected_points_of_opencv(lens):
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(1).uniform([2, -1, -0.7], [9, 1, 0.7], (200, 3))
    optical = points[:, [1, 2, 0]] * [-1, -1, 1]
    projected = cv2.projectPoints(optical, np.zeros(3), np.zeros(3), *opencv_of(lens, SHAPE))[0][:, 0]
    row, column = pixel_of(points, lens, SHAPE)
    assert_allclose(np.stack([column, row], axis=-1), projected, atol=1e-9)


def plain(**changes):
    return Lens(horizontal_fov_deg=70, **changes)


@pytest.mark.parametrize(
    "lens",
    [plain(), plain(projection="equiangular", vertical_fov_deg=40, axis_down=0.1), BARREL, PINCUSHION],
    ids=["perspective", "equiangular", "barrel", "pincushion"],
)
def test_every_ray_comes_back_to_its_pixel(lens, tmp_path):
    ray, indices = rays(lens, SHAPE).reshape(-1, 3), np.indices(SHAPE).reshape(2, -1)
    assert_allclose(pixel_of(3 * ray, lens, SHAPE), indices, atol=1e-6)
    np.savez(tmp_path / "lens.npz", rays=rays(lens, SHAPE))
    table = Lens(table=str(tmp_path / "lens.npz"))
    assert_allclose(pixel_of(3 * ray, table, SHAPE), indices, atol=1e-6)


@given(st.floats(-0.2, 0.2), st.floats(-0.05, 0.05), st.floats(-0.01, 0.01), st.floats(-0.9, 0.9), st.floats(-0.9, 0.9))
@settings(max_examples=80, deadline=None)
def test_undistortion_is_the_inverse_of_distortion(k1, k2, p1, x, y):
    seen_x, seen_y, jacobian = distort(np.array([x]), np.array([y]), (k1, k2, 0.0, p1, -p1))
    back = undistort(seen_x, seen_y, (k1, k2, 0.0, p1, -p1))
    assert_allclose(back, [[x], [y]], atol=1e-8)
    h = 1e-6
    for k, step in enumerate(([h, 0], [0, h])):
        more = distort(np.array([x + step[0]]), np.array([y + step[1]]), (k1, k2, 0.0, p1, -p1))[:2]
        assert_allclose(jacobian[0, :, k], [(more[0] - seen_x)[0] / h, (more[1] - seen_y)[0] / h], atol=1e-5)


def test_a_lens_that_folds_the_image_over_is_refused():
    with pytest.raises(UsageError, match=r"k1 = -0.6: the image is folded over at \d+ of 4800 pixels"):
        rays(Lens(horizontal_fov_deg=100, k1=-0.6), SHAPE)
    row, column = pixel_of(np.array([[1.0, 2.0, 0.0], [1.0, 0.1, 0.0]]), Lens(horizontal_fov_deg=40, k1=-0.6), SHAPE)
    assert np.isnan(row[0])
    assert 0 < column[1] < 80


def test_distortion_of_an_equiangular_lens_is_refused():
    with pytest.raises(UsageError, match="k1, k2, k3, p1, p2 are of a perspective lens"):
        rays(Lens(projection="equiangular", k1=0.1), SHAPE)


def test_the_axis_beside_the_centre_shifts_the_image():
    shifted = rays(Lens(axis_right=0.25, axis_down=0.1), (40, 40))
    assert_allclose(shifted[4:, 10:], rays(Lens(), (40, 40))[:-4, :-10])


def test_distortion_can_be_set_like_anything_else():
    config = load_config("generic_cw", overrides(["camera.lens.projection=perspective", "camera.lens.k1=-0.1"]))
    assert config.camera.lens.k1 == -0.1
    with pytest.raises(UsageError, match=r"axis_right = 0\.7"):
        parse(Lens, {"axis_right": 0.7}, "lens")


# --- tables


def saved(tmp_path, name="lens.npz", **arrays):
    np.savez(tmp_path / name, **arrays)
    return Lens(table=str(tmp_path / name))


def test_rays_of_a_table_are_those_in_the_file_whatever_their_length(tmp_path):
    ray = rays(BARREL, SHAPE)
    table = saved(tmp_path, rays=ray * np.random.default_rng(2).uniform(0.5, 2, (*SHAPE, 1)))
    assert_allclose(rays(table, SHAPE), ray, atol=1e-12)
    assert not rays(table, SHAPE).flags.writeable


def test_rays_within_a_pixel_of_a_table_are_those_of_the_lens(tmp_path):
    fine = (SHAPE[0] * 3, SHAPE[1] * 3)
    table = saved(tmp_path, rays=rays(BARREL, SHAPE))
    off = np.degrees(np.arccos(np.clip(np.sum(rays(table, fine) * rays(BARREL, fine), axis=-1), -1, 1)))
    assert off[6:-6, 6:-6].max() < 0.01  # of a pixel of about 1 degree
    assert off.max() < 0.1  # straight on beyond the outer centres
    assert_allclose(rays(saved(tmp_path, "one.npz", rays=[[[2.0, 0, 0]]]), (2, 3)), np.full((2, 3, 3), [1.0, 0, 0]))


@pytest.mark.parametrize(
    ("arrays", "error", "match"),
    [
        ({"x": np.ones(3)}, DataError, "not a NumPy archive with an array 'rays'"),
        ({"rays": np.ones((4, 5))}, DataError, "must be finite numbers"),
        ({"rays": np.full((4, 5, 3), np.nan)}, DataError, "must be finite numbers"),
        ({"rays": np.zeros((4, 5, 3))}, DataError, "length zero"),
        ({"rays": np.ones((7, 5, 3))}, UsageError, "rays of 7 x 5 pixels do not fit an image of 60 x 80"),
    ],
)
def test_tables_that_hold_no_rays_of_the_camera_are_refused(tmp_path, arrays, error, match):
    with pytest.raises(error, match=match):
        rays(saved(tmp_path, **arrays), SHAPE)


def test_a_table_that_is_not_there_or_is_garbage_is_refused(tmp_path):
    with pytest.raises(UsageError, match="there is no such file"):
        rays(Lens(table=str(tmp_path / "none.npz")), SHAPE)
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 rubbish")
    with pytest.raises(DataError, match="not a NumPy archive"):
        rays(Lens(table=str(tmp_path / "bad.npz")), SHAPE)


# --- what follows from the rays


def test_steps_of_a_plain_lens_are_its_pitch_on_the_axis():
    lens = Lens(horizontal_fov_deg=50)
    steps = pixel_steps(lens, (61, 81))[30, 40]
    assert_allclose(
        steps, [[0, -pixel_pitch(lens, (61, 81))[0], 0], [0, 0, -pixel_pitch(lens, (61, 81))[1]]], rtol=1e-3, atol=1e-12
    )
    for shape in ((1, 9), (9, 1)):
        across, down = np.linalg.norm(pixel_steps(lens, shape)[shape[0] // 2, shape[1] // 2], axis=-1)
        assert across == pytest.approx(down)


@BENT
@pytest.mark.parametrize("as_table", [False, True])
def test_covariance_is_that_of_many_noisy_pixels_of_the_bent_lens(lens, as_table, tmp_path):
    mounting, rng = Mounting(x_m=1.0, z_m=1.5, roll_deg=4, pitch_deg=30, yaw_deg=50), np.random.default_rng(3)
    for row, column in ((30, 40), (6, 70), (52, 8)):
        noise = rng.standard_normal((60_000, 3)) * [0.4, 0.3, 0.05]
        (across, down), (height, width) = pixel_pitch(lens, SHAPE), SHAPE
        shown_x = (column + noise[:, 0] - width * (0.5 + lens.axis_right) + 0.5) * across
        shown_y = (row + noise[:, 1] - height * (0.5 + lens.axis_down) + 0.5) * down
        x, y = undistort(shown_x, shown_y, (lens.k1, lens.k2, lens.k3, lens.p1, lens.p2))
        ray = np.stack([np.ones_like(x), -x, -y], axis=-1)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        expected = np.cov(turned(mounting) @ (ray * (6 + noise[:, 2:])).T)
        point = (6 * rays(lens, SHAPE)[row, column] @ turned(mounting).T + position(mounting))[None]
        used = saved(tmp_path, rays=rays(lens, SHAPE)) if as_table else lens
        found = point_covariance(point, np.array([[0.4, 0.3, 0.05]]), used, mounting, SHAPE)[0]
        assert_allclose(found, expected, atol=0.015 * np.trace(expected))


def test_bent_and_plain_covariance_agree_where_the_distortion_vanishes():
    point = np.array([[5.0, 0.7, -0.4], [3.0, -1.0, 0.5]])
    sigmas = np.full((2, 3), [0.3, 0.4, 0.02])
    bent = replace(Lens(), k1=1e-12)
    expected = point_covariance(point, sigmas, Lens(), Mounting(), SHAPE)
    found = point_covariance(point, sigmas, bent, Mounting(), SHAPE)
    assert_allclose(found, expected, atol=0.02 * np.trace(expected[0]))


@BENT
def test_a_plate_seen_through_a_bent_lens_is_measured_where_it_is_and_as_large_as_it_is(lens):
    ray = rays(lens, SHAPE)
    range_m = (4.0 / ray[..., 0]).astype(np.float32)
    points = (ray * range_m[..., None]).astype(np.float32)
    labels = ((np.abs(points[..., 1] - 1.0) < 0.5) & (np.abs(points[..., 2] + 0.6) < 0.4)).astype(np.int32)
    ones = np.ones_like(range_m)
    source = RangeImage(0.0, range_m, 1e-3 * ones, ones, np.zeros(SHAPE, np.uint8))
    one = measure_segments(labels, points, source, lens, Mounting(), SegmentSettings(shared_noise_pixels=1.0))[0]
    assert_allclose(one.position_m, [4.0, 1.0, -0.6], atol=0.06)
    assert_allclose(one.size_m[1:], [1.0, 0.8], atol=0.1)  # a pixel is 0.09 m there


@BENT
def test_solid_angles_of_the_pixels_add_up_to_that_of_the_image(lens):
    from rangecam.scene.weather import pixel_solid_angles

    fine = (SHAPE[0] * 4, SHAPE[1] * 4)
    assert pixel_solid_angles(lens, SHAPE).sum() == pytest.approx(pixel_solid_angles(lens, fine).sum(), rel=2e-3)
    unbent = Lens(horizontal_fov_deg=60)
    almost = Lens(horizontal_fov_deg=60, k1=1e-9)
    assert_allclose(
        pixel_solid_angles(almost, SHAPE)[1:-1, 1:-1], pixel_solid_angles(unbent, SHAPE)[1:-1, 1:-1], rtol=1e-3
    )


def test_recordings_tell_other_tools_of_the_distortion(tmp_path):
    from rangecam.io.results import _calibration

    message = _calibration(BARREL, SHAPE, 0.0)
    matrix, coefficients = opencv_of(BARREL, SHAPE)
    assert_allclose(message.K, matrix.ravel())
    assert_allclose(message.D, coefficients)
    assert message.distortion_model == "plumb_bob"
    assert _calibration(saved(tmp_path, rays=rays(BARREL, SHAPE)), SHAPE, 0.0).distortion_model == "table"
