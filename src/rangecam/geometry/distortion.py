"""Distortion of a lens after Brown (1966) and Conrady (1919), as OpenCV counts its coefficients, and its inverse."""

import numpy as np

from rangecam.errors import UsageError
from rangecam.types import Floats

Coefficients = tuple[float, float, float, float, float]
"""k1, k2, k3 (radial), p1, p2 (tangential)."""


def distort(x: Floats, y: Floats, coefficients: Coefficients) -> tuple[Floats, Floats, Floats]:
    """Return where a distorting lens shows a point, and the derivatives of that.

    x, y: tangents of a ray to the right and downwards, any shape. Returned: the tangents at which a pinhole camera
    would see the image point, and the Jacobian (..., 2, 2) of both by x and y.
    """
    k1, k2, k3, p1, p2 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # of radial, by r2
    shown_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    shown_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    by_x = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    by_y = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    jacobian = np.stack([np.stack([by_x, cross], axis=-1), np.stack([cross, by_y], axis=-1)], axis=-2)
    return shown_x, shown_y, jacobian


def undistort(shown_x: Floats, shown_y: Floats, coefficients: Coefficients) -> tuple[Floats, Floats]:
    """Return the tangents of the rays that a distorting lens shows at these image points: the inverse of `distort`.

    Newton's method, the step halved as long as it does not help. Raises UsageError where the lens folds the image over:
    there no ray, or more than one, belongs to a pixel.
    """
    x, y = shown_x.astype(np.float64), shown_y.astype(np.float64)
    for _ in range(_STEPS):
        seen_x, seen_y, jacobian = distort(x, y, coefficients)
        error = np.stack([shown_x - seen_x, shown_y - seen_y], axis=-1)
        size = np.linalg.norm(error, axis=-1)
        if np.all(size < _EXACT):
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            step = _solved(jacobian, error)
        step = np.where(np.isfinite(step), step, 0.0)
        share = np.ones_like(size)
        for _ in range(_HALVINGS):
            tried_x, tried_y, _ = distort(x + share * step[..., 0], y + share * step[..., 1], coefficients)
            worse = np.hypot(shown_x - tried_x, shown_y - tried_y) > size
            share = np.where(worse, share / 2, share)
        x, y = x + share * step[..., 0], y + share * step[..., 1]
    bad = ~(size < _ALMOST) | folded(x, y, coefficients)
    if bad.any():
        names = ", ".join(f"{name} = {value:g}" for name, value in zip(_NAMES, coefficients, strict=True) if value)
        raise UsageError(
            f"camera.lens: {names}: the image is folded over at {bad.sum()} of {bad.size} pixels, which see no ray or "
            "several; check the signs and the opening angle of the coefficients' calibration"
        )
    return x, y


def folded(x: Floats, y: Floats, coefficients: Coefficients) -> Floats:
    """Return where (bool) the lens folds the image over somewhere between its axis and the ray of tangents x, y."""
    part = np.linspace(0, 1, _PARTS + 1)[1:]
    _, _, jacobian = distort(x[..., None] * part, y[..., None] * part, coefficients)
    turned: Floats = (np.linalg.det(jacobian) <= 0).any(axis=-1) | ~np.isfinite(x + y)
    return turned


_NAMES = ("k1", "k2", "k3", "p1", "p2")
_STEPS, _HALVINGS, _PARTS = 50, 6, 16
_EXACT, _ALMOST = 1e-13, 1e-9  # tangents


def _solved(jacobian: Floats, error: Floats) -> Floats:
    """Return the solutions of 2 x 2 equations, infinite or NaN where there is none."""
    a, b, c, d = jacobian[..., 0, 0], jacobian[..., 0, 1], jacobian[..., 1, 0], jacobian[..., 1, 1]
    det = a * d - b * c
    u, v = error[..., 0], error[..., 1]
    return np.stack([(d * u - b * v) / det, (a * v - c * u) / det], axis=-1)
