"""What exists in a simulation: a scenario is a TOML file, checked and turned into frozen settings."""

import tomllib
from importlib.resources import files
from typing import Any, Literal

from rangecam.config import merge, parse
from rangecam.errors import UsageError, did_you_mean
from rangecam.scene.paths import EgoMotion, motion
from rangecam.scene.shapes import SceneObject
from rangecam.scene.weather import Weather
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings

AMBIENT_WPM2 = {"none": 0.0, "sun": 1000.0, "street_light": 1.3, "headlights": 6.0}
"""Irradiance by sources of ambient light with all of their spectrum, W/m2 (König 2008, 5.2.1.2).

The full sun across its rays; 20 lx of a street and 100 lx of halogen headlights as lamps of 2856 K give them (16 lm/W).
"""


@settings
class Scenario:
    """Everything outside the camera: what there is, how it moves, and how light it is."""

    name: str
    """The name of its file."""
    description: str
    """What happens, in a phrase for people."""
    preset: str
    """The configuration that it is seen with unless another is asked for."""
    duration_s: Positive
    """How long it lasts."""
    frame_rate_hz: Positive | None = None
    """Images a second; none: as fast as the camera's settings say."""
    subpixels: PositiveInt = 2
    """Rays per pixel along each edge; more than one give mixed pixels at the edges of things."""
    ambient_wpm2: NonNegative = 0.0
    """Irradiance of everything by ambient light in the camera's band, W/m2."""
    ambient_light: Literal["none", "sun", "street_light", "headlights"] = "none"
    """A source whose light comes to that, with all of its spectrum: see `AMBIENT_WPM2`."""
    ground_reflectivity: Fraction | None = None
    """Reflectivity of the ground at z = 0; none: no ground."""
    weather: Weather = Weather()
    """Rain, snow and single drops before the camera."""
    ego: EgoMotion = EgoMotion()
    """How the own vehicle drives."""
    objects: tuple[SceneObject, ...] = ()
    """The things in it."""


def scenario_names() -> list[str]:
    """Return the names of the scenarios that ship with rangecam, sorted."""
    entries = files("rangecam").joinpath("scene", "scenarios").iterdir()
    return sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml"))


def load_scenario(name: str) -> Scenario:
    """Return the scenario of that name; raises UsageError, with the names that exist, if there is none."""
    return parse_scenario(name, _text(name))


def _text(name: str) -> str:
    known = scenario_names()
    if name not in known:
        raise UsageError(f"unknown scenario '{name}'{did_you_mean(name, known)}; scenarios: {', '.join(known)}")
    return files("rangecam").joinpath("scene", "scenarios", f"{name}.toml").read_text("utf-8")


def _tree(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{where}: not a TOML file: {error}") from error


def parse_scenario(name: str, text: str) -> Scenario:
    """Return the scenario that a TOML text describes; `like = "NAME"` in it starts from a scenario that ships.

    Raises UsageError that names the key and the value if something in it cannot be.
    """
    where = f"scenario '{name}'"
    values = _tree(text, where)
    if "like" in values:
        values = merge(_tree(_text(str(values.pop("like"))), where), values)
    scenario = parse(Scenario, {**values, "name": name}, where)
    for thing in scenario.objects:
        try:
            motion(thing.path, 0.0)
        except UsageError as error:
            raise UsageError(f"{where}: object '{thing.name}': {error}") from error
    return scenario
