"""Which pixels belong together, and what the segments measure."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import label as connected
from scipy.stats import chi2

from rangecam.clean import CleanSettings, clean, shared_noise_pixels
from rangecam.config import load_config
from rangecam.errors import DataError
from rangecam.geometry import Lens, Mounting, rays, rotation, to_world
from rangecam.processed import processed
from rangecam.segmentation import SEGMENTATION, SegmentSettings, measure_segments
from rangecam.segmentation.histogram import _minima
from rangecam.types import RangeImage, RawFrame, Why

LENS = Lens(horizontal_fov_deg=50)
LEVEL = Mounting()
SHAPE = (60, 80)


def image(range_m, sigma_m=0.01, why=None, amplitude=50.0):
    range_m = np.atleast_2d(np.asarray(range_m, np.float32))
    sigma, light = (np.broadcast_to(np.float32(plane), range_m.shape).copy() for plane in (sigma_m, amplitude))
    why = np.zeros(range_m.shape, np.uint8) if why is None else np.asarray(why, np.uint8)
    return RangeImage(0.0, range_m, sigma, light, why)


SUITED = {"connected_slices": {"slice_m": 0.7}, "k_means": {"cluster_radius_m": 4.0}}
"""What a method needs so that it does not cut the plates of these tests: no slice ends at one, a radius holds all."""


def labels_of(source, method, lens=LENS, mounting=LEVEL, **changes):
    options = SegmentSettings(**{**SUITED.get(method, {}), **changes})
    return SEGMENTATION[method](source, to_world(source, lens, mounting), options)


def measured(labels, source, lens=LENS, mounting=LEVEL, **changes):
    points = to_world(source, lens, mounting)
    return measure_segments(labels.astype(np.int32), points, source, lens, mounting, SegmentSettings(**changes))


def plates(*depths_m, shape=SHAPE, noise_m=0.0, seed=0):
    """Return an image of square plates side by side at these depths, with gaps between, and which pixel is of which."""
    range_m, number = np.full(shape, np.nan), np.zeros(shape, int)
    width = shape[1] // len(depths_m)
    for k, depth in enumerate(depths_m):
        inside = np.s_[10:-10, k * width + 2 : (k + 1) * width - 2]
        range_m[inside], number[inside] = depth / rays(LENS, shape)[inside][..., 0], k + 1
    noise = noise_m * np.random.default_rng(seed).standard_normal(shape)
    return image(range_m + noise, max(noise_m, 0.001), np.where(number > 0, 0, Why.NO_SIGNAL)), number


# --- every method


@pytest.mark.parametrize("method", SEGMENTATION)
def test_separate_plates_become_separate_segments_with_background_zero(method):
    source, number = plates(2.0, 3.0, 5.0, noise_m=0.01)
    labels = labels_of(source, method)
    assert labels.dtype == np.int32
    assert labels.shape == SHAPE
    assert_array_equal(labels, number)  # nearest first, and first in the scan


@pytest.mark.parametrize("method", SEGMENTATION)
def test_image_without_valid_pixels_has_no_segments(method):
    source = image(np.full(SHAPE, np.nan), why=np.full(SHAPE, Why.NO_SIGNAL))
    labels = labels_of(source, method)
    assert not labels.any()
    assert len(measured(labels, source)) == 0


@pytest.mark.parametrize("method", SEGMENTATION)
def test_small_segments_are_background_and_labels_have_no_gaps(method):
    source, number = plates(2.0, 3.0, 5.0)
    source.why[(number == 2)] = Why.ISOLATED
    source.why[30, 40:45] = Why.VALID
    assert set(np.unique(labels_of(source, method, min_pixels=6))) == {0, 1, 2}
    assert set(np.unique(labels_of(source, method, min_pixels=5, min_peak=1.0))) == {0, 1, 2, 3}


@pytest.mark.parametrize("method", SEGMENTATION)
def test_refused_pixels_belong_to_nothing_whatever_they_hold(method):
    source, _ = plates(2.0, 3.0)
    for value in (np.nan, np.inf, 2.0, -1e30):
        source.range_m[:5], source.why[:5] = value, Why.SATURATED
        assert not labels_of(source, method)[:5].any()


@pytest.mark.parametrize("method", SEGMENTATION)
def test_the_image_stays_as_it_was(method):
    source, _ = plates(2.0, 3.0)
    before = source.range_m.copy(), source.why.copy()
    labels_of(source, method)
    assert_array_equal(source.range_m, before[0])
    assert_array_equal(source.why, before[1])


@pytest.mark.parametrize("method", SEGMENTATION)
def test_one_pixel_can_be_a_segment(method):
    source = image([[2.0]])
    assert labels_of(source, method, min_pixels=1, min_peak=0.0, small_bin=0.1)[0, 0] == 1


# --- region growing


def grown(range_m, sigma, valid, options):
    """The rule of König 2008, 6.3, in plain Python."""
    steps = [(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)][: options.connectivity]
    labels, label = np.where(valid, -1, 0), 0
    for start in np.ndindex(range_m.shape):
        if labels[start] != -1:
            continue
        members, values = [start], [float(range_m[start])]
        labels[start] = label + 1
        for pixel in members:  # grows while it is walked
            for step in steps:
                other = pixel[0] + step[0], pixel[1] + step[1]
                if not (0 <= other[0] < range_m.shape[0] and 0 <= other[1] < range_m.shape[1]) or labels[other] != -1:
                    continue
                reach = options.growing_threshold_m + options.growing_threshold_sigmas * sigma[other]
                near_mean = abs(range_m[other] - np.mean(values)) < reach
                if near_mean or abs(range_m[other] - range_m[pixel]) < options.growing_step_m:
                    labels[other] = label + 1
                    members.append(other)
                    values.append(float(range_m[other]))
        if len(members) < options.min_pixels:
            for pixel in members:
                labels[pixel] = 0
        else:
            label += 1
    return labels


@given(
    seed=st.integers(0, 10_000),
    connectivity=st.sampled_from([4, 8]),
    threshold=st.floats(0.05, 1.0),
    sigmas=st.sampled_from([0.0, 2.0]),
    step=st.sampled_from([0.0, 0.1]),
    min_pixels=st.integers(1, 6),
)
@settings(max_examples=60, deadline=None)
def test_region_growing_is_the_rule_of_the_thesis(seed, connectivity, threshold, sigmas, step, min_pixels):
    rng = np.random.default_rng(seed)
    range_m = np.cumsum(rng.normal(0, 0.15, (9, 11)), axis=1).astype(np.float32) + 5
    sigma = rng.uniform(0.01, 0.1, (9, 11)).astype(np.float32)
    valid = rng.random((9, 11)) > 0.25
    changes = {"connectivity": connectivity, "growing_threshold_m": threshold, "growing_threshold_sigmas": sigmas,
               "growing_step_m": step, "min_pixels": min_pixels}  # fmt: skip
    labels = labels_of(image(range_m, sigma, np.where(valid, 0, Why.FLOOR)), "region_growing", **changes)
    assert_array_equal(labels, grown(range_m, sigma, valid, SegmentSettings(**changes)))


@pytest.mark.parametrize(("connectivity", "structure"), [(4, None), (8, np.ones((3, 3)))])
def test_region_growing_on_one_range_is_connected_components(connectivity, structure):
    mask = np.random.default_rng(3).random((90, 120)) > 0.55
    source = image(np.full((90, 120), 2.0), why=np.where(mask, 0, Why.NO_SIGNAL))
    labels = labels_of(source, "region_growing", connectivity=connectivity, min_pixels=1)
    expected, count = connected(mask, structure)
    assert labels.max() == count
    assert_array_equal(labels, expected)  # both number in the order of the scan


def test_inclined_wall_falls_apart_by_the_mean_rule_and_stays_whole_with_a_step():
    source = image(np.linspace(2, 6, 80) * np.ones((60, 1)))
    pieces = labels_of(source, "region_growing", growing_threshold_m=0.5)
    assert pieces.max() > 2
    assert labels_of(source, "region_growing", growing_threshold_m=0.5, growing_step_m=0.1).max() == 1


def test_threshold_that_grows_with_sigma_keeps_a_noisy_far_wall_whole():
    rng = np.random.default_rng(4)
    source = image(15 + 0.3 * rng.standard_normal(SHAPE), 0.3)
    whole = labels_of(source, "region_growing", growing_threshold_m=0.3, growing_threshold_sigmas=4.0)
    holes = labels_of(source, "region_growing", growing_threshold_m=0.3, growing_threshold_sigmas=0.0)
    assert np.mean(whole == 1) > 0.99
    assert np.mean(holes == 1) < 0.9


# --- histogram


def histogram_labels(counts, **changes):
    """Label the bins of a histogram of these counts, by an image of one row with as many pixels in each bin."""
    distance = np.repeat(0.5 * np.arange(len(counts)) + 10, counts)
    options = {"histogram_of": "range", "bin_width_m": 0.5, "smoothing_bins": 1, "min_pixels": 1, "min_peak": 1.0}
    labels = labels_of(image(distance[None]), "range_histogram", **{**options, **changes})[0]
    return [int(labels[np.cumsum([0, *counts])[k]]) if n else 0 for k, n in enumerate(counts)]


def test_a_minimum_separates_two_peaks():
    assert histogram_labels([9, 20, 9, 2, 9, 20, 9]) == [1, 1, 1, 2, 2, 2, 2]


def test_a_shoulder_is_no_minimum():
    # E-S-11: d = 1, 0, 1 fulfils the printed eq 2.14 (d_n <= 0 and d_n+1 > 0)
    assert histogram_labels([10, 20, 20, 30, 10]) == [1] * 5


def test_first_bin_is_no_minimum():
    assert histogram_labels([5, 20, 30, 5]) == [1] * 4
    assert histogram_labels([5, 5, 20, 30, 5]) == [1] * 5


def test_plateau_is_cut_in_its_middle():
    assert histogram_labels([20, 2, 2, 2, 20]) == [1, 1, 2, 2, 2]
    assert list(_minima(np.array([9.0, 1, 1, 1, 9, 1, 9]), 0, 7)) == [0, 2, 5, 7]


def test_shallow_minimum_does_not_separate():
    assert histogram_labels([20, 10, 20], max_valley_to_peak=0.4) == [1, 1, 1]
    assert histogram_labels([20, 10, 20], max_valley_to_peak=0.6) == [1, 2, 2]


def test_minima_that_differ_too_much_do_not_separate():
    counts = [20, 9, 20, 1, 20]
    assert histogram_labels(counts, max_valley_difference=0.5) == [1, 2, 2, 3, 3]
    assert histogram_labels(counts, max_valley_difference=0.3) == [1, 1, 1, 2, 2]


def test_very_small_bins_are_borders_and_background():
    assert histogram_labels([20, 1, 1, 1, 20], small_bin=1.0) == [1, 0, 0, 0, 2]


def test_low_and_small_peaks_are_background():
    counts = [20, 0, 3, 3, 0, 20]
    assert histogram_labels(counts, min_peak=4.0) == [1, 0, 0, 0, 0, 2]
    assert histogram_labels(counts, min_pixels=7) == [1, 0, 0, 0, 0, 2]
    assert histogram_labels(counts) == [1, 0, 2, 2, 0, 3]


def test_smoothing_bridges_what_single_bins_miss():
    counts = [9, 0, 9, 0, 9, 0, 9]
    assert max(histogram_labels(counts)) == 4
    assert max(histogram_labels(counts, smoothing_bins=5)) == 1


def test_a_plane_ahead_is_one_peak_of_depth_and_many_bins_of_range():
    lens = Lens(horizontal_fov_deg=90)
    source = image(2 / rays(lens, SHAPE)[..., 0])
    depth, radial = (
        len(np.unique(np.round(plane / 0.05))) for plane in (to_world(source, lens, LEVEL)[..., 0], source.range_m)
    )
    assert depth == 1 < 10 < radial
    peak = {"smoothing_bins": 1, "min_peak": 1000.0}
    assert (labels_of(source, "range_histogram", lens, histogram_of="depth", **peak) == 1).all()
    assert not labels_of(source, "range_histogram", lens, histogram_of="range", **peak).any()


def test_objects_at_one_distance_become_one():
    # S-SEG-04
    source, number = plates(3.0, 3.0)
    labels = labels_of(source, "range_histogram")
    assert labels.max() == 1
    assert_array_equal(labels > 0, number > 0)


def test_distances_that_need_too_many_bins_are_an_error():
    source = image([[1.0, 1e6]])
    with pytest.raises(DataError, match="at most 10000: check the data"):
        labels_of(source, "range_histogram", histogram_of="range")


# --- measurement


@pytest.mark.parametrize(("yaw_deg", "tolerance_m"), [(0, 0.01), (15, 0.03)])
def test_a_plate_is_measured_where_it_is_and_as_large_as_it_is(yaw_deg, tolerance_m):
    """Seen at an angle the mean leans to the nearer side, where the pixels are denser on the plate."""
    mounting = Mounting(x_m=1.0, y_m=-0.4, z_m=1.2, pitch_deg=8 * yaw_deg / 15, yaw_deg=yaw_deg)
    ray = rays(LENS, SHAPE) @ rotation(mounting).T
    range_m = (4.0 - 1.0) / ray[..., 0]  # a wall at x = 4
    y, z = -0.4 + range_m * ray[..., 1], 1.2 + range_m * ray[..., 2]
    labels = ((np.abs(y - 0.3) < 0.5) & (np.abs(z - 0.9) < 0.4)).astype(int)
    segments = measured(labels, image(range_m), mounting=mounting)
    assert_allclose(segments.position_m[0], [4.0, 0.3, 0.9], atol=tolerance_m)
    assert_allclose(segments.size_m[0], [0.0, 1.0, 0.8], atol=0.06)  # a pixel is 0.035 m there
    assert segments.near_m[0] == pytest.approx(4.0, abs=1e-3)
    assert segments.n_pixels[0] == labels.sum()
    rows, columns = np.nonzero(labels)
    assert_array_equal(segments.box[0], [rows.min(), columns.min(), rows.max() + 1, columns.max() + 1])
    assert segments.range_m[0] == pytest.approx(range_m[labels > 0].mean(), rel=1e-6)
    assert segments.amplitude[0] == pytest.approx(50)
    assert_array_equal(segments.label, [1])


@pytest.mark.parametrize("lens", [LENS, Lens(horizontal_fov_deg=50, projection="equiangular")], ids=repr)
@pytest.mark.parametrize("columns", [1, 2, 7])
def test_size_counts_whole_pixels(lens, columns):
    labels = np.zeros(SHAPE, int)
    labels[30, 40 : 40 + columns] = 1
    segment = measured(labels, image(2.0 / rays(lens, SHAPE)[..., 0]), lens, shared_noise_pixels=1.0)[0]
    pixel = 2.0 * (2 * np.tan(np.radians(25)) if lens is LENS else np.radians(50)) / 80
    assert_allclose(segment.size_m[1:], [columns * pixel, pixel], rtol=0.01)
    assert segment.size_m[0] == pytest.approx(0, abs=1e-3)


def test_noise_makes_a_flat_plate_neither_thick_nor_near():
    labels = np.ones(SHAPE, int)
    rng = np.random.default_rng(7)
    source = image(3.0 / rays(LENS, SHAPE)[..., 0] + 0.05 * rng.standard_normal(SHAPE), 0.05)
    segment = measured(labels, source)[0]
    assert segment.size_m[0] < 0.1  # the extent of the noise alone would be 0.35
    assert segment.near_m == pytest.approx(3.0, abs=0.02)  # the quantile of the noise alone would be 0.08 nearer


@given(st.integers(0, 1000), st.floats(0.01, 0.5))
@settings(max_examples=25, deadline=None)
def test_nearest_distance_is_a_quantile_of_x(seed, fraction):
    rng = np.random.default_rng(seed)
    range_m = 2 + rng.gamma(2.0, 0.3, SHAPE)
    source = image(range_m)
    segment = measured(np.ones(SHAPE, int), source, near_fraction=fraction)[0]
    x = to_world(source, LENS, LEVEL)[..., 0]
    assert np.mean(x < segment.near_m) == pytest.approx(fraction, abs=0.03)
    assert np.ptp(x) / 32 + np.quantile(x, fraction) > segment.near_m > np.quantile(x, fraction) - np.ptp(x) / 32


def test_a_few_stray_pixels_do_not_move_the_nearest_distance():
    range_m = 3.0 / rays(LENS, SHAPE)[..., 0]
    range_m[::10, ::10] = 1.0  # 1 % of the pixels
    assert measured(np.ones(SHAPE, int), image(range_m))[0].near_m > 2.8


def test_position_is_unbiased_though_near_pixels_say_they_are_better():
    """Weights 1/sigma^2 with sigma proportional to the measured range would pull the mean nearer by 2 sigma^2/range."""
    rng, errors = np.random.default_rng(8), []
    for _ in range(20):
        range_m = 5.0 + 0.5 * rng.standard_normal((40, 50))
        source = image(range_m, 0.1 * range_m)
        errors.append(measured(np.ones((40, 50), int), source, Lens(horizontal_fov_deg=0.1))[0].position_m[0] - 5.0)
    assert abs(np.mean(errors)) < 4 * 0.5 / np.sqrt(20 * 2000)


@pytest.mark.parametrize("filtered", [{"filter": "off"}, {"window": "3x1"}, {"window": "3x3"}])
def test_range_of_a_segment_scatters_as_its_sigma_says_after_each_median(filtered):
    """Chi-square of 600 plates of 20 x 20 pixels against the stated sigma, which includes what the median shares."""
    shared = shared_noise_pixels(CleanSettings(**filtered))
    rng, z = np.random.default_rng(9), []
    lens = Lens(horizontal_fov_deg=2)
    for _ in range(600):
        source = image(4.0 + 0.05 * rng.standard_normal((20, 20)), 0.05)
        source = clean(source, lens, LEVEL, CleanSettings(**filtered))
        segment = measured(np.ones((20, 20), int), source, lens, shared_noise_pixels=shared, sigma_systematic_m=0.0)[0]
        z.append((segment.range_m - 4.0) / segment.sigma_range_m)
    total = np.sum(np.square(z))
    assert 0.9 * chi2.ppf(0.001, 600) < total < 1.1 * chi2.ppf(0.999, 600)  # 10 %: shared noise depends on the shape


def test_what_no_number_of_pixels_makes_smaller_remains():
    segment = measured(np.ones(SHAPE, int), image(np.full(SHAPE, 3.0), 1e-6), sigma_systematic_m=0.02)[0]
    assert segment.sigma_range_m == pytest.approx(0.02)
    few = measured(
        np.eye(3, dtype=int), image(np.full((3, 3), 3.0), 0.05), shared_noise_pixels=9.0, sigma_systematic_m=0.0
    )
    assert few.sigma_range_m[0] == pytest.approx(0.05)  # three pixels that share their noise are as good as one


def test_lateral_sigma_is_a_fixed_part_and_the_jitter_of_the_outline():
    labels = np.zeros(SHAPE, int)
    labels[20:36, 39:41] = 1
    lens = Lens(horizontal_fov_deg=50, projection="equiangular")
    segment = measured(labels, image(np.full(SHAPE, 3.0)), lens, sigma_pixel=0.02, edge_jitter=0.4, edge_step=0.0)[0]
    pixel = np.radians(50) / 80 * 3.0
    lateral, vertical = np.sqrt(np.diag(segment.covariance_m2))[1:]
    assert lateral == pytest.approx(pixel * np.hypot(0.02, 0.4 / np.sqrt(2 * 16)), rel=0.01)
    assert vertical == pytest.approx(pixel * np.hypot(0.02, 0.4 / np.sqrt(2 * 2)), rel=0.02)


@pytest.mark.parametrize("cut", [False, True])
def test_a_straight_edge_anywhere_between_two_columns_scatters_the_centroid_as_stated(cut):
    """A box at any place covers whole columns: its centroid is off by the mean of two even errors, cut off by one."""
    rng, error, stated = np.random.default_rng(11), [], 0.0
    lens = Lens(horizontal_fov_deg=20, projection="equiangular")
    pitch, ranges = np.radians(20) / 80, image(np.full((20, 80), 3.0))
    for _ in range(600):
        left, right = rng.uniform(8, 20), rng.uniform(50, 60)
        left = 0.0 if cut else left
        labels = np.zeros((20, 80), int)
        labels[5:15, round(left) : round(right)] = 1
        segment = measured(labels, ranges, lens, sigma_pixel=0.0, edge_jitter=0.0)[0]
        error.append(segment.position_m[1] - 3.0 * pitch * (40 - (left + right) / 2))
        stated = np.sqrt(segment.covariance_m2[1, 1])
    assert np.std(error) == pytest.approx(stated, rel=0.1)


def test_outline_that_flickers_scatters_the_centroid_as_stated():
    """Each end of each row jitters by whole pixels of standard deviation 0.7: the lateral sigma holds within 10 %."""
    rng, y, stated = np.random.default_rng(10), [], 0.0
    lens = Lens(horizontal_fov_deg=50, projection="equiangular")
    source = image(np.full((20, 80), 3.0))
    for _ in range(800):
        labels = np.zeros((20, 80), int)
        first, last = (edge + rng.choice([-1, 0, 1], 20, p=[0.245, 0.51, 0.245]) for edge in (30, 50))
        for row in range(20):
            labels[row, first[row] : last[row]] = 1
        segment = measured(labels, source, lens, sigma_pixel=0.0, edge_jitter=0.7, edge_step=0.0)[0]
        y.append(segment.position_m[1])
        stated = np.sqrt(segment.covariance_m2[1, 1])
    assert np.std(y) == pytest.approx(stated, rel=0.1)


def test_covariance_turns_with_the_camera():
    labels = np.ones((8, 8), int)
    lens = Lens(horizontal_fov_deg=10)
    source = image(np.full((8, 8), 5.0), 0.2)
    ahead = measured(labels, source, lens)[0].covariance_m2
    for mounting, axis in ((Mounting(yaw_deg=90), 1), (Mounting(pitch_deg=90), 2)):
        turned = measured(labels, source, lens, mounting)[0].covariance_m2
        assert turned[axis, axis] == pytest.approx(ahead[0, 0], rel=1e-6)
        assert_allclose(turned, rotation(mounting) @ ahead @ rotation(mounting).T, atol=1e-9)


def test_pixels_without_amplitude_have_a_segment_without_one():
    assert np.isnan(measured(np.ones((4, 4), int), image(np.ones((4, 4)), amplitude=np.nan))[0].amplitude)


def test_planes_of_other_types_measure_the_same():
    source, number = plates(2.0, 3.0)
    double = RangeImage(0.0, source.range_m.astype(float), source.sigma_m.astype(float), source.amplitude, source.why)
    assert_allclose(measured(number, double).position_m, measured(number, source).position_m)


# --- real cameras

DATA = Path(os.environ.get("RANGECAM_DATA", ""))
needs = pytest.mark.skipif(not (DATA / "terabee_overhead").is_dir(), reason="RANGECAM_DATA names no recordings")


def perceive(planes, preset):
    config = load_config(preset)
    lens, mounting = config.camera.lens, config.mounting
    seen = clean(processed(RawFrame(0.0, planes), config.camera), lens, mounting, config.clean)
    points = to_world(seen, lens, mounting)
    labels = SEGMENTATION[config.segmentation](seen, points, config.segments)
    return measure_segments(labels, points, seen, lens, mounting, config.segments)


@needs
def test_two_people_below_a_camera_are_two_segments_and_an_empty_floor_is_none():
    frames = np.load(DATA / "terabee_overhead" / "two_people_cross.npz")["range_mm"] / 1000
    count = [len(perceive({"range_m": frame}, "terabee_overhead")) for frame in frames]
    assert count[52:55] == [2, 2, 2]
    assert not any(count[:44])
    assert not any(count[58:])
    for frame in frames[52:55]:
        assert (np.abs(perceive({"range_m": frame}, "terabee_overhead").position_m[:, 2] - 1.5) < 0.3).all()


@needs
@pytest.mark.parametrize("name", ["A0", "A2", "A4"])
def test_wall_before_a_drone_is_one_segment_near_the_axis(name):
    flight = np.load(DATA / "vl53l5cx_flights" / f"{name}.npz")
    drone, surface = flight["vicon_Drone"], flight["vicon_Surface"]
    time_s = np.arange(drone[0, 0], drone[-1, 0], 0.1)
    gap = np.interp(time_s, drone[:, 0], surface[:, 1].mean() - drone[:, 1])
    seen_s = flight["time_s"] - 0.08  # the sensor's lag
    gap, speed = np.interp(seen_s, time_s, gap), np.interp(seen_s, time_s, np.gradient(gap, time_s))
    found, errors = [], []
    for k in np.flatnonzero((speed < -0.25) & (gap > 0.4) & (gap < 3)):
        planes = {key: flight[key][k] for key in ("status", "targets")} | {"range_m": flight["range_mm"][k] / 1000}
        x, y, z = perceive(planes, "vl53l5cx").position_m.T
        wall = np.abs(x / gap[k] - 1) < 0.25
        found.append(wall.sum() == 1 and (np.hypot(y, z) < np.tan(np.radians(15)) * x)[wall].all())
        errors.extend(x[wall] - gap[k])
    assert np.mean(found) > 0.98
    assert abs(np.median(errors)) < 0.03


@needs
def test_person_in_a_room_is_one_segment_before_the_wall():
    recorded = np.load(DATA / "adtf3175" / "person_mode2.npz")
    planes = {"depth_m": recorded["depth_mm"] / 1000, "amplitude": recorded["ab"] * 1.0, "confidence": recorded["conf"]}
    segments = perceive(planes, "adtf3175")
    person = segments[int(np.argmax(segments.n_pixels))]
    assert person.n_pixels > 40_000
    assert person.range_m == pytest.approx(0.95, abs=0.15)
    assert len(segments) < 25
