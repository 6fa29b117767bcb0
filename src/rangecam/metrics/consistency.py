"""Is the covariance honest, and how large are the errors (Bar-Shalom, Li and Kirubarajan 2001, section 5.4)."""

import numpy as np
from scipy.stats import chi2

from rangecam.errors import UsageError
from rangecam.types import Floats


def nees(error: Floats, covariance: Floats) -> Floats:
    """Return the normalised estimation error squared, e' P^-1 e, of errors (..., d) with covariances (..., d, d).

    Its mean is d where the covariance is true. Of an innovation and its covariance it is the NIS.
    """
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray(np.sum(error * solved, axis=-1))


def chi_square_bounds(dof: int, count: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Return between what the mean of `count` independent NEES (NIS) of `dof` lies with `probability`, both sides.

    The sum is chi-square with count * dof degrees of freedom. Raises UsageError for a probability outside of 0..1 or
    for nothing to average.
    """
    if not 0 < probability < 1:
        raise UsageError(f"probability = {probability}: expected between 0 and 1, such as 0.95")
    if dof < 1 or count < 1:
        raise UsageError(f"dof = {dof}, count = {count}: expected at least 1 of each")
    low, high = (float(chi2.ppf(tail, dof * count)) for tail in ((1 - probability) / 2, (1 + probability) / 2))
    return low / count, high / count


def rmse(error: Floats, axis: int | tuple[int, ...] | None = None) -> Floats:
    """Return the root of the mean square along `axis` (all, if None)."""
    return np.asarray(np.sqrt(np.mean(np.square(error), axis=axis)))


def amse(error: Floats) -> Floats:
    """Return the mean square error of estimates over runs, averaged over the steps: (runs, steps, ...) -> (...).

    At each step the square of the mean error and the variance over the runs add up (König 2008, eq 6.41 to 6.46).
    """
    residual, sigma = error.mean(axis=0), error.std(axis=0)  # eq 6.41 to 6.43
    return np.asarray((sigma**2 + residual**2).mean(axis=0))  # eq 6.44, 6.46
