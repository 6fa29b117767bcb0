"""The studies of corrections that need no calibration of each pixel: what their claims must say."""

import os
from pathlib import Path

import numpy as np
import pytest

from rangecam.studies import STUDIES, Panel, Picture, Series, Study, draw, run_study

DATA = Path(os.environ.get("RANGECAM_DATA", ""))
NAMES = ("cw-scattering", "cw-motion", "cw-flying", "cw-hdr", "cw-multipath")


@pytest.fixture(scope="module")
def studies():
    return {name: run_study(name) for name in NAMES}


def value(study, text):
    (claim,) = [claim for claim in study.claims if text in claim.text]
    return claim.computed


@pytest.mark.parametrize("name", NAMES)
def test_the_verdicts_do_not_hang_on_the_seed(name):
    assert [claim.text for claim in STUDIES[name](np.random.default_rng(1)).claims if claim.agrees is False] == []


def test_stray_light_of_one_percent_is_a_large_error_and_its_correction_leaves_a_thousandth(studies):
    study = studies["cw-scattering"]
    caused = value(study, "mean error of the wall by 1 %")
    assert caused > 100
    assert value(study, "left with the true lens") < 1e-3 * caused
    assert value(study, "fitted to recordings") < 0.02 * caused
    assert value(study, "left with stray fraction guessed +20 %") == pytest.approx(0.2 * caused, rel=0.2)


def test_adjacent_phases_contradict_each_other_where_something_moves(studies):
    study = studies["cw-motion"]
    for camera in ("differential, 0 90 180 270", "single-ended, 0 90 180 270"):
        assert value(study, f"{camera}: pixels with gross errors") > 20
        assert value(study, f"{camera}: gross errors left, of their sum, MOTION refused and cleaned") < 5
        assert value(study, f"{camera}: good pixels lost") < 1


def test_two_exposures_show_what_neither_shows(studies):
    study = studies["cw-hdr"]
    assert value(study, "0.2 ms: valid pixels, far and dark") == 0
    assert value(study, "valid pixels by two") > value(study, "best single") + 20


def test_no_gross_flying_pixel_is_left_and_real_tools_are_looked_at_where_they_are(studies, monkeypatch):
    assert studies["cw-flying"].claims[0].computed > 100
    assert value(studies["cw-flying"], "gross ones left by the rejection") == 0
    monkeypatch.delenv("RANGECAM_DATA", raising=False)
    without = run_study("cw-flying")
    assert [claim.text for claim in without.claims][-1] == "real recordings looked at"
    assert "RANGECAM_DATA names no folder" in without.claims[-1].why
    assert len(without.panels) == 3


@pytest.mark.skipif(not (DATA / "cw_mlx75027").is_dir(), reason="RANGECAM_DATA does not name a folder with cw_mlx75027")
def test_flying_pixels_of_real_tools_are_rejected_and_shown_before_and_after(studies):
    study = studies["cw-flying"]
    assert 2 < value(study, "real tools: flying pixels") < 8
    assert value(study, "real tools: such pixels left") < 1
    before, after = (panel.picture.values for panel in study.panels[-2:])
    assert np.isnan(after).sum() > np.isnan(before).sum()


def test_a_picture_is_drawn_within_its_limits_below_its_series():
    values = np.linspace(0, 1, 12).reshape(3, 4)
    panel = Panel("t", "column", "row", [], picture=Picture(values, "m", (0.0, 1.0)))
    over = Panel("t", "column", "row", [Series("place", [1.0], [1.0], line="o")], picture=panel.picture)
    other = Panel("t", "column", "row", [], picture=Picture(values, "m", (0.0, 2.0)))
    assert len({draw(Study("x", "s", [], [each])) for each in (panel, over, other)}) == 3
