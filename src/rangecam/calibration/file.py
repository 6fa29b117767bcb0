"""What a calibration is, the file that it is kept in (K-CAL-05), and how it comes to the frames."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rangecam.errors import DataError, UsageError
from rangecam.types import Floats, Ints, RawFrame

FORMAT = 2
_PLANE, _STEPPED = "plane_", "stepped_"


def _no_steps() -> Ints:
    return np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of one camera with one ranging method, of any family.

    made_for: facts of camera and method by name; with others it must not be used. settings: tree of camera settings
    that it determines, such as noise parameters: over those of a preset, below those that a user sets. taken: how it
    was taken, among it temperature_c if that was known.
    planes: name -> (H, W), laid beside the samples of every frame. stepped: name -> (K, H, W), of which a frame gets,
    pixel by pixel, the one of its n_acc among `accumulations` (K,).
    """

    made_for: Mapping[str, Any]
    settings: Mapping[str, Any] = field(default_factory=dict)
    taken: Mapping[str, Any] = field(default_factory=dict)
    planes: Mapping[str, Floats] = field(default_factory=dict)
    accumulations: Ints = field(default_factory=_no_steps)
    stepped: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """The planes that a frame gets."""
        return {*self.planes, *self.stepped}


def attach(raw: RawFrame, calibration: Calibration) -> RawFrame:
    """Return the frame with the planes of a calibration beside its samples, in place of planes of the same names.

    Raises DataError for a frame of another shape or a number of accumulations that the calibration does not know.
    """
    shape = raw.shape
    for name, image in [*calibration.planes.items(), *((n, stack[0]) for n, stack in calibration.stepped.items())]:
        if image.shape != shape:
            raise DataError(
                f"frame {raw.frame_id}: its images have shape {shape}, '{name}' of the calibration {image.shape}; "
                "they must be the same"
            )
    planes = {name: image.astype(np.float32) for name, image in calibration.planes.items()}
    if calibration.stepped:
        step = _step(raw, calibration.accumulations)[None]
        for name, stack in calibration.stepped.items():
            planes[name] = np.take_along_axis(stack, step, axis=0)[0].astype(np.float32)
    return RawFrame(raw.time_s, {**raw.planes, **planes}, raw.frame_id)


def _step(raw: RawFrame, accumulations: Ints) -> Ints:
    """Return which of the `accumulations` each pixel was taken with (H, W)."""
    n_acc = np.asarray(raw.planes["n_acc"] if "n_acc" in raw.planes else np.zeros(raw.shape))
    step = np.searchsorted(accumulations, n_acc).clip(max=len(accumulations) - 1)
    unknown = n_acc[(accumulations[step] != n_acc) & (n_acc > 0)]  # 0: such a pixel has no signal
    if unknown.size:
        known = ", ".join(str(n) for n in accumulations)
        raise DataError(
            f"frame {raw.frame_id}: the calibration has no dark image for n_acc = {unknown[0]}; it has {known}"
        )
    return step


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration to `path` (.npz); it appears whole or not at all."""
    from rangecam.io.files import replacing

    arrays: dict[str, Any] = {_PLANE + name: image for name, image in calibration.planes.items()}
    arrays |= {_STEPPED + name: stack for name, stack in calibration.stepped.items()}
    arrays |= {name: json.dumps(dict(getattr(calibration, name))) for name in ("made_for", "settings", "taken")}
    with replacing(path) as part, part.open("wb") as stream:
        np.savez(stream, format=FORMAT, accumulations=calibration.accumulations, **arrays)


def load_calibration(path: Path) -> Calibration:
    """Read a calibration, of whatever camera (see `check_made_for`).

    Raises UsageError if there is no such file, DataError for a file that is no calibration, of another format, or whose
    arrays do not fit together.
    """
    from rangecam.io.files import check_source

    check_source(path)
    if not zipfile.is_zipfile(path):
        raise DataError(f"{path}: not a NumPy archive; rangecam calibrate writes calibrations")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        version = int(arrays["format"])
        texts = {k: json.loads(str(arrays[k])) for k in ("made_for", "settings", "taken")} if version == FORMAT else {}
    except Exception as error:  # whatever zipfile, NumPy and json make of garbage
        raise DataError(f"{path}: not a calibration: {error}") from error
    if version != FORMAT:
        raise DataError(f"{path}: a calibration of format {version}; this version reads {FORMAT}; calibrate again")
    for name, value in texts.items():
        if not isinstance(value, dict):
            raise DataError(f"{path}: not a calibration: {name} holds {value!r}; it must be a table")
    return _checked(path, texts, arrays)


def _checked(path: Path, texts: Mapping[str, Any], arrays: Mapping[str, Any]) -> Calibration:
    """Return the calibration in these arrays; raises DataError if they do not fit together."""
    planes = {key.removeprefix(_PLANE): a for key, a in arrays.items() if key.startswith(_PLANE)}
    stepped = {key.removeprefix(_STEPPED): a for key, a in arrays.items() if key.startswith(_STEPPED)}
    steps = np.asarray(arrays.get("accumulations", _no_steps()))
    if steps.ndim != 1 or steps.dtype.kind not in "ui" or (np.diff(steps.astype(int)) <= 0).any():
        raise DataError(f"{path}: accumulations is {steps.tolist()}; it must be increasing whole numbers")
    shapes = {name: image.shape for name, image in planes.items()}
    shapes |= {name: stack.shape[1:] if stack.shape[:1] == steps.shape else () for name, stack in stepped.items()}
    rows, columns = (texts["made_for"].get(name) for name in ("rows", "columns"))
    for name, shape in shapes.items():
        if len(shape) != 2 or (not steps.size and name in stepped) or (rows, columns) not in ((None, None), shape):
            image = arrays[_PLANE + name] if name in planes else arrays[_STEPPED + name]
            raise DataError(
                f"{path}: {name} has shape {image.shape}, which does not fit {steps.size} accumulations "
                f"and {rows} x {columns} pixels"
            )
    for name, image in {**planes, **stepped}.items():
        if image.dtype.kind != "f" or not np.isfinite(image).all():
            raise DataError(f"{path}: {name} must hold finite numbers")
    return Calibration(texts["made_for"], texts["settings"], texts["taken"], planes, steps, stepped)


def check_made_for(path: Path | str, calibration: Calibration, made_for: Mapping[str, Any]) -> None:
    """Raise UsageError that names the first fact of camera or method for which a calibration was not made."""
    facts, those = (json.loads(json.dumps(dict(each))) for each in (made_for, calibration.made_for))
    for name, value in facts.items():
        found = those.get(name)
        if found != value:
            raise UsageError(
                f"{path}: a calibration for {name} = {found}, but here {name} = {value}; "
                "calibrate this camera with this method"
            )
