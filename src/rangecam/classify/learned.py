"""What a track is by trees that were trained on simulated drives, evaluated without the library that grew them.

A model is a sum of trees for each class (gradient boosting: Friedman 2001), divided by a temperature that makes the
probabilities as large as they come true (Guo et al. 2017). `training` makes one.
"""

import zipfile
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from rangecam.classify.features import FEATURES, is_resolved, observe
from rangecam.classify.settings import ClassificationSettings
from rangecam.compiled import kernel
from rangecam.errors import DataError
from rangecam.types import CLASSES, Ego, Floats, Ints, Segments, Tracks, TrackStatus
from rangecam.values import changed

_CONFIRMED = int(TrackStatus.CONFIRMED)
_TOLD = len(CLASSES) - 1


@dataclass(frozen=True, eq=False)
class Model:
    """Trees as arrays, one node an element.

    feature (M,) int: column that a node compares, -1 for a leaf. threshold (M,): at most it goes left. left, right (M,)
    int: nodes to go on with. value (M,): of a leaf. roots (T,) int: first node of each tree; tree t votes for class 1 +
    t % 3. base (3,): of each class, before any tree. temperature: divides the sums.
    """

    feature: Ints
    threshold: Floats
    left: Ints
    right: Ints
    value: Floats
    roots: Ints
    base: Floats
    temperature: float


def learned(tracks: Tracks, ego: Ego, settings: ClassificationSettings, segments: Segments) -> Tracks:
    """Return the tracks with new class probabilities, by a trained model, and the memory that it needs."""
    memory, features = observe(tracks, ego, segments)
    probability = np.array(tracks.class_probability, float)
    confirmed = tracks.status == _CONFIRMED
    if confirmed.any():
        probability[confirmed] = class_probabilities(features[confirmed], load_model(settings.model), settings)
    return changed(tracks, class_probability=probability, class_memory=memory)


def class_probabilities(features: Floats, model: Model, settings: ClassificationSettings) -> Floats:
    """Return the probabilities of all classes (N, 4) for features (N, F), with `unknown`.

    Those of the three classes are the model's, less a part for `unknown` that is as large as the greatest of them where
    that is `unknown_below` (`unresolved_below`, for what the image does not resolve), and vanishes where it is certain;
    their proportions stay.
    """
    probability = np.empty((len(features), len(CLASSES)))
    given = np.ascontiguousarray(features, float), *_arrays(model), settings.unknown_below, settings.unresolved_below
    kernel: Any = _classify  # as mypy cannot count arrays that a function returns
    kernel(*given, probability)
    return probability


def probabilities(features: Floats, model: Model) -> Floats:
    """Return what the model says of features (N, F): the probability of each class but unknown, (N, 3)."""
    told = np.empty((len(features), _TOLD))
    given = np.ascontiguousarray(features, float), *_arrays(model)
    kernel: Any = _probabilities
    kernel(*given, told)
    return told


def compact(model: Model) -> Model:
    """Return the model with nodes of few bytes, as its file has them: walking down its trees is waiting for memory."""
    small: dict[str, Any] = {"feature": np.int8, "left": np.int32, "right": np.int32, "roots": np.int32}
    small |= {"threshold": np.float32, "value": np.float32}
    return Model(**{**vars(model), **{key: vars(model)[key].astype(kind) for key, kind in small.items()}})


def save_model(model: Model, path: Path) -> None:
    """Write a model to a file (.npz)."""
    arrays = {key: np.asarray(value, np.float32) for key, value in vars(model).items()} | vars(compact(model))
    with path.open("wb") as file:
        np.savez_compressed(file, names=np.array(FEATURES), **arrays)


