"""Claims about the simulated continuous-wave camera: its sequence of exposures, and each imperfection by itself."""

from dataclasses import replace

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.cw import RANGING, simulate
from rangecam.cw.effects import (
    STRAY_FRACTION,
    FixedPattern,
    Interference,
    Link,
    Multipath,
    Scattering,
    Taps,
    Temperature,
    Waveform,
)
from rangecam.cw.imperfections import IMPERFECTIONS, ground_truth, ideal, imperfect, with_and_without
from rangecam.cw.light import collect, correlate
from rangecam.cw.link import transfer
from rangecam.cw.multipath import Emitters, Surfaces, irradiance, solid_angles, surfaces_of
from rangecam.cw.pixel import fixed_pattern, temperature_c
from rangecam.cw.scattering import scatter
from rangecam.cw.sequence import (
    exposure_times_s,
    exposures,
    fastest_frame_rate_hz,
    plane_names,
    readout_time_s,
)
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.cw.waveform import TABLE_SIZE, correlation_table, harmonics
from rangecam.errors import UsageError
from rangecam.geometry import rays
from rangecam.scene.view import View
from rangecam.studies.cw_imperfections import cw_imperfections
from rangecam.types import SPEED_OF_LIGHT, Why

CAMERA = load_config("scaled_car").camera
QUIET = replace(
    CAMERA,
    read_noise_lsb=0.0,
    shot_noise_lsb2_per_lsb=0.0,
    quantisation_lsb=0.0,
    lower_limit_lsb=None,
    full_scale_lsb=None,
    pseudo_rows=0,
    black_level_lsb=0.0,
    binning=1,
)
"""The same camera without noise and converter."""


def flat_view(range_m, reflectivity=1.0, shape=(4, 5), cos_incidence=1.0, ambient_wpm2=0.0):
    full = [np.full((1, *shape), a, np.float32) for a in (range_m, reflectivity, cos_incidence)]
    return View(*full, ambient_wpm2)


def simulated(view, camera, time_s=0.0, seed=0):
    return simulate(lambda _: view, camera, time_s, np.random.default_rng(seed))


def test_a_frame_of_several_frequencies_has_every_step_of_each_in_order_of_capture():
    camera = replace(QUIET, modulations_hz=(80e6, 16e6), phase_steps_deg=(0, 120, 240), capture_order=(240, 0, 120))
    camera = replace(camera, frame_rate_hz=10.0)
    names = [exposure.plane for exposure in exposures(camera)]
    assert names == [f"f{k}_phase_{step}" for k in (0, 1) for step in (240, 0, 120)]
    raw = simulated(flat_view(1.3), camera)
    assert tuple(raw.planes) == plane_names(camera)
    for k, modulation_hz in enumerate(camera.modulations_hz):
        phase = 4 * np.pi * 1.3 * modulation_hz / camera.speed_of_light_mps
        samples = [raw.planes[f"f{k}_phase_{step}"] for step in (0, 120, 240)]
        phasor = sum(s * np.exp(-1j * np.radians(step)) for s, step in zip(samples, (0, 120, 240), strict=True))
        np.testing.assert_allclose(np.angle(phasor * np.exp(-1j * phase)), 0, atol=1e-5)


def test_the_sequence_is_as_long_as_all_its_exposures_and_centred_on_the_frame():
    camera = replace(CAMERA, modulations_hz=(60e6, 80e6), illumination_time_s=1e-3)
    times = exposure_times_s(camera, 2.0)
    assert len(times) == 8
    assert np.mean(times) == pytest.approx(2.0)
    assert fastest_frame_rate_hz(replace(camera, modulations_hz=())) == pytest.approx(1 / 8.92e-3)  # N-S-019.1
    assert fastest_frame_rate_hz(camera) == pytest.approx(0.5 / 8.92e-3)


def test_without_an_order_steps_are_captured_as_they_are_listed_and_fractions_have_names():
    camera = replace(CAMERA, phase_steps_deg=(22.5, 0.0, 247.5, 90), capture_order=())
    assert [e.plane for e in exposures(camera)] == ["phase_22.5", "phase_0", "phase_247.5", "phase_90"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"phase_steps_deg": (0, 180), "capture_order": ()}, r"phase_steps_deg = \[0, 180\]: expected three or more"),
        ({"phase_steps_deg": (0, 90, 90), "capture_order": ()}, "expected three or more steps, none of them twice"),
        ({"phase_steps_deg": (0, 120, 240)}, r"capture_order = \[0, 180, 90, 270\]: expected 0, 120, 240 in some"),
        ({"modulations_hz": (80e6, 80e6)}, r"modulations_hz = \[8e\+07, 8e\+07\]: expected each frequency once"),
    ],
)
def test_a_sequence_that_cannot_be_is_refused_by_name(settings, message):
    with pytest.raises(UsageError, match=message):
        simulated(flat_view(1.0), replace(CAMERA, **settings))


