"""Ranging methods."""

from collections.abc import Callable
from typing import Any

RANGING: dict[str, Callable[..., Any]] = {"cw_x": lambda: None}
