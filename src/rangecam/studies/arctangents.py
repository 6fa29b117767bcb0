"""Ways to compute the phase compared: how far each is off, in radians and millimetres, and how long a pixel takes."""

import time
from statistics import median
from typing import Any

import numpy as np

from rangecam.cw.arctangent import ARCTANGENTS, TABLE_SIZE
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import metres_per_radian
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats

POINTS = 400_000
"""How many directions the error is taken over."""
PIXELS = 160 * 120
_REPEATS = 9
_RIVALS = ("libm", "taylor", "chebyshev", "cordic")


def arctangents(rng: np.random.Generator) -> Study:
    """Arctangents compared: tables, CORDIC, series, library, polynomial: error and time a pixel.

    rng: of the lengths of the phasors.
    """
    imaginary, real = _parts(rng)
    errors = {name: _error(name, imaginary, real) for name in ARCTANGENTS}
    taken = {name: _nanoseconds(name, imaginary[:PIXELS], real[:PIXELS]) for name in ARCTANGENTS}
    claims = [*_bounds(errors), *(claim for name in ARCTANGENTS for claim in _row(name, errors[name], taken[name]))]
    return Study("arctangents", "Steinbäck 2016, 2.2.1 and 4.5.1", [*claims, _fastest(taken)], _panels(errors, taken))


def _parts(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return whole imaginary and real parts in all directions, as differences of words of 16 bits are."""
    angle, size = np.linspace(0, 2 * np.pi, POINTS, endpoint=False), rng.uniform(2_000, 65_520, POINTS)
    order = rng.permutation(POINTS)
    return np.round(size * np.sin(angle))[order], np.round(size * np.cos(angle))[order]


def _error(name: str, imaginary: Floats, real: Floats) -> Floats:
    """Return the difference to the library's arctangent, the short way around: rad (N,)."""
    difference = ARCTANGENTS[name](imaginary, real) - np.arctan2(imaginary, real)
    wrapped: Floats = (difference + np.pi) % (2 * np.pi) - np.pi
    return wrapped


def _nanoseconds(name: str, imaginary: Floats, real: Floats) -> float:
    """Return the processor time of one pixel, ns: the median of some runs over an image of random directions.

    The parts come in the type that the way computes in, so that no conversion counts.
    """
    kind: Any = {"polynomial": np.float32, "integer_table": np.int32}.get(name, np.float64)
    y, x = imaginary.astype(kind), real.astype(kind)
    times = []
    for _ in range(_REPEATS):
        start = time.thread_time_ns()
        ARCTANGENTS[name](y, x)
        times.append(time.thread_time_ns() - start)
    return median(times) / imaginary.size


def _mm(rad: float) -> float:
    return rad * metres_per_radian(CwCamera(speed_of_light_mps=3e8)) * 1e3


def _bounds(errors: dict[str, Floats]) -> list[Claim]:
    step = 1 / (TABLE_SIZE - 1)
    bound = step**2 / 8 * 3 * np.sqrt(3) / 8
    worst, alone = (float(np.abs(errors[name]).max()) for name in ("table", "table_alone"))
    why = "bound h^2/8 max|atan''| = 1.249e-6 rad, with 255 steps between 256 entries"
    before = "before rounding to 2^-27 rad; the bound demanded is 1.3e-6 rad"
    whole = float(np.abs(errors["integer_table"]).max())
    return [
        judged("N-S-025", "largest error of 256 entries with interpolation", None, worst, "rad", worst <= bound, why),
        judged("N-S-025", "... in millimetres at 17 MHz", None, _mm(worst), "mm", _mm(worst) <= _mm(bound), why),
        derived("N-S-025", "largest error without interpolation", alone, "rad", "half a step"),
        derived("N-S-025", "... in millimetres at 17 MHz", _mm(alone), "mm", "half a step"),
        judged("S-DST-03", "largest error of the integer table", None, whole, "rad", whole < 1.3e-6, before),
    ]


def _row(name: str, error: Floats, nanoseconds: float) -> list[Claim]:
    title = name.replace("_", " ")
    worst, spread = float(np.abs(error).max()), float(np.sqrt(np.mean(error**2)))
    return [
        derived("S-DST-07", f"{title}: largest error", worst, "rad", f"{_mm(worst):.2g} mm at 17 MHz"),
        derived("S-DST-07", f"{title}: RMS error", spread, "rad", f"{_mm(spread):.2g} mm at 17 MHz"),
        derived("S-DST-07", f"{title}: time of a pixel", nanoseconds, "ns", "on this machine, one thread"),
    ]


def _fastest(taken: dict[str, float]) -> Claim:
    """Return how the table with interpolation, the fastest of fig 4.14, fares here; a time is no verdict."""
    ratio = min(taken[name] for name in _RIVALS) / taken["table"]
    text = "time of the fastest rival of the table with interpolation (library, series, CORDIC) over its own"
    why = "fig 4.14: above 1 on the microcontroller; here, series become vector instructions and need no memory"
    return derived("S-DST-07", text, ratio, "", why)


def _panels(errors: dict[str, Floats], taken: dict[str, float]) -> list[Panel]:
    scatter = [
        Series(name.replace("_", " "), [taken[name]], [max(float(np.abs(error).max()), 1e-16)], line="o")
        for name, error in errors.items()
    ]
    return [
        Panel("Error against time", "processor time a pixel (ns)", "largest error (rad)", scatter, log="xy"),
        _octant_panel(),
    ]


def _octant_panel() -> Panel:
    """Return the error over the first twentieth of an octant, where the table's steps can be seen."""
    angle = np.linspace(0, np.pi / 80, 1500)
    imaginary, real = np.round(2**28 * np.sin(angle)), np.round(2**28 * np.cos(angle))
    series = [
        Series(name.replace("_", " "), np.degrees(angle), _error(name, imaginary, real) * 1e6)
        for name in ("table", "integer_table", "polynomial", "chebyshev")
    ]
    return Panel("Over ten entries of the table", "phase (degrees)", "error (µrad)", series)