def test_binning_of_two_by_two_halves_the_noise():
    single, camera = replace(CAMERA, binning=1), replace(CAMERA, binning=2)
    for light in (0.0, 300.0):
        assert sample_variance(light, single) / sample_variance(light, camera) == pytest.approx(4)  # N-S-042


def test_a_sinusoidal_sample_is_the_cosine_of_the_phase_and_the_step():
    sample, _ = correlate(flat_view(2.1, shape=(1, 1)), QUIET, 120)
    strength, _ = correlate(flat_view(2.1, shape=(1, 1)), replace(QUIET, offset_m=2.1), 0)  # phase 0
    phase = 2.1 / metres_per_radian(QUIET)
    np.testing.assert_allclose(sample, strength * np.cos(phase + np.radians(120)), rtol=1e-5)


def decoded(camera, view, time_s=0.0):
    """Phasor of four samples a quarter period apart, such that sample = level + Re(phasor exp(i step))."""
    c0, c90, c180, c270 = (correlate(view, camera, step, time_s)[0].astype(float) for step in (0, 90, 180, 270))
    return ((c0 - c180) + 1j * (c270 - c90)) / 2


def line_of(ranges_m, reflectivity=1.0):
    """One row of pixels, each at its own range."""
    ranges_m = np.asarray(ranges_m, np.float32).reshape(1, 1, -1)
    return View(ranges_m, np.full_like(ranges_m, reflectivity), np.ones_like(ranges_m))


def range_error_m(phasor, ranges_m, camera):
    phase = np.asarray(ranges_m) / metres_per_radian(camera)
    return np.angle(phasor * np.exp(-1j * phase)) * metres_per_radian(camera)


def test_two_rectangular_signals_wiggle_as_the_triangle_of_their_correlation_says():
    camera = replace(QUIET, waveform=Waveform(illumination="square", reference="square"), speed_of_light_mps=3e8)
    unambiguous = 2 * np.pi * metres_per_radian(camera)
    ranges = unambiguous * (np.arange(800) + 0.5) / 800
    error = range_error_m(decoded(camera, line_of(ranges))[0], ranges, camera)
    part = 4 * ranges / unambiguous % 1  # of a quarter turn: the samples then are 1 - part and part
    expected = np.arctan2(part, 1 - part) - part * np.pi / 2
    np.testing.assert_allclose(error / metres_per_radian(camera), expected, atol=3e-4)
    assert np.abs(error).max() == pytest.approx(0.0711 * metres_per_radian(camera), rel=5e-3)  # N-S-035
    assert np.abs(error).max() == pytest.approx(0.100, abs=1e-3)
    assert np.argmax(np.abs(np.fft.rfft(error))) == 4  # periods in the unambiguous range


@pytest.mark.parametrize(("duty", "other"), [(0.5, 0.5), (0.25, 0.5), (1 / 3, 0.4)])
def test_the_correlation_of_rectangles_is_the_mean_of_their_product(duty, other):
    waveform = Waveform(
        illumination="square", reference="square", illumination_duty_cycle=duty, reference_duty_cycle=other
    )
    t = (np.arange(12000) + 0.5) / 12000 - 0.5
    light, reference = (np.where(np.abs(t) < each / 2, 1.0, 0.0) for each in (duty, other))
    product = np.fft.irfft(np.fft.rfft(light) * np.conj(np.fft.rfft(reference)))
    product = (product - product.mean()) / (2 / 12000 * np.abs(np.fft.rfft(product)[1]))
    table = correlation_table(harmonics(waveform, 17e6))
    ours = np.interp(np.arange(12000) / 12000, np.arange(TABLE_SIZE) / TABLE_SIZE, table[:TABLE_SIZE])
    np.testing.assert_allclose(ours, product, atol=2e-3)


def test_a_slow_light_source_charges_and_discharges_and_its_delay_is_left_to_the_offset():
    bandwidth_hz, modulation_hz = 20e6, 17e6
    waveform = Waveform(illumination="square", bandwidth_hz=bandwidth_hz)  # times a sinusoidal reference: pure
    np.testing.assert_allclose(harmonics(waveform, modulation_hz)[1:], 0, atol=1e-12)
    h = harmonics(replace(waveform, reference="square"), modulation_hz)
    t = np.arange(20000) / 20000  # the steady answer of a first-order filter to a square of levels +1 and -1
    decay = modulation_hz / (2 * np.pi * bandwidth_hz)
    half = 1 - 2 * np.exp(-(t % 0.5) / decay) / (1 + np.exp(-0.5 / decay))
    spectrum = np.fft.rfft(np.where(t < 0.5, half, -half))
    square = np.fft.rfft(np.where(t < 0.5, 1.0, -1.0))
    product = spectrum[1:10] * np.conj(square[1:10])
    k = np.arange(1, 10)
    expected = product / np.abs(product[0]) * np.exp(-1j * k * np.angle(product[0]))
    np.testing.assert_allclose(h[:9], expected, atol=2e-4)


def test_a_third_of_a_period_of_light_has_no_third_harmonic():
    assert abs(harmonics(Waveform(illumination="square", illumination_duty_cycle=1 / 3), 1e6)[2]) < 1e-12


