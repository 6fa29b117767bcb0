"""Configuration: TOML in, frozen dataclasses out. The only module that imports pydantic.

Later sources win: defaults < preset < the recording's own facts < a file (`--config`) < single settings (`--set`).
Every module declares its own piece with `@settings`; `Config` puts the pieces together.
"""

import dataclasses
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from rangecam import cw, processed, pulsed
from rangecam.brake import BrakeSettings, DecisionSettings
from rangecam.classify import ClassificationSettings
from rangecam.clean import CleanSettings, shared_noise_pixels
from rangecam.cw import CwCamera
from rangecam.cw.registers import written
from rangecam.errors import UsageError, did_you_mean
from rangecam.geometry import Lens, Mounting, pixel_pitch
from rangecam.processed import ProcessedCamera
from rangecam.pulsed import PulsedCamera
from rangecam.segmentation import SEGMENTATION, SegmentSettings
from rangecam.settings import settings
from rangecam.tracking import TrackingSettings

T = TypeVar("T")
Tree = Mapping[str, Any]

Camera = Annotated[CwCamera | PulsedCamera | ProcessedCamera, Field(discriminator="kind")]
FAMILIES = {"cw": cw, "pulsed": pulsed, "processed": processed}
"""Camera families by the `kind` of their settings."""

__all__ = [
    "Camera",
    "Config",
    "Lens",
    "load_config",
    "merge",
    "overrides",
    "parse",
    "preset_names",
    "preset_tree",
    "tree",
]


@settings
class Config:
    """Everything that can be set, each part named after the module that takes it."""

    preset: str = "scaled_car"
    """Name of the preset that this configuration started from."""
    description: str = ""
    ranging: str = "cw_four_phase"
    """Ranging method, a key of `pipeline.RANGING`."""
    segmentation: str = "range_histogram"
    """Segmentation method, a key of `segmentation.SEGMENTATION`."""
    camera: Camera = CwCamera()
    mounting: Mounting = Mounting()
    clean: CleanSettings = CleanSettings()
    segments: SegmentSettings = SegmentSettings()
    tracking: TrackingSettings = TrackingSettings()
    classification: ClassificationSettings = ClassificationSettings()
    decision: DecisionSettings = DecisionSettings()
    brake: BrakeSettings = BrakeSettings()


def load_config(preset: str | None = None, *layers: Tree) -> Config:
    """Return the configuration of a preset (default: scaled_car) with `layers` of settings over it, the last winning.

    `decision.pixel_pitch_deg` is that of the camera, `segments.shared_noise_pixels` that of the filters of
    ranging and `clean`, unless a layer sets them.
    Raises UsageError for an unknown preset, an unknown setting or an impossible value, naming it and what is allowed.
    """
    values = merge(preset_tree(preset or "scaled_car"), *layers)
    config = parse(Config, values, "configuration")
    if config.camera.kind == "cw" and config.camera.registers:
        config = replace(config, camera=written(config.camera))
    if "pixel_pitch_deg" not in values.get("decision", {}):
        config = replace(config, decision=replace(config.decision, pixel_pitch_deg=_pitch_deg(config.camera)))
    if "shared_noise_pixels" not in values.get("segments", {}):
        shared = shared_noise_pixels(config.clean)
        if config.camera.kind == "cw":
            shared *= cw.shared_noise_pixels(config.camera)
        config = replace(config, segments=replace(config.segments, shared_noise_pixels=shared))
    _check_choice("ranging", config.ranging, sorted(FAMILIES[config.camera.kind].RANGING))
    _check_choice("segmentation", config.segmentation, sorted(SEGMENTATION))
    return config


def _pitch_deg(camera: CwCamera | PulsedCamera | ProcessedCamera) -> float:
    """Return the angle between neighbouring pixels in the image centre, the geometric mean of both directions."""
    across, down = pixel_pitch(camera.lens, (camera.rows, camera.columns))
    return math.degrees(math.sqrt(across * down))


def preset_names() -> list[str]:
    """Return the names of the presets that ship with rangecam, sorted."""
    entries = files("rangecam").joinpath("presets").iterdir()
    return sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml"))


