"""What a pulsed camera can be at all: its times, the designs that are refused, and those that come with a warning."""

from functools import lru_cache

from rangecam.errors import UsageError
from rangecam.pulsed.bit_pattern import Cycle, cycle_of
from rangecam.pulsed.laser import power_fraction, thermal_limit_hz
from rangecam.pulsed.settings import PulsedCamera
from rangecam.pulsed.signal import Window, check_edges, correlation_curve, edges_s, exposures, gate_windows


@lru_cache(maxsize=64)
def max_frame_rate_hz(camera: PulsedCamera) -> float:
    """Return the images a second that exposure and read-out allow (König 2008, eq 4.48, for any number of windows).

    A window is read at each number of accumulations, all pixels of an output one after the other (K-FW-03).
    """
    if camera.readout == "three_tap":
        return camera.laser.repetition_hz / (camera.taps.pulses * camera.averages)
    return 1 / (len(exposures(camera)) * _window_s(camera) * camera.averages)


def window_step_s(camera: PulsedCamera) -> float:
    """Return the time from the middle of one window to that of the next: all of its pulses, or one (N-K-050)."""
    return 1 / camera.laser.repetition_hz if camera.shutter_order == "alternating" else _window_s(camera)


@lru_cache(maxsize=64)
def _window_s(camera: PulsedCamera) -> float:
    """Return how long the pulses of one window and its read-outs take."""
    pixel, sequencer = camera.pixel, camera.sequencer
    read_s = camera.rows * camera.columns / sequencer.outputs * sequencer.pixel_read_s
    return max(pixel.accumulations) / camera.laser.repetition_hz + len(pixel.accumulations) * read_s


@lru_cache(maxsize=8)
def cycles(camera: PulsedCamera) -> tuple[Cycle, ...]:
    """Return what the bit pattern does for each pulse of each of `exposures`; off the clock, of the next wider one."""
    opening_s, closing_s = edges_s(camera)
    found = []
    for window, _ in exposures(camera).values():
        switched = (window[0] + opening_s / 2, window[1] + closing_s / 2)
        found.append(cycle_of(switched, camera.sequencer))
    return tuple(found)


@lru_cache(maxsize=64)
def check(camera: PulsedCamera) -> None:
    """Raise UsageError for a camera that cannot be, or could measure nothing, saying why.

    Refused are: no accumulation, a pulse or window shorter than its edges, windows that no pulse meets in the range of
    measurement, and pulses that come before the cycle of the one before has ended.
    """
    if min(camera.pixel.accumulations) < 1:
        raise UsageError(f"camera.pixel.accumulations = {camera.pixel.accumulations}: each must be 1 or more")
    for name, (window, delay_s) in _windows(camera).items():
        check_edges(window, camera)
        _check_overlap(name, window, delay_s, camera)
    if camera.readout == "three_tap":
        return
    longest_s = max(cycle.length_s for cycle in cycles(camera))
    if longest_s * camera.laser.repetition_hz > 1:
        raise UsageError(
            f"camera.laser.repetition_hz = {camera.laser.repetition_hz:g}: exposures with the laser on and off and "
            f"their transfer take {longest_s:.3g} s, so that it must not exceed {1 / longest_s:.4g}"
        )


def _windows(camera: PulsedCamera) -> dict[str, tuple[Window, float]]:
    """Return the windows that must meet the pulse: the shutters, those of CSI and DCSI together, or the second gate."""
    if camera.readout == "three_tap":
        return {"gate 2": (gate_windows(camera)["2"], -camera.pulse_lead_s)}
    return exposures(camera)


def _check_overlap(name: str, window: Window, delay_s: float, camera: PulsedCamera) -> None:
    if camera.shutters.endswith("_delayed") and camera.readout == "shutters":
        return  # of many delays, some may miss
    delays_s, _ = correlation_curve(window, camera)
    nearest_m, farthest_m = (camera.speed_of_light_mps / 2 * (at_s - delay_s) for at_s in (delays_s[0], delays_s[-1]))
    limit_m = camera.max_range_m
    if farthest_m <= camera.min_range_m or (limit_m is not None and nearest_m >= limit_m):
        to_m = "" if limit_m is None else f" to {limit_m:g}"
        raise UsageError(
            f"{name.replace('_', ' ')}: it sees targets from {nearest_m:.4g} to {farthest_m:.4g} m, none from "
            f"camera.min_range_m = {camera.min_range_m:g}{to_m}; change the delays of laser or shutter, or the widths"
        )


def warnings_of(camera: PulsedCamera) -> list[str]:
    """Return what is possible but harmful or beyond what is known, a sentence each, naming the limit."""
    laser, found = camera.laser, []
    limit_hz = thermal_limit_hz(laser, camera.pulse_width_s, camera.temperature_c)
    if laser.repetition_hz > limit_hz:
        settles = float(power_fraction(laser, camera.pulse_width_s, camera.temperature_c, float("inf")))
        found.append(
            f"camera.laser.repetition_hz = {laser.repetition_hz:g} is above its thermal limit, {limit_hz:.4g} Hz: "
            f"the power settles at {settles:.0%} of the first, and below {laser.least_power:.0%} heat harms the diodes"
        )
    return found
