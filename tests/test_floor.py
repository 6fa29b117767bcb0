"""However the floor is known: it goes, and what stands on it stays."""

import numpy as np
import pytest

from rangecam.clean import CleanSettings, clean
from rangecam.errors import DataError, UsageError
from rangecam.geometry import Lens, Mounting, rays, rotation, to_world
from rangecam.types import RangeImage, Why

LENS = Lens(horizontal_fov_deg=60)
TILTED = Mounting(x_m=0.5, z_m=1.2, pitch_deg=25, roll_deg=3)
SHAPE = (60, 80)
FLOORS = pytest.mark.parametrize("floor", ["mounting", "fit", "image"])


def view(seed=0, box=True, sigma_m=0.02):
    """Return a noisy image of the floor and of a box of 0.6 m height on it at 3 m, and which pixels see the box."""
    ray = rays(LENS, SHAPE) @ rotation(TILTED).T
    with np.errstate(divide="ignore"):
        floor = np.where(ray[..., 2] < 0, -1.2 / ray[..., 2], np.inf)
    front = (3.0 - 0.5) / ray[..., 0]
    y, z = front * ray[..., 1], 1.2 + front * ray[..., 2]
    on_box = (np.abs(y) < 0.4) & (z > 0) & (z < 0.6) & box
    range_m = np.where(on_box, front, floor)
    hit = range_m < 12
    noise = sigma_m * np.random.default_rng(seed).standard_normal(SHAPE)
    plane = (np.where(hit, range_m, np.nan) + noise).astype(np.float32)
    ones = np.ones(SHAPE, np.float32)
    return RangeImage(0.0, plane, sigma_m * ones, 50 * ones, np.where(hit, 0, Why.NO_SIGNAL).astype(np.uint8)), on_box


def stored(tmp_path, frames=9, **arrays):
    images = [view(seed=100 + k, box=False)[0] for k in range(frames)]
    whole = {"range_m": np.stack([one.range_m for one in images]), "why": np.stack([one.why for one in images])}
    np.savez(tmp_path / "floor.npz", **{**whole, **arrays})
    return str(tmp_path / "floor.npz")


def settings(floor, path, **changes):
    return CleanSettings(floor=floor, floor_file=path, min_neighbours=0, filter="off", **changes)


@FLOORS
@pytest.mark.parametrize("sigma_m", [0.005, 0.02, 0.05])
def test_the_floor_goes_and_a_box_on_it_stays_but_for_its_lowest_part(floor, sigma_m, tmp_path):
    source, on_box = view(sigma_m=sigma_m)
    cleaned = clean(source, LENS, TILTED, settings(floor, stored(tmp_path)))
    height = to_world(source, LENS, TILTED)[..., 2]
    ground = source.valid & ~on_box
    assert np.mean(cleaned.why[ground] == Why.FLOOR) > 0.985
    upper = on_box & (height > 0.1 + 4 * sigma_m)
    assert upper.sum() > 100
    assert cleaned.valid[upper].mean() > 0.985


@FLOORS
def test_the_margin_grows_with_sigma_as_it_says(floor, tmp_path):
    source, _ = view(sigma_m=0.1, box=False)
    path = stored(tmp_path)
    kept = [
        clean(source, LENS, TILTED, settings(floor, path, floor_margin_m=0.0, floor_margin_sigmas=n)).valid.mean()
        for n in (0.0, 1.0, 3.0)
    ]
    assert kept[0] > 0.2
    assert kept[1] == pytest.approx(0.16 * source.valid.mean(), abs=0.05)
    assert kept[2] < 0.01


def test_a_stored_floor_removes_a_wall_that_was_there_too_and_keeps_what_stands_before_it(tmp_path):
    wall = (4.0 / rays(LENS, SHAPE)[..., 0]).astype(np.float32)
    path = stored(tmp_path, range_m=wall[None], why=np.zeros((1, *SHAPE), np.uint8))
    ones = np.ones(SHAPE, np.float32)
    before = wall.copy()
    before[20:40, 30:50] -= 0.5
    source = RangeImage(0.0, before, 0.01 * ones, ones, np.zeros(SHAPE, np.uint8))
    cleaned = clean(source, LENS, Mounting(), settings("image", path))
    assert cleaned.valid[20:40, 30:50].all()
    assert cleaned.valid.sum() == 400


def test_pixels_that_saw_no_floor_have_none(tmp_path):
    why = np.full((3, *SHAPE), Why.NO_SIGNAL, np.uint8)
    why[0] = Why.VALID  # in less than half of the images
    path = stored(tmp_path, range_m=np.ones((3, *SHAPE), np.float32), why=why)
    source, _ = view()
    assert np.array_equal(clean(source, LENS, TILTED, settings("image", path)).valid, source.valid)


def test_pixels_that_were_refused_as_floor_saw_it(tmp_path):
    path = stored(tmp_path)
    file = dict(np.load(path))
    file["why"][file["why"] == 0] = Why.FLOOR
    other = tmp_path / "other.npz"
    np.savez(other, **file)
    source, _ = view()
    one, two = (clean(source, LENS, TILTED, settings("image", str(name))) for name in (path, other))
    assert np.array_equal(one.why, two.why)


@pytest.mark.parametrize(
    ("arrays", "error", "match"),
    [
        ({"range_m": np.ones((2, 4, 5)), "why": np.zeros((2, 4, 5), np.uint8)}, UsageError, "the camera has"),
        ({"why": np.zeros((2, 4, 5), np.uint8)}, DataError, "must be images"),
    ],
)
def test_files_of_another_camera_are_refused(tmp_path, arrays, error, match):
    with pytest.raises(error, match=match):
        clean(view()[0], LENS, TILTED, settings("image", stored(tmp_path, **arrays)))


def test_files_that_are_missing_or_garbage_are_refused(tmp_path):
    with pytest.raises(UsageError, match="there is no such file"):
        clean(view()[0], LENS, TILTED, settings("image", str(tmp_path / "none.npz")))
    (tmp_path / "bad.npz").write_bytes(b"rubbish")
    with pytest.raises(DataError, match="no archive at all"):
        clean(view()[0], LENS, TILTED, settings("image", str(tmp_path / "bad.npz")))
