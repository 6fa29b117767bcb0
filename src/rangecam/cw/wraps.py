"""How often each phase of several frequencies has wrapped: the likeliest, pixel by pixel (theory: `cw.unwrapping`)."""

import math
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.block import INNER
from rangecam.cw.settings import CwCamera
from rangecam.cw.unwrapping import Combination
from rangecam.types import Floats, Why

_VALID, _WRAPPED = np.int32(Why.VALID), np.int32(Why.WRAPPED)
_ZERO, _ONE, _HUGE = np.float32(0), np.float32(1), np.float32(1e30)


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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def unwrap(block: Any, ratios: Any, plan: Any) -> None:
    """Unwrap a block: try every wrap of the anchor, keep the likeliest, refuse what is not clearly so.

    block: `cycles`, phases in turns 0..1, and `certainty`, one over their variance, plan[6] of which is no noise; the
    anchor comes first. ratios: wraps of each over those of the anchor. plan: number of candidates, largest residual
    (squared sigmas), least lead of the best over the next (in -2 ln likelihood), unambiguous range and greatest range
    (m), wraps of the anchor, squared error of the phases beside noise (turns).
    """
    _prepare(block, ratios, plan[6])
    n_candidates, now = int(plan[0]), 0
    for candidate in range(0, n_candidates, 2):
        absent = _ZERO if candidate + 1 < n_candidates else _HUGE
        _try_two(block, ratios, np.float32(candidate), absent, now)
        now = 1 - now
    _decide(block, plan, now)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _prepare(block: Any, ratios: Any, error: Any) -> None:
    """Fill what is the same for all candidates; the best of none is beyond any cost."""
    cycles, certainty, apart, pull = block["cycles"], block["certainty"], block["apart"], block["pull"]
    inverse, noise, kept = block["inverse"], block["noise"], block["kept"]
    for i in range(INNER):
        precision, passed = _ZERO, _ZERO
        for k in range(len(ratios)):
            ratio, weight = ratios[k], certainty[k, i]
            apart[k, i] = ratio * cycles[0, i] - cycles[k, i]
            pull[k, i] = ratio * weight
            precision += ratio * ratio * weight
            passed += ratio * ratio * weight * (_ONE - error * weight)  # noise that comes through with these weights
        inverse[i], noise[i] = _ONE / precision, np.sqrt(passed)
        kept[0, 0, i], kept[0, 1, i], kept[0, 2, i] = _HUGE, _HUGE, _ZERO


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _try_two(block: Any, ratios: Any, candidate: Any, absent: Any, now: int) -> None:
    """Compare two candidates with the best so far: its cost, that of the next, and its turns less the misfit.

    The wraps of the other frequencies follow by rounding; what then is too much of the anchor's phase, by least
    squares. absent: added to the cost of the second. Kept are two sets in turn, for in place stores would be
    conditional, which is slow.
    """
    certainty, apart, pull, inverse = block["certainty"], block["apart"], block["pull"], block["inverse"]
    old, new, following = block["kept"][now], block["kept"][1 - now], candidate + _ONE
    for i in range(INNER):
        slope, cost, slope_2, cost_2 = _ZERO, _ZERO, _ZERO, absent
        for k in range(1, len(ratios)):
            one, two = ratios[k] * candidate + apart[k, i], ratios[k] * following + apart[k, i]
            one, two = one - np.rint(one), two - np.rint(two)
            slope += pull[k, i] * one
            slope_2 += pull[k, i] * two
            cost += certainty[k, i] * one * one
            cost_2 += certainty[k, i] * two * two
        # the residuals are e - ratio offset, and 0 - offset of the anchor itself
        offset, offset_2 = slope * inverse[i], slope_2 * inverse[i]
        cost, cost_2 = cost - slope * offset, cost_2 - slope_2 * offset_2
        place = candidate - offset if cost <= cost_2 else following - offset_2
        better, worse = (cost if cost < cost_2 else cost_2), (cost if cost > cost_2 else cost_2)
        best, second, place_before = old[0, i], old[1, i], old[2, i]
        beaten = better if better > best else best
        beaten = beaten if beaten < worse else worse
        new[0, i] = better if better < best else best
        new[1, i] = beaten if beaten < second else second
        new[2, i] = place if better < best else place_before


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _decide(block: Any, plan: Any, now: int) -> None:
    kept, cycles, inverse, noise = block["kept"][now], block["cycles"], block["inverse"], block["noise"]
    range_m, sigma_m, judged, decided = block["range_m"], block["sigma_m"], block["judged"], block["decided"]
    step_m, most, lead, whole_m, reach_m = plan[3] / plan[5], plan[1], plan[2], plan[3], plan[4]
    for i in range(INNER):
        value = (cycles[0, i] + kept[2, i]) * step_m
        value = value - whole_m if value >= whole_m else value
        value = value + whole_m if value < _ZERO else value
        range_m[i] = value
        sigma_m[i] = step_m * noise[i] * inverse[i]
        clear = (kept[0, i] <= most) & (kept[1, i] - kept[0, i] >= lead) & (value <= reach_m)
        decided[i] = _WRAPPED if (judged[i] == _VALID) & (not clear) else judged[i]


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
