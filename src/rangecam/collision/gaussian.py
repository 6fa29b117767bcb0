"""Gaussian distributions, as loops: of one variable, of two that are correlated, and roots of covariances."""

import math

import numpy as np

from rangecam.compiled import kernel
from rangecam.types import Floats


@kernel
def normal(u: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-u / math.sqrt(2.0))


@kernel
def cholesky(L: Floats) -> None:
    """Turn the lower half of a covariance into its root in place; rows without variance become zero."""
    n = L.shape[0]
    for a in range(n):
        for b in range(a + 1):
            total = L[a, b]
            for c in range(b):
                total -= L[a, c] * L[b, c]
            if a == b:
                L[a, a] = math.sqrt(total) if total > 0 else 0.0
            else:
                L[a, b] = total / L[b, b] if L[b, b] > 0 else 0.0
        for b in range(a + 1, n):
            L[a, b] = 0.0


@kernel
def both_above(h: float, k: float, r: float) -> float:
    """Return the probability that two standard normal variables of correlation r are above h and above k.

    Its derivative by r is the density at (h, k) (Plackett 1954), integrated from what is known: the product at r = 0,
    or the smaller of both at r = 1. Good to 3e-4, to 1e-5 where r < 0.8 or r > 0.95.
    """
    alone = normal(-h), normal(-k)
    smaller = min(alone[0], alone[1])
    if smaller < _NEGLIGIBLE or 1 - max(alone[0], alone[1]) < _NEGLIGIBLE:
        return smaller
    if r > _ALIKE:
        return min(max(smaller - _missing(h, k, 1 - r * r), 0.0), smaller)
    angle = math.asin(r)
    total = 0.0
    for i in range(len(_NODES)):
        sine = math.sin(angle * _NODES[i, 0])
        total += _NODES[i, 1] * math.exp(-((h - k) ** 2 / (1 - sine * sine) / 2 + h * k / (1 + sine)))
    return min(max(alone[0] * alone[1] + total * angle / (2 * math.pi), 0.0), smaller)


@kernel
def _missing(h: float, k: float, x2: float) -> float:
    """Return how much less probable it is than at r = 1 that both are above: x2 = 1 - r^2.

    With r = sqrt(1 - t^2) it is 1 / 2 pi times the integral up to x of exp(-d^2 / 2 t^2) g(t), d = h - k, where g(t) =
    exp(-m / (1 + sqrt(1 - t^2))) / sqrt(1 - t^2) with m = h k is smooth, exp(-m / 2) (1 + (1/2 - m/8) t^2 + ..). With
    E = exp(-d^2 / 2 x^2) the integrals of its powers are I0 = x E - d sqrt(2 pi) Phi(-d / x) and, as the derivative of
    x^n E is (n x^(n-1) + d^2 x^(n-3)) E, I2 = (x^3 E - d^2 I0) / 3 and I4 = (x^5 E - d^2 I2) / 5.
    """
    d2, m = (h - k) ** 2, h * k
    if d2 >= 24 * x2:  # less than exp(-12)
        return 0.0
    x, d = math.sqrt(x2), abs(h - k)
    e = x * math.exp(-d2 / x2 / 2)
    i0 = e - d * math.sqrt(2 * math.pi) * normal(-d / x)
    i2 = (x2 * e - d2 * i0) / 3
    i4 = (x2 * x2 * e - d2 * i2) / 5
    return math.exp(-m / 2) / (2 * math.pi) * (i0 + (1 / 2 - m / 8) * i2 + (3 / 8 - m / 8 + m * m / 128) * i4)


_ALIKE = 0.8
_NEGLIGIBLE = 1e-5
_NODES: Floats = np.stack(np.polynomial.legendre.leggauss(8), axis=1) / 2 + [0.5, 0.0]
"""Places and weights of Gauss and Legendre between 0 and 1."""
