"""Training: drives of known things, examples of them, trees taken out of the library that grew them, scores."""

import json
from functools import cache

import numpy as np
import pytest

from rangecam.classify.features import FEATURES
from rangecam.classify.learned import load_model, probabilities
from rangecam.cli import main
from rangecam.errors import UsageError
from rangecam.training import lots
from rangecam.training.drives import KINDS, DriveSettings, random_drive
from rangecam.training.examples import Examples, Lot, joined, simulated
from rangecam.training.fit import _grow, _taken_out, fit
from rangecam.training.lots import HELD_OUT, held_out_lots, learning_lots, told
from rangecam.training.score import confusion, reliability, resolved, right_of_all, right_share, score
from rangecam.types import Cut


def made_up(count, rng):
    """Examples of three classes that differ in one feature, whose truth is drawn with known probabilities."""
    features = rng.standard_normal((count, len(FEATURES))).round(1)  # of few values thresholds are found in no time
    odds = np.exp(2 * np.stack([features[:, 0], np.zeros(count), -features[:, 0]], axis=1))
    shares = odds / odds.sum(axis=1, keepdims=True)
    classes = 1 + (rng.random(count)[:, None] > np.cumsum(shares, axis=1)).sum(axis=1)
    return Examples(
        *(features, classes, np.eye(4)[classes], np.full(count, 5.0)),
        *(np.full((count, 2), 9), np.zeros(count, int), np.ones(count), classes.astype(str), np.arange(count)),
    ), shares


def test_a_drive_is_drawn_by_its_numbers_alone_and_knows_the_class_of_each_object():
    one, again = (random_drive("road_cw", DriveSettings(), np.random.default_rng([3, 4])) for _ in range(2))
    assert one == again
    assert len(one.classes) == len(one.kinds) == len(one.scenario.objects)
    by_name = {kind.name: kind.class_ for kind in KINDS}
    assert all(by_name[kind] == class_ for kind, class_ in zip(one.kinds, one.classes, strict=True))


def test_drives_held_out_share_no_seed_with_those_learned_from():
    learned = {(lot.seed, number) for lot in learning_lots(50, 1) for number in lot.numbers}
    for name in HELD_OUT:
        held = {(lot.seed, number) for lot in held_out_lots(name, 50, 1) for number in lot.numbers}
        assert len(held) == 50
        assert not held & learned


def test_the_chain_sees_things_of_a_drive_whose_class_the_truth_tells():
    examples = joined([simulated(Lot("usercams", DriveSettings(field_deg=27.0), 5, range(2))) for _ in range(2)])
    assert len(examples) > 10
    assert np.isfinite(examples.features).all()
    assert set(examples.classes) <= {1, 2, 3}
    np.testing.assert_allclose(examples.given.sum(axis=1), 1)
    assert (examples.pixels > 0).all()
    assert ((examples.share > 0) & (examples.share <= 1)).all()
    assert len(np.unique(examples.drives)) in (2, 4)
    half = len(examples) // 2
    np.testing.assert_array_equal(examples.features[:half], examples.features[half:])
    assert not set(examples.drives[:half]) & set(examples.drives[half:])


def test_trees_taken_out_say_what_the_library_says():
    examples, _ = made_up(900, np.random.default_rng(1))
    grown = _grow(examples.features, examples.classes - 1, np.ones(900), 1, 40)
    np.testing.assert_allclose(
        probabilities(examples.features, _taken_out(grown)), grown.predict_proba(examples.features), atol=1e-4
    )


@cache
def fitted():
    return fit(made_up(4000, np.random.default_rng(2))[0], 1, 60)


def test_fitted_probabilities_are_those_of_classes_that_come_alike():
    model = fitted()
    others, shares = made_up(4000, np.random.default_rng(8))
    alike = shares / shares.mean(axis=0)
    alike /= alike.sum(axis=1, keepdims=True)
    said = probabilities(others.features, model)
    assert np.abs(said - alike).mean() < 0.1
    assert np.abs((said - alike).mean(axis=0)).max() < 0.05


def test_a_class_without_examples_is_refused():
    examples, _ = made_up(50, np.random.default_rng(3))
    lacking = Examples(**{**vars(examples), "classes": np.ones(50, int)})
    with pytest.raises(UsageError, match="no example of vehicle, obstacle"):
        fit(lacking, 1, 1)


