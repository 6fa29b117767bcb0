"""Parking aid (S-FUT-05, S-FUT-08): the nearest distance in each zone around the bumper, and a beep that says it."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rangecam.errors import UsageError
from rangecam.settings import NonNegative, Positive, settings
from rangecam.types import Frame


@settings
class Parking:
    """Zones and beeps. For reversing the camera looks back, and x counts backwards from it."""

    bumper_x_m: float = 0.0
    """x of the outermost point of the vehicle, in the axes of the frame."""
    edges_m: tuple[float, ...] = (0.9, 0.3, -0.3, -0.9)
    """y of the borders between zones, from left to right; the first and the last are where the car ends."""
    near_m: NonNegative = 0.3
    """Nearer than this the beep does not pause: stop."""
    far_m: Positive = 1.5
    """Farther than this there is none."""
    slowest_s: Positive = 0.8
    """Pause between beeps at the far end; it shrinks in proportion to the distance."""


class Aid(NamedTuple):
    """What a parking aid says.

    distances_m: in each zone from left to right, inf where nothing is. nearest_m: of all. pause_s: between beeps, 0 for
    a beep without end and inf for none.
    """

    distances_m: tuple[float, ...]
    nearest_m: float
    pause_s: float


def park(frame: Frame, settings: Parking) -> Aid:
    """Return what a parking aid says of one frame: it needs no history, and takes every segment, confirmed or not.

    Raises UsageError if the zones do not go from left to right, or do not end farther than they begin.
    """
    edges = settings.edges_m
    if len(edges) < 2 or any(a <= b for a, b in pairwise(edges)):
        raise UsageError(f"edges_m = {list(edges)}: expected two or more, from left (positive) to right")
    if settings.near_m >= settings.far_m:
        raise UsageError(f"near_m = {settings.near_m:g} must be less than far_m = {settings.far_m:g}")
    nearest, half = frame.segments.nearest_m, frame.segments.size_m[:, 1] / 2
    y, away_m = frame.segments.position_m[:, 1], np.maximum(nearest[:, 0] - settings.bumper_x_m, 0.0)
    zones = []
    for left, right in pairwise(edges):
        reaches = (y - half < left) & (y + half > right)
        zones.append(float(np.min(away_m[reaches], initial=math.inf)))
    least = min(zones)
    share = (least - settings.near_m) / (settings.far_m - settings.near_m)
    pause_s = math.inf if least > settings.far_m else max(0.0, share) * settings.slowest_s
    return Aid(tuple(zones), least, pause_s)
