"""Assistance functions: on tracks made by hand, on a simulated follower, and on simulated scenes."""

import contextlib
import dataclasses
import io
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangecam import open_source, pipeline
from rangecam.apps import (
    BlindSpot,
    BlindSpotState,
    DistanceControl,
    Following,
    FollowState,
    LaserGuard,
    LaserState,
    Parking,
    follow,
    guard_laser,
    keep_distance,
    may_start,
    park,
)
from rangecam.collision import CorridorSettings
from rangecam.errors import UsageError
from rangecam.types import Collisions, Decision, Ego, Frame, RangeImage, RawFrame, Segments, Tracks, TrackStatus
from test_brake import tracks_of

ROAD = CorridorSettings(width_m=2.0)
NOBODY = Collisions(**{field.name: np.zeros(0) for field in dataclasses.fields(Collisions)})


def segments_of(*boxes: tuple[float, float, float]) -> Segments:
    """Segments of (x, y, width): 0.2 m deep, seen well."""
    x, y, width = np.array(boxes, float).reshape(-1, 3).T
    n = len(x)
    position = np.column_stack([x, y, np.full(n, 0.5)])
    return Segments(
        label=np.arange(1, n + 1),
        position_m=position,
        covariance_m2=np.tile(np.eye(3) * 1e-4, (n, 1, 1)),
        size_m=np.column_stack([np.full(n, 0.2), width, np.full(n, 0.5)]),
        near_m=x - 0.1,
        n_pixels=np.full(n, 100),
        box=np.zeros((n, 4), int),
        range_m=x,
        sigma_range_m=np.full(n, 0.01),
        amplitude=np.ones(n),
        cut=np.zeros(n, np.uint8),
        nearest_m=position - np.array([0.1, 0, 0]),
    )


def frame_of(
    *rows: dict[str, float], segments: Segments | None = None, time_s: float = 2.5, valid: bool = True
) -> Frame:
    tracks = tracks_of(*rows) if rows else Tracks.empty()
    plane = np.ones((4, 4), np.float32)
    image = RangeImage(time_s, plane, plane, plane, np.full((4, 4), 0 if valid else 1, np.uint8))
    decision = Decision(time_s=time_s, brake=False, reason="", collisions=NOBODY)
    labels = np.zeros((4, 4), np.int32)
    return Frame(RawFrame(time_s, {}), image, labels, segments or segments_of(), tracks, decision)


# -- distance control --------------------------------------------------------------------------------------------------


def followed(lead: Any, start_gap: float, speed: float, seconds: float, control: DistanceControl) -> Any:
    """Times, gaps, own speeds and accelerations behind a car whose speed is lead(t)."""
    dt, gap, wish, rows = 0.02, start_gap, None, []
    for k in range(round(seconds / dt)):
        u = lead(k * dt)
        frame = frame_of({"x": gap, "vx": u - speed, "sigma_v": 0.01})
        wish = keep_distance(frame, Ego(k * dt, speed), wish, dt, control)
        rows.append((k * dt, gap, speed, wish.acceleration_mps2))
        speed = max(0.0, speed + wish.acceleration_mps2 * dt)
        gap += (u - speed) * dt
    return np.array(rows).T


CONTROL = DistanceControl(set_speed_mps=20.0, corridor=ROAD)


def test_behind_a_slower_car_the_gap_settles_at_its_time_without_coming_nearer() -> None:
    _, gap, speed, acceleration = followed(lambda t: 12.0, 60.0, 18.0, 40.0, CONTROL)
    assert gap[-1] == pytest.approx(2.0 + 1.8 * 12.0, abs=0.2)
    assert speed[-1] == pytest.approx(12.0, abs=0.05)
    assert gap.min() > 0.95 * gap[-1]
    assert acceleration.min() >= -3.0


