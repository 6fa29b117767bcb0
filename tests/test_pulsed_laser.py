"""The light source and its limits (König 2008, 4.1.2, 4.2.2)."""

from dataclasses import replace

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.errors import DataError, UsageError
from rangecam.pulsed import PulsedCamera, check, simulate, warnings_of
from rangecam.pulsed.camera import laser_exposure
from rangecam.pulsed.feasible import cycles, max_frame_rate_hz
from rangecam.pulsed.laser import Laser, beam_profile, power_fraction, thermal_limit_hz
from rangecam.pulsed.pulses import mean_of_pulses
from rangecam.pulsed.settings import Background, Pixel, Sequencer, Taps
from rangecam.pulsed.signal import shutter_windows
from rangecam.scene.scenario import parse_scenario
from rangecam.scene.view import View

LASER, PULSE_S, ROOM_C = Laser(), 180e-9, 25.0
CAMERA = PulsedCamera(speed_of_light_mps=3e8)
FRONT_VIEW = ((-1.0, 0.5), (-0.5, 1.0))


def wall(range_m, reflectivity, camera, ambient_wpm2=0.0):
    ones = np.ones((1, camera.rows, camera.columns))
    view = View(ones * range_m, ones * reflectivity, ones, ambient_wpm2)
    return lambda time_s: view


# --- warming up --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("repetition_hz", "low", "high"), [(10e3, 0.70, 0.72), (11e3, 0.66, 0.70)])
def test_at_10_khz_the_power_settles_just_above_70_percent_and_at_11_khz_below(repetition_hz, low, high):
    """N-K-046."""
    laser = replace(LASER, repetition_hz=repetition_hz)
    assert low < power_fraction(laser, PULSE_S, ROOM_C, np.inf) < high


def test_the_power_falls_from_its_maximum_steadily_and_settles_within_minutes():
    minutes = power_fraction(LASER, PULSE_S, ROOM_C, 60.0 * np.arange(11))
    assert minutes[0] == 1
    assert (np.diff(minutes) < 0).all()
    assert minutes[5] == pytest.approx(minutes[-1], abs=0.005)
    slow = replace(LASER, warm_up_s=600.0)
    assert power_fraction(slow, PULSE_S, ROOM_C, 60.0) > minutes[1]


@pytest.mark.parametrize(
    ("change", "pulse_s"), [({"peak_power_w": 4000.0}, PULSE_S), ({"repetition_hz": 20e3}, PULSE_S), ({}, 2 * PULSE_S)]
)
def test_the_loss_grows_with_power_rate_and_length_of_the_pulses_alike(change, pulse_s):
    lost = 1 - power_fraction(LASER, PULSE_S, ROOM_C, np.inf)
    assert 1 - power_fraction(replace(LASER, **change), pulse_s, ROOM_C, np.inf) == pytest.approx(2 * lost)


def test_warm_surroundings_cost_power_and_lower_the_limit_until_there_is_none():
    """K-ILL-09."""
    assert power_fraction(LASER, PULSE_S, 50.0, 0.0) == pytest.approx(0.9)
    cool, warm = (thermal_limit_hz(LASER, PULSE_S, celsius) for celsius in (25.0, 50.0))
    assert 10e3 < cool < 11e3
    assert warm == pytest.approx(cool * 0.2 / 0.3)
    assert thermal_limit_hz(LASER, PULSE_S, 120.0) == 0
    assert thermal_limit_hz(replace(LASER, loss_per_w=0.0), PULSE_S, 25.0) == np.inf
    assert thermal_limit_hz(replace(LASER, least_power=0.85), PULSE_S, 25.0) == pytest.approx(cool / 2)
    assert power_fraction(LASER, PULSE_S, 400.0, 0.0) == 0  # it does not become negative


