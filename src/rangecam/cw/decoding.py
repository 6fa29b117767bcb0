"""From samples at any phase steps and several frequencies to range, with the filter of phasors and unwrapping between.

The image is taken by strips of a few columns, from top to bottom; of the phasors only as many rows are kept as the
filter looks at (`cw.block`).
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from rangecam.compiled import kernel
from rangecam.cw.block import INNER, RIM, WIDTH, blind, load, record_types, store, store_phases
from rangecam.cw.phasor import (
    add_neighbours,
    demodulate,
    filter_rule,
    harmonic_weights,
    noise_model,
    refuse_lonely,
    start_sum,
)
from rangecam.cw.phasor import turns as turns_of
from rangecam.cw.settings import CwCamera
from rangecam.cw.wraps import unwrap, unwrap_by_neighbours
from rangecam.types import Floats, Image, Why

_VALID, _LOW_AMPLITUDE = np.int32(Why.VALID), np.int32(Why.LOW_AMPLITUDE)
_ZERO, _ONE, _PER_TURN = np.float32(0), np.float32(1), np.float32(0.25 / math.pi**2)


def decode(
    planes: tuple[Image, ...], camera: CwCamera, wavelengths_m: tuple[float, ...], plan: Floats
) -> tuple[Floats, Image]:
    """Return range, sigma and amplitude (3, H, W) float32, and why (H, W), of one to four frequencies.

    planes: of one frequency after the other, the anchor first if there are several, as `wavelengths_m` and the ratios
    in `plan` (`cw.wraps`) are.
    """
    shape, n_frequencies = planes[0].shape, len(wavelengths_m)
    images, why = np.empty((3, *shape), np.float32), np.empty(shape, np.uint8)
    spatially = n_frequencies > 1 and camera.unwrap_spatially
    turns = np.empty((2, shape[0] if spatially else 0, n_frequencies, shape[1]), np.float32)
    reach, rule = filter_rule(camera, wavelengths_m)
    row, block = record_types(n_frequencies, len(planes))
    _decode(
        planes,
        (*_weights(camera.phase_steps_deg), noise_model(camera)),
        (rule, _limits(camera, wavelengths_m), plan),
        (_offsets(camera, wavelengths_m), tuple(plan[7:]) or (_ONE,)),
        (camera.pseudo_rows, *_places(reach)),
        (np.zeros(2 * reach + 1, row), np.zeros(1, block)),
        (turns, images, why),
    )
    if spatially:
        given = np.empty(shape, bool)
        while unwrap_by_neighbours(turns[0], turns[1], plan, images[0], images[1], why, given):
            pass
    return images, why


@lru_cache(maxsize=16)
def _weights(steps_deg: tuple[float, ...]) -> tuple[tuple[Any, ...], ...]:
    """Return the weights of Re and Im as tuples, of which the compiler knows the length."""
    real, imaginary = harmonic_weights(steps_deg)
    return tuple(real), tuple(imaginary)


def _offsets(camera: CwCamera, wavelengths_m: tuple[float, ...]) -> tuple[Any, ...]:
    return tuple(np.float32(camera.offset_m / each) for each in wavelengths_m)


def _limits(camera: CwCamera, wavelengths_m: tuple[float, ...]) -> Floats:
    return np.array(
        [camera.phase_sign, camera.min_amplitude, camera.max_phase_sigma_rad**2, wavelengths_m[0]], np.float32
    )


def _places(reach: int) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return the places of neighbours in rows above and below, and in the row itself."""
    beside = tuple(np.uint64(RIM + dx) for dx in range(-reach, reach + 1))
    return beside, tuple(place for place in beside if place != RIM) or beside


@kernel(error_model="numpy")
def _decode(planes: Any, model: Any, rules: Any, scales: Any, extent: Any, scratch: Any, results: Any) -> None:
    to_real, to_imaginary, noise = model
    (rule, limits, plan), (offsets, ratios), (pseudo_rows, beside, around) = rules, scales, extent
    (ring, blocks), (turns, images, why) = scratch, results
    (height, width), block, n_rows = why.shape, blocks[0], ring.size
    reach = n_rows // 2
    for column in range(0, width, INNER):
        for last in range(height + reach):
            y, newest = last - reach, ring[last % n_rows]
            if last < height:
                load(planes, last, column - RIM, block)
                demodulate(block, (to_real, to_imaginary), noise, newest)
                blind(newest, 0, WIDTH if last < pseudo_rows else RIM - column)
                blind(newest, width - column + RIM, WIDTH)
            if y < 0:
                continue
            here = ring[y % n_rows]
            start_sum(here, block)
            if reach > 0:
                top, bottom = max(y - reach, 0), min(y + reach, height - 1)
                for j in range(top, bottom + 1):
                    if j == y:
                        add_neighbours(here, here, around, rule, block)
                    else:
                        add_neighbours(here, ring[j % n_rows], beside, rule, block)
                if rule[2] > _ZERO:
                    refuse_lonely(block, column, width, bottom - top + 1, reach, rule[2])
            _phases(here, block, offsets, limits, plan[6])
            if len(ratios) == 1:
                _single(block, limits[3])
            else:
                unwrap(block, ratios, plan)
            store(block, y, column, images, why)
            if turns.shape[1] > 0:
                store_phases(block, y, column, turns)


@kernel(error_model="numpy", fastmath={"contract", "nsz"})
def _phases(here: Any, block: Any, offsets: Any, limits: Any, error: Any) -> None:
    """Fill the phases in turns, one over their variance, and the mean amplitude; refuse weak pixels.

    The variance of a mean is shared out among the frequencies as at its centre, the row `here`.
    """
    real, imaginary, count, strewn = block["real"], block["imaginary"], block["count"], block["strewn"]
    cycles, certainty, amplitude = block["cycles"], block["certainty"], block["mean_amplitude"]
    own, all_own, why, judged = here["variance"], here["strewn"], block["why"], block["judged"]
    sign, least, most, n_frequencies = limits[0], limits[1], limits[2], len(offsets)
    for i in range(INNER):
        weak, total, number, ratio = False, _ZERO, count[i], strewn[i] / all_own[RIM + i]
        for k in range(n_frequencies):
            re, im, across = real[k, i], imaginary[k, i], ratio * own[k, RIM + i]
            phase = sign * turns_of(im, re) + offsets[k]
            phase -= np.floor(phase)
            cycles[k, i] = _ZERO if phase >= _ONE else phase
            square = re * re + im * im
            size = np.sqrt(square)
            certainty[k, i] = square / (across * _PER_TURN + error * square)
            total += size
            weak |= (not across <= most * square) | (size < least * number)
        amplitude[i] = total / (np.float32(n_frequencies) * number)
        judged[i] = _LOW_AMPLITUDE if weak & (why[i] == _VALID) else why[i]


@kernel(error_model="numpy", fastmath={"contract", "nsz"})
def _single(block: Any, wavelength_m: Any) -> None:
    """Fill the range of the only frequency."""
    cycles, certainty, range_m, sigma_m = block["cycles"], block["certainty"], block["range_m"], block["sigma_m"]
    judged, decided = block["judged"], block["decided"]
    for i in range(INNER):
        range_m[i] = wavelength_m * cycles[0, i]
        sigma_m[i] = wavelength_m / np.sqrt(certainty[0, i])
        decided[i] = judged[i]