def tap_camera(**settings):
    return replace(QUIET, taps=Taps(**settings), full_scale_lsb=4095.0)


def test_ambient_light_saturates_a_differential_pixel_beyond_what_its_circuit_takes_out():
    view = flat_view(2.0, 0.5, ambient_wpm2=20.0)
    sample, light = correlate(view, QUIET, 0)
    fuller_tap = ((light + np.abs(sample)) / 2).max()
    needed = fuller_tap - 100.0
    for suppression, saturated in ((needed - 1, True), (needed + 1, False)):
        camera = tap_camera(full_well_lsb=100.0, ambient_suppression_lsb=suppression)
        assert np.isinf(correlate(view, camera, 0)[0]).any() == saturated
    roomy = tap_camera(full_well_lsb=fuller_tap + 1)
    np.testing.assert_allclose(correlate(view, roomy, 0)[0], sample, atol=1e-3)
    assert np.abs(sample).max() < 0.1 * needed  # the difference itself is small


def test_a_saturated_pixel_reads_full_scale_or_the_difference_of_its_full_taps():
    view = flat_view(0.5, shape=(1, 1))
    sample, light = (a[0, 0] for a in correlate(view, QUIET, 0))
    small, large = (light - abs(sample)) / 2, (light + abs(sample)) / 2
    well = (small + large) / 2
    camera = tap_camera(full_well_lsb=well, saturated_reads_full_scale=False)
    assert correlate(view, camera, 0)[0][0, 0] == pytest.approx(np.sign(sample) * (well - small), rel=1e-4)
    both_full = tap_camera(full_well_lsb=small / 2, saturated_reads_full_scale=False)
    assert correlate(view, both_full, 0)[0][0, 0] == pytest.approx(0, abs=1e-3)
    raw = simulated(view, tap_camera(full_well_lsb=well))
    assert raw.planes["phase_0"][0, 0] == 4095.0


def test_suppression_cannot_take_out_more_than_the_emptier_tap_holds():
    view = flat_view(0.5, shape=(1, 1))
    sample, _ = correlate(view, QUIET, 0)
    camera = tap_camera(full_well_lsb=1e-3, ambient_suppression_lsb=1e9, saturated_reads_full_scale=False)
    assert abs(correlate(view, camera, 0)[0][0, 0]) == pytest.approx(1e-3, rel=1e-3)
    assert np.isfinite(correlate(view, tap_camera(full_well_lsb=1e5, ambient_suppression_lsb=1e9), 0)[0]).all()
    assert sample[0, 0] != 0


def test_the_tap_of_a_single_ended_pixel_holds_its_full_well():
    camera = replace(
        tap_camera(full_well_lsb=50.0, saturated_reads_full_scale=False), pixel="single_ended", black_level_lsb=7.0
    )
    assert correlate(flat_view(0.5), camera, 0)[0].max() == pytest.approx(57.0)
    assert correlate(flat_view(9.0), camera, 0)[0].max() < 57.0


def test_the_fixed_pattern_is_measured_where_it_was_put_and_belongs_to_the_sensor():
    sensor = FixedPattern(seed=3, global_offset_m=0.2, range_sigma_m=0.01, gain_sigma=0.02, offset_sigma_lsb=3.0)
    camera, view = replace(QUIET, fixed_pattern=sensor, black_level_lsb=100.0), flat_view(1.5, shape=(40, 50))
    pattern, phasor = fixed_pattern(camera, (40, 50)), decoded(camera, view)
    np.testing.assert_allclose(range_error_m(phasor, 1.5, camera), pattern.range_m, atol=2e-6)
    clean = decoded(replace(camera, fixed_pattern=FixedPattern()), view)
    np.testing.assert_allclose(np.abs(phasor) / np.abs(clean), pattern.gain, rtol=1e-4)
    level = sum(correlate(view, camera, step)[0] for step in (0, 90, 180, 270)) / 4
    np.testing.assert_allclose(level, 100.0 + pattern.offset_lsb, atol=1e-3)
    # 2000 pixels: 4 sigma of a standard deviation are 6.3 %
    for values, sigma in ((pattern.range_m, 0.01), (pattern.gain, 0.02), (pattern.offset_lsb, 3.0)):
        assert values.std() == pytest.approx(sigma, rel=0.063)
    assert pattern.range_m.mean() == pytest.approx(0.2, abs=1e-3)
    other = fixed_pattern(replace(camera, fixed_pattern=replace(sensor, seed=4)), (40, 50))
    assert abs(np.corrcoef(other.gain.ravel(), pattern.gain.ravel())[0, 1]) < 0.1
    binned = fixed_pattern(replace(camera, binning=2), (40, 50))
    np.testing.assert_allclose(binned.gain - 1, (pattern.gain - 1) / 2, atol=1e-6)


