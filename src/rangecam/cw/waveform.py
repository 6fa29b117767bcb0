"""The correlation function of real signals: light and reference with their harmonics (Steinbäck 2016, 2.2.1)."""

import numpy as np
from numpy.typing import NDArray

from rangecam.cw.effects import Signal, Waveform
from rangecam.types import Floats

TABLE_SIZE = 4096
"""Values of a period; interpolation between them leaves 3e-7 of the amplitude."""

Complexes = NDArray[np.complexfloating]


def harmonics(waveform: Waveform, modulation_hz: float, count: int = TABLE_SIZE // 2 - 1) -> Complexes:
    """Return the harmonics h_1 .. h_count of the correlation c(x) = Re sum h_k exp(-i k x), with h_1 = 1.

    With light sum L_k exp(i k w t), delayed by the phase, and reference sum R_k exp(i k (w t + step)), the mean of
    their product over a period is 2 Re sum L_k conj(R_k) exp(-i k (phase + step)) (S-TOF-01). The delay of the
    fundamental is taken out, as a camera's global offset does, and its amplitude is 1: what is left makes wiggling.
    """
    k = np.arange(1, count + 1)
    light = _series(waveform.illumination, waveform.illumination_duty_cycle, k).astype(complex)
    if waveform.bandwidth_hz is not None:
        light /= 1 + 1j * k * modulation_hz / waveform.bandwidth_hz
    product = light * _series(waveform.reference, waveform.reference_duty_cycle, k)
    result: Complexes = product / abs(product[0]) * np.exp(-1j * k * np.angle(product[0]))
    return result


def correlation_table(h: Complexes) -> Floats:
    """Return c(x) over one period in TABLE_SIZE steps and the first two values again, float32.

    The second one is for a phase just below zero, which in float32 is one whole turn.
    """
    spectrum = np.zeros(TABLE_SIZE // 2 + 1, complex)
    spectrum[1 : len(h) + 1] = np.conj(h) * (TABLE_SIZE / 2)
    period = np.fft.irfft(spectrum, TABLE_SIZE)
    return np.append(period, period[:2]).astype(np.float32)


def _series(signal: Signal, duty_cycle: float, k: NDArray[np.int_]) -> Floats:
    """Return the Fourier coefficients of a signal that is even in time."""
    if signal == "sine":
        return np.where(k == 1, 1.0, 0.0)
    result: Floats = np.sin(np.pi * k * duty_cycle) / k
    return result
