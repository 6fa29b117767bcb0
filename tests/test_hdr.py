"""Several exposures merged: what each pixel gets from which."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from rangecam import cw
from rangecam.config import load_config
from rangecam.errors import DataError
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
