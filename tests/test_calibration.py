"""Offset and distance calibration: what they remove, their file, and how they reach the chain (König 2008, 4.3)."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rangecam import cw
from rangecam.calibration import (
    Calibration,
    Line,
    attach,
    check_made_for,
    estimate_dark,
    fit_curve,
    fit_range,
    load_calibration,
    mean_plane,
    save_calibration,
)
from rangecam.errors import DataError, UsageError
from rangecam.io import Recorder, open_source
from rangecam.pulsed import RANGING, PulsedCamera, made_for, simulate
from rangecam.pulsed.pixel import accumulated, fixed_pattern
from rangecam.pulsed.settings import Pixel
from rangecam.scene.view import View
from rangecam.types import RangeImage, RawFrame, Why

C = 3e8
STEPS = (1, 4, 16, 64, 100)
PATTERNED = Pixel(fixed_pattern_v=5e-3, fixed_pattern_per_pulse_v=0.3e-3, fixed_pattern_seed=7)
CAMERA = PulsedCamera(speed_of_light_mps=C, pixel=PATTERNED)


def wall(range_m, camera, reflectivity=0.5):
    ones = np.ones((1, camera.rows, camera.columns))
    view = View(ones * range_m, ones * reflectivity, ones)
    return lambda time_s: view


def shoot(range_m, camera, seed, reflectivity=0.5):
    return simulate(wall(range_m, camera, reflectivity), camera, 0.0, np.random.default_rng(seed))


def dark_frames(camera, count, steps=STEPS):
    for n in steps:
        one_step = replace(camera, pixel=replace(camera.pixel, accumulations=(n,)))
        for i in range(count):
            yield shoot(np.inf, one_step, [1, n, i], 0.0)


def unit_line(camera):
    shape = (camera.rows, camera.columns)
    return Line(np.ones(shape), np.zeros(shape))


def calibration_of(camera, line, dark=None, method="mdsi3", **more):
    planes = {"range_slope": line[0], "range_intercept_m": line[1]}
    stepped = {name.replace("shutter_", "offset_"): stack for name, stack in (dark or {}).items()}
    return Calibration(made_for(camera, method), {}, {}, planes, np.array(STEPS), stepped, **more)


@pytest.fixture(scope="module")
def offsets():
    still = estimate_dark(dark_frames(CAMERA, 60), "shutter_")
    assert still.accumulations.tolist() == list(STEPS)
    assert still.frames.tolist() == [60] * 5
    return calibration_of(CAMERA, unit_line(CAMERA), still.mean)


# --- offset ------------------------------------------------------------------------------------------------------


def test_the_pattern_is_that_of_the_sensor_and_grows_with_the_accumulations():
    """K-PIX-16: the part of every pulse accumulates with the damping of the signal."""
    noiseless = replace(PATTERNED, sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0)
    camera = replace(CAMERA, pixel=noiseless)
    readout_v, pulse_v = fixed_pattern((2, 8, 64), noiseless)
    assert np.std(readout_v) == pytest.approx(5e-3, rel=0.1)
    for raw, n in zip(dark_frames(camera, 1), STEPS, strict=True):
        expected_v = readout_v + accumulated(pulse_v, n, noiseless)
        for i, name in enumerate("ab"):
            np.testing.assert_allclose(raw.planes[f"shutter_{name}"], expected_v[i], atol=1e-8)
    other = replace(camera, pixel=replace(noiseless, fixed_pattern_seed=8))
    assert not np.allclose(shoot(9.0, other, 1).planes["shutter_a"], shoot(9.0, camera, 1).planes["shutter_a"])


@pytest.mark.parametrize("n", STEPS)
def test_offset_calibration_removes_99_percent_of_the_variance_of_the_pattern(offsets, n):
    """K-CAL-01, on frames that the dark images were not made of."""
    one_step = replace(CAMERA, pixel=replace(PATTERNED, accumulations=(n,)))
    frames = [attach(shoot(np.inf, one_step, [2, n, i], 0.0), offsets) for i in range(100)]
    for name in "ab":
        before, after = (
            np.mean([f.planes[f"shutter_{name}"] - k * f.planes[f"offset_{name}"] for f in frames], axis=0)
            for k in (0, 1)
        )
        assert np.var(after) < 0.01 * np.var(before)


def test_offset_calibration_brings_the_range_back_within_its_sigma(offsets):
    """What sigma says holds again: 68 and 95 % of a far, dark wall."""
    raw, range_m = [shoot(15.0, CAMERA, i, 0.3) for i in range(20)], 15.0
    deviations = {}
    for name, frames in {"raw": raw, "calibrated": [attach(r, offsets) for r in raw]}.items():
        images = [RANGING["mdsi3"](frame, CAMERA) for frame in frames]
        deviations[name] = np.concatenate([np.abs((i.range_m - range_m) / i.sigma_m)[i.valid] for i in images])
    assert np.mean(deviations["raw"] < 1) < 0.5
    assert 0.64 < np.mean(deviations["calibrated"] < 1) < 0.72
    assert 0.93 < np.mean(deviations["calibrated"] < 1.96) < 0.97


def test_a_saturated_sample_stays_saturated(offsets):
    raw = attach(shoot(0.7, CAMERA, 1, 1.0), offsets)
    assert (RANGING["mdsi3"](raw, CAMERA).why == Why.SATURATED).all()


# --- distance ----------------------------------------------------------------------------------------------------

KNOWN_M = (2.0, 6.0, 11.0, 15.0, 20.0)
# The edges of the thesis' laser and sensor, and a pulse whose flat top is longer than the flight to 20 m and the edge.
SOFT = replace(
    CAMERA, pulse_rise_s=60e-9, pulse_fall_s=30e-9, shutter_edge_s=65e-9, pulse_width_s=260e-9,
    shutter_a_width_s=300e-9, shutter_b_width_s=400e-9, laser_delay_s=55e-9, pixel=Pixel(), rows=4, columns=8,
    frame_rate_hz=0.1, averages=500,
)  # fmt: skip
# What people take it for: cables of 3 ns and a pulse a few per cent longer are not known.
ASSUMED = {"pulse_width_s": 250e-9, "laser_delay_s": 52e-9}


BETWEEN_M = (2.0, 4.0, 8.0, 13.0, 17.0, 20.0)
SHORT = replace(
    SOFT, averages=2000, frame_rate_hz=0.02, pulse_width_s=180e-9, shutter_a_width_s=230e-9, laser_delay_s=27e-9
)


def planes_of(camera, known_m, assumed, method="mdsi3", seed=4):
    known = replace(camera, **assumed)
    return [mean_plane([RANGING[method](shoot(r, camera, [seed, i]), known) for i in range(5)], r) for r in known_m]


def biases_m(camera, line, assumed, curve=()):
    """Bias of every pixel (6, 4, 8) at ranges between those of the calibration, from many frames."""
    known = replace(camera, **assumed, range_curve_m=curve)
    calibration = calibration_of(camera, line)
    biases = []
    for range_m in BETWEEN_M:
        frames = [attach(shoot(range_m, camera, [3, i]), calibration) for i in range(5)]
        images = [RANGING["mdsi3"](frame, known) for frame in frames]
        assert all(image.valid.all() for image in images)
        biases.append(np.mean([image.range_m for image in images], axis=0, dtype=float) - range_m)
    return np.array(biases)


def test_distance_calibration_leaves_less_than_a_centimetre_with_soft_edges():
    """K-CAL-03: 2 to 20 m off 50 %, where the line of the quotient is straight."""
    before = biases_m(SOFT, unit_line(SOFT), ASSUMED)
    after = biases_m(SOFT, fit_range(planes_of(SOFT, KNOWN_M, ASSUMED)), ASSUMED)
    assert np.abs(before).max() > 0.5
    assert np.abs(after).max() < 0.01


def test_a_line_cannot_straighten_a_pulse_that_is_too_short_for_its_edges():
    """With the thesis' pulse of 180 ns, 126 ns are straight within 5 mV of 1 V (N-K-048): decimetres are left."""
    assert np.abs(biases_m(SHORT, fit_range(planes_of(SHORT, KNOWN_M, {})), {})).max() > 0.1