def test_the_range_drifts_with_a_temperature_that_rises_exponentially():
    warm = Temperature(drift_m_per_k=2e-3, reference_c=20.0, temperature_c=23.0, self_heating_k=10.0)
    camera = replace(QUIET, temperature=warm)
    for time_s, kelvin in ((-5.0, 0.0), (0.0, 0.0), (600.0, 10 * (1 - np.exp(-1))), (1e5, 10.0)):
        assert temperature_c(camera, time_s) == pytest.approx(23.0 + kelvin)
        error = range_error_m(decoded(camera, flat_view(1.0), time_s), 1.0, camera)
        np.testing.assert_allclose(error, 2e-3 * (3.0 + kelvin), atol=2e-6)
    raw = simulated(flat_view(1.0), camera, time_s=600.0)
    phasor = raw.planes["phase_0"] - raw.planes["phase_180"] + 1j * (raw.planes["phase_270"] - raw.planes["phase_90"])
    np.testing.assert_allclose(range_error_m(phasor, 1.0, camera), 2e-3 * (13 - 10 * np.exp(-1)), atol=5e-6)


def test_stray_light_conserves_light_and_adds_phasors():
    settings = Scattering(stray_fraction=0.3, width=0.2)
    rng = np.random.default_rng(4)
    phasors = rng.normal(size=(2, 11, 17)) + 1j * rng.normal(size=(2, 11, 17))
    spread = scatter(phasors, settings)
    np.testing.assert_allclose(spread.sum(axis=(1, 2)), phasors.sum(axis=(1, 2)), rtol=1e-5)
    rows, columns = np.mgrid[:11, :17]
    expected = 0.7 * phasors[0]
    for row in range(11):
        for column in range(17):
            falls = np.exp(-0.5 * ((rows - row) ** 2 + (columns - column) ** 2) / (0.2 * 17) ** 2)
            expected = expected + 0.3 * phasors[0, row, column] * falls / falls.sum()
    np.testing.assert_allclose(spread[0], expected, atol=1e-5)
    assert scatter(phasors, Scattering()) is phasors


def test_one_per_cent_of_stray_light_draws_a_dark_background_towards_a_near_white_object():
    ranges = np.full((1, 30, 40), 4.0, np.float32)
    ranges[:, :, :12] = 0.5
    view = View(ranges, np.where(ranges < 1, 1.0, 0.2).astype(np.float32), np.ones_like(ranges))
    camera = replace(QUIET, scattering=Scattering(stray_fraction=STRAY_FRACTION))
    phasor = decoded(camera, view)
    own = decoded(QUIET, view)
    np.testing.assert_allclose(phasor, scatter(own, camera.scattering), rtol=1e-3, atol=1e-3)
    error = range_error_m(phasor, ranges[0], camera)
    assert (error[:, 14:24] < -0.05).all()
    assert np.abs(error[:, :12]).max() < 0.01


def test_a_second_camera_beats_with_ours():
    strength, beat_hz, phase_deg = 0.3, 120.0, 40.0
    its = Interference(strength=strength, modulation_hz=QUIET.modulation_hz + beat_hz, phase_deg=phase_deg)
    camera, view = replace(QUIET, interference=its), flat_view(1.4, shape=(2, 3))
    own = decoded(QUIET, view)
    delay = 4 * np.pi * 1.4 * its.modulation_hz / camera.speed_of_light_mps
    for time_s in (0.0, 1e-3, 3.4e-3, 7.0):
        turn = np.exp(1j * (delay - np.radians(phase_deg) - 2 * np.pi * beat_hz * time_s))
        expected = own + strength * np.abs(own) * turn * np.sinc(beat_hz * camera.illumination_time_s)
        np.testing.assert_allclose(decoded(camera, view, time_s), expected, rtol=2e-4)
    _, light = correlate(view, camera, 0)
    np.testing.assert_allclose(light, correlate(view, QUIET, 0)[1] * (1 + strength), rtol=1e-5)


@pytest.mark.parametrize("beat_hz", [-170.0, 170.0, 50e3])
def test_the_light_of_two_cameras_is_the_sum_of_both_by_their_harmonics(beat_hz):
    """The first two are modulated so nearly alike that they are one light; the third is not."""
    its = Interference(strength=0.05, modulation_hz=QUIET.modulation_hz + beat_hz, phase_deg=130.0)
    waveform = Waveform(illumination="square", reference="square", bandwidth_hz=4 * QUIET.modulation_hz)
    camera, step_deg = replace(QUIET, interference=its, waveform=waveform), 90.0
    range_m = np.random.default_rng(3).uniform(0.3, 12.0, (1, 9, 9))
    view = View(range_m, np.ones_like(range_m), np.ones_like(range_m))
    for time_s in (0.0, 3.4e-3, 7.0):
        expected = 0.0
        for hz, strength, phase_deg in ((QUIET.modulation_hz, 1.0, 0.0), (its.modulation_hz, 0.05, its.phase_deg)):
            turns = 2 * range_m[0] * hz / camera.speed_of_light_mps + step_deg / 360 - phase_deg / 360
            h = harmonics(waveform, hz, 1000)
            k, beats = np.arange(1, 1001), (hz - QUIET.modulation_hz) * np.array([camera.illumination_time_s, time_s])
            h = h * np.sinc(beats[0] * k)
            expected = expected + strength * np.real(np.exp(-2j * np.pi * (turns - beats[1])[..., None] * k) @ h)
        signal, light = collect(view, camera, step_deg, time_s)
        amplitude = light * camera.demodulation_contrast / 1.05
        assert (np.abs(signal - amplitude * expected) < 2e-6 * amplitude + 1e-6 * camera.reference_amplitude_lsb).all()


