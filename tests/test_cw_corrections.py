"""Corrections of the continuous-wave camera that need no calibration of each pixel."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rangecam.clean import FILTERS, clean
from rangecam.config import load_config
from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.cw.contradictions import moved
from rangecam.cw.effects import Multipath, Scattering
from rangecam.cw.imperfections import with_and_without
from rangecam.cw.ranging import cw_four_phase
from rangecam.cw.scattering import scatter, stray_light
from rangecam.cw.scattering_fit import fit_scattering
from rangecam.errors import DataError, UsageError
from rangecam.hdr import ranged
from rangecam.scene.view import View
from rangecam.types import RawFrame, Why

FOUR = RANGING["cw_four_phase"]
STRAY = Scattering(stray_fraction=0.01)
CAMERA = CwCamera(
    rows=60, columns=80, read_noise_lsb=0.5, shot_noise_lsb2_per_lsb=0.01, reference_amplitude_lsb=600.0,
    reference_floor_lsb=600.0, motion_tolerance=0.0,
)  # fmt: skip


def seen(range_m, reflectivity):
    """One ray a pixel, squarely onto surfaces."""
    range_m, reflectivity = np.broadcast_arrays(np.asarray(range_m, np.float32), np.asarray(reflectivity, np.float32))
    return View(range_m[None], reflectivity[None], np.ones_like(range_m[None]))


def target_before_wall(camera=CAMERA, wall_m=3.0, wall_reflectivity=0.1):
    """A white square at 0.5 m on the left of a dark wall; and where the wall is seen."""
    rows, columns = np.mgrid[: camera.rows, : camera.columns]
    target = (abs(rows - 25) < 8) & (abs(columns - 20) < 8)
    return seen(np.where(target, 0.5, wall_m), np.where(target, 0.9, wall_reflectivity)), ~target


def shot(view, camera, seed=0):
    return simulate(view if callable(view) else lambda _: view, camera, 0.0, np.random.default_rng(seed))


# --- stray light


@pytest.mark.parametrize("shape", [(60, 80), (3, 41, 30)])
@pytest.mark.parametrize(("fraction", "width"), [(0.01, 0.25), (0.3, 0.05), (0.7, 1.0)])
def test_stray_light_is_what_scattering_added(shape, fraction, width):
    lens = Scattering(stray_fraction=fraction, width=width)
    light = np.random.default_rng(0).random(shape).astype(np.float32) * 1000
    light = light + 1j * light[..., ::-1]
    seen_light = scatter(light, lens)
    np.testing.assert_allclose(seen_light - stray_light(seen_light, lens), (1 - fraction) * light, atol=2e-3)
    assert not stray_light(light, Scattering()).any()


def test_at_one_percent_of_stray_light_the_error_of_a_dark_wall_falls_more_than_fivefold():
    """Here to a hundredth with the right lens, and still fivefold with 15 % too much of it."""
    quiet = replace(CAMERA, read_noise_lsb=0.0, shot_noise_lsb2_per_lsb=0.0, scattering=STRAY)
    view, wall = target_before_wall()
    raw = shot(view, quiet)
    error = {
        f: np.abs(FOUR(raw, replace(quiet, stray_light=Scattering(stray_fraction=f))).range_m - 3.0)[wall].mean()
        for f in (0.0, 0.0085, 0.01, 0.0115)
    }
    assert error[0.0] > 0.1
    assert error[0.01] < 0.01 * error[0.0]
    assert max(error[0.0085], error[0.0115]) < 0.2 * error[0.0]


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
@pytest.mark.parametrize("shot_noise", [0.0, 0.5])
def test_sigma_holds_the_truth_after_stray_light_is_taken_out(pixel, shot_noise):
    """With much shot noise, which the stray light leaves behind."""
    lens = Scattering(stray_fraction=0.05)
    camera = replace(
        CAMERA, pixel=pixel, read_noise_lsb=0.3, shot_noise_lsb2_per_lsb=shot_noise, scattering=lens, stray_light=lens,
        max_phase_sigma_rad=0.3,
    )  # fmt: skip
    view, wall = target_before_wall(wall_reflectivity=0.6)
    errors = []
    for seed in range(4):
        image = FOUR(shot(view, camera, seed), camera)
        kept = wall & image.valid
        assert kept.mean() > 0.9 * wall.mean()
        errors.append(((image.range_m - 3.0) / image.sigma_m)[kept])
    assert np.concatenate(errors).std() == pytest.approx(1.0, abs=0.04)


def test_what_a_pixel_cannot_measure_is_said_as_without_correction_and_does_no_harm_to_others():
    camera = replace(CAMERA, scattering=STRAY, full_scale_lsb=2000.0, lower_limit_lsb=-2000.0, pseudo_rows=1)
    view, _ = target_before_wall()
    raw = shot(view, camera)
    planes = {name: plane.copy() for name, plane in raw.planes.items()}
    planes["phase_90"][10, 60] = np.nan
    planes["phase_90"][11, 60] = 5000.0
    planes["phase_180"][12, 60] = -5000.0
    for plane in planes.values():
        plane[13, 60] = 7.0
        plane[14, 60] = -np.inf
        plane[0] = 65535.0  # the sensor's own data is no light
    planes["phase_0"][14, 60] = np.inf
    image = FOUR(RawFrame(0.0, planes), replace(camera, stray_light=STRAY, motion_sigmas=3.0, motion_tolerance=0.1))
    told = [Why.NOT_FINITE, Why.SATURATED, Why.SATURATED, Why.NO_SIGNAL, Why.NOT_FINITE]
    assert image.why[10:15, 60].tolist() == told
    assert (image.why[0] == Why.SENSOR_FLAG).all()
    clean = FOUR(raw, replace(camera, stray_light=STRAY))
    inner = np.s_[30:, 30:55]
    np.testing.assert_allclose(image.range_m[inner], clean.range_m[inner], atol=0.02)
    assert image.valid[inner].mean() > 0.98


def test_stray_light_is_taken_out_before_neighbours_are_averaged_and_at_every_frequency():
    view, wall = target_before_wall(wall_reflectivity=0.15)
    bright = replace(CAMERA, reference_amplitude_lsb=3000.0, reference_floor_lsb=3000.0)
    for changes, method in (
        ({"phasor_filter": "3x3"}, "cw_four_phase"),
        ({"phase_steps_deg": (0, 72, 144, 216, 288)}, "cw_phases"),
        ({"modulations_hz": (20e6, 30e6), "frame_rate_hz": 10.0, "unwrap_residual_sigmas": 30.0}, "cw_multi_frequency"),
    ):
        camera = replace(bright, scattering=STRAY, **changes)
        raw = shot(view, camera)
        error = [
            np.median(np.abs(RANGING[method](raw, replace(camera, stray_light=lens)).range_m - 3.0)[wall])
            for lens in (Scattering(), STRAY)
        ]
        assert error[1] < 0.3 * error[0]


def test_without_settings_ranging_is_untouched():
    view, _ = target_before_wall()
    raw = shot(view, CAMERA)
    one, other = FOUR(raw, CAMERA), cw_four_phase(raw, CAMERA)
    for name in ("range_m", "sigma_m", "amplitude", "why"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_of_a_saturated_pixel_the_shortest_exposure_tells_the_stray_light():
    """A white plate saturates the long exposure; without the short one two thirds of its stray light would stay."""
    camera = load_config("scaled_car", {"camera": {"pseudo_rows": 0, "rows": 60, "columns": 80}}).camera
    camera = replace(camera, scattering=STRAY, illumination_times_s=(1e-4, 16e-3), frame_rate_hz=5.0)
    view, wall = target_before_wall(camera, wall_reflectivity=0.4)
    raw = shot(view, camera)
    error = {}
    for lens in (Scattering(), STRAY):
        image = ranged(FOUR, raw, replace(camera, stray_light=lens))
        seen_wall = wall & image.valid & (image.amplitude > 20)
        error[lens.stray_fraction] = abs(np.median(image.range_m[seen_wall]) - 3.0)
    assert error[0.01] < 0.05 * error[0.0]
    planes = {**raw.planes, "exposure_100us_phase_90": np.ones((3, 3), np.float32)}
    with pytest.raises(DataError, match="shape"):
        ranged(FOUR, RawFrame(0.0, planes), replace(camera, stray_light=STRAY))


# --- the lens from a recording


@pytest.mark.parametrize("lens", [STRAY, Scattering(stray_fraction=0.03, width=0.1)])
def test_the_lens_is_found_from_a_target_before_darkness_and_before_a_wall(lens):
    camera = replace(CAMERA, scattering=lens, pseudo_rows=1)
    rows, columns = np.mgrid[:60, :80]
    target = (abs(rows - 25) < 5) & (abs(columns - 20) < 5)
    wall = seen(np.full((60, 80), 3.0), 0.4)
    lit = [shot(seen(np.where(target, 0.5, np.inf), 0.9), camera, k) for k in range(4)]
    before = [shot(seen(np.where(target, 0.5, 3.0), np.where(target, 0.9, 0.4)), camera, k) for k in range(16)]
    without = [shot(wall, camera, 100 + k) for k in range(16)]
    for found in (fit_scattering(lit, camera), fit_scattering(before, camera, without)):
        assert found.stray_fraction == pytest.approx(lens.stray_fraction, rel=0.03)
        assert found.width == pytest.approx(lens.width, rel=0.03)


def test_recordings_that_do_not_show_stray_light_are_refused():
    view, _ = target_before_wall()
    with pytest.raises(DataError, match="no frames of the target"):
        fit_scattering([], CAMERA)
    with pytest.raises(DataError, match="fills a small part of a dark image"):
        fit_scattering([shot(seen(np.full((60, 80), 2.0), 0.5), CAMERA)], CAMERA)
    with pytest.raises(DataError, match="fills a small part of a dark image"):
        fit_scattering([RawFrame(0.0, {f"phase_{k}": np.zeros((6, 8)) for k in (0, 90, 180, 270)})], CAMERA)
    for limits in ({"full_scale_lsb": 500.0}, {"lower_limit_lsb": -500.0}):
        with pytest.raises(DataError, match="the target: a pixel is saturated"):
            fit_scattering([shot(view, CAMERA)], replace(CAMERA, **limits))


# --- motion


def crossing(at_s, speed=300.0, near_m=2.0, far_m=3.0):
    """A white half plane whose edge crosses `speed` pixels a second, before a wall; nine rays across a pixel."""
    columns = np.arange(80) + ((np.arange(9) - 4) / 9)[:, None]
    near = np.broadcast_to((columns < 40 + speed * at_s)[:, None, :], (9, 60, 80))
    return View(np.where(near, near_m, far_m), np.where(near, 0.5, 0.8), np.ones(near.shape))


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
def test_of_gross_errors_at_a_moving_edge_less_than_a_tenth_is_left(pixel):
    camera = replace(CAMERA, pixel=pixel, motion_tolerance=0.02)
    before = after = kept = pure = 0
    for phase, far_m in enumerate((2.6, 3.0, 3.5, 4.0, 5.0)):
        raw = shot(lambda t, p=phase, far=far_m: crossing(t + p / 1500, far_m=far), camera, phase)
        plain, tested = FOUR(raw, camera), FOUR(raw, replace(camera, motion_sigmas=3.0))
        off_m = np.minimum(abs(plain.range_m - 2.0), abs(plain.range_m - far_m))
        gross = off_m > 0.05 + 3 * plain.sigma_m
        before += off_m[gross & plain.valid].sum()
        after += off_m[gross & tested.valid].sum()
        assert set(np.unique(tested.why)) <= {Why.VALID, Why.MOTION}
        kept, pure = kept + tested.valid[:, :37].sum(), pure + tested.valid[:, :37].size
    assert before > 30
    assert after < 0.1 * before
    assert kept > 0.99 * pure


@pytest.mark.parametrize("steps", [(0, 90, 180, 270), (0, 72, 144, 216, 288), (0, 45, 90, 135, 180, 225, 270, 315)])
def test_noise_alone_contradicts_as_often_as_a_gaussian_says(steps):
    """N - 3 combinations: their squares add up to chi squared."""
    from scipy.stats import chi2

    camera = replace(CAMERA, rows=200, columns=250, phase_steps_deg=steps, motion_sigmas=2.0, frame_rate_hz=10.0)
    range_m = np.broadcast_to(np.linspace(0.8, 5.0, 250), (200, 250))
    image = RANGING["cw_phases"](shot(seen(range_m, 0.5), camera), camera)
    expected = chi2.sf(4.0, len(steps) - 3)
    assert np.mean(image.why == Why.MOTION) == pytest.approx(expected, rel=0.05)


def test_tolerance_lets_a_surface_come_nearer():
    """At 5 m/s before 1.2 m its light grows by 2.7 % from exposure to exposure, and its phase by 0.0115 rad."""
    camera = replace(CAMERA, reference_amplitude_lsb=6000.0, reference_floor_lsb=6000.0, motion_sigmas=3.0)

    def nearer(at_s):
        return seen(np.full((60, 80), 1.2 - 5 * at_s), 0.5)

    refused = [
        np.mean(FOUR(shot(nearer, camera), replace(camera, motion_tolerance=t)).why == Why.MOTION) for t in (0, 0.045)
    ]
    assert refused[0] > 0.9
    assert refused[1] < 0.01


def test_pixels_that_moved_are_not_averaged_with_their_neighbours():
    camera = replace(CAMERA, motion_sigmas=3.0)
    view = seen(np.full((60, 80), 2.0), 0.5)
    planes = {name: plane.copy() for name, plane in shot(view, camera).planes.items()}
    planes["phase_90"][20, 30] += 40.0
    raw = RawFrame(0.0, planes)
    image = FOUR(raw, replace(camera, phasor_filter="3x3", phasor_filter_sigmas=1000.0))
    assert image.why[20, 30] == Why.MOTION
    assert abs(image.range_m[20, 31] - 2.0) < 4 * image.sigma_m[20, 31]


def test_three_steps_cannot_contradict_each_other():
    camera = replace(CAMERA, phase_steps_deg=(0, 120, 240), motion_sigmas=3.0)
    with pytest.raises(UsageError, match="3 phase steps cannot contradict each other"):
        RANGING["cw_phases"](shot(seen(np.full((60, 80), 2.0), 0.5), camera), camera)


def test_gain_offset_and_a_constant_phase_contradict_nothing():
    samples = np.stack([30 + 7 * np.cos(0.3 + np.radians(step)) for step in (0, 90, 180, 270)]).reshape(1, 4, 1, 1)
    camera = replace(CAMERA, motion_sigmas=1e-3)
    assert not moved(samples.astype(np.float32), (0, 90, 180, 270), camera).any()


# --- multipath


def corner(mods, two_bounces):
    camera = load_config("scaled_car").camera
    return replace(
        camera, rows=40, columns=56, pseudo_rows=0, modulations_hz=mods, frame_rate_hz=10.0, full_scale_lsb=None,
        lower_limit_lsb=None, reference_amplitude_lsb=600.0, reference_floor_lsb=40.0, unwrap_phase_error_rad=0.0,
        unwrap_residual_sigmas=8.0, multipath=Multipath(two_bounces=two_bounces), multipath_sigmas=4.0,
    )  # fmt: skip


def test_frequencies_tell_some_of_the_multipath_of_a_corner_and_hardly_give_false_alarms():
    """Two white walls, at 2.5 m ahead and 1 m to the left."""
    from rangecam.geometry import rays

    camera = corner((80e6, 16e6, 120e6), True)
    ray = rays(camera.lens, (40, 56))
    ahead, beside = 2.5 / ray[..., 0], 1.0 / np.maximum(ray[..., 1], 1e-6)
    range_m = np.minimum(ahead, beside)
    cosine = np.where(ahead < beside, ray[..., 0], ray[..., 1])
    view = View(range_m[None], np.full((1, 40, 56), 0.9), cosine[None])
    raws = with_and_without("multipath", lambda _: view, camera, 0.0, 0)
    both, direct = (RANGING["cw_multi_frequency"](raw, camera) for raw in raws)
    wrong = np.abs(both.range_m - range_m) > 0.03
    assert wrong.mean() > 0.03
    assert np.mean(both.why[wrong] == Why.MULTIPATH) > 0.1
    assert np.mean(direct.why == Why.MULTIPATH) < 0.005


def test_one_frequency_cannot_tell_multipath():
    camera = replace(CAMERA, multipath_sigmas=3.0)
    with pytest.raises(UsageError, match="one modulation frequency cannot tell multipath"):
        FOUR(shot(target_before_wall()[0], camera), camera)


def test_the_shell_finds_the_lens_and_ranging_with_the_file_corrects_it(tmp_path, capsys):
    """A white plate at 0.5 m before a wall at 2 m, simulated and recorded; the file corrects what it was made from."""
    from rangecam.calibration import Calibration, Recording, load_calibration
    from rangecam.cli import main
    from rangecam.cw.scattering_fit import scattering
    from rangecam.io import Recorder
    from rangecam.types import Capture

    config = load_config("scaled_car", {"camera": {"rows": 60, "columns": 80, "scattering": {"stray_fraction": 0.02}}})
    view, _ = target_before_wall(wall_m=2.0, wall_reflectivity=0.5)
    scenes = {"with": view, "without": seen(np.full((60, 80), 2.0), 0.5)}
    for n, (name, each) in enumerate(scenes.items()):
        recorder = Recorder(tmp_path / f"{name}.mcap", config)
        for k in range(12):
            raw = replace(shot(each, config.camera, 100 * n + k), frame_id=k, time_s=0.1 * k)
            recorder.write(Capture(raw))
        recorder.close()
    files = [str(tmp_path / f"{name}.mcap") for name in scenes]
    out = str(tmp_path / "lens.npz")
    assert main(["calibrate", "scattering", files[0], "--without", files[1], "-o", out]) == 0
    assert "stray_fraction 0.0" in " ".join(capsys.readouterr().out.split())
    found = load_calibration(tmp_path / "lens.npz").settings["stray_light"]
    assert found["stray_fraction"] == pytest.approx(0.02, rel=0.05)
    assert found["width"] == pytest.approx(0.25, rel=0.05)
    errors = []
    for extra in ([], [f"--set=camera.calibration={out}"]):
        images = str(tmp_path / f"{len(extra)}.npz")
        everything = ("floor=off", "x_max_m=9.0", "width_m=9.0", "z_max_m=9.0", "wrap_threshold=0.0")
        sets = [f"--set=clean.{each}" for each in everything]
        assert main(["run", files[0], "--images", images, *sets, *extra]) == 0
        with np.load(images) as found_images:
            wall = found_images["valid"] & (found_images["range_m"] > 1)
            errors.append(abs(np.mean(found_images["range_m"][wall]) - 2.0))
    assert errors[1] < 0.2 * errors[0]
    one, none = (Recording("x", frames, CAMERA, "cw_four_phase", FOUR) for frames in ([shot(view, CAMERA)], []))
    with pytest.raises(DataError, match="no frames of the scene without the target"):
        scattering([one, none], Calibration({}))


@pytest.mark.parametrize("filter_name", FILTERS)
def test_the_whole_chain_from_phases_leaves_a_wall_where_it_is_with_a_tenth_of_the_pixels_lost(filter_name):
    """Stray light, motion, flying pixels, neighbours, filter: bias at most 2 mm, one and two sigma true."""
    lens = Scattering(stray_fraction=0.01)
    settings = {
        "camera": {"pseudo_rows": 0, "reference_amplitude_lsb": 600.0, "reference_floor_lsb": 600.0},
        "clean": {"floor": "off", "x_max_m": 9.0, "width_m": 30.0, "z_max_m": 9.0, "wrap_threshold": 0.0,
                  "amplitude_threshold": 0.0, "reject_flying": True, "filter": filter_name},
    }  # fmt: skip
    config = load_config("scaled_car", settings)
    camera = replace(config.camera, scattering=lens, stray_light=lens, motion_sigmas=3.0)
    rng, errors, sigmas = np.random.default_rng(5), [], []
    for seed in range(6):
        raw = shot(seen(np.full((120, 160), 2.5), 0.5), camera, seed)
        lost = rng.random((120, 160)) < 0.1
        planes = {name: np.where(lost, np.nan, plane.astype(np.float32)) for name, plane in raw.planes.items()}
        image = clean(FOUR(RawFrame(0.0, planes), camera), camera.lens, config.mounting, config.clean)
        assert not image.valid[lost].any()
        assert image.valid.mean() > 0.85
        errors.append((image.range_m - 2.5)[image.valid])
        sigmas.append(image.sigma_m[image.valid])
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    assert abs(error.mean()) < 0.002
    assert np.mean(np.abs(error) < sigma) == pytest.approx(0.6827, abs=0.03)
    assert np.mean(np.abs(error) < 2 * sigma) == pytest.approx(0.9545, abs=0.03)


DATA = Path(os.environ.get("RANGECAM_DATA", "")) / "cw_mlx75027" / "tools_scene.npz"


@pytest.mark.skipif(not DATA.is_file(), reason="RANGECAM_DATA does not name a folder with cw_mlx75027")
def test_the_samples_of_real_tools_at_rest_do_not_contradict_each_other():
    """A real sensor's taps differ and its light is no sine: neither is taken for motion."""
    from rangecam.io import open_source

    source = open_source(DATA)
    image = FOUR(next(iter(source.captures)).raw, replace(source.config.camera, motion_sigmas=3.0))
    assert np.mean(image.why == Why.MOTION) < 0.001