@pytest.mark.parametrize("assumed", [{}, {"pulse_width_s": 174e-9, "laser_delay_s": 25e-9}])
def test_a_curve_straightens_the_pulse_of_the_thesis_to_less_than_a_centimetre(assumed):
    """K-CAL-03 with the 180 ns and the soft edges of the thesis, 2 to 20 m off 50 %."""
    planes = planes_of(SHORT, np.arange(2.0, 21.5), assumed)
    curve = fit_curve(planes)
    after = biases_m(SHORT, fit_range(planes, curve), assumed, curve)
    assert np.abs(after).max() < 0.01


def test_sigma_is_that_of_the_curve():
    """The spread of the ranges of 100 images is what sigma_m says, where the curve is steep and where it is not."""
    camera = replace(SHORT, frame_rate_hz=20.0, averages=1)
    planes = planes_of(SHORT, np.arange(2.0, 21.5), {})
    known = replace(camera, range_curve_m=fit_curve(planes))
    for range_m in (3.0, 10.0, 20.0):
        images = [RANGING["mdsi3"](shoot(range_m, camera, [5, i]), known) for i in range(100)]
        spread = np.std([image.range_m for image in images], axis=0)
        assert np.median(spread / images[0].sigma_m) == pytest.approx(1.0, abs=0.05)


