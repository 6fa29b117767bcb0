"""How well things are told apart: rules of size and speed beside trees that were trained on other simulated drives.

The thesis (König 2008, 6.5) names the classes and owns up to one failure: a person who stands looks like a tree. What
is right is told twice: of all, where `unknown` is wrong, and of what is decided; and of what the image resolves beside
what it does not (`training.score.resolved`). `rangecam train` scores the same on many more drives.
"""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rangecam.classify.features import RESOLVED_PIXELS
from rangecam.classify.learned import load_model
from rangecam.studies.study import Claim, Panel, Picture, Series, Study, derived, judged
from rangecam.training.examples import Examples
from rangecam.training.lots import held_out_lots, simulate, told
from rangecam.training.score import (
    RANGE_M,
    calibration_error,
    confusion,
    reliability,
    resolved,
    right_of_all,
    right_share,
)
from rangecam.types import CLASSES, Floats

_ASKED = {"CW": (30, 0.97), "pulsed": (60, 0.90)}
"""Drives of each sensor, and the share of what is resolved that ought to be taken for what it is."""
_BINS_M = np.array([2.0, 5.0, 8.0, 11.0, 15.0])
_RESOLVED = (
    f"resolved: {RANGE_M[0]:g} to {RANGE_M[1]:g} m, at least {RESOLVED_PIXELS} columns and rows, "
    "not cut or hidden beside, not in pieces"
)


def classification(rng: np.random.Generator) -> Study:
    """Classes of tracks on simulated drives from 2 to 15 m: confusion, whether probabilities come true, who stands."""
    seed, claims, panels = int(rng.integers(2**20)), [], []
    curves = [Series("as it should be", [1 / 3, 1], [1 / 3, 1], line="--", colour=7)]
    distances = []
    for number, (name, (drives, asked)) in enumerate(_ASKED.items()):
        examples = simulate(held_out_lots(name, drives, seed), lambda function, lots: iter(map(function, lots)))
        learned, clear = told(examples, load_model()), resolved(examples)
        claims += [*_claims(name, examples, learned, clear, asked), *_standing(name, examples, learned, clear)]
        curve = reliability(examples.classes, learned)
        share = (curve.right * curve.number + 1) / (curve.number + 2)  # as if one more were right and one wrong
        sigma = np.sqrt(share * (1 - share) / curve.number)
        curves.append(Series(name, curve.told, curve.right, sigma=sigma, colour=number))
        distances += _over_distance(name, examples, learned, clear, number)
        for title, those, probability in (
            ("trees, resolved", clear, learned),
            ("trees, the rest", ~clear, learned),
            ("rules, resolved", clear, examples.given),
        ):
            panels.append(_confused(f"{name}, {title}", examples, probability, those))
    panels.append(Panel("Probabilities that come true", "probability that is told", "share that is right", curves))
    panels.append(Panel("Resolved things over their distance", "distance / m", "share", distances))
    return Study("classification", "König 2008, 6.5; Steinbäck 2016, 2.3.3", claims, panels)


