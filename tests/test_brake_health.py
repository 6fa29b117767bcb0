"""Whether an image is to be trusted, and what a stop says of the friction."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from rangecam.brake.friction import Friction, FrictionSettings, observe, with_friction
from rangecam.brake.health import Health, HealthSettings, judge, perceived
from rangecam.brake.machine import CarState, Fault
from rangecam.brake.rule import DecisionSettings
from rangecam.types import Collisions, Decision, Frame, RangeImage, RawFrame, Segments, Tracks, TrackStatus, Why

N0, I0 = np.zeros(0), np.zeros(0, int)
NO_SEGMENTS = Segments(**{field.name: N0 for field in dataclasses.fields(Segments)})
NOBODY = Collisions(**{field.name: N0 for field in dataclasses.fields(Collisions)})
SETTINGS = HealthSettings()


def frame_of(
    planes: dict[str, Any] | None = None,
    why: Any = Why.VALID,
    range_m: Any = 2.0,
    time_s: float = 0.0,
    closing_mps: tuple[float, ...] = (),
    status: int = TrackStatus.CONFIRMED,
    shape: tuple[int, int] = (10, 10),
) -> Frame:
    plane = np.ones(shape, np.float32)
    n = len(closing_mps)
    state = np.zeros((n, 9))
    state[:, 1] = [-speed for speed in closing_mps]
    tracks = dataclasses.replace(Tracks.empty(), status=np.full(n, status), state=state, track_id=np.arange(n))
    image = RangeImage(time_s, plane * range_m, plane, plane, (plane * why).astype(np.uint8))
    decision = Decision(time_s, True, "box", NOBODY)
    raw = RawFrame(time_s, {"a": plane} if planes is None else planes, frame_id=7)
    return Frame(raw, image, np.zeros(shape, int), NO_SEGMENTS, tracks, decision)


def judged(*frames: Frame, settings: HealthSettings = SETTINGS, late_s: tuple[float, ...] = ()) -> Health:
    """Health of the last of some frames, each arriving 5 s after its camera time and so much later."""
    health = None
    for i, frame in enumerate(frames):
        health = judge(frame, frame.raw.time_s + 5.0 + (late_s[i] if late_s else 0.0), health, settings)
    assert health is not None
    return health


def share(count: int, inside: Any, outside: Any) -> np.ndarray:
    """(10, 10) with one value in so many pixels and another in the rest."""
    return np.where(np.arange(100).reshape(10, 10) < count, inside, outside)


def test_a_clear_image_has_no_fault_and_its_numbers_are_shares() -> None:
    health = judged(frame_of())
    assert (health.faults, health.seen, health.saturated, health.near, health.unchanged) == ((), 1.0, 0.0, 0.0, 0.0)
    assert (health.lateness_s, health.repeats, health.received_s, health.fastest_s) == (0.0, 0, 5.0, 5.0)


@pytest.mark.parametrize(("count", "faults"), [(30, ()), (31, (Fault.SATURATED,))])
def test_too_much_light_in_too_many_pixels_is_a_fault(count: int, faults: tuple[Fault, ...]) -> None:
    health = judged(frame_of(why=share(count, Why.SATURATED, Why.VALID)))
    assert health.faults == faults
    assert health.saturated == pytest.approx(count / 100)


@pytest.mark.parametrize("why", [Why.VALID, Why.FLOOR, Why.OUTSIDE_AREA])
@pytest.mark.parametrize(("count", "faults"), [(5, ()), (4, (Fault.BLOCKED,))])
def test_an_image_that_shows_hardly_anything_is_blocked(why: Why, count: int, faults: tuple[Fault, ...]) -> None:
    health = judged(frame_of(why=share(count, why, Why.LOW_AMPLITUDE)))
    assert health.faults == faults
    assert health.seen == pytest.approx(count / 100)


@pytest.mark.parametrize("why", [Why.NO_SIGNAL, Why.SATURATED, Why.SENSOR_FLAG, Why.FLYING, Why.WRAPPED])
def test_pixels_that_measured_nothing_are_not_seen(why: Why) -> None:
    assert judged(frame_of(why=why)).seen == 0.0
    assert Fault.BLOCKED in judged(frame_of(why=why)).faults


@pytest.mark.parametrize(("count", "faults"), [(50, ()), (51, (Fault.BLOCKED,))])
def test_a_surface_on_the_lens_blocks_it(count: int, faults: tuple[Fault, ...]) -> None:
    assert judged(frame_of(range_m=share(count, 0.049, 0.05))).faults == faults
    assert judged(frame_of(range_m=share(count, 0.049, np.nan))).near == pytest.approx(count / 100)


def test_an_image_of_no_pixels_is_blocked() -> None:
    empty = frame_of(planes={}, shape=(0, 0))
    assert judged(empty).faults == (Fault.BLOCKED,)


def samples(seed: int, unchanged: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return share(unchanged, 1000.0, rng.normal(2000, 1, (10, 10)))


@pytest.mark.parametrize(("unchanged", "frozen"), [(98, True), (97, False)])
def test_samples_without_noise_are_frozen_from_the_second_repetition_on(unchanged: int, frozen: bool) -> None:
    frames = [frame_of({"a": samples(i, unchanged)}, time_s=0.1 * i) for i in range(4)]
    assert judged(*frames[:2]).faults == ()
    health = judged(*frames[:3])
    assert health.unchanged == pytest.approx(unchanged / 100)
    assert health.faults == ((Fault.FROZEN,) if frozen else ())
    assert judged(*frames).repeats == (3 if frozen else 0)


def test_one_image_with_noise_ends_the_freeze() -> None:
    still, alive = {"a": samples(0)}, {"a": samples(1)}
    assert judged(*[frame_of(p) for p in (still, still, still)]).faults == (Fault.FROZEN,)
    assert judged(*[frame_of(p) for p in (still, still, alive, still, still)]).faults == ()


def test_only_pixels_that_measured_can_freeze() -> None:
    why = share(50, Why.LOW_AMPLITUDE, Why.VALID)
    frames = [frame_of({"a": samples(i, 50)}, why=why) for i in range(3)]
    assert judged(*frames).unchanged == 0.0
    assert judged(*[frame_of({"a": samples(0)}, why=Why.LOW_AMPLITUDE) for _ in range(3)]).unchanged == 0.0


@pytest.mark.parametrize("name", ["reference_range_m", "temperature_c", "status", "n_acc", "dark_1"])
def test_planes_that_may_stay_as_they_are_do_not_freeze_an_image(name: str) -> None:
    frames = [frame_of({name: samples(0), "a": samples(i)}) for i in range(3)]
    assert judged(*frames).unchanged == 0.0


def test_planes_that_cannot_be_compared_do_not_count() -> None:
    still = samples(0)
    assert judged(frame_of({"a": still}), frame_of({"b": still, "a": still})).unchanged == 1.0
    assert judged(frame_of({"a": still}), frame_of({"b": still})).unchanged == 0.0
    assert judged(frame_of({"a": still[:5]}), frame_of({"a": still})).unchanged == 0.0
    assert judged(frame_of({"a": still[:5], "b": still}), frame_of({"a": still[:5], "b": still})).unchanged == 1.0
    assert (
        judged(frame_of({"a": np.zeros((5, 10)), "b": samples(1)}), frame_of({"a": still, "b": still})).unchanged == 0
    )
    mixed = [frame_of({"a": still, "b": samples(i)}) for i in range(2)]
    assert judged(*mixed).unchanged == 0.5


@pytest.mark.parametrize(("late", "faults"), [(0.0625, ()), (0.0626, (Fault.LATE,))])
def test_an_image_that_takes_much_longer_than_the_fastest_is_late(late: float, faults: tuple[Fault, ...]) -> None:
    settings = HealthSettings(max_lateness_s=0.0625, clock_drift=0.0)
    frames = [frame_of({}, time_s=float(i)) for i in range(3)]
    health = judged(*frames, settings=settings, late_s=(0.5, 0.0, late))
    assert health.faults == faults
    assert health.lateness_s == pytest.approx(late)
    assert health.fastest_s == 5.0


def test_an_image_without_camera_time_is_late() -> None:
    assert judged(frame_of({}), frame_of({}, time_s=math.nan)).faults == (Fault.LATE,)


def test_clocks_may_drift_apart_but_not_faster_than_stated() -> None:
    for drift, late in ((0.9e-4, False), (2.1e-4, True)):
        health = None
        for i in range(2000):
            health = judge(frame_of({}, time_s=float(i)), i * (1 + drift) + 5.0, health, SETTINGS)
        assert health is not None
        assert (health.faults == (Fault.LATE,)) == late


def test_a_clock_of_ours_that_jumps_back_does_not_count_as_drift() -> None:
    first = judge(frame_of({}, time_s=0.0), 1000.0, None, SETTINGS)
    assert judge(frame_of({}, time_s=900.0), 0.0, first, SETTINGS).fastest_s == -900.0
    assert judge(frame_of({}, time_s=-1000.0), 500.0, first, SETTINGS).fastest_s == 1000.0


def test_the_gravest_fault_stands_first() -> None:
    dark = [frame_of({"a": samples(0)}, why=share(95, Why.SATURATED, Why.VALID), range_m=0.0) for _ in range(3)]
    health = judged(*dark, late_s=(0.0, 0.0, 9.0))
    assert health.faults == (Fault.LATE, Fault.SATURATED, Fault.BLOCKED, Fault.FROZEN)


def test_the_machine_is_told_what_it_needs_of_an_image() -> None:
    frame = frame_of(time_s=3.0, closing_mps=(1.0, 2.0, 9.0))
    seen = perceived(frame, judge(frame, 12.0, None, SETTINGS))
    assert (seen.frame_id, seen.time_s, seen.received_s) == (7, 3.0, 12.0)
    assert (seen.brake, seen.reason, seen.faults, seen.scene_speed_mps) == (True, "box", (), 2.0)
    blocked = frame_of(why=Why.NO_SIGNAL)
    assert perceived(blocked, judged(blocked)).faults == (Fault.BLOCKED,)


def test_a_scene_has_a_speed_only_with_three_confirmed_tracks() -> None:
    for frame in (frame_of(closing_mps=(1.0, 2.0)), frame_of(closing_mps=(1.0,) * 3, status=TrackStatus.TENTATIVE)):
        assert perceived(frame, judged(frame)).scene_speed_mps is None


# -- friction ---------------------------------------------------------------------------------------------------------


FRICTION = FrictionSettings()


def stopped(
    mu: float,
    known: Friction | None = None,
    noise_mps: float = 0.0,
    seed: int = 0,
    settings: FrictionSettings = FRICTION,
    v0: float = 5.0,
) -> Friction:
    """Friction after a stop from 5 m/s; the brakes bite after 0.1 s, car states come every 20 ms."""
    rng = np.random.default_rng(seed)
    friction = known or Friction()
    for i in range(400):
        t = i * 0.02
        speed = max(0.0, v0 - mu * 9.81 * max(0.0, t - 0.1)) + rng.normal(0, noise_mps)
        friction = observe(friction, CarState(speed, t), True, t, settings)
    return observe(friction, CarState(0.0, 8.0), False, 8.0, settings)


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.7])
def test_the_friction_of_a_stop_without_noise_is_exact(mu: float) -> None:
    found = stopped(mu)
    assert found.mu == pytest.approx(mu, rel=1e-9)
    assert math.isnan(found.began_s)
    assert found.n == 0


def test_its_sigma_is_that_of_the_slope_of_a_line() -> None:
    t = np.arange(5, 400) * 0.02
    t = t[5.0 - 0.3 * 9.81 * (t - 0.1) >= 0.3]
    expected = 0.02 / math.sqrt(((t - t.mean()) ** 2).sum()) / 9.81
    assert stopped(0.3).sigma == pytest.approx(expected, rel=1e-6)
    found = np.array([stopped(0.3, noise_mps=0.02, seed=seed).mu for seed in range(150)])
    assert found.mean() == pytest.approx(0.3, abs=4 * expected / math.sqrt(150))
    assert found.std() == pytest.approx(expected, rel=0.25)  # 4 sigma of a standard deviation from 150 values


def test_two_stops_are_weighted_with_the_change_between_them() -> None:
    first = stopped(0.3)
    second = stopped(0.7, known=first)
    prior, new = first.sigma**2 + 0.05**2, stopped(0.7).sigma ** 2
    assert second.mu == pytest.approx((0.3 / prior + 0.7 / new) / (1 / prior + 1 / new))
    assert second.sigma == pytest.approx((1 / prior + 1 / new) ** -0.5)


@pytest.mark.parametrize(
    "stop",
    [
        lambda known: stopped(0.3, known, v0=0.2),  # too slow
        lambda known: stopped(-0.01, known),  # faster instead of slower
        lambda known: stopped(0.3, known, noise_mps=0.2),  # no line
        lambda known: stopped(0.3, known, noise_mps=math.nan),
        lambda known: stopped(3.0, known, v0=1.0),  # over before five speeds
        lambda known: observe(known, CarState(1.0, 0.0), False, 0.0, FRICTION),
    ],
)
def test_a_stop_that_says_nothing_changes_nothing(stop: Any) -> None:
    known = Friction(0.4, 0.01)
    assert repr(stop(known)) == repr(known)


def test_a_car_state_counts_once_and_not_before_the_brakes_bite() -> None:
    friction = Friction()
    for time_s, counted in ((1.0, 0), (1.05, 0), (1.125, 1), (1.125, 1), (1.25, 2)):
        friction = observe(friction, CarState(2.0, time_s), True, time_s, FrictionSettings(brake_delay_s=0.125))
        assert friction.n == counted
    friction = observe(friction, CarState(0.29, 1.5), True, 1.5, FRICTION)
    assert (friction.n, friction.heard_s, friction.began_s) == (2, 1.25, 1.0)
    friction = observe(friction, CarState(0.3, 1.6), True, 1.6, FRICTION)
    assert friction.n == 3


@pytest.mark.parametrize(("needed", "known"), [(4, True), (5, False)])
def test_how_many_speeds_a_stop_needs_can_be_set(needed: int, known: bool) -> None:
    settings = FrictionSettings(brake_delay_s=0.0, min_speeds=needed)
    friction = observe(Friction(), CarState(9.0, 0.0), True, 0.0, settings)
    for i in range(1, 5):
        friction = observe(friction, CarState(3 - 0.3 * i, 0.1 * i), True, 0.1 * i, settings)
    friction = observe(friction, CarState(0.0, 1.0), False, 1.0, settings)
    assert friction.mu == pytest.approx(3 / 9.81 if known else 0.0)


@pytest.mark.parametrize(("misfit", "known"), [(0.99, False), (1.01, True)])
def test_how_far_speeds_may_scatter_can_be_set(misfit: float, known: bool) -> None:
    settings = FrictionSettings(brake_delay_s=0.0, min_speeds=3, speed_sigma_mps=0.1, max_misfit=misfit)
    friction = observe(Friction(), CarState(9.0, 0.0), True, 0.0, settings)
    error = math.sqrt(0.01 / 6)  # residuals e, -2 e, e of three speeds: a variance of 6 e2 with one degree of freedom
    for i, off in enumerate((1, -2, 1), start=1):
        friction = observe(friction, CarState(3 - 0.3 * i + off * error, 0.1 * i), True, 0.1 * i, settings)
    assert (observe(friction, CarState(0.0, 1.0), False, 1.0, settings).mu > 0) == known


def test_the_decision_uses_the_estimate_less_its_uncertainty() -> None:
    decision = DecisionSettings(friction=0.3, deceleration_mps2=5.0)
    used = with_friction(decision, Friction(0.5, 0.05), FRICTION)
    assert used.friction == pytest.approx(0.4)
    assert used.deceleration_mps2 is None
    for unknown in (Friction(), Friction(0.1, 0.05)):
        assert with_friction(decision, unknown, FRICTION) is decision
