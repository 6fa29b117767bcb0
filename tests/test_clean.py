"""Cleaning: what is refused, why, and how sigma stays true."""

import itertools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import maximum_filter, median_filter, minimum_filter
from scipy.stats import norm

import rangecam.clean
from rangecam.cameras.simulated import frames
from rangecam.clean import FILTERS, STAGES, CleanSettings, clean, clean_stages, shared_noise_pixels
from rangecam.clean.limits import area_of_interest, fit_floor, floor_limit, reference_amplitude
from rangecam.clean.median import median
from rangecam.clean.neighbours import Kept
from rangecam.clean.onepass import WIDEST
from rangecam.config import load_config
from rangecam.geometry import Lens, Mounting, rays, rotation, to_world
from rangecam.pipeline import RANGING
from rangecam.scene.paths import Path as Way
from rangecam.scene.render import ray_bundle, render
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, Cylinder, SceneObject
from rangecam.types import RangeImage, Why

WIDE = Lens(horizontal_fov_deg=80, vertical_fov_deg=60, projection="equiangular")
LENS = Lens(horizontal_fov_deg=50)
LEVEL = Mounting()
OFF = {"min_neighbours": 0, "filter": "off"}


def image(range_m, sigma_m=0.01, amplitude=100.0, why=None):
    range_m = np.atleast_2d(np.asarray(range_m, np.float32))
    full = [np.broadcast_to(np.float32(plane), range_m.shape).copy() for plane in (sigma_m, amplitude)]
    why = np.zeros(range_m.shape, np.uint8) if why is None else np.asarray(why, np.uint8)
    return RangeImage(3.0, range_m, *full, why)


def cleaned(source, lens=LENS, mounting=LEVEL, **changes):
    return clean(source, lens, mounting, CleanSettings(**changes))


def reasons(result):
    return [[Why(code).name for code in row] for row in result.why]


def wall(shape, range_m=3.0, sigma_m=0.02, seed=0):
    return image(range_m + sigma_m * np.random.default_rng(seed).standard_normal(shape), sigma_m)


# --- amplitude


def test_reference_amplitude_is_that_of_the_appendix():
    # N-S-028: rows and columns off the centre (59, 79) in steps of half a degree
    def at(row, column):
        angles = np.radians(0.5 * np.abs([column - 79.0, row - 59.0]))
        return float(reference_amplitude(*angles, CleanSettings()))

    assert at(59, 79) == pytest.approx(145.00, abs=0.005)
    assert at(0, 79) == pytest.approx(61.08, abs=0.005)
    assert at(59, 0) == pytest.approx(31.99, abs=0.005)
    assert at(0, 0) == pytest.approx(18.32, abs=0.005)
    assert at(119, 159) == pytest.approx(17.64, abs=0.005)


def test_reference_amplitude_has_a_level_a_floor_and_a_falloff():
    angle = np.radians(60.0)
    flat = CleanSettings(reference_amplitude=200.0, reference_floor=0.25, reference_falloff=0.0)
    assert reference_amplitude(angle, 0.0, flat) == pytest.approx(200)
    steep = CleanSettings(reference_amplitude=200.0, reference_floor=0.25, reference_falloff=2.0)
    assert reference_amplitude(angle, 0.0, steep) == pytest.approx(200 * (0.25 + 0.75 / 4))


def test_white_plane_passes_up_to_the_range_where_its_light_falls_below_the_first_threshold():
    # N-S-054: rho / z^2 > c_th1; rho = 0.3 at 4 m needs c_th1 < 0.0187
    for threshold, passes in ((0.0185, True), (0.0190, False)):
        seen = cleaned(image([[4.0]], amplitude=145 * 0.3 / 16), Lens(horizontal_fov_deg=1.0),
                       amplitude_threshold=threshold, **OFF)  # fmt: skip
        assert seen.valid.all() == passes
        assert passes or seen.why[0, 0] == Why.LOW_AMPLITUDE


def test_amplitude_threshold_follows_the_vignetting():
    shape = (120, 160)
    ray = rays(WIDE, shape)
    azimuth, elevation = np.arctan2(ray[..., 1], ray[..., 0]), np.arcsin(ray[..., 2])
    grey = 0.3 * reference_amplitude(azimuth, elevation, CleanSettings())
    for threshold, valid in ((0.299, True), (0.301, False)):
        assert (
            cleaned(image(np.ones(shape), amplitude=grey), WIDE, amplitude_threshold=threshold, **OFF).valid == valid
        ).all()


def test_wrapped_objects_send_too_little_light_for_their_range():
    # N-S-036: white at 8.8235 m + x reads x; A x^2 against white
    unambiguous = 3e8 / 2 / 17e6
    lens = Lens(horizontal_fov_deg=0.1)
    for x, relative in ((0.5, 0.0029), (1, 0.0104), (2, 0.0341), (3, 0.0644), (4, 0.0973), (5, 0.1308)):
        source = image([[x]], amplitude=145 / (unambiguous + x) ** 2)
        assert cleaned(source, lens, wrap_threshold=relative * 1.02, **OFF).why[0, 0] == Why.WRAPPED
        assert cleaned(source, lens, wrap_threshold=relative * 0.98, **OFF).valid.all()


def test_wrap_threshold_counts_the_depth_so_that_a_plane_passes_or_fails_as_a_whole():
    # N-S-048, E-S-22: the radial distance would be 2.04 times off in the corner
    shape = (120, 160)
    ray = rays(WIDE, shape)
    azimuth, elevation = np.arctan2(ray[..., 1], ray[..., 0]), np.arcsin(ray[..., 2])
    depth = 2.0
    amplitude = 0.5 * reference_amplitude(azimuth, elevation, CleanSettings()) / depth**2
    source = image(depth / ray[..., 0], amplitude=amplitude)
    assert cleaned(source, WIDE, wrap_threshold=0.499, **OFF).valid.all()
    assert (cleaned(source, WIDE, wrap_threshold=0.501, **OFF).why == Why.WRAPPED).all()


