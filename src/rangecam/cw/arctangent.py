"""Arctangents: the ways to get the phase from imaginary and real part that Steinbäck 2016, 2.2.1 and 4.5.1 compare.

All but the library's fold the point by pi, pi/2 and pi/4 into the first octant, where 0 <= y/x <= 1.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from rangecam.compiled import kernel
from rangecam.cw.phasor import turns as _polynomial_turns
from rangecam.types import Floats, Ints

TABLE_SIZE = 256
ANGLE_BITS = 27
"""Integer angles count 2^-27 rad, so that two turns still fit into 32 bits."""
FRACTION_BITS = 20
"""Places of the quotient y/x between two entries of the integer table."""
EIGHTH_TURN = round(math.pi / 4 * 2**ANGLE_BITS)
TURN = 8 * EIGHTH_TURN
"""One turn in integer angles, the sum of its rounded eighths."""

_PI, _HALF_PI, _QUARTER_PI, _TWO_PI = math.pi, math.pi / 2, math.pi / 4, 2 * math.pi
_STEPS = TABLE_SIZE - 1
_TABLE = np.arctan(np.arange(TABLE_SIZE) / _STEPS)
INTEGER_TABLE: Ints = np.round(_TABLE * 2**ANGLE_BITS).astype(np.int32)
"""The arctangent of 0, 1/255 .. 1 in integer angles, (256,) int32; read-only."""
INTEGER_TABLE.setflags(write=False)
_TURNS_OF_CORDIC = 24
_CORDIC_ANGLES = np.arctan(2.0 ** -np.arange(_TURNS_OF_CORDIC))
_TAN_EIGHTH, _EIGHTH_PI = math.tan(math.pi / 8), math.pi / 8
_TERMS = 8
_TAYLOR = np.array([(-1) ** k / (2 * k + 1) for k in range(_TERMS)])
_CHEBYSHEV = np.array([2 * (-1) ** k * (math.sqrt(2) - 1) ** (2 * k + 1) / (2 * k + 1) for k in range(_TERMS)])


def table(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by a table of 256 entries with linear interpolation (S-DST-03), error 1.25e-6 rad (N-S-025).

    imaginary, real: any shape. The phase is in 0..2 pi rad, 0 where both are zero; so do all of `ARCTANGENTS`.
    """
    return _mapped(_by_table, imaginary, real)