def preset_tree(name: str) -> dict[str, Any]:
    """Return the settings of a preset as nested dicts; raises UsageError if there is none of that name."""
    known = preset_names()
    if name not in known:
        raise UsageError(f"unknown preset '{name}'{did_you_mean(name, known)}; presets: {', '.join(known)}")
    text = files("rangecam").joinpath("presets", f"{name}.toml").read_text(encoding="utf-8")
    return {**tomllib.loads(text), "preset": name}


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return the content of a TOML file as nested dicts; raises UsageError if it cannot be read or parsed."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot read the configuration: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not a TOML file: {error}") from error


def overrides(assignments: Sequence[str]) -> dict[str, Any]:
    """Turn `a.b=value` assignments into nested dicts; values are TOML, anything else is a string.

    Raises UsageError for an assignment without a key or an equals sign.
    """
    result: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"--set {assignment}: expected key=value, for example --set clean.filter=off")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text
        for part in reversed(key.strip().split(".")):
            value = {part: value}
        result = merge(result, value)
    return result


def merge(*trees: Tree) -> dict[str, Any]:
    """Merge nested dicts, the last one winning. A camera of another kind replaces the earlier one as a whole."""
    result: dict[str, Any] = {}
    for layer in trees:
        for key, value in layer.items():
            old = result.get(key)
            if isinstance(old, dict) and isinstance(value, Mapping):
                replaced = "kind" in value and old.get("kind", value["kind"]) != value["kind"]
                result[key] = dict(value) if replaced else merge(old, value)
            else:
                result[key] = value
    return result


def tree(config: Any) -> dict[str, Any]:
    """Return a settings dataclass as nested dicts of JSON values: the inverse of `parse`."""
    result: dict[str, Any] = _adapter(type(config)).dump_python(config, mode="json")
    return result


def parse(kind: type[T], values: Tree, where: str) -> T:
    """Build the settings dataclass `kind` from nested dicts.

    Raises UsageError that names the key, the value and what is allowed; `where` says what was being read.
    """
    try:
        result: T = _adapter(kind).validate_python(values)
    except ValidationError as error:
        raise UsageError(f"{where}: {_explain(error, kind)}") from error
    return result


_ADAPTERS: dict[Any, TypeAdapter[Any]] = {}


def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Return the validator of a settings dataclass; building one takes milliseconds, so it is done once."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


def _explain(error: ValidationError, kind: type[Any]) -> str:
    """Return the first fault of a validation in one phrase, with the nearest known key if it was misspelled."""
    fault = error.errors()[0]
    path = [str(part) for part in fault["loc"] if str(part) not in FAMILIES]
    key = ".".join(path) or "the whole"
    if fault["type"] == "unexpected_keyword_argument":
        known = _known_keys(kind, [str(part) for part in fault["loc"][:-1]])
        return f"unknown setting '{key}'{did_you_mean(path[-1], known)}; known here: {', '.join(known)}"
    value = fault["input"] if not isinstance(fault["input"], Mapping) else "..."
    return f"{key} = {value!r}: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def _known_keys(kind: Any, path: Sequence[str]) -> list[str]:
    """Return the field names of the dataclass that lies under `path` in `kind`."""
    for part in path:
        for inner in _dataclasses_in(kind):
            fields = {f.name: f.type for f in dataclasses.fields(inner)}
            if part in fields:
                kind = fields[part]
                break
            if part == getattr(inner, "kind", None):
                kind = inner
                break
    return sorted({f.name for inner in _dataclasses_in(kind) for f in dataclasses.fields(inner)})


def _dataclasses_in(kind: Any) -> list[Any]:
    """Return `kind` if it is a dataclass, else the dataclasses among the members of a union or annotation."""
    if dataclasses.is_dataclass(kind):
        return [kind]
    return [inner for argument in getattr(kind, "__args__", ()) for inner in _dataclasses_in(argument)]


def _check_choice(key: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise UsageError(f"{key} = '{value}'{did_you_mean(value, known)}; possible here: {', '.join(known)}")