def test_the_beat_of_an_exposure_is_the_integral_over_it():
    its = Interference(strength=1.0, modulation_hz=QUIET.modulation_hz + 311.0)
    whole = replace(QUIET, interference=its, waveform=Waveform(illumination="square", reference="square"))
    view = flat_view(1.4, shape=(1, 1))
    one = simulated(view, whole).planes["phase_0"][0, 0]
    instant = replace(whole, illumination_time_s=1e-12)  # a moment, as bright as it is short
    start_s = exposure_times_s(whole, 0.0)[0] - whole.illumination_time_s / 2
    moments = start_s + (np.arange(400) + 0.5) / 400 * whole.illumination_time_s
    mean = np.mean([correlate(view, instant, 0, t)[0][0, 0] for t in moments])
    assert one == pytest.approx(mean * whole.illumination_time_s / 1e-12, rel=1e-3)
    for count in (2, 5):
        split = simulated(view, replace(whole, exposure_samples=count)).planes["phase_0"][0, 0]
        assert split == pytest.approx(one, rel=1e-4)


def test_an_exposure_of_a_moving_surface_is_the_mean_over_its_way():
    speed = 30.0

    def view(time_s):
        range_m = 2.0 + speed * time_s
        return flat_view(range_m, reflectivity=range_m**2 / 100, shape=(1, 1))

    camera = replace(QUIET, exposure_samples=50)
    still, rng = replace(QUIET, freeze_motion=True), np.random.default_rng(0)
    at_s = exposure_times_s(camera, 0.0)[0]
    middle = correlate(view(at_s), QUIET, 0)[0][0, 0]
    phase_rate = speed / metres_per_radian(camera)
    expected = middle * np.sinc(phase_rate * camera.illumination_time_s / (2 * np.pi))
    assert simulate(view, camera, 0.0, rng).planes["phase_0"][0, 0] == pytest.approx(expected, rel=1e-4)
    assert abs(expected / middle - 1) > 2e-5
    frozen = simulate(view, still, 0.0, rng)
    for step in (0, 90, 180, 270):
        assert frozen.planes[f"phase_{step}"][0, 0] == correlate(view(0.0), QUIET, step)[0][0, 0]


def test_the_middle_ray_alone_has_no_mixed_pixels():
    ranges = np.array([1.0, 1.0, 3.0, 3.0], np.float32).reshape(4, 1, 1)
    view = View(ranges, np.ones_like(ranges), np.ones_like(ranges))
    alone = decoded(replace(QUIET, mixed_pixels=False), view)
    np.testing.assert_allclose(range_error_m(alone, 3.0, QUIET), 0, atol=1e-5)
    assert abs(range_error_m(decoded(QUIET, view), 3.0, QUIET)[0, 0]) > 0.5


def test_a_missed_clock_edge_loses_a_pixel_and_moves_the_rest_of_its_row():
    plane = np.arange(1, 201, dtype=np.uint16).reshape(10, 20)
    arrived = transfer(plane, Link(missed_clock_probability=0.1), np.random.default_rng(1))
    lost = 0
    for row, sent in zip(arrived, plane, strict=True):
        kept = row[row > 0]
        assert (np.diff(kept.astype(int)) > 0).all()
        assert set(kept) <= set(sent)
        assert (row[len(kept) :] == 0).all()
        lost += len(sent) - len(kept)
    assert 5 <= lost <= 38  # 20 expected, binomial, four standard deviations
    assert (transfer(plane, Link(missed_clock_probability=1.0), np.random.default_rng(1)) == 0).all()
    assert transfer(plane, Link(), np.random.default_rng(1)) is plane


def test_crosstalk_turns_over_as_many_bits_as_it_should():
    plane = np.full((50, 60), 1234, np.uint16)
    all_turned = transfer(plane, Link(bit_error_probability=1.0), np.random.default_rng(1))
    assert (all_turned == 4095 - 1234).all()
    some = transfer(plane, Link(bit_error_probability=0.01), np.random.default_rng(1)) ^ plane
    turned = np.array([np.sum(some >> bit & 1, dtype=int) for bit in range(12)])
    assert abs(turned.sum() - 360) < 4 * np.sqrt(360 * 0.99)
    assert (turned > 0).all()
    assert some.max() < 4096
    assert (plane == 1234).all()


def test_a_wrong_bit_of_a_sample_without_rounding_is_one_of_its_nearest_whole_number():
    plane = np.full((3, 3), 8.25, np.float32)
    three_lines = Link(bit_error_probability=1.0, bits=3)
    np.testing.assert_array_equal(transfer(plane, three_lines, np.random.default_rng(1)), 8.25 - 7)


