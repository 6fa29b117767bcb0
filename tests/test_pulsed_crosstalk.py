"""Crosstalk of the pulsed camera and its correction (König 2008, 4.2.1.4)."""

from dataclasses import replace

import numpy as np
import pytest

from rangecam.optics import blur_radius_m
from rangecam.pulsed import RANGING, PulsedCamera, simulate
from rangecam.pulsed.camera import ambient_irradiance, laser_exposure
from rangecam.pulsed.crosstalk import Crosstalk, disc_weights, electrical, foreign_light, optical
from rangecam.pulsed.settings import Laser, Pixel, Taps
from rangecam.pulsed.signal import shutter_windows
from rangecam.scene.view import View
from rangecam.types import Why

SILENT = Pixel(photon_noise=False, adc_bits=0, sensor_noise_v=0.0, readout_noise_v=0.0)
CAMERA = PulsedCamera(speed_of_light_mps=3e8, pixel=SILENT)
PARTS = {
    "blur": Crosstalk(blur=True),
    "stray": Crosstalk(stray_fraction=0.04),
    "glass": Crosstalk(cover_glass_fraction=0.05),
    "electrical": Crosstalk(electrical_fraction=0.01),
}
KNOWN = Crosstalk(stray_fraction=0.04, cover_glass_fraction=0.05, electrical_fraction=0.02)


def with_parts(crosstalk, camera=CAMERA):
    return replace(camera, crosstalk=crosstalk)


def one_lit(camera):
    """Light in one pixel in the middle of the image, (1, H, W)."""
    light = np.zeros((1, camera.rows, camera.columns))
    light[0, 4, 32] = 1.0
    return light


def scene(camera, dark=0.05, bright=1.0):
    """A dark wall at 15 m with a bright board at 3 m in front of its middle."""
    range_m, reflectivity = (np.full((1, camera.rows, camera.columns), v) for v in (15.0, dark))
    range_m[0, 2:6, 28:36], reflectivity[0, 2:6, 28:36] = 3.0, bright
    return View(range_m, reflectivity, np.ones_like(range_m))


def shoot(view, camera, seed=0):
    return simulate(lambda _: view, camera, 0.0, np.random.default_rng(seed))


def measure(camera, seed=0):
    return RANGING["mdsi3"](shoot(scene(camera), camera, seed), camera)


# --- each part ---------------------------------------------------------------------------------------------------


def test_crosstalk_is_off_unless_asked_for():
    light = np.random.default_rng(0).random((1, 8, 64))
    np.testing.assert_array_equal(optical(light, np.full_like(light, 2.0), CAMERA), light[0])
    assert electrical(light, Crosstalk()) is light


@pytest.mark.parametrize("name", PARTS)
def test_each_part_alone_pulls_a_dark_neighbour_of_a_bright_board_towards_it(name):
    """The measured range of dark pixels is distorted towards the bright region (4.2.1.4)."""
    neighbour, far = (4, 36), (0, 0)
    image = measure(with_parts(PARTS[name]))
    assert image.range_m[neighbour] < 15.0 - 0.02
    assert (abs(image.range_m[far] - 15.0) > 0.02) == (name in ("stray", "electrical"))
    assert image.range_m[4, 32] == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("depth_m", [2.0, 3.0, 20.0])
def test_blur_reaches_the_direct_neighbours_by_the_radius_of_its_disc_and_no_farther(depth_m):
    """K-OPT-09, N-K-013. Oracle: random points of the disc, and how much of a pixel each shift moves."""
    camera = with_parts(PARTS["blur"])
    image = optical(one_lit(camera), np.full((1, 8, 64), depth_m), camera)
    rng, radius_m = np.random.default_rng(1), float(blur_radius_m(depth_m, camera.objective))
    r, angle = radius_m * np.sqrt(rng.random(400_000)), 2 * np.pi * rng.random(400_000)
    dy, dx = r * np.sin(angle) / 300e-6, r * np.cos(angle) / 130e-6
    right = np.mean(np.clip(dx, 0, 1) * (1 - np.abs(dy)))
    corner = np.mean(np.clip(dx, 0, 1) * np.clip(dy, 0, 1))
    assert image[4, 33] == pytest.approx(right, rel=0.01)
    assert image[3, 31] == pytest.approx(corner, rel=0.02)
    assert image.sum() == pytest.approx(1)
    assert image[4, 34] == image[6, 32] == 0


