"""Several exposures merged: what each pixel gets from which."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from rangecam import cw
from rangecam.config import load_config
from rangecam.errors import DataError, UsageError
from rangecam.hdr import exposures, merge, ranged
from rangecam.pipeline import RANGING, process_frame
from rangecam.scene.view import View
from rangecam.types import Ego, RangeImage, RawFrame, Tracks, Why


def image(range_m, sigma_m=0.1, amplitude=10.0, why=0):
    planes = np.broadcast_arrays(*(np.atleast_2d(np.asarray(p, float)) for p in (range_m, sigma_m, amplitude, why)))
    return RangeImage(1.0, *(plane.astype(np.float32) for plane in planes[:3]), planes[3].astype(np.uint8))


def test_pixels_valid_in_both_exposures_have_the_variance_of_the_weighted_mean():
    rng = np.random.default_rng(0)
    truth, noise = np.full((200, 200), 3.0), rng.standard_normal((2, 200, 200))
    merged = merge([image(truth + 0.3 * noise[0], 0.3), image(truth + 0.1 * noise[1], 0.1)], [1e-3, 4e-3])
    expected = 1 / np.sqrt(1 / 0.3**2 + 1 / 0.1**2)
    assert merged.sigma_m[0, 0] == pytest.approx(expected)
    assert (merged.range_m - truth).std() == pytest.approx(expected, rel=0.02)
    assert abs((merged.range_m - truth).mean()) < 4 * expected / 200


def test_a_saturated_pixel_comes_from_the_short_exposure_and_a_dark_one_from_the_long():
    short = image([[2.0, 3.0, 5.0, 1.0]], 0.2, [[40.0, 2.0, 1.0, 9.0]], [[0, Why.LOW_AMPLITUDE, Why.LOW_AMPLITUDE, 4]])
    long = image([[2.2, 3.1, 5.5, 1.0]], 0.1, [[99.0, 20.0, 2.0, 99.0]], [[Why.SATURATED, 0, Why.LOW_AMPLITUDE, 4]])
    for images, times_s in (([short, long], [1e-4, 1e-3]), ([long, short], [1e-3, 1e-4])):
        merged = merge(images, times_s)
        assert_array_equal(merged.why, [[0, 0, Why.LOW_AMPLITUDE, Why.SATURATED]])
        np.testing.assert_allclose(merged.range_m[0, :2], [2.0, 3.1], rtol=1e-6)
        np.testing.assert_allclose(merged.sigma_m[0, :2], [0.2, 0.1], rtol=1e-6)
        np.testing.assert_allclose(merged.amplitude[0, :2], [400.0, 20.0], rtol=1e-6)


def test_exposures_that_contradict_each_other_leave_the_surer_one():
    merged = merge([image(2.0, 0.2), image(4.0, 0.1)], [1e-4, 1e-3])
    assert merged.range_m[0, 0] == 4.0
    assert merged.sigma_m[0, 0] == pytest.approx(0.1)


def test_images_that_do_not_belong_together_are_refused():
    with pytest.raises(DataError, match="one or more images of one shape"):
        merge([image(np.ones((2, 2))), image(np.ones((2, 3)))], [1e-3, 2e-3])
    with pytest.raises(DataError, match="0 images"):
        merge([], [])


@pytest.mark.parametrize("name", ["phase_0", "exposure_0us_phase_0", "exposure_phase_0"])
def test_a_plane_of_no_exposure_is_named(name):
    with pytest.raises(DataError, match=f"plane '{name}' belongs to no exposure"):
        exposures(RawFrame(0.0, {"exposure_200us_phase_0": np.ones((1, 1)), name: np.ones((1, 1))}))


def test_two_exposures_see_the_bright_and_the_dark_half_of_a_scene_and_go_through_the_whole_chain():
    """White at 2 m beside a retro-reflector at 0.5 m: either exposure alone loses a half."""
    config = load_config("scaled_car", {"clean": {"floor": "off", "wrap_threshold": 0.0, "width_m": 9.0}})
    camera, shape = config.camera, (1, 120, 160)
    left = np.arange(160) < 80
    truth = np.where(left, 0.5, 2.0) * np.ones(shape)
    view = View(truth, np.where(left, 6.0, 0.9) * np.ones(shape), np.ones(shape))
    planes, alone = {}, []
    for k, (time_us, exposure_s) in enumerate(((40, 4e-5), (2000, 2e-3))):
        raw = cw.simulate(lambda at_s: view, replace(camera, illumination_time_s=exposure_s), 0.0,
                          np.random.default_rng(k))  # fmt: skip
        planes |= {f"exposure_{time_us}us_{name}": plane for name, plane in raw.planes.items()}
        alone.append(RANGING["cw_four_phase"](raw, camera).valid[30:90, 40:120].mean())
    merged = ranged(RANGING["cw_four_phase"], RawFrame(0.0, planes), camera)
    inside = merged.valid[30:90, 40:120]
    assert max(alone) < 0.6 < 0.95 < inside.mean()
    z = ((merged.range_m - truth[0]) / merged.sigma_m)[merged.valid]
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.68, abs=0.03)
    frame = process_frame(RawFrame(0.0, planes), Tracks.empty(), Ego(0.0), config)
    depth_m = np.sort(frame.segments.position_m[np.argsort(frame.segments.n_pixels)[-2:], 0])
    assert depth_m[0] < 0.55
    assert 1.3 < depth_m[1] < 2.05  # a sphere about the camera, as the field of view shows it


def test_planes_of_a_calibration_go_with_every_exposure():
    parts = exposures(
        RawFrame(0.0, {"exposure_100us_phase_0": np.ones((1, 1)), "exposure_2000us_phase_0": np.ones((1, 1)) * 2,
                       "range_offset_m": np.full((1, 1), 0.5)})
    )  # fmt: skip
    assert [set(part.planes) for part in parts.values()] == [{"phase_0", "range_offset_m"}] * 2


def test_the_simulated_camera_exposes_all_phases_at_each_illumination_time_one_after_the_other():
    camera = replace(load_config("scaled_car").camera, illumination_times_s=(1e-4, 2e-3), frame_rate_hz=10.0, rows=4,
                     columns=6, read_noise_lsb=0.0, shot_noise_lsb2_per_lsb=0.0)  # fmt: skip
    looked_at = []

    def view(at_s):
        looked_at.append(at_s)
        return View(np.full((1, 4, 6), 1.0), np.full((1, 4, 6), 0.5), np.ones((1, 4, 6)))

    raw = cw.simulate(view, camera, 5.0, np.random.default_rng(0))
    assert list(raw.planes)[:2] == ["exposure_100us_phase_0", "exposure_100us_phase_90"]
    assert len(raw.planes) == 8
    steps = np.diff(looked_at)
    np.testing.assert_allclose(steps[:3], 1e-4 + camera.readout_time_s, rtol=1e-6)
    np.testing.assert_allclose(steps[4:], 2e-3 + camera.readout_time_s, rtol=1e-6)
    np.testing.assert_allclose(steps[3], (1e-4 + 2e-3) / 2 + camera.readout_time_s, rtol=1e-6)
    begin = looked_at[0] - (1e-4 + camera.readout_time_s) / 2
    end = looked_at[-1] + (2e-3 + camera.readout_time_s) / 2
    assert (begin + end) / 2 == pytest.approx(5.0, abs=1e-9)
    weak, strong = (part.planes["phase_0"][2, 3] - 2048.0 for part in exposures(raw).values())
    assert strong == pytest.approx(20 * weak, abs=12)


@pytest.mark.parametrize("times_s", [(1e-3, 1.0001e-3), (1e-7, 1e-3)])
def test_illumination_times_that_make_the_same_planes_are_refused(times_s):
    camera = replace(load_config("scaled_car").camera, illumination_times_s=times_s)
    with pytest.raises(UsageError, match="different whole numbers of microseconds"):
        cw.simulate(lambda _: None, camera, 0.0, np.random.default_rng(0))


def test_a_frame_rate_that_two_exposures_do_not_leave_is_refused():
    camera = replace(load_config("scaled_car").camera, illumination_times_s=(1e-3, 4e-3))
    with pytest.raises(UsageError, match=r"8 exposures and read-outs leave no more than 33.51 Hz"):
        cw.simulate(lambda _: None, replace(camera, frame_rate_hz=40.0), 0.0, np.random.default_rng(0))


def test_a_recorded_scenario_of_two_exposures_is_replayed_as_it_was(tmp_path):
    from rangecam.cli import main

    sets = [f"--set=camera.{each}" for each in ("illumination_times_s=[1e-4,2e-3]", "rows=12", "columns=16")]
    out = tmp_path / "two.mcap"
    assert main(["simulate", "approach-box", "-o", str(out), *sets, "--set=camera.frame_rate_hz=5.0"]) == 0
    assert main(["run", str(out), "--images", str(tmp_path / "two.npz")]) == 0
    with np.load(tmp_path / "two.npz") as images:
        assert images["valid"].mean() > 0.02
