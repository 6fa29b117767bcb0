"""How good a classifier is: how often it is right, and whether its probabilities come true.

Two shares tell how often it is right: of all examples, where `unknown` counts as wrong, and of those that it decides.
And they are told of all examples, and of those that can be told at all: see `resolved`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rangecam.classify.features import RESOLVED_PIXELS
from rangecam.training.examples import Examples
from rangecam.types import CLASSES, Cut, Floats, Ints

RANGE_M = 2.0, 15.0
_WHOLE = 0.5  # of what is seen of an object
_SIDES = int(Cut.LEFT | Cut.RIGHT | Cut.OCCLUDED)


class Reliability(NamedTuple):
    """For each group of decisions of like probability: their mean, the share that is right, their number."""

    told: Floats
    right: Floats
    number: Ints


def resolved(examples: Examples, whole: bool = True) -> NDArray[np.bool_]:
    """Return which examples can be told (N,): seen from side to side, in enough pixels, and not in pieces.

    That is: nothing cuts them short beside, and they have `RESOLVED_PIXELS` both ways. If they must be whole, their
    segment holds at least half of the pixels that show them: pieces are a matter of segmentation. They are `RANGE_M`
    away. The image may end above or below them, as that of the pulsed camera does, which is 1.5 m high at 10 m.
    """
    near, far = RANGE_M
    clear: NDArray[np.bool_] = (examples.cut & _SIDES == 0) & (examples.pixels >= RESOLVED_PIXELS).all(axis=1)
    clear &= (examples.range_m >= near) & (examples.range_m <= far)
    return clear & (examples.share >= _WHOLE) if whole else clear


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


def right_of_all(classes: Ints, probability: Floats) -> float:
    """Return the share of the examples that are taken for what they are: `unknown` is wrong."""
    return float((np.argmax(probability, axis=1) == classes).mean()) if len(classes) else float("nan")


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
    by_kind = {
        str(kind): round(right_of_all(examples.classes[of], probability[of]), 4)
        for kind in np.unique(examples.kinds)
        for of in [examples.kinds == kind]
    }
    return {
        "examples": len(examples),
        "drives": len(np.unique(examples.drives)),
        **_shares(examples.classes, probability),
        "resolved": _part(examples, probability, resolved(examples)),
        "resolved_or_in_pieces": _part(examples, probability, resolved(examples, whole=False)),
        "calibration_error": round(calibration_error(reliability(examples.classes, probability)), 4),
        "classes": list(CLASSES),
        "confusion": confusion(examples.classes, probability).tolist(),
        "right_of_kind": by_kind,
    }


def _part(examples: Examples, probability: Floats, those: NDArray[np.bool_]) -> dict[str, Any]:
    classes, told = examples.classes[those], probability[those]
    return {"examples": len(classes), **_shares(classes, told), "confusion": confusion(classes, told).tolist()}


def _shares(classes: Ints, probability: Floats) -> dict[str, float | None]:
    right, decided = right_share(classes, probability) if len(classes) else (float("nan"), float("nan"))
    shares = {"right_of_all": right_of_all(classes, probability), "right": right, "decided": decided}
    return {key: round(value, 4) if np.isfinite(value) else None for key, value in shares.items()}
