"""Claims about rain and snow before a camera: light of drops, their number, sizes and fall (König 2008, 5.2.1.3)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

from rangecam.cameras.simulated import frames
from rangecam.config import load_config
from rangecam.errors import UsageError
from rangecam.geometry import Lens, Mounting, position, rays, rotation
from rangecam.pulsed import RANGING, PulsedCamera, simulate
from rangecam.pulsed.settings import Pixel
from rangecam.scene.scenario import parse_scenario
from rangecam.scene.view import View
from rangecam.scene.weather import (
    Drop,
    Weather,
    extinction_perm,
    in_weather,
    mirrored,
    pixel_solid_angles,
    precipitation,
    rain_fall_mps,
)

FRONT_ONLY = Weather(rear_reflection=False)
LENS, SHAPE, LEVEL = PulsedCamera().lens, (8, 64), Mounting()
ROW, COLUMN = 4, 20


def wall(range_m=8.0, reflectivity=0.1, rays_of_pixel=4, shape=SHAPE):
    ones = np.ones((rays_of_pixel, *shape))
    return View(ones * range_m, ones * reflectivity, ones)


def with_drop(range_m, weather=FRONT_ONLY, view=None, lens=LENS, shape=SHAPE, mounting=LEVEL, **drop):
    """The view with one drop on the axis of a pixel."""
    ray = rotation(mounting) @ rays(lens, shape)[ROW, COLUMN] * range_m
    place = tuple(float(v) for v in position(mounting) + ray)
    weather = replace(weather, drops=(Drop(position_m=place, **{"diameter_m": 6e-3, **drop}),))
    hanging = precipitation(weather, lens, mounting, shape, np.random.default_rng(0), 10.0)
    return in_weather(view or wall(shape=shape), hanging, weather, lens, mounting, 3.0)


def light_of(view):
    """What the rays of each pixel send back, over that of a white surface at 1 m, behind the rays of `wall`."""
    every = np.where(np.isfinite(view.range_m), view.reflectivity * view.cos_incidence / view.range_m**2, 0.0)
    return every[4:].sum(axis=0) / len(every)


def drop_light(range_m, weather=FRONT_ONLY, **settings):
    return light_of(with_drop(range_m, weather, **settings))


# --- one drop -----------------------------------------------------------------------------------------------------


def test_a_drop_sends_back_what_a_mirroring_sphere_does():
    """N-K-070, from first principles: intensity E R0 r^2 / 4 of a sphere, pi D^2 / 4 of the lens, against a wall."""
    camera, d = PulsedCamera(), 1.0
    area, f = camera.pixel.pitch_horizontal_m * camera.pixel.pitch_vertical_m, camera.objective.focal_length_m
    aperture = np.pi / 4 * camera.objective.aperture_m**2
    drop = 0.0197 * 3e-3**2 / 4 / d**2 * aperture / d**2
    wall_at_1_m = area / f**2 / np.pi * aperture
    assert drop_light(d)[ROW, COLUMN] == pytest.approx(drop / wall_at_1_m, rel=0.02)  # cos^3 off the axis


@pytest.mark.parametrize(("target_m", "drop_m"), [(2.0, 0.43), (8.0, 0.86), (20.0, 1.36)])
def test_a_6_mm_drop_is_as_bright_as_a_tenth_reflecting_target_behind_it(target_m, drop_m):
    """N-K-070 to its digits: the range at which the drop's fourth power meets the light of the target."""
    at_1_m = drop_light(1.0)[ROW, 32] + drop_light(1.0)[ROW, COLUMN] * np.cos(np.radians(4.5)) ** 3
    assert (at_1_m / 0.1 * target_m**2) ** 0.25 == pytest.approx(drop_m, abs=0.005)


