"""Sources by URL: scenarios, recordings and NumPy files, each with the configuration to process it with."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from rangecam.config import Config, load_config, merge, preset_names, preset_tree
from rangecam.errors import DataError, UsageError
from rangecam.io import npz, recording
from rangecam.io.content import Captures, Content, Source
from rangecam.io.files import check_source
from rangecam.pulsed import made_for
from rangecam.types import Capture

_FAMILY = {"cw": "continuous-wave", "pulsed": "pulsed", "processed": "range-image"}


def open_source(
    url: str | PathLike[str],
    config: Config | None = None,
    *,
    preset: str | None = None,
    layers: Sequence[Mapping[str, Any]] = (),
    seed: int = 0,
) -> Source:
    """Open `scenario:NAME`, a recording (.mcap) or a NumPy file (.npz).

    Its settings, the last winning: those of `preset` (else of a preset named in `layers`, else those recorded with the
    source or of the preset that it suggests); facts that it states itself, such as its modulation frequency; `layers`
    of nested dicts. Or a ready `config`, which is taken as it is. seed: of the simulated noise.
    The captures carry the calibration that `camera.calibration` names, unless it is the one that was recorded.
    Raises UsageError if there is no such source or the settings do not suit it, DataError if its content is at fault.
    """
    if config is not None and (preset or layers):
        raise UsageError("give either a ready configuration or a preset and layers of settings, not both")
    name = str(url)
    content = _open(name, seed)
    if config is None:
        config = _configure(name, content, preset, layers)
    _check_kind(name, content, config.camera.kind, config.preset)
    captures = _calibrated(content, config) or Captures(partial(content.captures, config))
    return Source(name, config, captures, content.n_frames(config), content.notes)


def _calibrated(content: Content, config: Config) -> Captures | None:
    """Return the captures with the planes of `camera.calibration`; None without one, or if the recording has them."""
    camera = config.camera
    recorded = content.settings.get("camera", {}).get("calibration")
    if camera.kind != "pulsed" or not camera.calibration or camera.calibration == recorded:
        return None
    from rangecam.calibration import attach, load_calibration

    calibration = load_calibration(Path(camera.calibration), made_for(camera, config.ranging))

    def captures() -> Iterator[Capture]:
        for capture in content.captures(config):
            yield replace(capture, raw=attach(capture.raw, calibration))

    return Captures(captures)


def _open(name: str, seed: int) -> Content:
    scheme, colon, rest = name.partition(":")
    if colon and scheme in SCHEMES:
        return SCHEMES[scheme](rest, seed)
    suffix = Path(name).suffix.lower()
    if "://" in name or suffix not in SUFFIXES:
        files = " or ".join(SUFFIXES)
        raise UsageError(f"{name}: nobody knows how to open this; a source is scenario:NAME or a file ({files})")
    path = check_source(name)
    if path.stat().st_size == 0:
        raise DataError(f"{name}: the file is empty")
    return SUFFIXES[suffix](path)


def _configure(name: str, content: Content, preset: str | None, layers: Sequence[Mapping[str, Any]]) -> Config:
    """Return the configuration of a source; see `open_source` for who wins."""
    chosen = preset or next((str(layer["preset"]) for layer in reversed(layers) if "preset" in layer), None)
    base, settings = _base(name, content, chosen)
    camera = merge(preset_tree(base) if base else {}, settings, *layers).get("camera")
    if isinstance(camera, Mapping):
        _check_kind(name, content, camera.get("kind", "cw"), chosen or content.preset)
    return load_config(base, settings, content.facts, *layers)


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


SCHEMES: dict[str, Callable[[str, int], Content]] = {"scenario": _open_scenario}
"""Openers by the scheme of a URL: (the rest of it, seed) -> Content."""
SUFFIXES: dict[str, Callable[[Path], Content]] = {".npz": npz.open_npz, ".mcap": recording.open_recording}
"""Openers by the suffix of a file."""
