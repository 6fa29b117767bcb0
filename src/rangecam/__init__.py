"""rangecam: time-of-flight range cameras, from raw samples to the brake command.

    import rangecam

    source = rangecam.open_source("scenario:test-scene")
    for frame in rangecam.run(source.captures, source.config):
        print(frame.decision.reason)

`rangecam.pipeline.process_frame` is the whole chain in one function; ARCHITECTURE.md is the map.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "load_config": "rangecam.config",
    "open_source": "rangecam.io",
    "process_frame": "rangecam.pipeline",
    "run": "rangecam.pipeline",
}
__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    """Import the public names when they are first used, so that `rangecam --help` need not load the kernels."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'rangecam' has no attribute '{name}'")
    return getattr(import_module(_PUBLIC[name]), name)