@lru_cache(maxsize=4)
def load_model(path: str = "") -> Model:
    """Return the model of a file, or the one that ships if there is no name.

    Raises DataError if the file cannot be read, is no model, or looks at other features than this version.
    """
    source: Any = path or str(files("rangecam").joinpath("classify", "model.npz"))
    try:
        with np.load(source, allow_pickle=False) as file:
            values = {key: file[key] for key in file.files}
    except OSError as error:
        raise DataError(f"{path}: cannot read the model: {error.strerror or error}") from error
    except (ValueError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: not a model of the classifier; `rangecam train` writes one") from error
    missing = [key for key in ("names", *Model.__dataclass_fields__) if key not in values]
    if missing:
        raise DataError(f"{path}: not a model of the classifier: it lacks {', '.join(missing)}")
    if tuple(values["names"].tolist()) != FEATURES:
        raise DataError(f"{path}: this model looks at other features than this version; train it again")
    return _checked(values, path)


def _checked(values: dict[str, Any], path: str) -> Model:
    """Return the model, with every node within its arrays and every path down a tree ending."""
    feature, left, right, roots = (values[key].astype(np.int64) for key in ("feature", "left", "right", "roots"))
    count, inner = feature.size, feature >= 0
    sizes = {values[key].size for key in ("feature", "threshold", "left", "right", "value")}
    node = np.arange(count)[inner]
    downwards = len(sizes) == 1 and all(
        bool(np.all((side[inner] > node) & (side[inner] < count))) for side in (left, right)
    )
    inside = bool(np.all((feature < len(FEATURES)) & (feature >= -1))) and bool(np.all((roots >= 0) & (roots < count)))
    if not (downwards and inside and roots.size % _TOLD == 0 and values["base"].size == _TOLD):
        raise DataError(f"{path}: not a model of the classifier: its trees are broken")
    threshold, value = values["threshold"].astype(float), values["value"].astype(float)
    base, temperature = values["base"].astype(float), float(values["temperature"])
    if not (temperature > 0 and np.isfinite([*threshold, *value, *base, temperature]).all()):
        raise DataError(f"{path}: not a model of the classifier: its numbers must be finite, its temperature above 0")
    return compact(Model(feature, threshold, left, right, value, roots, base, temperature))


def _arrays(model: Model) -> tuple[Any, ...]:
    return (
        *(model.feature, model.threshold, model.left, model.right, model.value),
        *(model.roots, model.base, model.temperature),
    )


@kernel
def _classify(
    features: Any,
    feature: Any,
    threshold: Any,
    left: Any,
    right: Any,
    value: Any,
    roots: Any,
    base: Any,
    temperature: Any,
    unknown_below: Any,
    unresolved_below: Any,
    probability: Any,
) -> None:
    told = np.empty((len(features), 3))
    _probabilities(features, feature, threshold, left, right, value, roots, base, temperature, told)
    for i in range(len(features)):
        most = max(told[i, 0], told[i, 1], told[i, 2])
        below = unknown_below if is_resolved(features[i]) else unresolved_below
        # odds of unknown against the likeliest class: 1 where that is as probable as `below`
        odds = (1.0 - most) / most * below / (1.0 - below)
        unknown = most * odds / (1.0 + most * odds)
        probability[i, 0] = unknown
        for k in range(3):
            probability[i, 1 + k] = (1.0 - unknown) * told[i, k]


@kernel
def _probabilities(
    features: Any,
    feature: Any,
    threshold: Any,
    left: Any,
    right: Any,
    value: Any,
    roots: Any,
    base: Any,
    temperature: Any,
    told: Any,
) -> None:
    for i in range(len(features)):
        for k in range(3):
            told[i, k] = base[k]
        for t in range(roots.size):
            node = roots[t]
            while feature[node] >= 0:
                node = left[node] if features[i, feature[node]] <= threshold[node] else right[node]
            told[i, t % 3] += value[node]
        most = max(told[i, 0], told[i, 1], told[i, 2])
        total = 0.0
        for k in range(3):
            told[i, k] = np.exp((told[i, k] - most) / temperature)
            total += told[i, k]
        for k in range(3):
            told[i, k] /= total