@pytest.mark.parametrize(
    ("drop_m", "measured_m"),
    [(0.3, 0.41), (0.5, 1.26), (0.75, 3.39), (1.0, 5.50), (1.5, 7.36), (2.0, 7.80), (3.0, 7.97)],
)
def test_the_measured_range_through_a_drop_comes_out_of_the_whole_chain(drop_m, measured_m):
    """N-K-072: a 6 mm drop before a target of 0.1 at 8 m, with the simulated camera and MDSI3."""
    quiet = Pixel(sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0)
    camera = PulsedCamera(speed_of_light_mps=3e8, pixel=quiet)
    ray = rays(LENS, SHAPE)[4, 32] * drop_m
    weather = replace(FRONT_ONLY, drops=(Drop(position_m=tuple(map(float, ray)), diameter_m=6e-3),))
    hanging = precipitation(weather, LENS, LEVEL, SHAPE, np.random.default_rng(0), 0.0)
    view = in_weather(wall(), hanging, weather, LENS, LEVEL, 0.0)
    image = RANGING["mdsi3"](simulate(lambda _: view, camera, 0.0, np.random.default_rng(0)), camera)
    assert image.range_m[4, 32] == pytest.approx(measured_m, abs=0.012)
    assert image.range_m[4, 31] == pytest.approx(8.0, abs=1e-4)


def test_the_light_of_a_mirroring_drop_falls_with_the_fourth_power_however_near():
    """N-K-071 with E-K-14: a glint is a point, and fills no pixel."""
    for range_m in (0.2, 0.5, 1.0, 4.0):
        assert drop_light(range_m).sum() == pytest.approx(drop_light(1.0).sum() / range_m**4, rel=1e-5)


def test_a_flake_falls_with_the_fourth_power_while_it_is_smaller_than_the_footprint_and_with_the_square_nearer():
    """E-K-14: the footprint of a pixel is 6 mm wide at 0.72 m."""
    footprint_m = 130e-6 / PulsedCamera().objective.focal_length_m
    assert 6e-3 / footprint_m == pytest.approx(0.72, abs=0.005)
    far = drop_light(2.0, kind="snow")[ROW, COLUMN] * 2.0**4
    for range_m in (0.74, 1.0, 1.5, 5.0):
        assert drop_light(range_m, kind="snow")[ROW, COLUMN] * range_m**4 == pytest.approx(far, rel=1e-4)
    assert drop_light(0.6, kind="snow")[ROW, COLUMN] * 0.6**4 < 0.99 * far
    near = [drop_light(d, kind="snow")[ROW, COLUMN] * d**2 for d in (0.1, 0.15, 0.2)]  # covers all of the pixel
    assert near == pytest.approx([0.8 * 2 / 3] * 3, rel=0.03)


def test_a_near_flake_lights_its_neighbours_and_none_of_its_light_is_lost():
    lights = drop_light(0.3, kind="snow", diameter_m=6e-3)
    assert np.count_nonzero(lights) > 4
    assert lights.sum() == pytest.approx(drop_light(2.0, kind="snow").sum() * (2.0 / 0.3) ** 4, rel=0.01)


def test_the_rear_of_a_drop_is_brighter_than_its_front():
    """Two refractions and a mirror of the same Fresnel reflection, focused (n / (2 - n))^2 times."""
    n, front = 1.3265, 0.0197
    assert mirrored(FRONT_ONLY) == pytest.approx(front / 4, rel=1e-3)
    assert mirrored(Weather()) == pytest.approx(front / 4 * (1 + (1 - front) ** 2 * (n / (2 - n)) ** 2), rel=1e-3)
    assert mirrored(Weather(refractive_index=1.5, rear_reflection=False)) == pytest.approx(0.04 / 4)


def test_the_focusing_of_the_rear_is_that_of_traced_rays():
    """A ray at height b leaves at 2 i - 4 t from where it came; b db over the solid angle is the gain over a mirror."""
    n, b = 1.3265, 1e-3
    turned = 4 * np.arcsin(b / n) - 2 * np.arcsin(b)
    assert (b / turned) ** 2 / (1 / 4) == pytest.approx((n / (2 - n)) ** 2, rel=1e-5)


