"""`rangecam calibrate`: the whole calibration of a camera from the shell, its steps, and the noise fit."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rangecam.calibration import Calibration, Recording, load_calibration
from rangecam.calibration.noise import fit_noise
from rangecam.cli import main
from rangecam.errors import DataError, UsageError
from rangecam.io import open_source
from rangecam.pulsed import CALIBRATE, RANGING, PulsedCamera, simulate
from rangecam.pulsed.noise_fit import fit_dark_noise
from rangecam.pulsed.pixel import damping, dark_noise
from rangecam.pulsed.settings import Pixel, Taps
from rangecam.scene.view import View
from rangecam.studies import run_study
from rangecam.types import RawFrame

C = 3e8
STEPS = (1, 4, 16, 64, 100)
FOLDER = Path(os.environ.get("RANGECAM_DATA", "")) / "pulsed_bec80t"
recorded = pytest.mark.skipif(
    not (FOLDER / "clear_standard.npz").is_file(), reason="RANGECAM_DATA does not name a folder with pulsed_bec80t"
)
DARK = 'description = "nothing"\npreset = "usercams"\nduration_s = 2.0\n'
WALL = """description = "a wall"
preset = "usercams"
duration_s = 1.0
[[objects]]
name = "wall"
path.start_m = [{}, 0.0, 1.2]
boxes = [{{ center_m = [0.05, 0.0, 0.0], size_m = [0.1, 100.0, 100.0], reflectivity = 0.5 }}]
"""
KNOWN = """[camera]
rows = 2
columns = 8
frame_rate_hz = 2.0
averages = 25
speed_of_light_mps = 3e8
shutter_a_width_s = 230e-9
laser_delay_s = 25e-9
min_range_m = 0.0
max_range_m = 40.0
"""
ACTUAL = """[camera]
rows = 2
columns = 8
frame_rate_hz = 2.0
averages = 25
speed_of_light_mps = 3e8
shutter_a_width_s = 230e-9
laser_delay_s = 27e-9
pulse_rise_s = 60e-9
pulse_fall_s = 30e-9
shutter_edge_s = 65e-9
pixel.fixed_pattern_v = 5e-3
pixel.fixed_pattern_per_pulse_v = 0.3e-3
"""


def rangecam(*arguments):
    assert main([str(each) for each in arguments]) == 0


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the settings people know, those that are true, recordings of darkness and of walls."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "known.toml").write_text(KNOWN)
    (folder / "actual.toml").write_text(ACTUAL)
    (folder / "dark.toml").write_text(DARK)
    here = ("--config", folder / "actual.toml")
    for n in STEPS:
        steps = f"camera.pixel.accumulations=[{n}]"
        rangecam("simulate", folder / "dark.toml", *here, "--set", steps, "-o", folder / f"dark-{n}.mcap")
    for seed, distance_m in enumerate((*range(2, 23, 2), 3, 7, 13, 19)):
        scene = folder / f"wall-{distance_m}.toml"
        scene.write_text(WALL.format(distance_m))
        rangecam("simulate", scene, *here, "--seed", seed, "-o", folder / f"wall-{distance_m}.mcap")
    return folder


def bias_m(folder, distance_m, *more):
    images = folder / "images.npz"
    config = ("--config", folder / "known.toml", "--images", images, "--json")
    rangecam("run", folder / f"wall-{distance_m}.mcap", *config, *more)
    with np.load(images) as file:
        x = np.linspace(1, -1, 17)[1::2] * np.tan(np.radians(29.95 / 2))
        z = np.linspace(1, -1, 5)[1::2] * np.tan(np.radians(8.83 / 2))
        known_m = distance_m * np.sqrt(1 + x**2 + z[:, None] ** 2)
        return float(np.nanmean(np.where(file["valid"], file["range_m"], np.nan) - known_m))


def test_a_camera_is_calibrated_from_the_shell_and_its_bias_falls_below_a_centimetre(bench, capsys):
    """Dark frames, walls, and ranges of other walls: soft edges, a cable of 2 ns and a fixed pattern are gone."""
    dark, whole = bench / "dark.npz", bench / "whole.npz"
    config = ("--config", bench / "known.toml")
    rangecam("calibrate", "dark", *(bench / f"dark-{n}.mcap" for n in STEPS), *config, "-o", dark)
    walls = [f"{d}={bench}/wall-{d}.mcap" for d in range(2, 23, 2)]
    rangecam("calibrate", "range", *walls, *config, "--from", dark, "-o", whole, "--json")
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["step"] == "range"
    assert np.abs(said["found"]["bias_after_m"]).max() < 0.01 < np.abs(said["found"]["bias_before_m"]).max()
    calibration = load_calibration(whole)
    assert calibration.names == {"offset_a", "offset_b", "range_slope", "range_intercept_m"}
    assert calibration.taken["temperature_c"] == 25.0
    before = [bias_m(bench, d) for d in (3, 7, 13, 19)]
    after = [bias_m(bench, d, "--set", f"camera.calibration={whole}") for d in (3, 7, 13, 19)]
    assert np.abs(before).min() > 0.1
    assert np.abs(after).max() < 0.01


def test_a_straight_line_leaves_what_the_soft_edges_bend(bench):
    straight = bench / "straight.npz"
    walls = [f"{d}={bench}/wall-{d}.mcap" for d in range(2, 23, 2)]
    rangecam("calibrate", "range", *walls, "--config", bench / "known.toml", "-o", straight, "--straight")
    found = load_calibration(straight)
    assert found.settings["range_curve_m"] == []
    assert np.abs(found.taken["range"]["bias_after_m"]).max() > 0.05
    assert found.taken["range"]["curve"] == "none"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["dark", "-o", "x.npz"], "calibrate needs a recording"),
        (["range", "wall-4.mcap", "-o", "x.npz"], "expected NUMBER=RECORDING"),
        (["range", "x=wall-4.mcap", "-o", "x.npz"], "expected NUMBER=RECORDING"),
        (["range", "4=wall-4.mcap", "-o", "x.npz"], "have no line"),
        (["range", "4=none.mcap", "-o", "x.npz"], "no such file"),
        (["dark", "wall-4.mcap", "-o", "none/x.npz"], "does not exist"),
        (["noise", "wall-4.mcap", "-o", "x.npz", "--figure", "none/x.png"], "does not exist"),
        (["range", "4=wall-4.mcap", "-o", "x.npz", "--from", "wall-4.mcap"], "not a NumPy archive"),
        (["dark", "r.npz", "-o", "x.npz"], "nothing to calibrate of a camera of kind processed"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused_in_a_line(bench, capsys, monkeypatch, arguments, said):
    monkeypatch.chdir(bench)
    np.savez("r.npz", range_m=np.ones((2, 3)))
    assert main(["calibrate", *arguments]) in (1, 2)
    error = capsys.readouterr().err.strip()
    assert said in error
    assert error.count("\n") == 0


# --- steps -------------------------------------------------------------------------------------------------------

EDGES = {"pulse_rise_s": 60e-9, "pulse_fall_s": 30e-9, "shutter_edge_s": 65e-9}
CAMERA = PulsedCamera(
    speed_of_light_mps=C, rows=2, columns=8, frame_rate_hz=0.5, averages=100, shutter_a_width_s=230e-9,
    laser_delay_s=27e-9, **EDGES,
)  # fmt: skip


def wall(range_m, camera, seed, reflectivity=0.5):
    """One frame of a wall whose range is the same for all pixels."""
    ones = np.ones((1, camera.rows, camera.columns))
    view = View(ones * range_m, ones * reflectivity, ones)
    return simulate(lambda _: view, camera, 0.0, np.random.default_rng(seed))


def across(distance_m, camera, seed):
    """One frame of a wall across the axis at that distance."""
    from rangecam.geometry import rays

    return wall(distance_m / rays(camera.lens, (camera.rows, camera.columns))[..., 0], camera, seed)


def recording(frames, camera, known=None, method="mdsi3"):
    return Recording(f"wall {known}", frames, camera, method, RANGING[method], known)


def by_planes(camera):
    return CALIBRATE["range"](
        [recording([across(d, camera, [1, d])], camera, float(d)) for d in range(2, 23)], Calibration({})
    )


def by_delays(camera, stated, distance_m=3.0):
    later_s = np.arange(0.0, 130e-9, 20e-9 / 3)
    states = [replace(camera, laser_delay_s=camera.laser_delay_s + s) for s in later_s.tolist()]
    frames = [across(distance_m, state, [2, i]) for i, state in enumerate(states)]
    recordings = [
        recording([frame], state if stated else camera, later)
        for frame, state, later in zip(frames, states, later_s.tolist(), strict=True)
    ]
    return CALIBRATE["delay"](recordings, Calibration({}), distance_m=distance_m)


@pytest.mark.parametrize("stated", [True, False])
def test_laser_delays_stand_for_distances(stated):
    """K-CAL-04: within a centimetre of the calibration by planes wherever both know, with delays that are true."""
    planes, delays = by_planes(CAMERA), by_delays(CAMERA, stated)
    assert delays.made_for["laser_delay_s"] == pytest.approx(27e-9)
    curves = [np.array(each.settings["range_curve_m"]) for each in (planes, delays)]
    true_m = np.linspace(3.5, 20, 50)
    measured = np.interp(true_m, curves[0][:, 1], curves[0][:, 0])
    difference_m = np.interp(measured, *curves[1].T) - true_m
    assert np.abs(difference_m).max() < 0.01
    assert delays.taken["range"]["target_m"] == 3.0


def test_laser_delays_that_do_not_fit_what_is_said_are_refused():
    frame = across(3.0, CAMERA, 1)
    later = replace(CAMERA, laser_delay_s=47e-9)
    with pytest.raises(UsageError, match=r"1e-08 s later than in use: that makes 3\.7e-08 in use, but 2\.7e-08"):
        CALIBRATE["delay"](
            [recording([frame], CAMERA, 0.0), recording([frame], later, 10e-9)], Calibration({}), distance_m=3.0
        )
    with pytest.raises(UsageError, match="the delay of its laser is not said"):
        CALIBRATE["delay"]([recording([frame], CAMERA)], Calibration({}), distance_m=3.0)


def test_recordings_and_calibrations_of_different_cameras_are_refused():
    frame, other = across(3.0, CAMERA, 1), replace(CAMERA, pulse_width_s=200e-9)
    with pytest.raises(UsageError, match="pulse_width_s"):
        CALIBRATE["dark"]([recording([wall(np.inf, CAMERA, 1)], CAMERA), recording([], other)], Calibration({}))
    start = Calibration({**by_planes(CAMERA).made_for, "rows": 3})
    with pytest.raises(UsageError, match="--from: a calibration for rows = 3"):
        CALIBRATE["range"]([recording([frame], CAMERA, 3.0), recording([across(5.0, CAMERA, 1)], CAMERA, 5.0)], start)


def test_what_a_step_does_not_determine_stays():
    camera = replace(CAMERA, averages=1, frame_rate_hz=25.0)
    with_noise = CALIBRATE["noise"]([recording(dark_frames(camera, 20), camera)], by_planes(CAMERA))
    with_dark = CALIBRATE["dark"]([recording(dark_frames(camera, 2), camera)], with_noise)
    assert with_dark.names == {"offset_a", "offset_b", "range_slope", "range_intercept_m"}
    assert set(with_dark.settings) == {"range_curve_m", "pixel"}
    assert set(with_dark.taken) == {"temperature_c", "range", "noise", "dark"}


def test_a_three_tap_camera_gets_its_dark_images():
    camera = PulsedCamera(readout="three_tap", pulse_width_s=30e-9, rows=4, columns=8, frame_rate_hz=2.0)
    made = CALIBRATE["dark"](
        [recording([wall(np.inf, camera, i) for i in range(20)], camera, method="three_tap")], Calibration({})
    )
    assert made.names == {"dark_1", "dark_2", "dark_3"}
    assert made.planes["dark_2"].mean() == pytest.approx(camera.taps.black_level_counts, abs=1.0)


# --- noise -------------------------------------------------------------------------------------------------------


def dark_frames(camera, count, seed=3):
    for n in STEPS:
        one_step = replace(camera, pixel=replace(camera.pixel, accumulations=(n,)))
        for i in range(count):
            yield wall(np.inf, one_step, [seed, n, i])


@pytest.mark.parametrize("width_s", [180e-9, 400e-9])
def test_the_noise_fit_recovers_both_parameters_within_two_percent(width_s):
    """K-NOI-03 and K-NOI-04: from simulated dark frames, whatever the length of the shutter, with a fixed pattern."""
    pixel = Pixel(fixed_pattern_v=5e-3, fixed_pattern_per_pulse_v=0.3e-3)
    camera = PulsedCamera(pixel=pixel, shutter_a_width_s=width_s, shutter_b_width_s=width_s)
    found = CALIBRATE["noise"]([recording(dark_frames(camera, 150), camera)], Calibration({})).settings["pixel"]
    assert found["sensor_noise_v"] == pytest.approx(0.379e-3, rel=0.02)
    assert found["readout_noise_v"] == pytest.approx(0.442e-3, rel=0.02)


def test_without_the_damping_taken_off_the_fit_would_be_wrong():
    """E-K-10: the same frames, read with a pixel that is said not to damp."""
    camera = PulsedCamera(pixel=Pixel())
    undamped = replace(camera, pixel=replace(camera.pixel, damping=0.0))
    found = CALIBRATE["noise"]([recording(dark_frames(camera, 20), undamped)], Calibration({})).settings["pixel"]
    assert abs(found["sensor_noise_v"] / 0.379e-3 - 1) > 0.2


def test_the_dark_fit_is_exact_for_exact_variances():
    pixel, n = Pixel(adc_bits=0), np.array(STEPS)
    fit = fit_dark_noise(n, (damping(n, pixel) * dark_noise(n, pixel)) ** 2, np.full(5, 1e4), pixel)
    assert np.sqrt([fit.slope, fit.base]) == pytest.approx([0.379e-3, 0.442e-3], rel=1e-6)


def test_dark_frames_that_tell_no_noise_are_refused():
    pixel, camera = Pixel(), PulsedCamera(rows=2, columns=8)
    with pytest.raises(DataError, match="two or more tell sigma_S from sigma_R"):
        fit_dark_noise([4], [1e-6], [100], pixel)
    with pytest.raises(DataError, match="does not grow with the accumulations"):
        fit_dark_noise([1, 16], [1e-6, 1e-7], [100, 100], pixel)
    with pytest.raises(DataError, match="take two or more of each"):
        CALIBRATE["noise"]([recording(dark_frames(camera, 1), camera)], Calibration({}))


def tap_frames(camera, count):
    """A staircase of grey, at rest."""
    grey = np.geomspace(2e-4, 0.02, camera.columns) * np.ones((1, camera.rows, 1))
    view = View(np.full(grey.shape, 3.0), grey, np.ones(grey.shape))
    return [simulate(lambda _: view, camera, 0.0, np.random.default_rng([9, i])) for i in range(count)]


TAPS = PulsedCamera(readout="three_tap", pulse_width_s=30e-9, rows=100, columns=60, frame_rate_hz=2.0)


def test_the_tap_noise_is_recovered_from_frames_of_a_scene_at_rest():
    frames = tap_frames(TAPS, 40)
    found = CALIBRATE["noise"]([recording(frames, TAPS, method="three_tap")], Calibration({})).settings["taps"]
    assert found["read_noise_counts"] == pytest.approx(TAPS.taps.read_noise_counts, rel=0.02)
    assert found["shot_noise_counts2_per_count"] == pytest.approx(TAPS.taps.shot_noise_counts2_per_count, rel=0.05)
    assert found["black_level_counts"] == pytest.approx(TAPS.taps.black_level_counts, abs=1.0)
    bare = [RawFrame(f.time_s, {k: p for k, p in f.planes.items() if k.startswith("tap_")}) for f in frames]
    with pytest.raises(DataError, match=r"no dark_1\.\.3 beside the taps"):
        CALIBRATE["noise"]([recording(bare, TAPS, method="three_tap")], Calibration({}))


def test_pixels_that_flicker_do_not_decide_the_tap_noise():
    rng = np.random.default_rng(4)
    light = rng.uniform(0, 800, 20_000)
    variance = (3.0**2 + 1 / 12 + 0.02 * light) * rng.chisquare(29, light.size) / 29
    variance[(light > 100) & (light < 140)] *= 1.3
    variance[rng.random(light.size) < 0.05] *= 50
    variance[light > 700] *= rng.uniform(1, 1000, (light > 700).sum())
    fit = fit_noise(light, variance, 30)
    assert np.sqrt(fit.base) == pytest.approx(3.0, rel=0.02)
    assert fit.slope == pytest.approx(0.02, rel=0.08)
    assert fit.x.max() < 720
    with pytest.raises(DataError, match="too few to tell"):
        fit_noise(light[:10], variance[:10], 30)
    with pytest.raises(DataError, match="three are needed for a line"):
        fit_noise(np.zeros(1000), np.ones(1000), 30)
    with pytest.raises(DataError, match="does not grow with the light"):
        fit_noise(light, rng.chisquare(29, light.size) / light.clip(1), 30)


@recorded
def test_the_noise_of_a_real_camera_is_fitted_from_its_recording(tmp_path, capsys):
    """Both recordings agree; without their own deviations, sigma by the fitted model is that of the recording."""
    found = {}
    for name in ("standard", "early"):
        path, output = FOLDER / f"clear_{name}.npz", tmp_path / f"{name}.npz"
        figure = tmp_path / f"{name}.png"
        rangecam("calibrate", "noise", path, "-o", output, "--figure", figure)
        assert figure.read_bytes().startswith(b"\x89PNG")
        assert "figure" in capsys.readouterr().out
        found[name] = load_calibration(output).settings["taps"]
    for key in ("read_noise_counts", "shot_noise_counts2_per_count"):
        assert found["early"][key] == pytest.approx(found["standard"][key], rel=0.05)
        assert found["standard"][key] == pytest.approx(getattr(Taps(), key), rel=0.15)
    source = open_source(
        FOLDER / "clear_standard.npz", layers=[{"camera": {"calibration": str(tmp_path / "standard.npz")}}]
    )
    raw, camera = next(iter(source.captures)).raw, source.config.camera
    assert camera.taps.read_noise_counts == found["standard"]["read_noise_counts"]
    modelled = {name: plane for name, plane in raw.planes.items() if not name.startswith("tap_std")}
    measured, image = (RANGING["three_tap"](replace(raw, planes=p), camera) for p in (raw.planes, modelled))
    both = measured.valid & image.valid
    assert both.mean() > 0.9
    np.testing.assert_allclose(image.range_m[both], measured.range_m[both], rtol=1e-6)
    assert 0.9 < np.median(image.sigma_m[both] / measured.sigma_m[both]) < 1.1


# --- studies -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["calibration", "noise-fit"])
def test_what_the_studies_claim_holds(name):
    """K-CAL-01, -03 and -04, K-NOI-03 and -04, as they are shown to people."""
    claims = run_study(name).claims
    assert [claim.text for claim in claims if claim.agrees is False] == []
    assert {claim.id for claim in claims} == {
        "calibration": {"K-CAL-01", "K-CAL-03", "K-CAL-04"},
        "noise-fit": {"K-NOI-03", "K-NOI-04"},
    }[name]
