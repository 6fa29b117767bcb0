"""Wiggling: how much too long a range is measured, as a periodic function of the measured phase (S-EFF-01).

Harmonics of light and reference bend the phase the same way in every pixel and at every amplitude; square signals at
four steps by a fourth harmonic above all (Steinbäck 2016, 2.2.2). As the error is a function of the measured phase,
taking it off inverts the bend exactly. Two models, both linear in their values: a table with the periodic cubic spline
between its values, and the harmonics of the phase.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.phasor import harmonic_weights
from rangecam.cw.sequence import plane_name, single_frequencies
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian
from rangecam.errors import UsageError
from rangecam.planes import plane_of
from rangecam.types import Floats, RangeImage, RawFrame

_SIZE = 1024
"""Values of a period in the kernel's table; between them it interpolates linearly."""
_LEAST_VALUES = 4


def unambiguous_m(camera: CwCamera) -> float:
    """Return the unambiguous range of a camera at `modulation_hz` (Steinbäck 2016, eq 2.4)."""
    return 2 * math.pi * metres_per_radian(camera)


def table_basis(turns: Floats, size: int) -> Floats:
    """Return (N, size): by how much each of `size` values at equal steps from phase 0 on counts at these phases.

    The periodic cubic spline through the values. Raises UsageError for fewer than four.
    """
    from scipy.interpolate import CubicSpline

    if size < _LEAST_VALUES:
        raise UsageError(f"a wiggling table of {size} values; it needs {_LEAST_VALUES} or more over a period")
    cardinal = np.eye(size)[np.arange(size + 1) % size]
    result: Floats = CubicSpline(np.linspace(0, 1, size + 1), cardinal, bc_type="periodic")(np.mod(turns, 1.0))
    return result


def harmonic_basis(turns: Floats, size: int) -> Floats:
    """Return (N, 2 size): cosine and sine of the first, second, ... harmonic at these phases."""
    angle = 2 * np.pi * np.multiply.outer(turns, np.arange(1, size + 1))
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(len(turns), 2 * size)


BASES: dict[str, Callable[[Floats, int], Floats]] = {"table": table_basis, "harmonics": harmonic_basis}
"""Models of wiggling by name: (phases in turns (N,), size) -> what each value counts there."""


@lru_cache(maxsize=16)
def wiggling(camera: CwCamera) -> Floats:
    """Return the error of the range that is corrected, m: (F, 1026) float32 over a period of each modulation frequency.

    1024 steps and the first two values again; no rows if the settings of `camera` correct nothing. Raises UsageError
    for both models at once, for another number of rows than frequencies, for a table that is too short, and for an
    error that grows faster than the phase, which no camera has: it could not be inverted.
    """
    table, harmonics = camera.wiggling_table_m, camera.wiggling_harmonics_m
    if not (table or harmonics):
        return np.zeros((0, _SIZE + 2), np.float32)
    name = "wiggling_table_m" if table else "wiggling_harmonics_m"
    if table and harmonics:
        raise UsageError("camera.wiggling_table_m and camera.wiggling_harmonics_m correct the same; set one of them")
    cameras, rows = single_frequencies(camera), table or harmonics
    if len(rows) != len(cameras):
        raise UsageError(
            f"camera.{name} has {len(rows)} rows; the camera has {len(cameras)} modulation frequencies, each needs one"
        )
    turns = np.arange(_SIZE + 2) / _SIZE
    basis = table_basis if table else harmonic_basis
    errors = [basis(turns, len(row)) @ np.ravel(row) for row in rows]
    for k, (error_m, single) in enumerate(zip(errors, cameras, strict=True)):
        steepest = np.diff(error_m).max() * _SIZE / unambiguous_m(single)
        if steepest >= 1:
            raise UsageError(
                f"camera.{name}: row {k} grows by {steepest:.3g} m in a metre; an error that grows as fast as the "
                "range cannot be taken off it: values are metres, at equal steps over one period"
            )
    result: Floats = np.array(errors, np.float32)
    result.setflags(write=False)
    return result


