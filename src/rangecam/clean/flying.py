"""Flying pixels: light of two surfaces in one pixel, which shows a range between them where nothing is."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.clean.neighbours import singles
from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints, Why

_NAN, _ZERO, _ONE, _TWO = singles(math.nan, 0, 1, 2)
_FLYING = int(Why.FLYING)


def flying(range_m: Floats, sigma_m: Floats, why: Ints, settings: CleanSettings) -> NDArray[np.uint8]:
    """Return why (H, W) uint8 with the flying pixels refused: between two surfaces, they belong to neither.

    It flies if along one of the four lines through it the range steps on both sides, in the same sense, by more than
    noise explains, and neither step is seen to go on: on an inclined surface the neighbour differs from the next but
    one as the pixel differs from the neighbour (within a factor of two), so that no floor is eaten. Only pixels that
    came in valid are asked. Where the noise is greater than the distance between the surfaces nothing can be told; and
    two surfaces more than half the unambiguous range of a continuous-wave camera apart mix to a range outside of both.
    """
    reason = why.astype(np.uint8)
    came, reach = np.empty((2, why.shape[0] + 4, why.shape[1] + 4), np.float32)
    _find(range_m, sigma_m, _tolerance(settings), came, reach, reason)
    return reason


@lru_cache(maxsize=16)
def _tolerance(settings: CleanSettings) -> Floats:
    """Return what a pixel adds to the tolerance of a step: a constant, and a factor of its sigma."""
    return np.array([settings.flying_tolerance_m / 2, settings.flying_tolerance_sigmas / math.sqrt(2)], np.float32)


@njit(cache=True, nogil=True)
def _find(range_m: Floats, sigma_m: Floats, tolerance: Floats, came: Floats, reach: Floats, reason: Ints) -> None:
    height, width = reason.shape
    came[:2], came[height + 2 :], came[:, :2], came[:, width + 2 :] = _NAN, _NAN, _NAN, _NAN
    reach[:2], reach[height + 2 :], reach[:, :2], reach[:, width + 2 :] = _ZERO, _ZERO, _ZERO, _ZERO
    for y in range(height):
        for x in range(width):
            came[y + 2, x + 2] = range_m[y, x] if reason[y, x] == 0 else _NAN
            reach[y + 2, x + 2] = tolerance[0] + tolerance[1] * sigma_m[y, x]
    flies = np.empty(width, np.float32)
    for y in range(height):
        flies[:] = _ZERO
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            here, own = came[y + 2, 2 : width + 2], reach[y + 2, 2 : width + 2]
            near0, far0 = came[y + 2 - down, 2 - right :], came[y + 2 - 2 * down, 2 - 2 * right :]
            near1, far1 = came[y + 2 + down, 2 + right :], came[y + 2 + 2 * down, 2 + 2 * right :]
            reach0, reach1 = reach[y + 2 - down, 2 - right :], reach[y + 2 + down, 2 + right :]
            for x in range(width):
                step0, step1 = here[x] - near0[x], near1[x] - here[x]
                jumps = (abs(step0) > own[x] + reach0[x]) & (abs(step1) > own[x] + reach1[x])
                goes_on = _alike(step0, near0[x] - far0[x]) | _alike(step1, far1[x] - near1[x])
                flies[x] = _ONE if jumps & (step0 * step1 > _ZERO) & (not goes_on) else flies[x]
        for x in range(width):
            reason[y, x] = _FLYING if flies[x] > _ZERO else reason[y, x]


@njit(cache=True, nogil=True)
def _alike(step: float, beyond: float) -> Any:
    """Return whether a step goes on: in the same sense, half as large to twice as large."""
    return (step * beyond > _ZERO) & (abs(step) <= _TWO * abs(beyond)) & (abs(beyond) <= _TWO * abs(step))
