"""The closed loop: one drive, its faults, what is touched, and what could have been done."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rangecam.brake.friction import FrictionSettings
from rangecam.brake.gate import CanFrame, Refusal
from rangecam.brake.health import judge
from rangecam.brake.machine import Fault as Cause
from rangecam.brake.settings import GRAVITY_MPS2
from rangecam.brake.unit import BrakeSettings
from rangecam.cameras.simulated import frame
from rangecam.can.layout import GIVE_BACK_DATA, MAGIC, MASTER_ID
from rangecam.config import Config, load_config
from rangecam.drive import bound, page
from rangecam.drive.campaigns import trial_of
from rangecam.drive.contact import impact_speed, nearest
from rangecam.drive.eye import Eye
from rangecam.drive.journey import _interpolated, between, hand_of
from rangecam.drive.loop import drive
from rangecam.drive.mind import Mind, brake_settings, latency_s, restarted
from rangecam.drive.opening import drive_settings, opened
from rangecam.drive.result import COLUMNS, Drive, as_json, describe
from rangecam.drive.settings import DriveSettings, Fault
from rangecam.errors import UsageError
from rangecam.io import Recorder, open_source
from rangecam.pipeline import process_frame, run
from rangecam.scene.paths import EgoMotion, EgoPhase, Phase, Pose, WayPoint
from rangecam.scene.paths import Path as Way
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, Cylinder, Rod, SceneObject
from rangecam.types import Tracks
from rangecam.vehicle.dynamics import standing
from rangecam.vehicle.settings import VEHICLES

MODEL = VEHICLES["scaled_car"]
AHEAD = Pose(0.0, 0.0, 0.0, 2.0, 0.0)


def scene(*things: SceneObject, speed: float = 2.0, duration_s: float = 2.2, **more: object) -> Scenario:
    return Scenario(
        name="test",
        description="a test",
        preset="scaled_car",
        duration_s=duration_s,
        objects=things,
        ego=EgoMotion(speed_mps=speed),
        ground_reflectivity=0.3,
        **more,  # type: ignore[arg-type]
    )


def box(x: float = 2.6, y: float = 0.0, height: float = 0.5, low: float = 0.0, yaw: float = 0.0) -> SceneObject:
    part = Box(center_m=(0.2, 0.0, low + height / 2), size_m=(0.4, 0.5, height), yaw_deg=yaw, reflectivity=0.8)
    return SceneObject(name="box", boxes=(part,), path=Way(start_m=(x, y, 0.0)))


@cache
def coarse() -> Config:
    """The scaled car's camera with few pixels, so that a drive takes little time."""
    small = {"rows": 24, "columns": 32, "pseudo_rows": 0, "read_noise_lsb": 0.5}
    few = {"min_object_px": 2.0, "large_object_px": 30.0, "min_object_m": 0.01}
    return load_config("scaled_car", {"camera": small, "decision": few, "segments": {"min_pixels": 3}})


SETTINGS = DriveSettings(vehicle=MODEL, friction=0.5)


@cache
def usual() -> Drive:
    return drive(scene(box()), coarse(), SETTINGS)


# -- one drive --------------------------------------------------------------------------------------------------------


def test_a_box_in_the_way_is_stopped_for() -> None:
    found = usual()
    assert not found.hit
    assert 0.02 < found.least_gap_m < 2.0
    assert found.timeline["speed_mps"][-1] == 0
    assert not found.by_fault
    assert "stopping needs" in found.reason
    assert found.frames_on_bus[0x50] > 10
    assert found.frames_on_bus[0xA0] == found.frames_on_bus[0xA1]


def test_the_same_drive_is_the_same_bit_for_bit_and_another_seed_another() -> None:
    again, other = drive(scene(box()), coarse(), SETTINGS), drive(scene(box()), coarse(), SETTINGS, 1)
    assert set(again.timeline) == set(COLUMNS)
    assert all(np.array_equal(again.timeline[name], usual().timeline[name], equal_nan=True) for name in COLUMNS)
    assert not np.array_equal(other.timeline["seen_m"], usual().timeline["seen_m"], equal_nan=True)