def straightened(image: RangeImage, camera: CwCamera) -> RangeImage:
    """Return the ranges of one modulation frequency without wiggling; sigma_m goes with the slope of the correction."""
    shape = image.shape
    range_m, sigma_m = np.empty(shape, np.float32), np.empty(shape, np.float32)
    numbers = np.array([camera.offset_m, unambiguous_m(camera)], np.float32)
    _straighten(
        np.ascontiguousarray(image.range_m, np.float32),
        np.ascontiguousarray(image.sigma_m, np.float32),
        wiggling(camera)[0],
        numbers,
        range_m,
        sigma_m,
    )
    return replace(image, range_m=range_m, sigma_m=sigma_m)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _straighten(range_m: Any, sigma_m: Any, table: Any, numbers: Any, straight_m: Any, deviation_m: Any) -> None:
    offset_m, period_m, size = numbers[0], numbers[1], np.float32(table.size - 2)
    zero, one, per_m = np.float32(0), np.float32(1), np.float32(1) / numbers[1]
    place, slope = np.empty(range_m.shape[1], np.float32), size * per_m
    for y in range(range_m.shape[0]):
        measured, sigma, straight, deviation = range_m[y], sigma_m[y], straight_m[y], deviation_m[y]
        for x in range(place.size):
            turns = (measured[x] - offset_m) * per_m
            turns -= np.floor(turns)
            place[x] = size * turns if turns >= zero else zero  # NaN finds a place in the table, too
        for x in range(place.size):
            n = np.int32(place[x])
            here = table[n]
            step = table[n + 1] - here
            value = measured[x] - (here + (place[x] - np.float32(n)) * step)
            value -= period_m * np.floor(value * per_m)
            straight[x] = zero if (value < zero) | (value >= period_m) else value
            deviation[x] = sigma[x] * abs(one - step * slope)


def taken_off(range_m: Floats, off_m: Floats, period_m: float) -> Floats:
    """Return ranges (H, W) float32 less an offset that is the same for all, or (H, W), within the interval again."""
    result = np.empty(range_m.shape, np.float32)
    every = np.broadcast_to(np.asarray(off_m, np.float32), range_m.shape)
    _take_off(np.ascontiguousarray(range_m, np.float32), every, np.float32(period_m), result)
    return result


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _take_off(range_m: Any, off_m: Any, period_m: Any, result: Any) -> None:
    zero, per_m = np.float32(0), np.float32(1) / period_m
    for y in range(range_m.shape[0]):
        for x in range(range_m.shape[1]):
            value = range_m[y, x] - off_m[y, x]
            value -= period_m * np.floor(value * per_m)
            result[y, x] = zero if (value < zero) | (value >= period_m) else value


def turned_back(raw: RawFrame, camera: CwCamera) -> tuple[RawFrame, Floats]:
    """Return the frame of several modulation frequencies as without wiggling, and the slope of the correction (H, W).

    Before unwrapping, which contradictions between the phases would mislead: the phasor of each frequency is turned by
    its own error, and its samples with it. Samples at the limits of the converter stay as they are. The slope is that
    of the combined range, in which a frequency counts by its squared amplitude times frequency.
    Raises DataError for a missing or misshapen plane.
    """
    cameras, weights = single_frequencies(camera), harmonic_weights(camera.phase_steps_deg).astype(np.float64)
    names = [[plane_name(step, k) for step in camera.phase_steps_deg] for k in range(len(cameras))]
    every = [name for row in names for name in row]
    planes, total, squares = dict(raw.planes), np.zeros(()), np.zeros(())
    turn = np.exp(1j * np.radians(camera.phase_steps_deg))[:, None, None]
    for table, single, row in zip(wiggling(camera), cameras, names, strict=True):
        samples = np.stack([plane_of(raw, name, every) for name in row]).astype(np.float32)
        phasor = np.tensordot(weights[0] + 1j * weights[1], samples, 1)
        place = np.mod(camera.phase_sign * np.angle(phasor) / (2 * np.pi), 1.0) * _SIZE
        n = np.nan_to_num(place).astype(int)
        step, period_m = table[n + 1] - table[n], unambiguous_m(single)
        error_rad = 2 * np.pi * (table[n] + (place - n) * step) / period_m
        change = phasor * np.expm1(-1j * camera.phase_sign * error_rad)
        moved = _within_limits(samples, samples + (change * turn).real, camera)
        planes |= dict(zip(row, moved, strict=True))
        weight = np.abs(phasor * single.modulation_hz) ** 2
        total, squares = total + weight, squares + weight * (1 - step * _SIZE / period_m) ** 2
    slope = np.sqrt(squares / np.where(total > 0, total, 1.0))
    return replace(raw, planes=planes), slope.astype(np.float32)


def _within_limits(samples: Floats, moved: Floats, camera: CwCamera) -> Floats:
    """Return the moved samples (N, H, W), but as they were where one of a pixel is at a limit, and none beyond."""
    least, most = np.float32(-np.inf), np.float32(np.inf)
    if camera.lower_limit_lsb is not None:
        least = np.nextafter(np.float32(camera.lower_limit_lsb), most)
    if camera.full_scale_lsb is not None:
        most = np.nextafter(np.float32(camera.full_scale_lsb), -np.float32(np.inf))
    limited = ((samples < least) | (samples > most)).any(axis=0)
    result: Floats = np.where(limited, samples, np.clip(moved, least, most)).astype(np.float32)
    return result