def test_blur_of_what_is_very_near_reaches_farther_and_joins_smoothly():
    """Discs larger than a pixel are summed point by point; at one pixel both ways agree."""
    small, large = (disc_weights(0.4, radius, (5, 9)) for radius in (1.0, 1.0 + 1e-9))
    np.testing.assert_allclose(small, large, atol=2e-3)
    wide = disc_weights(2.0, 3.0, (9, 13))
    assert wide.sum() == pytest.approx(1)
    rows, columns = np.mgrid[-4:5, -6:7]
    # a quarter of the squared radius, and the sixth of a pixel that sharing between two pixels adds
    assert (wide * columns**2).sum() == pytest.approx(3.0**2 / 4 + 1 / 6, rel=0.02)
    assert (wide * rows**2).sum() == pytest.approx(2.0**2 / 4 + 1 / 6, rel=0.02)


def test_blur_keeps_an_even_scene_but_for_the_edges_of_the_image():
    camera = with_parts(PARTS["blur"])
    image = optical(np.ones((1, 8, 64)), np.full((1, 8, 64), 2.0), camera)
    np.testing.assert_allclose(image[1:-1, 1:-1], 1)
    assert (image[0] < 1).all()


def test_distance_of_influence_depends_on_the_pitch():
    """K-PIX-17."""
    wide = replace(CAMERA, pixel=replace(SILENT, pitch_horizontal_m=300e-6))
    near = np.full((1, 8, 64), 2.0)
    small, large = (optical(one_lit(c), near, with_parts(PARTS["blur"], c))[4, 33] for c in (CAMERA, wide))
    assert large < 0.6 * small


def test_stray_light_spreads_its_part_over_the_whole_sensor():
    """K-OPT-11."""
    camera = with_parts(PARTS["stray"])
    image = optical(one_lit(camera), np.full((1, 8, 64), 5.0), camera)
    assert image[4, 32] == pytest.approx(0.96 + 0.04 / 512)
    assert image[0, 0] == pytest.approx(0.04 / 512)
    assert image.sum() == pytest.approx(1)


def test_the_cover_glass_reaches_over_several_pixels():
    """K-OPT-12: bounce by bounce the disc grows by gap / f#, 4.8 pixels of 130 um, and its light falls by the part."""
    camera = with_parts(PARTS["glass"])
    image = optical(one_lit(camera), np.full((1, 8, 64), 5.0), camera)
    radius = 0.5e-3 / camera.objective.f_number / 130e-6
    assert radius == pytest.approx(4.8, abs=0.01)
    assert image[4, 32] == pytest.approx(0.95, rel=2e-3)
    first = 0.05 * 0.95 / (np.pi * radius**2 * 130 / 300)
    assert image[4, 32 + 2] == pytest.approx(first, rel=0.05)
    assert first / 10 > image[4, 32 + 7] > 1e-6 > abs(image[4, 32 + 17])
    assert 0.98 < image.sum() <= 1  # some leaves the sensor
    thin = with_parts(Crosstalk(cover_glass_fraction=0.05, cover_glass_gap_m=0.05e-3))
    assert abs(optical(one_lit(thin), np.full((1, 8, 64), 5.0), thin)[4, 32 + 4]) < 1e-12


def test_references_add_a_part_of_the_mean_signal_to_every_pixel():
    """K-PIX-17."""
    signal = np.random.default_rng(2).random((2, 8, 64))
    coupled = electrical(signal, PARTS["electrical"])
    np.testing.assert_allclose(coupled - signal, 0.01 * signal.mean(axis=(1, 2))[:, None, None] * np.ones((2, 8, 64)))


def test_ambient_light_goes_the_same_ways_but_does_not_couple_through_the_references():
    view = replace(scene(CAMERA), ambient_wpm2=500.0)
    plain = ambient_irradiance(view, CAMERA)
    stray = ambient_irradiance(view, with_parts(PARTS["stray"]))
    np.testing.assert_allclose(stray, 0.96 * plain + 0.04 * plain.mean())
    planes = [shoot(view, with_parts(part)).planes["ambient"] for part in (Crosstalk(), PARTS["electrical"])]
    np.testing.assert_array_equal(*planes)