def test_the_way_from_light_to_brake_is_four_frame_periods_and_the_delay_of_the_brakes() -> None:
    latency = usual().latency
    least_s = 4 / 30 + MODEL.brake_delay_s
    assert least_s < latency.total_s < least_s + 3 * SETTINGS.step_s
    steps = [getattr(latency, name) for name in ("exposed_s", "read_s", "decided_s", "obeyed_s", "bites_s", "full_s")]
    assert steps == sorted(steps)
    assert latency.full_s - latency.bites_s == pytest.approx(MODEL.brake_rise_s, abs=2 * SETTINGS.step_s)


def test_a_recording_replays_to_the_decisions_that_were_made(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with Recorder(path, coarse(), "test") as recorder:
        recorded = drive(scene(box()), coarse(), SETTINGS, 0, [recorder])
    assert np.array_equal(recorded.timeline["demand"], usual().timeline["demand"])
    source = open_source(path)
    frames = list(run(source.captures, source.config))
    assert len(frames) == recorded.frames
    first = next(frame for frame in frames if frame.decision.brake)
    assert first.raw.time_s == pytest.approx((recorded.latency.exposed_s + recorded.latency.read_s) / 2)


def test_a_driver_who_holds_drives_on_after_control_is_given_back() -> None:
    settings = replace(SETTINGS, driver="holds")
    found = drive(scene(box(), duration_s=1.5), coarse(), settings)
    speed, since = found.timeline["speed_mps"], found.timeline["time_s"] > found.stood_s
    assert found.timeline["bus_control"][-1] == 0 or speed[since].max(initial=0) == 0
    assert found.duration_s > usual().duration_s


def test_a_take_over_is_held_until_a_vehicle_whose_wheels_have_locked_really_stands() -> None:
    found = drive(scene(box(3.5)), coarse(), replace(SETTINGS, friction=0.3))
    t = found.timeline
    assert t["wheel_mps"][t["speed_mps"] > 0.5].min() == 0
    assert not found.hit
    released = np.flatnonzero(np.diff(t["bus_control"]) < 0)
    assert all(t["speed_mps"][k] < 0.1 for k in released)


def two_boxes() -> Scenario:
    """The first box leaves after 4 s; the driver then drives on to the second."""
    places = ((0.0, 3.0, 0.0), (4.0, 3.0, 0.0), (4.6, 3.0, 6.0), (60.0, 3.0, 6.0))
    leaves = Way(waypoints=tuple(WayPoint(time_s=t, position_m=(x, y, 0.0)) for t, x, y in places))
    return scene(replace(box(3.0), path=leaves), box(10.0), speed=1.5, duration_s=9.0)


def test_after_a_stop_on_slippery_ground_the_next_begins_sooner_if_the_brake_adapts(tmp_path: Path) -> None:
    path, begins_m = tmp_path / "drive.mcap", []
    for adapt in (False, True):
        brake = BrakeSettings(friction=FrictionSettings(adapt=adapt))
        settings = replace(SETTINGS, friction=0.15, driver="holds", brake=brake)
        with Recorder(path, coarse(), "test") as recorder:
            found = drive(two_boxes(), coarse(), settings, 0, [recorder][: int(adapt)])
        slows = settings.friction + MODEL.rolling_mps2 / GRAVITY_MPS2
        assert found.friction == pytest.approx(slows, abs=2 * found.friction_sigma)
        assert found.friction_sigma < 0.03
        assert "friction   0.1" in describe(found)
        assert not found.hit
        t = found.timeline
        begins_m.append(t["x_m"][(t["time_s"] > 5.0) & (t["bus_control"] > 0)][0])
    assert begins_m[1] < begins_m[0] - 0.5
    source = open_source(path)
    known = [capture.ego.friction for capture in source.captures]
    assert known[0] is None
    assert known[-1] == pytest.approx(0.15, abs=0.05)


def test_who_leaves_gives_control_back_and_brakes_no_more() -> None:
    mind = Mind(coarse(), SETTINGS, 0.0, unit=restarted())
    assert [frame.data[-2:] for frame in mind.think(1.0)] == [MAGIC]
    assert mind.leave() == CanFrame(MASTER_ID, GIVE_BACK_DATA)
    assert mind.think(1.1) == []
    assert mind.unit.gate.refused == {Refusal.NOT_ARMED: 1}


def test_json_and_lines_say_how_it_came_out() -> None:
    as_values = as_json(usual())
    assert as_values["hit"] is None
    assert len(as_values["timeline"]["time_s"]) == len(usual().timeline["time_s"])
    assert "none, least gap" in describe(usual())
    assert "take-over  none" in describe(replace(usual(), braked_s=math.inf))
    assert "with box" in describe(replace(usual(), hit="box", refused={"old": 2}))
    assert page.html(usual(), "a test").startswith(b"<!DOCTYPE html>")


@pytest.mark.parametrize(("preset", "brakes"), [("scaled_car", True), ("scaled_car_unwrapped", False)])
def test_a_reflector_beyond_the_unambiguous_range_needs_a_second_frequency(preset: str, brakes: bool) -> None:
    scenario, config, settings = opened("beyond-range", preset, [])
    found = drive(replace(scenario, duration_s=1.1), config, settings)
    assert math.isfinite(found.braked_s) is brakes
    assert not found.by_fault


@pytest.mark.parametrize(("number", "until_s"), [(113, 0.4), (112, 0.6), (79, 0.3), (78, 1.2)])
def test_parked_cars_poles_in_rain_and_dust_and_a_rail_are_driven_past(number: int, until_s: float) -> None:
    trial = trial_of("false-positives", 11, number, {})
    brief = replace(trial.scenario, duration_s=until_s)
    assert math.isinf(drive(brief, trial.config, trial.settings, trial.seed).braked_s)


def test_one_who_walks_into_the_way_of_a_car_is_stopped_for() -> None:
    trial = trial_of("full-size", 21, 98, {})
    assert (trial.drawn.group, trial.drawn.camera) == ("CPNA", "usercams")
    found = drive(trial.scenario, trial.config, trial.settings, trial.seed)
    assert not found.hit
    assert not found.by_fault


@pytest.mark.parametrize(("reflectivity", "faults"), [(0.08, ()), (0.0, (Cause.BLOCKED,))])
def test_a_dark_bare_floor_does_not_block_the_lens_and_no_light_at_all_does(
    reflectivity: float, faults: tuple[Cause, ...]
) -> None:
    config = load_config("scaled_car_unwrapped")
    bare = replace(scene(), ground_reflectivity=reflectivity)
    seen = frame(bare, config, 0, 0.1, 0)
    found = process_frame(seen.raw, Tracks.empty(), seen.ego, config)
    health = drive_settings(config, {}).brake.health
    assert health.min_seen == config.brake.health.min_seen
    assert judge(found, 0.2, None, health).faults == faults


def test_a_car_ahead_as_fast_as_we_are_is_followed() -> None:
    scenario, config, settings = opened("follow-car", None, [])
    assert drive(replace(scenario, duration_s=1.5), config, settings).braked_s == math.inf


# -- faults -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["frozen", "dropped", "late", "repeated", "saturated", "status_silence"])
def test_input_that_goes_wrong_stops_the_vehicle(kind: str) -> None:
    faults = (Fault(kind=kind, start_s=0.2, value=0.5),)  # type: ignore[arg-type]
    found = drive(scene(duration_s=1.2), coarse(), replace(SETTINGS, faults=faults))
    assert found.by_fault
    assert 0.2 < found.braked_s < 0.7
    assert found.timeline["speed_mps"][-1] == 0


def test_a_frame_that_comes_after_the_next_does_not_undo_it() -> None:
    faults = (Fault(kind="out_of_order", start_s=0.2),)
    found = drive(scene(box()), coarse(), replace(SETTINGS, faults=faults))
    assert not found.hit


@pytest.mark.parametrize("kind", ["command_silence", "wrong_magic"])
def test_where_no_take_over_arrives_the_vehicle_drives_on(kind: str) -> None:
    found = drive(scene(box()), coarse(), replace(SETTINGS, faults=(Fault(kind=kind),)))  # type: ignore[arg-type]
    assert found.hit == "box"
    assert found.impact_mps == pytest.approx(2.0, abs=0.3)
    assert found.timeline["take_overs"][-1] > 0


def test_on_a_slippery_spot_the_way_is_longer() -> None:
    found = drive(scene(box()), coarse(), replace(SETTINGS, faults=(Fault(kind="slippery", value=0.05),)))
    assert found.least_gap_m < usual().least_gap_m


def test_a_speed_sensor_that_is_stuck_goes_on_telling_what_it_told() -> None:
    found = drive(scene(box()), coarse(), replace(SETTINGS, faults=(Fault(kind="speed_stuck", start_s=0.1),)))
    assert found.timeline["measured_mps"][-1] == pytest.approx(2.0, abs=0.05)
    assert not found.hit


def test_a_camera_of_any_family_can_be_saturated() -> None:
    for preset in ("usercams", "generic_range"):
        scenario, config, settings = opened("braking-car", preset, [{"drive": {"faults": [{"kind": "saturated"}]}}])
        found = drive(replace(scenario, duration_s=0.2), config, replace(settings, run_in_s=0.1))
        assert found.frames > 3


def test_timeouts_follow_the_latency_and_the_road() -> None:
    settings = replace(SETTINGS, result_after_frames=10.0)
    machine = brake_settings(coarse(), settings).machine
    assert machine.image_timeout_s == pytest.approx(latency_s(coarse(), settings) + 3 / 30)
    assert machine.sure_deceleration_mps2 == pytest.approx(0.3 * 9.81)


# -- what is touched --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("thing", "gap_m"),
    [
        (box(3.0), 3.0),
        (box(3.0, y=1.0), math.hypot(3.0, 0.55)),
        (box(-0.2), 0.0),
        (box(3.0, yaw=45.0), 3.2 - 0.45 / math.sqrt(2)),
        (box(3.0, height=0.03), math.inf),
        (box(3.0, low=0.4), math.inf),
        (SceneObject(name="c", cylinders=(Cylinder(base_m=(2.0, 0.0, 0.0), radius_m=0.3, height_m=1.0),)), 1.7),
        (SceneObject(name="r", rods=(Rod(start_m=(2.0, -1.0, 0.2), end_m=(2.0, 1.0, 0.2), radius_m=0.1),)), 1.9),
        (SceneObject(name="r", rods=(Rod(start_m=(2.0, 0.0, 0.0), end_m=(2.0, 0.0, 1.0), radius_m=0.1),)), 1.9),
        (SceneObject(name="r", rods=(Rod(start_m=(1.0, 0.0, 0.9), end_m=(2.0, 0.0, 0.9), radius_m=0.1),)), math.inf),
        (SceneObject(name="r", rods=(Rod(start_m=(1.0, 0.0, 2.0), end_m=(1.0, 0.0, 1.0), radius_m=0.1),)), math.inf),
        (SceneObject(name="r", rods=(Rod(start_m=(-0.3, -1.0, 0.2), end_m=(-0.3, 1.0, 0.2), radius_m=0.1),)), 0.0),
    ],
)
def test_the_gap_is_the_distance_of_the_outlines_between_clearance_and_height(thing: SceneObject, gap_m: float) -> None:
    assert nearest(scene(thing), 0.0, AHEAD, MODEL).gap_m == pytest.approx(gap_m, abs=1e-9)


