"""Cameras that compute the range themselves: their images enter the chain here, with a noise model."""

from collections.abc import Callable
from typing import Any, Literal

from rangecam.geometry import Lens
from rangecam.settings import PositiveInt, settings


@settings
class ProcessedCamera:
    """A camera whose raw frame is a range or depth image."""

    kind: Literal["processed"] = "processed"
    name: str = "generic"
    rows: PositiveInt = 120
    columns: PositiveInt = 160
    frame_rate_hz: float = 30.0
    lens: Lens = Lens()


RANGING: dict[str, Callable[..., Any]] = {"processed": lambda: None}