def test_only_the_region_of_interest_is_read_and_fewer_rows_take_less_time():
    camera = replace(CAMERA, rows=8, columns=10, pseudo_rows=0, region_of_interest=(2, 3, 4, 5))
    raw = simulated(flat_view(1.0, shape=(8, 10)), camera)
    image = RANGING["cw_four_phase"](raw, camera)
    inside = np.zeros((8, 10), bool)
    inside[2:6, 3:8] = True
    np.testing.assert_array_equal(image.why == Why.NO_SIGNAL, ~inside)
    assert image.valid[inside].all()
    assert readout_time_s(camera) == pytest.approx(CAMERA.readout_time_s / 2)
    assert fastest_frame_rate_hz(camera) > fastest_frame_rate_hz(CAMERA)
    with pytest.raises(UsageError, match=r"region_of_interest = \[2, 3, 4, 8\]: .* 8 rows and 10 columns"):
        simulated(flat_view(1.0, shape=(8, 10)), replace(camera, region_of_interest=(2, 3, 4, 8)))


def test_a_slow_pixel_clock_lengthens_the_read_out():
    clocked = [replace(CAMERA, link=Link(pixel_clock_hz=66.6e6 / divider)) for divider in (1, 8)]
    assert readout_time_s(clocked[0]) == CAMERA.readout_time_s  # 0.288 ms of pixels: not what limits it (E-S-14)
    assert readout_time_s(clocked[1]) == pytest.approx(160 * 120 / 8.325e6)  # N-S-018, N-S-041
    assert exposure_times_s(clocked[1], 0.0)[3] > exposure_times_s(CAMERA, 0.0)[3]
    part = replace(clocked[1], region_of_interest=(0, 0, 120, 80))
    assert readout_time_s(part) == CAMERA.readout_time_s


def test_the_words_of_the_processor_are_the_samples_shifted_to_the_top():
    words = replace(
        CAMERA,
        **{name: 16 * getattr(CAMERA, name) for name in WITH_UNIT_LSB},
        shot_noise_lsb2_per_lsb=16 * CAMERA.shot_noise_lsb2_per_lsb,
    )
    raw, shifted = (simulated(flat_view(1.0), camera) for camera in (CAMERA, words))
    for name, plane in raw.planes.items():
        np.testing.assert_array_equal(shifted.planes[name], plane << 4)  # N-S-050: 0..65520 in steps of 16
    one, other = (RANGING["cw_four_phase"](r, c) for r, c in ((raw, CAMERA), (shifted, words)))
    np.testing.assert_allclose(one.range_m, other.range_m, atol=1e-5)
    np.testing.assert_allclose(one.sigma_m, other.sigma_m, rtol=1e-4)


WITH_UNIT_LSB = (
    "black_level_lsb",
    "read_noise_lsb",
    "quantisation_lsb",
    "full_scale_lsb",
    "lower_limit_lsb",
    "reference_amplitude_lsb",
    "reference_floor_lsb",
)


def patches(point_m, normal, area_m2, power):
    count = len(point_m)
    surfaces = Surfaces(
        np.asarray(point_m, np.float32),
        np.tile(np.float32(normal), (count, 1)),
        np.linalg.norm(point_m, axis=1).astype(np.float32),
    )
    return Emitters(surfaces, np.full(count, power, np.float32), np.full(count, area_m2, np.float32))


def test_a_wall_lights_the_one_across_the_corner_by_its_form_factor():
    n = 60
    width, height = 1.0, 1.5  # the emitting wall lies in z = 0, from the edge y = 0 to y = height
    x, y = np.meshgrid((np.arange(n) + 0.5) / n * width, (np.arange(n) + 0.5) / n * height)
    area = width * height / n**2
    wall = patches(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), (0, 0, 1), area, area)
    distance = 0.4  # the receiver: on y = 0, over the corner x = 0 of the edge
    taker = Surfaces(np.float32([[0, 0, distance]]), np.float32([[0, 1, 0]]), np.float32([distance]))
    _, total = irradiance(wall, taker, correlation_table(harmonics(Waveform(), 17e6)), 0.0, np.zeros(1))
    X, Y = width / distance, height / distance
    root = np.sqrt(1 + Y**2)
    form_factor = (np.arctan(X) - np.arctan(X / root) / root) / (2 * np.pi)
    assert total[0] == pytest.approx(form_factor, rel=2e-3)


def corner_view(lens, shape, wall_m, side_m):
    """A wall across the axis and one along it to the right, which meet at a right angle."""
    ray = rays(lens, shape)
    to_wall = wall_m / ray[..., 0]
    with np.errstate(divide="ignore"):
        to_side = np.where(ray[..., 1] < 0, -side_m / ray[..., 1], np.inf)
    range_m = np.minimum(to_wall, to_side)[None].astype(np.float32)
    cosine = np.where(to_wall < to_side, ray[..., 0], -ray[..., 1])[None].astype(np.float32)
    return View(range_m, np.full_like(range_m, 0.8), cosine), to_wall < to_side