def test_a_vehicle_within_a_large_box_touches_it() -> None:
    hall = Box(center_m=(0.0, 0.0, 0.5), size_m=(20.0, 20.0, 1.0))
    assert nearest(scene(SceneObject(name="hall", boxes=(hall,))), 0.0, AHEAD, MODEL).gap_m == 0


def test_things_that_are_harmless_do_not_count() -> None:
    assert nearest(scene(box()), 0.0, AHEAD, MODEL, ("bo",)) == (math.inf, 0)
    assert nearest(scene(), 0.0, AHEAD, MODEL) == (math.inf, 0)


def test_an_impact_is_as_fast_as_we_drive_into_a_thing() -> None:
    away = replace(box(), path=Way(start_m=(2.0, 0.0, 0.0), velocity_mps=(0.5, 3.0, 0.0)))
    assert impact_speed(scene(away), 0.0, AHEAD, 1) == pytest.approx(1.5)
    assert impact_speed(scene(away), 0.0, AHEAD._replace(speed_mps=0.0), 1) == 0


def test_between_two_poses_it_goes_evenly_and_straight_before_and_after() -> None:
    own = between([Pose(0, 0, 0, 2, 0), Pose(1, 0.2, 0.1, 2, 0.5)], 10.0, 0.5)
    assert own(10.25) == pytest.approx((0.5, 0.1, 0.05, 2.0, 0.25))
    assert own(9.0) == pytest.approx((-2.0, 0, 0, 2, 0))
    assert own(11.5)[:2] == pytest.approx((1 + 2 * math.cos(0.1), 0.2 + 2 * math.sin(0.1)))


