"""Whether an image can be trusted: its samples and its time beside those of the image before. Pure.

Nothing here knows a camera family: samples are compared plane by plane, and what a pixel could not measure is in `why`.
`judge` says what is wrong with one image; how long that may last before the car is stopped is the machine's business.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rangecam.brake.machine import Fault, Perception
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings
from rangecam.types import VELOCITY, Frame, RawFrame, TrackStatus, Why
from rangecam.values import value

_MEASURED = [Why.VALID, Why.FLOOR, Why.OUTSIDE_AREA]
"""Pixels that measured something: what does not belong to an object shows as well that the lens is clear."""
_IS_MEASURED = np.array([each in _MEASURED for each in range(256)])
_SATURATED = int(Why.SATURATED)
_CONFIRMED = int(TrackStatus.CONFIRMED)
_CONSTANT = ("reference_range_m", "temperature_c", "status", "n_acc", "dark_")
"""Planes whose names begin so may stay as they are from image to image."""


@settings
class HealthSettings:
    """From when on an image is not to be trusted."""

    frozen_fraction: Fraction = 0.98
    """Noise changes samples from image to image: with at least this share of the samples as before, it is frozen ..."""
    frozen_repeats: PositiveInt = 2
    """... when so many images in a row are like the one before."""
    max_lateness_s: Positive = 0.05
    """An image may take so much longer from exposure to arrival than the fastest did."""
    clock_drift: NonNegative = 1e-4
    """Seconds a second by which the camera's clock may run apart from ours (two quartz clocks and their warming)."""
    max_saturated: Fraction = 0.3
    """At most this share of the pixels may have too much light."""
    min_seen: Fraction = 0.05
    """At least this share of the pixels must have measured something: less means blocked, or blinded by the sun."""
    near_m: NonNegative = 0.05
    """A surface nearer than this lies on the lens ..."""
    max_near: Fraction = 0.5
    """... if this share of the pixels sees it."""


@value
class Health:
    """What was found of one image, and what the judgement of the next needs.

    faults: all that is wrong, empty for a good image. seen, saturated, near: shares of the pixels. unchanged: share of
    the samples that are what they were. lateness_s: beyond the fastest image. repeats: images in a row like the one
    before. raw, received_s: of this image. fastest_s: least time from exposure to arrival, clocks apart included.
    """

    faults: tuple[Fault, ...]
    seen: float
    saturated: float
    near: float
    unchanged: float
    lateness_s: float
    repeats: int
    raw: RawFrame
    received_s: float
    fastest_s: float


def judge(frame: Frame, received_s: float, before: Health | None, settings: HealthSettings) -> Health:
    """Return the health of an image that arrived at `received_s` on our clock, after another one (None: the first)."""
    why, range_m = np.ascontiguousarray(frame.image.why), np.ascontiguousarray(frame.image.range_m)
    measured = np.empty(why.shape, np.bool_)
    near_m = range_m.dtype.type(settings.near_m)
    counts = _count(why.ravel(), range_m.ravel(), near_m, _IS_MEASURED, measured.ravel())
    n_measured, n_saturated, n_near = counts
    pixels = max(1, why.size)
    seen, saturated, near = n_measured / pixels, n_saturated / pixels, n_near / pixels
    took_s = received_s - frame.raw.time_s
    unchanged, repeats, fastest_s = 0.0, 0, took_s
    if before is not None:
        unchanged = _unchanged(frame.raw, before.raw, measured, n_measured)
        repeats = before.repeats + 1 if unchanged >= settings.frozen_fraction else 0
        drift_s = settings.clock_drift * max(0.0, received_s - before.received_s)
        fastest_s = min(took_s, before.fastest_s + drift_s)
    lateness_s = took_s - fastest_s
    found = (
        (Fault.LATE, not lateness_s <= settings.max_lateness_s),
        (Fault.SATURATED, saturated > settings.max_saturated),
        (Fault.BLOCKED, seen < settings.min_seen or near > settings.max_near),
        (Fault.FROZEN, repeats >= settings.frozen_repeats),
    )
    faults = tuple(fault for fault, is_so in found if is_so)
    return Health(faults, seen, saturated, near, unchanged, lateness_s, repeats, frame.raw, received_s, fastest_s)


@njit(cache=True, nogil=True)
def _count(why: Any, range_m: Any, near_m: Any, is_measured: Any, measured: Any) -> Any:
    """Return how many pixels measured something, have too much light, are near; fill which measured something."""
    n_measured = n_saturated = n_near = 0
    for i in range(why.size):
        measured[i] = is_measured[why[i]]
        n_measured += measured[i]
        n_saturated += why[i] == _SATURATED
        n_near += range_m[i] < near_m
    return n_measured, n_saturated, n_near


def _unchanged(raw: RawFrame, before: RawFrame, measured: NDArray[np.bool_], n_measured: int) -> float:
    """Return the share of the samples of measured pixels that are what they were, 0 where none can be compared."""
    equal = total = 0
    for name, plane in raw.planes.items():
        old = before.planes.get(name)
        if name.startswith(_CONSTANT) or old is None or not plane.shape == old.shape == measured.shape:
            continue
        equal += int(np.count_nonzero((plane == old) & measured))
        total += n_measured
    return equal / total if total else 0.0


def perceived(frame: Frame, health: Health) -> Perception:
    """Return what the machine needs to know of an image."""
    decision = frame.decision
    return Perception(
        frame_id=frame.raw.frame_id,
        time_s=frame.raw.time_s,
        received_s=health.received_s,
        brake=decision.brake,
        reason=decision.reason,
        faults=health.faults,
        scene_speed_mps=_scene_speed(frame),
        track_id=decision.track_id,
        distance_m=decision.distance_m if decision.track_id else math.inf,
        closing_mps=decision.closing_speed_mps if decision.track_id else 0.0,
    )


def _scene_speed(frame: Frame) -> float | None:
    """Return the speed in m/s at which the scene comes closer: the median of at least three confirmed tracks."""
    confirmed = frame.tracks.status == _CONFIRMED
    if np.count_nonzero(confirmed) < 3:
        return None
    return float(np.median(-frame.tracks.state[confirmed, VELOCITY[0]]))
