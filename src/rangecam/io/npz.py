"""NumPy files (.npz) of raw samples or range images, known by their keys.

Images are (H, W), or (N, H, W) for N frames. Keys that end in `_mm` are turned into metres. A known file may hold more
keys than are used. To add a format, add a row to `FORMATS`; the first one whose keys are all there is taken.
"""

import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rangecam.config import Config
from rangecam.errors import DataError
from rangecam.io.content import Content
from rangecam.types import Capture, Floats, Image, RawFrame

Array = NDArray[Any]
Load = Callable[[str], Array]
"""Returns the array of a key; raises DataError if it cannot be read."""


@dataclass(frozen=True)
class Format:
    """A way to lay out a recording: which keys make which planes, and what else is known from it.

    needs, takes: key -> plane of the images that must, and may, be there. asks: keys of facts that must be there.
    kind, preset: of the camera settings that decode it. raw: samples of a converter, none of which may be NaN.
    shape: (H, W) that the first image must have. time: key of the times.
    """

    what: str
    kind: str
    preset: str
    needs: Mapping[str, str]
    takes: Mapping[str, str] = field(default_factory=dict)
    asks: tuple[str, ...] = ()
    raw: bool = False
    shape: tuple[int, int] | None = None
    time: str = "time_s"


@dataclass(frozen=True)
class Fact:
    """A number in a file that is a setting of the camera: its name there, which values are possible, in words."""

    setting: str
    possible: Callable[[float], bool]
    rule: str
    number: Callable[[float], float] = float


FACTS = {
    "modulation_hz": Fact("modulation_hz", lambda value: value > 0, "greater than 0"),
    "phase_sign": Fact("phase_sign", lambda value: value in (1, -1), "1 or -1", int),
    "pulse_width_s": Fact("pulse_width_s", lambda value: value > 0, "greater than 0"),
    "gate_width_s": Fact("gate_width_s", lambda value: value > 0, "greater than 0"),
    "pulse_lead_s": Fact("pulse_lead_s", lambda value: value >= 0, "0 or greater"),
}


def _same(*names: str) -> dict[str, str]:
    return {name: name for name in names}


_TAPS = [f"{kind}_{i}" for kind in ("tap", "dark", "tap_std", "dark_std") for i in (1, 2, 3)]
_PHASES = ("phase_0", "phase_90", "phase_180", "phase_270")
_BESIDE = _same("amplitude", "noise_m", "status", "targets", "confidence")

FORMATS = (
    Format(
        "raw continuous-wave samples",
        "cw",
        "generic_cw",
        _same(*_PHASES),
        {"camera_range_m": "reference_range_m", **_same("reference_range_m")},
        asks=("modulation_hz",),
        raw=True,
    ),
    Format("raw three-tap samples", "pulsed", "generic_pulsed", _same(*_TAPS[:3]), _same(*_TAPS[3:]), raw=True),
    Format(
        "raw shutter samples",
        "pulsed",
        "usercams",
        _same("shutter_a", "shutter_b", "n_acc"),
        _same("shutter_c", "ambient"),
        raw=True,
    ),
    Format(
        "range images of a VL53L5CX",
        "processed",
        "vl53l5cx",
        {"range_mm": "range_m", "status": "status", "targets": "targets"},
        shape=(8, 8),
    ),
    Format(
        "depth images of an ADTF3175",
        "processed",
        "adtf3175",
        {"depth_mm": "depth_m", "ab": "amplitude", "conf": "confidence"},
    ),
    Format(
        "depth images of an Azure Kinect",
        "processed",
        "azure_kinect",
        {"depth_mm": "depth_m", "ir": "amplitude"},
        time="t",
    ),
    Format(
        "range images of an ifm O3R",
        "processed",
        "ifm_o3r",
        {"radial_m": "range_m", "noise_m": "noise_m", "norm_amp": "amplitude", "confidence": "confidence"},
    ),
    Format("range images", "processed", "terabee_overhead", {"range_mm": "range_m"}, _BESIDE, shape=(60, 80)),
    Format("range images", "processed", "generic_range", {"range_m": "range_m"}, _BESIDE),
    Format("range images", "processed", "generic_range", {"range_mm": "range_m"}, _BESIDE),
    Format("depth images", "processed", "generic_range", {"depth_m": "depth_m"}, _BESIDE),
    Format("depth images", "processed", "generic_range", {"depth_mm": "depth_m"}, _BESIDE),
)
"""What is known; a file of several is the first of them."""