def test_a_flake_is_a_diffuse_ball_of_its_reflectivity():
    bright, dark = (drop_light(2.0, replace(FRONT_ONLY, snow_reflectivity=r), kind="snow") for r in (0.8, 0.4))
    assert bright[ROW, COLUMN] == pytest.approx(2 * dark[ROW, COLUMN])


def test_a_drop_lights_the_pixel_that_looks_at_it_wherever_the_camera_stands():
    for lens in (LENS, Lens(horizontal_fov_deg=90.0, projection="equiangular")):
        for mounting in (LEVEL, Mounting(x_m=1.0, y_m=-0.5, z_m=1.2, roll_deg=5.0, pitch_deg=10.0, yaw_deg=30.0)):
            lights = drop_light(1.5, lens=lens, mounting=mounting)
            assert np.argwhere(lights).tolist() == [[ROW, COLUMN]]


def test_drops_behind_and_beside_the_view_are_not_seen():
    for place in ((-1.0, 0.0, 0.0), (0.1, 3.0, 0.0), (1.0, 0.0, 2.0)):
        weather = Weather(drops=(Drop(position_m=place, diameter_m=0.01),))
        hanging = precipitation(weather, LENS, LEVEL, SHAPE, np.random.default_rng(0), 0.0)
        view = wall()
        assert in_weather(view, hanging, weather, LENS, LEVEL, 0.0) is view


def test_what_is_behind_a_drop_keeps_its_light():
    view, through = wall(), with_drop(1.0)
    share = len(view.range_m) / len(through.range_m)
    np.testing.assert_allclose(through.reflectivity[:4] * share, view.reflectivity, rtol=1e-6)
    np.testing.assert_array_equal(through.range_m[:4], view.range_m)


def test_the_pixels_of_an_image_see_the_solid_angle_of_the_whole_view():
    lens = Lens(horizontal_fov_deg=60.0, vertical_fov_deg=40.0)
    a, b = np.tan(np.radians([30.0, 20.0]))
    whole = 4 * np.arcsin(a * b / np.sqrt((1 + a * a) * (1 + b * b)))
    assert pixel_solid_angles(lens, (80, 120)).sum() == pytest.approx(whole, rel=1e-3)
    even = replace(lens, projection="equiangular")
    bands = np.radians(60.0) * 2 * np.sin(np.radians(20.0))
    assert pixel_solid_angles(even, (80, 120)).sum() == pytest.approx(bands, rel=1e-3)


# --- fields of drops ----------------------------------------------------------------------------------------------


def field(weather, seed=0, speed_mps=0.0, lens=LENS):
    return precipitation(weather, lens, LEVEL, SHAPE, np.random.default_rng(seed), speed_mps)


@pytest.mark.parametrize("rate", [2.0, 25.0])
def test_the_sizes_of_raindrops_follow_marshall_and_palmer(rate):
    """Kolmogorov and Smirnov, 99.9 %."""
    diameter_mm = field(Weather(rain_mm_per_h=rate)).diameter_m * 1e3
    steep, ends = 4.1 * rate**-0.21, np.array([0.2, 8.0])
    low, high = np.exp(-steep * ends)
    assert kstest(diameter_mm, lambda d: (low - np.exp(-steep * d)) / (low - high)).pvalue > 1e-3
    assert diameter_mm.min() >= 0.2
    assert diameter_mm.max() <= 8.0