def test_a_corner_is_measured_too_far_by_the_integral_over_the_other_wall():
    shape, wall_m, side_m, rho = (60, 80), 2.0, 0.9, 0.8
    camera = replace(QUIET, multipath=Multipath(two_bounces=True, block_pixels=1), reference_exponent=0.0)
    view, on_wall = corner_view(camera.lens, shape, wall_m, side_m)
    direct, both = (decoded(each, view) for each in (replace(camera, multipath=Multipath()), camera))
    row, column = 33, 42
    assert on_wall[row, column]
    azimuth, elevation = np.meshgrid(  # over all directions in which the camera sees the side wall
        np.radians(40) * (1 - 2 * (np.arange(1000) + 0.5) / 1000), np.radians(30) * ((np.arange(600) + 0.5) / 300 - 1)
    )
    d = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    seen = -side_m / np.minimum(d[..., 1], -1e-9) * d[..., 0] < wall_m
    d, solid = d[seen], (np.cos(elevation) * np.radians(80) / 1000 * np.radians(60) / 600)[seen]
    there = d * (-side_m / d[:, 1])[:, None]
    here = rays(camera.lens, shape)[row, column] * view.range_m[0, row, column]
    way = here - there
    length = np.linalg.norm(way, axis=1)
    intensity = camera.reference_amplitude_lsb / d[:, 0] ** 7  # of the light: gain / cos^3 / vignetting cos^4
    given = rho / np.pi * intensity * solid * (way[:, 1] / length) * (way[:, 0] / length) / length**2
    total_m = np.linalg.norm(there, axis=1) + length + np.linalg.norm(here)
    cos_here = here[0] / np.linalg.norm(here)
    expected = rho * cos_here**4 * np.sum(given * np.exp(1j * total_m / 2 / metres_per_radian(camera)))
    second = both[row, column] - direct[row, column]
    assert abs(second - expected) < 0.02 * abs(expected)
    error = range_error_m(both, view.range_m[0], camera)
    assert error[row, column] > 5e-3
    assert error.min() > -1e-4  # light that goes a longer way never makes a range shorter here
    coarse = decoded(replace(camera, multipath=Multipath(two_bounces=True)), view)
    np.testing.assert_allclose(np.abs(coarse - both)[10:50, 5:30].max(), 0, atol=0.05 * np.abs(both - direct).max())


def test_a_plane_alone_has_no_multipath_and_a_void_gives_none():
    lens, shape = CAMERA.lens, (12, 16)
    camera = replace(QUIET, multipath=Multipath(two_bounces=True))
    cos_axis = rays(lens, shape)[..., 0].astype(np.float32)
    plane = View(1 / cos_axis[None], np.ones((1, *shape), np.float32), cos_axis[None])
    np.testing.assert_array_equal(decoded(camera, plane), decoded(replace(camera, multipath=Multipath()), plane))
    void = View(np.full((1, *shape), np.inf), np.zeros((1, *shape)), np.zeros((1, *shape)))
    np.testing.assert_array_equal(decoded(camera, void), 0)
    assert solid_angles(lens, (120, 160)).sum() == pytest.approx(np.radians(80) * 2 * np.sin(np.radians(30)), rel=1e-3)


def test_normals_are_found_on_both_sides_of_an_edge():
    view, on_wall = corner_view(CAMERA.lens, (30, 40), 2.0, 0.9)
    normal = surfaces_of(view, CAMERA.lens).normal.reshape(30, 40, 3)
    np.testing.assert_allclose(normal[on_wall], [[-1, 0, 0]] * on_wall.sum(), atol=1e-3)
    np.testing.assert_allclose(normal[~on_wall], [[0, 1, 0]] * (~on_wall).sum(), atol=1e-3)


EVERYTHING = replace(
    imperfect(CAMERA),
    rows=12,
    columns=16,
    taps=Taps(full_well_lsb=60.0, ambient_suppression_lsb=10.0),
    temperature=Temperature(drift_m_per_k=1e-3, temperature_c=30.0, self_heating_k=20.0),
    multipath=Multipath(two_bounces=True, block_pixels=2),
    interference=Interference(strength=0.2),
    link=Link(missed_clock_probability=0.01, bit_error_probability=0.01),
)


def moving_corner(time_s):
    near, _ = corner_view(CAMERA.lens, (12, 16), 0.9 - 20 * time_s, 0.5)
    far, _ = corner_view(CAMERA.lens, (12, 16), 1.9, 0.6)
    both = [np.concatenate([a, b]) for a, b in zip(vars(near).values(), vars(far).values(), strict=True) if np.ndim(a)]
    return View(*both, ambient_wpm2=3.0)


