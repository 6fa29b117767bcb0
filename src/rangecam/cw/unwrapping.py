"""Several modulation frequencies together: how often each phase has wrapped, and how often that goes wrong.

Measured in turns, the phase of frequency k is u_k = p_k x - n_k: x is the range as a fraction of the unambiguous range
of all frequencies together, p_k whole numbers without a common divisor, n_k the wraps that nobody sees.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

import numpy as np

from rangecam.errors import UsageError
from rangecam.types import Floats

MOST_WRAPS = 200
"""Of one frequency within the unambiguous range of all; beyond, no real phase noise leaves the wraps decidable."""
_MOST_FREQUENCIES = 4  # each has its exposures: more would blur what moves


@dataclass(frozen=True)
class Combination:
    """Frequencies that are unwrapped together.

    unambiguous_m: c / (2 times their greatest common divisor). wraps: p_k of each frequency. anchor: number of the one
    whose wraps are tried one after the other; those of the others follow by rounding.
    """

    unambiguous_m: float
    wraps: tuple[int, ...]
    anchor: int


@lru_cache(maxsize=64)
def combine(modulations_hz: tuple[float, ...], speed_of_light_mps: float) -> Combination:
    """Return how two to four modulation frequencies go together (N-S-039).

    The anchor is the lowest frequency from which no other is more than twice as high, so that its noise, scaled up,
    still rounds the others to the right wrap wherever the residual is acceptable.
    Raises UsageError for frequencies that cannot be combined, with the reason.
    """
    what = f"camera.modulations_hz = {[*modulations_hz]}"
    if not 2 <= len(modulations_hz) <= _MOST_FREQUENCIES:
        raise UsageError(f"{what}: unwrapping needs two to four frequencies; one alone goes into camera.modulation_hz")
    whole = [round(each) for each in modulations_hz]
    if min(whole) < 1 or any(abs(f - n) > 1e-3 for f, n in zip(modulations_hz, whole, strict=True)):
        raise UsageError(f"{what}: unwrapping needs whole numbers of hertz")
    if len(set(whole)) < len(whole):
        raise UsageError(f"{what}: the same frequency twice tells nothing about the wraps")
    common = math.gcd(*whole)
    wraps = tuple(n // common for n in whole)
    unambiguous_m = speed_of_light_mps / (2 * common)
    if max(wraps) > MOST_WRAPS:
        raise UsageError(
            f"{what}: their greatest common divisor is {common} Hz, so that a phase wraps {max(wraps)} times within "
            f"{unambiguous_m:.0f} m, more than the {MOST_WRAPS} that can be told apart; take multiples of one frequency"
        )
    anchor = min((k for k in range(len(wraps)) if max(wraps) <= 2 * wraps[k]), key=lambda k: wraps[k])
    return Combination(unambiguous_m, wraps, anchor)


def combined_sigma_m(phase_sigmas_rad: Sequence[float], combination: Combination) -> float:
    """Return the standard deviation of the combined range: each frequency weighs by one over its variance."""
    steps_m = [combination.unambiguous_m / p for p in combination.wraps]
    precision = sum((2 * math.pi / (s * step)) ** 2 for s, step in zip(phase_sigmas_rad, steps_m, strict=True))
    return 1 / math.sqrt(precision)


def gross_error_probability(phase_sigmas_rad: Sequence[float], combination: Combination) -> float:
    """Return how probable it is that the likeliest number of wraps is a wrong one, at given phase noises.

    phase_sigmas_rad: of each frequency, the noise of a sample over its amplitude, propagated to the phase. Two
    frequencies: exact. p_2 u_1 - p_1 u_2 is a whole number plus noise, and goes wrong where the noise exceeds a half.
    More: the union bound over the wrong numbers, an upper limit and close to the truth while it is small. The noise of
    a phase has the tails of the arctangent of a noisy phasor, which 0.2 rad already double the errors of a Gaussian.
    """
    rivals = _rivals(tuple(phase_sigmas_rad), combination.wraps)
    if len(combination.wraps) == 2:
        rivals = rivals[:2]
    nearest = min(length for length, _ in rivals)
    near = [rival for rival in rivals if rival[0] < nearest + 3]
    return min(1.0, sum(_beyond(across, length**2 / 2, phase_sigmas_rad) for length, across in near))


def accepted_error_probability(
    phase_sigmas_rad: Sequence[float], combination: Combination, unwrap_error: float
) -> tuple[float, float]:
    """Return the probabilities that a pixel is accepted with wrong wraps, and that it is rejected as undecidable.

    For two frequencies, without the test of the residual: a pixel is accepted if the noise of p_2 u_1 - p_1 u_2 stays
    within a distance of a whole number that follows from the ratio of likelihoods that `unwrap_error` demands. A pixel
    that reckons with its own noisy amplitude is rejected more often: about twice at 0.2 rad.
    Raises UsageError for more frequencies, for which nothing but counting helps.
    """
    if len(combination.wraps) != 2:
        raise UsageError("the probability of accepted errors is known for two frequencies only")
    length, across = _rivals(tuple(phase_sigmas_rad), combination.wraps)[0]
    margin = length**2 / 2 - math.log(1 / unwrap_error)  # on the scale on which the next candidate is length^2 away
    if margin <= 0:
        return 0.0, 1.0

    def tail(limit: float) -> float:
        return _beyond(across, limit, phase_sigmas_rad)

    wrong = 2 * sum(tail(j * length**2 - margin) - tail(j * length**2 + margin) for j in range(1, 4))
    return max(0.0, wrong), max(0.0, 2 * tail(margin) - wrong)


@lru_cache(maxsize=64)
def _rivals(sigmas_rad: tuple[float, ...], wraps: tuple[int, ...]) -> tuple[tuple[float, tuple[float, ...]], ...]:
    """Return the wrong numbers of wraps as seen from the right ones: distance in standard deviations, and the vector.

    The vector is (2 pi n_k / sigma_k) across the direction (p_k / sigma_k), along which a mere change of the range
    lies. Two that differ by whole unambiguous ranges are one. The nearest come first.
    """
    p, sigma = np.array(wraps, float), np.array(sigmas_rad) / (2 * math.pi)
    direction = (p / sigma) / np.linalg.norm(p / sigma)
    found: dict[tuple[int, ...], tuple[float, tuple[float, ...]]] = {}
    for start, others in product(range(2 * wraps[0] + 1), product((-1, 0, 1), repeat=len(wraps) - 1)):
        n = np.array([start, *(round(start / wraps[0] * q) + o for q, o in zip(wraps[1:], others, strict=True))], float)
        across = n / sigma - (n / sigma @ direction) * direction
        relations = tuple(int(n[i] * wraps[j] - n[j] * wraps[i]) for i, j in combinations(range(len(wraps)), 2))
        if any(relations):
            for sign in (1, -1):
                vector = tuple((sign * across).tolist())
                found[tuple(sign * r for r in relations)] = (float(np.linalg.norm(across)), vector)
    return tuple(sorted(found.values()))


def _beyond(across: Sequence[float], limit: float, sigmas_rad: Sequence[float]) -> float:
    """Return the probability that the sum of across_k error_k / sigma_k exceeds a limit.

    The errors are those of the phases of noisy phasors; by the characteristic function, real as their density is even.
    """
    error = np.linspace(-math.pi, math.pi, 1601)
    omega = (np.arange(800) + 0.5) * (12 / float(np.linalg.norm(across)) / 800)
    characteristic = np.ones(omega.shape)
    for part, sigma in zip(across, sigmas_rad, strict=True):
        density = _phase_density(error, sigma)
        characteristic *= np.cos(np.outer(omega, error * (part / sigma))) @ (density / density.sum())
    inverted = np.sum(np.sin(omega * limit) * characteristic / omega) * (omega[1] - omega[0])
    return max(0.0, 0.5 - float(inverted) / math.pi)


def _phase_density(error_rad: Floats, sigma_rad: float) -> Floats:
    """Return the density of the phase error of a phasor with noise of `sigma_rad` amplitudes in each component."""
    snr, cosine = 1 / sigma_rad, np.cos(error_rad)
    below = 0.5 * np.array([math.erfc(-snr * c / math.sqrt(2)) for c in cosine])
    peak = snr * cosine / math.sqrt(2 * math.pi) * np.exp(-((snr * np.sin(error_rad)) ** 2) / 2) * below
    density: Floats = math.exp(-(snr**2) / 2) / (2 * math.pi) + peak
    return density
