"""The loops of the microcontroller: distance, thresholds, common neighbourhood, median, all in integers."""

from typing import Any

import numpy as np

from rangecam.compiled import kernel
from rangecam.cw.arctangent import ANGLE_BITS, INTEGER_TABLE, TURN, integer_angle
from rangecam.cw.fixed_point.program import COSINE_BITS, FACTOR_BITS, HALF_COSINE, Program
from rangecam.types import Ints, Why
from rangecam.values import value

_ANGLE_AND_FACTOR = ANGLE_BITS + FACTOR_BITS
_LIMIT_BITS, _LARGEST = 8, (1 << 31) - 1
_LOW_AMPLITUDE, _WRAPPED = np.uint8(Why.LOW_AMPLITUDE), np.uint8(Why.WRAPPED)
_ISOLATED, _BORDER = np.uint8(Why.ISOLATED), np.uint8(Why.BORDER)
_NETWORK = np.array(
    [
        *((0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (0, 3), (3, 6), (0, 3), (1, 4)),
        *((4, 7), (1, 4), (2, 5), (5, 8), (2, 5), (1, 3), (5, 7), (2, 6), (4, 6), (2, 4), (2, 3), (5, 6)),
    ]
)
"""Pairs to be put in order, in this order (A.8, N-S-043)."""


@value
class IntegerImages:
    """What the microcontroller has in its memory at the end: (H, W) each.

    distance_mm uint16: the result, with the marker where it is discarded. judged_mm uint16: before the median.
    converted_mm uint16: before all filters. square int64: squared amplitude, words squared. why uint8: the reason,
    which the microcontroller itself does not keep.
    """

    distance_mm: Ints
    judged_mm: Ints
    converted_mm: Ints
    square: Ints
    why: Ints


def integer_chain(words: Ints, program: Program) -> IntegerImages:
    """Return what the microcontroller makes of four phase images: words (4, H, W) uint16 at 0, 90, 180, 270 degrees."""
    shape = words.shape[1:]
    converted, square, why = np.empty(shape, np.uint16), np.empty(shape, np.int64), np.empty(shape, np.uint8)
    _distances(words, program.conversion, program.constants, INTEGER_TABLE, converted, square)
    _thresholds(converted, square, program.weakest, program.wrapped, why)
    _common_neighbours(converted, program.constants, why)
    marker = np.uint16(program.constants[8])
    judged = np.where(why == 0, converted, marker)
    distance = judged.copy()
    _median(judged, program.constants, distance, why)
    if program.constants[7]:
        for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
            distance[edge] = marker
            why[edge] = np.where(why[edge] == 0, _BORDER, why[edge])
    return IntegerImages(distance, judged, converted, square, why)


@kernel
def _distances(words: Any, conversion: Any, constants: Any, table: Any, converted: Any, square: Any) -> None:
    """The distance calculation loop of alg 4.1, up to the camera angle conversion of alg 4.2."""
    sign, offset, factor = constants[0], constants[1], constants[2]
    for row in range(converted.shape[0]):
        for column in range(converted.shape[1]):
            real = np.int64(words[0, row, column]) - np.int64(words[2, row, column])  # 17 bits (N-S-037, E-S-15)
            imaginary = np.int64(words[3, row, column]) - np.int64(words[1, row, column])
            angle = integer_angle(sign * imaginary, real, table) + offset  # eq 3.13, on the phase
            if angle >= TURN:  # eq 3.14
                angle -= TURN
            distance = angle * factor >> _ANGLE_AND_FACTOR  # eq 3.11; cut, since the thesis names 0..8823 mm
            converted[row, column] = (distance * conversion[row, column] + HALF_COSINE) >> COSINE_BITS  # eq 3.15
            square[row, column] = (real * real + imaginary * imaginary) >> 2  # alg 4.1


@kernel
def _thresholds(converted: Any, square: Any, weakest: Any, wrapped: Any, why: Any) -> None:
    """Amplitude thresholds 1 and 2, both sides squared (eqs 3.17-3.18, E-S-16), with the plane's distance (E-S-22)."""
    for row in range(why.shape[0]):
        for column in range(why.shape[1]):
            distance, strength = np.int64(converted[row, column]), square[row, column]
            limit = _LARGEST if wrapped[row, column] > 0 else 0
            if distance > 0:  # the limit of the amplitude itself, because A^2 d^4 has up to 77 bits (N-S-038)
                limit = min(_LARGEST, (wrapped[row, column] << _LIMIT_BITS) // (distance * distance))
            reason = np.uint8(0)
            if strength < weakest[row, column]:
                reason = _LOW_AMPLITUDE
            elif strength << (2 * _LIMIT_BITS) < limit * limit:
                reason = _WRAPPED
            why[row, column] = reason


@kernel
def _common_neighbours(converted: Any, constants: Any, why: Any) -> None:
    """Discard pixels with too few common neighbours, in the image before the thresholds (eqs 2.8-2.9)."""
    needed, tolerance = constants[3], constants[4]
    for row in range(1, why.shape[0] - 1):
        for column in range(1, why.shape[1] - 1):
            middle, common = np.int64(converted[row, column]), -1  # the pixel itself does not count
            for i in range(-1, 2):
                for j in range(-1, 2):
                    if abs(np.int64(converted[row + i, column + j]) - middle) <= tolerance:
                        common += 1
            if common < needed and why[row, column] == 0:
                why[row, column] = _ISOLATED


@kernel
def _median(judged: Any, constants: Any, filtered: Any, why: Any) -> None:
    """Sort each neighbourhood by the network of 25 exchanges (A.8) and take the middle of what was not discarded."""
    median, fill_holes, marker = constants[5], constants[6], constants[8]
    values = np.empty(9, np.int64)
    for row in range(1, judged.shape[0] - 1 if median else 1):
        for column in range(1, judged.shape[1] - 1):
            if judged[row, column] == marker and not fill_holes:
                continue
            count, kept = 0, 0
            for i in range(-1, 2):
                for j in range(-1, 2):
                    values[count] = judged[row + i, column + j]
                    kept += values[count] != marker
                    count += 1
            for k in range(_NETWORK.shape[0]):
                low, high = _NETWORK[k, 0], _NETWORK[k, 1]
                if values[low] > values[high]:
                    values[low], values[high] = values[high], values[low]
            if kept > 0:  # markers sort to the end
                filtered[row, column] = values[kept // 2]
                why[row, column] = 0
