"""What a calibration is estimated from: recordings of one camera, each of something known."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from rangecam.types import RangeImage, RawFrame


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of one camera that all saw the same.

    name: for people. camera: its settings. method, ranging: its
    ranging method, by name and as a function. known: what is known of them, in the unit of the
    step that uses it (the distance of a plane target, m; how much later the laser fired, s), None for nothing.
    """

    name: str
    frames: Iterable[RawFrame]
    camera: Any
    method: str
    ranging: Callable[[RawFrame, Any], RangeImage]
    known: float | None = None
