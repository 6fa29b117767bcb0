"""Claims about the simulated continuous-wave camera: its sequence of exposures, and each imperfection by itself."""

from dataclasses import replace

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.cw import simulate
from rangecam.cw.light import correlate
from rangecam.cw.sequence import exposure_times_s, exposures, fastest_frame_rate_hz, plane_names
from rangecam.cw.signal import metres_per_radian, sample_variance
from rangecam.errors import UsageError
from rangecam.scene.view import View

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
    camera = replace(CAMERA, binning=2)
    for light in (0.0, 300.0):
        assert sample_variance(light, CAMERA) / sample_variance(light, camera) == pytest.approx(4)  # N-S-042


def test_a_sinusoidal_sample_is_the_cosine_of_the_phase_and_the_step():
    sample, _ = correlate(flat_view(2.1, shape=(1, 1)), QUIET, 120)
    strength, _ = correlate(flat_view(2.1, shape=(1, 1)), replace(QUIET, offset_m=2.1), 0)  # phase 0
    phase = 2.1 / metres_per_radian(QUIET)
    np.testing.assert_allclose(sample, strength * np.cos(phase + np.radians(120)), rtol=1e-5)
