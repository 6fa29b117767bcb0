"""Whether an image is to be trusted, and what a stop says of the friction."""

import dataclasses
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import curve_fit

from rangecam.brake.friction import Friction, FrictionSettings, Gap, _misfit, _slopes, after_stop, cautious, observe
from rangecam.brake.health import Health, HealthSettings, judge, perceived
from rangecam.brake.machine import Fault, Perception
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


def test_the_shares_of_a_single_pixel_are_all_or_nothing() -> None:
    health = judged(frame_of(why=Why.SATURATED, range_m=0.01, shape=(1, 1)))
    assert (health.seen, health.saturated, health.near) == (0.0, 1.0, 1.0)
    assert judged(frame_of(shape=(0, 0))).near == 0.0


def test_healths_with_their_images_are_not_compared() -> None:
    health = judged(frame_of())
    assert health != replace(health)


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


def test_the_machine_is_told_the_free_way_to_what_was_decided_on_and_of_nothing_that_it_is_far() -> None:
    frame = frame_of()
    decided = replace(frame.decision, track_id=4, distance_m=1.5, closing_speed_mps=0.7)
    some = perceived(replace(frame, decision=decided), judged(frame))
    assert (some.track_id, some.distance_m, some.closing_mps) == (4, 1.5, 0.7)
    none = perceived(replace(frame, decision=replace(decided, track_id=0)), judged(frame))
    assert (none.track_id, none.distance_m, none.closing_mps) == (0, math.inf, 0.0)


def test_a_scene_has_a_speed_only_with_three_confirmed_tracks() -> None:
    for frame in (frame_of(closing_mps=(1.0, 2.0)), frame_of(closing_mps=(1.0,) * 3, status=TrackStatus.TENTATIVE)):
        assert perceived(frame, judged(frame)).scene_speed_mps is None


# -- friction ---------------------------------------------------------------------------------------------------------


FRICTION = FrictionSettings()


def seen(time_s: float, gap_m: float, track_id: int = 7) -> Perception:
    return Perception(round(time_s * 1000), time_s, time_s + 0.1, False, "box", track_id=track_id, distance_m=gap_m)


def stopped(
    mu: float,
    known: Friction | None = None,
    noise_m: float = 0.0,
    seed: int = 0,
    s: FrictionSettings = FRICTION,
    v0: float = 3.0,
    object_mps: float = 0.0,
    gain_mps2: float = 0.0,
    tracks: tuple[int, int] = (7, 7),
    until_s: float = 9.0,
    period_s: float = 1 / 30,
) -> Friction:
    """What is known after braking from v0 at 1 s; the brakes bite 0.1 s later, and 1.5 m before an object we stand.

    tracks: of the object in the images before 1.3 s and in those after; gain_mps2: the speed rises until 1 s;
    until_s: images until then.
    """
    rng = np.random.default_rng(seed)
    friction = known or Friction()
    a = mu * 9.81
    way_m = v0 * 1.1 + v0**2 / (2 * a)
    for time_s in np.arange(0.2, until_s, period_s).tolist():
        braked_s = min(max(0.0, time_s - 1.1), v0 / a if a > 0 else math.inf)
        rolled_s = min(time_s, 1.1)
        before_mps = v0 + gain_mps2 * (min(time_s, 1.0) - 1.0)
        gone_m = v0 * rolled_s + v0 * braked_s - a * braked_s**2 / 2
        gap_m = 1.5 + way_m - gone_m + object_mps * time_s + rng.normal(0, noise_m)
        look = seen(time_s, gap_m, tracks[time_s > 1.3])
        friction = observe(friction, look, before_mps if time_s < 1 else 0.0, time_s >= 1, s)
    return observe(friction, look, 0.0, False, s)


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.7])
def test_the_friction_of_a_stop_without_noise_is_exact_though_its_wheels_lock(mu: float) -> None:
    found = stopped(mu)
    assert found.mu == pytest.approx(mu, rel=1e-6)
    assert (found.gaps, found.braking, found.track_id) == ((), False, 0)


def test_its_sigma_is_that_of_many_stops() -> None:
    sharp = replace(FRICTION, model=0.0)
    found = [stopped(0.5, noise_m=0.02, seed=seed, s=sharp) for seed in range(100)]
    mus, sigmas = np.array([each.mu for each in found]), np.array([each.sigma for each in found])
    assert mus.mean() == pytest.approx(0.5, abs=4 * mus.std() / 10)
    assert mus.std() == pytest.approx(np.sqrt((sigmas**2).mean()), rel=0.3)  # 4 sigma of a standard deviation
    wide = stopped(0.5, noise_m=0.02, s=replace(FRICTION, model=0.1))
    assert wide.sigma == pytest.approx(math.hypot(found[0].sigma, 0.1 * wide.mu), rel=1e-6)


