"""Rays that were measured for every pixel, from a file: the exact angles of a calibrated lens (S-PRE-02)."""

from functools import lru_cache
from pathlib import Path
from zipfile import is_zipfile

import numpy as np

from rangecam.errors import DataError, UsageError
from rangecam.types import Floats


def measured_rays(path: str, shape: tuple[int, int]) -> Floats:
    """Return the unit rays of a table for an image of `shape`: (H, W, 3) in camera axes.

    The table may be coarser than the image by whole numbers, then rays are interpolated linearly, beyond the outer
    pixel centres too. Raises UsageError for a file that is not there or an image that it does not fit, DataError for a
    file that holds no rays.
    """
    table = _read(path)
    rows, columns = table.shape[:2]
    if shape[0] % rows or shape[1] % columns:
        raise UsageError(
            f"camera.lens.table = {path}: rays of {rows} x {columns} pixels do not fit an image of {shape[0]} x "
            f"{shape[1]}"
        )
    between: Floats = _between(_between(table, shape[0], 0), shape[1], 1)
    between /= np.linalg.norm(between, axis=-1, keepdims=True)
    return between


@lru_cache(maxsize=4)
def _read(path: str) -> Floats:
    if not Path(path).is_file():
        raise UsageError(f"camera.lens.table = {path}: there is no such file")
    try:
        if not is_zipfile(path):
            raise ValueError("no archive at all")
        with np.load(path, allow_pickle=False) as file:
            table: Floats = np.array(file["rays"], np.float64)
    except Exception as error:  # whatever zipfile and NumPy make of garbage
        raise DataError(f"{path}: not a NumPy archive with an array 'rays' (rows, columns, 3): {error}") from error
    if table.ndim != 3 or table.shape[2] != 3 or not table.size or not np.isfinite(table).all():
        raise DataError(f"{path}: rays of shape {table.shape}; they must be finite numbers (rows, columns, 3)")
    size = np.linalg.norm(table, axis=-1, keepdims=True)
    if not np.all(size > 0):
        raise DataError(f"{path}: a ray of length zero has no direction")
    table /= size
    return table


def _between(table: Floats, size: int, axis: int) -> Floats:
    """Return the table at `size` centres along an axis, on the straight lines through neighbouring centres."""
    known = table.shape[axis]
    if known in (1, size):
        return np.repeat(table, size // known, axis)
    place = (np.arange(size) + 0.5) * known / size - 0.5
    first = np.clip(np.floor(place).astype(int), 0, known - 2)
    share = np.expand_dims(place - first, [k for k in range(3) if k != axis])
    result: Floats = (1 - share) * np.take(table, first, axis) + share * np.take(table, first + 1, axis)
    return result