def test_behind_a_car_that_stops_it_stops_at_the_distance_of_standing() -> None:
    _, gap, speed, _ = followed(lambda t: max(0.0, 10.0 - 1.5 * t), 22.0, 10.0, 40.0, CONTROL)
    assert speed[-1] == pytest.approx(0.0, abs=0.02)
    assert gap.min() > 1.0
    assert gap[-1] == pytest.approx(2.0, abs=0.3)


def test_acceleration_rises_slowly_and_never_passes_its_limits() -> None:
    _, _, speed, acceleration = followed(lambda t: 30.0, 50.0, 5.0, 30.0, CONTROL)
    assert acceleration.max() <= 1.5
    assert np.diff(acceleration).max() <= 3.0 * 0.02 + 1e-9
    assert speed.max() <= 20.0 + 1e-9
    assert speed[-1] == pytest.approx(20.0, abs=0.1)


@given(st.floats(0, 40), st.floats(0.5, 100), st.floats(-30, 30), st.floats(-3, 1.5), st.floats(0, 1), st.booleans())
def test_at_or_above_the_set_speed_it_never_accelerates(
    excess: float, gap: float, relative: float, last: float, elapsed: float, ahead: bool
) -> None:
    frame = frame_of({"x": gap, "vx": relative}) if ahead else frame_of()
    before = keep_distance(frame_of(), Ego(0.0, 20.0 - last / 0.9), None, 1.0, CONTROL)
    wish = keep_distance(frame, Ego(0.0, 20.0 + excess), before, elapsed, CONTROL)
    assert -3.0 <= wish.acceleration_mps2 <= 0.0


def test_a_car_beside_the_corridor_is_not_followed_and_without_a_speed_it_slows_down() -> None:
    beside = keep_distance(frame_of({"x": 10.0, "y": 4.0}), Ego(0.0, 15.0), None, 0.1, CONTROL)
    assert (beside.track_id, beside.gap_m) == (0, math.inf)
    assert beside.acceleration_mps2 > 0
    for ego in (Ego(), Ego(0.0, math.nan)):
        assert keep_distance(frame_of(), ego, None, 0.1, CONTROL).acceleration_mps2 == -3.0


def test_of_two_cars_the_one_that_demands_more_is_followed() -> None:
    frame = frame_of({"x": 30.0, "vx": 0.0}, {"x": 45.0, "vx": -14.0})
    assert keep_distance(frame, Ego(0.0, 15.0), None, 0.1, CONTROL).track_id == 2


def test_in_a_simulated_scene_the_car_ahead_is_found_and_kept_away_from() -> None:
    source = open_source("scenario:follow-car", layers=[{"camera": {"rows": 60, "columns": 80}}])
    control = DistanceControl(set_speed_mps=3.0, time_gap_s=0.6, standstill_m=0.3)
    captures = [capture for capture, _ in zip(source.captures, range(45), strict=False)]
    wish, found = None, []
    for capture, frame in zip(captures, pipeline.run(captures, source.config), strict=True):
        wish = keep_distance(frame, capture.ego, wish, 1 / 30, control)
        found.append(wish)
    gaps = [each.gap_m for each in found[20:]]
    assert min(gaps) > 1.0
    assert max(gaps) < 2.2


# -- parking -----------------------------------------------------------------------------------------------------------


def test_each_zone_says_its_nearest_and_the_pause_shrinks_with_the_distance() -> None:
    aid = park(frame_of(segments=segments_of((1.1, 0.6, 0.1), (2.0, 0.6, 0.1), (1.6, -0.6, 0.1))), Parking())
    assert aid.distances_m == pytest.approx((1.0, math.inf, 1.5))
    assert aid.nearest_m == pytest.approx(1.0)
    assert aid.pause_s == pytest.approx(0.8 * (1.0 - 0.3) / 1.2)


