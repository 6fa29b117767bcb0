"""Pulse, shutter windows and their correlation: how long each window collects of a pulse, by its delay.

Times count from the trigger of the shutter; a pulse without delay is at half of its height at 0 and at its width.
"""

from functools import lru_cache

import numpy as np

from rangecam.errors import UsageError
from rangecam.pulsed.bit_pattern import execute
from rangecam.pulsed.settings import PulsedCamera
from rangecam.types import Floats

Window = tuple[float, float]
"""When a window opens and closes, s: where it is at half of its sensitivity."""

_STEPS_IN_PULSE = 2000
_STEPS_IN_WINDOW = 20_000


def switch_times(camera: PulsedCamera) -> dict[str, Window]:
    """Return when the switch opens and closes the windows a, b, c: b opens when a closes, c spans both.

    König 2008, eq 3.12 and fig 3.6. A bit pattern in `camera.sequencer` takes the place of these times.
    """
    opens, sequencer = camera.shutter_delay_s, camera.sequencer
    middle = opens + (camera.shutter_a_width_s or camera.pulse_width_s)
    closes = middle + (camera.shutter_b_width_s or camera.pulse_width_s)
    times = {"a": (opens, middle), "b": (middle, closes), "c": (opens, closes)}
    tables = {"a": sequencer.table_a, "b": sequencer.table_b, "c": sequencer.table_c}
    for name, table in tables.items():
        if table:
            times[name] = execute(table, sequencer.clock_step_s, f"camera.sequencer.table_{name}").window_s
    return times


def shutter_windows(camera: PulsedCamera) -> dict[str, Window]:
    """Return the windows a, b, c, which open and close before the switch does.

    Charge needs `shutter_edge_s` to arrive (the opening edge `shutter_opening_s`), so that both edges of a window come
    before the switch (König 2008, 4.2.1.2). Different edges leave a gap between a and b, or let them overlap.
    """
    opening_s, closing_s = edges_s(camera)
    return {
        name: (opens - opening_s / 2, closes - closing_s / 2) for name, (opens, closes) in switch_times(camera).items()
    }


def edges_s(camera: PulsedCamera) -> tuple[float, float]:
    """Return the lengths of the opening and the closing edge of a window, s."""
    return (
        camera.shutter_edge_s if camera.shutter_opening_s is None else camera.shutter_opening_s,
        camera.shutter_edge_s,
    )


def gradient_windows(camera: PulsedCamera, kind: str) -> tuple[Window, Window]:
    """Return the two windows of a gradient method (König 2008, 3.4.2), of kind "a" or "b".

    a1 and a2 open together, a2 closes `gradient_step_s` earlier; b1 opens `gating_s` after b, b2 that step later, both
    as long as b (5.2.1.3). Raises UsageError for a step that leaves nothing of window a2.
    """
    (opens, closes), step_s = shutter_windows(camera)[kind], camera.gradient_step_s
    if kind == "b":
        first = (opens + camera.gating_s, closes + camera.gating_s)
        return first, (first[0] + step_s, first[1] + step_s)
    if step_s >= closes - opens:
        raise UsageError(
            f"camera.gradient_step_s = {step_s:g}: must be less than the width of window a, {closes - opens:g} s"
        )
    return (opens, closes), (opens, closes - step_s)


def laser_delays(camera: PulsedCamera) -> Floats:
    """Return the delays of the laser for csi, dcsi and shifted, s (delay_count,)."""
    return camera.laser_delay_s + camera.delay_first_s + camera.delay_step_s * np.arange(camera.delay_count)


@lru_cache(maxsize=8)
def exposures(camera: PulsedCamera) -> dict[str, tuple[Window, float]]:
    """Return window and laser delay of each plane that `camera.shutters` takes, by its name and in order of time."""
    windows, taken, delay_s = shutter_windows(camera), camera.shutters, camera.laser_delay_s
    if taken in ("aa", "bb"):
        pair = gradient_windows(camera, taken[0])
        return {f"shutter_{taken[0]}{i}": (window, delay_s) for i, window in enumerate(pair, 1)}
    if taken in ("a_delayed", "b_delayed", "ab_delayed"):
        letters = taken.removesuffix("_delayed")
        delays = enumerate(laser_delays(camera).tolist())
        return {f"shutter_{name}_{i}": (windows[name], each_s) for i, each_s in delays for name in letters}
    return {f"shutter_{name}": (windows[name], delay_s) for name in taken}


def gate_windows(camera: PulsedCamera) -> dict[str, Window]:
    """Return the gates 1, 2, 3 of a three-tap sensor, which follow each other; gate 2 opens at 0."""
    width = camera.gate_width_s or camera.pulse_width_s
    return {str(i): ((i - 2) * width, (i - 1) * width) for i in (1, 2, 3)}


