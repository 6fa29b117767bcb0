"""Ranging methods."""

from collections.abc import Callable
from typing import Any

RANGING: dict[str, Callable[..., Any]] = {"pulsed_x": lambda: None}