@pytest.mark.parametrize("name", IMPERFECTIONS)
def test_each_imperfection_can_be_switched_off_by_itself_from_the_same_noise(name):
    one, other = with_and_without(name, moving_corner, EVERYTHING, 0.01, seed=2)
    assert any(not np.array_equal(one.planes[p], other.planes[p]) for p in one.planes)
    assert IMPERFECTIONS[name](EVERYTHING) != EVERYTHING
    perfect = ideal(EVERYTHING)
    assert IMPERFECTIONS[name](perfect) == perfect
    same, again = with_and_without(name, moving_corner, perfect, 0.01, seed=2)
    assert all(np.array_equal(same.planes[p], again.planes[p]) for p in same.planes)


def test_an_unknown_imperfection_is_refused_with_the_nearest_name():
    with pytest.raises(UsageError, match="unknown imperfection 'wigling'; did you mean 'wiggling'"):
        with_and_without("wigling", moving_corner, CAMERA, 0.0, 0)


def test_the_noise_is_the_same_whatever_else_is_switched_off():
    camera = replace(EVERYTHING, shot_noise_lsb2_per_lsb=0.0, taps=Taps(), quantisation_lsb=0.0, link=Link())
    camera = replace(camera, lower_limit_lsb=None, full_scale_lsb=None)
    quiet = replace(camera, read_noise_lsb=0.0)
    for name in ("wiggling", "scattering", "interference", "link_faults"):
        noise = [
            with_and_without(name, moving_corner, camera, 0.0, 1)[i].planes["phase_90"]
            - with_and_without(name, moving_corner, quiet, 0.0, 1)[i].planes["phase_90"]
            for i in (0, 1)
        ]
        np.testing.assert_allclose(noise[0], noise[1], atol=1e-3)


def test_an_ideal_camera_measures_the_truth_at_every_frequency_and_the_truth_knows_its_wraps():
    camera = replace(EVERYTHING, modulations_hz=(80e6, 16e6), offset_m=0.3, phase_sign=-1, frame_rate_hz=10.0)
    view = moving_corner(0.0)
    raw, truth = simulated(view, ideal(camera)), ground_truth(view, camera)
    shown = ideal(camera)
    for k, modulation_hz in enumerate(camera.modulations_hz):
        c0, c90, c180, c270 = (raw.planes[f"f{k}_phase_{step}"].astype(float) for step in (0, 90, 180, 270))
        phasor = ((c0 - c180) + 1j * (c270 - c90)) / 2
        np.testing.assert_allclose(phasor, ground_truth(view, shown).phasor[k], rtol=2e-3)
        unambiguous = SPEED_OF_LIGHT / 2 / modulation_hz
        wrapped = -np.angle(phasor) / (2 * np.pi) * unambiguous + camera.offset_m
        np.testing.assert_allclose(wrapped % unambiguous + truth.wraps[k] * unambiguous, truth.range_m, atol=1e-3)
    assert truth.wraps[0].max() == 1
    assert truth.wraps[1].max() == 0
    empty = View(np.full((1, 2, 2), np.inf), np.zeros((1, 2, 2)), np.zeros((1, 2, 2)))
    nothing = ground_truth(empty, camera)
    assert np.isinf(nothing.range_m).all()
    assert (nothing.phasor == 0).all()
    assert (nothing.wraps == 0).all()


@pytest.mark.parametrize(
    ("part", "setting", "value"),
    [
        ("waveform", "illumination", "sawtooth"),
        ("waveform", "illumination_duty_cycle", 1.0),
        ("taps", "full_well_lsb", 0.0),
        ("fixed_pattern", "range_sigma_m", -0.1),
        ("temperature", "heating_time_s", 0.0),
        ("scattering", "stray_fraction", 1.5),
        ("multipath", "block_pixels", 0),
        ("interference", "strength", -1.0),
        ("link", "bit_error_probability", 2.0),
    ],
)
def test_imperfections_are_settings_of_the_camera_and_impossible_ones_are_refused(part, setting, value):
    with pytest.raises(UsageError, match=rf"camera.*{part}.{setting}"):
        load_config("scaled_car", {"camera": {part: {setting: value}}})


def test_white_at_one_metre_still_has_the_amplitude_of_the_thesis_with_every_imperfection_at_its_default():
    camera = replace(CAMERA, rows=121, columns=161)
    cos_axis = rays(camera.lens, (121, 161))[..., 0].astype(np.float32)
    view = View(1 / cos_axis[None], np.ones((1, 121, 161), np.float32), cos_axis[None])
    assert abs(decoded(camera, view)[60, 80]) == pytest.approx(145.0, abs=0.01)  # N-S-028


def test_the_study_of_imperfections_finds_what_the_thesis_says():
    study = cw_imperfections(np.random.default_rng(0))
    assert all(claim.agrees is not False for claim in study.claims)
    assert sum(claim.agrees is True for claim in study.claims) == 3
    caused = {claim.text.split(":")[0]: claim.computed for claim in study.claims if ": change of" in claim.text}
    assert {name.replace("_", " ") for name in IMPERFECTIONS} >= set(caused)
    assert caused["global offset"] == pytest.approx(100, rel=0.15)  # stretched by wiggling
    assert caused["temperature"] == pytest.approx(20, rel=0.15)