def test_something_wide_is_in_every_zone_and_beside_the_car_in_none() -> None:
    wide = park(frame_of(segments=segments_of((0.3, 0.0, 2.0))), Parking())
    assert wide.distances_m == pytest.approx((0.2, 0.2, 0.2))
    assert wide.pause_s == 0.0
    beside = park(frame_of(segments=segments_of((0.5, 1.5, 0.4))), Parking())
    assert beside.nearest_m == beside.pause_s == math.inf
    assert park(frame_of(segments=segments_of((2.0, 0.0, 0.4))), Parking()).pause_s == math.inf


def test_what_is_at_the_bumper_is_at_no_distance() -> None:
    assert park(frame_of(segments=segments_of((0.4, 0.0, 0.1))), Parking(bumper_x_m=0.5)).nearest_m == 0.0


def test_zones_that_cannot_be_are_refused() -> None:
    with pytest.raises(UsageError, match="from left"):
        park(frame_of(), Parking(edges_m=(-1.0, 1.0)))
    with pytest.raises(UsageError, match="must be less than"):
        park(frame_of(), Parking(near_m=2.0))


# -- following ---------------------------------------------------------------------------------------------------------


def test_it_stays_with_the_one_it_chose_although_another_comes_nearer() -> None:
    state = follow(frame_of({"x": 2.0}, {"x": 3.0}), Ego(), FollowState(), Following())
    assert state.track_id == 1
    state = follow(frame_of({"x": 3.5}, {"x": 1.0}), Ego(), state, Following())
    assert state.track_id == 1
    assert state.speed_mps == pytest.approx(0.8 * 2.5)


def test_it_keeps_the_distance_and_drives_no_faster_than_it_may_and_never_back() -> None:
    settings = Following()
    at = {x: follow(frame_of({"x": x}), Ego(), FollowState(), settings).speed_mps for x in (0.5, 1.0, 1.5, 4.0)}
    assert at == pytest.approx({0.5: 0.0, 1.0: 0.0, 1.5: 0.4, 4.0: 2.0})
    walking = follow(frame_of({"x": 1.0, "vx": 0.0}), Ego(0.0, 1.2), FollowState(), settings)
    assert walking.speed_mps == pytest.approx(1.2)


def test_the_arc_leads_through_the_object() -> None:
    state = follow(frame_of({"x": 3.0, "y": 1.0}), Ego(), FollowState(), Following())
    radius = 1 / state.curvature_per_m
    assert math.hypot(3.0, 1.0 - radius) == pytest.approx(radius)
    assert follow(frame_of({"x": 1.0, "y": -1.0}), Ego(), FollowState(), Following()).curvature_per_m == -0.5


def test_lost_it_stops_at_once_and_chooses_anew_when_it_has_given_up() -> None:
    state = follow(frame_of({"x": 3.0}), Ego(), FollowState(), Following())
    gone = follow(frame_of(time_s=2.8), Ego(), state, Following())
    assert (gone.track_id, gone.speed_mps) == (1, 0.0)
    other = frame_of({"x": 2.0}, time_s=2.9)
    other = replace(other, tracks=replace(other.tracks, track_id=np.array([7])))
    assert follow(other, Ego(), gone, Following()).track_id == 1
    later = replace(other, decision=replace(other.decision, time_s=3.1))
    assert follow(later, Ego(), gone, Following()).track_id == 7
    assert follow(frame_of(time_s=3.1), Ego(), gone, Following()) == FollowState()


def test_a_track_that_only_coasts_is_lost_in_time_and_none_is_chosen_far_away_or_beside() -> None:
    state = follow(frame_of({"x": 3.0}), Ego(), FollowState(), Following())
    coasting = {"x": 3.0, "status": float(TrackStatus.COASTING)}
    assert follow(frame_of(coasting, time_s=2.9), Ego(), state, Following()).seen_s == 2.5
    assert follow(frame_of(coasting, time_s=3.1), Ego(), state, Following()) == FollowState()
    for row in ({"x": 6.0}, {"x": 2.0, "y": 3.0}, {"x": 2.0, "status": float(TrackStatus.TENTATIVE)}):
        assert follow(frame_of(row), Ego(), FollowState(), Following()).track_id == 0