def test_the_driver_follows_the_bends_of_the_scenario() -> None:
    bend = EgoMotion(speed_mps=2.0, phases=(EgoPhase(duration_s=2.0, yaw_rate_radps=0.5),))
    rolled = bound.roll(replace(scene(), ego=bend, duration_s=2.0), SETTINGS)
    assert rolled.own(2.0).heading_rad == pytest.approx(1.0, abs=0.05)
    stop = EgoMotion(speed_mps=2.0, phases=(EgoPhase(duration_s=1.0, acceleration_mps2=-2.0),))
    rolled = bound.roll(replace(scene(), ego=stop, duration_s=2.0), SETTINGS)
    assert rolled.own(2.0).speed_mps == pytest.approx(0.0, abs=0.02)
    assert hand_of(scene(), 0.0, standing(MODEL), MODEL, False).throttle == 1.0


def test_between_the_moments_of_a_course_the_driver_holds_what_numpy_interpolates() -> None:
    rng = np.random.default_rng(3)
    places, values = np.sort(rng.uniform(0, 5, 40)), rng.normal(size=40)
    for at in (*rng.uniform(-1, 6, 200).tolist(), *places.tolist()):
        assert _interpolated(at, places.tolist(), values.tolist()) == np.interp(at, places, values)
    assert _interpolated(1.0, [0.0], [4.0]) == 4.0


