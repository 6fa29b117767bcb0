"""Calibration: what a camera reads in darkness, and the line from measured to true range, of every pixel.

Estimated from frames (`estimate_dark`, `fit_range`), saved and loaded as one .npz file that knows what camera and
method it was made for, and laid beside the samples as planes (`attach`): a recording then holds its own calibration,
and the chain stays a function of its arguments. What it corrects, and when, is the business of the camera family.
"""

import json
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rangecam.errors import DataError, UsageError
from rangecam.types import Floats, Ints, RangeImage, RawFrame

_FORMAT = 1
_DARK = "dark_"


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of every pixel of one camera with one ranging method.

    made_for: facts of camera and method, by name. accumulations (K,): numbers of pulses of the dark images.
    dark: plane -> (K, H, W), its value without light. slope, intercept_m (H, W): true range = slope times the measured
    one + intercept_m. As the range is a linear function of the quotient of König 2008, 4.3.2, so are these of its
    slope and intercept.
    """

    made_for: Mapping[str, Any]
    accumulations: Ints
    dark: Mapping[str, Floats]
    slope: Floats
    intercept_m: Floats


def estimate_dark(frames: Iterable[RawFrame]) -> tuple[Ints, dict[str, Floats]]:
    """Return the numbers of accumulations (K,) and the dark image of each shutter plane for each of them (K, H, W).

    frames: taken without any light, some of each number; what their mean leaves of the noise stays in every range, so
    take many. König 2008, 4.3.1 (K-CAL-01). Raises DataError for no frames, a frame without n_acc or shutter_* planes,
    or one whose pixels differ in n_acc: it was not dark.
    """
    by_step: dict[int, list[Mapping[str, Any]]] = {}
    for raw in frames:
        names = [name for name in raw.planes if name.startswith("shutter_")]
        if "n_acc" not in raw.planes or not names:
            raise DataError(
                f"frame {raw.frame_id}: a dark frame needs n_acc and shutter_* planes, it has {[*raw.planes]}"
            )
        steps = np.unique(raw.planes["n_acc"])
        if len(steps) != 1:
            raise DataError(
                f"frame {raw.frame_id}: its pixels have n_acc = {', '.join(f'{n:g}' for n in steps)}; in darkness and "
                "with one number of accumulations at a time they would all have the same"
            )
        by_step.setdefault(int(steps[0]), []).append({name: raw.planes[name] for name in names})
    if not by_step:
        raise DataError("no dark frames: at least one is needed")
    accumulations: Ints = np.array(sorted(by_step), np.int64)
    planes = next(iter(by_step.values()))[0]
    dark: dict[str, Floats] = {
        name: np.stack(
            [np.mean([frame[name] for frame in by_step[n]], axis=0, dtype=np.float64) for n in accumulations]
        )
        for name in planes
    }
    return accumulations, dark


def fit_range(images: Sequence[RangeImage], known_m: Sequence[float]) -> tuple[Floats, Floats]:
    """Return slope and intercept, m, (H, W) of the line from measured to true range of each pixel.

    images: of a plane target at the ranges `known_m`, already without their offset; only valid pixels count, by their
    1 / sigma2. The measured range is fitted over the known one, as in König 2008, 4.3.2 (K-CAL-03), and the line
    inverted. Raises DataError if a pixel was not seen at two ranges, or its range does not grow.
    """
    known = np.asarray(known_m, np.float64)[:, None, None]
    valid = np.stack([image.valid for image in images])
    measured = np.where(valid, np.stack([image.range_m for image in images]), 0.0).astype(np.float64)
    weight = np.where(valid, 1 / np.where(valid, np.stack([image.sigma_m for image in images]), 1.0) ** 2, 0.0)
    total = weight.sum(axis=0)
    mean_known, mean_measured = ((weight * x).sum(axis=0) / np.where(total > 0, total, 1.0) for x in (known, measured))
    spread = (weight * (known - mean_known) ** 2).sum(axis=0)
    seen = spread > 1e-12 * total
    gain = (weight * (known - mean_known) * (measured - mean_measured)).sum(axis=0) / np.where(seen, spread, 1.0)
    bad = np.argwhere(~seen | (gain <= 0))
    if len(bad):
        row, column = bad[0]
        raise DataError(
            f"{len(bad)} pixels, the first in row {row}, column {column}, have no line from measured to true range: "
            "each must be valid at two ranges or more, and measure the farther one as farther"
        )
    return 1 / gain, mean_known - mean_measured / gain


def attach(raw: RawFrame, calibration: Calibration) -> RawFrame:
    """Return the frame with the planes of its calibration: offset_* for each shutter_*, range_slope, range_intercept_m.

    The offset of a pixel is that of its n_acc. Raises DataError for a frame of another shape or a number of
    accumulations without a dark image.
    """
    n_acc = np.asarray(raw.planes["n_acc"] if "n_acc" in raw.planes else np.zeros(raw.shape))
    if n_acc.shape != calibration.slope.shape:
        raise DataError(
            f"frame {raw.frame_id}: its images have shape {n_acc.shape}, those of the calibration "
            f"{calibration.slope.shape}; they must be the same"
        )
    step = np.searchsorted(calibration.accumulations, n_acc).clip(max=len(calibration.accumulations) - 1)
    unknown = n_acc[(calibration.accumulations[step] != n_acc) & (n_acc > 0)]  # 0: such a pixel has no signal
    if unknown.size:
        known = ", ".join(str(n) for n in calibration.accumulations)
        raise DataError(
            f"frame {raw.frame_id}: the calibration has no dark image for n_acc = {unknown[0]}; it has {known}"
        )
    offsets = {
        name.replace("shutter_", "offset_"): np.take_along_axis(dark, step[None], axis=0)[0].astype(np.float32)
        for name, dark in calibration.dark.items()
    }
    line = {
        "range_slope": calibration.slope.astype(np.float32),
        "range_intercept_m": calibration.intercept_m.astype(np.float32),
    }
    return RawFrame(raw.time_s, {**raw.planes, **offsets, **line}, raw.frame_id)


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration to `path` (.npz); it appears whole or not at all (K-CAL-05)."""
    from rangecam.io.files import replacing

    arrays: dict[str, Any] = {_DARK + name: dark for name, dark in calibration.dark.items()}
    with replacing(path) as part, part.open("wb") as stream:
        np.savez(
            stream,
            format=_FORMAT,
            made_for=json.dumps(dict(calibration.made_for)),
            accumulations=calibration.accumulations,
            range_slope=calibration.slope,
            range_intercept_m=calibration.intercept_m,
            **arrays,
        )


