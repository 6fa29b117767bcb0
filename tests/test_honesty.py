"""What is stated of collisions, over simulated drives through the whole chain; `rangecam study honesty` takes more."""

import math

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.scene.paths import motion
from rangecam.studies.honesty import OVERCONFIDENT, WELL_MODELLED, binomial_bounds, draw_drive, drive, drives


def test_a_drive_ends_as_its_truth_says() -> None:
    """The nearest surface is at our front when it arrives, and the outlines overlap at some time if they hit."""
    config = load_config("usercams", WELL_MODELLED)
    hits = 0
    for seed in range(12):
        drawn = draw_drive(np.random.default_rng(seed), config)
        thing, own = drawn.scenario.objects[0], drawn.scenario.ego.speed_mps
        assert drawn.seen_s < drawn.arrives_s
        x, y, _ = motion(thing.path, drawn.arrives_s).position_m
        assert x - own * drawn.arrives_s == pytest.approx(0.0, abs=0.3)  # it moves up to 0.25 m in a step of time
        aside = abs(y) - (config.decision.corridor.width_m + thing.boxes[0].size_m[1]) / 2
        assert drawn.hits or aside > -0.01
        hits += drawn.hits
    assert 0 < hits < 12


def test_a_drive_is_the_same_for_the_same_seed() -> None:
    one, same, other = (drive(seed, (WELL_MODELLED,)) for seed in (3, 3, 4))
    assert one is not None
    assert same is not None
    assert other is not None
    assert (one.p_collision, one.ttc_s, *one.quantiles_s) == (same.p_collision, same.ttc_s, *same.quantiles_s)
    assert one.ttc_s != other.ttc_s


def test_intervals_and_probabilities_hold_and_a_wrong_model_shows() -> None:
    told = drives(40, 500)
    assert len(told) >= 36
    inside = [each.quantiles_s[0] <= each.ttc_s <= each.quantiles_s[4] for each in told]
    low, high = binomial_bounds(sum(inside), len(inside), 0.999)
    assert low <= 0.95 <= high
    said, came = (np.array([getattr(each, key) for each in told], float) for key in ("p_collision", "hits"))
    expected_brier = np.mean(said * (1 - said))
    spread = math.sqrt(np.mean(said * (1 - said) * (1 - 2 * said) ** 2) / len(said))
    assert np.mean((said - came) ** 2) <= expected_brier + 4 * spread + 0.02
    nis, wrong = (
        np.concatenate([each.nis for each in outcomes])
        for outcomes in (told, drives(6, 500, (WELL_MODELLED, OVERCONFIDENT)))
    )
    assert 0.15 < nis.mean() / 3 < 1.3  # below 1: what errs alike for several frames is stated as if anew in each
    assert wrong.mean() / 3 > 2


def test_several_processes_find_what_one_finds() -> None:
    one, two = drives(3, 7), drives(3, 7, jobs=2)
    assert [each.p_collision for each in one] == [each.p_collision for each in two]


@pytest.mark.parametrize(("hits", "count"), [(0, 10), (3, 10), (10, 10), (50, 200)])
def test_binomial_bounds_leave_as_much_outside_as_they_say(hits: int, count: int) -> None:
    """At each bound so few hits, or so many, have just the probability of a tail."""
    from scipy.stats import binom

    low, high = binomial_bounds(hits, count, 0.9)
    if hits > 0:
        assert binom.sf(hits - 1, count, low) == pytest.approx(0.05)
    if hits < count:
        assert binom.cdf(hits, count, high) == pytest.approx(0.05)
    assert (low == 0) == (hits == 0)
    assert (high == 1) == (hits == count)