def test_free_ways_scatter_at_least_as_they_are_told() -> None:
    sharp, coarse = (stopped(0.5, s=replace(FRICTION, model=0.0, distance_sigma_m=each)) for each in (0.01, 0.02))
    assert coarse.sigma == pytest.approx(2 * sharp.sigma, rel=1e-4)


def stop_of(times_s: list[float], noise_m: float = 0.0, before_mps: float = 2.0) -> Friction:
    """A stop from 2 m/s with 2 m/s2 that bites at 1 s, under way; before it we drove with `before_mps`."""
    rng = np.random.default_rng(3)
    gaps = []
    for time_s in times_s:
        since_s = min(time_s - 1, 1.0)
        gap_m = 4.0 - 2.0 * since_s + max(since_s, 0.0) ** 2 + rng.normal(0, noise_m)
        gaps.append(Gap(time_s, gap_m, before_mps if time_s < 1 else 0.0))
    return Friction(speed_mps=2.0, track_id=7, gaps=tuple(gaps), braking=True, before=sum(t < 1 for t in times_s))


def test_the_sigma_of_a_stop_is_that_of_a_general_fit_of_the_same_curve() -> None:
    def way(time_s: Any, a: float, bites_s: float, bites_m: float) -> Any:
        since_s = np.minimum(time_s - bites_s, 2.0 / a)
        return bites_m - 2.0 * since_s + a * np.maximum(since_s, 0) ** 2 / 2

    stop = stop_of(np.arange(0.6, 2.4, 1 / 30).tolist(), noise_m=0.02)
    time_s, gap_m, _ = np.array(stop.gaps).T
    best, covariance = curve_fit(way, time_s, gap_m, p0=(2.0, 1.0, 4.0))
    found = after_stop(stop, replace(FRICTION, model=0.0))
    assert found.mu == pytest.approx(best[0] / 9.81, rel=1e-5)
    assert found.sigma == pytest.approx(math.sqrt(covariance[0, 0]) / 9.81, rel=1e-3)


@pytest.mark.parametrize("a", [0.7, 2.0, 5.0])
def test_the_derivatives_of_the_fit_are_those_of_differences(a: float) -> None:
    time_s, known = np.linspace(0.2, 3.0, 41), np.array([a, 1.03, 4.0])
    seen_m = np.zeros(41)
    steps = [1e-6 * direction for direction in np.eye(3)]
    apart = [
        (_misfit(known + step, time_s, seen_m, 2.0) - _misfit(known - step, time_s, seen_m, 2.0)) / 2e-6
        for step in steps
    ]
    np.testing.assert_allclose(_slopes(known, time_s, seen_m, 2.0), np.transpose(apart), atol=1e-6)


def test_two_images_before_the_brakes_bite_and_six_until_standstill_are_enough_and_no_fewer() -> None:
    early, between = [0.8, 0.9], [1.1, 1.2, 1.4, 1.5, 1.7, 1.8]
    assert after_stop(stop_of(early + between), FRICTION).mu == pytest.approx(2.0 / 9.81, rel=1e-4)
    for times_s in (early[1:] + between, early + between[1:], [0.7, *early, *between[1:]], [0.9, *between, 1.9]):
        assert after_stop(stop_of(times_s), FRICTION).mu == 0.0, times_s


def test_our_speed_may_have_changed_before_the_braking_by_its_limit_and_no_more() -> None:
    stop = stop_of([0.8, 0.9, 1.1, 1.2, 1.4, 1.5, 1.7, 1.8], before_mps=2.5)
    assert after_stop(stop, replace(FRICTION, steady=0.25)).mu > 0
    assert after_stop(stop, replace(FRICTION, steady=0.2)).mu == 0.0


def test_two_stops_are_weighted_with_the_change_between_them() -> None:
    first, alone = stopped(0.3), stopped(0.7)
    second = stopped(0.7, known=first)
    prior, new = first.sigma**2 + 0.05**2, alone.sigma**2
    assert second.mu == pytest.approx((first.mu / prior + alone.mu / new) / (1 / prior + 1 / new))
    assert second.sigma == pytest.approx((1 / prior + 1 / new) ** -0.5)


def test_a_stop_that_ends_before_standstill_counts_as_well() -> None:
    assert stopped(0.15, until_s=1.8).mu == pytest.approx(0.15, rel=1e-6)


@pytest.mark.parametrize(
    "stop",
    [
        lambda known: stopped(0.3, known, v0=0.7),  # too slow
        lambda known: stopped(0.3, known, noise_m=0.2),  # looks otherwise
        lambda known: stopped(0.3, known, object_mps=-0.9),  # the object comes towards us
        lambda known: stopped(0.3, known, object_mps=0.9),  # or drives on
        lambda known: stopped(0.3, known, gain_mps2=2.0),  # we were still gaining speed
        lambda known: stopped(-0.01, known, until_s=3.0),  # nothing slowed us down
        lambda known: stopped(3.0, known, v0=1.0),  # over before six images
        lambda known: stopped(0.3, known, until_s=1.25),  # images end too early
        lambda known: stopped(0.3, known, tracks=(7, 8)),  # another object
        lambda known: stopped(0.3, known, tracks=(0, 7)),  # none before
        lambda known: stopped(0.3, known, noise_m=math.nan),
    ],
)
def test_a_stop_that_says_nothing_changes_nothing(stop: Any) -> None:
    known = Friction(0.4, 0.01)
    found = stop(known)
    assert (found.mu, found.sigma) == (0.4, 0.01)


