"""Claims about the microcontroller's integer chain: bit for bit against a second model, and against exact ranging."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.cw import RANGING, simulate
from rangecam.cw.fixed_point import chain
from rangecam.cw.fixed_point.chain import integer_chain
from rangecam.cw.fixed_point.edge import interface_words
from rangecam.cw.fixed_point.program import compiled, conversion, cosine_table, reference_words
from rangecam.cw.signal import reference_amplitude
from rangecam.errors import UsageError
from rangecam.geometry import rays
from rangecam.scene.view import View
from rangecam.types import RawFrame, Why

CAMERA = load_config("scaled_car_emulation").camera
SHAPE = (120, 160)
MARKER = 12500


def program_of(**settings):
    return replace(CAMERA, emulation=replace(CAMERA.emulation, **settings))


def golden(words, camera, dtype=np.int64):
    """The same chain from the thesis' text alone, in whole-array steps; dtype=object computes in Python's integers."""
    options = camera.emulation
    c0, c90, c180, c270 = words.astype(dtype)
    re, im = c0 - c180, camera.phase_sign * (c270 - c90)
    angle = golden_angle(im, re)
    per_rad_mm = options.speed_of_light_mps / (4 * math.pi * camera.modulation_hz) * 1e3
    eighth = round(math.pi / 4 * 2**27)
    offset = round(camera.offset_m * 1e3 / per_rad_mm * 2**27)
    angle = (angle + offset) % (8 * eighth)
    radial = (angle * round(per_rad_mm * 65536)) // 2**43
    height, width = re.shape
    row, column = np.arange(height)[:, None], np.arange(width)[None, :]
    cosine = [round(math.cos(math.radians(0.5 * k)) * 32768) for k in range(81)]
    seventh = [round(math.cos(math.radians(0.5 * k)) ** 7 * 32768) for k in range(81)]
    factor = lookup(cosine, abs(row - 60), dtype) * lookup(cosine, abs(column - 80), dtype)
    plane = (radial * ((factor + 16384) // 32768) + 16384) // 32768
    falloff = lookup(seventh, abs(row - 59), dtype) * lookup(seventh, abs(column - 79), dtype) // 32768
    reference = 160 + 2160 * falloff // 32768
    square = (re * re + im * im) // 4
    first = (reference * round(options.amplitude_threshold * 32768)) ** 2 // 2**30
    numerator = reference * round(options.wrap_threshold * 32768) * 10**6 // 32768
    limit = np.minimum(numerator * 256 // np.maximum(plane * plane, 1), 2**31 - 1)
    limit = np.where(plane == 0, np.where(numerator > 0, 2**31 - 1, 0), limit)
    bad = (square < first) | (square * 65536 < limit * limit)
    padded = np.pad(plane.astype(np.int64), 1, constant_values=-(10**6))
    around = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    common = (
        sum((abs(each - plane.astype(np.int64)) <= options.neighbour_tolerance_mm).astype(int) for each in around) - 1
    )
    inside = np.zeros((height, width), bool)
    inside[1:-1, 1:-1] = True
    bad = bad | (inside & (common < options.common_neighbours))
    judged = np.where(bad.astype(bool), options.marker_mm, plane).astype(np.int64)
    padded = np.pad(judged, 1)
    ordered = np.sort([padded[i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0)
    kept = (ordered < options.marker_mm).sum(axis=0)
    middle = np.take_along_axis(ordered, np.minimum(kept // 2, 8)[None], axis=0)[0]
    takes = inside & options.median & (~bad.astype(bool) | options.fill_holes) & (kept > 0)
    result = np.where(takes, middle, judged)
    return np.where(inside | (options.border == "keep"), result, options.marker_mm), square, plane


def lookup(table, place, dtype):
    return np.array(table, dtype)[place]


def golden_angle(im, re):
    """Quadrant by quadrant instead of by folding: the octant from signs and sizes."""
    eighth = round(math.pi / 4 * 2**27)
    table = [round(math.atan(k / 255) * 2**27) for k in range(256)] + [0]
    # odd octants rise from the axis, even ones are turned by an eighth: (large + small, large - small)
    quarter = np.where((re > 0) & (im >= 0), 0, np.where((re <= 0) & (im > 0), 1, np.where((re < 0) & (im <= 0), 2, 3)))
    along = np.where(quarter % 2 == 0, abs(re), abs(im))
    across = np.where(quarter % 2 == 0, abs(im), abs(re))
    second = across > along
    y = np.where(second, across - along, across)
    x = np.where(second, across + along, along)
    place = (y * 255 * 2**20) // np.where(x > 0, x, 1)
    entry = (place // 2**20).astype(int)
    low, high = lookup(table, entry, place.dtype), lookup(table, entry + 1, place.dtype)
    within = low + ((high - low) * (place % 2**20)) // 2**20
    within = np.where(entry == 255, table[255], within)
    return np.where((re == 0) & (im == 0), 0, (2 * quarter + second) * eighth + within)


def random_words(rng, kind):
    """Four phase images of 12 bits at the high end of a word: of the kinds that go wrong."""
    if kind == "any":
        raw = rng.integers(0, 4096, (4, *SHAPE))
    elif kind == "weak":
        raw = 2048 + rng.integers(-30, 31, (4, *SHAPE))
    elif kind == "extreme":
        raw = rng.choice([0, 1, 2047, 2048, 2049, 4094, 4095], (4, *SHAPE))
    elif kind == "octants":
        size, sign = rng.integers(0, 2048, SHAPE), rng.choice([-1, 1], (2, *SHAPE))
        axis = rng.integers(0, 3, SHAPE)
        real, imaginary = np.where(axis == 1, 0, size) * sign[0], np.where(axis == 2, 0, size) * sign[1]
        raw = np.stack([2048 + real, 2048 + 0 * real, 2048 + 0 * real, 2048 + imaginary])
        raw = np.clip(raw, 0, 4095)
    else:  # a smooth scene with the noise of a camera, so that the filters have something to keep
        row, column = np.indices(SHAPE)
        phase = 0.5 + 5.7 * np.sin(row / 40 + rng.uniform(0, 6)) ** 2 * np.cos(column / 60) ** 2 + (column > 80)
        size = 400 * np.exp(-(((column - 80) / 50.0) ** 2))
        raw = np.rint(
            [2048 + size * np.cos(phase + t) + rng.normal(0, 1, SHAPE) for t in np.radians([0, 90, 180, 270])]
        )
    return (raw.astype(np.uint16) << 4).astype(np.uint16)


KINDS = ("any", "weak", "extreme", "octants", "scene")
VARIANTS = {
    "default": {},
    "no thresholds": {"amplitude_threshold": 0.0, "wrap_threshold": 0.0},
    "strict": {"amplitude_threshold": 1.0, "wrap_threshold": 1.0, "common_neighbours": 8, "neighbour_tolerance_mm": 1},
    "filled, whole": {"fill_holes": True, "border": "keep", "common_neighbours": 5},
    "thresholds alone": {"median": False, "common_neighbours": 0, "marker_mm": 65535},
}


def identical(words, camera, dtype=np.int64):
    images, (distance, square, plane) = integer_chain(words, compiled(camera, SHAPE)), golden(words, camera, dtype)
    np.testing.assert_array_equal(images.distance_mm, distance)
    np.testing.assert_array_equal(images.square, square.astype(np.int64))
    np.testing.assert_array_equal(images.converted_mm, plane.astype(np.int64))
    return images


def test_a_million_random_pixels_are_identical_to_the_golden_model_bit_for_bit():
    rng, pixels = np.random.default_rng(5), 0
    for k in range(55):
        variant = list(VARIANTS.values())[k // len(KINDS) % len(VARIANTS)]
        camera = replace(program_of(**variant), phase_sign=rng.choice([1, -1]).item(), offset_m=rng.uniform(-9, 9))
        images = identical(random_words(rng, KINDS[k % len(KINDS)]), camera)
        pixels += images.why.size
    assert pixels > 1_000_000


@pytest.mark.parametrize("kind", KINDS)
def test_no_product_leaves_64_bits(kind):
    words = random_words(np.random.default_rng(6), kind)
    identical(words, program_of(amplitude_threshold=1.0, wrap_threshold=1.0), dtype=object)


def one_pixel(c0, c90, c180, c270, camera=None):
    words = np.zeros((4, *SHAPE), np.uint16)
    words[:, 60, 80] = c0, c90, c180, c270
    camera = camera or program_of(amplitude_threshold=0, wrap_threshold=0, common_neighbours=0, median=False)
    return integer_chain(words, compiled(camera, SHAPE)), words


def test_the_distances_reach_from_0_to_8823_mm_and_wrap_there():
    largest = one_pixel(65520, 16, 0, 0)[0].distance_mm[60, 80]  # the last angle before a whole turn
    assert largest == 8823  # N-S-003
    assert one_pixel(65520, 0, 0, 0)[0].distance_mm[60, 80] == 0
    assert one_pixel(0, 0, 65520, 0)[0].distance_mm[60, 80] == 8823 // 2
    assert one_pixel(0, 0, 0, 0)[0].distance_mm[60, 80] == 0
    shifted = replace(program_of(common_neighbours=0, amplitude_threshold=0, wrap_threshold=0), offset_m=0.001)
    assert one_pixel(65520, 16, 0, 0, shifted)[0].converted_mm[60, 80] == 0
    assert one_pixel(65520, 0, 0, 0, replace(shifted, offset_m=-0.001))[0].converted_mm[60, 80] == 8822


def test_full_words_make_17_bits_of_difference_and_more_than_32_of_sum():
    images, words = one_pixel(65520, 0, 0, 65520)
    real = words[0].astype(int) - words[2]
    assert np.abs(real).max() == 65520  # N-S-037, E-S-15
    assert 4 * int(images.square[60, 80]) == 8_585_740_800
    assert 8_585_740_800 > 2**32


def test_the_squared_limit_of_threshold_2_would_need_more_than_64_bits():
    assert round(8823.0**4 / 1e13) == 606  # N-S-038: 6.06e15
    assert math.log2(8823.0**4) < 53
    assert math.log2(8.586e9 / 4 * 8823.0**4) > 64


def wall(range_m, reflectivity=0.8, camera=CAMERA, seed=1):
    shape = (1, camera.rows, camera.columns)
    view = View(*(np.full(shape, value, np.float32) for value in (range_m, reflectivity, 1.0)))
    return simulate(lambda _: view, camera, 0.0, np.random.default_rng(seed))


def test_words_are_samples_of_12_bits_at_the_high_end():
    samples = [np.array([[0.0, 1.0, 4095.0, np.nan]])] * 4
    words = interface_words(samples, np.isfinite(samples[0]), CAMERA)
    assert words.dtype == np.uint16
    np.testing.assert_array_equal(words[0], [[0, 16, 65520, 0]])  # N-S-050
    np.testing.assert_array_equal(words[2] >> 4, [[0, 1, 4095, 0]])


def test_words_that_are_recorded_as_they_came_give_the_same_image_as_samples():
    raw = wall(1.5)
    words = RawFrame(raw.time_s, {name: plane << 4 for name, plane in raw.planes.items()})
    high = {"black_level_lsb": 32768.0, "quantisation_lsb": 16.0, "full_scale_lsb": 65535.0, "read_noise_lsb": 32.0}
    high |= {"reference_amplitude_lsb": 145.0 * 16, "reference_floor_lsb": 160.0, "shot_noise_lsb2_per_lsb": 0.64}
    camera = replace(program_of(word_shift=0), **high)
    images = [RANGING["cw_emulation"](*each) for each in ((raw, CAMERA), (words, camera))]
    np.testing.assert_array_equal(images[0].range_m, images[1].range_m)
    np.testing.assert_array_equal(images[0].why, images[1].why)
    np.testing.assert_allclose(images[0].amplitude * 16, images[1].amplitude, rtol=1e-6)
    np.testing.assert_allclose(images[0].sigma_m, images[1].sigma_m, rtol=1e-5)


def test_the_range_is_cut_to_millimetres_half_of_one_short_in_the_mean():
    camera = program_of(angles="lens", speed_of_light_mps=CAMERA.speed_of_light_mps)
    ranges = np.linspace(0.7, 1.3, 40)
    errors = []
    for k, range_m in enumerate(ranges):
        image = RANGING["cw_emulation"](wall(range_m, seed=k), camera)
        errors.append(np.mean((image.range_m - range_m)[image.valid]))
    assert np.mean(errors) == pytest.approx(-0.5e-3, abs=0.15e-3)


@pytest.mark.parametrize("range_m", [0.7, 1.5])
@pytest.mark.parametrize("median", [True, False])
def test_sigma_says_how_much_the_ranges_spread_through_the_median(range_m, median):
    camera = program_of(angles="lens", speed_of_light_mps=CAMERA.speed_of_light_mps, median=median)
    image = RANGING["cw_emulation"](wall(range_m), camera)
    score = ((image.range_m - range_m) / image.sigma_m)[image.valid]
    assert np.std(score) == pytest.approx(1, abs=0.03)
    assert np.mean(np.abs(score) < 1) == pytest.approx(0.68, abs=0.03)


def test_sigma_holds_where_the_median_has_few_values_and_takes_the_upper_of_two():
    rng = np.random.default_rng(4)
    camera = program_of(
        angles="lens", speed_of_light_mps=CAMERA.speed_of_light_mps, amplitude_threshold=0.2, common_neighbours=0
    )
    scores = []
    for seed in range(20):
        raw = wall(1.0, seed=seed)
        dark = rng.random(SHAPE) < 0.6
        raw = RawFrame(0.0, {name: np.where(dark, 2048, plane) for name, plane in raw.planes.items()})
        image = RANGING["cw_emulation"](raw, camera)
        scores.append(((image.range_m - 1.0) / image.sigma_m)[image.valid])
    together = np.concatenate(scores)
    assert together.mean() > 0.1  # the upper one of two is too long
    assert np.sqrt(np.mean(together**2)) == pytest.approx(1, abs=0.03)


def scene_view(*patches):
    """A wall at 1.2 m with patches: (rows, columns, range, reflectivity)."""
    range_m, reflectivity = np.full((1, *SHAPE), 1.2, np.float32), np.full((1, *SHAPE), 0.8, np.float32)
    for rows, columns, distance, rho in patches:
        range_m[0, rows, columns], reflectivity[0, rows, columns] = distance, rho
    view = View(range_m, reflectivity, np.ones((1, *SHAPE), np.float32))
    return simulate(lambda _: view, replace(CAMERA, pseudo_rows=0), 0.0, np.random.default_rng(2))


def test_each_reason_is_given_where_it_applies():
    raw = scene_view(
        (slice(20, 40), slice(40, 60), 1.2, 1e-4),
        (slice(60, 80), slice(40, 60), 8.8174 + 1.0, 3.0),
        (slice(100, 101), slice(80, 81), 0.6, 0.8),
    )
    planes = {name: plane.astype(np.float32) for name, plane in raw.planes.items()}
    planes["phase_90"][50, 100] = np.nan
    for name in planes:
        planes[name][90, 30] = 2048
    camera = replace(program_of(amplitude_threshold=0.025), pseudo_rows=0)
    image = RANGING["cw_emulation"](RawFrame(0.0, planes), camera)
    assert np.isin(image.why[22:38, 42:58], [Why.LOW_AMPLITUDE, Why.NO_SIGNAL]).mean() > 0.95
    assert (image.why[62:78, 42:58] == Why.WRAPPED).mean() > 0.6
    assert image.why[100, 80] == Why.ISOLATED
    assert image.why[50, 100] == Why.NOT_FINITE
    assert np.isnan(image.range_m[50, 100])
    assert image.why[90, 30] == Why.NO_SIGNAL
    assert np.all(image.why[0, 100:] == Why.BORDER)
    flagged = RANGING["cw_emulation"](RawFrame(0.0, planes), replace(camera, pseudo_rows=2))
    assert np.all(flagged.why[:2] == Why.SENSOR_FLAG)


def test_a_hole_is_filled_and_the_border_kept_where_that_is_asked_for():
    raw = scene_view((slice(50, 51), slice(70, 71), 1.2, 1e-4))
    plain = RANGING["cw_emulation"](raw, replace(CAMERA, pseudo_rows=0))
    assert not plain.valid[50, 70]
    assert not plain.valid[:, 0].any()
    camera = replace(program_of(fill_holes=True, border="keep"), pseudo_rows=0)
    filled = RANGING["cw_emulation"](raw, camera)
    assert filled.valid[50, 70]
    assert filled.range_m[50, 70] == pytest.approx(1.2, abs=0.03)
    assert filled.sigma_m[50, 70] < 0.01
    assert filled.valid[1:-1, 0].mean() > 0.9


def test_the_program_knows_no_saturation():
    raw = scene_view()
    planes = {name: plane.copy() for name, plane in raw.planes.items()}
    for name in planes:
        planes[name][60, 80] = 4095 if name in ("phase_0", "phase_90") else planes[name][60, 80]
    saturated = RawFrame(0.0, planes)
    assert RANGING["cw_four_phase"](saturated, CAMERA).why[60, 80] == Why.SATURATED
    assert RANGING["cw_emulation"](saturated, CAMERA).why[60, 80] != Why.SATURATED


def test_the_cosine_table_has_81_entries_that_serve_rows_and_columns():
    table = cosine_table(0.5, 160)
    assert table.size == 81  # N-S-027
    np.testing.assert_array_equal(table[:61], cosine_table(0.5, 120))
    assert table[80] == round(math.cos(math.radians(40)) * 32768)


def test_the_camera_angle_conversion_is_the_lens_but_for_half_a_pixel():
    by_table, by_lens = conversion(program_of(), SHAPE) / 32768, conversion(program_of(angles="lens"), SHAPE) / 32768
    np.testing.assert_allclose(by_lens, rays(CAMERA.lens, SHAPE)[..., 0], atol=1 / 65536)
    half_a_pixel = math.radians(0.25) * (math.tan(math.radians(40)) + math.tan(math.radians(30)))
    assert np.abs(by_table / by_lens - 1).max() < half_a_pixel + 1e-3
    assert np.abs(by_table / by_lens - 1).max() > 0.8 * half_a_pixel
    square_pixels = replace(CAMERA, lens=replace(CAMERA.lens, vertical_fov_deg=None))
    np.testing.assert_array_equal(conversion(square_pixels, SHAPE), conversion(CAMERA, SHAPE))


def test_the_reference_image_is_that_of_the_camera_but_for_half_a_pixel():
    words = reference_words(CAMERA, SHAPE) / 16
    assert words[59, 79] == pytest.approx(145.0, abs=0.05)  # N-S-028
    assert np.abs(words - reference_amplitude(CAMERA, SHAPE)).max() < 3.0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"modulation_hz": 12e6}, ["marker_mm = 12500", "12499 mm at 12 MHz", "65535"]),
        ({"modulation_hz": 10e6}, ["14999 mm"]),
        ({"phase_steps_deg": (0.0, 120.0, 240.0)}, ["phase_0, phase_120", "cw_emulation"]),
        ({"modulations_hz": (17e6, 30e6)}, ["f0_phase_0"]),
        ({"lower_limit_lsb": None}, ["lower_limit_lsb = None"]),
        ({"full_scale_lsb": 5000.0}, ["full_scale_lsb 5000", "0 to 4095"]),
    ],
)
def test_a_camera_that_does_not_fit_the_program_is_refused(settings, words):
    camera = replace(CAMERA, capture_order=(), **settings)
    if camera.modulation_hz == 12e6:  # 12500 mm less one angle: the last is cut to 12499
        camera = replace(camera, emulation=replace(camera.emulation, marker_mm=12499))
        words = [word.replace("12500", "12499") for word in words]
    with pytest.raises(UsageError) as failure:
        RANGING["cw_emulation"](RawFrame(0.0, wall(1.0).planes), camera)
    assert all(word in str(failure.value) for word in words)


def test_the_kernels_compute_the_same_without_a_compiler(monkeypatch):
    words = random_words(np.random.default_rng(7), "scene")[:, :30, :40].copy()
    compiled_images = integer_chain(words, compiled(CAMERA, (30, 40)))
    for name in ("_distances", "_thresholds", "_common_neighbours", "_median"):
        monkeypatch.setattr(chain, name, getattr(getattr(chain, name), "py_func", getattr(chain, name)))
    images = integer_chain(words, compiled(CAMERA, (30, 40)))
    np.testing.assert_array_equal(images.distance_mm, compiled_images.distance_mm)
    np.testing.assert_array_equal(images.why, compiled_images.why)
    np.testing.assert_array_equal(images.square, compiled_images.square)