def table_alone(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by the nearest of 256 entries, error 1.96e-3 rad (N-S-025)."""
    return _mapped(_by_nearest, imaginary, real)


def integer_table(imaginary: Floats | Ints, real: Floats | Ints) -> Floats:
    """Return the phase by the table of the fixed-point chain; the parts are cut to whole numbers, below 2^30."""
    y, x = (np.ascontiguousarray(part, np.int32) for part in (imaginary, real))
    phase = np.empty(y.shape)
    _by_integer_table(y.reshape(-1), x.reshape(-1), INTEGER_TABLE, phase.reshape(-1))
    return phase


def cordic(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by 24 turns of shrinking angles, shifts and sums only (CORDIC)."""
    return _mapped(_by_cordic, imaginary, real)


def taylor(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by eight terms of the Taylor series, about pi/8, where it converges fast enough."""
    return _mapped(_by_taylor, imaginary, real)


def chebyshev(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by eight terms of the Chebyshev series over -1..1, summed by Clenshaw's recurrence.

    The coefficients are 2 (-1)^k (sqrt 2 - 1)^(2k+1) / (2k+1).
    """
    return _mapped(_by_chebyshev, imaginary, real)


def libm(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by the arctangent of the C library, in double precision."""
    return _mapped(_by_libm, imaginary, real)


def polynomial(imaginary: Floats, real: Floats) -> Floats:
    """Return the phase by the polynomial of `cw.ranging`, in single precision and by vector instructions."""
    imaginary, real = (np.ascontiguousarray(part, np.float32) for part in (imaginary, real))
    phase = np.empty(imaginary.shape, np.float32)
    _by_polynomial(imaginary.reshape(-1), real.reshape(-1), phase.reshape(-1))
    return phase


def _mapped(loop: Callable[..., Any], imaginary: Floats, real: Floats) -> Floats:
    imaginary, real = (np.ascontiguousarray(part, np.float64) for part in (imaginary, real))
    phase = np.empty(imaginary.shape)
    loop(imaginary.reshape(-1), real.reshape(-1), phase.reshape(-1))
    return phase


@kernel(inline="always")
def _fold(y: Any, x: Any, eighth: Any) -> Any:
    """Return the point turned into the first octant and the angle by which it was turned back, in units of `eighth`.

    The second quadrant is where the real part is negative (E-S-08); the turn by pi/4 stretches, which does not matter,
    and goes by x + y and y - x (E-S-09).
    """
    back = 0 * eighth
    if y < 0:
        y, x, back = -y, -x, 4 * eighth
    if x < 0:
        y, x, back = -x, y, back + 2 * eighth
    if y > x:
        y, x, back = y - x, x + y, back + eighth
    return y, x, back


@kernel(error_model="numpy")
def _by_table(imaginary: Any, real: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        y, x, back = _fold(imaginary[i], real[i], _QUARTER_PI)
        place = _STEPS * y / x if x > 0 else 0.0
        entry = min(int(place), _STEPS - 1)
        phase[i] = back + _TABLE[entry] + (place - entry) * (_TABLE[entry + 1] - _TABLE[entry])


@kernel(error_model="numpy")
def _by_nearest(imaginary: Any, real: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        y, x, back = _fold(imaginary[i], real[i], _QUARTER_PI)
        phase[i] = back + _TABLE[int(_STEPS * y / x + 0.5) if x > 0 else 0]


@kernel
def integer_angle(y: Any, x: Any, table: Any) -> Any:
    """Return the angle of a point of whole numbers in 2^-27 rad, 0 to one turn less one (kernel of `fixed_point`).

    y, x: int64 below 2^30 in size; the quotient is cut, and so is the interpolation. 0 where both are zero.
    """
    y, x, back = _fold(y, x, EIGHTH_TURN)
    if x == 0:
        return 0
    place = ((y * _STEPS) << FRACTION_BITS) // x
    entry = place >> FRACTION_BITS
    if entry >= _STEPS:  # exactly on the border of the octant
        return back + np.int64(table[_STEPS])
    low, high = np.int64(table[entry]), np.int64(table[entry + 1])
    return back + low + (((high - low) * (place & ((1 << FRACTION_BITS) - 1))) >> FRACTION_BITS)


@kernel
def _by_integer_table(imaginary: Any, real: Any, table: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        angle = integer_angle(np.int64(imaginary[i]), np.int64(real[i]), table)
        phase[i] = angle * (1.0 / (1 << ANGLE_BITS))


@kernel
def _by_cordic(imaginary: Any, real: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        y, x, back = _fold(imaginary[i], real[i], _QUARTER_PI)
        angle, shrink = 0.0, 1.0
        if y > 0:
            for k in range(_TURNS_OF_CORDIC):
                if y >= 0:
                    x, y, angle = x + y * shrink, y - x * shrink, angle + _CORDIC_ANGLES[k]
                else:
                    x, y, angle = x - y * shrink, y + x * shrink, angle - _CORDIC_ANGLES[k]
                shrink *= 0.5
        phase[i] = _within_turn(back + angle)


@kernel(inline="always")
def _within_turn(angle: Any) -> Any:
    """Return an angle that rounding has taken out of 0..2 pi to its nearest end."""
    return min(max(angle, 0.0), _TWO_PI)


@kernel(error_model="numpy")
def _by_taylor(imaginary: Any, real: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        y, x, back = _fold(imaginary[i], real[i], _QUARTER_PI)
        angle = 0.0
        if y > 0:
            t = (y - _TAN_EIGHTH * x) / (x + _TAN_EIGHTH * y)
            square, series = t * t, 0.0
            for k in range(_TERMS - 1, -1, -1):
                series = series * square + _TAYLOR[k]
            angle = _EIGHTH_PI + t * series
        phase[i] = _within_turn(back + angle)


@kernel(error_model="numpy")
def _by_chebyshev(imaginary: Any, real: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        y, x, back = _fold(imaginary[i], real[i], _QUARTER_PI)
        angle = 0.0
        if y > 0:
            t = y / x
            twice = 4 * t * t - 2  # of odd polynomials every second one: T_(n+2) = (4 t^2 - 2) T_n - T_(n-2)
            above, after = 0.0, 0.0
            for k in range(_TERMS - 1, 0, -1):
                above, after = _CHEBYSHEV[k] + twice * above - after, above
            angle = t * (_CHEBYSHEV[0] + (twice - 1) * above - after)
        phase[i] = _within_turn(back + angle)


@kernel
def _by_libm(imaginary: Any, real: Any, phase: Any) -> None:
    for i in range(imaginary.size):
        angle = math.atan2(imaginary[i], real[i])
        phase[i] = angle + _TWO_PI if angle < 0 else max(angle, 0.0)


@kernel(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _by_polynomial(imaginary: Any, real: Any, phase: Any) -> None:
    turn, zero = np.float32(_TWO_PI), np.float32(0)
    for i in range(imaginary.size):
        angle = turn * _polynomial_turns(imaginary[i], real[i])
        angle = zero if (imaginary[i] == zero) & (real[i] == zero) else angle
        phase[i] = angle + turn if angle < zero else angle


ARCTANGENTS: dict[str, Callable[[Floats, Floats], Floats]] = {
    "table": table,
    "table_alone": table_alone,
    "integer_table": integer_table,
    "cordic": cordic,
    "taylor": taylor,
    "chebyshev": chebyshev,
    "libm": libm,
    "polynomial": polynomial,
}
"""Arctangents by name: (imaginary, real) -> phase in 0..2 pi rad."""
