"""Limits of each pixel that are known before the image, or fitted to it: amplitudes, floor, area of interest."""

import math
from functools import lru_cache
from itertools import combinations

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rangecam.clean.floor_image import stored_floor
from rangecam.clean.settings import CleanSettings
from rangecam.geometry import Lens, Mounting, polar, position, rays, rotation
from rangecam.types import Floats, Ints, Why

_FLOOR, _OUTSIDE_AREA = int(Why.FLOOR), int(Why.OUTSIDE_AREA)
REFUSE = 255
"""Number of neighbours needed that says: refuse this pixel, it lies at the border."""


def reference_amplitude(azimuth_rad: Floats, elevation_rad: Floats, settings: CleanSettings) -> Floats:
    """Return the amplitude of a white plane at depth 1 m at angles of any shape, in the unit of the sensor.

    10 + 135 cos^7 cos^7 with the default settings (Steinbäck 2016, A.5, N-S-028).
    """
    falloff = (np.cos(azimuth_rad) * np.cos(elevation_rad)) ** settings.reference_falloff
    floor = settings.reference_floor
    scaled: Floats = settings.reference_amplitude * (floor + (1 - floor) * falloff)
    return scaled


@lru_cache(maxsize=16)
def weakest_amplitudes(lens: Lens, shape: tuple[int, int], settings: CleanSettings) -> tuple[Floats, Floats]:
    """Return the least amplitude, and the least amplitude times squared range, of each pixel: (H, W) float32 each."""
    ray = rays(lens, shape)
    azimuth, elevation, _ = polar(ray)
    reference = reference_amplitude(azimuth, elevation, settings)
    weakest = reference * settings.amplitude_threshold  # Steinbäck 2016, eq 3.17
    # eq 3.18 holds for the depth, because the reference was taken on a plane (E-S-22): depth = range times cosine
    wrapped = reference * settings.wrap_threshold / ray[..., 0] ** 2
    return weakest.astype(np.float32), wrapped.astype(np.float32)