def test_only_new_images_of_the_last_moments_are_kept_before_a_stop_and_all_of_it() -> None:
    friction = Friction()
    for time_s in (1.0, 1.2, 1.2, 1.1, 1.5):
        friction = observe(friction, seen(time_s, 3.0), 2.0, False, FRICTION)
    assert [each.time_s for each in friction.gaps] == [1.2, 1.5]
    assert friction.speed_mps == 2.0
    friction = observe(friction, seen(1.5, 9.0, 8), 2.0, False, FRICTION)
    assert friction.track_id == 7
    friction = observe(friction, seen(1.6, 9.0, 8), 2.0, False, FRICTION)
    assert (friction.track_id, len(friction.gaps)) == (8, 1)
    friction = observe(friction, seen(1.7, 9.0, 0), 2.0, False, FRICTION)
    assert friction.track_id == 8
    for time_s in (1.9, 3.0):
        friction = observe(friction, seen(time_s, 2.0, 8), 1.0, True, FRICTION)
    assert (friction.speed_mps, friction.before, len(friction.gaps)) == (2.0, 1, 3)


def test_of_a_stop_that_does_not_end_no_more_than_so_many_images_are_kept() -> None:
    friction = Friction()
    for k in range(700):
        friction = observe(friction, seen(k / 30, 3.0), 2.0, k > 3, FRICTION)
    assert len(friction.gaps) == 600


def test_at_first_nothing_is_known_and_the_first_track_counts() -> None:
    assert Friction() == Friction(0.0, math.inf, 0.0, 0, (), False, 0)
    friction = observe(Friction(), seen(1.0, 3.0, 1), 2.0, False, FRICTION)
    assert (friction.track_id, len(friction.gaps)) == (1, 1)
    friction = observe(friction, seen(1.4, 2.2, 1), 2.0, False, replace(FRICTION, before_s=1.4 - 1.0))
    assert len(friction.gaps) == 2


def test_a_stop_in_which_the_object_changes_goes_on_without_one_and_without_a_stop_nothing_is_concluded() -> None:
    friction = Friction()
    for k in range(90):  # 3 m/s, from 1 s on 3 m/s2 less: it stands at 2 s
        time_s = k / 30
        braked_s = min(max(time_s - 1, 0.0), 1.0)
        gap_m = 9.0 - 3.0 * min(time_s, 1.0) - 3.0 * braked_s + 1.5 * braked_s**2
        friction = observe(friction, seen(time_s, gap_m), 3.0 if time_s < 1 else 0.0, time_s >= 1, FRICTION)
    assert after_stop(friction, FRICTION).mu == pytest.approx(3.0 / 9.81, rel=1e-4)
    assert after_stop(replace(friction, braking=False), FRICTION).mu == 0.0
    friction = observe(friction, seen(3.1, 2.0, 1), 0.0, True, FRICTION)
    assert (friction.track_id, friction.gaps) == (0, ())


@pytest.mark.parametrize(("limit", "known"), [({"min_images": 12}, True), ({"min_images": 13}, False)])
def test_how_many_images_a_stop_needs_can_be_set(limit: dict[str, Any], known: bool) -> None:
    assert (stopped(0.75, s=replace(FRICTION, **limit)).mu > 0) == known  # it lasts 0.408 s: 12 periods of 33.3 ms


@pytest.mark.parametrize(
    ("limit", "told"),
    [
        ({"min_speed_mps": 3.0}, {}),
        ({"max_misfit_m": 0.025}, {"noise_m": 0.02}),
        ({"steady": 0.3}, {"gain_mps2": 2.0}),
        ({"standing": 0.12}, {"object_mps": 0.3, "until_s": 2.0}),
    ],
)
def test_what_a_stop_must_be_like_can_be_set(limit: dict[str, float], told: dict[str, Any]) -> None:
    assert stopped(0.3, s=replace(FRICTION, **limit), **told).mu > 0
    first, *_ = limit
    stricter = {**limit, first: limit[first] * (1.1 if first == "min_speed_mps" else 0.6)}
    assert stopped(0.3, s=replace(FRICTION, **stricter), **told).mu == 0


def test_what_is_reckoned_with_is_the_estimate_less_its_uncertainty_if_that_is_wanted() -> None:
    adapting = FrictionSettings(adapt=True)
    assert cautious(Friction(0.5, 0.05), adapting) == pytest.approx(0.4)
    assert cautious(Friction(), adapting) is cautious(Friction(0.1, 0.05), adapting) is None
    assert cautious(Friction(0.5, 0.05), FRICTION) is None
