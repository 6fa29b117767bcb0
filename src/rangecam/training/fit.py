"""The trees of the learned classifier, grown by scikit-learn and taken out of it."""

from typing import Any

import numpy as np

from rangecam.classify.learned import Model, compact, probabilities
from rangecam.errors import UsageError
from rangecam.training.examples import Examples
from rangecam.types import CLASSES, Floats, Ints

_LEAVES = 12
_RATE = 0.1
_VALIDATION = 4  # each fourth drive is kept until the temperature is found


def fit(examples: Examples, seed: int, rounds: int) -> Model:
    """Return the model of these examples, of so many rounds of three trees.

    Its temperature is that of trees which have not seen each fourth drive. All classes and all kinds of
    things weigh alike, however many pixels and frames there are of them. Raises UsageError if a class is missing, or
    scikit-learn is.
    """
    missing = {1, 2, 3} - set(examples.classes.tolist())
    if missing:
        raise UsageError(f"no example of {', '.join(CLASSES[k] for k in sorted(missing))}: simulate more drives")
    held = examples.drives % _VALIDATION == 0
    weights = _weights(examples)
    grown = _grow(examples.features[~held], examples.classes[~held] - 1, weights[~held], seed, rounds)
    temperature = _temperature(_taken_out(grown), examples.features[held], examples.classes[held] - 1, weights[held])
    model = _taken_out(_grow(examples.features, examples.classes - 1, weights, seed, rounds))
    return Model(**{**vars(model), "temperature": temperature})


def _weights(examples: Examples) -> Floats:
    """Return the weight of each example: those of one kind together as much as those of any other of its class."""
    _, which, counts = np.unique(examples.kinds, return_inverse=True, return_counts=True)
    weights = 1 / np.sqrt(counts[which])
    for k in np.unique(examples.classes):
        weights[examples.classes == k] /= weights[examples.classes == k].sum()
    balanced: Floats = weights / weights.mean()
    return balanced


def _grow(features: Floats, classes: Ints, weights: Floats, seed: int, rounds: int) -> Any:
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier
        from threadpoolctl import threadpool_limits  # which scikit-learn brings along
    except ImportError as error:
        raise UsageError("training needs scikit-learn: pip install 'rangecam[train]'") from error
    grower = HistGradientBoostingClassifier(
        max_iter=rounds,
        max_leaf_nodes=_LEAVES,
        learning_rate=_RATE,
        min_samples_leaf=30,
        l2_regularization=5.0,
        max_features=0.5,
        early_stopping=False,
        random_state=seed,
    )
    with threadpool_limits(1):  # threads that wait for each other take minutes where others use the cores
        return grower.fit(features, classes, sample_weight=weights)


def _taken_out(grown: Any) -> Model:
    """Return the trees of a fitted HistGradientBoostingClassifier as arrays, without a temperature."""
    trees = [tree.nodes for round_ in grown._predictors for tree in round_]
    roots = np.cumsum([0, *(len(nodes) for nodes in trees)])
    nodes = np.concatenate(trees)
    start = np.repeat(roots[:-1], np.diff(roots))
    leaf = nodes["is_leaf"].astype(bool)
    found = Model(
        feature=np.where(leaf, -1, nodes["feature_idx"]),
        threshold=np.where(leaf, 0.0, nodes["num_threshold"]),
        left=np.where(leaf, 0, nodes["left"] + start),
        right=np.where(leaf, 0, nodes["right"] + start),
        value=np.where(leaf, nodes["value"], 0.0),
        roots=roots[:-1],
        base=grown._baseline_prediction.ravel().astype(float),
        temperature=1.0,
    )
    return compact(found)


def _temperature(model: Model, features: Floats, classes: Ints, weights: Floats) -> float:
    """Return the temperature under which the classes of examples that no tree has seen are the likeliest."""

    def surprise(temperature: float) -> float:
        told = probabilities(features, Model(**{**vars(model), "temperature": temperature}))
        return float(-(weights * np.log(told[np.arange(len(classes)), classes] + 1e-12)).sum())

    candidates = np.geomspace(0.5, 4.0, 43)
    return float(candidates[int(np.argmin([surprise(t) for t in candidates]))])