def test_the_line_of_the_ideal_quotient_is_that_of_the_thesis():
    """N-K-051: slope -0.03704 1/m and intercept 1 of U_a / (U_a + U_b), from slope and intercept of the range."""
    ideal = replace(SOFT, pulse_rise_s=0.0, pulse_fall_s=0.0, shutter_edge_s=0.0, pulse_width_s=180e-9,
                    shutter_a_width_s=None, shutter_b_width_s=None, laser_delay_s=0.0)  # fmt: skip
    slope, intercept_m = fit_range(planes_of(ideal, KNOWN_M, {}))
    np.testing.assert_allclose(-1 / slope / 27.0, -0.03704, rtol=5e-3)
    np.testing.assert_allclose(1 + intercept_m / slope / 27.0, 1.0, atol=2e-3)


def image_of(range_m, valid=True, sigma_m=0.1):
    plane = np.array([[range_m, range_m]], np.float32)
    why = np.array([[0, 0 if valid else int(Why.SATURATED)]], np.uint8)
    return RangeImage(0.0, plane, np.full((1, 2), sigma_m, np.float32), plane, why)


def targets(images, known_m):
    return [mean_plane([image], known) for image, known in zip(images, known_m, strict=True)]


def test_the_fit_weighs_what_it_sees_and_leaves_invalid_pixels_out():
    images = [image_of(2.0), image_of(4.5), image_of(7.0), image_of(30.0, valid=False, sigma_m=1e6)]
    slope, intercept_m = fit_range(targets(images, [1.0, 2.0, 3.0, 4.0])[:3])
    np.testing.assert_allclose(slope, 0.4, rtol=1e-6)
    np.testing.assert_allclose(intercept_m, 0.2, atol=1e-6)
    with_bad = fit_range(targets(images, [1.0, 2.0, 3.0, 4.0]))
    assert with_bad.slope[0, 1] == pytest.approx(0.4, rel=1e-6)


def test_a_pixel_that_is_mostly_invalid_counts_nothing():
    """Which of its values are missing depends on their noise."""
    good, bad = image_of(2.0), image_of(2.0, valid=False)
    assert (mean_plane([good, bad], 1.0).weight > 0).all()
    assert mean_plane([good, bad, bad], 1.0).weight.tolist() == [[pytest.approx(300.0), 0.0]]
    with pytest.raises(DataError, match="no images of the target"):
        mean_plane([], 1.0)


@pytest.mark.parametrize(
    ("images", "known_m"),
    [
        ([image_of(2.0), image_of(4.0, valid=False)], [1.0, 2.0]),
        ([image_of(2.0), image_of(4.0)], [1.0, 1.0]),
        ([image_of(4.0), image_of(2.0)], [1.0, 2.0]),
    ],
)
def test_a_pixel_without_a_line_is_named(images, known_m):
    with pytest.raises(DataError, match="pixels, the first in row 0, column"):
        fit_range(targets(images, known_m))


