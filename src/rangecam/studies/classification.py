"""How well things are told apart: rules of size and speed beside trees that were trained on other simulated drives.

The thesis (König 2008, 6.5) names the classes and owns up to one failure: a person who stands looks like a tree.
`rangecam train` scores the same on many more drives.
"""

import math

import numpy as np

from rangecam.classify.learned import load_model
from rangecam.classify.settings import ClassificationSettings
from rangecam.studies.study import Claim, Panel, Picture, Series, Study, derived, judged
from rangecam.training.examples import Examples
from rangecam.training.lots import held_out_lots, simulate, told
from rangecam.training.score import calibration_error, confusion, reliability, right_share
from rangecam.types import CLASSES, Floats

_ASKED = {"CW": (24, 0.97), "pulsed": (60, 0.90)}
"""Drives of each sensor, and the share of decisions that ought to be right."""
_WHY = "of what is decided, less two standard deviations of the share over drives"


def classification(rng: np.random.Generator) -> Study:
    """Classes of tracks on simulated drives from 2 to 15 m: confusion, whether probabilities come true, who stands."""
    seed, claims, panels = int(rng.integers(2**20)), [], []
    curves = [Series("as it should be", [1 / 3, 1], [1 / 3, 1], line="--", colour=7)]
    for number, (name, (drives, asked)) in enumerate(_ASKED.items()):
        examples = simulate(held_out_lots(name, drives, seed), lambda function, lots: iter(map(function, lots)))
        learned = told(examples, load_model(), ClassificationSettings())
        claims += _claims(name, examples, learned, asked)
        curve = reliability(examples.classes, learned)
        share = (curve.right * curve.number + 1) / (curve.number + 2)  # as if one more were right and one wrong
        sigma = np.sqrt(share * (1 - share) / curve.number)
        curves.append(Series(name, curve.told, curve.right, sigma=sigma, colour=number))
        for method, probability in (("trees", learned), ("rules", examples.given)):
            panels.append(_confused(f"{name}, {method}", examples, probability))
    panels.append(Panel("Probabilities that come true", "probability that is told", "share that is right", curves))
    return Study("classification", "König 2008, 6.5; Steinbäck 2016, 2.3.3", claims, panels)


def _claims(name: str, examples: Examples, learned: Floats, asked: float) -> list[Claim]:
    right, decided = right_share(examples.classes, learned)
    by_rules, rules_decided = right_share(examples.classes, examples.given)
    sigma = _sigma(examples, learned)
    off = calibration_error(reliability(examples.classes, learned))
    claims = [
        judged("S-SEG-06", f"{name}: right of what trees decide", asked, right, "", right >= asked - 2 * sigma, _WHY),
        derived("S-SEG-06", f"{name}: share that trees decide; the rest is unknown", decided, ""),
        derived("S-SEG-06", f"{name}: probabilities of the trees are off by, in the mean", off, ""),
        derived("K-CLS-02", f"{name}: right of what rules decide", by_rules, ""),
        derived("K-CLS-02", f"{name}: share that rules decide", rules_decided, ""),
    ]
    stands, vru = examples.kinds == "standing person", CLASSES.index("vru")
    if stands.any():
        rules, trees = (float((np.argmax(p[stands], axis=1) == vru).mean()) for p in (examples.given, learned))
        wrong = float(np.isin(np.argmax(learned[stands], axis=1), (2, 3)).mean())
        text = f"{name}: people who stand that rules take for people"
        claims += [
            judged("K-CLS-02", text, None, rules, "", rules < 0.5, "the thesis: they cannot be told from a tree"),
            derived("K-CLS-02", f"{name}: people who stand that trees take for people", trees, ""),
            derived("K-CLS-02", f"{name}: people who stand that trees take for something else", wrong, ""),
        ]
    posts = examples.kinds == "post"
    if posts.any():
        taken = float((np.argmax(learned[posts], axis=1) == vru).mean())
        claims.append(derived("K-CLS-02", f"{name}: posts that trees take for people", taken, ""))
    return claims


def _sigma(examples: Examples, probability: Floats) -> float:
    """Return the standard deviation of the share of right decisions: those of one drive belong together."""
    choice = np.argmax(probability, axis=1)
    known = choice > 0
    error = (choice == examples.classes)[known] - right_share(examples.classes, probability)[0]
    sums = np.bincount(examples.drives[known], error)
    return math.sqrt(float((sums**2).sum())) / max(int(known.sum()), 1)


def _confused(name: str, examples: Examples, probability: Floats) -> Panel:
    table = confusion(examples.classes, probability)
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    taken, true = ", ".join(CLASSES), ", ".join(CLASSES[:0:-1])
    return Panel(name, f"taken for {taken}", true, [], picture=Picture(share, "share", (0.0, 1.0)))