def test_each_kelvin_above_25_degrees_costs_the_stated_share_of_the_power():
    cold, warm = (float(power_fraction(Laser(loss_per_k=2e-3), 180e-9, kelvin, 0.0)) for kelvin in (25.0, 45.0))
    assert cold == pytest.approx(1.0)
    assert warm == pytest.approx(1.0 - 20 * 2e-3)


def test_at_the_limit_the_power_settles_at_the_least_that_is_allowed():
    at_limit = replace(LASER, repetition_hz=thermal_limit_hz(LASER, PULSE_S, ROOM_C))
    assert power_fraction(at_limit, PULSE_S, ROOM_C, np.inf) == pytest.approx(0.7)


def test_a_warm_camera_gets_less_light():
    window = shutter_windows(CAMERA)["c"]
    cold, warm = (
        laser_exposure(wall(5.0, 0.5, CAMERA)(0), window, 0.0, replace(CAMERA, laser=Laser(operating_time_s=time_s)))
        for time_s in (0.0, 3600.0)
    )
    np.testing.assert_allclose(warm / cold, power_fraction(LASER, PULSE_S, ROOM_C, np.inf))


def test_only_a_repetition_rate_above_the_thermal_limit_is_warned_of_and_the_warning_names_the_limit():
    assert warnings_of(CAMERA) == []
    (warning,) = warnings_of(replace(CAMERA, laser=Laser(repetition_hz=11e3)))
    assert "camera.laser.repetition_hz = 11000" in warning
    assert f"{thermal_limit_hz(LASER, PULSE_S, ROOM_C):.4g} Hz" in warning
    assert "68%" in warning
    assert warnings_of(replace(CAMERA, temperature_c=50.0))


def test_no_preset_comes_with_a_warning():
    for name in ("usercams", "generic_pulsed"):
        assert warnings_of(load_config(name).camera) == []


# --- beams -------------------------------------------------------------------------------------------------------


def test_one_beam_lights_all_columns_alike_and_two_that_overlap_give_the_middle_twice_the_light():
    """K-ILL-05; the light is the same in all."""
    np.testing.assert_allclose(beam_profile(LASER, 64), 1)
    front = beam_profile(replace(LASER, beams=FRONT_VIEW), 64)
    np.testing.assert_allclose(front[16:48], 4 / 3)
    np.testing.assert_allclose(front[:16], 2 / 3)
    assert front.mean() == pytest.approx(1)
    assert beam_profile(replace(LASER, beams=((-0.3, 0.9), (-1.0, 0.11))), 64).mean() == pytest.approx(1)


def test_beams_change_the_light_in_the_columns():
    camera = replace(CAMERA, laser=Laser(beams=FRONT_VIEW))
    window = shutter_windows(CAMERA)["c"]
    even, front = (laser_exposure(wall(5.0, 0.5, c)(0), window, 0.0, c) for c in (CAMERA, camera))
    np.testing.assert_allclose(front / even, np.broadcast_to(beam_profile(camera.laser, 64), even.shape))


def test_a_beam_without_width_is_refused():
    with pytest.raises(UsageError, match=r"camera\.laser\.beams.*0\.5 to 0\.5"):
        beam_profile(replace(LASER, beams=((0.5, 0.5),)), 8)
    with pytest.raises(UsageError, match=r"camera\.laser\.beams"):
        load_config("usercams", {"camera": {"laser": {"beams": [[-2.0, 1.0]]}}})


# --- from pulse to pulse -----------------------------------------------------------------------------------------

SILENT = Pixel(photon_noise=False, adc_bits=0, sensor_noise_v=0.0, readout_noise_v=0.0, damping=0.0)


def samples(camera, ambient_wpm2=0.0, range_m=9.0, frames=400):
    """Values of one pixel over many frames, (frames, S), V for one pulse."""
    one = replace(camera, rows=1, columns=1, pixel=replace(SILENT, accumulations=(camera.pixel.accumulations[0],)))
    n = one.pixel.accumulations[0]
    view = wall(range_m, 0.1, one, ambient_wpm2)
    raws = [simulate(view, one, 0.0, np.random.default_rng(seed)) for seed in range(frames)]
    return np.array([[raw.planes[f"shutter_{x}"][0, 0] for x in "ab"] for raw in raws], float) / n


