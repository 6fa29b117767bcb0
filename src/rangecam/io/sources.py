"""Sources by URL: scenarios, recordings and NumPy files, each with the configuration to process it with."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from rangecam.calibration import Calibration, attach, check_made_for, load_calibration
from rangecam.config import FAMILIES, Config, load_config, merge, preset_names, preset_tree, tree
from rangecam.errors import DataError, UsageError
from rangecam.io import npz, recording
from rangecam.io.content import Captures, Content, Source
from rangecam.io.files import check_source
from rangecam.io.udp.source import open_udp
from rangecam.pulsed import warnings_of
from rangecam.types import Capture

_RECALIBRATE_K = 10.0
_WORKS_C = (0.0, 50.0)
_FAMILY = {"cw": "continuous-wave", "pulsed": "pulsed", "processed": "range-image"}


def open_source(
    url: str | PathLike[str],
    config: Config | None = None,
    *,
    preset: str | None = None,
    layers: Sequence[Mapping[str, Any]] = (),
    seed: int = 0,
) -> Source:
    """Open `scenario:NAME`, a recording (.mcap), a NumPy file (.npz) or a stream `udp://HOST:PORT`.

    Its settings, the last winning: those of `preset` (else of a preset named in `layers`, else those recorded with the
    source or of the preset that it suggests); facts that it states itself, such as its modulation frequency; those that
    the calibration determines; `layers` of nested dicts. Or a ready `config`, which is taken as it is. seed: of the
    simulated noise. The captures carry the calibration that `camera.calibration` names and no other; a recording that
    was made with it has it already, and the file is not needed.
    Raises UsageError if there is no such source or the settings do not suit it, DataError if its content is at fault.
    """
    if config is not None and (preset or layers):
        raise UsageError("give either a ready configuration or a preset and layers of settings, not both")
    name = str(url)
    content = _open(name, seed)
    try:
        return _opened(name, content, config, preset, layers)
    except BaseException:
        if content.live is not None:
            content.live.stop()
        raise


def _opened(
    name: str, content: Content, config: Config | None, preset: str | None, layers: Sequence[Mapping[str, Any]]
) -> Source:
    """Return the source with the settings that it is to be processed with, and its captures with their calibration."""
    if config is None:
        base, *settings = _layers(name, content, preset, layers)
        calibration = _calibration(content, merge(preset_tree(base) if base else {}, *settings))
        config = load_config(
            base, *settings[:2], {"camera": calibration.settings} if calibration else {}, *settings[2:]
        )
    else:
        calibration = _calibration(content, tree(config))
    _check_kind(name, content, config.camera.kind, config.preset)
    captures = Captures(partial(content.captures, config))
    notes = content.notes
    if config.camera.kind != "processed":  # which calibrates itself
        path = config.camera.calibration
        captures = _calibrated(content, captures, path, calibration, config)
        notes = (*notes, *_advice(content, path, calibration, config))
    return Source(name, config, captures, content.n_frames(config), notes, content.live)


def _recorded(content: Content) -> str:
    """Return the name of the calibration that samples were recorded with."""
    return str(content.settings.get("camera", {}).get("calibration", ""))


def _calibration(content: Content, settings: Mapping[str, Any]) -> Calibration | None:
    """Return the calibration that these settings name, unless it is the one that was recorded with the samples."""
    camera = settings.get("camera")
    path = camera.get("calibration") if isinstance(camera, Mapping) else None
    return None if not path or path == _recorded(content) else load_calibration(Path(str(path)))


def _calibrated(
    content: Content, captures: Captures, path: str, calibration: Calibration | None, config: Config
) -> Captures:
    """Return the captures with the planes of the calibration at `path`, and of no other; none: those recorded.

    Raises UsageError if it was made for another camera or method.
    """
    family: Any = FAMILIES[config.camera.kind]
    facts = family.made_for(config.camera, config.ranging)
    if path and path == _recorded(content):
        taken = load_config(None, content.settings)
        check_made_for(path, Calibration(family.made_for(taken.camera, taken.ranging)), facts)
        return captures
    if calibration is not None:
        check_made_for(path, calibration, facts)

    def begin() -> Iterator[Capture]:
        for capture in captures:
            planes = {k: plane for k, plane in capture.raw.planes.items() if not k.startswith(family.PLANES)}
            raw = replace(capture.raw, planes=planes)
            yield replace(capture, raw=raw if calibration is None else attach(raw, calibration))

    return Captures(begin)


def _advice(content: Content, path: str, calibration: Calibration | None, config: Config) -> Iterator[str]:
    """Yield what a user should know of the camera and of its calibration (K-CAL-02, K-ILL-08)."""
    if config.camera.kind == "pulsed":
        yield from warnings_of(config.camera)
    recorded = _recorded(content)
    if recorded and path != recorded:
        yield f"the calibration that it was recorded with, {recorded}, is not used"
    now_c = getattr(config.camera, "temperature_c", None)
    taken_c = calibration.taken.get("temperature_c") if calibration else None
    if now_c is not None and not _WORKS_C[0] <= now_c <= _WORKS_C[1]:
        yield f"camera.temperature_c = {now_c:g}: nobody has tried it outside of {_WORKS_C[0]:g} to {_WORKS_C[1]:g} C"
    if now_c is not None and taken_c is not None and abs(now_c - taken_c) >= _RECALIBRATE_K:
        yield (
            f"{path} was taken at {taken_c:g} C, the camera is at {now_c:g} C: offsets move with the temperature; "
            f"calibrate again when it has changed by {_RECALIBRATE_K:g} K"
        )
    for key, value in calibration.settings.items() if calibration else ():
        used = tree(config)["camera"].get(key)
        if merge({key: used}, {key: value})[key] != used:
            yield f"camera.{key} is not that of the calibration {path}"


def _open(name: str, seed: int) -> Content:
    scheme, colon, rest = name.partition(":")
    if colon and scheme in SCHEMES:
        return SCHEMES[scheme](rest, seed)
    suffix = Path(name).suffix.lower()
    if "://" in name or suffix not in SUFFIXES:
        files = " or ".join(SUFFIXES)
        raise UsageError(
            f"{name}: nobody knows how to open this; a source is scenario:NAME, udp://HOST:PORT or a file ({files})"
        )
    path = check_source(name)
    if path.stat().st_size == 0:
        raise DataError(f"{name}: the file is empty")
    return SUFFIXES[suffix](path)


def _layers(name: str, content: Content, preset: str | None, layers: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    """Return the preset to begin with and the layers over it: recorded settings, facts, then those of the caller."""
    chosen = preset or next((str(layer["preset"]) for layer in reversed(layers) if "preset" in layer), None)
    base, settings = _base(name, content, chosen)
    camera = merge(preset_tree(base) if base else {}, settings, *layers).get("camera")
    if isinstance(camera, Mapping):
        _check_kind(name, content, camera.get("kind", "cw"), chosen or content.preset)
    return base, settings, content.facts, *layers


def _base(name: str, content: Content, chosen: str | None) -> tuple[str | None, Mapping[str, Any]]:
    """Return the preset to begin with and the settings over it: the recorded ones, unless a preset was chosen."""
    if chosen or not content.settings:
        return chosen or content.preset, {}
    # recorded settings are complete, and their preset may be one that this version does not have
    base = content.preset if content.preset in preset_names() else None
    try:
        load_config(base, content.settings)
    except UsageError as error:
        raise DataError(f"{name}: its settings do not fit this version, try another --preset: {error}") from error
    return base, content.settings


def _check_kind(name: str, content: Content, kind: str, preset: str) -> None:
    """Raise UsageError if the settings are for another family of cameras than the samples."""
    if content.kind not in (None, kind):
        raise UsageError(
            f"{name} holds {content.what}; preset '{preset}' is for a {_FAMILY.get(kind, kind)} camera; "
            f"use one for a {_FAMILY.get(str(content.kind), content.kind)} camera, such as {content.preset}"
        )


def _open_scenario(name: str, seed: int) -> Content:
    """Return the captures of a simulated camera in a scenario that ships with rangecam, or in a file NAME.toml."""
    from rangecam.cameras import open_camera
    from rangecam.scene.scenario import load_scenario, parse_scenario

    if name.endswith(".toml"):
        try:
            scenario = parse_scenario(Path(name).stem, Path(name).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"scenario:{name}: cannot be read: {error}") from error
    else:
        scenario = load_scenario(name)

    def n_frames(config: Config) -> int:
        return max(1, round(scenario.duration_s * (scenario.frame_rate_hz or config.camera.frame_rate_hz)))

    return Content(
        what=f"the scene {scenario.name}",
        kind=None,
        preset=scenario.preset,
        captures=lambda config: open_camera("simulated")(scenario, config, seed),
        n_frames=n_frames,
    )


SCHEMES: dict[str, Callable[[str, int], Content]] = {"scenario": _open_scenario, "udp": open_udp}
"""Openers by the scheme of a URL: (the rest of it, seed) -> Content."""
SUFFIXES: dict[str, Callable[[Path], Content]] = {".npz": npz.open_npz, ".mcap": recording.open_recording}
"""Openers by the suffix of a file."""
