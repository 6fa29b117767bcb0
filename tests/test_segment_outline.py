"""What cuts a segment short, where its surface is nearest, and how it is bent."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import ndimage

from rangecam.geometry import Lens, Mounting, rays, rotation, to_world
from rangecam.segmentation import SegmentSettings, measure_segments
from rangecam.types import SURFACE, Cut, RangeImage, Why

LENS = Lens(horizontal_fov_deg=50)
SHAPE = (40, 60)


def wall(depth_m=5.0, sigma_m=0.01):
    range_m = (depth_m / rays(LENS, SHAPE)[..., 0]).astype(np.float32)
    return RangeImage(0.0, range_m, np.full(SHAPE, sigma_m, np.float32), np.ones_like(range_m), np.zeros(SHAPE, "u1"))


def segment(labels, source, mounting=Mounting(), **changes):  # noqa: B008 - frozen
    points = to_world(source, LENS, mounting)
    return measure_segments(labels, points, source, LENS, mounting, SegmentSettings(**changes))[0]


def block(rows, columns):
    labels = np.zeros(SHAPE, np.int32)
    labels[rows, columns] = 1
    return labels


EDGES = {
    Cut.LEFT: np.s_[10:20, :20],
    Cut.RIGHT: np.s_[10:20, 40:],
    Cut.TOP: np.s_[:20, 20:40],
    Cut.BOTTOM: np.s_[20:, 20:40],
}


@pytest.mark.parametrize("edge", EDGES)
def test_segment_at_an_edge_of_the_image_is_cut_there_and_nowhere_else(edge):
    assert segment(block(*EDGES[edge]), wall()).cut == edge


def test_segment_amid_the_image_is_not_cut_and_one_that_fills_it_is_cut_all_around():
    assert segment(block(slice(10, 20), slice(20, 40)), wall()).cut == 0
    assert segment(block(slice(None), slice(None)), wall()).cut == Cut.LEFT | Cut.RIGHT | Cut.TOP | Cut.BOTTOM


@pytest.mark.parametrize("edge", EDGES)
def test_a_border_that_is_discarded_is_the_edge_of_the_image(edge):
    source, labels = wall(), block(*EDGES[edge])
    for place in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        source.why[place], labels[place] = Why.BORDER, 0
    assert segment(labels, source).cut == edge


@pytest.mark.parametrize(("columns", "beside", "edge"), [((10, 30), 9, Cut.LEFT), ((30, 50), 50, Cut.RIGHT)])
def test_what_goes_on_outside_the_area_of_interest_is_cut_there(columns, beside, edge):
    for rows, depth_m, cut in ((10, 0.0, edge), (4, 0.0, 0), (10, 1.0, 0)):  # all of its side, less than half; a step
        source, labels = wall(), block(slice(10, 20), slice(*columns))
        source.why[10 : 10 + rows, beside] = Why.OUTSIDE_AREA
        source.why[10 + rows : 20, beside] = Why.LOW_AMPLITUDE
        source.range_m[10 : 10 + rows, beside] += depth_m
        assert segment(labels, source).cut == cut


@pytest.mark.parametrize("columns", [(10, 30), (30, 50), (20, 21)])
def test_a_segment_ends_where_its_outermost_pixels_do_whatever_their_own_ranges_are(columns):
    edges = np.tan(np.radians(25)) * (1 - np.array(columns) / 30) * 5.0
    pixel_m = 2 * np.tan(np.radians(25)) * 5.0 / 60
    whole = columns[1] - columns[0] > 1
    source, labels = wall(), block(slice(10, 20), slice(*columns))
    if whole:
        source.range_m[10:20, columns[0]] -= 0.6  # it sees something nearer, too
    found = segment(labels, source)
    assert_allclose(found.ends_m, edges if whole else edges.mean(), atol=0.15 * pixel_m)  # as far, not as deep


def behind(step_m, reason=Why.VALID, gap=0, sigma_m=0.01):
    """Return a plate at 5 m whose right part stands behind something nearer by a step; gap: flying pixels between."""
    source, labels = wall(sigma_m=sigma_m), block(slice(10, 20), slice(20, 40))
    source.range_m[5:25, 40:50] -= step_m
    source.why[5:25, 40:50] = reason
    source.why[5:25, 40 : 40 + gap] = Why.FLYING
    return labels, source


@pytest.mark.parametrize("reason", [Why.VALID, Why.OUTSIDE_AREA])
@pytest.mark.parametrize("gap", [0, 1, 2])
def test_something_nearer_at_the_outline_hides_a_part_also_behind_flying_pixels(reason, gap):
    assert segment(*behind(1.0, reason, gap)).cut == Cut.OCCLUDED | Cut.HIDDEN_RIGHT


@pytest.mark.parametrize(("columns", "sides"), [(np.s_[10:20], Cut.HIDDEN_LEFT), (np.s_[40:50], Cut.HIDDEN_RIGHT)])
@pytest.mark.parametrize(("rows", "most"), [(np.s_[10:16], True), (np.s_[10:14], False)])
def test_a_side_is_hidden_where_most_of_it_is(columns, sides, rows, most):
    source = wall()
    source.range_m[rows, columns] = 2.0
    assert segment(block(slice(10, 20), slice(20, 40)), source).cut == Cut.OCCLUDED | (sides if most else 0)


def test_what_hides_the_lower_part_hides_no_side():
    source = wall()
    source.range_m[20:25, 15:45] = 2.0
    assert segment(block(slice(10, 20), slice(20, 40)), source, Mounting(z_m=3.0)).cut == (Cut.OCCLUDED | Cut.HIDDEN_UP)


def test_nor_does_what_hides_a_side_hide_anything_above_or_below():
    source = wall()
    source.range_m[5:25, 40:50] = 2.0
    assert not segment(block(slice(10, 20), slice(20, 40)), source).cut & Cut.HIDDEN_UP


@pytest.mark.parametrize(
    "given", [behind(-1.0), behind(0.1), behind(1.0, gap=3), behind(1.0, Why.SATURATED), behind(1.0, sigma_m=0.5)]
)
def test_what_is_behind_beside_far_away_without_a_range_or_within_the_noise_hides_nothing(given):
    assert segment(*given).cut == 0


def test_a_stray_near_pixel_at_the_outline_hides_nothing():
    source = wall()
    source.range_m[15, 40] = 2.0
    assert segment(block(slice(10, 20), slice(20, 40)), source).cut == 0
    source.range_m[10:20, 40] = 2.0
    assert segment(block(slice(10, 20), slice(20, 40)), source, occluder_fraction=0.1).cut & Cut.OCCLUDED
    assert segment(block(slice(10, 20), slice(20, 40)), source, occluder_fraction=0.3).cut == 0


def standing(camera_m, box_m=0.0, reason=Why.VALID):
    """Return what a camera sees of a plate of 1.5 m that stands on the floor at 6 m, of a box at 3 m, and the plate."""
    mounting = Mounting(z_m=camera_m, pitch_deg=10)
    ray = rays(LENS, SHAPE) @ rotation(mounting).T
    with np.errstate(divide="ignore"):
        floor = np.where(ray[..., 2] < 0, -camera_m / ray[..., 2], np.inf)
    plate, box = 6 / ray[..., 0], 3 / ray[..., 0]
    point = camera_m + plate * ray[..., 2]
    on_plate = (np.abs(plate * ray[..., 1]) < 0.8) & (point > 0) & (point < 1.5)
    height = camera_m + box * ray[..., 2]
    on_box = (np.abs(box * ray[..., 1]) < 1.5) & (height > 0) & (height < box_m)
    range_m = np.where(on_box, box, np.where(on_plate, plate, np.minimum(floor, 50.0)))
    ones = np.ones(SHAPE, np.float32)
    why = np.where(on_plate | on_box, 0, reason).astype(np.uint8)
    source = RangeImage(0.0, range_m.astype(np.float32), 0.01 * ones, ones, why)
    return (on_plate & ~on_box).astype(np.int32), source, mounting


@pytest.mark.parametrize("reason", [Why.VALID, Why.OUTSIDE_AREA, Why.FLOOR])
@pytest.mark.parametrize("camera_m", [0.3, 1.2, 2.5])
def test_the_floor_before_an_object_does_not_hide_it_but_a_box_does(camera_m, reason):
    assert not segment(*standing(camera_m, 0.0, reason)).cut & Cut.OCCLUDED
    assert segment(*standing(camera_m, 0.7 * camera_m, reason)).cut & Cut.OCCLUDED


def test_the_nearest_point_of_an_oblique_wall_is_at_its_near_end():
    mounting = Mounting(z_m=1.0)
    ray = rays(LENS, SHAPE) @ rotation(mounting).T
    source = wall()
    source.range_m[:] = 4.0 / (ray[..., 0] + ray[..., 1])  # x + y = 4: nearer on the left
    one = segment(block(slice(None), slice(None)), source, mounting, near_fraction=0.02)
    assert one.nearest_m[0] == one.near_m
    assert one.nearest_m[0] + one.nearest_m[1] == pytest.approx(4.0, abs=0.05)
    assert one.nearest_m[1] > one.position_m[1] + 0.5
    assert one.nearest_m[2] == pytest.approx(1.0, abs=0.1)


@given(st.integers(0, 1000), st.floats(0.01, 0.5))
@settings(max_examples=15, deadline=None)
def test_the_nearest_point_is_the_mean_of_what_is_not_farther_than_the_quantile(seed, fraction):
    source = wall(sigma_m=1e-4)
    source.range_m[:] = 2 + np.random.default_rng(seed).gamma(2.0, 0.3, SHAPE)
    one = segment(block(slice(None), slice(None)), source, near_fraction=fraction)
    points = to_world(source, LENS, Mounting()).reshape(-1, 3)
    near = points[points[:, 0] <= np.float32(one.near_m)]
    assert_allclose(one.nearest_m[1:], near[:, 1:].mean(axis=0), atol=1e-5)


def test_noise_brings_the_near_end_of_an_oblique_wall_hardly_nearer():
    ray, near, quantile = rays(LENS, SHAPE), [], []
    for noise_m in (1e-4, 0.5):
        source = wall(sigma_m=noise_m)
        source.range_m[:] = 4.0 / (ray[..., 0] + 0.3 * ray[..., 1])
        source.range_m[:] += noise_m * np.random.default_rng(5).standard_normal(SHAPE)
        near.append(segment(block(slice(None), slice(None)), source).near_m)
        quantile.append(np.quantile(to_world(source, LENS, Mounting())[..., 0], 0.05))
    assert quantile[1] < quantile[0] - 0.2
    assert near[1] == pytest.approx(near[0], abs=float(quantile[0] - quantile[1]) / 2)


def test_the_profile_follows_the_outline_from_the_top_to_the_bottom():
    """A head of 4 pixels, shoulders of 12, hips of 8, and two legs of 3 that are 2 apart."""
    labels = np.zeros(SHAPE, np.int32)
    labels[4:8, 28:32] = labels[8:12, 24:36] = labels[12:16, 26:34] = 1
    labels[16:20, 26:29] = labels[16:20, 31:34] = 1
    profile = segment(labels, wall()).profile
    assert_allclose(profile[0] * 12, [4, 12, 8, 8])
    assert_allclose(profile[1] * 12, [4, 12, 8, 6])


def test_the_profile_tells_how_much_farther_away_a_cabin_is_than_the_bonnet():
    source, labels = wall(), block(slice(10, 20), slice(20, 40))
    source.range_m[10:15, 20:40] *= 6.0 / 5.0
    cabin, upper, lower, bonnet = segment(labels, source).profile[2]
    assert upper - lower == pytest.approx(1.0, abs=0.05)
    assert cabin == pytest.approx(-bonnet, abs=0.1)  # of ten rows, two or three are in a band


@pytest.mark.parametrize("rows", [1, 2, 3, 5])
def test_segments_of_few_rows_have_a_profile_too(rows):
    profile = segment(block(slice(10, 10 + rows), slice(20, 30)), wall()).profile
    assert_allclose(profile[:2], 1.0)
    assert np.abs(profile[2]).max() < 0.05


@pytest.mark.parametrize(
    ("reason", "cut"), [(Why.LOW_AMPLITUDE, Cut.LEFT), (Why.ISOLATED, Cut.LEFT), (Why.VALID, 0), (Why.FLOOR, 0)]
)
def test_what_ends_at_a_last_pixel_that_measured_nothing_may_go_on_beyond_the_image(reason, cut):
    source = wall()
    source.why[:, 0] = reason
    assert segment(block(slice(10, 20), slice(1, 20)), source).cut == cut


@pytest.mark.parametrize(("columns", "share"), [(1, 1.0), (2, 1 / 4), (5, 1 / 25)])
def test_torn_ends_make_the_range_of_thin_things_beside_our_way_uncertain(columns, share):
    labels = block(slice(10, 20), slice(50, 50 + columns))
    with_it, without = (segment(labels, wall(), edge_range_sigma_m=sigma) for sigma in (10.0, 0.0))
    sine = abs(with_it.position_m[1]) / np.linalg.norm(with_it.position_m)
    more = np.sqrt(with_it.sigma_range_m**2 - without.sigma_range_m**2)
    assert_allclose(more, 10.0 * sine * share, rtol=1e-6)
    assert segment(block(slice(10, 20), slice(29, 31)), wall(), edge_range_sigma_m=10.0).sigma_range_m < 0.01


# ---- how the surface is bent


def surface(labels, source):
    return dict(zip(SURFACE, segment(labels, source).surface, strict=True))


def bent(of):
    """Return a surface at 5 m whose distance along x is a function of the places across and up."""
    ray, source = rays(LENS, SHAPE), wall()
    depth = 5.0 / ray[..., 0]
    for _ in range(30):  # only the middle is looked at where it bends
        depth = (5.0 + of(*(np.clip(depth * ray[..., k], -1, 1) for k in (1, 2)))) / ray[..., 0]
    source.range_m[:] = depth
    return source


MIDDLE = block(slice(14, 26), slice(22, 38))  # 1.1 m wide


def test_a_plane_that_leans_has_its_slopes_and_no_bends():
    seen = surface(MIDDLE, bent(lambda across, up: 0.4 * across - 0.2 * up))
    assert seen["lean_across"] == pytest.approx(0.4, abs=0.03)
    assert seen["lean_up"] == pytest.approx(-0.2, abs=0.02)
    assert max(abs(seen["bend_across"]), abs(seen["bend_up"])) < 0.01
    assert seen["rough_m"] < 0.005


def test_a_trunk_is_bent_across_by_half_of_one_over_its_radius_and_shaded_by_the_cosine():
    radius, source = 1.0, bent(lambda across, up: across**2 / 2)
    across = source.range_m * rays(LENS, SHAPE)[..., 1]
    source.amplitude[:] = (1 - (across / radius) ** 2 / 2) / source.range_m**2
    seen = surface(MIDDLE, source)
    assert seen["bend_across"] == pytest.approx(0.5 / radius, rel=0.03)
    assert seen["shade"] == pytest.approx(-0.5 / radius**2 / (1 - 0.55**2 / 6), rel=0.05)
    assert abs(seen["bend_up"]) < 0.01


@pytest.mark.parametrize("labels", [MIDDLE, block(slice(None), slice(None))], ids=["each pixel", "some of many"])
def test_the_parabola_is_the_one_of_least_squares(labels):
    source = bent(lambda across, up: 0.1 * across + 0.05 * across**2 + 0.02 * np.sin(9 * across) * np.cos(7 * up))
    seen, points = surface(labels, source), to_world(source, LENS, Mounting()).astype(float)
    centre = points[labels == 1].mean(axis=0)
    inner = ndimage.binary_erosion(labels == 1, border_value=1)
    away = np.hypot(*centre[:2])
    x, y, z = points[inner].T
    u, v = (y * centre[0] - x * centre[1]) / away, z - centre[2]
    terms = np.stack([np.ones_like(u), u, v, u * u, v * v], axis=1)
    best, *_ = np.linalg.lstsq(terms, (x * centre[0] + y * centre[1]) / away - away)
    kept = [seen[name] for name in ("lean_across", "lean_up", "bend_across", "bend_up")]
    assert_allclose(kept, best[1:], atol=0.01)


def test_the_roughness_of_a_plane_is_its_noise():
    source = wall()
    source.range_m[:] += 0.05 * np.random.default_rng(3).standard_normal(SHAPE)
    assert surface(block(slice(5, 35), slice(10, 40)), source)["rough_m"] == pytest.approx(0.05, rel=0.15)


def test_an_edge_of_the_image_is_no_edge_of_the_surface_and_legs_are_two_pieces_in_a_row():
    assert surface(block(slice(None), slice(None)), wall())["inner"] == 1.0
    assert surface(block(slice(10, 16), slice(20, 30)), wall())["inner"] == pytest.approx(4 * 8 / 60)
    labels = block(slice(10, 20), slice(20, 30))
    labels[15:20, 24:26] = 0
    assert surface(labels, wall())["pieces"] == 1.5


def test_what_has_no_inner_pixels_is_flat_and_without_light_nothing_is_said_of_shade():
    seen = surface(block(slice(10, 12), slice(20, 30)), wall())
    assert list(seen.values()) == [0.0] * 7 + [1.0]
    dark = bent(lambda across, up: 0.4 * across)
    dark.amplitude[:] = np.nan
    seen = surface(MIDDLE, dark)
    assert seen["shade"] == 0.0
    assert seen["lean_across"] == pytest.approx(0.4, abs=0.03)


# ---- a thing ends where its surface does


THING = np.s_[8:20, 22:42]


def dim(sigma_m=0.2, deeper_m=3.0, seed=5):
    """Return a plate at 5 m, of which nothing is bright enough yet, before something deeper that is darker still."""
    rng, source = np.random.default_rng(seed), wall(sigma_m=0.02)
    shown = np.zeros(SHAPE, bool)
    shown[THING] = True
    source.range_m[~shown] += deeper_m
    source.sigma_m[:] = np.where(shown, sigma_m, 1.0)
    source.range_m[:] += source.sigma_m * rng.standard_normal(SHAPE)
    source.why[:] = Why.LOW_AMPLITUDE
    return source


def brightened(source, columns):
    """Return labels and image where these columns of the thing are bright enough by now."""
    labels = block(slice(8, 20), columns)
    seen = labels > 0
    range_m = np.where(seen, wall().range_m, source.range_m)
    sigma_m, why = np.where(seen, 0.02, source.sigma_m), np.where(seen, 0, source.why)
    return labels, RangeImage(0.0, range_m, sigma_m.astype(np.float32), source.amplitude, why.astype("u1"))


WHOLE_M = np.tan(np.radians(25)) * (1 - np.array([22, 42]) / 30) * 5.0
PIXEL_M = 2 * np.tan(np.radians(25)) * 5.0 / 60


@pytest.mark.parametrize("columns", [slice(30, 34), slice(26, 40), slice(22, 30), slice(22, 42)])
@pytest.mark.parametrize("reason", [Why.LOW_AMPLITUDE, Why.ISOLATED])
def test_a_dim_thing_ends_where_its_surface_does_however_much_of_it_is_bright(columns, reason):
    source = dim()
    source.why[:] = reason
    found = segment(*brightened(source, columns), dim_sigma_m=0.3)
    assert_allclose(found.ends_m, WHOLE_M, atol=0.6 * PIXEL_M)
    assert_allclose(found.position_m[1], WHOLE_M.mean(), atol=0.5 * PIXEL_M)
    assert_allclose(found.size_m[1], WHOLE_M[0] - WHOLE_M[1], atol=1.2 * PIXEL_M)
    assert found.cut == 0


def test_without_a_limit_or_dimmer_than_it_a_thing_ends_with_its_label():
    labels, source = brightened(dim(), slice(26, 40))
    ends_m = [segment(labels, source, dim_sigma_m=sigma_m).ends_m for sigma_m in (0.0, 0.15)]
    assert_allclose(ends_m, np.tan(np.radians(25)) * (1 - np.array([[26, 40]] * 2) / 30) * 5.0, atol=0.15 * PIXEL_M)


def test_all_rows_together_tell_a_thing_from_what_is_half_a_metre_behind_it():
    labels, source = brightened(dim(deeper_m=0.5), slice(22, 42))
    source.sigma_m[labels == 0] = 0.25
    source.range_m[labels == 0] = (wall(5.5).range_m + 0.25 * np.random.default_rng(6).standard_normal(SHAPE))[
        labels == 0
    ]
    assert_allclose(segment(labels, source, dim_sigma_m=0.3).ends_m, WHOLE_M, atol=0.6 * PIXEL_M)


def test_of_a_flank_that_leads_away_no_more_than_a_pixel_is_taken_for_the_front():
    labels, source = brightened(dim(), slice(22, 42))
    for beside in range(8):
        depth_m = 5.0 + 0.12 * (beside + 1)
        source.range_m[8:20, 42 + beside] = wall(depth_m).range_m[8:20, 42 + beside]
    source.sigma_m[8:20, 42:50] = 0.2
    assert_allclose(segment(labels, source, dim_sigma_m=0.3).ends_m, WHOLE_M, atol=1.1 * PIXEL_M)


def test_dim_floor_beside_the_foot_of_a_thing_is_no_part_of_it():
    mounting = Mounting(z_m=0.3)
    down = -(rays(LENS, SHAPE) @ rotation(mounting)[2])
    source, labels = wall(1.0, sigma_m=0.02), block(slice(22, 28), slice(22, 42))
    beside = labels == 0
    source.range_m[beside] = np.where(down > 0, 0.3 / np.maximum(down, 1e-3), 9.0)[beside]
    source.sigma_m[beside], source.why[beside] = 0.25, Why.LOW_AMPLITUDE
    ends_m = [segment(labels, source, mounting, dim_sigma_m=sigma_m).ends_m for sigma_m in (0.0, 0.3)]
    assert_allclose(ends_m[1], ends_m[0])


def test_what_lies_beside_the_area_of_interest_belongs_to_a_thing_whose_end_is_seen():
    labels, source = brightened(dim(), slice(30, 42))
    source.range_m[THING], source.sigma_m[THING] = wall().range_m[THING], 0.02
    source.why[8:20, 22:30] = Why.OUTSIDE_AREA
    found = segment(labels, source, dim_sigma_m=0.3)
    assert_allclose(found.ends_m, WHOLE_M, atol=0.3 * PIXEL_M)
    assert found.cut == 0
    source.range_m[8:20, :22], source.sigma_m[8:20, :22] = wall().range_m[8:20, :22], 0.02
    source.why[8:20, :22] = Why.OUTSIDE_AREA  # as far as the image reaches
    found = segment(labels, source, dim_sigma_m=0.3)
    assert found.cut == Cut.LEFT
    assert_allclose(found.size_m[1], 12 * PIXEL_M, rtol=0.1)


# -- pieces of a surface that goes on ----------------------------------------------------------------------------------


def grazing(slope):
    """Return a wall that is 5 m away amid the image and comes nearer by `slope` m for each m to the left."""
    ray = rays(LENS, SHAPE)
    range_m = (5.0 / (ray[..., 0] + slope * ray[..., 1])).astype(np.float32)
    return RangeImage(0.0, range_m, np.full(SHAPE, 0.03, np.float32), np.ones_like(range_m), np.zeros(SHAPE, "u1"))


def slid(source, **changes):
    """Return by how much the covariance across and ahead of a piece of 20 columns grows because it may slide."""
    labels = block(slice(18, 22), slice(20, 40))
    sure, slides = (segment(labels, source, pieces_slide=on, **changes).covariance_m2 for on in (False, True))
    assert_allclose((slides - sure)[2], 0.0, atol=1e-12)
    return (slides - sure)[:2, :2]


@pytest.mark.parametrize("slope", [1.0, -1.0])
@pytest.mark.parametrize("reason", [Why.VALID, Why.ISOLATED])
def test_a_piece_of_a_wall_may_lie_anywhere_along_it(slope, reason):
    source = grazing(slope)
    source.why[:, :20], source.why[:, 40:] = reason, reason
    x = to_world(source, LENS, Mounting())[20, 20:40, 0]
    found = slid(source)
    assert found[0, 0] == pytest.approx((x.max() - x.min()) ** 2 / 12, rel=0.15)
    assert_allclose(found[0, 1], -found[0, 0] / slope, rtol=0.01)
    assert_allclose(found[1, 1], found[0, 0] / slope**2, rtol=0.02)
    assert np.linalg.det(found) == pytest.approx(0.0, abs=1e-9)
    source.range_m[:, :20] += 4.0  # it ends there
    assert_allclose(slid(source), found / 4, rtol=1e-5)


@pytest.mark.parametrize("reason", [Why.LOW_AMPLITUDE, Why.FLOOR, Why.BORDER])
def test_what_ends_at_both_sides_or_is_seen_squarely_slides_nowhere(reason):
    source = grazing(1.0)
    source.why[:, :20], source.why[:, 40:] = reason, reason
    assert_allclose(slid(source), 0.0)
    assert_allclose(slid(grazing(0.0)), 0.0)
