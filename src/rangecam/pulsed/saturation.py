"""Ranging of what is too bright for the pixel: the laser is shifted until little of its pulse meets the window.

König 2008, 5.2.2. The simulated camera takes the planes with `camera.shutters` = b_delayed. Not part of any preset:
each step of the shift costs pulses.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rangecam.errors import UsageError
from rangecam.pulsed.delays import Samples, compose, pick, read_samples, strong_enough
from rangecam.pulsed.ranging import range_limits
from rangecam.pulsed.settings import PulsedCamera
from rangecam.pulsed.signal import correlation_curve, laser_delays, shutter_windows
from rangecam.types import Floats, RangeImage, RawFrame, Why

_TOP_PART = 0.77
_EDGE_PART = 0.75
_CURVE_POINTS = 4000


def shifted(raw: RawFrame, camera: PulsedCamera) -> RangeImage:
    """Return the range from window b at two delays of the laser at which the pixel is not saturated.

    Planes shutter_b_0.. of window b, one for each of `laser_delays`: the later the pulse, the more of it falls into the
    window. Of each pixel the last delay before it is full is taken (or before 77 % of its largest signal, if it never
    is), and one of about a quarter of that signal, or the one before. The quotient of both is that of two windows
    of gradient method 2 (eq 3.24, E-K-04; equally for ideal shapes): it tells how long before the window opened
    the pulse began, on the rising edge of the correlation of pulse and window, whatever its shape. sigma_m follows
    from the noise of both values and the slope of that curve. amplitude is what the whole pulse would give, V.
    A pixel that is full at the first two delays is SATURATED; one whose signal grows by less than `min_snr` of its
    standard deviations with each step is LOW_AMPLITUDE: noise would choose the delays.
    Raises UsageError for steps longer than the edge.
    """
    (opens, closes), delays_s, count = shutter_windows(camera)["b"], laser_delays(camera), camera.delay_count
    samples = read_samples(raw, camera, tuple(f"shutter_b_{i}" for i in range(count)), [closes - opens] * count)
    top, foot = _chosen(samples.value_v, camera.pixel.saturation_v * (1 - 1e-6), _steps_on_edge(camera))
    found = foot >= 0
    top, foot = np.maximum(top, 1), np.maximum(foot, 0)
    (top_v, top_v2), (foot_v, foot_v2) = (
        (pick(samples.value_v, at), pick(samples.variance_v2, at)) for at in (top, foot)
    )
    inverse = 1 / np.where(top_v > 0, top_v, np.inf)
    quotient = foot_v * inverse
    quotient_sigma = inverse * np.sqrt(foot_v2 + quotient**2 * top_v2)
    arrival_s, per_quotient_s, part = _on_the_edge(quotient, top - foot, camera)
    per_second = camera.speed_of_light_mps / 2
    distance_m = per_second * (arrival_s - delays_s[top]) + camera.offset_m
    sigma_m = per_second * per_quotient_s * quotient_sigma
    edge_s, _ = _edge(camera)
    low_m, high_m, _ = range_limits(camera, edge_s[0] - delays_s[-1], edge_s[-1] - delays_s[1])
    inside = (low_m <= distance_m) & (distance_m <= high_m) & (quotient >= camera.far_margin_sigmas * quotient_sigma)
    bright = (samples.why == Why.SATURATED) & found
    free = Samples(*samples[:3], np.where(bright, np.uint8(Why.VALID), samples.why))
    whole_v = np.where(found, top_v / part, 0.0)
    growth = (top_v - foot_v) / (top - foot)
    enough = strong_enough(whole_v, growth, top_v2, camera)
    return compose(raw, free, distance_m, sigma_m, whole_v, enough, inside & found)


def _chosen(values_v: Floats, full_v: float, most_steps: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the index of the larger and of the smaller signal of each pixel of (S, H, W), both on the rising edge.

    They are at most `most_steps` apart. The smaller is -1 where there is none.
    """
    most_v = values_v.max(axis=0)
    limit_v = np.where(most_v >= full_v, full_v, _TOP_PART * most_v)
    top = (values_v >= limit_v).argmax(axis=0) - 1
    last = np.maximum(top, 0)
    top_v, sum_v = pick(values_v, last), pick(values_v.cumsum(axis=0), last)
    # The area under the edge, not a single value, says how long it is: noise would choose the value.
    length = 2 * sum_v / np.where(top_v > 0, top_v, np.inf) - 1
    apart = np.clip(np.floor(_EDGE_PART * length), 1, most_steps).astype(np.intp)
    return top, np.where(top < 1, -1, np.maximum(top - apart, 0))


@lru_cache(maxsize=8)
def _edge(camera: PulsedCamera) -> tuple[Floats, Floats]:
    """Return the rising edge of the correlation of pulse and window b: arrival of the pulse, s, and part of the top."""
    at_s, collected_s = correlation_curve(shutter_windows(camera)["b"], camera)
    top = int((collected_s >= collected_s.max() * (1 - 1e-9)).argmax())
    first = int(np.flatnonzero(collected_s[: top + 1] <= 0)[-1])
    arrival_s = np.linspace(at_s[first], at_s[top], _CURVE_POINTS)
    return arrival_s, np.interp(arrival_s, at_s, collected_s) / collected_s[top]


def _steps_on_edge(camera: PulsedCamera) -> int:
    edge_s, _ = _edge(camera)
    steps = int((edge_s[-1] - edge_s[0]) / camera.delay_step_s * (1 - 1e-3))
    if steps < 1:
        raise UsageError(
            f"camera.delay_step_s = {camera.delay_step_s:g}: must be less than the edge of the correlation of pulse "
            f"and window, {edge_s[-1] - edge_s[0]:g} s"
        )
    return steps


def _on_the_edge(quotient: Floats, steps: NDArray[np.intp], camera: PulsedCamera) -> tuple[Floats, Floats, Floats]:
    """Return when the pulse of the larger signal arrived, s, its derivative by the quotient, and its part of the top.

    quotient: of the signals of two pulses which lie `steps` of the delay apart; each (H, W).
    """
    edge_s, part = _edge(camera)
    arrival_s, slope_s = np.empty(quotient.shape), np.empty(quotient.shape)
    for apart in np.unique(steps):
        later_s = edge_s[edge_s - apart * camera.delay_step_s > edge_s[0]]
        here = steps == apart
        earlier = np.interp(later_s - apart * camera.delay_step_s, edge_s, part)
        known = earlier / np.interp(later_s, edge_s, part)
        known = np.maximum.accumulate(known) + 1e-12 * np.arange(len(known))  # rounding must not make it fall
        arrival_s[here] = np.interp(quotient[here], known, later_s)
        slope_s[here] = np.interp(quotient[here], known, np.gradient(later_s, known))
    return arrival_s, slope_s, np.interp(arrival_s, edge_s, part)


RANGING: dict[str, Callable[[RawFrame, PulsedCamera], RangeImage]] = {"shifted": shifted}
"""Ranging methods of pulsed cameras for saturated pixels, by name."""