def test_rays_blur_by_their_own_range():
    """A pixel that sees near and far gives its near light more blur."""
    camera, light = with_parts(PARTS["blur"]), np.concatenate([one_lit(CAMERA), one_lit(CAMERA)])
    depth_m = np.concatenate([np.full((1, 8, 64), 2.0), np.full((1, 8, 64), 20.0)])
    both = optical(light, depth_m, camera)
    apart = [optical(light[i : i + 1], depth_m[i : i + 1], camera) for i in (0, 1)]
    np.testing.assert_allclose(both, (apart[0] + apart[1]) / 2)


# --- correction --------------------------------------------------------------------------------------------------


def test_foreign_light_is_what_the_known_parts_brought():
    """Round trip: what comes in from others, and nothing of what the pixel keeps of its own."""
    camera = with_parts(KNOWN)
    light = laser_exposure(scene(camera), shutter_windows(camera)["c"], 0.0, CAMERA)
    signal = electrical(optical(light[None], np.full((1, 8, 64), 5.0), camera), KNOWN)
    np.testing.assert_allclose(signal - foreign_light(signal, camera), 0.96 * 0.95 * light, rtol=1e-6)
    assert not foreign_light(signal, with_parts(replace(KNOWN, stray_fraction=1.0))).any()


def test_correction_brings_the_ranges_back():
    """K-FUT-01."""
    wrong, right = measure(with_parts(KNOWN)), measure(with_parts(replace(KNOWN, correct=True)))
    assert np.abs(wrong.range_m[0] - 15.0).max() > 1.0
    np.testing.assert_allclose(right.range_m[0], 15.0, atol=1e-3)
    np.testing.assert_allclose(right.range_m[2:6, 28:36], 3.0, atol=1e-3)
    nothing = with_parts(Crosstalk(correct=True))
    np.testing.assert_array_equal(measure(nothing).range_m, measure(CAMERA).range_m)


def test_intervals_hold_the_truth_after_correction():
    camera = with_parts(replace(KNOWN, correct=True), replace(CAMERA, pixel=Pixel()))
    truth = scene(camera).range_m[0]
    images = [measure(camera, seed) for seed in range(60)]
    deviation = np.concatenate([np.abs((i.range_m - truth) / i.sigma_m)[i.valid & (truth < 10)] for i in images])
    assert 0.63 < np.mean(deviation < 1) < 0.73
    assert 0.93 < np.mean(deviation < 1.96) < 0.97


def test_a_full_pixel_stays_full_and_a_broken_one_hurts_no_other():
    camera = with_parts(replace(KNOWN, correct=True))
    raw = shoot(scene(camera, bright=50.0), camera)
    image = RANGING["mdsi3"](raw, camera)
    assert (image.why[2:6, 28:36] == Why.SATURATED).all()
    good = shoot(scene(camera), camera)
    planes = {name: plane.copy() for name, plane in good.planes.items()}
    planes["shutter_a"][0, 0], planes["n_acc"][0, 1] = np.nan, 0
    image = RANGING["mdsi3"](replace(good, planes=planes), camera)
    assert (image.why[0, :2] == [Why.NOT_FINITE, Why.NO_SIGNAL]).all()
    np.testing.assert_allclose(image.range_m[0, 2:], 15.0, atol=0.15)


@pytest.mark.parametrize("dark", [True, False])
def test_taps_are_corrected_as_well(dark):
    quiet = Taps(read_noise_counts=0.0, shot_noise_counts2_per_count=0.0, saturation_counts=1e7, pulses=30000)
    camera = PulsedCamera(
        speed_of_light_mps=3e8, readout="three_tap", pulse_width_s=30e-9, frame_rate_hz=30.0, taps=quiet,
        laser=Laser(peak_power_w=20.0, repetition_hz=1e6), crosstalk=KNOWN,
    )  # fmt: skip
    range_m, reflectivity = (np.full((1, 8, 64), v) for v in (3.5, 0.1))
    range_m[0, 2:6, 28:36], reflectivity[0, 2:6, 28:36] = 1.0, 1.0
    raw = shoot(View(range_m, reflectivity, np.ones_like(range_m)), camera)
    if not dark:
        raw = replace(raw, planes={name: plane for name, plane in raw.planes.items() if name.startswith("tap")})
    wrong, right = (
        RANGING["three_tap"](raw, replace(camera, crosstalk=replace(KNOWN, correct=on))).range_m for on in (False, True)
    )
    assert np.abs(wrong[0] - 3.5).max() > 0.2
    np.testing.assert_allclose(right[0], 3.5, atol=0.01)
