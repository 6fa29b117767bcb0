"""Whether an image can be trusted: its samples and its time beside those of the image before. Pure.

Nothing here knows a camera family: samples are compared plane by plane, and what a pixel could not measure is in `why`.
`judge` says what is wrong with one image; how long that may last before the car is stopped is the machine's business.
"""

import math
from dataclasses import dataclass

import numpy as np

from rangecam.brake.machine import Fault, Perception
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings
from rangecam.types import Frame, RawFrame, TrackStatus, Why

_SCENE = (Why.FLOOR, Why.OUTSIDE_AREA)
"""Pixels with these reasons were measured well: they are left out, but they show that the lens is clear."""
_CONSTANT = ("reference_range_m", "temperature_c", "status")


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


@dataclass(frozen=True, eq=False)
class Health:
    """What was found of one image, and what the judgement of the next needs.

    faults: all that is wrong, gravest first; empty for a good image. seen, saturated, near, unchanged: shares of the
    pixels (of the samples). lateness_s: beyond the fastest image. repeats: images in a row like the one before.
    raw: the samples judged. fastest_s: least time from exposure to arrival so far, clocks apart included.
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
    """Return the health of an image that arrived at `received_s` on our clock, after the one `before` (None: the first)."""
    image = frame.image
    seen = float(np.mean(np.isin(image.why, (Why.VALID, *_SCENE))))
    saturated = float(np.mean(image.why == Why.SATURATED))
    with np.errstate(invalid="ignore"):
        near = float(np.mean(image.range_m < settings.near_m))
    unchanged = 0.0 if before is None else _unchanged(frame.raw, before.raw)
    repeats = before.repeats + 1 if before is not None and unchanged >= settings.frozen_fraction else 0
    took_s = received_s - frame.raw.time_s
    fastest_s = took_s if before is None else min(took_s, _drifted(before, received_s, settings))
    lateness_s = took_s - fastest_s
    found = {
        Fault.FROZEN: repeats >= settings.frozen_repeats,
        Fault.LATE: not lateness_s <= settings.max_lateness_s,
        Fault.SATURATED: saturated > settings.max_saturated,
        Fault.BLOCKED: seen < settings.min_seen or near > settings.max_near,
    }
    faults = tuple(fault for fault, is_so in found.items() if is_so)
    return Health(faults, seen, saturated, near, unchanged, lateness_s, repeats, frame.raw, received_s, fastest_s)


def _drifted(before: Health, received_s: float, settings: HealthSettings) -> float:
    """Return the least time from exposure to arrival, which the drift of the clocks may have let grow since."""
    return before.fastest_s + settings.clock_drift * max(0.0, received_s - before.received_s)


def _unchanged(raw: RawFrame, before: RawFrame) -> float:
    """Return the share of the samples that are what they were, 0 where the images cannot be compared.

    Planes that do not change in a still scene do not count, nor do samples that are not finite.
    """
    equal = total = 0
    for name, plane in raw.planes.items():
        old = before.planes.get(name)
        if name.startswith(_CONSTANT) or old is None or old.shape != plane.shape:
            continue
        finite = np.isfinite(plane)
        equal += int(np.count_nonzero((plane == old) & finite))
        total += int(np.count_nonzero(finite))
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
    )


def _scene_speed(frame: Frame) -> float | None:
    """Return the speed in m/s at which the scene comes closer: the median of at least three confirmed tracks."""
    seen = frame.tracks.status == TrackStatus.CONFIRMED
    closing = -frame.tracks.state[seen, 1]
    return float(np.median(closing)) if len(closing) >= 3 and math.isfinite(float(np.median(closing))) else None