def open_npz(path: Path) -> Content:
    """Read a NumPy file whose keys are known.

    Raises DataError that names the key at fault: none known, one missing, shapes or types that cannot be, NaN among raw
    samples, nothing but NaN, times that decrease, a fact that is no possible number, no frames, a broken file.
    """
    if not zipfile.is_zipfile(path):
        raise DataError(f"{path}: not a NumPy archive, or cut off; write one with numpy.savez")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return _read(path, list(file.files), cache(partial(_array, path, file)))
    except DataError:
        raise
    except Exception as error:  # whatever zipfile and NumPy make of garbage
        raise DataError(f"{path}: not a readable NumPy archive: {error}") from error


def _array(path: Path, file: Mapping[str, Any], key: str) -> Array:
    """Return an array of numbers in native byte order."""
    try:
        array = file[key]
    except Exception as error:  # whatever zipfile and NumPy make of garbage
        raise DataError(f"{path}: {key} cannot be read: {error}") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "buif":
        held = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise DataError(f"{path}: {key} holds {held}; it must hold real numbers")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _read(path: Path, keys: list[str], load: Load) -> Content:
    format_ = _choose(path, keys, load)
    used = {**format_.needs, **{key: plane for key, plane in format_.takes.items() if key in keys}}
    arrays = {key: load(key) for key in used}
    shape = _check_images(path, format_, arrays)
    n_frames = shape[0] if len(shape) == 3 else 1
    times = _times(path, format_.time, load, n_frames) if format_.time in keys else None
    facts = {FACTS[key].setting: _fact(path, key, load) for key in FACTS if key in keys and format_.raw}
    _lead_on_gate_2(path, facts)
    ignored = [key for key in keys if key not in {*used, *FACTS, format_.time}]
    notes = []
    if ignored:
        notes.append(f"{path}: taken as {format_.what}; not used: {_list(ignored)}")
    if times is None and n_frames > 1:
        notes.append(f"{path}: no {format_.time} in it; frames are taken at camera.frame_rate_hz")

    def captures(config: Config) -> Iterator[Capture]:
        for k in range(n_frames):
            time_s = k / config.camera.frame_rate_hz if times is None else float(times[k])
            planes = {plane: _plane(key, arrays[key], k) for key, plane in used.items()}
            yield Capture(RawFrame(time_s, planes, k))

    return Content(
        what=format_.what,
        kind=format_.kind,
        preset=format_.preset,
        captures=captures,
        n_frames=lambda _: n_frames,
        facts={"camera": {"kind": format_.kind, "rows": shape[-2], "columns": shape[-1], **facts}},
        notes=tuple(notes),
    )


def _choose(path: Path, keys: list[str], load: Load) -> Format:
    """Return the first format that the keys fit; raises DataError that names what is missing for the nearest one."""
    for format_ in FORMATS:
        if {*format_.needs, *format_.asks} <= {*keys} and _has_shape(format_, load):
            return format_
    near = max(FORMATS, key=lambda f: _share(f, keys))
    missing = [key for key in (*near.needs, *near.asks) if key not in keys]
    if _share(near, keys) >= 0.5:
        raise DataError(
            f"{path}: {near.what} need {_list(missing)}, which {'is' if len(missing) == 1 else 'are'} missing; "
            f"it holds {_list(keys)}"
        )
    known = dict.fromkeys(" ".join([*f.needs, *f.asks]) for f in FORMATS)
    raise DataError(f"{path}: no known keys in it; it holds {_list(keys) or 'nothing'}; known: {' | '.join(known)}")


def _has_shape(format_: Format, load: Load) -> bool:
    return format_.shape is None or load(next(iter(format_.needs))).shape[-2:] == format_.shape


