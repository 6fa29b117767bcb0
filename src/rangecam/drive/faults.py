"""What goes wrong with the frames on their way from the sensor; the bus and the road have their faults in the loop."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rangecam.config import Config
from rangecam.drive.settings import Fault
from rangecam.types import Capture, Image


def active(faults: Sequence[Fault], time_s: float, kind: str) -> Fault | None:
    """Return the fault of that kind at a time, or none."""
    for fault in faults:
        if fault.kind == kind and fault.start_s <= time_s < fault.start_s + fault.duration_s:
            return fault
    return None


def arrivals(
    capture: Capture, time_s: float, held: Capture, faults: Sequence[Fault], config: Config
) -> list[tuple[float, Capture]]:
    """Return when and how a frame arrives that was ready at `time_s`; held: the last one before a fault began."""
    if not faults:
        return [(time_s, capture)]
    taken_s = capture.raw.time_s
    if active(faults, taken_s, "dropped"):
        return []
    if active(faults, taken_s, "repeated"):
        return [(time_s, held)]
    if active(faults, taken_s, "frozen"):
        capture = replace(capture, raw=replace(capture.raw, planes=held.raw.planes))
    if active(faults, taken_s, "saturated"):
        planes = {name: _full(name, plane, config) for name, plane in capture.raw.planes.items()}
        capture = replace(capture, raw=replace(capture.raw, planes=planes))
    late = active(faults, taken_s, "late")
    if late is not None:
        time_s += late.value
    if active(faults, taken_s, "out_of_order") and capture.raw.frame_id % 2:
        time_s += 1.5 / config.camera.frame_rate_hz
    return [(time_s, capture)]


_IMAGE_FAULTS = ("frozen", "repeated")


def kept(capture: Capture, held: Capture, faults: Sequence[Fault]) -> Capture:
    """Return what a frozen or repeating camera goes on showing: `held` while it does, else the new frame."""
    wrong = faults and any(active(faults, capture.raw.time_s, kind) for kind in _IMAGE_FAULTS)
    return held if wrong else capture


def _full(name: str, plane: Image, config: Config) -> Image:
    """Return a plane of samples at full scale; planes that are no samples stay."""
    camera = config.camera
    if camera.kind == "cw" and "phase_" in name:
        top = camera.full_scale_lsb if camera.full_scale_lsb is not None else float(np.max(plane))
    elif camera.kind == "pulsed" and name.startswith(("shutter_", "tap_")):
        top = camera.pixel.saturation_v if name.startswith("shutter_") else camera.taps.saturation_counts
    elif camera.kind == "processed" and name in ("range_m", "depth_m"):
        top = 0.0  # it refuses what it cannot measure
    else:
        return plane
    return np.full_like(plane, top)
