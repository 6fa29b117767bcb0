"""The mounting of a camera from what it sees of the floor."""

import json

import numpy as np
import pytest

from rangecam.calibration import fit_mounting
from rangecam.cli import main
from rangecam.config import load_config, read_toml
from rangecam.errors import DataError
from rangecam.geometry import Lens, Mounting, rays, rotation
from rangecam.types import RangeImage, Why

LENS = Lens(horizontal_fov_deg=60)
TRUE = Mounting(x_m=0.4, z_m=1.3, pitch_deg=28, roll_deg=-4, yaw_deg=10)
ABOUT = Mounting(x_m=0.4, z_m=1.0, pitch_deg=20, yaw_deg=10)
SHAPE = (30, 40)


def floor_images(seed, boxes=True, frames=4, sigma_m=0.03, mounting=TRUE):
    """Yield images of a floor on which a box and a wall stand."""
    ray = rays(LENS, SHAPE) @ rotation(mounting).T
    with np.errstate(divide="ignore"):
        range_m = np.where(ray[..., 2] < 0, -mounting.z_m / ray[..., 2], np.inf)
    if boxes:
        for x, y_low, y_high, height in ((2.2, -0.4, 0.3, 0.7), (6.0, -9, 9, 3.0)):
            front = (x - mounting.x_m) / ray[..., 0]
            y, z = mounting.y_m + front * ray[..., 1], mounting.z_m + front * ray[..., 2]
            range_m = np.where((y > y_low) & (y < y_high) & (z < height), np.minimum(front, range_m), range_m)
    rng, hit, ones = np.random.default_rng(seed), range_m < 20, np.ones(SHAPE, np.float32)
    for _ in range(frames):
        noisy = (np.where(hit, range_m, np.nan) + sigma_m * rng.standard_normal(SHAPE)).astype(np.float32)
        yield RangeImage(0.0, noisy, sigma_m * ones, ones, np.where(hit, 0, Why.NO_SIGNAL).astype(np.uint8))


def off_in_sigmas(fit, true=TRUE):
    found = fit.mounting
    return [
        (found.z_m - true.z_m) / fit.sigma_height_m,
        (found.pitch_deg - true.pitch_deg) / fit.sigma_pitch_deg,
        (found.roll_deg - true.roll_deg) / fit.sigma_roll_deg,
    ]


def test_an_empty_floor_gives_height_pitch_and_roll_within_their_intervals():
    """Of 60 recordings 95 % intervals hold the truth about 57 times; fewer than 51 has a chance of 1 %."""
    inside = np.zeros(3)
    for seed in range(60):
        fit = fit_mounting(floor_images(seed, boxes=False), LENS, ABOUT, np.random.default_rng(seed))
        inside += np.abs(off_in_sigmas(fit)) < 1.96
    assert (inside >= 51).all()
    assert fit.sigma_height_m < 0.003
    assert fit.sigma_pitch_deg < 0.2


def test_what_stands_on_the_floor_hardly_moves_it():
    for seed in range(5):
        fit = fit_mounting(floor_images(seed), LENS, ABOUT, np.random.default_rng(seed))
        assert np.abs(off_in_sigmas(fit)).max() < 5
        assert fit.mounting.z_m == pytest.approx(1.3, abs=0.01)
        assert fit.mounting.pitch_deg == pytest.approx(28, abs=0.2)
        assert fit.mounting.roll_deg == pytest.approx(-4, abs=0.2)
        assert fit.pixels < 0.95 * fit.seen


def test_what_a_floor_does_not_show_stays_as_it_was():
    found = fit_mounting(floor_images(1), LENS, ABOUT, np.random.default_rng(1)).mounting
    assert (found.x_m, found.y_m, found.yaw_deg) == (ABOUT.x_m, ABOUT.y_m, ABOUT.yaw_deg)


def test_noise_that_was_stated_too_small_is_noticed():
    stated = [
        RangeImage(0.0, one.range_m, one.sigma_m / 3, one.amplitude, one.why) for one in floor_images(2, boxes=False)
    ]
    fit = fit_mounting(stated, LENS, ABOUT, np.random.default_rng(2))
    honest = fit_mounting(floor_images(2, boxes=False), LENS, ABOUT, np.random.default_rng(2))
    assert fit.sigma_height_m > 0.6 * honest.sigma_height_m


@pytest.mark.parametrize("reason", ["a wall", "nothing"])
def test_images_without_a_floor_are_refused(reason):
    image = next(iter(floor_images(3)))
    wall = (3.0 / rays(LENS, SHAPE)[..., 0]).astype(np.float32)
    why = image.why * 0 + (Why.NO_SIGNAL if reason == "nothing" else 0)
    with pytest.raises(DataError, match="no floor among"):
        fit_mounting(
            [RangeImage(0.0, wall, image.sigma_m, image.amplitude, why.astype(np.uint8))],
            LENS,
            Mounting(z_m=1.0),
            np.random.default_rng(3),
        )


@pytest.mark.parametrize("preset", ["generic_cw", "generic_range"])
def test_the_command_finds_the_mounting_of_a_simulated_camera(preset, tmp_path, capsys):
    scene = tmp_path / "floor.toml"
    scene.write_text(
        f'description = "a floor"\npreset = "{preset}"\nduration_s = 0.2\nground_reflectivity = 0.5\n[[objects]]\n'
        'name = "box"\npath.start_m = [1.6, 0.2, 0.2]\n'
        "boxes = [{ center_m = [0.0, 0.0, 0.0], size_m = [0.3, 0.3, 0.4], reflectivity = 0.5 }]\n"
    )
    true = {"z_m": 0.9, "pitch_deg": 40.0, "roll_deg": 2.0}
    recording, output = str(tmp_path / "floor.mcap"), tmp_path / "mounting.toml"
    small = ["--set", "camera.rows=40", "--set", "camera.columns=60"]
    mounted = [part for name, value in true.items() for part in ("--set", f"mounting.{name}={value}")]
    assert main(["simulate", str(scene), "-o", recording, *small, *mounted]) == 0
    guess = ["--set", "mounting.pitch_deg=30", "--set", "mounting.z_m=1", "--set", "mounting.roll_deg=0"]
    capsys.readouterr()
    assert main(["calibrate", "mounting", recording, "-o", str(output), "--json", *guess]) == 0
    said = json.loads(capsys.readouterr().out)
    found = load_config(preset, read_toml(output)).mounting
    assert found.z_m == pytest.approx(0.9, abs=0.02)
    assert found.pitch_deg == pytest.approx(40, abs=1.0)
    assert found.roll_deg == pytest.approx(2, abs=1.0)
    assert said["mounting"]["z_m"] == pytest.approx(found.z_m, rel=1e-4)
    assert main(["calibrate", "mounting", recording, "-o", str(output), *guess]) == 0
    assert "use it with --config" in capsys.readouterr().out