def _claims(name: str, examples: Examples, learned: Floats, clear: NDArray[np.bool_], asked: float) -> list[Claim]:
    right, decided = right_share(examples.classes[clear], learned[clear])
    every = right_of_all(examples.classes[clear], learned[clear])
    sigma = _sigma(examples, learned, clear)
    pieces = resolved(examples, whole=False)
    rest_right, rest_decided = right_share(examples.classes[~clear], learned[~clear])
    why = f"unknown is wrong; less two standard deviations over drives, of {sigma:.3f}; {_RESOLVED}"
    text = f"{name}: trees are right, of what is resolved"
    off = calibration_error(reliability(examples.classes, learned))
    by_rules, rules_decided = right_share(examples.classes[clear], examples.given[clear])
    return [
        judged("S-SEG-06", text, asked, every, "", every >= asked - 2 * sigma, why),
        derived("S-SEG-06", f"{name}: share of what is resolved that trees decide; the rest is unknown", decided, ""),
        derived("S-SEG-06", f"{name}: trees are right, of what is resolved and decided", right, ""),
        derived("S-SEG-06", f"{name}: share of all moments of tracks that is resolved", float(clear.mean()), ""),
        derived("S-SEG-06", f"{name}: trees are right, of what is resolved or in pieces; unknown is wrong",
                right_of_all(examples.classes[pieces], learned[pieces]), ""),
        derived("S-SEG-06", f"{name}: trees are right, of all; unknown is wrong",
                right_of_all(examples.classes, learned), ""),
        derived("S-SEG-06", f"{name}: share that trees decide of what is not resolved", rest_decided, ""),
        derived("S-SEG-06", f"{name}: trees are right, of what is not resolved but decided", rest_right, ""),
        derived("S-SEG-06", f"{name}: probabilities of the trees are off by, in the mean", off, ""),
        derived("K-CLS-02", f"{name}: rules are right, of what is resolved; unknown is wrong",
                right_of_all(examples.classes[clear], examples.given[clear]), ""),
        derived("K-CLS-02", f"{name}: rules are right, of what is resolved and decided", by_rules, ""),
        derived("K-CLS-02", f"{name}: share of what is resolved that rules decide", rules_decided, ""),
    ]  # fmt: skip


def _standing(name: str, examples: Examples, learned: Floats, clear: NDArray[np.bool_]) -> list[Claim]:
    """Return whom people who stand, and posts, are taken for, where the image resolves them and where not."""
    claims = []
    rules, trees = np.argmax(examples.given, axis=1), np.argmax(learned, axis=1)
    person, vru = examples.kinds == "standing person", CLASSES.index("vru")
    if person.any():
        share = float((rules[person] == vru).mean())
        why = "the thesis: they cannot be told from a tree"
        text = f"{name}: people who stand that rules take for people"
        claims.append(judged("K-CLS-02", text, None, share, "", share < 0.5, why))
    for of, is_it in (("people who stand", person), ("posts", examples.kinds == "post")):
        for where, those in (("resolved", is_it & clear), ("not resolved", is_it & ~clear)):
            if those.any():
                text, count = f"{name}, {where}: {of}", f"{those.sum()} moments"
                for what, k in (("for people", vru), ("for obstacles", 3), ("for unknown", 0)):
                    share = float((trees[those] == k).mean())
                    claims.append(derived("K-CLS-02", f"{text} that trees take {what}", share, "", count))
    return claims


def _over_distance(
    name: str, examples: Examples, learned: Floats, clear: NDArray[np.bool_], colour: int
) -> list[Series]:
    """Return the shares that are right over distance: of all that is resolved, and of what of it is decided."""
    at_m, every, decided = [], [], []
    for near, far in pairwise(_BINS_M):
        those = clear & (examples.range_m >= near) & (examples.range_m < far)
        if those.any():
            at_m.append((near + far) / 2)
            every.append(right_of_all(examples.classes[those], learned[those]))
            decided.append(right_share(examples.classes[those], learned[those])[0])
    return [
        Series(f"{name}: right, unknown is wrong", at_m, every, None, "o-", colour),
        Series(f"{name}: right of what is decided", at_m, decided, None, "o--", colour),
    ]


def _sigma(examples: Examples, probability: Floats, those: NDArray[np.bool_]) -> float:
    """Return the standard deviation of the share that is right: moments of one drive belong together."""
    hit = np.argmax(probability[those], axis=1) == examples.classes[those]
    sums = np.bincount(examples.drives[those], hit - hit.mean())
    return math.sqrt(float((sums**2).sum())) / len(hit)


def _confused(name: str, examples: Examples, probability: Floats, those: NDArray[np.bool_]) -> Panel:
    table = confusion(examples.classes[those], probability[those])
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    taken, true = ", ".join(CLASSES), ", ".join(CLASSES[:0:-1])
    return Panel(f"{name} ({table.sum()})", f"taken for {taken}", true, [], picture=Picture(share, "share", (0.0, 1.0)))
