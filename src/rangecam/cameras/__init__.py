"""Cameras that yield captures; each is a module, imported when it is asked for."""

from collections.abc import Callable, Iterator
from importlib import import_module

from rangecam.errors import UsageError, did_you_mean
from rangecam.types import Capture

CAMERAS = {"simulated": "rangecam.cameras.simulated:frames"}
"""Cameras by name: "module:function" of a function that yields captures."""


def open_camera(name: str) -> Callable[..., Iterator[Capture]]:
    """Return the function of the camera of that name; raises UsageError, with the names known, if there is none."""
    if name not in CAMERAS:
        raise UsageError(f"unknown camera '{name}'{did_you_mean(name, CAMERAS)}; cameras: {', '.join(sorted(CAMERAS))}")
    module, _, function = CAMERAS[name].partition(":")
    opened: Callable[..., Iterator[Capture]] = getattr(import_module(module), function)
    return opened
