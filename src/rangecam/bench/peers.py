"""The same steps as a skilled user would write them today with OpenCV, NumPy, SciPy and FilterPy.

They are opponents, not oracles: where OpenCV has no such step (a median that knows of invalid pixels, sigma), the peer
does the nearest thing that it has, or leaves it out, which favours the peer. Imports are inside the functions, because
the peers are optional (extra `bench`).
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from rangecam.config import Config
from rangecam.geometry import position, rays, rotation
from rangecam.types import Floats, Image, Segments

Planes = Mapping[str, Image]
MARKER_M = 1e4
"""Stands for an invalid range in the peers, which know no validity."""


def opencv_cw_range(config: Config) -> Callable[[Planes], tuple[Floats, Any]]:
    """Return a function of the four phase images: cleaned range and mask, by OpenCV on whole images."""
    import cv2

    cv2.setNumThreads(1)
    camera, c = config.camera, config.clean
    assert camera.kind == "cw"
    metres_per_rad = np.float32(camera.speed_of_light_mps / (4 * math.pi * camera.modulation_hz))

    def ranging_and_cleaning(planes: Planes) -> tuple[Floats, Any]:
        c0, c90, c180, c270 = (planes[f"phase_{step}"] for step in (0, 90, 180, 270))
        real = cv2.subtract(c0, c180, dtype=cv2.CV_32F)
        imaginary = cv2.subtract(c270, c90, dtype=cv2.CV_32F)
        amplitude, phase = cv2.cartToPolar(real, imaginary)
        range_m = cv2.multiply(phase, metres_per_rad)
        amplitude = cv2.multiply(amplitude, 0.5)
        weakest, per_square, floor_m, near, far = _limits(config, range_m.shape)
        mask = cv2.compare(amplitude, weakest, cv2.CMP_GE)
        light = cv2.multiply(amplitude, cv2.multiply(range_m, range_m))
        mask = cv2.bitwise_and(mask, cv2.compare(light, per_square, cv2.CMP_GE))
        padded = cv2.copyMakeBorder(range_m, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=-MARKER_M)
        height, width = range_m.shape
        agree = np.zeros(range_m.shape, np.uint8)
        for i in range(3):
            for j in range(3):
                if (i, j) != (1, 1):
                    difference = cv2.absdiff(range_m, padded[i : i + height, j : j + width])
                    near_enough = cv2.compare(difference, c.neighbour_tolerance_m, cv2.CMP_LE)
                    agree = cv2.add(agree, cv2.min(near_enough, 1))
        mask = cv2.bitwise_and(mask, cv2.compare(agree, c.min_neighbours, cv2.CMP_GE))
        range_m[mask == 0] = MARKER_M
        range_m = cv2.medianBlur(range_m, 3)
        for limit, comparison in ((floor_m, cv2.CMP_LE), (near, cv2.CMP_GE), (far, cv2.CMP_LE)):
            mask = cv2.bitwise_and(mask, cv2.compare(range_m, limit, comparison))
        return range_m, mask

    return ranging_and_cleaning


def opencv_cw_chain(config: Config) -> Callable[[Planes], Any]:
    """Return a function of the four phase images: histogram segments with their boxes and the nearest one.

    The peer has no sigma, no covariance and no tracks.
    """
    import cv2

    clean = opencv_cw_range(config)
    bin_m, top_m = 0.05, 10.0

    def chain(planes: Planes) -> Any:
        range_m, mask = clean(planes)
        points = _points(cv2, range_m, config)
        histogram = cv2.calcHist([range_m], [0], mask, [int(top_m / bin_m)], [0, top_m]).ravel()
        smooth = np.convolve(histogram, np.ones(3) / 3, "same")
        slope = np.diff(smooth)
        minima = np.flatnonzero((slope[:-1] < 0) & (slope[1:] >= 0)) + 1
        borders = np.concatenate([[0.0], (minima + 0.5) * bin_m, [top_m]]).astype(np.float32)
        found = []
        for near, far in pairwise(borders):
            part = cv2.bitwise_and(cv2.inRange(range_m, float(near), float(far)), mask)
            if cv2.countNonZero(part) >= 10:
                found.append((cv2.mean(points, part)[:3], cv2.boundingRect(part)))
        return min((centre[0] for centre, _ in found), default=math.inf)

    return chain


def opencv_pulsed_chain(config: Config) -> Callable[[Planes], Any]:
    """Return a function of two shutter images: MDSI3, median, floor, flood-filled segments, nearest one."""
    import cv2

    cv2.setNumThreads(1)
    camera, c = config.camera, config.clean
    assert camera.kind == "pulsed"
    half_c_pulse = np.float32(camera.speed_of_light_mps * camera.pulse_width_s / 2)

    def chain(planes: Planes) -> Any:
        a, b = planes["shutter_a"], planes["shutter_b"]
        total = cv2.add(a, b)
        range_m = cv2.multiply(cv2.divide(b, total), half_c_pulse)
        mask = cv2.compare(total, 0.005, cv2.CMP_GE)
        mask = cv2.bitwise_and(mask, cv2.compare(cv2.max(a, b), 1.5, cv2.CMP_LT))
        range_m[mask == 0] = MARKER_M
        if c.median != "off":
            range_m = cv2.medianBlur(range_m, 3)
        _, _, floor_m, near, far = _limits(config, range_m.shape)
        for limit, comparison in ((floor_m, cv2.CMP_LE), (near, cv2.CMP_GE), (far, cv2.CMP_LE)):
            mask = cv2.bitwise_and(mask, cv2.compare(range_m, limit, comparison))
        points = _points(cv2, range_m, config)
        blocked = cv2.copyMakeBorder(cv2.bitwise_not(mask), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
        found = []
        inside = blocked[1:-1, 1:-1]
        label = 2
        for row, column in np.argwhere(mask):
            if inside[row, column] == 0:
                fill = 8 | (label << 8) | cv2.FLOODFILL_MASK_ONLY
                count, _, _, box = cv2.floodFill(range_m, blocked, (int(column), int(row)), 0, 0.5, 0.5, fill)
                if count >= 3:
                    found.append((cv2.mean(points, cv2.compare(inside, label, cv2.CMP_EQ))[:3], box))
                label = label + 1 if label < 254 else 2
        return min((centre[0] for centre, _ in found), default=math.inf)

    return chain


def opencv_segments(config: Config) -> Callable[[Floats, Image], Any]:
    """Return a function of range and mask (H, W): regions grown by flood fill from each free pixel."""
    import cv2

    cv2.setNumThreads(1)

    def grow(range_m: Floats, valid: Image) -> Image:
        blocked = np.pad((~valid).astype(np.uint8), 1, constant_values=1)
        inside = blocked[1:-1, 1:-1]
        label = 2
        for row, column in np.argwhere(valid):
            if inside[row, column] == 0:
                fill = 8 | (label << 8) | cv2.FLOODFILL_MASK_ONLY
                cv2.floodFill(range_m, blocked, (int(column), int(row)), 0, 0.1, 0.1, fill)
                label = label + 1 if label < 254 else 2
        return inside

    return grow


def filterpy_tracker(segments: Segments, dt_s: float) -> Callable[[], Any]:
    """Return a step of as many nine-state Kalman filters as there are segments: predict, gate, assign, update."""
    from filterpy.kalman import KalmanFilter
    from scipy.optimize import linear_sum_assignment

    transition = np.kron(np.eye(3), [[1, dt_s, dt_s**2 / 2], [0, 1, dt_s], [0, 0, 1]])
    gain = np.kron(np.eye(3), np.array([[dt_s**2 / 2], [dt_s], [1]]))
    filters = []
    for segment in segments:
        kalman = KalmanFilter(dim_x=9, dim_z=3)
        kalman.F, kalman.Q, kalman.P = transition, gain @ gain.T, np.eye(9)
        kalman.H = np.kron(np.eye(3), [[1, 0, 0]])
        kalman.x[[0, 3, 6], 0] = segment.position_m
        filters.append(kalman)

    def step() -> Any:
        for kalman in filters:
            kalman.predict()
        cost = np.empty((len(filters), len(segments)))
        for i, kalman in enumerate(filters):
            innovation = segments.position_m - (kalman.H @ kalman.x).T
            inverse = np.linalg.inv(kalman.H @ kalman.P @ kalman.H.T + segments.covariance_m2[i])
            cost[i] = np.einsum("ni,ij,nj->n", innovation, inverse, innovation)
        cost[cost > 16.27] = 1e6
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            filters[row].update(segments.position_m[column], R=segments.covariance_m2[column])

    return step


@lru_cache(maxsize=8)
def _limits(config: Config, shape: tuple[int, int]) -> tuple[Floats, ...]:
    """Return maps made once: weakest amplitude, light per square metre, floor range, beginning and end of the area."""
    c, ray = config.clean, rays(config.camera.lens, shape)
    azimuth, elevation = np.arctan2(ray[..., 1], ray[..., 0]), np.arcsin(ray[..., 2])
    falloff = (np.cos(azimuth) * np.cos(elevation)) ** c.reference_falloff
    reference = c.reference_amplitude * (c.reference_floor + (1 - c.reference_floor) * falloff)
    world = ray @ rotation(config.mounting).T
    with np.errstate(divide="ignore"):
        height = position(config.mounting)[2] - c.floor_margin_m
        floor_m = np.where(world[..., 2] < 0, height / -world[..., 2], np.inf)
    if c.floor == "off":
        floor_m = np.full(shape, np.inf)
    near, far = np.zeros(shape), np.full(shape, np.inf)
    if c.x_max_m is not None:
        far = np.minimum(far, c.x_max_m / world[..., 0])
    if c.width_m is not None:
        far = np.minimum(far, c.width_m / 2 / np.maximum(np.abs(world[..., 1]), 1e-9))
    maps = (reference * c.amplitude_threshold, reference * c.wrap_threshold / ray[..., 0] ** 2, floor_m, near, far)
    return tuple(m.astype(np.float32) for m in maps)


@lru_cache(maxsize=8)
def _parts(config: Config, shape: tuple[int, int]) -> list[Floats]:
    """Return the three components of the rays in vehicle axes: each (H, W)."""
    world = rays(config.camera.lens, shape) @ rotation(config.mounting).T
    return [np.ascontiguousarray(world[..., i], np.float32) for i in range(3)]


def _points(cv2: Any, range_m: Floats, config: Config) -> Any:
    """Return the points (H, W, 3) of a range image."""
    start, parts = position(config.mounting), _parts(config, (range_m.shape[0], range_m.shape[1]))
    return cv2.merge([cv2.add(cv2.multiply(range_m, part), float(s)) for part, s in zip(parts, start, strict=True)])
