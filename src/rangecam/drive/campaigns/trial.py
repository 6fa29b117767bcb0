"""One drive of a campaign: what was drawn for it, and the scene, camera and vehicle that follow from that."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from rangecam.config import Config, load_config, merge
from rangecam.drive.settings import DriveSettings, Fault
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import SceneObject
from rangecam.values import value


@value
class Drawn:
    """What was drawn for one drive, for people and for the table; NaN and empty where something does not apply."""

    group: str
    camera: str
    speed_mps: float
    target: str = ""
    target_mps: float = 0.0
    offset_m: float = 0.0
    reflectivity: float = float("nan")
    friction: float = float("nan")
    light: str = "none"
    weather: str = ""
    fault: str = ""


@value
class Trial:
    """One drive before it is driven. seed: of the camera's noise and the weather."""

    drawn: Drawn
    scenario: Scenario
    config: Config
    settings: DriveSettings
    seed: int


@lru_cache(maxsize=32)
def _loaded(preset: str) -> Config:
    return load_config(preset)


def configured(preset: str, layers: Mapping[str, Any], *settings: Mapping[str, Any]) -> Config:
    """Return the configuration of a preset for a vehicle, with the user's `layers` over all."""
    if not layers and not settings:
        return _loaded(preset)
    return load_config(preset, merge(*settings, layers))


def scene(name: str, duration_s: float, objects: tuple[SceneObject, ...], preset: str, **more: Any) -> Scenario:
    """Return a scene that a campaign made."""
    return Scenario(name=name, description=name, preset=preset, duration_s=float(duration_s), objects=objects, **more)


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two others, with four digits: a table shows what was driven."""
    return round(float(rng.uniform(low, high)), 4)


def one_of(rng: np.random.Generator, *choices: Any) -> Any:
    """Return one of the choices, each as likely as the others."""
    return choices[int(rng.integers(len(choices)))]


_FRAME_FAULTS = ("frozen", "dropped", "late", "repeated", "out_of_order", "saturated")
_BUS_FAULTS = ("status_silence", "wrong_magic", "speed_stuck")


def a_fault(rng: np.random.Generator, until_s: float) -> Fault:
    """Return something that goes wrong for a while before `until_s`."""
    kind = one_of(rng, *_FRAME_FAULTS, *_BUS_FAULTS)
    # without take-overs nothing can be done, and a wheel that does not turn with the way tells nobody: only briefly
    longest_s = 0.1 if kind in ("wrong_magic", "speed_stuck") else 1.0
    start_s = uniform(rng, 0.2, max(until_s, 0.3))
    return Fault(kind=kind, start_s=start_s, duration_s=uniform(rng, 0.05, longest_s), value=uniform(rng, 0.02, 0.3))
