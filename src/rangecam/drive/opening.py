"""A drive from what the command line says: scene, camera and vehicle of a scenario, with the user's settings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rangecam.config import Config, load_config, merge, parse, tree
from rangecam.drive.settings import DriveSettings
from rangecam.errors import UsageError
from rangecam.scene.scenario import Scenario, load_scenario, parse_scenario
from rangecam.vehicle.settings import vehicle_named

_MODEL_CAR_M = 1.0  # a corridor narrower than this is that of a model car
ROAD: dict[str, Any] = {"friction": 0.9, "brake": {"health": {"min_seen": 0.0}}}
"""Of a passenger car: dry asphalt; on an empty road a camera sees nothing, and is neither blocked nor blind."""


def opened(
    name: str, preset: str | None, layers: Sequence[Mapping[str, Any]]
) -> tuple[Scenario, Config, DriveSettings]:
    """Return scene, camera and settings of a drive.

    name: scenario, `scenario:NAME` or a file NAME.toml. layers: nested dicts, the last winning; `drive` in them is for
    `DriveSettings` (`drive.vehicle` may name a vehicle), all else for the configuration. Without a vehicle it is the
    scaled car where the brake's corridor is narrower than 1 m, else a passenger car on asphalt.
    Raises UsageError for what is unknown or cannot be.
    """
    scenario = _scenario(name.removeprefix("scenario:"))
    together = merge(*layers)
    told = dict(together.pop("drive", {}))
    config = load_config(preset or together.get("preset") or scenario.preset, together)
    return scenario, config, drive_settings(config, told)


def drive_settings(config: Config, told: Mapping[str, Any]) -> DriveSettings:
    """Return the settings of a drive with this camera; told: what differs from those of camera and vehicle."""
    on_road = config.decision.corridor.width_m >= _MODEL_CAR_M
    vehicle = told.get("vehicle", {})
    if isinstance(vehicle, str):
        first, rest = vehicle, {}
    else:
        first, rest = "passenger_car" if on_road else "scaled_car", vehicle
    brake = {"brake": tree(config.brake)}
    base = merge(brake, ROAD if first == "passenger_car" else {}, {"vehicle": tree(vehicle_named(first))})
    others = {key: value for key, value in told.items() if key != "vehicle"}
    return parse(DriveSettings, merge(base, others, {"vehicle": rest}), "drive")


def _scenario(name: str) -> Scenario:
    if not name.endswith(".toml"):
        return load_scenario(name)
    try:
        return parse_scenario(Path(name).stem, Path(name).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{name}: cannot be read: {error}") from error
