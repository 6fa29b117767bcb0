"""Numbers of the tracker's settings by name."""

from collections.abc import Iterator, Mapping
from typing import Any

from rangecam.config import parse, tree
from rangecam.errors import UsageError
from rangecam.tracking import TrackingSettings


def with_values(settings: TrackingSettings, values: Mapping[str, float]) -> TrackingSettings:
    """Return settings with `values` by name, such as tracking.motion.drift_mps2 or tracking.motion.modes.0.drift_mps2.

    Raises UsageError if there is no such number, or it cannot have that value.
    """
    changed = tree(settings)
    for name, number in values.items():
        *_, (node, key) = _walk(changed, name)
        node[key] = number
    return parse(TrackingSettings, changed, "tune")


def value_of(settings: TrackingSettings, name: str) -> float:
    """Return the number of that name; raises UsageError if there is none."""
    *_, (node, key) = _walk(tree(settings), name)
    return float(node[key])


def _walk(root: dict[str, Any], name: str) -> Iterator[tuple[Any, Any]]:
    """Yield each node on the way to a number with the key of the next."""
    first, *parts = name.split(".")
    node: Any = root
    if first != "tracking" or not parts:
        raise UsageError(f"{name}: expected a number of [tracking], such as tracking.motion.drift_mps2")
    for part in parts:
        key = int(part) if isinstance(node, list) and part.isdigit() else part
        found = range(len(node)) if isinstance(node, list) else node if isinstance(node, dict) else ()
        if key not in found:
            raise UsageError(f"{name}: there is no '{part}'; known here: {', '.join(map(str, found)) or 'nothing'}")
        yield node, key
        node = node[key]
    if isinstance(node, bool) or not isinstance(node, int | float):
        raise UsageError(f"{name}: expected the name of a number, this is {node!r}")


def process_noise(settings: TrackingSettings) -> str:
    """Return the name of the process noise of the motion model; raises UsageError where several modes have one each."""
    names = {"constant_velocity": "velocity_drift_mps", "wiener_acceleration": "step_mps2"}
    motion = settings.motion
    if motion.modes:
        each = (f"modes.{k}.{names.get(mode.model, 'drift_mps2')}" for k, mode in enumerate(motion.modes))
        raise UsageError(f"the motion model has several modes; name a parameter: tracking.motion.{', '.join(each)}")
    return f"tracking.motion.{names.get(motion.model, 'drift_mps2')}"