# -- blind spot --------------------------------------------------------------------------------------------------------

STANDING = Ego(0.0, 0.0)


def test_somebody_in_the_area_inhibits_at_once_and_for_a_while_after() -> None:
    there = frame_of(segments=segments_of((0.0, -2.0, 0.5)))
    state = may_start(there, STANDING, BlindSpotState(), BlindSpot())
    assert state.inhibit
    assert "object at 0.0, -2.0 m" in state.reason
    state = may_start(frame_of(time_s=3.0), STANDING, state, BlindSpot())
    assert (state.inhibit, state.reason) == (True, "somebody was there a moment ago")
    state = may_start(frame_of(time_s=3.5), STANDING, state, BlindSpot())
    assert (state.inhibit, state.reason) == (False, "free")


def test_who_will_be_there_inhibits_and_who_passes_by_does_not() -> None:
    comes = frame_of({"x": -7.0, "vx": 3.0, "y": -2.5, "class": 1.0})
    state = may_start(comes, STANDING, BlindSpotState(), BlindSpot())
    assert state.inhibit
    assert state.reason.startswith("vru there in ")
    for row in ({"x": -7.0, "vx": 0.5, "y": -2.5}, {"x": -7.0, "vx": 3.0, "y": -6.0}):
        assert not may_start(frame_of(row), STANDING, BlindSpotState(), BlindSpot()).inhibit
    tentative = {"x": -7.0, "vx": 3.0, "y": -2.5, "status": float(TrackStatus.TENTATIVE)}
    assert not may_start(frame_of(tentative), STANDING, BlindSpotState(), BlindSpot()).inhibit


def test_a_blind_camera_inhibits_a_driving_vehicle_is_left_alone_and_an_unknown_speed_is_standing() -> None:
    assert may_start(frame_of(valid=False), STANDING, BlindSpotState(), BlindSpot()).inhibit
    there = frame_of(segments=segments_of((0.0, -2.0, 0.5)))
    assert not may_start(there, Ego(0.0, 2.0), BlindSpotState(), BlindSpot()).inhibit
    assert may_start(there, Ego(), BlindSpotState(), BlindSpot()).inhibit
    assert BlindSpotState().inhibit


# -- laser guard -------------------------------------------------------------------------------------------------------


def lit(*speeds: float | None, step_s: float = 0.1, age_s: float = 0.0) -> list[bool]:
    state, found = LaserState(), []
    for k, speed in enumerate(speeds):
        state = guard_laser(Ego(k * step_s - age_s, speed), k * step_s, state, LaserGuard())
        found.append(state.on)
    return found


def test_the_laser_is_off_until_the_vehicle_moves_and_again_after_it_stopped() -> None:
    assert lit(0.0, 0.7, 0.9, 0.7, 0.7) == [False, False, True, True, True]
    stopped = lit(2.0, *[0.0] * 14)
    assert stopped == [True] * 11 + [False] * 4
    assert lit(*[2.0, *[0.0] * 12, 0.7, 0.9])[-3:] == [False, False, True]


def test_a_speed_that_is_unknown_old_or_of_the_future_is_standing() -> None:
    assert not any(lit(None, math.nan, None))
    assert not any(lit(5.0, 5.0, age_s=0.3))
    assert not any(lit(5.0, 5.0, age_s=-0.3))


# -- recipes -----------------------------------------------------------------------------------------------------------


def test_the_recipes_run() -> None:
    text = (Path(__file__).parent.parent / "docs" / "applications.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) == 2
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        for block in blocks:
            exec(compile(block, "applications.md", "exec"), {})
    assert "True object at" in out.getvalue()
    assert "m/s2" in out.getvalue()