def test_scores_count_what_is_decided_and_what_is_right():
    classes = np.array([1, 1, 2, 3])
    probability = np.array([[0.1, 0.9, 0, 0], [0.6, 0.4, 0, 0], [0, 0.8, 0.2, 0], [0.2, 0, 0, 0.8]])
    assert right_share(classes, probability) == (pytest.approx(2 / 3), 0.75)
    assert right_of_all(classes, probability) == 0.5
    np.testing.assert_array_equal(confusion(classes, probability), [[1, 1, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    curve = reliability(classes, probability, groups=1)
    assert curve.number.tolist() == [4]
    assert curve.right[0] == 0.75
    assert curve.told[0] == pytest.approx((1 + 1 + 0.8 + 1) / 4)


def test_an_object_is_resolved_if_pixels_sides_range_and_segment_allow():
    examples, _ = made_up(7, np.random.default_rng(4))
    examples.pixels[0], examples.pixels[1] = (3, 9), (9, 3)
    examples.cut[2], examples.cut[3] = int(Cut.OCCLUDED), int(Cut.TOP | Cut.BOTTOM)
    examples.range_m[4], examples.range_m[5], examples.share[6] = 1.9, 15.1, 0.4
    assert resolved(examples).tolist() == [False, False, False, True, False, False, False]
    assert resolved(examples, whole=False).tolist() == [False, False, False, True, False, False, True]


def test_a_score_says_of_all_and_of_what_is_resolved_how_much_is_right():
    examples, _ = made_up(4, np.random.default_rng(5))
    right = np.eye(4)[examples.classes]
    probability = np.where([[True], [False], [True], [True]], right, np.eye(4)[0])  # the second is unknown
    examples.cut[0] = int(Cut.LEFT)
    scored = score(examples, probability)
    assert (scored["right_of_all"], scored["right"], scored["decided"]) == (0.75, 1.0, 0.75)
    assert scored["resolved"]["examples"] == 3
    assert scored["resolved"]["right_of_all"] == pytest.approx(2 / 3, abs=1e-4)
    examples.cut[:] = int(Cut.LEFT)
    assert score(examples, probability)["resolved"]["right_of_all"] is None


def test_what_is_not_resolved_must_be_surer_to_be_no_unknown():
    examples, _ = made_up(400, np.random.default_rng(6))
    model = fitted()
    for name, value in (("log_columns", np.log(8)), ("log_rows", np.log(8)), ("cut_beside", 0.0), ("occluded", 0.0)):
        examples.features[:, FEATURES.index(name)] = value
    clear = told(examples, model)
    most = clear[:, 1:].max(axis=1) / clear[:, 1:].sum(axis=1)
    assert ((clear.argmax(axis=1) == 0) == (most < 0.5)).all()
    for name, value in (("log_columns", np.log(3)), ("log_rows", np.log(3)), ("cut_beside", 1.0), ("occluded", 1.0)):
        poor = Examples(**{**vars(examples), "features": examples.features.copy()})
        poor.features[:, FEATURES.index(name)] = value
        said = told(poor, model)
        most = said[:, 1:].max(axis=1) / said[:, 1:].sum(axis=1)
        assert ((said.argmax(axis=1) == 0) == (most < 0.85)).all()
        assert 0.1 < (said.argmax(axis=1) == 0).mean() < 0.99


def test_the_command_trains_by_its_options_writes_the_model_and_says_how_good_it_is(tmp_path, monkeypatch, capsys):
    """Drives are made up here: those of the shipped model take tens of minutes."""
    asked = []

    def simulated_lots(given, over):
        asked.append(given)
        return made_up(600, np.random.default_rng(len(asked)))[0]

    monkeypatch.setattr(lots, "simulate", simulated_lots)
    path = tmp_path / "model.npz"
    told_by = ["--drives", "30", "--held-out", "5", "--rounds", "4", "--seed", "3", "--jobs", "1"]
    main(["train", str(path), *told_by])
    assert asked[0] == learning_lots(30, 3)
    assert asked[1:] == [held_out_lots(name, 5, 3) for name in HELD_OUT]
    assert len(load_model(str(path)).roots) == 3 * 4
    assert "CW, rain" in capsys.readouterr().out
    main(["train", *told_by, "--json"])
    scored = json.loads(capsys.readouterr().out)
    assert scored["model"] is None
    assert set(HELD_OUT) <= set(scored["scores"])
