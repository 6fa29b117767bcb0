"""How likely it is that braking comes too late; derived in docs/decision.md."""

import math

import numpy as np
from numba import njit

from rangecam.types import Floats


def lost_way(own_mps: float, object_mps: float, object_mps2: float, deceleration_mps2: float, delay_s: float) -> float:
    """Return the most by which the gap to an object is ever smaller than now, if we brake fully after a delay, in m.

    The object goes on at `object_mps` (negative: towards us) and brakes with `object_mps2` >= 0 until it stands; what
    happens after we stand is not ours. The gap is looked at over the whole manoeuvre: it may be smallest before both
    stand, where the object brakes less than we do. At least 0.
    """
    return float(_lost_way(own_mps, object_mps, object_mps2, deceleration_mps2, delay_s))


@njit(cache=True, nogil=True)
def _lost_way(u: float, w: float, b: float, a: float, delay: float) -> float:
    stop = delay + u / a
    # we get nearer as long as we are the faster one: until both are as fast, both braking, or else until we stand, for
    # what stands no longer gains on us
    even = delay + (u - w + b * delay) / (a - b) if a > b else stop
    most = 0.0
    for t in (min(max(even, delay), stop), stop):
        most = max(most, _way(u, a, delay, t) - _way(w, b, 0.0, t))
    return most


@njit(cache=True, nogil=True)
def _way(v: float, a: float, delay: float, t: float) -> float:
    """Return the way at time t of something that brakes with a after a delay, until it stands."""
    braked = max(t - delay, 0.0)
    if a > 0 and v > 0:
        braked = min(braked, v / a)
        return v * (min(t, delay) + braked) - a * braked * braked / 2
    return v * t


def p_too_late(
    gap_m: float,
    closing_mps: float,
    spread: tuple[float, float, float],
    object_mps2: float,
    own: tuple[float, float, float],
    delay_s: float,
) -> float:
    """Return the probability that braking fully after a delay does not keep a gap open.

    spread: standard deviations of gap and closing speed, and their covariance; own: speed, deceleration of full
    braking, and its standard deviation. The way that is lost, `lost_way`, is a function of the closing speed and the
    deceleration alone; the gap is Gaussian given the closing speed, so that the probability is an integral over both
    (Gauss-Hermite, 15 x 5 nodes) of a normal distribution function. A closing speed of zero or less loses no way.
    """
    return float(_p_too_late((gap_m, closing_mps, object_mps2), spread, own, delay_s, _NODES, _FEW))


def _gauss_hermite(count: int) -> Floats:
    """Return nodes in standard deviations and their weights: (2, count)."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return np.array([nodes, weights / weights.sum()])


_NODES, _FEW = _gauss_hermite(15), _gauss_hermite(5)


@njit(cache=True, nogil=True)
def _p_too_late(
    state: tuple[float, float, float],
    spread: tuple[float, float, float],
    own: tuple[float, float, float],
    delay: float,
    nodes: Floats,
    few: Floats,
) -> float:
    (gap, closing, b), (gap_sigma, sigma, covariance) = state, spread
    slope = covariance / max(sigma, 1e-9) ** 2
    rest = math.sqrt(max(gap_sigma**2 - slope * covariance, 0.0))
    total = 0.0
    for j in range(few.shape[1]):
        a = max(own[1] + own[2] * few[0, j], own[1] / 10)
        for i in range(nodes.shape[1]):
            c = closing + sigma * nodes[0, i]
            if c <= 0:
                continue
            lacks = _lost_way(own[0], own[0] - c, b, a, delay) - gap - slope * (c - closing)
            p = 0.5 * math.erfc(-lacks / rest / math.sqrt(2.0)) if rest > 0 else 1.0 if lacks > 0 else 0.0
            total += nodes[1, i] * few[1, j] * p
    return total
