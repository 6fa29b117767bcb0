"""How good a classifier is: how often it is right, and whether its probabilities come true."""

from typing import Any, NamedTuple

import numpy as np

from rangecam.training.examples import Examples
from rangecam.types import CLASSES, Floats, Ints


class Reliability(NamedTuple):
    """For each group of decisions of like probability: their mean, the share that is right, their number."""

    told: Floats
    right: Floats
    number: Ints


def confusion(classes: Ints, probability: Floats) -> Ints:
    """Return how many examples of each class (3 rows: all but unknown) were taken for each (4 columns)."""
    table = np.zeros((3, 4), int)
    np.add.at(table, (classes - 1, np.argmax(probability, axis=1)), 1)
    return table


def right_share(classes: Ints, probability: Floats) -> tuple[float, float]:
    """Return the share of the decisions that are right, and that of the examples that got one: not `unknown`."""
    decided = np.argmax(probability, axis=1)
    known = decided > 0
    return float((decided == classes)[known].mean()) if known.any() else float("nan"), float(known.mean())


def reliability(classes: Ints, probability: Floats, groups: int = 8) -> Reliability:
    """Return whether the probabilities of the likeliest class come true, unknown set aside: (G,) each.

    Probabilities from 1/3 to 1 are cut into groups alike; empty ones are left out.
    """
    told = probability[:, 1:] / np.maximum(probability[:, 1:].sum(axis=1, keepdims=True), 1e-12)
    most, right = told.max(axis=1), np.argmax(told, axis=1) + 1 == classes
    group = np.clip(((most - 1 / 3) / (2 / 3) * groups).astype(int), 0, groups - 1)
    count = np.bincount(group, minlength=groups)
    some = count > 0
    mean = np.bincount(group, most, groups)[some] / count[some]
    return Reliability(mean, np.bincount(group, right, groups)[some] / count[some], count[some])


def calibration_error(curve: Reliability) -> float:
    """Return by how much the probabilities are off, in the mean over all decisions."""
    return float((curve.number * np.abs(curve.told - curve.right)).sum() / curve.number.sum())


def score(examples: Examples, probability: Floats) -> dict[str, Any]:
    """Return what there is to say of a classifier's probabilities (N, 4) for examples, as JSON values."""
    right, decided = right_share(examples.classes, probability)
    by_kind = {
        str(kind): round(float((np.argmax(probability[of], axis=1) == examples.classes[of]).mean()), 4)
        for kind in np.unique(examples.kinds)
        for of in [examples.kinds == kind]
    }
    return {
        "examples": len(examples),
        "drives": len(np.unique(examples.drives)),
        "right": round(right, 4),
        "decided": round(decided, 4),
        "calibration_error": round(calibration_error(reliability(examples.classes, probability)), 4),
        "classes": list(CLASSES),
        "confusion": confusion(examples.classes, probability).tolist(),
        "right_of_kind": by_kind,
    }