def collected_s(delay_s: Floats, window: Window, camera: PulsedCamera) -> Floats:
    """Return how much of a pulse of height 1 a window collects, s, when the pulse comes `delay_s` late.

    The integral of eq 3.16 of König 2008 without the constants. Raises UsageError for edges longer than the pulse or
    the window.
    """
    delays_s, values_s = correlation_curve(window, camera)
    return np.interp(delay_s, delays_s, values_s)


@lru_cache(maxsize=64)
def correlation_curve(window: Window, camera: PulsedCamera) -> tuple[Floats, Floats]:
    """Return the correlation of pulse and window as a line through points: delays, s, and what is collected there, s.

    Ideal shapes give the trapezoid of fig 3.5, exactly, by its four corners; others are correlated numerically.
    Raises UsageError as `collected_s` does.
    """
    (opens, closes), pulse_s, (opening_s, closing_s) = window, camera.pulse_width_s, edges_s(camera)
    if camera.pulse_rise_s == camera.pulse_fall_s == opening_s == closing_s == camera.pulse_rounding == 0:
        inner = sorted((opens, closes - pulse_s))
        most_s = min(pulse_s, closes - opens)
        return np.array([opens - pulse_s, *inner, closes]), np.array([0.0, most_s, most_s, 0.0])
    check_edges(window, camera)
    step_s = max(pulse_s / _STEPS_IN_PULSE, (closes - opens) / _STEPS_IN_WINDOW)
    pulse_start_s, window_start_s = -camera.pulse_rise_s, opens - opening_s
    pulse_at = np.arange(pulse_start_s, pulse_s + camera.pulse_fall_s + step_s, step_s)
    window_at = np.arange(window_start_s, closes + closing_s + step_s, step_s)
    # An upright edge is sampled as one step long, about the same middle.
    sensitivity = trapezoid(window_at, window, max(opening_s, step_s), max(closing_s, step_s))
    values_s = correlate(pulse_shape(pulse_at, camera, step_s), sensitivity, step_s)
    first_s = window_start_s - (pulse_start_s + (len(pulse_at) - 1) * step_s)
    return first_s + step_s * np.arange(len(values_s)), values_s


def pulse_shape(time_s: Floats, camera: PulsedCamera, shortest_edge_s: float = 0.0) -> Floats:
    """Return the power over its peak, after the start of the pulse (König 2008, 4.2.2.1; K-ILL-02)."""
    width_s, shortest_s = camera.pulse_width_s, max(shortest_edge_s, 1e-9 * camera.pulse_width_s)
    shape = trapezoid(
        time_s, (0.0, width_s), max(camera.pulse_rise_s, shortest_s), max(camera.pulse_fall_s, shortest_s)
    )
    if camera.pulse_edges == "rounded":
        shape = (1 - np.cos(np.pi * shape)) / 2
    from_middle = np.clip(2 * time_s / width_s - 1, -1, 1)
    result: Floats = shape * (1 - camera.pulse_rounding * from_middle**2)
    return result


def correlate(pulse: Floats, sensitivity: Floats, step_s: float) -> Floats:
    """Return the correlation integral of two sampled shapes (König 2008, eq 3.16; 4.2.3.2).

    pulse (N,), sensitivity (M,): samples `step_s` apart, zero outside. Value i of the (N + M - 1,) returned belongs to
    the delay at which the last sample of the pulse meets sample i of the sensitivity.
    """
    return np.convolve(sensitivity, pulse[::-1]) * step_s


def trapezoid(time_s: Floats, window: Window, rise_s: float, fall_s: float) -> Floats:
    """Return a shape that is 1 inside, 0 outside and 1/2 at both times of `window`, with straight edges."""
    start, end = window
    corners = [start - rise_s / 2, start + rise_s / 2, end - fall_s / 2, end + fall_s / 2]
    return np.interp(time_s, corners, [0.0, 1.0, 1.0, 0.0])


def check_edges(window: Window, camera: PulsedCamera) -> None:
    """Raise UsageError if a pulse or a window is shorter than its edges."""
    longest_s = (camera.pulse_rise_s + camera.pulse_fall_s) / 2
    if longest_s > camera.pulse_width_s:
        raise UsageError(
            f"camera.pulse_rise_s = {camera.pulse_rise_s:g}, camera.pulse_fall_s = {camera.pulse_fall_s:g}: "
            f"their mean must not exceed camera.pulse_width_s = {camera.pulse_width_s:g}"
        )
    (opening_s, closing_s), width_s = edges_s(camera), window[1] - window[0]
    # half of each edge lies within the window, as its times are those of half of the sensitivity
    if (opening_s + closing_s) / 2 > width_s * (1 + 1e-9):
        raise UsageError(
            f"camera.shutter_edge_s = {closing_s:g}, camera.shutter_opening_s = {opening_s:g}: "
            f"their mean must not exceed the width of a window, {width_s:g} s"
        )