@pytest.mark.parametrize("n", [1, 16])
def test_jitter_of_the_trigger_averages_over_the_pulses_and_moves_both_windows(n):
    """K-ILL-07, N-K-092: 30 ps are 4.5 mm for one pulse."""
    camera = replace(CAMERA, laser=Laser(trigger_jitter_s=30e-12), pixel=Pixel(accumulations=(n,)))
    a, b = samples(camera).T
    slope = (a + b).mean() / 180e-9  # of both windows: what one loses the other wins
    assert a.std() == pytest.approx(slope * 30e-12 / np.sqrt(n), rel=0.1)
    assert b.std() == pytest.approx(slope * 30e-12 / np.sqrt(n), rel=0.1)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.15  # they have pulses of their own


@pytest.mark.parametrize("n", [1, 16])
def test_jitter_of_the_amplitude_averages_over_the_pulses(n):
    camera = replace(CAMERA, laser=Laser(amplitude_jitter=0.02), pixel=Pixel(accumulations=(n,)))
    values = samples(camera)
    np.testing.assert_allclose(values.std(axis=0) / values.mean(axis=0), 0.02 / np.sqrt(n), rtol=0.1)


def test_read_outs_of_one_run_share_their_pulses():
    """What jitter did to the first pulse is in all read-outs; with damping it counts less and less."""
    camera = replace(CAMERA, averages=4000, laser=Laser(amplitude_jitter=1.0), pixel=Pixel(accumulations=(1, 4)))
    one, none = np.ones((1, 1, 1)), np.zeros((1, 1, 1))
    first, fourth = mean_of_pulses(one, none, none, camera, np.random.default_rng(0))[:, :, 0, 0, 0].T
    weights = np.exp(-camera.pixel.damping * np.arange(4))
    weights /= weights.sum()
    assert np.cov(first, fourth)[0, 1] == pytest.approx(weights[-1], abs=0.06)
    assert fourth.var() == pytest.approx((weights**2).sum(), rel=0.1)


@pytest.mark.parametrize("correlation_s", [1e-6, 1e-4])
def test_background_that_changes_stays_in_the_signal_by_as_much_as_it_is_not_correlated(correlation_s):
    """K-PIX-07: one exposure keeps sqrt(2 (1 - rho)) of the fluctuation."""
    camera = replace(
        CAMERA, background=Background(fluctuation=0.2, correlation_s=correlation_s), pixel=Pixel(accumulations=(1,))
    )
    gap_s = cycles(camera)[0].off_after_s
    assert gap_s < 10e-6
    values = samples(camera, 500.0)[:, 0]
    one = replace(CAMERA, rows=1, columns=1, pixel=SILENT)
    plane = simulate(wall(9.0, 0.1, one, 500.0), one, 0.0, np.random.default_rng(0)).planes["ambient"]
    ambient_v = plane[0, 0] * 180e-9
    left = np.sqrt(2 * (1 - np.exp(-gap_s / correlation_s)))
    assert values.std() == pytest.approx(0.2 * ambient_v * left, rel=0.1)
    steady = replace(camera, background=Background(fluctuation=0.2, correlation_s=1e6))
    assert samples(steady, 500.0, frames=50)[:, 0].std() < 1e-2 * values.std()


# --- times and designs -------------------------------------------------------------------------------------------


def test_read_out_lowers_the_frame_rate():
    """K-FW-03: five read-outs of 256 pixels for each output and window."""
    camera = replace(CAMERA, sequencer=Sequencer(pixel_read_s=1e-6))
    assert max_frame_rate_hz(CAMERA) == pytest.approx(50)
    assert 1 / max_frame_rate_hz(camera) == pytest.approx(0.02 + 2 * 5 * 256e-6)
    assert 1 / max_frame_rate_hz(replace(camera, sequencer=Sequencer(pixel_read_s=1e-6, outputs=4))) == pytest.approx(
        0.02 + 2 * 5 * 128e-6
    )
    with pytest.raises(UsageError, match="read-out"):
        simulate(wall(5.0, 0.5, camera), camera, 0.0, np.random.default_rng(0))