def test_as_many_raindrops_are_in_a_cubic_metre_as_the_distribution_says():
    lens, weather = Lens(horizontal_fov_deg=40.0, vertical_fov_deg=20.0), Weather(rain_mm_per_h=25.0)
    falling = field(weather, lens=lens)
    at_m = np.linalg.norm(falling.position_m, axis=1)
    x, y, z = falling.position_m.T
    inside = (x > 0) & (abs(y) < x * np.tan(np.radians(20))) & (abs(z) < x * np.tan(np.radians(10))) & (at_m > 1.0)
    volume_m3 = pixel_solid_angles(lens, (200, 400)).sum() / 3 * (5.0**3 - 1.0**3)
    expected = 8000 * quad(lambda d: np.exp(-4.1 * 25**-0.21 * d), 0.2, 8.0)[0] * volume_m3
    assert abs(inside.sum() - expected) < 4 * np.sqrt(expected)


def test_the_water_that_falls_is_the_rain_rate():
    """The flux of volume of the field: Marshall-Palmer sizes with Atlas' speeds give the rate to a fifth."""
    for rate in (5.0, 25.0, 50.0):
        steep = 4.1 * rate**-0.21
        flux = quad(
            lambda d, s=steep: np.pi / 6 * (d * 1e-3) ** 3 * 8000 * np.exp(-s * d) * rain_fall_mps(np.array(d * 1e-3)),
            0.2,
            8.0,
        )[0]
        assert flux * 3600 * 1e3 == pytest.approx(rate, rel=0.2)


def test_the_extinction_is_the_sum_of_the_cross_sections():
    rain = extinction_perm(Weather(rain_mm_per_h=25.0))
    steep = 4.1e3 * 25**-0.21
    assert rain == pytest.approx(quad(lambda d: np.pi / 4 * d**2 * 8e6 * np.exp(-steep * d), 2e-4, 8e-3)[0], rel=1e-6)
    snow = extinction_perm(Weather(snow_mm_per_h=2.5))
    melted = quad(lambda d: np.pi / 4 * d**2 * 3.8e6 * 2.5**-0.87 * np.exp(-2550 * 2.5**-0.48 * d), 2e-4, 8e-3)[0]
    assert snow == pytest.approx(melted * 10 ** (2 / 3), rel=1e-6)
    assert extinction_perm(Weather(rain_mm_per_h=25.0, snow_mm_per_h=2.5)) == pytest.approx(rain + snow)
    assert extinction_perm(Weather()) == 0


def test_the_wall_behind_rain_is_dimmed_twice_on_the_way():
    weather = Weather(rain_mm_per_h=25.0, within_m=0.2, nearest_m=0.19)
    view = in_weather(wall(20.0), field(weather), weather, LENS, LEVEL, 0.0)
    share = 4 / len(view.range_m)
    expected = 0.1 * np.exp(-2 * extinction_perm(weather) * 20.0)
    assert view.reflectivity[:4] * share == pytest.approx(np.full((4, *SHAPE), expected), rel=1e-5)


def test_a_ray_that_meets_nothing_stays_dark_in_rain():
    weather = Weather(rain_mm_per_h=25.0)
    empty = View(np.full((1, *SHAPE), np.inf), np.zeros((1, *SHAPE)), np.zeros((1, *SHAPE)))
    view = in_weather(empty, field(weather), weather, LENS, LEVEL, 0.0)
    assert np.isfinite(view.reflectivity).all()
    assert np.all(view.reflectivity[0] == 0)
    assert np.all(view.reflectivity[np.isinf(view.range_m)] == 0)


def test_flakes_are_larger_than_their_melted_drops_and_fall_at_their_own_speed():
    weather = Weather(snow_mm_per_h=2.0, snow_density_kgpm3=125.0, snow_fall_mps=1.5)
    flakes = field(weather, speed_mps=8.0)
    assert flakes.diameter_m.min() == pytest.approx(2 * 2e-4, rel=0.01)
    assert not flakes.mirrors.any()
    np.testing.assert_array_equal(np.unique(flakes.velocity_mps, axis=0), [[-8.0, 0.0, -1.5]])


