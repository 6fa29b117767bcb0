"""Claims about several modulation frequencies: how far they reach, how often they fail, and what is refused."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.cw import simulate
from rangecam.cw.phasor import harmonic_weights
from rangecam.cw.ranging import cw_multi_frequency
from rangecam.cw.sequence import plane_name, single_frequencies
from rangecam.cw.signal import metres_per_radian
from rangecam.cw.unwrapping import accepted_error_probability, combine, combined_sigma_m, gross_error_probability
from rangecam.errors import UsageError
from rangecam.scene.view import View
from rangecam.types import SPEED_OF_LIGHT, RawFrame, Why
from test_cw_phasor import CAMERA, frame_of

STEPS = (0, 120, 240)
TWO = replace(CAMERA, modulations_hz=(60e6, 80e6), phase_steps_deg=STEPS, max_phase_sigma_rad=0.5)
THREE = replace(TWO, modulations_hz=(80e6, 16e6, 120e6))
FOUR = replace(TWO, modulations_hz=(80e6, 55e6, 35e6, 15e6))
BARE = {"unwrap_phase_error_rad": 0.0, "unwrap_residual_sigmas": 100.0}


@pytest.mark.parametrize(
    ("megahertz", "reach_m"), [((17, 12), 150.0), ((30, 20), 15.0), ((30, 17), 150.0), ((30, 12), 25.0)]
)
def test_two_frequencies_reach_half_the_wavelength_of_their_common_divisor(megahertz, reach_m):
    together = combine(tuple(f * 1e6 for f in megahertz), 3e8)
    assert together.unambiguous_m == pytest.approx(reach_m)  # N-S-039
    camera = replace(CAMERA, modulations_hz=tuple(f * 1e6 for f in megahertz), speed_of_light_mps=3e8)
    range_m = np.linspace(0.02, 0.98, 90).reshape(9, 10) * reach_m
    image = cw_multi_frequency(frame_of(camera, range_m), replace(camera, read_noise_lsb=0.5))
    assert image.valid.all()
    np.testing.assert_allclose(image.range_m, range_m, atol=2e-4 * reach_m / 10)


def test_17_mhz_alone_wraps_where_17_and_12_do_not():
    camera = replace(CAMERA, modulations_hz=(17e6, 12e6), read_noise_lsb=0.5)
    alone = 2 * np.pi * metres_per_radian(replace(CAMERA, modulation_hz=17e6))
    assert alone == pytest.approx(8.818, abs=1e-3)
    image = cw_multi_frequency(frame_of(camera, np.array([[1.0, 1.0 + alone, 1.0 + 12 * alone]])), camera)
    np.testing.assert_allclose(image.range_m[0] - 1.0, [0, alone, 12 * alone], atol=1e-3)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("camera", [TWO, THREE, FOUR], ids=["two", "three", "four"])
def test_every_range_comes_back_whatever_sign_and_offset(camera, sign):
    camera = replace(camera, phase_sign=sign, offset_m=1.7)
    reach_m = combine(camera.modulations_hz, SPEED_OF_LIGHT).unambiguous_m
    range_m = np.linspace(0.01, reach_m - 0.01, 2000).reshape(40, 50)
    image = cw_multi_frequency(frame_of(camera, range_m), camera)
    assert image.valid.all()
    np.testing.assert_allclose(image.range_m, range_m, atol=2e-4)
    np.testing.assert_allclose(image.amplitude, 200.0, rtol=1e-4)


def likeliest(camera, raw, shape):
    """Every number of wraps of every frequency, in double precision: the likeliest range and its squared residual."""
    together = combine(camera.modulations_hz, camera.speed_of_light_mps)
    weights = harmonic_weights(camera.phase_steps_deg).astype(float)
    turns, sigma = [], []
    for k in range(len(together.wraps)):
        c = np.stack([raw.planes[plane_name(s, k)].astype(float) for s in camera.phase_steps_deg])
        z = np.tensordot(weights[0] + 1j * weights[1], c, 1)
        turns.append(np.angle(z) / (2 * np.pi) % 1)
        sigma.append(np.sqrt(weights[0] @ weights[0]) * camera.read_noise_lsb / np.abs(z) / (2 * np.pi))
    u, w, p = np.array(turns), 1 / np.array(sigma) ** 2, np.array(together.wraps, float)[:, None, None]
    best, place = np.full(shape, np.inf), np.zeros(shape)
    for wraps in product(*(range(-1, q + 1) for q in together.wraps)):
        n = np.array(wraps, float)[:, None, None]
        x = (w * p * (u + n)).sum(axis=0) / (w * p * p).sum(axis=0)
        cost = (w * (u + n - p * x) ** 2).sum(axis=0)
        better = (cost < best) & (x >= 0) & (x < 1)
        best, place = np.where(better, cost, best), np.where(better, x, place)
    return place * together.unambiguous_m, best


@pytest.mark.parametrize("camera", [TWO, THREE], ids=["two", "three"])
def test_the_wraps_are_the_likeliest_of_all_combinations(camera):
    rng = np.random.default_rng(1)
    noise_lsb = 45.0  # 0.18 rad
    camera = replace(camera, read_noise_lsb=noise_lsb, unwrap_phase_error_rad=0.0)
    reach_m = combine(camera.modulations_hz, SPEED_OF_LIGHT).unambiguous_m
    raw = frame_of(camera, rng.uniform(0.05, 0.95, (40, 50)) * reach_m, 200.0, noise_lsb, rng)
    image, (range_m, cost) = cw_multi_frequency(raw, camera), likeliest(camera, raw, (40, 50))
    assert image.valid.mean() > 0.8
    np.testing.assert_allclose(image.range_m[image.valid], range_m[image.valid], atol=1e-3)
    assert (cost[image.valid] <= camera.unwrap_residual_sigmas**2 + 1e-2).all()


@pytest.mark.parametrize("camera", [TWO, THREE], ids=["two", "three"])
def test_sigma_weighs_each_frequency_by_one_over_its_variance_and_is_the_scatter(camera):
    rng, noise_lsb = np.random.default_rng(2), 8.0
    camera = replace(camera, read_noise_lsb=noise_lsb, unwrap_phase_error_rad=0.0)
    image = cw_multi_frequency(frame_of(camera, np.full((80, 80), 3.3), 200.0, noise_lsb, rng), camera)
    phase_sigma = noise_lsb / 200.0 / np.sqrt(1.5)
    together = combine(camera.modulations_hz, SPEED_OF_LIGHT)
    expected = combined_sigma_m([phase_sigma] * len(together.wraps), together)
    assert image.sigma_m.mean() == pytest.approx(expected, rel=0.01)
    assert (image.range_m - 3.3).std() == pytest.approx(expected, rel=4 / np.sqrt(2 * 6400))
    assert expected < min(phase_sigma * metres_per_radian(single) for single in single_frequencies(camera))


@pytest.mark.parametrize("phase_error_rad", [0.0, 0.05, 0.3])
def test_sigma_is_the_scatter_also_with_an_allowance_for_errors_that_are_not_noise(phase_error_rad):
    rng, noise_lsb = np.random.default_rng(3), 6.0
    camera = replace(THREE, read_noise_lsb=noise_lsb, unwrap_phase_error_rad=phase_error_rad, unwrap_error=0.9)
    image = cw_multi_frequency(frame_of(camera, np.full((80, 80), 3.3), 200.0, noise_lsb, rng), camera)
    assert (image.range_m - 3.3).std() == pytest.approx(image.sigma_m.mean(), rel=0.04)


@pytest.mark.parametrize("sigma_rad", [0.16, 0.2, 0.25])
@pytest.mark.parametrize("modulations", [(60e6, 80e6), (30e6, 20e6), (80e6, 16e6, 120e6), FOUR.modulations_hz])
def test_gross_errors_are_as_frequent_as_the_theory_says(modulations, sigma_rad):
    rng, n = np.random.default_rng(4), 200
    together = combine(modulations, SPEED_OF_LIGHT)
    noise_lsb = sigma_rad * 200.0 * np.sqrt(1.5)
    camera = replace(THREE, modulations_hz=modulations, read_noise_lsb=noise_lsb, unwrap_error=1 - 1e-9, **BARE)
    range_m = rng.uniform(0.1, 0.9, (2 * n, n)) * together.unambiguous_m
    image = cw_multi_frequency(frame_of(camera, range_m, 200.0, noise_lsb, rng), camera)
    gross = np.abs(image.range_m - range_m) > together.unambiguous_m / max(together.wraps) / 2
    theory = gross_error_probability([sigma_rad] * len(modulations), together)
    over = 0.15 * theory if len(modulations) > 2 else 0.0  # the union bound counts some errors twice
    assert gross.mean() == pytest.approx(theory, abs=4 * np.sqrt(theory / gross.size) + over)
    assert gross.mean() < theory + 4 * np.sqrt(theory / gross.size)


@pytest.mark.parametrize("unwrap_error", [1e-1, 1e-3])
def test_accepted_errors_and_rejected_pixels_are_as_frequent_as_the_theory_says(unwrap_error):
    rng, sigma_rad, shape = np.random.default_rng(5), 0.25, (400, 400)
    together = combine(TWO.modulations_hz, SPEED_OF_LIGHT)
    camera = replace(TWO, read_noise_lsb=sigma_rad * 200.0 * np.sqrt(1.5), unwrap_error=unwrap_error, **BARE)
    range_m, planes = rng.uniform(0.1, 0.9, shape) * together.unambiguous_m, {}
    for k, single in enumerate(single_frequencies(camera)):  # the phases of noisy phasors, all of the same amplitude
        error = np.angle(1 + sigma_rad * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)))
        phase = range_m / metres_per_radian(single) + error
        for step in STEPS:
            planes[plane_name(step, k)] = (200.0 * np.cos(phase + np.radians(step))).astype(np.float32)
    image = cw_multi_frequency(RawFrame(0.0, planes), camera)
    wrong, rejected = accepted_error_probability([sigma_rad] * 2, together, unwrap_error)
    for expected, found in ((rejected, ~image.valid), (wrong, image.valid & (np.abs(image.range_m - range_m) > 0.5))):
        assert found.mean() == pytest.approx(expected, abs=4 * np.sqrt(expected / found.size))


def test_where_noise_leaves_nothing_decidable_everything_is_rejected():
    together = combine((17e6, 12e6), SPEED_OF_LIGHT)
    assert accepted_error_probability([0.2, 0.2], together, 1e-3) == (0.0, 1.0)


def test_the_probability_of_accepted_errors_is_known_for_two_frequencies_only():
    with pytest.raises(UsageError, match="two frequencies only"):
        accepted_error_probability([0.1] * 3, combine(THREE.modulations_hz, SPEED_OF_LIGHT), 1e-3)


def test_phases_that_contradict_each_other_are_rejected_as_wrapped():
    """Light of two surfaces makes phases that no single range has at all three frequencies."""
    near, far = frame_of(THREE, np.full((20, 20), 2.0), 120.0), frame_of(THREE, np.full((20, 20), 3.05), 100.0)
    mixed = {name: near.planes[name] + far.planes[name] - np.float32(THREE.black_level_lsb) for name in near.planes}
    raw = RawFrame(0.0, mixed)
    assert (cw_multi_frequency(raw, THREE).why == Why.WRAPPED).all()
    assert cw_multi_frequency(raw, replace(THREE, unwrap_residual_sigmas=100.0, unwrap_error=0.99)).valid.all()


@pytest.mark.parametrize(("phase_error_rad", "kept"), [(None, 1.0), (0.03, 0.0)])
def test_what_comes_nearer_at_20_mps_contradicts_itself_by_more_than_wiggling(phase_error_rad, kept):
    """The frequencies are taken one after the other: the road camera allows for it."""
    road, range_m = load_config("road_cw_20m").camera, np.linspace(2.0, 18.0, 40).reshape(5, 8)
    if phase_error_rad is not None:
        road = replace(road, unwrap_phase_error_rad=phase_error_rad)
    camera = replace(FOUR, read_noise_lsb=0.1, unwrap_phase_error_rad=road.unwrap_phase_error_rad)
    nearer_m = 20.0 * len(STEPS) * (road.illumination_time_s + road.readout_time_s)
    planes = {}
    for k in range(4):
        raw = frame_of(camera, range_m - k * nearer_m)
        planes |= {plane_name(step, k): raw.planes[plane_name(step, k)] for step in STEPS}
    image = cw_multi_frequency(replace(raw, planes=planes), camera)
    assert image.valid.mean() == kept
    assert np.all(np.abs(image.range_m - range_m)[image.valid] < 3 * nearer_m)


def test_a_stricter_error_rejects_more_and_lets_fewer_errors_pass():
    rng, noise_lsb = np.random.default_rng(6), 55.0
    range_m = rng.uniform(0.5, 7.0, (150, 150))
    raw = frame_of(TWO, range_m, 200.0, noise_lsb, rng)
    gross, valid = [], []
    for unwrap_error in (0.5, 0.05, 1e-3):
        image = cw_multi_frequency(raw, replace(TWO, read_noise_lsb=noise_lsb, unwrap_error=unwrap_error))
        gross.append(np.mean(image.valid & (np.abs(image.range_m - range_m) > 0.5)))
        valid.append(image.valid.mean())
    assert gross[0] > gross[1] > gross[2]
    assert valid[0] > valid[1] > valid[2]


def test_a_greatest_range_leaves_fewer_wraps_to_choose_from():
    rng, noise_lsb = np.random.default_rng(7), 40.0
    range_m = rng.uniform(0.5, 3.0, (100, 100))
    raw = frame_of(THREE, range_m, 200.0, noise_lsb, rng)
    camera = replace(THREE, read_noise_lsb=noise_lsb)
    free, short = cw_multi_frequency(raw, camera), cw_multi_frequency(raw, replace(camera, unwrap_to_m=3.7))
    assert short.valid.mean() > free.valid.mean()
    assert short.range_m[short.valid].max() <= 3.7
    far = cw_multi_frequency(frame_of(THREE, np.full((3, 3), 9.0)), replace(THREE, unwrap_to_m=5.0))
    assert (far.why == Why.WRAPPED).all()


def test_neighbours_that_are_sure_decide_for_those_that_are_not():
    rng = np.random.default_rng(8)
    amplitude = np.where(rng.random((80, 80)) < 0.3, 60.0, 400.0)
    range_m = np.where(np.arange(80) < 40, 2.0, 5.5) + np.zeros((80, 1))
    camera = replace(TWO, read_noise_lsb=16.0)
    raw = frame_of(camera, range_m, amplitude, 16.0, rng)
    alone, helped = cw_multi_frequency(raw, camera), cw_multi_frequency(raw, replace(camera, unwrap_spatially=True))
    assert (alone.why == Why.WRAPPED).mean() > 0.03
    assert (helped.why == Why.WRAPPED).mean() < 0.3 * (alone.why == Why.WRAPPED).mean()
    wrong = np.abs(helped.range_m - range_m) > 0.5
    assert np.mean(wrong & helped.valid) < 1e-3
    np.testing.assert_array_equal(helped.range_m[alone.valid], alone.range_m[alone.valid])
    newly = helped.valid & ~alone.valid & ~wrong
    assert np.mean(np.abs(helped.range_m - range_m)[newly] < 2 * helped.sigma_m[newly]) > 0.9


def test_a_pixel_without_sure_neighbours_stays_undecided():
    camera = replace(TWO, read_noise_lsb=60.0, unwrap_spatially=True, unwrap_error=1e-12)
    image = cw_multi_frequency(frame_of(camera, np.full((6, 6), 2.0)), camera)
    assert (image.why == Why.WRAPPED).all()


@pytest.mark.parametrize(
    ("modulations", "message"),
    [
        ((), "two to four frequencies"),
        ((20e6,), "two to four frequencies"),
        ((20e6, 30e6, 40e6, 50e6, 60e6), "two to four frequencies"),
        ((20e6, 20e6), "same frequency twice"),
        ((20e6, 20_000_001.0), "greatest common divisor is 1 Hz"),
        ((20e6, 20.3e6), "wraps 203 times within 1499 m, more than the 200"),
        ((20e6, 1e6 / 3), "whole numbers of hertz"),
    ],
)
def test_frequencies_that_cannot_be_combined_are_refused_with_the_reason(modulations, message):
    with pytest.raises(UsageError, match=message):
        combine(modulations, SPEED_OF_LIGHT)


def test_the_camera_with_three_frequencies_measures_a_wall_beyond_each_of_its_wraps():
    camera = load_config("kinect2_like", {"camera": {"rows": 24, "columns": 32}}).camera
    for range_m in (0.9, 2.5, 4.2):
        view = View(*(np.full((1, 24, 32), a, np.float32) for a in (range_m, 0.6, 1.0)))
        image = cw_multi_frequency(simulate(lambda _, v=view: v, camera, 0.0, np.random.default_rng(9)), camera)
        assert image.valid.mean() > 0.95
        error = (image.range_m - range_m)[image.valid]
        assert np.abs(error).max() < 0.2
        assert abs(error.mean()) < 0.005


def test_a_fourth_frequency_in_the_same_light_errs_in_its_wraps_a_million_times_less():
    three, four = combine((80e6, 65e6, 15e6), SPEED_OF_LIGHT), combine(FOUR.modulations_hz, SPEED_OF_LIGHT)
    assert three.unambiguous_m == four.unambiguous_m
    sigma_rad = 0.15  # of phases that are exposed for a third of the time; a quarter of it leaves more noise
    apart = (
        gross_error_probability([sigma_rad] * 3, three),
        gross_error_probability([sigma_rad * (4 / 3) ** 0.5] * 4, four),
    )
    assert apart[1] < 1e-6 * apart[0]
