"""What each way of finding segments is good and bad at, and what none of them may do."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from rangecam.errors import DataError
from rangecam.geometry import Lens, Mounting, rays, to_world
from rangecam.segmentation import SEGMENTATION, SegmentSettings, measure_segments, segment
from rangecam.types import RangeImage, Tracks, TrackStatus, Why

LENS = Lens(horizontal_fov_deg=50)
LEVEL = Mounting()
SHAPE = (60, 80)
METHODS = pytest.mark.parametrize("method", SEGMENTATION)


def image(range_m, sigma_m=0.01, why=None, amplitude=50.0):
    range_m = np.atleast_2d(np.asarray(range_m, np.float32))
    sigma, light = (np.broadcast_to(np.float32(plane), range_m.shape).copy() for plane in (sigma_m, amplitude))
    why = np.zeros(range_m.shape, np.uint8) if why is None else np.asarray(why, np.uint8)
    return RangeImage(0.0, range_m, sigma, light, why)


def labels_of(source, method, **changes):
    return SEGMENTATION[method](source, to_world(source, LENS, LEVEL), SegmentSettings(**changes))


def measured(labels, source):
    return measure_segments(labels, to_world(source, LENS, LEVEL), source, LENS, LEVEL, SegmentSettings())


def at_depth(depth_m, shape=SHAPE):
    return np.broadcast_to(depth_m, shape) / rays(LENS, shape)[..., 0]


def assert_sound(segments):
    for name, field in vars(segments).items():
        assert np.isfinite(field).all(), name


# --- nothing may crash any of them


@METHODS
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1)])
def test_the_smallest_images_have_segments(method, shape):
    source = image(np.full(shape, 2.0))
    labels = labels_of(source, method, min_pixels=1, min_peak=0.0, small_bin=0.1)
    assert labels.shape == shape
    assert_sound(measured(labels, source))


@METHODS
def test_an_image_without_pixels_has_no_segments(method):
    source = image(np.zeros((0, 5)))
    labels = labels_of(source, method)
    assert labels.shape == (0, 5)
    assert len(measured(labels, source)) == 0


@METHODS
def test_ranges_that_are_no_numbers_get_into_no_segment(method):
    range_m = at_depth(3.0).copy()
    range_m[10:20, 10:20], range_m[30, 30], range_m[0, 0] = np.nan, np.inf, np.nan
    source = image(range_m)
    labels = labels_of(source, method, min_pixels=1, min_peak=0.0)
    segments = measured(labels, source)
    assert len(segments) > 0
    assert_sound(segments)
    assert segments.n_pixels.sum() >= 0.9 * np.isfinite(range_m).sum()


def test_a_segment_of_nothing_but_holes_is_left_out_and_the_others_keep_their_labels():
    source = image(at_depth(3.0).copy())
    labels = np.zeros(SHAPE, np.int32)
    labels[:10], labels[20:30], labels[40:50] = 1, 2, 3
    source.range_m[20:30], source.range_m[40, 5] = np.nan, np.nan
    segments = measured(labels, source)
    assert_array_equal(segments.label, [1, 3])
    assert_array_equal(segments.n_pixels, [800, 799])
    assert_sound(segments)


@METHODS
def test_a_thousand_segments_at_once_are_no_problem(method):
    shape = (130, 160)
    depth = 2.0 + 2.0 * (np.arange(160) // 5 % 2) + 4.0 * (np.arange(130)[:, None] // 4 % 2)
    there = (np.arange(160) % 5 < 4) & (np.arange(130)[:, None] % 4 < 3)
    source = image(at_depth(depth, shape), why=np.where(there, 0, Why.NO_SIGNAL))
    labels = labels_of(source, method, min_pixels=3, bandwidth_m=0.1, slice_m=0.7)
    segments = measured(labels, source)
    assert_sound(segments)
    if method not in ("range_histogram", "mean_shift", "k_means"):
        assert len(segments) == 32 * 33
    assert segments.n_pixels.sum() == np.count_nonzero(labels)


# --- what each can do, and cannot


def ramp(incidence_deg, shape=SHAPE):
    """Return an upright wall whose normal is turned from the view by an angle, nearest on the left, 6 m on the axis."""
    tangent = np.tan(np.radians(incidence_deg))
    ray = rays(LENS, shape)
    return 6.0 / (ray[..., 0] + tangent * ray[..., 1])


def test_an_inclined_wall_stays_whole_in_3d_and_falls_apart_by_mean_and_slices():
    source = image(ramp(45.0) + 0.01 * np.random.default_rng(1).standard_normal(SHAPE))
    assert labels_of(source, "region_growing_3d").max() == 1
    assert labels_of(source, "region_growing").max() > 1
    assert labels_of(source, "connected_slices").max() > 3


@pytest.mark.parametrize(("incidence_deg", "whole"), [(60.0, True), (85.0, False)])
def test_the_largest_incidence_is_where_a_surface_ends(incidence_deg, whole):
    ranges = 5.0 * (1 + np.tan(np.radians(incidence_deg)) * np.radians(50) / 40) ** np.arange(40)
    found = labels_of(image(np.tile(ranges, (8, 1))[:, ::-1].copy(), 1e-4), "region_growing_3d", min_pixels=1)
    assert (found.max() == 1) == whole


def test_a_step_is_told_from_noise_by_its_sigma():
    rng = np.random.default_rng(2)
    range_m = at_depth(np.where(np.arange(80) < 40, 5.0, 5.6))
    sharp = labels_of(image(range_m + 0.01 * rng.standard_normal(SHAPE), 0.01), "region_growing_3d")
    blurred = labels_of(image(range_m + 0.3 * rng.standard_normal(SHAPE), 0.3), "region_growing_3d")
    assert (sharp.max(), blurred.max()) == (2, 1)


def test_amplitude_tells_apart_what_range_does_not():
    # K-SEG-07
    light = np.where(np.arange(80) < 40, 50.0, 120.0)
    source = image(at_depth(3.0), amplitude=light)
    assert labels_of(source, "region_growing_3d").max() == 1
    labels = labels_of(source, "region_growing_3d", amplitude_difference=0.5)
    assert_array_equal(labels, np.broadcast_to(np.where(np.arange(80) < 40, 1, 2), SHAPE))


@pytest.mark.parametrize("method", ["region_growing_3d", "connected_slices", "k_means"])
def test_corners_join_pixels_only_where_eight_neighbours_count(method):
    range_m = np.full((8, 8), 4.0)
    touching = np.zeros((8, 8), bool)
    touching[:4, :4] = touching[4:, 4:] = True
    source = image(range_m, why=np.where(touching, 0, Why.NO_SIGNAL))
    assert labels_of(source, method, connectivity=8, cluster_radius_m=5.0).max() == 1
    assert labels_of(source, method, connectivity=4, cluster_radius_m=5.0).max() == 2


def test_objects_at_one_distance_become_one_in_the_histogram_alone():
    # S-SEG-04
    there = (np.arange(80) < 25) | (np.arange(80) > 54)
    source = image(at_depth(4.0), why=np.where(np.broadcast_to(there, SHAPE), 0, Why.NO_SIGNAL))
    number = {method: labels_of(source, method, slice_m=0.75, cluster_radius_m=5.0).max() for method in SEGMENTATION}
    assert number == {**dict.fromkeys(SEGMENTATION, 2), "range_histogram": 1}


def test_the_histogram_keeps_things_apart_that_stand_farther_apart_than_its_gap():
    columns, rows = np.broadcast_to(np.arange(80), SHAPE), np.arange(60)[:, None]
    left, middle, right = (columns < 25) & (rows >= 0), (columns == 40) & (rows < 4), (columns > 54) & (rows < 20)
    source = image(at_depth(4.0), why=np.where(left | middle | right, 0, Why.NO_SIGNAL))
    pixel_m = 2 * np.tan(np.radians(25)) * 4.0 / 80
    for gap, labels in (
        (14.5, (1, 2, 3)),
        (15.5, (1, 2, 2)),
        (16.5, (1, 1, 1)),
    ):  # 16 and 15 columns from one to the next
        found = labels_of(source, "range_histogram", max_gap_m=gap * pixel_m, min_pixels=1)
        assert_array_equal(found, labels[0] * left + labels[1] * middle + labels[2] * right)
    found = labels_of(source, "range_histogram", max_gap_m=14.5 * pixel_m, min_pixels=10)
    assert_array_equal(found, 1 * left + 2 * right)  # what is too small is background


def test_an_object_on_the_border_of_two_slices_is_cut_there():
    source = image(at_depth(4.0) + 0.05 * np.random.default_rng(3).standard_normal(SHAPE), 0.05)
    assert labels_of(source, "connected_slices", slice_m=0.5, min_pixels=1).max() > 1
    assert labels_of(source, "connected_slices", slice_m=0.7).max() == 1
    assert labels_of(source, "connected_slices", slice_m=0.7, histogram_of="range").max() >= 1


def test_mean_shift_bridges_a_gap_that_growing_does_not():
    off = np.abs(np.arange(80) - 40)
    there = (off > 2) & (off < 14) & (np.abs(np.arange(60)[:, None] - 30) < 10)
    source = image(at_depth(4.0), why=np.where(there, 0, Why.NO_SIGNAL))
    assert labels_of(source, "mean_shift", bandwidth_m=1.2).max() == 1
    assert labels_of(source, "region_growing_3d").max() == 2


def test_k_means_cuts_what_is_larger_than_its_radius():
    source = image(at_depth(4.0))
    assert labels_of(source, "k_means", cluster_radius_m=3.0).max() == 1
    assert labels_of(source, "k_means", cluster_radius_m=0.8).max() > 3


@pytest.mark.parametrize("method", ["mean_shift", "k_means"])
def test_points_that_need_too_many_cells_are_an_error(method):
    with pytest.raises(DataError, match="check the data, or set segments"):
        labels_of(image([[1.0, 1e6], [1e5, 1e6]]), method, bandwidth_m=0.01, cluster_radius_m=0.1)


# --- seeds from tracks


def two_that_touch():
    """Return a view of two people of half a metre side by side at 4 m, which touch, and the column between them."""
    range_m = at_depth(4.0)
    there = (np.abs(np.arange(80) - 40) < 11) & (np.arange(60)[:, None] > 10)
    return image(range_m, why=np.where(there, 0, Why.NO_SIGNAL)), 40


def tracks_at(*positions, speed=(0.0, 0.0, 0.0), status=TrackStatus.CONFIRMED, time_s=0.0):
    n = len(positions)
    state = np.zeros((n, 9))
    state[:, [0, 3, 6]], state[:, [1, 4, 7]] = positions, speed
    empty = Tracks.empty()
    fields = {name: np.zeros((n, *array.shape[1:]), array.dtype) for name, array in vars(empty).items()
              if isinstance(array, np.ndarray)}  # fmt: skip
    fields |= {"state": state, "status": np.full(n, status), "track_id": np.arange(1, n + 1)}
    return Tracks(**fields, time_s=time_s)


def seeded(source, tracks, **changes):
    points = to_world(source, LENS, LEVEL)
    return segment("region_growing_seeded", source, points, SegmentSettings(**changes), tracks)


def test_people_who_touch_stay_apart_where_tracks_are_expected():
    source, between = two_that_touch()
    labels = seeded(source, tracks_at([4.0, -0.3, 0.0], [4.0, 0.3, 0.0]))
    assert labels.max() == 2
    assert (labels[:, between + 2 :][source.valid[:, between + 2 :]] == 1).all()  # in the order of the tracks
    assert (labels[:, : between - 2][source.valid[:, : between - 2]] == 2).all()
    assert_array_equal(labels > 0, source.valid)
    assert labels_of(source, "region_growing_seeded").max() == 1


def test_tracks_are_looked_for_where_they_will_be():
    source, _ = two_that_touch()
    moved = tracks_at([4.0, -1.3, 0.0], [4.0, -0.7, 0.0], speed=(0.0, 1.0, 0.0), time_s=-1.0)
    assert seeded(source, moved).max() == 2
    assert seeded(source, tracks_at([4.0, -1.3, 0.0], [4.0, -0.7, 0.0])).max() == 1


@pytest.mark.parametrize(
    "tracks",
    [
        tracks_at([4.0, -0.3, 0.0], [4.0, 0.3, 0.0], status=TrackStatus.TENTATIVE),
        tracks_at([4.0, 0.0, 0.0], [4.0, 0.1, 0.0]),
        tracks_at([9.0, 0.3, 0.0], [9.0, -0.3, 0.0]),
        Tracks.empty(),
    ],
    ids=["tentative", "twice the same", "far away", "none"],
)
def test_tracks_that_say_nothing_new_cut_nothing(tracks):
    source, _ = two_that_touch()
    assert_array_equal(seeded(source, tracks), labels_of(source, "region_growing_3d"))


def test_methods_without_seeds_do_not_look_at_the_tracks():
    source, _ = two_that_touch()
    points = to_world(source, LENS, LEVEL)
    labels = segment("region_growing", source, points, SegmentSettings(), tracks_at([4.0, 0.3, 0.0]))
    assert_array_equal(labels, labels_of(source, "region_growing"))


def test_growing_in_3d_does_not_depend_on_where_the_vehicle_is():
    source = image(ramp(30.0), 0.01)
    there = Mounting(x_m=2.0, y_m=-1.0, z_m=1.5, pitch_deg=12, yaw_deg=40)
    points = to_world(source, LENS, there)
    assert_array_equal(
        SEGMENTATION["region_growing_3d"](source, points, SegmentSettings()), labels_of(source, "region_growing_3d")
    )
    assert_allclose(points.shape, (*SHAPE, 3))