def test_noise_belongs_to_the_number_of_a_frame_however_it_is_taken() -> None:
    world = scene(box())
    eye = Eye(world, coarse(), SETTINGS, 3, lambda _: AHEAD, False)
    seen = [capture.raw for _, capture in eye.arrived(0.8)]
    for number in (0, 31, 32, len(seen) - 1):
        alone = frame(world, coarse(), number, seen[number].time_s, 3, lambda _: AHEAD).raw
        for name, plane in alone.planes.items():
            assert np.array_equal(seen[number].planes[name], plane)


# -- what could have been done ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("range_m", "most_kmh"), [(20.0, 58), (10.0, 38)])
def test_a_usable_range_caps_the_speed_from_which_a_car_can_stop(range_m: float, most_kmh: int) -> None:
    car = replace(
        VEHICLES["passenger_car"],
        brake_mps2=9.0,
        brake_delay_s=0.0,
        brake_rise_s=0.0,
        rolling_mps2=0.0,
        drag_per_m=0.0,
        clearance_m=0.1,
    )
    settings = DriveSettings(vehicle=car, friction=1.5)
    wall = SceneObject(name="wall", boxes=(Box(center_m=(0.5, 0, 1), size_m=(1, 4, 2)),), path=Way(start_m=(60, 0, 0)))
    for kmh, stops in ((most_kmh - 1, True), (most_kmh + 1, False)):
        scenario = scene(wall, speed=kmh / 3.6, duration_s=6.0)
        braked = bound.roll(scenario, settings, (60 - range_m) / (kmh / 3.6) + 0.35)
        assert (braked.hit == 0) is stops


def test_without_brakes_a_box_is_hit_when_the_way_to_it_is_over() -> None:
    free = bound.roll(scene(box(), duration_s=3.0), SETTINGS)
    assert free.hit == 1
    assert free.hit_s == pytest.approx(1.3, abs=1e-3)
    assert free.impact_mps == pytest.approx(2.0, abs=0.01)


def test_a_box_is_seen_before_it_is_reached_and_one_behind_a_wall_never() -> None:
    found = bound.bound_of(scene(box(), duration_s=3.0), coarse(), SETTINGS, 0)
    assert found.threat
    assert found.avoidable
    assert found.seen_s < 0.5
    assert found.braked_mps == 0
    dark = replace(box(), reflectivity_factor=1e-3)
    unseen = bound.bound_of(scene(dark, duration_s=3.0), coarse(), SETTINGS, 0)
    assert unseen.threat
    assert not unseen.avoidable
    assert unseen.seen_s == math.inf


