"""The floor as the camera saw it without objects (König 2008, 6.3, "from an earlier image")."""

from functools import lru_cache
from pathlib import Path
from zipfile import is_zipfile

import numpy as np

from rangecam.errors import DataError, UsageError
from rangecam.geometry import Lens, Mounting, rays, rotation
from rangecam.types import Floats, Why

_SEEN = [Why.VALID, Why.FLOOR, Why.OUTSIDE_AREA]
"""A pixel refused for one of these reasons has a range all the same."""


@lru_cache(maxsize=16)
def stored_floor(path: str, lens: Lens, mounting: Mounting, shape: tuple[int, int], margin_m: float) -> Floats:
    """Return the range from which on each pixel sees the floor of a file: (H, W) float32 m, inf where it saw none.

    The file holds `range_m` and `why` (N, H, W) of N images of the bare floor; of each pixel counts the median of those
    in which it saw something. Whatever is less than `margin_m` above that belongs to the floor; where it lies above
    half of the height of the camera (a wall), or that is not known, whatever is less than that before it. Raises
    UsageError for no file, or one of another shape, DataError for one that holds no such images.
    """
    range_m = _read(path)
    if range_m.shape[1:] != shape:
        raise UsageError(f"clean.floor_file = {path}: images of {range_m.shape[1:]} pixels; the camera has {shape}")
    seen = np.isfinite(range_m).sum(axis=0) * 2 >= len(range_m)  # a pixel that seldom sees it says nothing
    median = np.full(shape, np.inf)
    median[seen] = np.nanmedian(range_m[:, seen], axis=0)
    down = -(rays(lens, shape) @ rotation(mounting)[2])
    with np.errstate(invalid="ignore"):  # infinitely far times level
        low = (mounting.z_m > 0) & (median * down > mounting.z_m / 2)
    limit: Floats = median - margin_m / np.where(low, down, 1.0)
    return limit.astype(np.float32)


def _read(path: str) -> Floats:
    """Return the ranges (N, H, W), NaN where there is none."""
    if not Path(path).is_file():
        raise UsageError(f"clean.floor = 'image': clean.floor_file = '{path}': there is no such file")
    try:
        if not is_zipfile(path):
            raise ValueError("no archive at all")
        with np.load(path, allow_pickle=False) as file:
            range_m, why = file["range_m"].astype(np.float64), file["why"]
    except Exception as error:  # whatever zipfile and NumPy make of garbage
        raise DataError(f"{path}: not the images that rangecam run --images writes: {error}") from error
    if range_m.ndim != 3 or range_m.shape != why.shape or not len(range_m):
        raise DataError(f"{path}: range_m {range_m.shape} and why {why.shape} must be images (N, rows, columns)")
    ranges: Floats = np.where(np.isin(why, _SEEN) & (range_m > 0), range_m, np.nan)
    return ranges