def load_calibration(path: Path, made_for: Mapping[str, Any]) -> Calibration:
    """Read a calibration that was made for these facts of camera and method.

    Raises UsageError if there is no such file or it was made for others, naming the first that differs; DataError for a
    file that is no calibration, of another format, or whose arrays do not fit together.
    """
    from rangecam.io.files import check_source

    check_source(path)
    if not zipfile.is_zipfile(path):
        raise DataError(f"{path}: not a NumPy archive; write a calibration with save_calibration")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        found = json.loads(str(arrays["made_for"])) if int(arrays["format"]) == _FORMAT else None
    except Exception as error:  # whatever zipfile, NumPy and json make of garbage
        raise DataError(f"{path}: not a calibration: {error}") from error
    if not isinstance(found, dict):
        raise DataError(f"{path}: a calibration of format {arrays['format']}; this version reads {_FORMAT}")
    for name, value in json.loads(json.dumps(dict(made_for))).items():
        if found.get(name) != value:
            raise UsageError(
                f"{path}: a calibration for {name} = {found.get(name)}, but here {name} = {value}; "
                "calibrate this camera with this method"
            )
    return _checked(path, found, arrays)


def _checked(path: Path, made_for: Mapping[str, Any], arrays: Mapping[str, Any]) -> Calibration:
    """Return the calibration in these arrays; raises DataError if they do not fit together."""
    missing = [key for key in ("accumulations", "range_slope", "range_intercept_m") if key not in arrays]
    if missing:
        raise DataError(f"{path}: not a calibration: {', '.join(missing)} missing")
    steps, slope, intercept_m = (arrays[key] for key in ("accumulations", "range_slope", "range_intercept_m"))
    dark = {key.removeprefix(_DARK): array for key, array in arrays.items() if key.startswith(_DARK)}
    if steps.ndim != 1 or steps.dtype.kind not in "ui" or not steps.size or (np.diff(steps.astype(int)) <= 0).any():
        raise DataError(f"{path}: accumulations is {steps.tolist()}; it must be increasing whole numbers")
    shapes = {"range_slope": slope.shape, "range_intercept_m": intercept_m.shape}
    wrong = [name for name, shape in shapes.items() if len(shape) != 2 or shape != slope.shape]
    wrong += [_DARK + name for name, array in dark.items() if array.shape != (len(steps), *slope.shape)]
    if wrong:
        raise DataError(f"{path}: {wrong[0]} has shape {arrays[wrong[0]].shape}, which does not fit the other arrays")
    for name in ("range_slope", "range_intercept_m", *(_DARK + name for name in dark)):
        if arrays[name].dtype.kind != "f" or not np.isfinite(arrays[name]).all():
            raise DataError(f"{path}: {name} must hold finite numbers")
    if (slope <= 0).any():
        raise DataError(f"{path}: range_slope must be above 0")
    return Calibration(made_for, steps, dark, slope, intercept_m)