def test_what_can_be_done_does_not_hang_on_how_far_aside_one_looks() -> None:
    way = Way(start_m=(2.6, 1.2, 0.0), velocity_mps=(0.0, -1.0, 0.0))
    crossing, narrow = scene(replace(box(), path=way), duration_s=3.0), load_config("scaled_car")
    narrow = replace(coarse(), clean=replace(coarse().clean, width_m=0.4))
    assert bound.bound_of(crossing, narrow, SETTINGS, 0) == bound.bound_of(crossing, coarse(), SETTINGS, 0)


def test_who_waits_beside_the_way_cannot_be_braked_for_before_he_comes() -> None:
    """A box 1 m aside that is seen all the time darts out when it is beside the image, and the same one that walks."""
    waits = WayPoint(time_s=1.1, position_m=(2.6, 1.0, 0.0))
    comes = WayPoint(time_s=1.3, position_m=(2.6, 0.2, 0.0), velocity_mps=(0.0, -4.0, 0.0))
    darts = Way(waypoints=(waits, comes))
    walks = Way(start_m=(2.6, 1.2, 0.0), velocity_mps=(0.0, -1.0, 0.0))
    found, other = (
        bound.bound_of(scene(replace(box(), path=path), duration_s=3.0), coarse(), SETTINGS, 0)
        for path in (darts, walks)
    )
    assert found.threat
    assert found.seen_s < 0.5
    assert not found.avoidable
    assert other.avoidable


def test_what_the_brake_rule_never_demands_cannot_be_avoided() -> None:
    timid = replace(coarse(), decision=replace(coarse().decision, margin=0.1))
    found = bound.bound_of(scene(box(), duration_s=3.0), timid, SETTINGS, 0)
    assert found.seen_s < 0.5
    assert not found.avoidable


def test_what_is_as_fast_as_we_are_is_braked_for_once_it_brakes() -> None:
    """It goes ahead of us for half a second, seen all the time, and stops: nothing touches us before that."""
    phases = (Phase(duration_s=0.5), Phase(duration_s=1.0, acceleration_mps2=(-2.0, 0.0, 0.0)))
    ahead = replace(box(), path=Way(start_m=(1.6, 0.0, 0.0), velocity_mps=(2.0, 0.0, 0.0), phases=phases))
    found = bound.bound_of(scene(ahead, duration_s=4.0), coarse(), SETTINGS, 0)
    assert found.threat
    assert found.avoidable


def test_where_nothing_is_hit_there_is_no_threat() -> None:
    assert bound.bound_of(scene(box(y=2.0)), coarse(), SETTINGS, 0).threat is False


# -- what the command line says ---------------------------------------------------------------------------------------


def test_a_narrow_corridor_is_that_of_the_scaled_car_and_any_vehicle_can_be_named(tmp_path: Path) -> None:
    assert opened("approach-box", None, [])[2].vehicle == MODEL
    assert opened("scenario:braking-car", None, [])[2].vehicle == VEHICLES["passenger_car"]
    told = {"drive": {"vehicle": "passenger_car", "friction": 0.4}}
    settings = opened("approach-box", None, [told])[2]
    assert (settings.vehicle.name, settings.friction) == ("passenger car", 0.4)
    assert opened("approach-box", None, [{"drive": {"vehicle": {"mass_kg": 12.0}}}])[2].vehicle.mass_kg == 12.0
    own = tmp_path / "own.toml"
    own.write_text('description = "x"\npreset = "scaled_car"\nduration_s = 1.0\n')
    assert opened(str(own), None, [])[0].name == "own"


def test_what_is_unknown_is_refused(tmp_path: Path) -> None:
    for name in ("approach-bux", str(tmp_path / "none.toml")):
        with pytest.raises(UsageError):
            opened(name, None, [])
    with pytest.raises(UsageError, match="unknown setting 'frction'"):
        opened("approach-box", None, [{"drive": {"frction": 0.4}}])
