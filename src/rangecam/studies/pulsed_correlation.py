"""Correlation of pulse and shutter window: how linear its edge is, and the ranges that follow from it."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed import RANGING
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import targets_on_axis
from rangecam.pulsed.settings import PulsedCamera
from rangecam.pulsed.signal import correlation_curve, shutter_windows
from rangecam.studies.study import Claim, Panel, Series, Study, judged, printed
from rangecam.studies.thesis_camera import thesis_camera
from rangecam.types import Floats

SHUTTER_S = 390e-9
TOLERANCE_V = 0.005
"""Deviation from a line, at 1 V amplitude."""
_STEP_S = 1e-9


def pulsed_correlation(rng: np.random.Generator) -> Study:
    """Correlation of pulse and shutter window: linear part of its edge, equal ranges of the MDSI methods.

    rng: not used, the images of this study have no noise.
    """
    ideal = PulsedCamera(shutter_a_width_s=SHUTTER_S)
    soft = replace(ideal, pulse_rise_s=60e-9, pulse_fall_s=30e-9, shutter_edge_s=65e-9)
    delays_s, values_v = _trailing_edge(soft)
    first, last = _linear_part(values_v)
    claims = [*_linear((last - first) * _STEP_S), *_equal_ranges(rng)]
    panels = [_curves({"ideal edges": ideal, "edges of the thesis": soft}), _deviation(delays_s, values_v, first, last)]
    return Study("pulsed-correlation", "König 2008, 3.4.1 and 4.2.3.2", claims, panels)


def _trailing_edge(camera: PulsedCamera) -> tuple[Floats, Floats]:
    """Return the falling edge of the correlation for window a: delays, s, and values, V, at 1 V amplitude."""
    delays_s, collected_s = correlation_curve(shutter_windows(camera)["a"], camera)
    values_v = collected_s / collected_s.max()
    top_s = delays_s[np.flatnonzero(values_v > 1 - 1e-9)[-1]]
    at_s = np.arange(top_s, delays_s[-1], _STEP_S)
    return at_s, np.interp(at_s, delays_s, values_v)


def _linear_part(values_v: Floats) -> tuple[int, int]:
    """Return the ends of the longest part of an edge that a fitted line leaves by TOLERANCE_V at most."""
    windows = (np.lib.stride_tricks.sliding_window_view(values_v, n) for n in range(len(values_v), 1, -1))
    parts_and_off = ((parts, _off_the_line(parts)) for parts in windows)
    parts, off_v = next(both for both in parts_and_off if both[1].min() <= TOLERANCE_V)
    first = int(off_v.argmin())
    return first, first + parts.shape[1] - 1


def _off_the_line(parts: Floats) -> Floats:
    """Return the largest distance of each row (M, N) from the line fitted to it, (M,)."""
    x = np.arange(parts.shape[1]) - (parts.shape[1] - 1) / 2
    slope = parts @ x / (x @ x)
    off: Floats = np.abs(parts - parts.mean(axis=1, keepdims=True) - slope[:, None] * x).max(axis=1)
    return off


def _linear(length_s: float) -> list[Claim]:
    shapes = "straight edges of 60, 30 and 65 ns; other shapes give 113 to 141 ns, the measured ones are not printed"
    return [
        printed("N-K-048", "linear part of the trailing edge, within 5 mV of 1 V", "145", length_s * 1e9, "ns", shapes),
        printed("N-K-047", "range that 145 ns are", "21.75", 3e8 / 2 * 145e-9, "m"),
    ]


def _equal_ranges(rng: np.random.Generator) -> list[Claim]:
    """Return the largest error of the four MDSI methods without noise."""
    at_m = np.arange(1.0, 26.5, 0.5)
    camera = thesis_camera("abc")
    quiet = replace(camera.pixel, sensor_noise_v=0.0, readout_noise_v=0.0, accumulations=(1,), saturation_v=1e3)
    camera, view = targets_on_axis(at_m, 0.5, replace(camera, pixel=quiet))
    raw = simulate(lambda _: view, camera, 0.0, rng)
    ranges_m = [RANGING[name](raw, camera).range_m[0] for name in ("mdsi1", "mdsi2", "mdsi3", "mdsi4")]
    worst_m = float(np.abs(np.array(ranges_m) - at_m).max())
    text = "MDSI1-4 give identical distances: largest error, 1-26 m"
    return [judged("N-K-021", text, None, worst_m * 1e6, "um", worst_m < 2e-5, "below 20 um: single precision")]


def _curves(cameras: dict[str, PulsedCamera]) -> Panel:
    series = []
    for label, camera in cameras.items():
        delays_s, collected_s = correlation_curve(shutter_windows(camera)["a"], camera)
        series.append(Series(label, delays_s * 1e9, collected_s / collected_s.max()))
    return Panel("Pulse of 180 ns, shutter of 390 ns", "laser delay (ns)", "signal (V, at 1 V amplitude)", series)


def _deviation(delays_s: Floats, values_v: Floats, first: int, last: int) -> Panel:
    line = np.polynomial.Polynomial.fit(delays_s[first : last + 1], values_v[first : last + 1], 1)
    shown = slice(max(first - 12, 0), last + 13)
    at_ns = delays_s[shown] * 1e9
    ends = delays_s[[first, last]] * 1e9
    series = [
        Series("edges of the thesis", at_ns, (values_v[shown] - line(delays_s[shown])) * 1e3),
        *(
            Series(
                "±5 mV over the linear part" if sign > 0 else "", ends, np.full(2, sign * 1e3 * TOLERANCE_V), colour=1
            )
            for sign in (1, -1)
        ),
    ]
    return Panel("Trailing edge", "laser delay (ns)", "deviation from the fitted line (mV)", series)