def test_unknown_amplitude_passes_every_threshold():
    source = image(np.ones((3, 3)), amplitude=np.nan)
    assert cleaned(source, amplitude_threshold=0.5, wrap_threshold=0.5, **OFF).valid.all()


# --- common neighbours


def common_neighbours(range_m, valid, tolerance):
    """Eqs 2.8-2.9 of Steinbäck 2016 in plain loops."""
    count = np.zeros(range_m.shape, int)
    for (i, j), value in np.ndenumerate(range_m):
        for k, m in itertools.product((-1, 0, 1), repeat=2):
            inside = 0 <= i + k < range_m.shape[0] and 0 <= j + m < range_m.shape[1]
            if (k, m) != (0, 0) and inside and valid[i + k, j + m]:
                count[i, j] += abs(range_m[i + k, j + m] - value) <= tolerance
    return count


@given(st.integers(0, 8), st.floats(0, 0.5), st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_pixels_with_too_few_common_neighbours_are_isolated(needed, tolerance, seed):
    rng = np.random.default_rng(seed)
    range_m = rng.uniform(1, 2, (7, 9)).astype(np.float32)
    why = np.where(rng.random((7, 9)) < 0.2, Why.NO_SIGNAL, 0)
    result = cleaned(image(range_m, why=why), filter="off", min_neighbours=needed,
                     neighbour_tolerance_m=tolerance, neighbour_tolerance_sigmas=0.0)  # fmt: skip
    count = common_neighbours(range_m.astype(float), why == 0, tolerance)
    inner = np.s_[1:-1, 1:-1]
    expected = np.where(why != 0, why, np.where(count < needed, Why.ISOLATED, 0))
    assert_array_equal(result.why[inner], expected[inner])


def test_pixels_at_the_border_need_the_same_share_of_the_neighbours_they_have():
    def left(needed):
        return cleaned(image(np.ones((3, 3))), filter="off", min_neighbours=needed).valid

    assert left(8).all()  # 8 of 8, 5 of 5, 3 of 3
    lonely = image([[1.0, 1.0, 5.0], [1.0, 5.0, 5.0], [5.0, 5.0, 5.0]])
    result = cleaned(lonely, filter="off", min_neighbours=5)
    assert result.why[0, 0] == Why.VALID  # ceil(5 * 3 / 8) = 2 of its 3
    assert result.why[0, 1] == Why.ISOLATED  # 2 of its 5, ceil(5 * 5 / 8) = 4
    assert cleaned(image([[1.0, 1.0, 1.0, 9.0]]), filter="off", min_neighbours=4).why[0, -1] == Why.ISOLATED


def test_border_can_be_refused_as_a_whole():
    result = cleaned(image(np.ones((4, 5))), filter="off", discard_border=True)
    assert (result.why[1:-1, 1:-1] == Why.VALID).all()
    assert (result.why == Why.BORDER).sum() == 14


def test_tolerance_grows_with_the_noise_of_both_pixels():
    pair = np.array([[2.0, 2.3]])
    exact = {"filter": "off", "min_neighbours": 1, "neighbour_tolerance_m": 0.0, "neighbour_tolerance_sigmas": 3.0}
    assert cleaned(image(pair, 0.3 / 3 / np.sqrt(2) * 1.01), **exact).valid.all()
    assert not cleaned(image(pair, 0.3 / 3 / np.sqrt(2) * 0.99), **exact).valid.any()


def test_neighbours_below_the_amplitude_threshold_still_count_as_the_image_before_thresholding():
    amplitude = np.full((3, 3), 1.0)
    amplitude[1, 1] = 100.0
    result = cleaned(
        image(np.ones((3, 3)), amplitude=amplitude), filter="off", min_neighbours=8, amplitude_threshold=0.1
    )
    assert result.why[1, 1] == Why.VALID
    assert (result.why == Why.LOW_AMPLITUDE).sum() == 8


def test_a_pixel_between_two_surfaces_is_isolated():
    range_m = np.full((9, 9), 2.0)
    range_m[:, 5:] = 4.0
    range_m[:, 4] = np.linspace(2.6, 3.4, 9)  # flying pixels of a vertical edge
    result = cleaned(image(range_m))
    assert (result.why[:, 4] == Why.ISOLATED).all()
    assert (np.delete(result.why, 4, axis=1) == 0).all()


# --- median


def middle(around):
    """Return median and sigma of the pixel in the middle of (3, 3, 3): range, reach and 1/sigma of nine pixels."""
    one, seen, never = np.zeros((1, 1), np.float32), np.zeros((1, 1), np.uint8), np.full((1, 1), np.inf, np.float32)
    rim = np.pad(np.asarray(around, np.float32), ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    found, sigma = median(Kept(one, one, one, seen, rim, never), CleanSettings())
    return found[0, 0], sigma[0, 0]


def test_network_takes_the_median_of_every_arrangement_of_zeros_and_ones():
    """N-S-043: a network that takes the median of all 512 arrangements of 0 and 1 takes it of all values."""
    around = np.empty((3, 3, 3), np.float32)
    around[1], around[2] = 10.0, 1.0
    for bits in itertools.product((0.0, 1.0), repeat=9):
        around[0] = np.reshape(bits, (3, 3))
        assert middle(around)[0] == np.median(bits)


def pairs_around(i, j, window, common):
    """Return the pixel and those opposite neighbours that are both common: a list of (row, column)."""
    half = [(0, 1)] if window == "3x1" else [(0, 1), (1, -1), (1, 0), (1, 1)]
    pairs = [((i - k, j - m), (i + k, j + m)) for k, m in half]
    return [(i, j), *(pixel for pair in pairs if all(map(common, pair)) for pixel in pair)]


@given(st.integers(0, 10_000), st.sampled_from(["3x3", "3x1"]), st.sampled_from(["median", "mean"]))
@settings(max_examples=60, deadline=None)
def test_median_and_mean_are_those_of_the_pairs_of_valid_common_neighbours(seed, window, name):
    rng = np.random.default_rng(seed)
    range_m = np.where(rng.random((6, 7)) < 0.5, 2.0, 2.8) + rng.normal(0, 0.05, (6, 7))
    range_m, sigma = range_m.astype(np.float32), rng.uniform(0.01, 0.05, (6, 7)).astype(np.float32)
    valid = rng.random((6, 7)) > 0.2
    source = image(np.where(valid, range_m, 77), sigma, why=np.where(valid, 0, Why.SATURATED))
    result = cleaned(source, filter=name, window=window, min_neighbours=0, neighbour_tolerance_m=0.2,
                     neighbour_tolerance_sigmas=2.0)  # fmt: skip
    for i, j in np.argwhere(valid):

        def common(pixel, i=i, j=j):
            if not (0 <= pixel[0] < 6 and 0 <= pixel[1] < 7 and valid[pixel]):
                return False
            return abs(range_m[pixel] - range_m[i, j]) <= 0.2 + np.sqrt(2) * (sigma[pixel] + sigma[i, j])

        values = [range_m[pixel] for pixel in pairs_around(i, j, window, common)]
        assert result.range_m[i, j] == pytest.approx({"median": np.median, "mean": np.mean}[name](values), rel=1e-6)
    assert_array_equal(result.valid, valid)
    assert_array_equal(result.sigma_m[~valid], sigma[~valid])


def test_median_across_edges_is_the_plain_median_of_scipy():
    range_m = np.random.default_rng(4).uniform(1, 9, (12, 15)).astype(np.float32)
    result = cleaned(image(range_m), min_neighbours=0, median_across_edges=True)
    inner = np.s_[1:-1, 1:-1]
    assert_array_equal(result.range_m[inner], median_filter(range_m, 3)[inner])


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_pixels_skipped_because_they_see_the_floor_are_those_that_the_floor_refuses_after_the_median(seed):
    """The same scene, cleaned without a floor and then cut at its limit, is the oracle of the shortcut."""
    rng, shape, mounting = np.random.default_rng(seed), (24, 41), Mounting(z_m=0.5)
    limit = floor_limit(np.ones(shape), np.zeros(shape, np.uint8), WIDE, mounting, CleanSettings(floor="mounting"))
    sigma = rng.uniform(0.005, 0.05, shape)
    range_m = np.minimum(limit, 4.0) * rng.uniform(0.9, 1.1) + sigma * rng.standard_normal(shape)
    source = image(range_m, sigma, why=np.where(rng.random(shape) < 0.2, Why.NO_SIGNAL, 0))
    result = cleaned(source, WIDE, mounting, floor="mounting")
    whole = cleaned(source, WIDE, mounting)
    sees_floor = whole.valid & (whole.range_m + 2 * whole.sigma_m > limit)
    assert_array_equal(result.why, np.where(sees_floor, Why.FLOOR, whole.why))
    for name in ("range_m", "sigma_m"):
        assert_array_equal(getattr(result, name)[result.valid], getattr(whole, name)[result.valid])


def scattered(seed, shape, missing):
    """Return an image of a floor with steps, holes, and noise and light that differ from pixel to pixel."""
    rng = np.random.default_rng(seed)
    limit = floor_limit(np.ones(shape), np.zeros(shape, np.uint8), WIDE, RAISED, CleanSettings(floor="mounting"))
    sigma = rng.uniform(0.005, 0.05, shape) * rng.choice([1, 3])
    steps = np.where(rng.random((shape[0] // 5 + 1, shape[1] // 7 + 1)) < 0.5, 1.5, 1.1).repeat(5, 0).repeat(7, 1)
    range_m = np.minimum(limit, 4.0) * steps[: shape[0], : shape[1]] * rng.uniform(0.6, 1.0)
    why = np.where(rng.random(shape) < missing, Why.SATURATED, 0)
    range_m = np.where((why != 0) & (rng.random(shape) < 0.5), np.nan, range_m + sigma * rng.standard_normal(shape))
    return image(range_m, sigma, rng.uniform(1, 100, shape), why)


RAISED = Mounting(z_m=0.5)


@given(
    st.integers(0, 10_000),
    st.tuples(st.integers(1, 30), st.integers(1, 70)),
    st.sampled_from([0.0, 0.02, 0.3, 0.95, 1.0]),
    st.fixed_dictionaries(
        {
            "floor": st.sampled_from(["off", "mounting"]),
            "window": st.sampled_from(["3x1", "3x3"]),
            "median_across_edges": st.booleans(),
            "min_neighbours": st.integers(0, 8),
            "discard_border": st.booleans(),
            "reject_flying": st.booleans(),
            "amplitude_threshold": st.sampled_from([0.0, 0.05]),
            "wrap_threshold": st.sampled_from([0.0, 0.5]),
            "x_max_m": st.sampled_from([None, 1.5]),
        }
    ),
)
@settings(max_examples=150, deadline=None)
def test_one_pass_gives_bit_for_bit_what_the_stages_give_one_after_the_other(seed, shape, missing, changes):
    source = scattered(seed, shape, missing)
    with pytest.MonkeyPatch.context() as patch:
        quick = cleaned(source, WIDE, RAISED, **changes)
        patch.setattr(rangecam.clean, "WIDEST", 0)
        stages = cleaned(source, WIDE, RAISED, **changes)
    assert_array_equal(quick.why, stages.why)
    for name in ("range_m", "sigma_m"):
        assert_array_equal(getattr(quick, name)[quick.valid], getattr(stages, name)[quick.valid])
        assert_array_equal(getattr(quick, name)[~source.valid], getattr(source, name)[~source.valid])


@pytest.mark.parametrize("columns", [WIDEST - 1, WIDEST, WIDEST + 1])
def test_an_image_of_any_width_is_cleaned_as_its_left_and_right_part_are(columns):
    source = wall((12, columns), sigma_m=0.05)
    result = cleaned(source)
    for part in (np.s_[:, :600], np.s_[:, 500:]):
        alone = cleaned(image(source.range_m[part], 0.05))
        inner = np.s_[:, 3:-3]
        for name in ("range_m", "sigma_m", "why"):
            assert_array_equal(getattr(alone, name)[inner], getattr(result, name)[part][inner])


def test_median_does_not_fill_what_is_invalid():
    why = np.zeros((5, 5))
    why[2, 2] = Why.SATURATED
    result = cleaned(image(np.ones((5, 5)), why=why))
    assert result.why[2, 2] == Why.SATURATED
    assert result.valid.sum() == 24


@pytest.mark.parametrize("missing", [0.0, 0.3, 0.6])
def test_a_noisy_wall_with_holes_keeps_its_range(missing):
    """No bias from markers (+28 mm) or lower ranks (-8 mm): below 1 mm at a noise of 100 mm."""
    rng = np.random.default_rng(5)
    source = wall((300, 300), sigma_m=0.1, seed=6)
    why = np.where(rng.random((300, 300)) < missing, Why.LOW_AMPLITUDE, 0)
    source = image(np.where(why == 0, source.range_m, 12.5), 0.1, why=why)
    result = cleaned(source, min_neighbours=0)
    assert abs(result.range_m[result.valid].mean() - 3.0) < 0.001


@pytest.mark.parametrize("number", [1, 3, 5, 7, 9])
def test_sigma_of_the_median_of_n_values_is_exact(number):
    """Monte Carlo of the median of n normal values: its standard deviation within 1 % (40,000 draws, 3 sigma)."""
    rng = np.random.default_rng(number)
    draws = rng.standard_normal((40_000, number))
    around = np.full((3, 3, 3), np.nan, np.float32)
    around[1], around[2] = 100.0, 0.0
    order = [4, 0, 8, 1, 7, 2, 6, 3, 5][:number]
    # half differences of pairs as noise makes them on average: variance 1/2 each
    around[0].ravel()[order] = [0.0, *np.tile([-1.0, 1.0], number // 2) * 0.03 / np.sqrt(2)]
    around[2].ravel()[order] = 1 / 0.03
    assert middle(around)[1] / 0.03 == pytest.approx(np.median(draws, axis=1).std(), rel=0.011)


def test_sigma_of_a_median_of_unlike_values_is_true_within_a_tenth():
    rng = np.random.default_rng(9)
    for spread in (1.5, 2.0, 3.0):
        sigmas = np.exp(rng.uniform(-np.log(spread), np.log(spread), (200, 9)) / 2) * 0.05
        found = []
        for nine in sigmas:
            half = np.mean(1 / nine) ** -1 / np.sqrt(2) * np.array([[1, 1, 1], [1, 0, -1], [-1, -1, -1]])
            found.append(middle([half, np.full((3, 3), 9.0), 1 / nine.reshape(3, 3)])[1])
        true = np.median(rng.standard_normal((4000, 200, 9)) * sigmas, axis=2).std(axis=0)
        assert np.median(np.array(found) / true) == pytest.approx(1, abs=0.03)
        assert np.all(np.abs(np.array(found) / true - 1) < 0.12)


@pytest.mark.parametrize("changes", [{}, {"window": "3x1"}, {"filter": "off"}, {"min_neighbours": 5}])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_intervals_hold_the_truth_as_often_as_they_say_after_cleaning(changes, missing):
    """68 % and 95 % within 3 points on a plane, also where sigma differs from pixel to pixel and pixels are missing."""
    rng, shape = np.random.default_rng(11), (240, 320)
    truth = 2.0 / rays(LENS, shape)[..., 0]
    sigma = rng.uniform(0.02, 0.05, shape)
    why = np.where(rng.random(shape) < missing, Why.NO_SIGNAL, 0)
    result = cleaned(image(truth + sigma * rng.standard_normal(shape), sigma, why=why), **changes)
    z = ((result.range_m - truth) / result.sigma_m)[result.valid]
    assert result.valid.mean() > 0.75 * (1 - missing)
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.6827, abs=0.03)
    assert np.mean(np.abs(z) < norm.ppf(0.975)) == pytest.approx(0.95, abs=0.03)


def test_intervals_hold_beside_an_edge_on_either_side():
    """Every pixel lies within one pixel of a step of twenty sigma, where a plain median leans to the other surface."""
    rng, shape = np.random.default_rng(12), (400, 120)
    far = np.arange(120) % 4 < 2
    truth = np.where(far, 3.0, 2.0) * np.ones(shape)
    source = image(truth + 0.05 * rng.standard_normal(shape), 0.05)

    def scores(**changes):
        result = cleaned(source, **changes)
        z = np.where(result.valid, (result.range_m - truth) / result.sigma_m, np.nan)
        return z[:, 1:-1], far[1:-1]

    z, side = scores()
    assert np.isfinite(z).all()
    assert abs(z[:, side].mean()) < 0.07  # four standard deviations of a mean over pixels that share their noise
    assert abs(z[:, ~side].mean()) < 0.07
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.6827, abs=0.03)
    assert np.mean(np.abs(z) < norm.ppf(0.975)) == pytest.approx(0.95, abs=0.03)
    plain, side = scores(median_across_edges=True)
    assert plain[:, side].mean() < -0.5 < 0.5 < plain[:, ~side].mean()


# --- every filter


def scene(kind, shape=(160, 220), sigma_m=0.03, missing=0.0, seed=3):
    """Return truth and noisy image: a wall seen squarely, one leaning 60 degrees away, or a board of steps of 1 m."""
    rng, (y, x) = np.random.default_rng(seed), np.mgrid[: shape[0], : shape[1]]
    ray = rays(Lens(horizontal_fov_deg=50), shape)
    lean = np.radians(60 if kind == "oblique" else 0)
    truth = 2.0 / (ray[..., 0] + np.tan(lean) * (0.8 * ray[..., 1] + 0.6 * ray[..., 2]))
    if kind == "edges":
        truth = truth + ((x // 5 + y // 7) % 2)
    why = np.where(rng.random(shape) < missing, Why.NO_SIGNAL, 0)
    return truth, image(np.where(why == 0, truth + sigma_m * rng.standard_normal(shape), 55.0), sigma_m, why=why)


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("kind", ["flat", "oblique", "edges"])
@pytest.mark.parametrize("name", FILTERS)
def test_after_every_filter_intervals_hold_the_truth_as_often_as_they_say(name, kind, missing):
    """68 % and 95 % within 3 points; 35200 pixels, of which up to 25 share their noise."""
    truth, source = scene(kind, missing=missing)
    result = cleaned(source, filter=name, min_neighbours=1)
    z = ((result.range_m - truth) / result.sigma_m)[result.valid]
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.6827, abs=0.03)
    assert np.mean(np.abs(z) < norm.ppf(0.975)) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("kind", ["flat", "oblique", "edges"])
@pytest.mark.parametrize("name", FILTERS)
def test_no_filter_moves_a_wall_by_two_millimetres_with_a_tenth_of_the_pixels_invalid(name, kind):
    truth, source = scene(kind, missing=0.1)
    result = cleaned(source, filter=name, min_neighbours=1)
    error = (result.range_m - truth)[result.valid]
    assert abs(error.mean()) < 0.002
    assert error.std() < (0.9 if kind == "flat" else 1.0) * 0.03


@pytest.mark.parametrize("name", FILTERS)
def test_no_filter_takes_from_or_gives_to_invalid_pixels(name):
    _, source = scene("edges", (30, 40), missing=0.3)
    results = []
    for value in (np.nan, 1e9, -4.0, 3.0):
        other = image(np.where(source.valid, source.range_m, value), 0.03, why=source.why)
        results.append(cleaned(other, filter=name, min_neighbours=0))
    for result in results:
        assert_array_equal(result.valid, source.valid)
        assert_array_equal(result.range_m[result.valid], results[0].range_m[result.valid])
        assert_array_equal(result.sigma_m[result.valid], results[0].sigma_m[result.valid])
        assert np.isfinite(result.sigma_m[result.valid]).all()
    assert_array_equal(results[3].range_m[~source.valid], np.float32(3.0))


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_leaves_a_noiseless_plane_as_it_is_whatever_is_missing(name):
    truth, source = scene("oblique", (40, 50), sigma_m=1e-6, missing=0.3)
    result = cleaned(source, filter=name, min_neighbours=0)
    assert np.abs(result.range_m - truth)[result.valid].max() < 0.005  # the range curves: 1/range is linear


@pytest.mark.parametrize(
    "changes", [{"filter": "off"}, {"window": "3x1"}, {"filter": "mean", "window": "3x1"}, {"total_variation": 3.0,
    "filter": "total_variation"}, {"filter": "bilateral", "bilateral_sigma_px": 0.7}, *({"filter": n} for n in FILTERS)]
)  # fmt: skip
def test_noise_of_a_mean_over_many_pixels_is_that_of_the_pixels_that_share_it(changes):
    """Variance of the mean of 40 x 40 pixels of a large image, 600 of them, within 20 % (3.5 standard deviations)."""
    source = wall((800, 1200), sigma_m=0.03, seed=1)
    result = cleaned(source, **changes)
    blocks = result.range_m.astype(float).reshape(20, 40, 30, 40).mean(axis=(1, 3))
    noise = result.sigma_m.astype(float) ** 2
    said = noise.mean() * shared_noise_pixels(CleanSettings(**changes)) / 1600
    assert blocks.var() / said == pytest.approx(1, abs=0.2)


def test_cross_bilateral_filter_keeps_an_edge_that_only_the_amplitude_shows():
    """A dark strip 3 cm before a bright wall, with 3 cm of noise: no difference of range tells them apart."""
    strip = np.arange(120) % 12 < 6
    truth = np.where(strip, 2.0, 2.03) * np.ones((200, 1))
    rng = np.random.default_rng(2)
    source = image(truth + 0.03 * rng.standard_normal(truth.shape), 0.03, np.where(strip, 40.0, 100.0))

    def step(name, **changes):
        found = cleaned(source, filter=name, **changes).range_m.mean(axis=0)
        beside = np.abs(np.diff(found[5:-5]))
        return beside.max()

    assert step("bilateral") < 0.015
    assert step("cross_bilateral") > 0.025
    assert step("cross_bilateral", amplitude_tolerance=5.0) < 0.018


def test_more_total_variation_leaves_less_noise():
    source = wall((80, 100), sigma_m=0.03)
    left = [cleaned(source, filter="total_variation", total_variation=x).range_m.std() for x in (0.1, 1.0, 5.0)]
    assert 0.03 > left[0] > 1.5 * left[1] > 2 * left[2]


# --- flying pixels


def edge_scene(seed, sigma_gain=600.0, subpixels=4):
    """Return image, rays of each pixel (16, H, W) and config: wall, floor, box, board and pole."""
    wall_ = SceneObject(
        name="wall", boxes=(Box(center_m=(0.5, 0, 0), size_m=(1, 30, 30)),), path=Way(start_m=(4, 0, 0))
    )
    box = SceneObject(name="box", boxes=(Box(center_m=(0.1, 0, 0.25), size_m=(0.2, 0.5, 0.5)),),
                      path=Way(start_m=(2.2, 0.35, 0)), heading_deg=20)  # fmt: skip
    board = SceneObject(name="board", boxes=(Box(center_m=(0, 0, 0.6), size_m=(0.05, 0.6, 0.8)),),
                        path=Way(start_m=(3.0, -0.9, 0)), heading_deg=-35)  # fmt: skip
    pole = SceneObject(name="pole", cylinders=(Cylinder(base_m=(0, 0, 0), radius_m=0.08, height_m=1.2),),
                       path=Way(start_m=(1.7, -0.35, 0)))  # fmt: skip
    scenario = Scenario(name="edges", description="", preset="", duration_s=1, subpixels=subpixels,
                        ground_reflectivity=0.4, objects=(wall_, box, board, pole))  # fmt: skip
    camera = {"modulation_hz": 20e6, "read_noise_lsb": 0.5, "shot_noise_lsb2_per_lsb": 0.002, "full_scale_lsb": None,
              "lower_limit_lsb": None, "quantisation_lsb": 0.0, "reference_amplitude_lsb": 4 * sigma_gain,
              "pseudo_rows": 0,
              "lens": {"horizontal_fov_deg": 60, "vertical_fov_deg": 46, "projection": "perspective"}}  # fmt: skip
    config = load_config("generic_cw", {"camera": {**camera, "rows": 120, "columns": 160}, "mounting": {"z_m": 0.5}})
    capture = next(iter(frames(scenario, config, seed)))
    bundle = ray_bundle(config.camera.lens, config.mounting, (120, 160), subpixels)
    return RANGING["cw_four_phase"](capture.raw, config.camera), render(scenario, 0.0, bundle).range_m, config


@pytest.mark.parametrize(("gain", "sigmas"), [(1500.0, 0.0), (600.0, 3.0)])
def test_no_gross_flying_pixel_survives_and_few_good_pixels_are_lost(gain, sigmas):
    """Gross: over 30 mm from every surface that the pixel sees, at 5 mm of noise; at 10 mm (40 on the floor at grazing
    incidence), where no single pixel can tell 30 mm, over 30 mm and three standard deviations.
    """
    for seed in range(3):
        source, seen_m, config = edge_scene(seed, gain)
        mixed = np.diff(np.sort(seen_m, axis=0), axis=0).max(axis=0) > 0.06
        kept = {}
        for reject in (False, True):
            changes = replace(config.clean, reject_flying=reject)
            result = clean(source, config.camera.lens, config.mounting, changes)
            gross = mixed & (np.abs(result.range_m - seen_m).min(axis=0) > 0.03 + sigmas * source.sigma_m)
            kept[reject] = (gross & result.valid).sum()
            good = ~mixed & source.valid
        assert kept[False] > 10
        assert kept[True] <= (0 if sigmas == 0 else 1)
        assert (good & ~result.valid).sum() < 0.03 * good.sum()
        assert (result.why == Why.FLYING).sum() > 100


def test_a_slope_flies_only_where_it_steps():
    flat = np.array([[2.0, 2.0, 2.0, 2.5, 3.0, 3.0, 3.0]]) * np.ones((7, 1))
    incline = np.array([[2.0, 2.2, 2.4, 2.6, 2.8, 3.0, 3.2]]) * np.ones((7, 1))
    step = np.zeros((7, 7), bool)
    step[:, 3] = True
    never = np.zeros((7, 7), bool)
    for range_m, expected in ((flat, step), (incline, never), (flat.T, step.T), (incline.T, never)):
        found = cleaned(image(range_m, 0.001), reject_flying=True, min_neighbours=0).why == Why.FLYING
        assert_array_equal(found[2:-2, 2:-2], expected[2:-2, 2:-2])


def test_tolerances_of_flying_pixels_are_a_constant_and_the_noise():
    step = np.array([[2.0, 2.0, 2.1, 2.2, 2.2]])
    for changes, flies in (
        ({"flying_tolerance_m": 0.09, "flying_tolerance_sigmas": 0.0}, True),
        ({"flying_tolerance_m": 0.11, "flying_tolerance_sigmas": 0.0}, False),
        ({"flying_tolerance_m": 0.0, "flying_tolerance_sigmas": 3.0}, False),
        ({"flying_tolerance_m": 0.0, "flying_tolerance_sigmas": 2.0}, True),
    ):
        result = cleaned(image(step, 0.03), reject_flying=True, min_neighbours=0, **changes)
        assert (result.why[0, 2] == Why.FLYING) == flies


# --- over time


def settled(speed, frames_=40, **changes):
    """Return z scores and sigma of 20 images of a wall that comes nearer by `speed` m a frame, below one at rest."""
    rng, before, z = np.random.default_rng(0), None, []
    for k in range(frames_):
        truth = np.where(np.arange(80) < 40, 4.0, 5.0 - speed * k)[:, None] * np.ones((80, 100))
        before = clean(image(truth + 0.03 * rng.standard_normal(truth.shape), 0.03), LENS, LEVEL,
                       CleanSettings(temporal_frames=8.0, **changes), before)  # fmt: skip
        if k >= frames_ - 20:
            z.append(((before.range_m - truth) / before.sigma_m)[44:])
    return np.array(z), before.sigma_m


@pytest.mark.parametrize("name", ["off", "median"])
def test_average_over_time_lowers_the_noise_of_what_rests_and_its_sigma_stays_true(name):
    z, sigma = settled(0.0, filter=name)
    _, single = settled(0.0, frames_=20, filter=name, temporal_gate_sigmas=1e-6)
    assert sigma.mean() < 0.5 * single.mean()
    assert 0.65 < np.mean(np.abs(z) < 1) < 0.77  # on the safe side: noise may pass for motion
    assert 0.93 < np.mean(np.abs(z) < norm.ppf(0.975)) < 0.98


@pytest.mark.parametrize("speed", [0.005, 0.02, 0.05, 0.2])
def test_what_moves_slowly_is_averaged_less_and_what_jumps_begins_anew(speed):
    z, sigma = settled(speed)
    assert 0.62 < np.mean(np.abs(z) < 1) < 0.74
    assert np.mean(np.abs(z) < norm.ppf(0.975)) > 0.91
    assert abs(z.mean()) < 0.6
    if speed == 0.2:
        fresh = cleaned(wall((80, 100), 4.0, 0.03))
        assert sigma[50:70, 20:80].mean() == pytest.approx(fresh.sigma_m[50:70, 20:80].mean(), rel=0.1)


def test_pixels_new_in_an_image_begin_anew_and_other_shapes_are_forgotten():
    source = wall((20, 30))
    why = np.zeros((20, 30))
    why[5] = Why.NO_SIGNAL
    changes = CleanSettings(temporal_frames=4.0)
    alone = clean(source, LENS, LEVEL, changes)
    after = clean(source, LENS, LEVEL, changes, clean(image(source.range_m, 0.02, why=why), LENS, LEVEL, changes))
    assert_array_equal(after.sigma_m[5], alone.sigma_m[5])
    assert (after.sigma_m[8:] < alone.sigma_m[8:]).all()
    other = clean(source, LENS, LEVEL, changes, wall((10, 30)))
    assert_array_equal(other.range_m, alone.range_m)


def test_a_run_hands_each_image_to_the_next_frame_and_repeats_bit_for_bit():
    import rangecam

    def images(**settings_):
        source = rangecam.open_source("scenario:test-scene", layers=[{"clean": settings_}])
        return [f.image for f, _ in zip(rangecam.run(source.captures, source.config), range(3), strict=False)]

    first, again, plain = images(temporal_frames=4.0), images(temporal_frames=4.0), images()
    for a, b in zip(first, again, strict=True):
        assert_array_equal(a.range_m, b.range_m)
    both = first[2].valid & plain[2].valid
    assert np.median(first[2].sigma_m[both] / plain[2].sigma_m[both]) < 0.95


# --- floor


def floor_scene(lens, mounting, shape, box_m=2.0):
    """Range of a flat floor with a wall ahead, and which pixels see the floor."""
    ray = rays(lens, shape) @ rotation(mounting).T
    with np.errstate(divide="ignore"):
        floor = np.where(ray[..., 2] < 0, -mounting.z_m / ray[..., 2], np.inf)
        ahead = np.where(ray[..., 0] > 0, (box_m - mounting.x_m) / ray[..., 0], np.inf)
    return np.minimum(floor, ahead), floor < ahead


def test_floor_that_the_mounting_implies_is_removed_and_nothing_else():
    mounting = Mounting(z_m=0.5, pitch_deg=12, roll_deg=5, yaw_deg=10)
    range_m, floor = floor_scene(WIDE, mounting, (60, 80))
    height = to_world(image(range_m), WIDE, mounting)[..., 2]
    result = cleaned(
        image(range_m), WIDE, mounting, floor="mounting", floor_margin_m=0.1, floor_margin_sigmas=0.0, **OFF
    )
    assert floor.any()
    assert_array_equal(result.why == Why.FLOOR, height < 0.1)
    raw = cleaned(image(range_m), WIDE, mounting, **OFF)
    assert raw.valid.all()


def test_noise_of_the_floor_is_floor_up_to_the_margin_in_sigmas():
    mounting = Mounting(z_m=1.0, pitch_deg=40)
    range_m, floor = floor_scene(LENS, mounting, (90, 120), box_m=50.0)
    noisy = image(range_m + 0.05 * np.random.default_rng(3).standard_normal(range_m.shape), 0.05)
    for sigmas in (0.0, 1.0, 2.0):
        result = cleaned(noisy, LENS, mounting, floor="mounting", floor_margin_m=0.0, floor_margin_sigmas=sigmas, **OFF)
        assert np.mean(result.why[floor] == Why.FLOOR) == pytest.approx(norm.cdf(sigmas), abs=0.02)


def test_a_camera_on_the_floor_sees_no_floor():
    assert cleaned(image(np.ones((4, 4))), LENS, Mounting(z_m=0.0), floor="mounting", **OFF).valid.all()


@pytest.mark.parametrize("covered", [0.0, 0.2, 0.4])
def test_fitted_floor_is_found_below_objects_that_cover_much_of_it(covered):
    """A camera that looks down, leaning by 4 degrees which its mounting does not say; boxes 0.5-1.5 m high."""
    rng, shape = np.random.default_rng(21), (60, 80)
    lean = Mounting(z_m=2.4, pitch_deg=86, roll_deg=2)
    down = -(rays(LENS, shape) @ rotation(lean).T)[..., 2]
    height = np.where(np.arange(80) < 80 * covered, rng.uniform(0.5, 1.5, (60, 1)), 0.0)
    source = image((lean.z_m - height) / down + 0.02 * rng.standard_normal(shape), 0.02)
    plane = fit_floor(source.range_m, source.why, LENS)
    assert 1 / np.linalg.norm(plane) == pytest.approx(2.4, abs=0.03)
    result = cleaned(source, LENS, Mounting(pitch_deg=90), floor="fit", floor_margin_m=0.2, **OFF)
    assert np.mean((result.why == Why.FLOOR) == (height == 0)) > 0.99


def test_fitted_plane_that_stands_up_is_no_floor():
    source = image(3 / rays(LENS, (40, 50))[..., 0])
    tilted = Mounting(pitch_deg=60)  # its floor leans by 30 degrees to the wall
    assert cleaned(source, LENS, tilted, floor="fit", **OFF).valid.all()
    removed = cleaned(source, LENS, tilted, floor="fit", floor_max_tilt_deg=70.0, **OFF).why == Why.FLOOR
    assert removed.mean() > 0.99


def test_too_few_pixels_are_no_floor():
    why = np.full((10, 10), Why.NO_SIGNAL)
    why[0, :5] = 0
    source = image(np.full((10, 10), 2.0), why=why)
    assert_array_equal(fit_floor(source.range_m, source.why, LENS), 0)
    assert cleaned(source, LENS, Mounting(pitch_deg=90), floor="fit", **OFF).valid.sum() == 5


# --- area of interest


BOX = {"x_min_m": 0.5, "x_max_m": 4.0, "width_m": 1.2, "z_min_m": 0.1, "z_max_m": 1.5}


@pytest.mark.parametrize(
    "mounting", [Mounting(z_m=0.8), Mounting(x_m=1.0, y_m=0.2, z_m=1.0, pitch_deg=15, yaw_deg=-20)]
)
@pytest.mark.parametrize("left_out", [None, *BOX])
def test_area_of_interest_keeps_the_points_inside_the_box_and_no_others(mounting, left_out):
    box = {key: value for key, value in BOX.items() if key != left_out}
    range_m = np.random.default_rng(8).uniform(0.05, 6, (60, 80))
    x, y, z = np.moveaxis(to_world(image(range_m), WIDE, mounting).astype(float), -1, 0)
    inside = (x >= box.get("x_min_m", -np.inf)) & (x <= box.get("x_max_m", np.inf))
    inside &= np.abs(y) <= box.get("width_m", np.inf) / 2
    inside &= (z >= box.get("z_min_m", -np.inf)) & (z <= box.get("z_max_m", np.inf))
    result = cleaned(image(range_m), WIDE, mounting, **box, **OFF)
    assert 0 < inside.mean() < 1
    assert np.mean(result.valid == inside) > 0.9999  # a point on a face may round either way
    assert set(np.unique(result.why)) == {Why.VALID, Why.OUTSIDE_AREA}


def test_area_is_as_wide_on_the_right_as_on_the_left():
    # E-S-05: the printed form without the absolute value keeps one side whole
    result = cleaned(image(np.full((1, 80), 2.0)), WIDE, width_m=1.0, **OFF)
    assert_array_equal(result.valid, result.valid[:, ::-1])
    assert not result.valid[0, 0]


def test_a_ray_along_a_face_is_inside_for_ever_or_never():
    level = Lens(horizontal_fov_deg=10)
    for z_max, inside in ((0.1, True), (-0.1, False)):
        near, far = area_of_interest(level, Mounting(), (1, 1), CleanSettings(z_min_m=-0.2, z_max_m=z_max))
        assert (near[0, 0] <= 5.0 <= far[0, 0]) == inside


# --- the whole


def test_first_reason_stands():
    amplitude = [[0.1, 100.0, 100.0]]
    why = [[Why.SATURATED, 0, 0]]
    result = cleaned(image([[9.0, 5.0, 1.0]], amplitude=amplitude, why=why), amplitude_threshold=0.1, x_max_m=3.0)
    assert reasons(result) == [["SATURATED", "ISOLATED", "ISOLATED"]]


def test_stages_end_with_the_clean_image_and_only_take_away():
    config = load_config("scaled_car")
    range_m, _ = floor_scene(config.camera.lens, config.mounting, (120, 160))
    source = image(range_m + 0.02 * np.random.default_rng(0).standard_normal(range_m.shape), 0.02, 20.0)
    stages = list(clean_stages(source, config.camera.lens, config.mounting, config.clean))
    assert tuple(name for name, _ in stages) == STAGES
    final = clean(source, config.camera.lens, config.mounting, config.clean)
    for name in ("range_m", "sigma_m", "amplitude", "why"):
        assert_array_equal(getattr(stages[-1][1], name), getattr(final, name))
    valid = [source.valid.sum()] + [stage.valid.sum() for _, stage in stages]
    assert valid == sorted(valid, reverse=True)
    assert valid[-1] < valid[0]


def test_everything_off_changes_nothing():
    source = wall((8, 9))
    result = cleaned(source, **OFF)
    for name in ("range_m", "sigma_m", "amplitude", "why"):
        assert_array_equal(getattr(result, name), getattr(source, name))
    assert result.time_s == source.time_s


def test_the_image_that_came_in_stays_as_it_was():
    source = wall((8, 9))
    before = source.range_m.copy(), source.sigma_m.copy(), source.why.copy()
    cleaned(source, LENS, Mounting(z_m=1.0), floor="mounting", amplitude_threshold=0.9)
    for old, new in zip(before, (source.range_m, source.sigma_m, source.why), strict=True):
        assert_array_equal(old, new)


@pytest.mark.parametrize("shape", [(1, 1), (1, 64), (8, 1), (3, 2)])
def test_small_images_pass_through_every_stage(shape):
    changes = {"floor": "fit", "filter": "median", "min_neighbours": 0, "x_max_m": 9.0, "discard_border": False}
    assert cleaned(image(np.full(shape, 2.0)), **changes).valid.all()


def test_invalid_pixels_may_hold_anything():
    why = np.zeros((5, 5))
    why[2] = Why.NO_SIGNAL
    source = image(np.full((5, 5), 2.0), why=why)
    for value in (np.nan, np.inf, -5.0, 1e9):
        source.range_m[2], source.sigma_m[2], source.amplitude[2] = value, value, value
        result = cleaned(source, LENS, Mounting(z_m=1.0), floor="mounting", wrap_threshold=0.01, x_max_m=9.0)
        assert (result.why[[0, 1, 3, 4]] == 0).all()
        assert_allclose(result.range_m[[0, 1, 3, 4]], 2.0)
        assert np.isfinite(result.sigma_m[[0, 1, 3, 4]]).all()


# --- real cameras

DATA = Path(os.environ.get("RANGECAM_DATA", ""))


@pytest.mark.skipif(not (DATA / "adtf3175").is_dir(), reason="RANGECAM_DATA does not name a folder with adtf3175")
def test_cleaning_a_real_room_leaves_smooth_surfaces():
    """Of an ADTF3175's image: neighbours differ by more than 10 cm in one pair of a thousand at most, at edges."""
    from rangecam.processed import processed
    from rangecam.types import RawFrame

    recorded, config = np.load(DATA / "adtf3175" / "person_mode2.npz"), load_config("adtf3175")
    planes = {"depth_m": recorded["depth_mm"] / 1000, "amplitude": recorded["ab"] * 1.0, "confidence": recorded["conf"]}
    image_in = processed(RawFrame(0.0, planes), config.camera)
    result = clean(image_in, config.camera.lens, config.mounting, config.clean)

    def jumps(one):
        pair = one.valid[:, 1:] & one.valid[:, :-1]
        return np.mean(np.abs(np.diff(one.range_m, axis=1))[pair] > 0.1)

    assert result.valid.mean() > 0.5
    assert jumps(result) < 0.2 * jumps(image_in)
    assert jumps(result) < 0.002


@pytest.mark.skipif(not (DATA / "cw_mlx75027").is_dir(), reason="RANGECAM_DATA does not name a folder with cw_mlx75027")
def test_flying_pixels_of_a_real_scene_lie_at_its_edges():
    """Tools before a wall, raw phase images: where a pixel flies, its neighbours differ ten times as much."""
    from rangecam.io import open_source

    source = open_source(DATA / "cw_mlx75027" / "tools_scene.npz")
    config, capture = source.config, next(iter(source.captures))
    measured = RANGING[config.ranging](capture.raw, config.camera)
    result = clean(measured, config.camera.lens, config.mounting, replace(config.clean, reject_flying=True))
    flies = result.why == Why.FLYING
    spread = maximum_filter(measured.range_m, 3) - minimum_filter(measured.range_m, 3)
    assert 0.02 < flies.mean() < 0.06
    assert np.median(spread[flies]) > 10 * np.median(spread[~flies])
