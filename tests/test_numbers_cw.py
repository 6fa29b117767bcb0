"""Numbers of Steinbäck 2016 and what the library makes of them, by their number; misprints as corrected (E-S-..)."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from rangecam.brake.rule import DecisionSettings, Threat, is_object, must_brake, stopping_distance
from rangecam.config import load_config
from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.fixed_point.chain import _NETWORK, integer_chain
from rangecam.cw.fixed_point.program import compiled, reference_words
from rangecam.cw.light import correlate
from rangecam.cw.register_map import PRINTED
from rangecam.cw.registers import HIGHEST_HZ, LOWEST_HZ, PIXEL_CLOCK_HZ, apply
from rangecam.cw.sequence import exposure_times_s, fastest_frame_rate_hz
from rangecam.cw.signal import metres_per_radian
from rangecam.cw.unwrapping import combine
from rangecam.geometry import Lens, rays
from rangecam.scene.view import View
from rangecam.types import RawFrame, Why

CAMERA = load_config("scaled_car").camera
THESIS = replace(CAMERA, speed_of_light_mps=3e8)
EMULATION = load_config("scaled_car_emulation").camera
PVC, ASPHALT = DecisionSettings(friction=0.3), DecisionSettings(friction=0.7)
KMH = 1 / 3.6


def unambiguous_m(hertz, speed_of_light=3e8):
    return 2 * math.pi * metres_per_radian(CwCamera(modulation_hz=hertz, speed_of_light_mps=speed_of_light))


@pytest.mark.parametrize(
    ("mhz", "metres", "exact_m"),
    [(30, 5.0, 4.9965), (20, 7.5, 7.4948), (17, 8.8235, 8.8174), (12, 12.5, 12.4914), (10, 15.0, 14.9896)],
)
def test_n_s_001_unambiguous_ranges(mhz, metres, exact_m):
    assert unambiguous_m(mhz * 1e6) == pytest.approx(metres, abs=5e-5)
    assert unambiguous_m(mhz * 1e6, 299_792_458.0) == pytest.approx(exact_m, abs=5e-5)


def test_n_s_002_and_003_17_mhz_reach_8_8_m_not_8_3():
    assert unambiguous_m(17e6) == pytest.approx(8.824, abs=5e-4)  # E-S-01
    assert unambiguous_m(17e6) * 1e3 == pytest.approx(8823.53, abs=5e-3)
    assert unambiguous_m(17e6, 299_792_458.0) * 1e3 == pytest.approx(8817.43, abs=5e-3)


def test_n_s_004_the_selectable_frequencies_reach_72_to_1_5_m():
    assert unambiguous_m(LOWEST_HZ) == pytest.approx(72.0, abs=0.05)
    assert unambiguous_m(HIGHEST_HZ) == pytest.approx(1.5, abs=0.005)


def test_n_s_005_the_range_factor_is_1404_308_mm_a_radian():
    assert metres_per_radian(THESIS) * 1e3 == pytest.approx(1404.308, abs=5e-4)


def test_n_s_006_an_offset_of_minus_a_metre_is_undone_on_the_phase_by_the_integers_too():
    camera = replace(EMULATION, modulation_hz=30e6, offset_m=1.0, emulation=replace(EMULATION.emulation, angles="lens"))
    settings = {"amplitude_threshold": 0.0, "wrap_threshold": 0.0, "common_neighbours": 0, "median": False}
    camera = replace(camera, emulation=replace(camera.emulation, **settings))
    phase = 4.5 / unambiguous_m(30e6) * 2 * np.pi
    samples = [np.full((3, 3), 2048 + np.round(2000 * np.cos(phase + t))) for t in np.radians([0, 90, 180, 270])]
    words = (np.array(samples, np.uint16) << 4).astype(np.uint16)
    middle = integer_chain(words, compiled(camera, (3, 3))).converted_mm[1, 1]
    assert middle == pytest.approx(500, abs=2)


def wall_frame(camera):
    view = View(*(np.full((1, camera.rows, camera.columns), v, np.float32) for v in (1.5, 0.8, 1.0)))
    return simulate(lambda _: view, camera, 0.0, np.random.default_rng(1))


def test_n_s_007_and_008_bytes_of_a_frame_and_bits_a_second():
    raw = wall_frame(CAMERA)
    sizes = [plane.nbytes for plane in raw.planes.values()]
    assert sizes == [38_400] * 4
    for rate_hz, megabit in ((10, 12.288), (20, 24.576), (30, 36.864), (40, 49.152)):
        assert sum(sizes) * 8 * rate_hz / 1e6 == pytest.approx(megabit, abs=5e-4)


@pytest.mark.parametrize(("kmh", "metres"), [(10, 0.562), (20, 2.247), (30, 5.056), (50, 14.046)])
def test_n_s_010_and_011_braking_distances_on_asphalt(kmh, metres):
    assert stopping_distance(kmh * KMH, 0.0, replace(ASPHALT, reaction_time_s=0.0)) == pytest.approx(metres, abs=5e-4)


def test_n_s_012_and_013_the_time_left_to_react_and_the_frame_period_that_it_allows():
    def beyond_m(time_s):
        return stopping_distance(20 * KMH, 0.0, replace(ASPHALT, reaction_time_s=time_s)) - 4.0

    react_s = brentq(beyond_m, 0, 2)
    assert react_s == pytest.approx(0.3155, abs=5e-5)
    assert (react_s - 0.1) / 4 == pytest.approx(53.87e-3, abs=5e-6)
    assert (react_s - 0.1) / 5 == pytest.approx(43.10e-3, abs=5e-6)  # one missed detection


def test_n_s_014_the_reaction_time_counts_the_capture_too():
    assert DecisionSettings().reaction_time_s == pytest.approx(0.2333, abs=5e-5)  # E-S-06
    assert load_config("scaled_car").decision.reaction_time_s == pytest.approx(0.2333, abs=5e-5)


def test_n_s_015_braking_takes_more_than_a_human_reaction_above_74_2_km_h():
    human = replace(ASPHALT, reaction_time_s=1.5)
    equal = brentq(lambda v: stopping_distance(v, 0.0, human) - 2 * 1.5 * v, 1, 50)
    assert equal / KMH == pytest.approx(74.2, abs=0.05)


@pytest.mark.parametrize(
    ("speed_mps", "stop_m", "trigger_m"),
    [(1, 0.403, 0.605), (2, 1.146, 1.719), (3, 2.229, 3.344), (4, 3.652, 5.477), (20 * KMH, 6.540, 9.810)],
)
def test_n_s_016_stopping_distances_on_pvc(speed_mps, stop_m, trigger_m):
    assert stopping_distance(speed_mps, 0.0, PVC) == pytest.approx(stop_m, abs=1e-3)
    for step, brakes in ((-2e-3, True), (2e-3, False)):
        assert must_brake(Threat(trigger_m + step, speed_mps, 1000), speed_mps, True, PVC) == brakes


def test_n_s_017_on_pvc_the_car_stops_within_4_m_only_below_15_2_km_h():
    within = [brentq(lambda v, m=metres: stopping_distance(v, 0.0, PVC) - m, 0.1, 20) for metres in (4.0, 5.0, 4 / 1.5)]
    np.testing.assert_allclose(np.array(within) / KMH, [15.2, 17.2, 12.0], atol=0.05)  # E-S-07
    assert within[0] == pytest.approx(4.21, abs=5e-3)
    assert stopping_distance(20 * KMH, 0.0, replace(PVC, reaction_time_s=0.0)) == pytest.approx(5.24, abs=5e-3)


def test_n_s_018_the_read_out_is_not_limited_by_the_pixel_clock():
    assert CAMERA.rows * CAMERA.columns / PIXEL_CLOCK_HZ == pytest.approx(0.288e-3, abs=5e-7)  # E-S-14
    assert 4 * CAMERA.rows * CAMERA.columns / PIXEL_CLOCK_HZ == pytest.approx(1.153e-3, abs=5e-7)
    assert CAMERA.readout_time_s * PIXEL_CLOCK_HZ == pytest.approx(81_918)


@pytest.mark.parametrize(
    ("lit_s", "fastest_hz", "span_s", "motion_m"), [(1e-3, 112, 7.69e-3, 0.043), (2e-3, 77, 11.69e-3, 0.065)]
)
def test_n_s_019_how_fast_frames_follow_and_how_far_the_car_drives_in_one(lit_s, fastest_hz, span_s, motion_m):
    camera = replace(CAMERA, illumination_time_s=lit_s)
    assert int(fastest_frame_rate_hz(camera)) == fastest_hz
    middles = exposure_times_s(camera, 0.0)
    span = middles[-1] - middles[0] + lit_s
    assert span == pytest.approx(span_s, abs=5e-6)
    assert span * 20 * KMH == pytest.approx(motion_m, abs=5e-4)


def test_n_s_020_to_024_the_printed_registers():
    contents = dict(PRINTED)
    assert contents["CFGCNT_S00_EXPOTIME"] == 0x109A == 4250
    camera = apply(PRINTED, replace(CAMERA, illumination_time_s=1e-3, capture_order=(0, 90, 180, 270)))
    assert camera.illumination_time_s == 2e-3
    assert camera.modulation_hz == 17e6
    for preset, hertz in ((0, 12e6), (1, 30e6), (3, 80e6)):
        changed = apply([(f"CFGCNT_S{k:02}_PLLSET", preset) for k in range(4)], camera)
        assert changed.modulation_hz == hertz
    assert 1 / camera.frame_rate_hz - 4 * 3.23e-3 == pytest.approx(20.41e-3, abs=5e-6)
    assert (1 / camera.frame_rate_hz - 4 * 3.23e-3) / 4096 == pytest.approx(4.98e-6, abs=5e-9)
    assert (contents["CFGCNT_ROICMINREG"], 351 - contents["CFGCNT_ROICMAXREG"]) == (16, 16)
    assert (contents["CFGCNT_ROIRMINREG"], 287 - contents["CFGCNT_ROIRMAXREG"]) == (24, 24)
    assert (camera.rows, camera.columns) == (120, 160)
    assert camera.capture_order == (0, 180, 90, 270)  # E-S-13


def test_n_s_028_the_reference_image_of_the_program():
    reference = reference_words(EMULATION, (120, 160)) / 16
    for place, lsb in (((59, 79), 145.0), ((0, 79), 61.08), ((59, 0), 31.99), ((0, 0), 18.32), ((119, 159), 17.64)):
        assert reference[place] == pytest.approx(lsb, abs=0.12)  # units of a sixteenth, and cut


@pytest.mark.parametrize(
    ("alpha", "beta", "approximate", "exact"),
    [(0, 40, 0.76604, 0.76604), (30, 0, 0.86603, 0.86603), (15, 20, 0.90767, 0.91125), (30, 40, 0.66341, 0.70058)],
)
def test_n_s_029_the_conversion_by_two_cosines_is_an_approximation_for_a_perspective_lens(
    alpha, beta, approximate, exact
):
    tangents = np.tan(np.radians([alpha, beta]))
    assert math.cos(math.radians(alpha)) * math.cos(math.radians(beta)) == pytest.approx(approximate, abs=5e-6)
    lens = Lens(horizontal_fov_deg=160.0, vertical_fov_deg=160.0)
    size, half = 4001, math.tan(math.radians(80))
    row, column = np.rint((1 - tangents / half) * size / 2 - 0.5).astype(int)  # E-S-03
    assert rays(lens, (size, size))[row, column, 0] == pytest.approx(exact, abs=1.5e-3)
    equiangular = Lens(horizontal_fov_deg=80.5, vertical_fov_deg=60.5, projection="equiangular")
    ray = rays(equiangular, (121, 161))[60 - 2 * alpha, 80 - 2 * beta]
    assert ray[0] == pytest.approx(approximate, abs=5e-6)


def test_n_s_030_half_a_degree_a_pixel_is_off_by_up_to_2_78_degrees_for_a_perspective_lens():
    ray = rays(Lens(horizontal_fov_deg=80.0, vertical_fov_deg=60.0), (120, 160))
    for line, axis, largest, at in ((ray[60], 1, 2.78, 43), (ray[:, 80], 2, 1.12, 33)):
        angle = np.degrees(np.arctan2(line[:, axis], line[:, 0]))
        offset = (len(line) - 1) / 2 - np.arange(len(line))
        error = np.abs(angle - 0.5 * offset)
        assert error.max() == pytest.approx(largest, abs=5e-3)
        assert abs(abs(offset[error.argmax()]) - at) <= 0.5
    square = Lens(horizontal_fov_deg=80.0)
    edge = rays(square, (1200, 1600))[0, 800]
    assert 2 * math.degrees(math.atan2(edge[2], edge[0])) == pytest.approx(64.4, abs=0.1)  # E-S-04


@pytest.mark.parametrize(
    ("metres", "pixels"), [(0.3, 1459.0), (0.5, 525.2), (1, 131.3), (2, 32.8), (3, 14.6), (4, 8.2)]
)
def test_n_s_031_pixels_of_a_square_of_10_cm(metres, pixels):
    alone = DecisionSettings(large_object_px=1e9, min_object_px=0.0)
    assert is_object(Threat(metres, 1.0, pixels + 0.06), alone)
    assert not is_object(Threat(metres, 1.0, pixels - 0.06), alone)
    plain = DecisionSettings()
    assert is_object(Threat(0.417, 1.0, 751), plain)
    assert not is_object(Threat(0.417, 1.0, 750), plain)
    assert not is_object(Threat(3.63, 1.0, 10), plain)  # beyond 3.62 m ten pixels decide


@pytest.mark.parametrize(("mhz", "metres"), [((17, 12), 150), ((30, 20), 15), ((30, 17), 150), ((30, 12), 25)])
def test_n_s_039_two_frequencies_reach_as_far_as_their_common_divisor(mhz, metres):
    assert combine(tuple(1e6 * f for f in mhz), 3e8).unambiguous_m == pytest.approx(metres, rel=1e-9)


def test_n_s_041_the_pixel_clock_divides_by_two_four_and_eight():
    np.testing.assert_allclose(PIXEL_CLOCK_HZ / 1e6 / np.array([2, 4, 8]), [33.3, 16.65, 8.32], atol=6e-3)


def test_n_s_043_the_sorting_network_sorts_all_zeros_and_ones_and_none_of_its_25_exchanges_is_needless():
    inputs = np.array(list(itertools.product((0, 1), repeat=9)))

    def unsorted(network):
        values = inputs.copy()
        for low, high in network:
            values[:, [low, high]] = np.sort(values[:, [low, high]], axis=1)
        return np.any(np.diff(values, axis=1) < 0)

    assert len(_NETWORK) == 25
    assert not unsorted(_NETWORK)
    assert all(unsorted(np.delete(_NETWORK, k, axis=0)) for k in range(25))


def test_n_s_044_sigma_falls_with_the_modulation_frequency():
    raw = wall_frame(replace(CAMERA, pseudo_rows=0))
    at = {
        f: np.median(RANGING["cw_four_phase"](raw, replace(CAMERA, modulation_hz=f * 1e6)).sigma_m)
        for f in (12, 17, 30)
    }
    assert at[30] / at[17] == pytest.approx(0.57, abs=5e-3)
    assert at[12] / at[17] == pytest.approx(1.42, abs=5e-3)


def test_n_s_045_the_difference_at_270_and_90_degrees_is_the_sine_of_the_phase():
    view = View(*(np.full((1, 3, 3), v, np.float32) for v in (1.0, 0.8, 1.0)))
    camera = replace(CAMERA, rows=3, columns=3)
    c0, c90, c180, c270 = (correlate(view, camera, step)[0][1, 1] for step in (0, 90, 180, 270))
    phase = 1.0 / metres_per_radian(camera)
    assert np.arctan2(c270 - c90, c0 - c180) == pytest.approx(phase, abs=1e-4)
    amplitude = np.hypot(c270 - c90, c0 - c180) / 2
    assert c270 - c90 == pytest.approx(2 * amplitude * math.sin(phase), rel=1e-3)


@pytest.mark.parametrize("speed_mps", [0.5, 0.51])
@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("pixels", [10, 11, 751])
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_n_s_047_the_brake_rule(speed_mps, forward, pixels, share):
    distance_m = share * 1.5 * stopping_distance(speed_mps, 0.0, PVC)
    area_px = (0.1 / (distance_m * math.radians(0.5))) ** 2
    expected = share < 1 and speed_mps > 0.5 and forward and pixels > 10 and (pixels > area_px or pixels > 750)
    assert must_brake(Threat(distance_m, speed_mps, pixels), speed_mps, forward, PVC) == expected


def test_n_s_051_a_centimetre_at_17_mhz_is_7_12_milliradians():
    assert 0.01 / metres_per_radian(THESIS) == pytest.approx(7.12e-3, abs=5e-6)


@pytest.mark.parametrize(
    ("depth_m", "reflectivity", "lsb", "sigma_mm"),
    [(1, 1, 145.0, 7), (2, 1, 36.2, 27), (4, 1, 9.1, 110), (4, 0.3, 2.7, 365), (5, 0.3, 1.7, 571)],
)
def test_n_s_052_amplitude_and_noise_of_a_plane(depth_m, reflectivity, lsb, sigma_mm):
    camera = replace(THESIS, pseudo_rows=0, shot_noise_lsb2_per_lsb=0.0, quantisation_lsb=0.0, max_phase_sigma_rad=0.5)
    view = View(*(np.full((1, 120, 160), v, np.float32) for v in (depth_m, reflectivity, 1.0)))
    steps = (0, 90, 180, 270)
    raw = RawFrame(0.0, {f"phase_{step}": correlate(view, camera, step)[0] for step in steps})
    image = RANGING["cw_four_phase"](raw, camera)
    assert image.amplitude[59, 79] == pytest.approx(lsb, abs=0.06)
    assert image.sigma_m[59, 79] * 1e3 == pytest.approx(sigma_mm, abs=0.5 + 1e-3 * sigma_mm)


def test_n_s_054_what_threshold_1_lets_pass_of_the_integers():
    for share, passes in ((0.0180, True), (0.0195, False)):  # 0.3 / 4^2 = 0.0187
        camera = replace(EMULATION, pseudo_rows=0, emulation=replace(EMULATION.emulation, amplitude_threshold=share))
        amplitude = 0.3 / 4**2 * 145.0 * 16  # of a word, at 4 m in the centre
        words = np.full((4, 120, 160), 32768, np.uint16)
        words[0, 59, 79], words[2, 59, 79] = 32768 + round(amplitude), 32768 - round(amplitude)
        why = integer_chain(words, compiled(camera, (120, 160))).why[59, 79]
        assert (why != Why.LOW_AMPLITUDE) == passes