def test_drops_fall_and_come_nearer_between_two_exposures():
    weather = Weather(rain_mm_per_h=10.0)
    falling = field(weather, speed_mps=10.0)
    np.testing.assert_allclose(falling.velocity_mps[:, 2], -rain_fall_mps(falling.diameter_m))
    assert rain_fall_mps(np.array([2e-3])) == pytest.approx(6.5, abs=0.1)  # Gunn and Kinzer 1949: 6.49 m/s
    early, late = (in_weather(wall(), falling, weather, LENS, LEVEL, after_s) for after_s in (0.0, 0.01))
    assert early.range_m.shape != late.range_m.shape or not np.array_equal(early.range_m, late.range_m)


def test_the_field_ends_where_it_is_told_to():
    weather = Weather(rain_mm_per_h=25.0, nearest_m=0.5, within_m=2.0)
    at_m = np.linalg.norm(field(weather).position_m, axis=1)
    assert at_m.min() >= 0.5
    assert at_m.max() <= 2.0


def test_drops_smear_along_their_fall_during_an_exposure():
    weather = Weather(rain_mm_per_h=2.0, smallest_radius_m=1e-3)
    falling = field(weather)
    sharp = in_weather(wall(), falling, weather, LENS, LEVEL, 0.0)
    smeared = in_weather(wall(), falling, replace(weather, streak_s=0.01), LENS, LEVEL, 0.0)
    assert np.count_nonzero(light_of(smeared)) > 1.5 * np.count_nonzero(light_of(sharp))
    assert light_of(smeared).max() < light_of(sharp).max()


def test_drops_of_no_size_are_refused():
    with pytest.raises(UsageError, match=r"smallest_radius_m = 0.01: must be below weather.largest_radius_m = 0.004"):
        field(Weather(rain_mm_per_h=1.0, smallest_radius_m=0.01))


# --- in a scenario ------------------------------------------------------------------------------------------------

SCENE = """
description = "a wall"
preset = "usercams"
duration_s = 0.08
[[objects]]
name = "wall"
path.start_m = [12.0, 0.0, 0.0]
boxes = [{ center_m = [0.5, 0.0, 0.0], size_m = [1.0, 50.0, 50.0], reflectivity = 0.3 }]
"""
RAIN = "[weather]\nrain_mm_per_h = 50.0\ndrops = [{ position_m = [0.8, 0.0, 1.0], diameter_m = 0.006 }]\n"


@pytest.mark.parametrize("preset", ["usercams", "scaled_car", "generic_range"])
def test_every_family_of_cameras_sees_the_weather_of_a_scenario(preset):
    small = {"camera": {"rows": 8, "columns": 12, "frame_rate_hz": 25.0}, "mounting": {"z_m": 1.0, "pitch_deg": 0.0}}
    config = load_config(preset, small)
    dry, wet, again = (
        [c.raw for c in frames(parse_scenario("t", text), config, 5)] for text in (SCENE, SCENE + RAIN, SCENE + RAIN)
    )
    for name in dry[0].planes:
        np.testing.assert_array_equal(wet[0].planes[name], again[0].planes[name])
    assert any(not np.array_equal(dry[0].planes[name], wet[0].planes[name]) for name in dry[0].planes)


def test_rain_is_drawn_anew_for_each_frame_and_shortens_the_ranges():
    quiet = {"camera": {"pixel": {"photon_noise": False, "sensor_noise_v": 0.0, "readout_noise_v": 0.0}}}
    config = load_config("usercams", quiet, {"mounting": {"z_m": 1.0}})
    images = [
        RANGING["mdsi3"](c.raw, config.camera).range_m
        for c in frames(parse_scenario("t", SCENE + "[weather]\nrain_mm_per_h = 25.0\n"), config, 1)
    ]
    assert not np.array_equal(images[0], images[1])
    errors = images[0] - 12.0 / rays(config.camera.lens, SHAPE)[..., 0]
    # A drop brightens one window only, as the other is taken 10 ms later: errors of both signs, more often short.
    assert np.nanpercentile(errors, 10) < -0.05
