"""The noise model of a pulsed camera, fitted to what it recorded: variance over accumulations."""

import numpy as np
from numpy.typing import ArrayLike

from rangecam.calibration.noise import NoiseFit, fit_line
from rangecam.errors import DataError
from rangecam.pulsed.pixel import damping, step_v
from rangecam.pulsed.settings import Pixel


def fit_dark_noise(accumulations: ArrayLike, variance_v2: ArrayLike, count: ArrayLike, pixel: Pixel) -> NoiseFit:
    """Return the line whose slope is sigma_S2 and whose base is sigma_R2 (König 2008, eq 4.21).

    accumulations, variance_v2, count (K,): numbers of pulses, the variance of a dark value over time at each, and how
    many values it was taken from. The noise is damped as the signal is, so the variances are divided by d2 before the
    fit (4.2.3.1; E-K-10), after that of the converter's rounding has been taken off. Raises DataError for fewer than
    two numbers of accumulations, or a line without positive parameters.
    """
    n, variance, values = (np.asarray(each, np.float64) for each in (accumulations, variance_v2, count))
    if len(n) < 2:
        raise DataError(f"dark frames of {len(n)} number of accumulations; two or more tell sigma_S from sigma_R")
    undamped = (variance - step_v(pixel) ** 2 / 12) / damping(n, pixel) ** 2
    error = variance * np.sqrt(2 / values) / damping(n, pixel) ** 2
    fit = fit_line(n, undamped, error)
    if fit.slope <= 0 or fit.base <= 0:
        raise DataError(
            f"dark noise of {', '.join(f'{v:.3g} V2 at n = {i:g}' for i, v in zip(n, variance, strict=True))} does not "
            "grow with the accumulations as n sigma_S2 + sigma_R2"
        )
    return fit
