"""Which drives the shipped classifier learns from, and on which others it is judged."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rangecam.classify.learned import Model, class_probabilities
from rangecam.classify.settings import ClassificationSettings
from rangecam.training.drives import DriveSettings
from rangecam.training.examples import Examples, Lot, joined, simulated
from rangecam.training.score import score
from rangecam.types import Floats

Map = Callable[[Callable[[Lot], Examples], Sequence[Lot]], Iterator[Examples]]
"""As the built-in map; it may work elsewhere, and yields in order."""
_AT_ONCE = 20  # drives in one lot
_HELD_OUT_SEED = 1_000_003  # added to the seed of the drives to learn from
_FIELD_DEG = {"road_cw": 44.0, "usercams": 27.0, "ifm_o3r": 50.0}

_OTHER_BODIES = {
    "person_scale": (0.8, 1.2),
    "child_scale": (0.5, 0.82),
    "vehicle_scale": (0.8, 1.3),
    "reflectivity": (0.3, 2.5),
}
_STILL = {"camera": {"freeze_motion": True}}  # what moves in an image of 10 ms is not worth four times the rays
# the camera of another maker, which ranges by itself and to 7.5 m, where ours would be mounted
_MOUNTED = {
    "mounting": {"z_m": 1.2},
    "clean": {"floor": "mounting", "floor_margin_m": 0.15},
    "segments": {"min_pixels": 20},
}

HELD_OUT: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "CW": ("road_cw", {}, {}),
    "CW, others": ("road_cw", _OTHER_BODIES, {}),
    "CW, rain": ("road_cw", {"rain_mm_per_h": 10.0, "ambient_wpm2": 1.0}, {}),
    "pulsed": ("usercams", {}, {}),
    "pulsed, others": ("usercams", _OTHER_BODIES, {}),
    "other camera": ("ifm_o3r", {"farthest_m": 7.0}, _MOUNTED),
}
"""Drives that no model has learned from: preset, what is drawn otherwise, settings over the preset. Their seeds are
other ones; "others" have bodies of sizes and reflectivities beyond those learned."""


def learning_lots(drives: int, seed: int) -> list[Lot]:
    """Return lots of so many drives of each sensor that the shipped model learns from: continuous-wave and pulsed."""
    return [
        Lot(preset, DriveSettings(field_deg=_FIELD_DEG[preset]), seed, numbers, still)
        for preset, still in (("road_cw", _STILL), ("usercams", {}))
        for numbers in _split(drives)
    ]


def held_out_lots(name: str, drives: int, seed: int) -> list[Lot]:
    """Return lots of so many drives of `HELD_OUT` by their name."""
    preset, drawn, settings = HELD_OUT[name]
    given = DriveSettings(**{"field_deg": _FIELD_DEG[preset], **drawn})
    return [Lot(preset, given, seed + _HELD_OUT_SEED, numbers, settings) for numbers in _split(drives)]


def _split(drives: int) -> list[range]:
    return [range(first, min(first + _AT_ONCE, drives)) for first in range(0, drives, _AT_ONCE)]


def simulate(lots: Sequence[Lot], over: Map) -> Examples:
    """Return all examples of some lots, as `over` maps them."""
    return joined(over(simulated, lots))


def told(examples: Examples, model: Model, settings: ClassificationSettings | None = None) -> Floats:
    """Return what the chain would say with this model: the probabilities of all classes (N, 4), with `unknown`."""
    return class_probabilities(examples.features, model, settings or ClassificationSettings())


def scores(model: Model, drives: int, seed: int, over: Map) -> dict[str, dict[str, Any]]:
    """Return the score of a model on so many drives of each of `HELD_OUT`, and beside it that of the rules."""
    found = {}
    for name in HELD_OUT:
        examples = simulate(held_out_lots(name, drives, seed), over)
        found[name] = score(examples, told(examples, model))
        found[f"{name}, by rules"] = score(examples, examples.given)
    return found
