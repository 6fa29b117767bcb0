"""Several modulation frequencies together: how often each phase has wrapped, and how often that goes wrong.

Measured in turns, the phase of frequency k is u_k = p_k x - n_k: x is the range as a fraction of the unambiguous range
of all frequencies together, p_k whole numbers without a common divisor, n_k the wraps that nobody sees.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.settings import CwCamera
from rangecam.errors import UsageError
from rangecam.types import Floats, Why

MOST_WRAPS = 200
"""Of one frequency within the unambiguous range of all; beyond, no real phase noise leaves the wraps decidable."""

_VALID, _WRAPPED = np.uint8(Why.VALID), np.uint8(Why.WRAPPED)
_ZERO, _ONE, _HUGE = np.float32(0), np.float32(1), np.float32(1e30)


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
    """Return how two or three modulation frequencies go together (N-S-039).

    The anchor is the lowest frequency from which no other is more than twice as high, so that its noise, scaled up,
    still rounds the others to the right wrap wherever the residual is acceptable.
    Raises UsageError for frequencies that cannot be combined, with the reason.
    """
    what = f"camera.modulations_hz = {[*modulations_hz]}"
    if len(modulations_hz) not in (2, 3):
        raise UsageError(f"{what}: unwrapping needs two or three frequencies; one alone goes into camera.modulation_hz")
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
    Three: the union bound over the wrong numbers, an upper limit and close to the truth while it is small. The noise of
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
    Raises UsageError for three frequencies, for which nothing but counting helps.
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def unwrap(cycles: Any, weights: Any, plan: Any, rows: Any, range_m: Any, sigma_m: Any, why: Any) -> None:
    """Unwrap one row: try every wrap of the anchor, keep the likeliest, refuse what is not clearly so.

    cycles (K, W): phases in turns 0..1; weights (K, W): one over their variance, plan[6] of which is no noise; the
    anchor comes first in both. plan: number of candidates, largest residual (squared sigmas), least lead of the best
    over the next (in -2 ln likelihood), unambiguous range and greatest range (m), wraps of the anchor, squared error of
    the phases beside noise (turns), then wraps of each over those of the anchor. rows (10, W): scratch.
    """
    inverse, noise, offset, cost = rows[0], rows[1], rows[2], rows[3]
    kept, other = rows[4:7], rows[7:10]
    kept[:2] = _HUGE
    kept[2] = _ZERO
    inverse[:] = _ZERO
    noise[:] = _ZERO
    for k in range(cycles.shape[0]):
        _add_precision(weights[k], plan[7 + k], plan[6], inverse, noise)
    for i in range(inverse.size):
        inverse[i] = _ONE / inverse[i]
    for candidate in range(int(plan[0])):
        offset[:] = np.float32(candidate)
        _fit(cycles, weights, plan, inverse, offset, cost)
        _keep_best(np.float32(candidate), cost, kept[0], kept[1], kept[2], other[0], other[1], other[2])
        kept, other = other, kept
    best, second, wraps = kept[0], kept[1], kept[2]
    offset[:] = wraps
    _fit(cycles, weights, plan, inverse, offset, cost)
    step_m, most, lead, whole_m, reach_m, turns = plan[3] / plan[5], plan[1], plan[2], plan[3], plan[4], cycles[0]
    for i in range(range_m.size):
        value = (turns[i] + wraps[i] - offset[i]) * step_m
        value = value - whole_m if value >= whole_m else value
        value = value + whole_m if value < _ZERO else value
        range_m[i] = value
        sigma_m[i] = step_m * np.sqrt(noise[i]) * inverse[i]
        decided = (best[i] <= most) & (second[i] - best[i] >= lead) & (value <= reach_m)
        why[i] = _WRAPPED if (why[i] == _VALID) & (not decided) else why[i]


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _add_precision(weight: Any, ratio: Any, error: Any, precision: Any, noise: Any) -> None:
    """Add one frequency to the weight of the range, and to the noise that comes through with these weights."""
    for i in range(precision.size):
        added = ratio * ratio * weight[i]
        precision[i] += added
        noise[i] += added * (_ONE - error * weight[i])


@njit(cache=True, nogil=True)
def _fit(cycles: Any, weights: Any, plan: Any, inverse: Any, wraps: Any, cost: Any) -> None:
    """Replace the wraps of the anchor by what its phase is too large, by least squares; fill the squared residual."""
    if cycles.shape[0] == 2:
        _fit_two(cycles[0], cycles[1], weights[1], plan[8], inverse, wraps, cost)
    else:
        _fit_three(cycles[0], cycles[1], cycles[2], weights[1], weights[2], plan[8], plan[9], inverse, wraps, cost)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _fit_two(u0: Any, u1: Any, w1: Any, ratio: Any, inverse: Any, wraps: Any, cost: Any) -> None:
    for i in range(cost.size):
        e1 = ratio * (u0[i] + wraps[i]) - u1[i]
        e1 -= np.rint(e1)
        slope = ratio * w1[i] * e1
        wraps[i] = slope * inverse[i]
        cost[i] = w1[i] * e1 * e1 - slope * wraps[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _fit_three(
    u0: Any, u1: Any, u2: Any, w1: Any, w2: Any, ratio1: Any, ratio2: Any, inverse: Any, wraps: Any, cost: Any
) -> None:
    for i in range(cost.size):
        turns = u0[i] + wraps[i]
        e1, e2 = ratio1 * turns - u1[i], ratio2 * turns - u2[i]
        e1, e2 = e1 - np.rint(e1), e2 - np.rint(e2)
        # the residuals are e - ratio offset, and 0 - offset of the anchor itself
        slope = ratio1 * w1[i] * e1 + ratio2 * w2[i] * e2
        offset = slope * inverse[i]
        cost[i] = w1[i] * e1 * e1 + w2[i] * e2 * e2 - slope * offset
        wraps[i] = offset


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _keep_best(
    candidate: Any, cost: Any, best: Any, second: Any, wraps: Any, best_now: Any, second_now: Any, wraps_now: Any
) -> None:
    """Fill the best cost, the next one and the wraps of the best; in place, stores would be conditional and slow."""
    for i in range(best.size):
        new, first, next_one = cost[i], best[i], second[i]
        worse = new if new > first else first
        second_now[i] = worse if worse < next_one else next_one
        best_now[i] = new if new < first else first
        wraps_now[i] = candidate if new < first else wraps[i]


@njit(cache=True, nogil=True, error_model="numpy")
def unwrap_by_neighbours(cycles: Any, weights: Any, plan: Any, range_m: Any, sigma_m: Any, why: Any, given: Any) -> int:
    """Give undecided pixels the wraps with which they agree with decided neighbours; return how many got them.

    cycles, weights (H, K, W). A pixel needs three decided neighbours of eight whose ranges agree with each other, and
    its own phases must allow the range that they suggest. given (H, W) bool: who was helped in this pass.
    """
    helped = 0
    height, width = range_m.shape
    step_m = plan[3] / plan[5]
    for y in range(height):
        for x in range(width):
            given[y, x] = False
            if why[y, x] != _WRAPPED or not weights[y, 0, x] > _ZERO:
                continue
            n, mean, low, high, widest = 0, 0.0, 1e30, -1e30, 0.0
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    if why[j, i] == _VALID:
                        n += 1
                        value = range_m[j, i]
                        mean += value
                        low, high = min(low, value), max(high, value)
                        widest = max(widest, sigma_m[j, i])
            if n < 3 or high - low > 0.25 * step_m + 4.0 * widest:
                continue
            found, cost = _nearest(mean / n, step_m, cycles, weights, plan, y, x)
            reach = 0.25 * step_m + 4.0 * (widest + sigma_m[y, x])
            if cost <= plan[1] and abs(found - mean / n) <= reach and 0.0 <= found <= plan[4]:
                range_m[y, x] = found
                given[y, x] = True
                helped += 1
    for y in range(height):
        for x in range(width):
            why[y, x] = _VALID if given[y, x] else why[y, x]
    return helped


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(expected_m: Any, step_m: Any, cycles: Any, weights: Any, plan: Any, y: int, x: int) -> Any:
    """Return the range by the wraps nearest to an expected one, m, and its squared residual in sigmas."""
    turns = cycles[y, 0, x]
    turns += np.rint(expected_m / step_m - turns)
    slope, square, precision = 0.0, 0.0, weights[y, 0, x]
    for k in range(1, cycles.shape[1]):
        ratio, weight = plan[7 + k], weights[y, k, x]
        error = ratio * turns - cycles[y, k, x]
        error -= np.rint(error)
        slope += ratio * weight * error
        square += weight * error * error
        precision += ratio * ratio * weight
    offset = slope / precision
    return (turns - offset) * step_m, square - slope * offset


def plan_of(combination: Combination, camera: CwCamera) -> Floats:
    """Return what the kernels need of a combination and the camera's limits, in their order."""
    p, anchor = combination.wraps, combination.anchor
    step_m = combination.unambiguous_m / p[anchor]
    reach_m = min(camera.unwrap_to_m or combination.unambiguous_m, combination.unambiguous_m)
    candidates = min(p[anchor], math.floor(reach_m / step_m) + 1)
    order = order_of(combination)
    lead, error = 2 * math.log(1 / camera.unwrap_error), (camera.unwrap_phase_error_rad / (2 * math.pi)) ** 2
    most = camera.unwrap_residual_sigmas**2
    head = [candidates, most, lead, combination.unambiguous_m, reach_m, p[anchor], error]
    return np.array([*head, *(p[k] / p[anchor] for k in order)], np.float32)


def order_of(combination: Combination) -> list[int]:
    """Return the numbers of the frequencies as the kernels take them: the anchor first."""
    return [combination.anchor, *(k for k in range(len(combination.wraps)) if k != combination.anchor)]
