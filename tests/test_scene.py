"""Claims about the simulated world: paths, shapes, rays and scenarios."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rangecam.config import load_config, preset_names
from rangecam.errors import UsageError
from rangecam.geometry import Lens, Mounting, rays
from rangecam.scene.bodies import CAR, PERSON
from rangecam.scene.paths import (
    EgoMotion,
    EgoPhase,
    Path,
    Phase,
    WayPoint,
    direction_rad,
    ego_pose,
    motion,
    travelled_m,
)
from rangecam.scene.render import GROUND, ego_at, ego_of, ray_bundle, render, truth
from rangecam.scene.scenario import Scenario, load_scenario, parse_scenario, scenario_names
from rangecam.scene.shapes import Box, Cylinder, Rod, SceneObject
from rangecam.scene.weather import Cloud, Weather, clouds

LENS, LEVEL, SHAPE = Lens(horizontal_fov_deg=60.0), Mounting(z_m=1.0), (12, 16)
NARROW = Lens(horizontal_fov_deg=1.0)


def scenario(*objects, **settings):
    return Scenario(name="test", description="", preset="scaled_car", duration_s=1.0, objects=objects, **settings)


def thing(*shapes, **settings):
    boxes = tuple(s for s in shapes if isinstance(s, Box))
    cylinders = tuple(s for s in shapes if isinstance(s, Cylinder))
    return SceneObject(name="thing", boxes=boxes, cylinders=cylinders, **settings)


def look(world, time_s=0.0, lens=LENS, mounting=LEVEL, shape=SHAPE, subpixels=1):
    return render(world, time_s, ray_bundle(lens, mounting, shape, subpixels))


# ---- paths


def test_phases_of_constant_acceleration_follow_the_laws_of_motion():
    phases = (Phase(duration_s=1.0), Phase(duration_s=2.0, acceleration_mps2=(-4.0, 0.5, 0.0)))
    path = Path(start_m=(5.0, 1.0, 0.0), velocity_mps=(10.0, 0.0, 0.0), phases=phases)
    for time_s in (-1.0, 0.0, 0.7, 1.0, 1.9, 3.0, 4.5):
        t, after = np.clip(time_s - 1, 0, 2), max(time_s - 3, 0)
        here = motion(path, time_s)
        np.testing.assert_allclose(here.position_m[0], 5 + 10 * time_s - 2 * t**2 - 8 * after, atol=1e-12)
        np.testing.assert_allclose(here.position_m[1], 1 + 0.25 * t**2 + 1.0 * after, atol=1e-12)
        np.testing.assert_allclose(here.velocity_mps, [10 - 4 * t, 0.5 * t, 0], atol=1e-12)
    np.testing.assert_allclose(motion(path, 2.0).acceleration_mps2, [-4, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(motion(path, 5.0).acceleration_mps2, 0)


def test_way_points_are_met_at_their_times_with_their_velocities():
    points = (
        WayPoint(time_s=1.0, position_m=(1.0, 2.0, 0.0), velocity_mps=(3.0, 0.0, 0.0)),
        WayPoint(time_s=2.5, position_m=(4.0, -1.0, 0.0)),
        WayPoint(time_s=4.0, position_m=(4.0, -1.0, 0.0)),
    )
    path = Path(waypoints=points)
    for point in points:
        here = motion(path, point.time_s)
        np.testing.assert_allclose(here.position_m, point.position_m, atol=1e-12)
        np.testing.assert_allclose(here.velocity_mps, point.velocity_mps, atol=1e-12)
    np.testing.assert_allclose(motion(path, 3.2).position_m, (4, -1, 0))  # a stop
    np.testing.assert_allclose(motion(path, 0.0).position_m, (-2, 2, 0))  # the velocity before is that of the first


def test_way_points_at_a_constant_velocity_are_a_straight_line():
    ends = [WayPoint(time_s=t, position_m=(2 * t, -t, 0.0), velocity_mps=(2.0, -1.0, 0.0)) for t in (0.0, 3.0)]
    here = motion(Path(waypoints=tuple(ends)), 1.234)
    np.testing.assert_allclose(here.position_m, (2.468, -1.234, 0), atol=1e-12)
    np.testing.assert_allclose(here.acceleration_mps2, 0, atol=1e-12)


@given(time_s=st.floats(-1, 6))
@hypothesis_settings(max_examples=40, deadline=None)
def test_velocity_and_acceleration_are_the_derivatives_of_position(time_s):
    points = (
        WayPoint(time_s=0.0, position_m=(0.0, 0.0, 0.0), velocity_mps=(1.0, 0.5, 0.0)),
        WayPoint(time_s=2.0, position_m=(3.0, 0.0, 0.2), velocity_mps=(0.0, 2.0, 0.0)),
        WayPoint(time_s=5.0, position_m=(1.0, 4.0, 0.0)),
    )
    path, h = Path(waypoints=points), 1e-4
    if min(abs(time_s - p.time_s) for p in points) < 2 * h:
        return
    before, here, after = (motion(path, time_s + d) for d in (-h, 0.0, h))
    np.testing.assert_allclose((after.position_m - before.position_m) / (2 * h), here.velocity_mps, atol=1e-6)
    np.testing.assert_allclose((after.velocity_mps - before.velocity_mps) / (2 * h), here.acceleration_mps2, atol=1e-6)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (Path(start_m=(1.0, 0.0, 0.0), waypoints=(WayPoint(time_s=0.0, position_m=(0.0, 0.0, 0.0)),)), "stand alone"),
        (Path(waypoints=tuple(WayPoint(time_s=t, position_m=(t, 0.0, 0.0)) for t in (1.0, 1.0))), "must rise.* 1, 1"),
    ],
)
def test_a_path_that_contradicts_itself_is_refused(path, message):
    with pytest.raises(UsageError, match=message):
        motion(path, 0.0)


def test_the_own_vehicle_brakes_to_standstill_and_no_further():
    ego = EgoMotion(speed_mps=10.0, phases=(EgoPhase(duration_s=1.0), EgoPhase(duration_s=9.0, acceleration_mps2=-5.0)))
    assert ego_at(ego, 2.0).speed_mps == pytest.approx(5.0)
    assert ego_at(ego, 3.0).speed_mps == pytest.approx(0.0, abs=1e-9)
    assert ego_at(ego, 50.0).speed_mps == pytest.approx(0.0, abs=1e-9)
    assert ego_pose(ego, 50.0).x_m == pytest.approx(10 + 10)  # v^2 / (2 a) after one second at 10 m/s
    assert ego_at(ego, 2.0).time_s == 2.0


def test_the_own_vehicle_can_speed_up_again_after_a_stop():
    phases = [EgoPhase(duration_s=d, acceleration_mps2=a) for d, a in ((3.0, -2.0), (1.0, 3.0))]
    ego = EgoMotion(speed_mps=2.0, phases=tuple(phases))
    assert [round(ego_at(ego, t).speed_mps, 9) for t in (1.0, 3.0, 4.0, 5.0)] == [0.0, 0.0, 3.0, 3.0]


# ---- rays


def test_a_wall_across_the_axis_is_at_its_depth_over_the_cosine_of_every_ray():
    world = scenario(thing(Box(center_m=(5.5, 0.0, 1.0), size_m=(1.0, 40.0, 40.0), reflectivity=0.3)), ambient_wpm2=7.0)
    view, cos_axis = look(world), rays(LENS, SHAPE)[..., 0]
    np.testing.assert_allclose(view.range_m[0], 5 / cos_axis, rtol=1e-5)
    np.testing.assert_allclose(view.cos_incidence[0], cos_axis, rtol=1e-5)
    np.testing.assert_array_equal(view.reflectivity, np.float32(0.3))
    assert view.ambient_wpm2 == 7.0


def test_the_ground_is_where_the_rays_come_down_to_it():
    mounting = Mounting(z_m=1.5, pitch_deg=30.0)
    view = look(scenario(ground_reflectivity=0.2), mounting=mounting)
    ray, pitch = rays(LENS, SHAPE), np.radians(30.0)
    down = np.sin(pitch) * ray[..., 0] - np.cos(pitch) * ray[..., 2]
    np.testing.assert_allclose(view.range_m[0], 1.5 / down, rtol=1e-4)
    np.testing.assert_allclose(view.cos_incidence[0], down, rtol=1e-4)
    assert (look(scenario(), mounting=mounting).range_m == np.inf).all()


def test_nothing_is_at_infinity_and_dark():
    view = look(scenario())
    assert (view.range_m == np.inf).all()
    assert not view.reflectivity.any()
    assert not view.cos_incidence.any()


def one_ray(shape_, from_m=(0.0, 0.0, 1.0), yaw_deg=0.0, **settings):
    """Range and cosine along the axis of a camera at `from_m`."""
    mounting = Mounting(x_m=from_m[0], y_m=from_m[1], z_m=from_m[2], yaw_deg=yaw_deg)
    view = look(scenario(thing(shape_, **settings)), lens=NARROW, mounting=mounting, shape=(1, 1))
    return float(view.range_m[0, 0, 0]), float(view.cos_incidence[0, 0, 0])


@pytest.mark.parametrize("yaw_deg", [0.0, 20.0, 45.0, 70.0, -30.0])
def test_a_turned_box_shows_its_nearest_face(yaw_deg):
    a = abs(np.radians(yaw_deg))
    # a square column with half side 1: the axis meets the face whose normal is nearest to us
    range_m, cosine = one_ray(Box(center_m=(10.0, 0.0, 1.0), size_m=(2.0, 2.0, 2.0), yaw_deg=yaw_deg))
    towards = max(np.cos(a), np.sin(a))
    assert range_m == pytest.approx(10 - 1 / towards, rel=1e-5)
    assert cosine == pytest.approx(towards, rel=1e-5)


@pytest.mark.parametrize("offset_m", [0.0, 0.3, -0.45, 0.49])
def test_a_cylinder_is_hit_where_the_circle_is(offset_m):
    range_m, cosine = one_ray(Cylinder(base_m=(8.0, offset_m, 0.0), radius_m=0.5, height_m=2.0))
    chord = np.sqrt(0.25 - offset_m**2)
    assert range_m == pytest.approx(8 - chord, rel=1e-5)
    assert cosine == pytest.approx(chord / 0.5, rel=1e-3)


def test_rays_pass_beside_above_and_below_a_cylinder():
    for base_m, height_m in (((8.0, 0.51, 0.0), 2.0), ((8.0, 0.0, 0.0), 0.99), ((8.0, 0.0, 1.01), 1.0)):
        assert one_ray(Cylinder(base_m=base_m, radius_m=0.5, height_m=height_m))[0] == np.inf


def test_from_above_one_sees_the_upper_end_of_a_cylinder():
    mounting = Mounting(z_m=3.0, pitch_deg=90.0)
    world = scenario(thing(Cylinder(base_m=(0.0, 0.0, 0.0), radius_m=0.5, height_m=1.8)))
    view = look(world, lens=NARROW, mounting=mounting, shape=(1, 1))
    assert view.range_m[0, 0, 0] == pytest.approx(1.2, rel=1e-5)
    assert view.cos_incidence[0, 0, 0] == pytest.approx(1.0)


def test_what_is_behind_the_camera_or_around_it_is_not_seen():
    assert one_ray(Box(center_m=(-3.0, 0.0, 1.0), size_m=(1.0, 1.0, 1.0)))[0] == np.inf
    assert one_ray(Box(center_m=(0.0, 0.0, 1.0), size_m=(9.0, 9.0, 9.0)))[0] == np.inf
    assert one_ray(Cylinder(base_m=(0.0, 0.0, 0.0), radius_m=4.0, height_m=3.0))[0] == np.inf


def test_a_ray_along_a_face_is_no_accident():
    range_m, _ = one_ray(Box(center_m=(5.0, 0.0, 0.5), size_m=(1.0, 1.0, 1.0)))  # its top is at the camera's height
    assert range_m == pytest.approx(4.5) or range_m == np.inf


def test_the_nearer_thing_hides_the_farther_one_whatever_their_order():
    near = thing(Box(center_m=(3.0, 0.0, 1.0), size_m=(0.2, 1.0, 9.0), reflectivity=0.9))
    far = thing(Box(center_m=(6.0, 0.0, 1.0), size_m=(0.2, 30.0, 30.0), reflectivity=0.1))
    one, other = look(scenario(near, far)), look(scenario(far, near))
    np.testing.assert_array_equal(one.range_m, other.range_m)
    assert set(np.unique(one.reflectivity)) == {np.float32(0.1), np.float32(0.9)}
    np.testing.assert_array_equal(one.reflectivity == np.float32(0.9), one.range_m < 4)


@given(
    place=st.tuples(st.floats(2, 30), st.floats(-10, 10), st.floats(-2, 4)),
    size=st.tuples(st.floats(0.05, 3), st.floats(0.05, 30), st.floats(0.05, 10)),  # from a stone to a wall beside us
    yaw_deg=st.one_of(st.floats(-180, 180), st.sampled_from([0.0, 45.0, 90.0])),
)
@hypothesis_settings(max_examples=60, deadline=None)
def test_skipping_shapes_out_of_view_changes_nothing(place, size, yaw_deg):
    box = Box(center_m=place, size_m=size, yaw_deg=yaw_deg)
    round_ = Cylinder(base_m=(place[0], -place[1], place[2]), radius_m=size[0], height_m=size[1])
    bundle = ray_bundle(LENS, LEVEL, SHAPE)
    every = replace(bundle, cones=bundle.cones * [1, 1, 1, 0, 0])
    world = scenario(thing(box, round_))
    np.testing.assert_array_equal(render(world, 0.0, bundle).range_m, render(world, 0.0, every).range_m)


def directions_of(bundle):
    return bundle.directions[:, np.argsort(bundle.place)].reshape(3, *bundle.shape)


def test_the_rays_of_a_pixel_are_spread_around_its_centre():
    one, four = (directions_of(ray_bundle(LENS, Mounting(), SHAPE, n)) for n in (1, 2))
    assert four.shape[1] == 4
    np.testing.assert_allclose(four.mean(axis=1), one[:, 0], atol=2e-3)
    assert np.ptp(four[1], axis=0).min() > 0.5 * abs(np.diff(one[1, 0], axis=1)).min() * 0.9


def test_an_edge_within_a_pixel_shows_in_some_of_its_rays():
    world = scenario(thing(Box(center_m=(3.0, 5.0, 1.0), size_m=(0.2, 10.1, 9.0))))  # its edge is at y = -0.05
    seen = np.isfinite(look(world, subpixels=4).range_m).mean(axis=0)
    assert ((seen > 0) & (seen < 1)).any()
    assert np.isfinite(look(world).range_m).any()


# ---- motion and truth


def test_things_move_relative_to_the_driving_vehicle():
    path = Path(start_m=(20.0, 1.0, 0.0), velocity_mps=(-2.0, 0.5, 0.0))
    box = Box(center_m=(0.5, 0.0, 1.0), size_m=(1.0, 20.0, 4.0))
    world = scenario(thing(box, path=path), ego=EgoMotion(speed_mps=3.0))
    for time_s in (0.0, 1.5):
        seen = truth(world, time_s, NARROW, LEVEL, (1, 1))
        np.testing.assert_allclose(seen.positions_m, [[20 - 5 * time_s, 1 + 0.5 * time_s, 0]])
        np.testing.assert_allclose(seen.velocities_mps, [[-5, 0.5, 0]])
        assert seen.range_m[0, 0] == pytest.approx(20 - 5 * time_s, rel=1e-5)
    assert seen.names == ("thing",)


def test_truth_numbers_the_objects_in_their_order_and_the_ground_apart():
    left = thing(Box(center_m=(4.0, 1.5, 1.0), size_m=(1.0, 1.0, 1.0), reflectivity=0.25))
    right = thing(Cylinder(base_m=(4.0, -1.5, 0.4), radius_m=0.5, height_m=1.2))
    seen = truth(scenario(left, right, ground_reflectivity=0.1), 0.0, LENS, LEVEL, SHAPE)
    assert set(np.unique(seen.object_id)) == {GROUND, 0, 1, 2}
    assert (seen.object_id[:, :8] != 2).all()
    assert (seen.object_id[:, 8:] != 1).all()
    assert set(np.unique(seen.reflectivity[seen.object_id == 1])) == {np.float32(0.25)}
    assert (seen.range_m[seen.object_id == 0] == np.inf).all()
    assert truth(scenario(), 0.0, LENS, LEVEL, SHAPE).positions_m.shape == (0, 3)


def test_heading_turns_an_object_about_its_own_position():
    box = Box(center_m=(2.0, 0.0, 1.0), size_m=(1.0, 0.2, 1.0))
    path = Path(start_m=(10.0, 0.0, 0.0))
    assert one_ray(box, heading_deg=180.0, path=path)[0] == pytest.approx(10 - 2.5, rel=1e-5)
    assert one_ray(box, heading_deg=90.0, path=path)[0] == np.inf  # it now stands 2 m to the left
    assert one_ray(box, from_m=(0.0, 2.0, 1.0), heading_deg=90.0, path=path)[0] == pytest.approx(10 - 0.1, rel=1e-5)


def test_the_reflectivity_factor_scales_all_shapes_of_a_body():
    def seen(factor):
        person = SceneObject(name="p", body="person", path=Path(start_m=(3.0, 0.0, 0.0)), reflectivity_factor=factor)
        return look(scenario(person), shape=(48, 64)).reflectivity

    np.testing.assert_allclose(seen(0.5), 0.5 * seen(1.0), rtol=1e-6)
    assert seen(1.0).any()


@pytest.mark.parametrize(("body", "size_m"), [("person", (0.47, 1.72)), ("car", (1.76, 1.41))])
def test_bodies_have_the_size_of_what_they_stand_for(body, size_m):
    body_ = SceneObject(name=body, body=body, path=Path(start_m=(20.0, 0.0, 0.0)))
    lens, shape = Lens(horizontal_fov_deg=12.0), (400, 400)
    seen = np.isfinite(look(scenario(body_), lens=lens, shape=shape).range_m[0])
    pixel_m = 2 * np.tan(np.radians(6)) * 20 / 400
    width, height = (np.ptp(np.nonzero(seen.any(axis=axis))[0]) * pixel_m for axis in (0, 1))
    assert (width, height) == pytest.approx(size_m, rel=0.15)  # a car's rear is nearer than its middle
    assert len(CAR) > 1
    assert len(PERSON) > 1


# ---- scenarios


def test_the_four_scenarios_ship():
    assert {"braking-car", "crossing-person", "test-scene", "approach-box"} <= set(scenario_names())


@pytest.mark.parametrize("name", scenario_names())
def test_each_scenario_names_a_preset_and_shows_every_thing_in_it(name):
    world = load_scenario(name)
    assert world.name == name
    assert world.preset in preset_names()
    config = load_config(world.preset)
    shape = (config.camera.rows, config.camera.columns)
    seen = set()
    for time_s in np.linspace(0, world.duration_s * 0.97, 50):
        seen |= set(np.unique(truth(world, float(time_s), config.camera.lens, config.mounting, shape).object_id))
    assert set(range(1, len(world.objects) + 1)) <= seen


def test_the_crossing_person_stops_in_the_middle_fifteen_metres_ahead_and_leaves_to_the_left():
    world = load_scenario("crossing-person")
    path = world.objects[0].path
    start, middle, end = (motion(path, t) for t in (0.0, 3.5, world.duration_s))
    assert start.position_m[1] < -3.5
    np.testing.assert_allclose(middle.position_m, (15, 0, 0), atol=1e-6)
    np.testing.assert_allclose(middle.velocity_mps, 0, atol=1e-6)
    assert end.position_m[1] > 3.5


def test_the_braking_car_and_the_box_cannot_be_avoided_without_braking():
    car = load_scenario("braking-car")
    other = car.objects[0].path
    gap = [motion(other, t).position_m[0] - 2.15 - ego_pose(car.ego, t).x_m for t in (0.0, car.duration_s + 0.2)]
    assert gap[0] == pytest.approx(18.0)
    assert gap[1] < 0.0
    box = load_scenario("approach-box")
    assert motion(box.objects[0].path, 0.0).position_m[0] - 3.0 * (box.duration_s + 0.3) < 0.0


def test_an_unknown_scenario_is_refused_with_the_nearest_name_and_all_names():
    with pytest.raises(UsageError, match=r"'breaking-car'; did you mean 'braking-car'\?; scenarios: approach-box, "):
        load_scenario("breaking-car")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("description = ", "scenario 'mine': not a TOML file"),
        ('description = ""\npreset = ""\nduration_s = -1', "duration_s = -1"),
        ('description = ""\npreset = ""\nduration_s = 1\nclimate = "fog"', "unknown setting 'climate'"),
        (
            'description = ""\npreset = ""\nduration_s = 1\n[[objects]]\nname = "a"\n'
            "path.waypoints = [{ time_s = 2.0, position_m = [0, 0, 0] }, { time_s = 1.0, position_m = [0, 0, 0] }]",
            "scenario 'mine': object 'a': path: the times of way-points must rise, they are 2, 1",
        ),
    ],
)
def test_a_faulty_scenario_is_refused_with_what_is_wrong(text, message):
    with pytest.raises(UsageError, match=message):
        parse_scenario("mine", text)


# ---- own motion with turns, moving parts


def test_an_own_motion_of_constant_speed_and_yaw_rate_is_a_circle():
    ego = EgoMotion(speed_mps=5.0, phases=(EgoPhase(duration_s=60.0, yaw_rate_radps=0.5),))
    for time_s in (0.05, 1.0, np.pi, 4 * np.pi, 30.0):
        pose = ego_pose(ego, time_s)
        np.testing.assert_allclose(
            (pose.x_m, pose.y_m), (10 * np.sin(0.5 * time_s), 10 - 10 * np.cos(0.5 * time_s)), atol=1e-9
        )
        assert pose.heading_rad == pytest.approx(0.5 * time_s)
        assert ego_at(ego, time_s).yaw_rate_radps == 0.5


@given(w=st.floats(-2, 2), a=st.floats(-1, 3), t=st.floats(0.1, 3))
@hypothesis_settings(max_examples=40, deadline=None)
def test_the_own_way_is_the_integral_of_the_own_velocity(w, a, t):
    ego = EgoMotion(speed_mps=4.0, phases=(EgoPhase(duration_s=4.0, acceleration_mps2=a, yaw_rate_radps=w),))
    nodes, weights = np.polynomial.legendre.leggauss(30)
    at = t * (1 + nodes) / 2
    way = (weights * t / 2 * (4 + a * at)) @ np.exp(1j * w * at)
    np.testing.assert_allclose((ego_pose(ego, t).x_m, ego_pose(ego, t).y_m), (way.real, way.imag), atol=1e-8)


def test_braking_to_standstill_ends_the_turn_and_before_time_zero_it_drives_straight():
    ego = EgoMotion(speed_mps=2.0, phases=(EgoPhase(duration_s=5.0, acceleration_mps2=-1.0, yaw_rate_radps=0.1),))
    assert ego_pose(ego, 4.0).heading_rad == pytest.approx(0.2)
    assert ego_at(ego, 4.0) == replace(ego_at(ego, 9.0), time_s=4.0)
    assert ego_pose(ego, -1.0)[:4] == pytest.approx((-2.0, 0.0, 0.0, 2.0))


def test_truth_holds_relative_velocities_without_the_rotation_that_moves_the_coordinates():
    ego = EgoMotion(speed_mps=6.0, phases=(EgoPhase(duration_s=9.0, yaw_rate_radps=0.3),))
    path = Path(start_m=(15.0, 2.0, 0.0), velocity_mps=(1.0, -0.5, 0.0))
    world, h = scenario(thing(Box(center_m=(0, 0, 1.0), size_m=(1.0, 1.0, 1.0)), path=path), ego=ego), 1e-4
    before, here, after = (truth(world, 1.0 + d, NARROW, LEVEL, (1, 1)) for d in (-h, 0.0, h))
    rate = (after.positions_m - before.positions_m)[0] / (2 * h)
    np.testing.assert_allclose(rate, here.velocities_mps[0] - np.cross([0, 0, 0.3], here.positions_m[0]), atol=1e-6)


def test_an_own_motion_from_outside_replaces_that_of_the_scenario():
    ego = EgoMotion(speed_mps=6.0, phases=(EgoPhase(duration_s=9.0, yaw_rate_radps=0.3),))
    box = thing(Box(center_m=(12.0, 1.0, 1.0), size_m=(1.0, 2.0, 2.0)))
    driven = truth(scenario(box, ego=ego), 1.0, LENS, LEVEL, SHAPE)
    told = truth(scenario(box), 1.0, LENS, LEVEL, SHAPE, lambda time_s: ego_pose(ego, time_s))
    np.testing.assert_array_equal(driven.range_m, told.range_m)
    np.testing.assert_array_equal(driven.velocities_mps, told.velocities_mps)
    assert np.isfinite(driven.range_m).any()
    assert not ego_of(ego_pose(ego, 0.0)._replace(speed_mps=-1.0), 0.0).forward


@pytest.mark.parametrize("end_m", [(0.0, 0.0, 0.0), (0.0, 0.6, 0.0), (0.5, 0.5, 0.5), (2.0, 0.0, 0.0)])
def test_a_rod_is_met_where_the_nearest_ball_along_it_is(end_m):
    rod = Rod(start_m=(8.0, -0.1, 1.02), end_m=tuple(np.add((8.0, -0.1, 1.02), end_m)), radius_m=0.2)
    middles = np.linspace(rod.start_m, rod.end_m, 20001)
    across2 = middles[:, 1] ** 2 + (middles[:, 2] - 1.0) ** 2
    expected = (middles[:, 0] - np.sqrt(np.maximum(0.04 - across2, 0)))[across2 < 0.04].min()
    world = scenario(SceneObject(name="rod", rods=(rod,)))
    view = look(world, lens=NARROW, shape=(1, 1))
    assert view.range_m[0, 0, 0] == pytest.approx(expected, rel=1e-5)
    assert 0 < view.cos_incidence[0, 0, 0] <= 1


def test_legs_swing_with_the_way_and_stand_still_when_the_person_does():
    points = (
        WayPoint(time_s=0.0, position_m=(6.0, -1.0, 0.0), velocity_mps=(0.0, 1.4, 0.0)),
        WayPoint(time_s=1.0, position_m=(6.0, 0.4, 0.0), velocity_mps=(0.0, 1.4, 0.0)),
        WayPoint(time_s=2.0, position_m=(6.0, 1.0, 0.0)),
        WayPoint(time_s=9.0, position_m=(6.0, 1.0, 0.0)),
    )
    person = SceneObject(name="p", body="person", follow_path=True, path=Path(waypoints=points))
    lens, shape = Lens(horizontal_fov_deg=40.0), (120, 120)
    widths = []
    for time_s in (0.25, 0.5, 4.0, 6.0):
        seen = np.isfinite(look(scenario(person), time_s, lens=lens, shape=shape).range_m[0])
        widths.append(np.ptp(np.nonzero(seen.any(axis=0))[0]))
    assert widths[0] > 1.5 * widths[2]
    assert widths[2] == widths[3]
    assert travelled_m(person.path, 1.0) == pytest.approx(1.4)
    assert travelled_m(person.path, 9.0) == pytest.approx(2.0)
    assert direction_rad(person.path, 5.0) == pytest.approx(np.pi / 2)
    assert direction_rad(Path(), 5.0) == 0.0
    later = Path(phases=(Phase(duration_s=1.0), Phase(duration_s=1.0, acceleration_mps2=(0.0, -1.0, 0.0))))
    assert direction_rad(later, 0.5) == pytest.approx(-np.pi / 2)


def test_scale_makes_a_child_of_a_person():
    lens, shape = Lens(horizontal_fov_deg=20.0), (300, 300)

    def height(scale):
        person = SceneObject(name="p", body="person", scale=scale, path=Path(start_m=(8.0, 0.0, 0.0)))
        return np.ptp(np.nonzero(np.isfinite(look(scenario(person), lens=lens, shape=shape).range_m[0]).any(axis=1))[0])

    assert height(0.6) == pytest.approx(0.6 * height(1.0), rel=0.03)


def test_a_scenario_like_another_differs_in_what_it_says():
    mine = parse_scenario("mine", 'like = "person-and-tree"\ndescription = "mine"\nduration_s = 3.0')
    other = load_scenario("person-and-tree")
    assert (mine.objects, mine.duration_s, mine.description) == (other.objects, 3.0, "mine")
    with pytest.raises(UsageError, match="unknown scenario 'person-and-tre'"):
        parse_scenario("mine", 'like = "person-and-tre"')


def test_a_cloud_drifts_over_the_ground_and_comes_nearer_as_we_drive():
    weather = Weather(clouds=(Cloud(position_m=(20.0, 0.0, 2.0), velocity_mps=(0.0, 1.0, 0.0), grains=4000),))
    pose = ego_pose(EgoMotion(speed_mps=5.0), 2.0)
    grains = clouds(weather, 2.0, pose, np.random.default_rng(1))
    np.testing.assert_allclose(grains.position_m.mean(axis=0), (10, 2, 2), atol=0.05)
    np.testing.assert_allclose(grains.velocity_mps[0], (-5, 1, 0))
    assert (grains.position_m[:, 2] > 0).all()
    assert not grains.mirrors.any()