@lru_cache(maxsize=16)
def neighbours_needed(shape: tuple[int, int], settings: CleanSettings) -> Ints:
    """Return how many common neighbours each pixel needs: (H, W) uint8; at the border the same share of fewer."""
    there = np.zeros((shape[0] + 2, shape[1] + 2), int)
    there[1:-1, 1:-1] = 1
    around = sliding_window_view(there, (3, 3)).sum(axis=(2, 3)) - 1
    needed = -(-settings.min_neighbours * around // 8)
    if settings.discard_border:
        needed[around < 8] = REFUSE
    result: Ints = needed.astype(np.uint8)
    return result


def floor_limit(range_m: Floats, why: Ints, lens: Lens, mounting: Mounting, settings: CleanSettings) -> Floats:
    """Return the range from which on each pixel sees the floor: (H, W) float32 m, inf where it never does."""
    if settings.floor == "mounting":
        return _mounting_floor(lens, mounting, why.shape, settings.floor_margin_m)
    if settings.floor == "image":
        return stored_floor(settings.floor_file, lens, mounting, why.shape, settings.floor_margin_m)
    if settings.floor == "fit":
        plane = fit_floor(range_m, why, lens)
        up = rotation(mounting).T @ np.array([0.0, 0.0, -1.0])
        size = float(np.linalg.norm(plane))
        if size > 0 and plane @ up >= size * math.cos(math.radians(settings.floor_max_tilt_deg)):
            return _limit(rays(lens, why.shape) @ plane, settings.floor_margin_m * size)
    return _never(why.shape)


@lru_cache(maxsize=16)
def _mounting_floor(lens: Lens, mounting: Mounting, shape: tuple[int, int], margin_m: float) -> Floats:
    """Return the floor limit where the mounting knows the floor (König 2008, 6.3, "calculatively derived")."""
    down = -(rays(lens, shape) @ rotation(mounting)[2])
    if mounting.z_m <= 0:
        return _never(shape)
    return _limit(down / mounting.z_m, margin_m / mounting.z_m)


def _limit(inverse: Floats, margin: float) -> Floats:
    """Return the range at which rays that meet a plane at 1/inverse come closer to it than a share of its distance."""
    with np.errstate(divide="ignore"):
        return np.where(inverse > 0, (1 - margin) / inverse, np.inf).astype(np.float32)


@lru_cache(maxsize=16)
def _never(shape: tuple[int, int]) -> Floats:
    return np.full(shape, np.inf, np.float32)


def fit_floor(range_m: Floats, why: Ints, lens: Lens) -> Floats:
    """Return the plane that most of the image lies on and nothing behind: (3,) 1/m in camera axes, zeros if none.

    The vector m points at the plane, 1/norm(m) is its distance, and 1/range = m . ray for a pixel that sees it. Every
    three of a dozen parts of the image propose the plane through their medians; the cheapest proposal is refined by
    least squares over the pixels near it. Deterministic; up to half of the pixels may see something nearer.
    """
    seen = np.flatnonzero((why.ravel() == 0) & (range_m.ravel() > 0))
    chosen = seen[:: max(1, len(seen) // _FIT_PIXELS)]
    ray = rays(lens, why.shape).reshape(-1, 3)[chosen]
    inverse = 1 / range_m.ravel()[chosen].astype(float)
    proposals = _proposed_planes(ray, inverse, chosen, why.shape)
    if len(proposals) == 0:
        return np.zeros(3)
    band = _FIT_BAND * np.median(inverse)
    nearer = inverse - proposals @ ray.T
    cost = np.where(nearer < -band, _FIT_BEHIND * band, np.minimum(np.abs(nearer), band)).sum(axis=1)
    plane: Floats = proposals[np.argmin(cost)]
    for _ in range(3):
        near = np.abs(inverse - ray @ plane) < band
        plane = np.linalg.lstsq(ray[near], inverse[near], rcond=None)[0]
    return plane


_FIT_PIXELS, _FIT_PARTS, _FIT_LEAST = 300, (3, 4), 4
_FIT_BAND = 0.1  # of the distance, as near to a plane as a pixel that may belong to it
_FIT_BEHIND = 3.0  # a pixel behind a plane says more against it than one before it


def _proposed_planes(ray: Floats, inverse: Floats, pixels: Ints, shape: tuple[int, int]) -> Floats:
    """Return the planes (M, 3) through the median 1/range of each three parts of the image that see enough."""
    rows, columns = np.unravel_index(pixels, shape)
    part = rows * _FIT_PARTS[0] // shape[0] * _FIT_PARTS[1] + columns * _FIT_PARTS[1] // shape[1]
    members = [np.flatnonzero(part == k) for k in range(_FIT_PARTS[0] * _FIT_PARTS[1])]
    members = [inside for inside in members if len(inside) >= _FIT_LEAST]
    triples = np.array(list(combinations(range(len(members)), 3)), int).reshape(-1, 3)
    if len(triples) == 0:
        return np.empty((0, 3))
    # per part, 1/range over the mean ray; the median stands for the part as a whole
    directions = np.stack([ray[inside].mean(axis=0) for inside in members])[triples]
    medians = np.array([np.median(inverse[inside]) for inside in members])[triples]
    apart = np.abs(np.linalg.det(directions)) > _FIT_LINE
    planes: Floats = np.linalg.solve(directions[apart], medians[apart][..., None])[..., 0]
    return planes


_FIT_LINE = 1e-4  # volume that three directions must span, else they lie in one line of the image


@lru_cache(maxsize=16)
def area_of_interest(
    lens: Lens, mounting: Mounting, shape: tuple[int, int], settings: CleanSettings
) -> tuple[Floats, Floats]:
    """Return the range at which each ray enters the area of interest and leaves it: (H, W) float32 m each.

    The box of Steinbäck 2016, eqs 3.19-3.20 (E-S-05) as limits of range for each pixel; a ray that misses it has its
    entry behind its exit.
    """
    half = None if settings.width_m is None else settings.width_m / 2
    lower = (settings.x_min_m, None if half is None else -half, settings.z_min_m)
    upper = (settings.x_max_m, half, settings.z_max_m)
    ray, centre = rays(lens, shape) @ rotation(mounting).T, position(mounting)
    near, far = np.zeros(shape), np.full(shape, np.inf)
    for axis in range(3):
        low = -np.inf if lower[axis] is None else lower[axis] - centre[axis]
        high = np.inf if upper[axis] is None else upper[axis] - centre[axis]
        along = ray[..., axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            first = np.where(along > 0, low, high) / along
            last = np.where(along > 0, high, low) / along
        inside = low <= 0 <= high
        level = along == 0  # stays on its plane: within the limits for ever, or never
        near = np.maximum(near, np.where(level, 0.0 if inside else np.inf, first))
        far = np.minimum(far, np.where(level, np.inf if inside else 0.0, last))
    return near.astype(np.float32), far.astype(np.float32)


def cut(
    range_m: Floats, sigma_m: Floats, why: Ints, limits: tuple[Floats, Floats, Floats], settings: CleanSettings
) -> NDArray[np.uint8]:
    """Return why (H, W) uint8 with the pixels that see the floor or lie outside the area of interest refused too.

    limits: the range at which each pixel meets the floor, enters and leaves the area.
    """
    reason = np.empty(why.shape, np.uint8)
    _cut(range_m, sigma_m, why, limits, settings.floor_margin_sigmas, reason)
    return reason


@njit(cache=True, nogil=True)
def _cut(
    range_m: Floats, sigma_m: Floats, why: Ints, limits: tuple[Floats, Floats, Floats], sigmas: float, reason: Ints
) -> None:
    floor, near, far = limits
    factor = np.float32(sigmas)
    for y in range(range_m.shape[0]):
        for x in range(range_m.shape[1]):
            value = range_m[y, x]
            first = 0 if (value >= near[y, x]) & (value <= far[y, x]) else _OUTSIDE_AREA
            first = _FLOOR if value + factor * sigma_m[y, x] > floor[y, x] else first
            reason[y, x] = why[y, x] if why[y, x] != 0 else first
