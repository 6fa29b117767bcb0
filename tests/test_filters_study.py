"""The study of the filters: what its claims must say."""

import numpy as np
import pytest

from rangecam.clean import FILTERS
from rangecam.studies.filters import filters


@pytest.fixture(scope="module")
def study():
    return filters(np.random.default_rng(7))


def value(study, text):
    (claim,) = [claim for claim in study.claims if text in claim.text]
    return claim.computed


def test_every_claim_with_a_rule_agrees(study):
    assert [claim.text for claim in study.claims if claim.agrees is False] == []


def test_noise_left_by_linear_filters_is_that_of_their_weights_whatever_the_slope(study):
    """Mean of nine: 1/3; the bell of 25: root of the sum of its squared weights."""
    for where in ("seen squarely", "2 sigma/pixel"):
        assert value(study, f"off: noise left {'on a wall ' if where[0] == 's' else 'at a slope of '}{where}") == (
            pytest.approx(1, abs=0.03)
        )
        assert value(study, f"mean: noise left {'on a wall ' if where[0] == 's' else 'at a slope of '}{where}") == (
            pytest.approx(1 / 3, rel=0.05)
        )
    assert value(study, "median: noise left on a wall") == pytest.approx(np.sqrt(0.1661), rel=0.05)
    assert value(study, "median: noise left at a slope") > 1.3 * value(study, "median: noise left on a wall")


def test_rejection_takes_flying_pixels_and_hardly_any_good_one(study):
    assert value(study, "mixed ones, with rejection") < 0.2 * value(study, "mixed ones, without rejection")
    assert value(study, "lost, with rejection") < 0.5


def test_figure_shows_every_filter_in_both_panels(study):
    for panel in study.panels:
        assert {series.label for series in panel.series} == {"off", *FILTERS}