def bent(slope_of, known_m):
    return targets([image_of(slope_of(r)) for r in known_m], known_m)


def test_a_curve_inverts_a_smooth_measured_range():
    """A cubic is followed exactly, wherever the planes stand."""
    known = np.array([1.0, 2.0, 4.0, 7.0, 11.0, 16.0])
    curve = np.array(fit_curve(bent(lambda r: r + 0.01 * (r - 8) ** 2 - 0.001 * (r - 8) ** 3, known)))
    measured, true = curve[1:-1].T
    np.testing.assert_allclose(measured, true + 0.01 * (true - 8) ** 2 - 0.001 * (true - 8) ** 3, atol=1e-5)
    assert true[[0, -1]].tolist() == [1.0, 16.0]
    assert curve[[0, -1], 1].tolist() == [0.5, 18.5]  # straight on, half the way to the next plane
    slope = 1 + 0.02 * (16 - 8) - 0.003 * (16 - 8) ** 2
    assert (curve[-1, 0] - measured[-1]) / 2.5 == pytest.approx(slope, abs=1e-4)


def test_a_curve_ends_where_the_measured_range_stops_growing():
    """Where the pulse lies within one window the quotient says nothing."""
    known = np.arange(1.0, 21.0)
    curve = np.array(fit_curve(bent(lambda r: np.log1p(np.exp(r - 8)), known)))
    assert curve[0, 1] == pytest.approx(8 - np.log(4), abs=0.2)  # where the slope is 0.2
    assert curve[-1, 1] == 20.5
    with pytest.raises(DataError, match=r"does not grow by 0\.2 m"):
        fit_curve(bent(lambda r: 5.0 - 0.1 * r, known))
    with pytest.raises(DataError, match="a curve needs at least 4"):
        fit_curve(bent(lambda r: r, known[:3]))


def test_ranges_beyond_the_curve_and_beyond_the_limits_are_marked():
    curve = ((1.0, 2.0), (5.0, 6.0), (9.0, 14.0))
    camera = replace(CAMERA, pixel=Pixel(), range_curve_m=curve, offset_m=0.25, min_range_m=3.5, max_range_m=10.5)
    got = {r: RANGING["mdsi3"](shoot(r, camera, 1), camera) for r in (0.9, 2.0, 4.0, 7.0, 8.0, 9.5)}
    assert {r: int(np.bincount(image.why.ravel()).argmax()) for r, image in got.items()} == {
        0.9: Why.SATURATED, 2.0: Why.OUT_OF_RANGE, 4.0: 0, 7.0: 0, 8.0: Why.OUT_OF_RANGE, 9.5: Why.OUT_OF_RANGE
    }  # fmt: skip
    assert np.median(got[4.0].range_m) == pytest.approx(5.25, abs=0.03)
    assert np.median(got[7.0].range_m) == pytest.approx(10.0 + 0.25, abs=0.1)
    for wrong in (((1.0, 2.0),), ((1.0, 2.0), (1.0, 3.0)), ((1.0, 2.0), (2.0, 1.0))):
        with pytest.raises(UsageError, match="range_curve_m: needs two or more points"):
            RANGING["mdsi3"](shoot(4.0, camera, 1), replace(camera, range_curve_m=wrong))


def test_slope_and_intercept_change_range_and_sigma_of_every_method():
    shape = (2, 3)
    slope, intercept_m = np.full(shape, 1.25), np.full(shape, -0.5)
    shutters = {"mdsi3": "ab", "gradient1": "aa", "csi": "a_delayed"}
    for method, taken in shutters.items():
        camera = replace(CAMERA, shutters=taken, rows=2, columns=3, frame_rate_hz=1.0, pixel=Pixel())
        raw = shoot(9.0, camera, 1)
        image = RANGING[method](raw, camera)
        line = calibration_of(camera, Line(slope, intercept_m))
        got = RANGING[method](attach(raw, line), camera)
        np.testing.assert_allclose(got.range_m, 1.25 * image.range_m - 0.5, rtol=1e-6)
        np.testing.assert_allclose(got.sigma_m, 1.25 * image.sigma_m, rtol=1e-6)
        np.testing.assert_array_equal(got.why, image.why)