def test_alternating_shutters_see_a_moving_object_one_pulse_apart():
    """N-K-050: 0.1 ms and 1.5 mm at 15 m/s, instead of 10 ms and 15 cm."""
    apart = {}
    for order in ("sequential", "alternating"):
        seen = []
        camera = replace(CAMERA, shutter_order=order)

        def look(time_s, seen=seen, camera=camera):
            seen.append(time_s)
            return wall(10.0 - 15.0 * time_s, 0.5, camera)(time_s)

        simulate(look, camera, 0.2, np.random.default_rng(0))
        apart[order] = 15.0 * (seen[1] - seen[0])
        assert np.mean(seen) == pytest.approx(0.2)
    assert apart["sequential"] == pytest.approx(0.15)
    assert apart["alternating"] == pytest.approx(1.5e-3)


def refused(camera, match):
    with pytest.raises(UsageError, match=match):
        check(camera)
    with pytest.raises(UsageError, match=match):
        simulate(wall(5.0, 0.5, camera), camera, 0.0, np.random.default_rng(0))


def test_impossible_designs_are_refused_with_the_reason():
    check(CAMERA)
    refused(replace(CAMERA, shutter_edge_s=200e-9), r"camera\.shutter_edge_s = 2e-07.*width of a window")
    refused(replace(CAMERA, pulse_rise_s=400e-9), r"camera\.pulse_rise_s = 4e-07")
    refused(replace(CAMERA, pixel=Pixel(accumulations=(0, 4))), r"camera\.pixel\.accumulations = \(0, 4\).*1 or more")
    with pytest.raises(UsageError, match=r"camera\.pixel\.accumulations\.0 = 0"):
        load_config("usercams", {"camera": {"pixel": {"accumulations": [0]}}})


@pytest.mark.parametrize(
    "change",
    [
        {"laser_delay_s": 1e-6}, {"min_range_m": 60.0}, {"shutter_delay_s": 1e-6, "max_range_m": 25.0},
        {"readout": "three_tap", "min_range_m": 60.0, "frame_rate_hz": 1.0},
    ],
)  # fmt: skip
def test_windows_that_no_pulse_meets_are_refused(change):
    refused(replace(CAMERA, **change), r"(shutter a|gate 2): it sees targets from")


def test_of_many_delays_some_may_miss():
    check(replace(CAMERA, shutters="ab_delayed", laser_delay_s=-400e-9))
    check(replace(CAMERA, readout="three_tap", taps=Taps(pulses=10)))


def test_pulses_faster_than_the_cycle_of_the_sensor_are_refused():
    """K-FUT-04: what limits the repetition rate when heat does not."""
    fast = replace(CAMERA, laser=Laser(repetition_hz=480e3))
    check(fast)
    slow = replace(fast, sequencer=Sequencer(transfer_steps=8))
    refused(slow, r"camera\.laser\.repetition_hz = 480000.*must not exceed")
    check(replace(slow, laser=Laser(repetition_hz=240e3)))


def test_a_negative_reflectivity_is_refused():
    with pytest.raises(DataError, match=r"reflectivity of -0\.1"):
        simulate(wall(5.0, -0.1, CAMERA), CAMERA, 0.0, np.random.default_rng(0))
    head = 'description = "x"\npreset = "usercams"\nduration_s = 1.0\n[[objects]]\nname = "x"\n'
    box = "[[objects.boxes]]\ncenter_m = [5.0, 0.0, 1.0]\nsize_m = [1.0, 1.0, 1.0]\nreflectivity = -0.5\n"
    with pytest.raises(UsageError, match="reflectivity"):
        parse_scenario("bad", head + box)
