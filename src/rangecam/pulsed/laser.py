"""The light source: where its beams go, how its power falls as it warms up, what repetition rate it bears.

König 2008, 4.1.2 and 4.2.2. The thesis shows the course of the power in a figure only, so that the parameters of the
model are *open*; their defaults make what it states: at 10 kHz the power settles just above 70 %, at 11 kHz below
(N-K-046).
"""

import math
from typing import Annotated

import numpy as np
from annotated_types import Interval, Len

from rangecam.errors import UsageError
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings
from rangecam.types import Floats

Extent = tuple[Annotated[float, Interval(ge=-1, le=1)], Annotated[float, Interval(ge=-1, le=1)]]


@settings
class Laser:
    """The light source (König 2008, 4.1.2 and 4.2.2)."""

    peak_power_w: Positive = 2000.0
    """Peak optical power of one module (eq 4.20, rounded as in the thesis)."""
    modules: PositiveInt = 1
    """Modules whose light adds up (K-ILL-04)."""
    repetition_hz: Positive = 10e3
    """Pulses a second; 10 kHz is the thermal limit at full power (4.2.2.3)."""
    beams: Annotated[tuple[Extent, ...], Len(1)] = ((-1.0, 1.0),)
    """Left and right end of each beam on the image, which reaches from -1 to 1; each is even and has an equal share of
    the power. [[-1, 0.5], [-0.5, 1]] overlap for the front view, with twice the light in the middle (4.1.2.2). *open*
    """
    trigger_jitter_s: NonNegative = 0.0
    """Standard deviation of the time at which a pulse leaves. The thesis knows that it is below some 30 ps (4.2.2.3,
    N-K-092)."""
    amplitude_jitter: NonNegative = 0.0
    """Standard deviation of the power of a pulse over its mean; below what the thesis could measure. *open*"""
    operating_time_s: NonNegative = 0.0
    """For how long it has been pulsing: the power falls as it warms up; 0: all of the power (simulation)."""
    warm_up_s: Positive = 60.0
    """Time constant of warming up; the thesis says "a few minutes" until the power is stable. *open*"""
    loss_per_w: NonNegative = 0.0806
    """Part of the power that is lost in the end for each watt of mean optical power of a module. *open*"""
    loss_per_k: NonNegative = 0.004
    """Part of the power that is lost for each kelvin of the surroundings above 25 °C (5.2.1.1). *open*"""
    least_power: Fraction = 0.7
    """Part of the initial power below which heat harms the diodes (4.2.2.3)."""


REFERENCE_C = 25.0
"""Temperature of the surroundings to which the powers and offsets of a camera's settings belong."""


def power_fraction(laser: Laser, pulse_width_s: float, temperature_c: float, time_s: Floats | float) -> Floats:
    """Return the power over that of a cold laser at 25 °C, after pulsing for `time_s` (broadcast).

    A linear model: the diodes lose power in proportion to how warm they are, their own heat is proportional to the mean
    power P T_Pw f, and their temperature settles exponentially (K-ILL-08, K-ILL-09; N-K-046).
    """
    warm = -np.expm1(-np.asarray(time_s, np.float64) / laser.warm_up_s)
    lost = laser.loss_per_w * _mean_power_w(laser, pulse_width_s) * warm + _lost_to_surroundings(laser, temperature_c)
    return np.asarray(np.maximum(1 - lost, 0.0))


def thermal_limit_hz(laser: Laser, pulse_width_s: float, temperature_c: float) -> float:
    """Return the repetition rate at which the power settles at `least_power`; inf if no rate does, 0 if any does."""
    left = 1 - laser.least_power - _lost_to_surroundings(laser, temperature_c)
    if left <= 0:
        return 0.0
    per_hz = laser.loss_per_w * _mean_power_w(laser, pulse_width_s) / laser.repetition_hz
    return left / per_hz if per_hz else math.inf


def power_w(laser: Laser, pulse_width_s: float, temperature_c: float) -> float:
    """Return the peak power of all modules at `laser.operating_time_s`, W."""
    fraction = power_fraction(laser, pulse_width_s, temperature_c, laser.operating_time_s)
    return laser.peak_power_w * laser.modules * float(fraction)


def beam_profile(laser: Laser, columns: int) -> Floats:
    """Return how much light falls into each column of the image over that of an even beam on all of it: (columns,).

    The beams share the power, so that the mean is 1 (K-ILL-05). Raises UsageError for a beam without width.
    """
    edges = np.linspace(-1, 1, columns + 1)
    profile = np.zeros(columns)
    for left, right in laser.beams:
        if left >= right:
            raise UsageError(f"camera.laser.beams: a beam from {left:g} to {right:g}; its left end must come first")
        lit = np.clip(np.minimum(edges[1:], right) - np.maximum(edges[:-1], left), 0.0, None)
        profile += lit * columns / (right - left)
    return profile / len(laser.beams)


def _mean_power_w(laser: Laser, pulse_width_s: float) -> float:
    return laser.peak_power_w * pulse_width_s * laser.repetition_hz


def _lost_to_surroundings(laser: Laser, temperature_c: float) -> float:
    return laser.loss_per_k * (temperature_c - REFERENCE_C)
