"""What makes the simulation fast, beside the simple version of each: the same numbers."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rangecam.cw.camera import _read_out
from rangecam.cw.effects import Link, Taps
from rangecam.cw.link import transfer
from rangecam.cw.pixel import fixed_pattern, respond
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import sample_variance
from rangecam.geometry import Lens, Mounting
from rangecam.scene.paths import Path, Phase, Pose, WayPoint, motion, place_and_velocity, stands
from rangecam.scene.placed import BOX, CYLINDER, PLANE, placed
from rangecam.scene.render import RayBundle, ray_bundle, render
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, Cylinder, Rod, SceneObject
from rangecam.types import Floats
from rangecam.values import changed, record, value

LENS = Lens(horizontal_fov_deg=80.0, vertical_fov_deg=60.0, projection="equiangular")
ORIGIN = Pose(0.0, 0.0, 0.0, 0.0, 0.0)


def street(rng: np.random.Generator) -> Scenario:
    """Return a ground with things of every kind that rays can meet, in and out of sight."""
    things = []
    for k in range(12):
        x, y, z = rng.uniform((-2, -6, 0), (14, 6, 2))
        r, h = rng.uniform(0.05, 0.8, 2)
        box = Box(center_m=(x, y, z), size_m=(r, h, 2 * r), yaw_deg=rng.uniform(0, 360), reflectivity=rng.random())
        drum = Cylinder(base_m=(y + 5, x - 5, 0.0), radius_m=r, height_m=h, reflectivity=rng.random())
        bar = Rod(start_m=(z + 3, y, h), end_m=(x + 3, y + r, z), radius_m=r / 4, reflectivity=rng.random())
        things.append(SceneObject(name=f"thing {k}", boxes=(box,), cylinders=(drum,) * (k % 2), rods=(bar,) * (k % 3)))
    return Scenario(
        name="street", description="", preset="", duration_s=1.0, objects=tuple(things), ground_reflectivity=0.2
    )


def simply_cast(world: Scenario, bundle: RayBundle) -> tuple[Floats, Floats]:
    """Return range and reflectivity of each ray in order of the image: each ray, one after the other, with each shape.

    Of boxes, cylinders and the ground, in double precision; rods stay out.
    """
    shapes, _ = placed(world.objects, 0.0, ORIGIN, bundle.origin_m, world.ground_reflectivity)
    shapes = shapes[np.isin(shapes[:, 0], (BOX, CYLINDER, PLANE))]
    directions = bundle.directions[:, np.argsort(bundle.place)].T.astype(float)
    found = np.full((len(directions), 2), (math.inf, 0.0))
    for i, ray in enumerate(directions):
        for shape in shapes:
            away_m = _met(ray, shape)
            if away_m < found[i, 0]:
                found[i] = away_m, shape[9]
    return found[:, 0].reshape(bundle.shape), found[:, 1].reshape(bundle.shape)


def _met(ray: Floats, shape: Floats) -> float:
    centre, half = shape[1:4], shape[6:9]
    if shape[0] == PLANE:
        away_m = centre[2] / ray[2] if ray[2] < 0 else math.inf
        return away_m if away_m < half[0] else math.inf
    if shape[0] == BOX:
        turn = np.array([[shape[4], shape[5], 0], [-shape[5], shape[4], 0], [0, 0, 1]])
        o, d = -turn @ centre, turn @ ray
        sides = np.sort([(-half - o) / d, (half - o) / d], axis=0)
        enter, leave = sides[0].max(), sides[1].min()
    else:
        a, b = ray[0] ** 2 + ray[1] ** 2, centre[:2] @ ray[:2]
        square = b * b - a * (centre[:2] @ centre[:2] - half[0] ** 2)
        if square <= 0:
            return math.inf
        ends = np.sort([(centre[2] - half[2]) / ray[2], (centre[2] + half[2]) / ray[2]])
        enter = max((b - math.sqrt(square)) / a, ends[0])
        leave = min((b + math.sqrt(square)) / a, ends[1])
    return enter if 0 < enter <= leave else math.inf


@pytest.mark.parametrize(("shape", "subpixels"), [((15, 20), 2), ((8, 64), 1), ((9, 33), 3)])
def test_rays_in_runs_meet_what_each_ray_alone_meets(shape: tuple[int, int], subpixels: int) -> None:
    world = street(np.random.default_rng(7))
    world = replace(world, objects=tuple(replace(thing, rods=()) for thing in world.objects))
    bundle = ray_bundle(LENS, Mounting(z_m=0.8, pitch_deg=-3.0), shape, subpixels)
    seen, (range_m, reflectivity) = render(world, 0.0, bundle), simply_cast(world, bundle)
    same = np.isclose(seen.range_m, range_m, rtol=1e-4) & np.isclose(seen.reflectivity, reflectivity, atol=1e-6)
    assert np.isfinite(range_m).mean() > 0.4
    assert len(np.unique(reflectivity)) > 5
    assert same.mean() > 0.998  # but for rays along an edge, by the digits of single precision


@pytest.mark.parametrize(("shape", "subpixels"), [((120, 160), 2), ((9, 33), 3), ((1, 1), 1)])
def test_each_ray_belongs_to_one_run_that_its_cone_holds(shape: tuple[int, int], subpixels: int) -> None:
    bundle = ray_bundle(LENS, Mounting(), shape, subpixels)
    assert np.array_equal(np.sort(bundle.place), np.arange(np.prod(bundle.shape)))
    assert np.array_equal(bundle.runs[1:, 0], bundle.runs[:-1, 1])
    assert (bundle.runs[0, 0], bundle.runs[-1, 1]) == (0, bundle.place.size)
    for (first, last, in_row), cone in zip(bundle.runs, bundle.cones, strict=True):
        assert (cone[:3] @ bundle.directions[:, first:last]).min() >= cone[3]
        rows = bundle.place[first:last].reshape(-1, in_row)
        assert (np.diff(rows, axis=1) == 1).all()
        assert (rows[:, 0] // shape[1] == rows[:, -1] // shape[1]).all()


PATHS = (
    Path(start_m=(1.0, 2.0, 0.5)),
    Path(start_m=(1.0, 2.0, 0.5), velocity_mps=(1.0, -2.0, 0.0)),
    Path(
        velocity_mps=(1.0, 0.0, 0.0),
        phases=(Phase(duration_s=1.0), Phase(duration_s=2.0, acceleration_mps2=(1.0, -1.0, 0.0))),
    ),
    Path(
        waypoints=(WayPoint(time_s=0.5, position_m=(0.0, 0.0, 0.0)), WayPoint(time_s=2.0, position_m=(3.0, 1.0, 0.0)))
    ),
)


@pytest.mark.parametrize("path", PATHS)
@given(time_s=st.floats(-2.0, 6.0))
@hypothesis_settings(max_examples=30, deadline=None)
def test_plain_numbers_of_a_path_are_those_of_its_motion(path: Path, time_s: float) -> None:
    position_m, velocity_mps = place_and_velocity(path, time_s)
    of_motion = motion(path, time_s)
    assert np.array_equal(of_motion.position_m, position_m)
    assert np.array_equal(of_motion.velocity_mps, velocity_mps)


def test_only_what_has_no_velocity_stands() -> None:
    assert [stands(path) for path in PATHS] == [True, False, False, False]


def test_what_stands_is_placed_as_what_moves_is_at_the_same_place() -> None:
    box = Box(center_m=(0.2, 0.0, 0.3), size_m=(0.4, 0.6, 0.6))
    still = SceneObject(name="a", boxes=(box,), heading_deg=30.0, path=Path(start_m=(4.0, 1.0, 0.0)))
    moving = replace(still, path=Path(start_m=(3.0, 1.0, 0.0), velocity_mps=(1.0, 0.0, 0.0)))
    own = Pose(0.5, -0.2, 0.1, 1.0, 0.0)
    for ground in (None, 0.3):
        (one, ball), (other, its) = (placed((thing,), 1.0, own, np.zeros(3), ground) for thing in (still, moving))
        assert np.array_equal(one, other)
        assert np.array_equal(ball, its)


# -- samples of the continuous-wave camera ----------------------------------------------------------------------------


def simply_responded(light: Floats, camera: CwCamera) -> Floats:
    """Return samples on whole arrays, as the taps are described (S-EFF-02, S-EFF-03)."""
    signal, total = light
    single = camera.pixel == "single_ended"
    sample, full = signal + total if single else signal, camera.taps.full_well_lsb
    if full is not None:
        first, second = (sample, 0 * sample) if single else ((total + sample) / 2, (total - sample) / 2)
        taken = 0 if single else np.minimum(np.minimum(first, second), camera.taps.ambient_suppression_lsb)
        sample = np.minimum(first - taken, full) - np.minimum(second - taken, full)
        if camera.taps.saturated_reads_full_scale and camera.full_scale_lsb is not None:
            sample = np.where(np.maximum(first - taken, second - taken) > full, np.inf, sample)
    pattern = fixed_pattern(camera, (signal.shape[0], signal.shape[1]))
    result: Floats = sample * pattern.gain + pattern.offset_lsb + camera.black_level_lsb
    return result


@pytest.mark.parametrize("pixel", ["differential", "single_ended"])
@pytest.mark.parametrize("taps", [Taps(), Taps(full_well_lsb=60.0, ambient_suppression_lsb=30.0)])
@pytest.mark.parametrize("full_scale", [None, 4095.0])
def test_a_pixel_responds_as_its_taps_are_described(pixel: Any, taps: Taps, full_scale: float | None) -> None:
    camera = CwCamera(pixel=pixel, taps=taps, full_scale_lsb=full_scale, black_level_lsb=100.0)
    rng = np.random.default_rng(1)
    total = rng.uniform(0, 300, (6, 9)).astype(np.float32)
    light = np.stack([total * rng.uniform(-0.9, 0.9, total.shape).astype(np.float32), total])
    sample, collected = respond(light, camera)
    np.testing.assert_allclose(sample, simply_responded(light, camera), rtol=1e-6)
    assert np.array_equal(collected, light.sum(axis=0) if pixel == "single_ended" else light[1])


@pytest.mark.parametrize("step", [0.0, 0.25, 1.0, 4.0])
@pytest.mark.parametrize("limits", [(None, None), (0.0, 4095.0), (-20.0, 150.0)])
def test_the_converter_rounds_noisy_samples_to_its_step_within_its_limits(step: float, limits: Any) -> None:
    low, high = limits
    camera = CwCamera(
        quantisation_lsb=step, lower_limit_lsb=low, full_scale_lsb=high, region_of_interest=(1, 2, 4, 5), pseudo_rows=2
    )
    rng = np.random.default_rng(2)
    sample, light, deviates = rng.normal(0, 80, (3, 6, 9)).astype(np.float32)
    light = np.abs(light)
    expected = sample + deviates * np.sqrt(sample_variance(light, camera))
    outside = np.ones(sample.shape, bool)
    outside[1:5, 2:7] = False
    expected[outside] = camera.black_level_lsb
    expected = np.round(expected / step) * step if step else expected
    expected = np.clip(expected, -np.inf if low is None else low, np.inf if high is None else high)
    expected[:2] = 0
    found = _read_out(sample, light, deviates, camera)
    assert found.dtype == (np.uint16 if step >= 1 and low == 0 else np.float32)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_link_without_a_wrong_bit_leaves_every_sample() -> None:
    plane = np.random.default_rng(0).normal(500, 300, (8, 9)).astype(np.float32)
    assert np.array_equal(transfer(plane, Link(bit_error_probability=1e-12), np.random.default_rng(1)), plane)


# -- copies -----------------------------------------------------------------------------------------------------------


@value
class Two:
    """Two numbers."""

    one: int
    two: int = 2


def test_a_changed_copy_leaves_its_original_and_its_other_fields() -> None:
    before = Two(1)
    after = changed(before, one=3)
    assert (before.one, after.one, after.two) == (1, 3, 2)
    assert isinstance(after, Two)


def test_a_field_that_there_is_not_cannot_be_changed() -> None:
    with pytest.raises(TypeError, match="Two has no three"):
        changed(Two(1), three=3)


@record
class Pair:
    """Two numbers that compare."""

    one: float
    two: float = 2.0


def test_records_are_equal_by_their_fields_and_always_to_themselves() -> None:
    assert Pair(1.0) == Pair(1.0, 2.0)
    assert hash(Pair(1.0)) == hash(Pair(1.0, 2.0))
    assert Pair(1.0) != Pair(3.0)
    assert Pair(1.0) != (1.0, 2.0)
    nothing = Pair(math.nan)
    assert nothing == nothing


def test_values_are_equal_to_nothing_but_themselves() -> None:
    assert Two(1) != Two(1)