def _share(format_: Format, keys: list[str]) -> float:
    needed = {*format_.needs, *format_.asks}
    return len(needed & {*keys}) / len(needed)


def _list(keys: list[str]) -> str:
    return ", ".join(keys[:12]) + (f" and {len(keys) - 12} more" if len(keys) > 12 else "")


def _check_images(path: Path, format_: Format, arrays: Mapping[str, Array]) -> tuple[int, ...]:
    """Return the shape (H, W) or (N, H, W) that all images have; raises DataError if they are not such images."""
    first = next(iter(arrays))
    shape = arrays[first].shape
    if len(shape) not in (2, 3):
        raise DataError(f"{path}: {first} has shape {shape}; it must be (H, W), or (N, H, W) for N frames")
    if 0 in shape:
        raise DataError(f"{path}: {first} has shape {shape}: there is no frame in it")
    for key, array in arrays.items():
        # one dark image may serve all frames
        if array.shape != shape and not (key.startswith("dark") and array.shape == shape[-2:]):
            raise DataError(f"{path}: {key} has shape {array.shape}, but {first} has {shape}; they must be the same")
        if key not in format_.needs or array.dtype.kind != "f":
            continue
        bad = np.count_nonzero(~np.isfinite(array))
        if format_.raw and bad:
            raise DataError(
                f"{path}: {key} holds NaN or infinity in {bad} of {array.size} samples; raw samples must be numbers"
            )
        if bad == array.size:
            raise DataError(f"{path}: {key} holds nothing but NaN or infinity")
    return shape


def _times(path: Path, key: str, load: Load, n_frames: int) -> Floats:
    """Return the (N,) times of the frames, s; raises DataError unless each has one and none decreases."""
    times = np.atleast_1d(load(key)).astype(np.float64)
    if times.shape != (n_frames,):
        raise DataError(f"{path}: {key} has shape {times.shape}; there are {n_frames} frames, each needs one time")
    if not np.isfinite(times).all():
        raise DataError(f"{path}: {key} holds NaN or infinity; each frame needs a time")
    late = np.flatnonzero(np.diff(times) < 0)  # frames that were delivered together may have the same time
    if len(late):
        k = int(late[0]) + 1
        raise DataError(
            f"{path}: {key} must not decrease; frame {k} is at {times[k]} s, the one before at {times[k - 1]} s"
        )
    return times


def _fact(path: Path, key: str, load: Load) -> float:
    """Return a number that the file states; raises DataError if it is no possible one."""
    value, fact = load(key), FACTS[key]
    if value.size != 1:
        raise DataError(f"{path}: {key} has shape {value.shape}; it must be one number")
    number = float(value.reshape(-1)[0])
    if not (np.isfinite(number) and fact.possible(number)):
        raise DataError(f"{path}: {key} is {number:g}; it must be {fact.rule}")
    return fact.number(number)


def _lead_on_gate_2(path: Path, facts: dict[str, Any]) -> None:
    """Turn the lead of the pulse as files state it into that on the opening of gate 2, which the camera's setting is.

    Files count it from a pulse that rises with gate 2 of gates as long as itself. The gates follow the opening of gate
    1, which stays where it is: shorter ones bring gate 2 forward by what they are shorter, and that is not lead.
    Raises DataError if nothing is left.
    """
    if {"pulse_lead_s", "pulse_width_s", "gate_width_s"} <= {*facts} and facts["pulse_lead_s"] > 0:
        lead_s = facts["pulse_lead_s"] - (facts["pulse_width_s"] - facts["gate_width_s"])
        if lead_s <= 0:
            raise DataError(
                f"{path}: pulse_lead_s is {facts['pulse_lead_s']:g}; gates shorter than the pulse open gate 2 earlier "
                "by pulse_width_s - gate_width_s, and the lead must be longer than that"
            )
        facts["pulse_lead_s"] = lead_s


def _plane(key: str, array: Array, k: int) -> Image:
    """Return image k of an array, in metres if it is in millimetres."""
    image = array if array.ndim == 2 else array[k]
    if key.endswith("_mm"):
        return (image / 1000.0).astype(np.float32)
    return np.ascontiguousarray(image)