# --- what is refused ---------------------------------------------------------------------------------------------


def frame(n_acc, **planes):
    return RawFrame(0.0, {"n_acc": np.asarray(n_acc), **planes}, 3)


def test_frames_that_are_no_dark_frames_are_refused():
    plane = np.zeros((1, 2))
    with pytest.raises(DataError, match="no dark frames"):
        estimate_dark([], "shutter_")
    with pytest.raises(DataError, match=r"needs shutter_\* planes"):
        estimate_dark([frame([[1, 1]])], "shutter_")
    with pytest.raises(DataError, match=r"needs shutter_a planes of the same shape"):
        estimate_dark([frame([[1, 1]], shutter_a=plane), frame([[1]], shutter_a=plane[:, :1])], "shutter_")
    with pytest.raises(DataError, match="n_acc = 1, 4"):
        estimate_dark([frame([[1, 4]], shutter_a=plane)], "shutter_")
    assert estimate_dark([RawFrame(0.0, {"phase_0": plane})], "phase_").accumulations.tolist() == [1]


def test_frames_that_the_calibration_does_not_fit_are_refused():
    planes = {"range_slope": np.ones((1, 2))}
    calibration = Calibration({}, {}, {}, planes, np.array([1, 16]), {"offset_a": np.zeros((2, 1, 2))})
    with pytest.raises(DataError, match=r"shape \(1, 3\)"):
        attach(frame([[1, 1, 1]]), calibration)
    with pytest.raises(DataError, match="no dark image for n_acc = 4; it has 1, 16"):
        attach(frame([[1, 4]]), calibration)
    with pytest.raises(DataError, match="no dark image for n_acc = 100"):
        attach(frame([[1, 100]]), calibration)
    assert attach(frame([[0, 16]]), calibration).planes["offset_a"].shape == (1, 2)
    assert "range_slope" in attach(RawFrame(0.0, {"shutter_a": np.zeros((1, 2))}), calibration).planes


def test_a_calibration_plane_of_another_shape_is_named():
    camera = replace(CAMERA, rows=1, columns=2)
    raw = attach(shoot(9.0, camera, 1), calibration_of(camera, unit_line(camera)))
    for name in ("offset_a", "range_intercept_m"):
        with pytest.raises(DataError, match=f"'{name}' has shape"):
            RANGING["mdsi3"](replace(raw, planes={**raw.planes, name: np.zeros((3, 3))}), camera)
    without = {name: plane for name, plane in raw.planes.items() if name != "range_intercept_m"}
    with pytest.raises(DataError, match="'range_intercept_m' has shape"):
        RANGING["mdsi3"](replace(raw, planes=without), camera)


# --- the file ----------------------------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path, offsets):
    path = tmp_path / "camera.npz"
    settings, taken = {"range_curve_m": [[1.0, 1.1], [20.0, 20.5]], "pixel": {"damping": 0.02}}, {"temperature_c": 31.0}
    save_calibration(path, replace(offsets, settings=settings, taken=taken))
    return path


def test_a_calibration_survives_its_file(saved, offsets):
    """K-CAL-05."""
    loaded = load_calibration(saved)
    check_made_for(saved, loaded, made_for(CAMERA, "mdsi3"))
    assert loaded.settings == {"range_curve_m": [[1.0, 1.1], [20.0, 20.5]], "pixel": {"damping": 0.02}}
    assert loaded.taken == {"temperature_c": 31.0}
    np.testing.assert_array_equal(loaded.accumulations, offsets.accumulations)
    assert loaded.names == {"offset_a", "offset_b", "range_slope", "range_intercept_m"}
    for kind in ("planes", "stepped"):
        for name, image in getattr(offsets, kind).items():
            np.testing.assert_array_equal(getattr(loaded, kind)[name], image)
    assert [p.name for p in saved.parent.iterdir()] == ["camera.npz"]


