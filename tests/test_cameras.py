"""Claims about the cameras that yield captures."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from rangecam.cameras import CAMERAS, open_camera
from rangecam.cameras.simulated import SIMULATE, frames
from rangecam.config import FAMILIES, load_config, preset_names
from rangecam.errors import UsageError
from rangecam.pipeline import RANGING
from rangecam.scene.paths import EgoMotion, Path
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, SceneObject

WALL = SceneObject(
    name="wall",
    boxes=(Box(center_m=(0.5, 0.0, 0.0), size_m=(1.0, 50.0, 50.0), reflectivity=0.8),),
    path=Path(start_m=(3.0, 0.0, 0.0)),
)


def world(**settings):
    fields = {"name": "t", "description": "", "preset": "scaled_car", "duration_s": 0.2, "objects": (WALL,)}
    return Scenario(**{**fields, **settings})


def small(preset, **camera):
    """A configuration with an image of 8 by 12 pixels that looks straight ahead."""
    ahead = {"x_m": 0.0, "z_m": 1.0, "pitch_deg": 0.0, "yaw_deg": 0.0, "roll_deg": 0.0}
    return load_config(preset, {"camera": {"rows": 8, "columns": 12, **camera}, "mounting": ahead})


def same(one, other):
    return all(np.array_equal(one.raw.planes[name], other.raw.planes[name]) for name in one.raw.planes)


@pytest.mark.parametrize("name", sorted(CAMERAS))
def test_every_camera_of_the_registry_can_be_opened(name):
    assert callable(open_camera(name))


def test_an_unknown_camera_is_refused_with_the_nearest_name():
    with pytest.raises(UsageError, match=r"unknown camera 'simulate'; did you mean 'simulated'\?; cameras: simulated"):
        open_camera("simulate")


def test_every_family_of_cameras_can_be_simulated():
    assert set(SIMULATE) == set(FAMILIES)


@pytest.mark.parametrize("preset", preset_names())
def test_the_simulated_camera_of_every_preset_ranges_a_wall_where_it_is(preset):
    config = small(preset, frame_rate_hz=3.0)
    distance_m = 2.0 if config.camera.kind == "pulsed" else 1.0
    near = replace(WALL, reflectivity_factor=0.5, path=Path(start_m=(distance_m, 0.0, 0.0)))
    captures = list(islice(frames(world(objects=(near,), duration_s=1.0), config), 3))
    assert len(captures) == 3
    for capture in captures:
        image = RANGING[config.ranging](capture.raw, config.camera)
        assert capture.raw.shape == image.shape == capture.truth.range_m.shape == (8, 12)
        assert image.valid.mean() > 0.5
        error = (image.range_m - capture.truth.range_m)[image.valid]
        # the phasor filter averages over pixels of this coarse image that lie apart
        assert abs(np.median(error)) < np.median(image.sigma_m[image.valid]) + 0.005
        assert np.abs(error).mean() < 0.2


def test_frame_k_comes_at_k_over_the_frame_rate_with_the_truth_and_the_ego_of_that_time():
    moving = world(ego=EgoMotion(speed_mps=4.0), ambient_wpm2=1.0)
    config = small("scaled_car")
    captures = list(frames(moving, config))
    assert [capture.raw.frame_id for capture in captures] == list(range(6))  # 0.2 s at 30 Hz
    for k, capture in enumerate(captures):
        assert capture.raw.time_s == capture.ego.time_s == pytest.approx(k / 30)
        assert capture.ego.speed_mps == pytest.approx(4.0)
        assert capture.truth.positions_m[0, 0] == pytest.approx(3.0 - 4 * k / 30)


def test_the_scenario_may_set_the_frame_rate():
    captures = list(frames(world(frame_rate_hz=10.0), small("scaled_car")))
    assert [capture.raw.time_s for capture in captures] == pytest.approx([0.0, 0.1])


def test_a_scenario_shorter_than_a_frame_has_one():
    assert len(list(frames(world(duration_s=1e-3), small("scaled_car")))) == 1


@pytest.mark.parametrize("preset", ["scaled_car", "usercams"])
def test_the_seed_and_the_number_of_the_frame_alone_make_the_noise(preset):
    config = small(preset)
    one, again, other = (list(frames(world(), config, seed)) for seed in (3, 3, 4))
    assert all(same(a, b) for a, b in zip(one, again, strict=True))
    assert not same(one[0], other[0])
    assert not same(one[0], one[1])
    shorter = list(frames(world(duration_s=0.07), config, 3))
    assert same(shorter[1], one[1])


def test_more_rays_per_pixel_mix_the_ranges_at_an_edge():
    column = replace(WALL, boxes=(Box(center_m=(0.5, 0.0, 0.0), size_m=(1.0, 0.2, 50.0)),))
    config = small("scaled_car")
    near, far = replace(column, name="post", path=Path(start_m=(1.0, 0.05, 0.0))), WALL
    spreads = []
    for subpixels in (1, 5):
        capture = next(frames(world(objects=(near, far), subpixels=subpixels), config))
        image = RANGING[config.ranging](capture.raw, config.camera)
        z = (image.range_m - capture.truth.range_m)[image.valid] / image.sigma_m[image.valid]
        spreads.append(np.abs(z).max())
    assert spreads[0] < 5
    assert spreads[1] > 10
