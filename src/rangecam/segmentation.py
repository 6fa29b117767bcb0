"""From points to objects."""

from collections.abc import Callable
from typing import Any

from rangecam.settings import settings


@settings
class SegmentSettings:
    """How segments are found."""


SEGMENTATION: dict[str, Callable[..., Any]] = {"region_growing": lambda: None, "range_histogram": lambda: None}