@pytest.mark.parametrize(
    ("change", "method", "named"),
    [
        ({"pulse_width_s": 100e-9}, "mdsi3", "pulse_width_s = 1.8e-07, but here pulse_width_s = 1e-07"),
        ({"shutters": "abc"}, "mdsi3", "shutters = ab, but here shutters = abc"),
        ({"rows": 4}, "mdsi3", "rows = 8"),
        ({}, "mdsi4", "method = mdsi3, but here method = mdsi4"),
    ],
)
def test_a_calibration_of_another_camera_is_refused_by_what_differs(saved, change, method, named):
    with pytest.raises(UsageError, match=named):
        check_made_for(saved, load_calibration(saved), made_for(replace(CAMERA, **change), method))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"format": 1}, "format 1; this version reads 2"),
        ({"format": None}, "not a calibration"),
        ({"made_for": "{"}, "not a calibration"),
        ({"settings": None}, "not a calibration"),
        ({"taken": "[1]"}, r"taken holds \[1\]; it must be a table"),
        ({"accumulations": np.array([4, 1, 16, 64, 100])}, "increasing whole numbers"),
        ({"accumulations": np.array([1, 4])}, "offset_a has shape"),
        ({"accumulations": None}, "offset_a has shape"),
        ({"plane_range_intercept_m": np.zeros((2, 2))}, "range_intercept_m has shape"),
        ({"plane_range_slope": np.full((8, 64), np.nan)}, "range_slope must hold finite numbers"),
        ({"plane_range_slope": np.zeros((8, 64), int)}, "range_slope must hold finite numbers"),
    ],
)
def test_a_file_at_fault_is_named_with_its_fault(saved, change, named):
    with np.load(saved) as file:
        arrays = {key: file[key] for key in file.files}
    arrays = {key: value for key, value in {**arrays, **change}.items() if value is not None}
    np.savez(saved, **arrays)
    with pytest.raises(DataError, match=named):
        load_calibration(saved)


