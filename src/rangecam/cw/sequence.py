"""What a frame of a continuous-wave camera is made of: exposures, each of one modulation frequency and phase step."""

from dataclasses import dataclass, replace
from functools import lru_cache

from rangecam.cw.settings import CwCamera
from rangecam.errors import UsageError


@dataclass(frozen=True)
class Exposure:
    """One phase image of a frame: the plane that it becomes, its phase step, and the camera at its one frequency."""

    plane: str
    step_deg: float
    camera: CwCamera


def plane_name(step_deg: float, frequency: int | None = None) -> str:
    """Return the name of a plane: phase_<step>, with f<k>_ before it for number k of several frequencies."""
    return ("" if frequency is None else f"f{frequency}_") + f"phase_{step_deg:g}"


@lru_cache(maxsize=64)
def single_frequencies(camera: CwCamera) -> tuple[CwCamera, ...]:
    """Return the camera at each of its modulation frequencies, as a camera with that `modulation_hz` alone."""
    if not camera.modulations_hz:
        return (camera,)
    return tuple(replace(camera, modulation_hz=each, modulations_hz=()) for each in camera.modulations_hz)


@lru_cache(maxsize=64)
def exposures(camera: CwCamera) -> tuple[Exposure, ...]:
    """Return the exposures of a frame in order of capture: all steps at the first frequency, then at the next.

    Raises UsageError if there are fewer than three different steps, a step or a frequency comes twice, or
    `capture_order` is not an order of the steps.
    """
    steps, order = camera.phase_steps_deg, camera.capture_order or camera.phase_steps_deg
    if len(steps) < 3 or len({step % 360 for step in steps}) < len(steps):
        raise UsageError(f"camera.phase_steps_deg = {_listed(steps)}: expected three or more steps, none of them twice")
    if sorted(order) != sorted(steps):
        raise UsageError(f"camera.capture_order = {_listed(order)}: expected {_listed(steps)[1:-1]} in some order")
    if len(set(camera.modulations_hz)) < len(camera.modulations_hz):
        raise UsageError(f"camera.modulations_hz = {_listed(camera.modulations_hz)}: expected each frequency once")
    return tuple(
        Exposure(plane_name(step, k if camera.modulations_hz else None), step, single)
        for k, single in enumerate(single_frequencies(camera))
        for step in order
    )


def plane_names(camera: CwCamera) -> tuple[str, ...]:
    """Return the planes of a frame, by frequency and then by phase step as `phase_steps_deg` lists them."""
    several = bool(camera.modulations_hz)
    return tuple(
        plane_name(step, k if several else None)
        for k in range(len(single_frequencies(camera)))
        for step in camera.phase_steps_deg
    )


def exposure_times_s(camera: CwCamera, time_s: float) -> list[float]:
    """Return the middle of each exposure, in order of capture, of the sequence centred on `time_s` (S-PIF-02)."""
    period_s = camera.illumination_time_s + readout_time_s(camera)
    count = len(exposures(camera))
    return [time_s + (k - (count - 1) / 2) * period_s for k in range(count)]


@lru_cache(maxsize=64)
def single_exposures(camera: CwCamera) -> tuple[CwCamera, ...]:
    """Return the camera with each of its illumination times, as a camera with that `illumination_time_s` alone.

    Raises UsageError if two times are the same number of whole microseconds, or one is none.
    """
    times_s = camera.illumination_times_s
    if not times_s:
        return (camera,)
    if len({round(each * 1e6) for each in times_s} - {0}) < len(times_s):
        raise UsageError(
            f"camera.illumination_times_s = {_listed(times_s)}: expected different whole numbers of microseconds, "
            "such as [1e-4, 2e-3]"
        )
    return tuple(replace(camera, illumination_time_s=each, illumination_times_s=()) for each in times_s)


def sequence_times_s(camera: CwCamera, time_s: float) -> list[float]:
    """Return the middle of the sequence of each illumination time; together they are centred on `time_s`."""
    durations_s = [1 / fastest_frame_rate_hz(each) for each in single_exposures(camera)]
    start_s, middles_s = time_s - sum(durations_s) / 2, []
    for duration_s in durations_s:
        middles_s.append(start_s + duration_s / 2)
        start_s += duration_s
    return middles_s


def fastest_frame_rate_hz(camera: CwCamera) -> float:
    """Return the rate at which frames follow each other without a pause (Steinbäck 2016, fig 4.7; N-S-019)."""
    if camera.illumination_times_s:
        return 1 / sum(1 / fastest_frame_rate_hz(each) for each in single_exposures(camera))
    return 1 / (len(exposures(camera)) * (camera.illumination_time_s + readout_time_s(camera)))


def readout_time_s(camera: CwCamera) -> float:
    """Return the pause after each exposure: in proportion to the rows that are read, no less than the link needs."""
    region, clock_hz = camera.region_of_interest, camera.link.pixel_clock_hz
    rows, columns = (camera.rows, camera.columns) if region is None else region[2:]
    pause_s = camera.readout_time_s * rows / camera.rows
    return pause_s if clock_hz is None else max(pause_s, rows * columns / clock_hz)


def _listed(values: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"
