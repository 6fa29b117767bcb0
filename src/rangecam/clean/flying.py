"""Flying pixels: light of two surfaces in one pixel, which shows a range between them where nothing is."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.clean.settings import CleanSettings
from rangecam.types import Floats, Ints, Why

_TWO = np.float32(2)


def flying(range_m: Floats, sigma_m: Floats, why: Ints, settings: CleanSettings) -> NDArray[np.uint8]:
    """Return why (H, W) uint8 with the flying pixels refused: between two surfaces, they belong to neither.

    It flies if along one of the four lines through it the range steps on both sides, in the same sense, by more than
    noise explains, and neither step is seen to go on: on an inclined surface the neighbour differs from the next but
    one as the pixel differs from the neighbour (within a factor of two), so that no floor is eaten. Only pixels that
    came in valid are asked. Where the noise is greater than the distance between the surfaces nothing can be told; and
    two surfaces more than half the unambiguous range of a continuous-wave camera apart mix to a range outside of both.
    """
    height, width = why.shape
    came, reach = np.full((2, height + 4, width + 4), np.nan, np.float32)
    came[2:-2, 2:-2] = np.where(why == 0, range_m, np.float32(np.nan))
    tolerance_m, factor = _tolerance(settings)
    reach[2:-2, 2:-2] = tolerance_m + factor * sigma_m
    between = np.zeros((height, width), np.uint8)
    _find(came, reach, between)
    return np.where((why == 0) & (between != 0), np.uint8(Why.FLYING), why)


@lru_cache(maxsize=16)
def _tolerance(settings: CleanSettings) -> tuple[np.float32, np.float32]:
    """Return what a pixel adds to the tolerance of a step: a constant, and a factor of its sigma."""
    return np.float32(settings.flying_tolerance_m / 2), np.float32(settings.flying_tolerance_sigmas / math.sqrt(2))


@njit(cache=True, nogil=True)
def _find(came: Floats, reach: Floats, between: Ints) -> None:
    for y in range(between.shape[0]):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            far0, near0, here = came[y + 2 - 2 * down], came[y + 2 - down], came[y + 2]
            near1, far1 = came[y + 2 + down], came[y + 2 + 2 * down]
            reach0, reach1, own = reach[y + 2 - down], reach[y + 2 + down], reach[y + 2]
            found = between[y]
            for x in range(len(found)):
                k = x + 2
                step0, step1 = here[k] - near0[k - right], near1[k + right] - here[k]
                jump0, jump1 = abs(step0) > own[k] + reach0[k - right], abs(step1) > own[k] + reach1[k + right]
                beyond0, beyond1 = near0[k - right] - far0[k - 2 * right], far1[k + 2 * right] - near1[k + right]
                goes_on = _alike(step0, beyond0) | _alike(step1, beyond1)
                found[x] |= jump0 & jump1 & (step0 * step1 > 0) & ~goes_on


@njit(cache=True, nogil=True)
def _alike(step: float, beyond: float) -> Any:
    """Return whether a step goes on: in the same sense, half as large to twice as large."""
    return (step * beyond > 0) & (abs(step) <= _TWO * abs(beyond)) & (abs(beyond) <= _TWO * abs(step))