def test_what_is_no_file_or_no_archive_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no such file"):
        load_calibration(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text(json.dumps({}))
    with pytest.raises(DataError, match="not a NumPy archive"):
        load_calibration(tmp_path / "text.npz")


# --- through the source ------------------------------------------------------------------------------------------

SCENE, CW_SCENE = "scenario:approach-box", "scenario:approach-box"


def first(url, *layers):
    source = open_source(url, layers=layers)
    return source, next(iter(source.captures)).raw


@pytest.fixture
def made(tmp_path):
    """A calibration of the camera of the scene with offsets, a line, a curve and a noise parameter."""
    path = tmp_path / "camera.npz"
    camera = open_source(SCENE, preset="usercams").config.camera
    dark = {name: np.full((5, 8, 64), 0.01) for name in ("shutter_a", "shutter_b")}
    calibration = calibration_of(camera, Line(np.ones((8, 64)), np.full((8, 64), 0.5)), dark)
    settings = {"range_curve_m": [[0.0, 0.0], [30.0, 30.0]], "pixel": {"sensor_noise_v": 0.5e-3}}
    save_calibration(path, replace(calibration, settings=settings, taken={"temperature_c": 12.0}))
    return path, {"preset": "usercams", "camera": {"calibration": str(path)}}


def test_a_source_carries_the_calibration_of_its_camera_and_a_recording_keeps_it(tmp_path, made):
    (path, layer), target = made, tmp_path / "run.mcap"
    source, raw = first(SCENE, layer)
    assert raw.planes["offset_b"] == pytest.approx(0.01)
    assert source.config.camera.range_curve_m == ((0.0, 0.0), (30.0, 30.0))
    assert source.config.camera.pixel.sensor_noise_v == 0.5e-3
    assert source.config.camera.pixel.damping == 0.0153
    with Recorder(target, source.config, source.name) as recorder:
        recorder.write(next(iter(source.captures)))
    path.unlink()
    replay, replayed = first(target)
    assert replay.config == source.config
    for name, plane in raw.planes.items():
        np.testing.assert_array_equal(replayed.planes[name], plane)
    assert "range_slope" not in first(SCENE, {"preset": "usercams"})[1].planes
    with pytest.raises(UsageError, match="no such file"):
        open_source(SCENE, layers=[layer])


def test_settings_of_a_calibration_lie_over_the_preset_and_under_those_of_the_user(made):
    _, layer = made
    source, _ = first(SCENE, layer, {"camera": {"pixel": {"sensor_noise_v": 0.7e-3}}})
    assert source.config.camera.pixel.sensor_noise_v == 0.7e-3
    assert any("camera.pixel is not that of the calibration" in note for note in source.notes)
    ready = open_source(SCENE, config=open_source(SCENE, layers=[layer]).config)
    assert not any("is not that" in note for note in ready.notes)
    np.testing.assert_array_equal(next(iter(ready.captures)).raw.planes["offset_a"], np.float32(0.01))


def test_a_recorded_calibration_is_used_for_its_method_only_and_can_be_left_out(tmp_path, made):
    (_, layer), target = made, tmp_path / "run.mcap"
    source, _ = first(SCENE, layer)
    with Recorder(target, source.config, source.name) as recorder:
        recorder.write(next(iter(source.captures)))
    with pytest.raises(UsageError, match=r"method = mdsi3, but here method = mdsi4"):
        open_source(target, layers=[{"ranging": "mdsi4"}])
    bare, raw = first(target, {"ranging": "mdsi4", "camera": {"calibration": "", "range_curve_m": []}})
    assert {"shutter_a", "shutter_b", "n_acc"} <= {*raw.planes}
    assert not {name for name in raw.planes if name.startswith(("offset_", "range_"))}
    assert any("is not used" in note for note in bare.notes)


@pytest.mark.parametrize(("now_c", "notes"), [(12.0, 0), (21.9, 0), (22.0, 1), (2.0, 1), (60.0, 2)])
def test_a_calibration_of_another_temperature_asks_to_be_taken_again(made, now_c, notes):
    """K-CAL-02: 10 K; and the camera of the thesis works from 0 to 50 C."""
    source = open_source(SCENE, layers=[made[1], {"camera": {"temperature_c": now_c}}])
    assert sum("calibrate again" in note or "outside of 0 to 50" in note for note in source.notes) == notes


def test_the_offset_of_each_pixel_of_a_continuous_wave_camera_is_taken_off(tmp_path):
    """A fixed pattern of the phase: what is left is less than a tenth of a millimetre, and ranges wrap."""
    path, layer = tmp_path / "cw.npz", {"preset": "scaled_car"}
    source, raw = first(CW_SCENE, layer)
    camera = source.config.camera
    pattern_m = np.random.default_rng(1).normal(0.0, 0.1, raw.shape)
    pattern_m[0, 0] = 8.0
    facts = cw.made_for(camera, source.config.ranging)
    save_calibration(path, Calibration(facts, planes={"range_offset_m": pattern_m}))
    calibrated_source, with_plane = first(CW_SCENE, layer, {"camera": {"calibration": str(path)}})
    bare = cw.RANGING[source.config.ranging](raw, camera)
    image = cw.RANGING[source.config.ranging](with_plane, calibrated_source.config.camera)
    unambiguous_m = 2 * np.pi * cw.signal.metres_per_radian(camera)
    expected = np.mod(bare.range_m - pattern_m, unambiguous_m)
    ok = image.valid & (expected > 1e-3) & (expected < unambiguous_m - 1e-3)
    np.testing.assert_allclose(image.range_m[ok], expected[ok], atol=1e-5)
    with pytest.raises(UsageError, match="kind = cw, but here kind = pulsed"):
        first(SCENE, {"preset": "usercams", "camera": {"calibration": str(path)}})
    wrong = replace(with_plane, planes={**with_plane.planes, "range_offset_m": np.zeros((2, 2))})
    with pytest.raises(DataError, match="'range_offset_m' has shape"):
        cw.RANGING[source.config.ranging](wrong, camera)
