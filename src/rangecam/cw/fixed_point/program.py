"""The constant tables of the microcontroller's program, made of the settings of a camera."""

import math
from functools import lru_cache

import numpy as np

from rangecam.cw.arctangent import ANGLE_BITS, TURN
from rangecam.cw.sequence import plane_names
from rangecam.cw.settings import CwCamera
from rangecam.errors import UsageError
from rangecam.geometry import rays
from rangecam.types import Ints
from rangecam.values import value

PLANES = ("phase_0", "phase_90", "phase_180", "phase_270")
FACTOR_BITS, COSINE_BITS, THRESHOLD_BITS = 16, 15, 15
HALF_COSINE = 1 << (COSINE_BITS - 1)


@value
class Program:
    """The constant tables of the microcontroller for one camera and image size.

    conversion (H, W) int64: cosine of the angle to the axis, 2^-15. weakest (H, W) int64: square of the least
    amplitude of a word. wrapped (H, W) int64: least amplitude times squared distance, word mm2.
    constants (9,) int64: sign and offset of the phase, range factor (mm a radian, 2^-16), common neighbours and their
    tolerance (mm), median, fill_holes, discarded border, marker (mm).
    """

    conversion: Ints
    weakest: Ints
    wrapped: Ints
    constants: Ints


@lru_cache(maxsize=8)
def compiled(camera: CwCamera, shape: tuple[int, int]) -> Program:
    """Return the program's tables for a camera and an image size (H, W); raises UsageError as `cw_emulation` does."""
    settings = camera.emulation
    _check_samples(camera)
    metres_per_rad = settings.speed_of_light_mps / (4 * math.pi * camera.modulation_hz)  # eq 3.12
    factor = round(metres_per_rad * 1e3 * 2**FACTOR_BITS)
    farthest_mm = (TURN - 1) * factor >> (ANGLE_BITS + FACTOR_BITS)
    if farthest_mm >= settings.marker_mm:
        raise UsageError(
            f"camera.emulation.marker_mm = {settings.marker_mm}: distances reach {farthest_mm} mm at "
            f"{camera.modulation_hz / 1e6:g} MHz; the marker must lie beyond, up to 65535 (E-S-20)"
        )
    offset = round(camera.offset_m / metres_per_rad * 2**ANGLE_BITS) % TURN
    reference = reference_words(camera, shape)
    weakest = (reference * round(settings.amplitude_threshold * 2**THRESHOLD_BITS)) ** 2 >> 2 * THRESHOLD_BITS
    wrapped = reference * round(settings.wrap_threshold * 2**THRESHOLD_BITS) * 10**6 >> THRESHOLD_BITS
    filters = (settings.common_neighbours, settings.neighbour_tolerance_mm, settings.median, settings.fill_holes)
    constants = (camera.phase_sign, offset, factor, *filters, settings.border == "discard", settings.marker_mm)
    return Program(conversion(camera, shape), weakest, wrapped, np.array(constants, np.int64))


def _check_samples(camera: CwCamera) -> None:
    if plane_names(camera) != PLANES:
        raise UsageError(
            f"ranging = 'cw_emulation' takes four phases at one frequency, {', '.join(PLANES)}; this camera has "
            f"{', '.join(plane_names(camera))}"
        )
    low, high, shift = camera.lower_limit_lsb, camera.full_scale_lsb, camera.emulation.word_shift
    if low is None or low < 0 or high is None or high > 0xFFFF >> shift:
        raise UsageError(
            f"ranging = 'cw_emulation' takes words of 16 bits: camera.lower_limit_lsb = {low}, full_scale_lsb {high}, "
            f"emulation.word_shift = {shift}; expected limits within 0 to {0xFFFF >> shift}"
        )


def conversion(camera: CwCamera, shape: tuple[int, int]) -> Ints:
    """Return the factor of the camera angle conversion of each pixel in 2^-15: (H, W) int64.

    cos(alpha) cos(beta) from a cosine table, alpha of the row and beta of the column (Steinbäck 2016, eqs 3.15-3.16,
    rows and columns the right way round, E-S-02), counted from the first pixel after the middle; or of the lens.
    """
    if camera.emulation.angles == "lens":
        along: Ints = np.rint(rays(camera.lens, shape)[..., 0] * 2**COSINE_BITS).astype(np.int64)
        return along
    rows, columns = (
        cosine_table(pitch_deg, count)[np.abs(np.arange(count) - count // 2)]
        for pitch_deg, count in zip(_pitches_deg(camera, shape), shape, strict=True)
    )
    product: Ints = (rows[:, None] * columns + HALF_COSINE) >> COSINE_BITS
    return product


def cosine_table(pitch_deg: float, count: int, power: float = 1.0) -> Ints:
    """Return the cosines, to a power, of the angles 0, one pitch .. half of `count` pitches, in 2^-15 (N-S-027)."""
    angles = np.radians(pitch_deg * np.arange((count + 1) // 2 + 1))
    entries: Ints = np.rint(np.cos(angles) ** power * 2**COSINE_BITS).astype(np.int64)
    return entries


def _pitches_deg(camera: CwCamera, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the angle that stands for a row and for a column: opening angle over their number (0.5 degrees)."""
    horizontal = camera.lens.horizontal_fov_deg
    vertical = camera.lens.vertical_fov_deg
    return (horizontal / shape[1] if vertical is None else vertical / shape[0]), horizontal / shape[1]


def reference_words(camera: CwCamera, shape: tuple[int, int]) -> Ints:
    """Return the amplitude of a white plane at 1 m in units of a word: (H, W) int64 (Steinbäck 2016, A.5, N-S-028).

    From a table of the power of the cosine; counted from the last pixel before the middle, as printed.
    """
    floor = round(camera.reference_floor_lsb * 2**camera.emulation.word_shift)
    rest = round((camera.reference_amplitude_lsb - camera.reference_floor_lsb) * 2**camera.emulation.word_shift)
    rows, columns = (
        cosine_table(pitch_deg, count, camera.reference_exponent)[np.abs(np.arange(count) - (count // 2 - 1))]
        for pitch_deg, count in zip(_pitches_deg(camera, shape), shape, strict=True)
    )
    reference: Ints = floor + (rest * (rows[:, None] * columns >> COSINE_BITS) >> COSINE_BITS)
    return reference
