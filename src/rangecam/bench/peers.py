"""The same steps as a skilled user would write them today with OpenCV, NumPy, SciPy and FilterPy.

They are opponents, not oracles: where OpenCV has no such step (a median that knows of invalid pixels, sigma), the peer
does the nearest thing that it has, or leaves it out, which favours the peer. Imports are inside the functions, because
the peers are optional (extra `bench`).
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any

import numpy as np

from rangecam.config import Config
from rangecam.geometry import position, rays, rotation
from rangecam.motion import MOTION, MotionSettings, mode_switching
from rangecam.types import Floats, Image, Segments, Why

Planes = Mapping[str, Image]
Cleaned = tuple[Floats, Floats, Any, Any]
"""Range, sigma, mask of the valid pixels and the reason of each invalid one (H, W)."""
MARKER = 1e4
"""Stands for an invalid range in the peers, which know no validity."""


def opencv_cw_range(config: Config) -> Callable[[Planes], Cleaned]:
    """Return a function of the four phase images: cleaned range, sigma and mask, by OpenCV on whole images."""
    import cv2

    cv2.setNumThreads(1)
    camera = config.camera
    assert camera.kind == "cw"
    metres_per_rad = camera.speed_of_light_mps / (4 * math.pi * camera.modulation_hz)
    floor_variance = camera.read_noise_lsb**2 / camera.binning**2 + camera.quantisation_lsb**2 / 12
    shot = camera.shot_noise_lsb2_per_lsb / camera.binning**2 / camera.demodulation_contrast
    low, high = camera.lower_limit_lsb or -MARKER, camera.full_scale_lsb or MARKER

    def range_of(planes: Planes) -> Cleaned:
        c0, c90, c180, c270 = (planes[f"phase_{step}"] for step in (0, 90, 180, 270))
        real = cv2.subtract(c0, c180, dtype=cv2.CV_32F)
        imaginary = cv2.subtract(c270, c90, dtype=cv2.CV_32F)
        amplitude, phase = cv2.cartToPolar(real, imaginary)
        range_m = cv2.multiply(phase, metres_per_rad)
        amplitude = cv2.multiply(amplitude, 0.5)
        variance = cv2.add(cv2.multiply(amplitude, shot), floor_variance)
        sigma = cv2.divide(cv2.sqrt(variance), amplitude, scale=metres_per_rad / math.sqrt(2))
        brightest = cv2.max(cv2.max(c0, c90), cv2.max(c180, c270))
        darkest = cv2.min(cv2.min(c0, c90), cv2.min(c180, c270))
        quiet = cv2.compare(sigma, metres_per_rad * camera.max_phase_sigma_rad, cv2.CMP_LE)
        kept = _start(cv2, cv2.compare(brightest, darkest, cv2.CMP_NE), Why.NO_SIGNAL)
        kept = _refuse(cv2, kept, cv2.compare(brightest, high, cv2.CMP_LT), Why.SATURATED)
        kept = _refuse(cv2, kept, cv2.compare(darkest, low, cv2.CMP_GT), Why.SATURATED)
        kept = _refuse(cv2, kept, quiet, Why.LOW_AMPLITUDE)
        return _cleaned(cv2, config, range_m, sigma, amplitude, kept)

    return range_of


def opencv_cw_chain(config: Config) -> Callable[[Planes], float]:
    """Return a function of the four phase images: histogram segments, tracked, and the free way to the nearest."""
    import cv2

    clean, track = opencv_cw_range(config), _Tracker(1 / config.camera.frame_rate_hz, config.tracking.motion)
    bin_m, top_m = config.segments.bin_width_m, 10.0
    smoothing = np.ones(config.segments.smoothing_bins) / config.segments.smoothing_bins

    def chain(planes: Planes) -> float:
        range_m, sigma, mask, _ = clean(planes)
        points = _points(cv2, range_m, config)
        depth = cv2.extractChannel(points, 0)
        histogram = cv2.calcHist([depth], [0], mask, [int(top_m / bin_m)], [0, top_m]).ravel()
        slope = np.diff(np.convolve(histogram, smoothing, "same"))
        minima = np.flatnonzero((slope[:-1] < 0) & (slope[1:] >= 0)) + 1
        borders = [0.0, *((minima + 0.5) * bin_m).tolist(), top_m]
        parts = [cv2.bitwise_and(cv2.inRange(depth, near, far), mask) for near, far in pairwise(borders)]
        return track(_measured(cv2, points, sigma, parts, config.segments.min_pixels))

    return chain


def opencv_pulsed_chain(config: Config) -> Callable[[Planes], float]:
    """Return a function of two shutter images: MDSI3, cleaned, flood-filled segments, tracked, nearest one."""
    import cv2

    cv2.setNumThreads(1)
    camera = config.camera
    assert camera.kind == "pulsed"
    pixel = camera.pixel
    half_c_pulse = camera.speed_of_light_mps * camera.pulse_width_s / 2
    grow, track = _flood_filled(config), _Tracker(1 / camera.frame_rate_hz, config.tracking.motion)

    def chain(planes: Planes) -> float:
        a, b, n_acc = planes["shutter_a"], planes["shutter_b"], planes["n_acc"]
        total = cv2.add(a, b)
        range_m = cv2.multiply(cv2.divide(b, total), half_c_pulse)
        damped = (1 - np.exp(-pixel.damping * n_acc)) / (1 - math.exp(-pixel.damping)) / n_acc  # König 2008, eq 4.17
        variance = n_acc * pixel.sensor_noise_v**2 + pixel.readout_noise_v**2  # eq 4.21
        noise = (np.sqrt(variance) * damped).astype(np.float32)
        sigma = cv2.divide(cv2.multiply(cv2.magnitude(a, b), noise), cv2.multiply(total, total), scale=half_c_pulse)
        kept = _start(cv2, cv2.compare(n_acc, 0, cv2.CMP_GT), Why.NO_SIGNAL)
        kept = _refuse(cv2, kept, cv2.compare(cv2.max(a, b), pixel.saturation_v, cv2.CMP_LT), Why.SATURATED)
        kept = _refuse(
            cv2, kept, cv2.compare(total, cv2.multiply(noise, camera.min_snr), cv2.CMP_GE), Why.LOW_AMPLITUDE
        )
        kept = _refuse(cv2, kept, cv2.inRange(range_m, camera.min_range_m, camera.max_range_m), Why.OUT_OF_RANGE)
        range_m, sigma, mask, _ = _cleaned(cv2, config, range_m, sigma, total, kept)
        points = _points(cv2, range_m, config)
        inside = grow(range_m, mask)
        parts = [cv2.compare(inside, label, cv2.CMP_EQ) for label in range(2, int(inside.max()) + 1)]
        return track(_measured(cv2, points, sigma, parts, config.segments.min_pixels))

    return chain


def skimage_segments(config: Config) -> Callable[[Floats, Image], Image]:
    """Return a function of range and valid (H, W): regions grown by scikit-image's flood from each free pixel."""
    from skimage.segmentation import flood

    step = config.segments.growing_threshold_m

    def grow(range_m: Floats, valid: Image) -> Image:
        ranges = np.where(valid, range_m, MARKER)
        labels = np.zeros(valid.shape, np.int32)
        label = 0
        while True:
            free = valid & (labels == 0)
            seed = divmod(int(np.argmax(free)), valid.shape[1])
            if not free[seed]:
                return labels
            label += 1
            labels[flood(ranges, seed, connectivity=2, tolerance=step) & free] = label

    return grow


def _flood_filled(config: Config) -> Callable[[Floats, Image], Image]:
    """Return a function of range and mask (H, W): regions grown by flood fill, labelled from 2."""
    import cv2

    step = config.segments.growing_threshold_m

    def grow(range_m: Floats, mask: Image) -> Image:
        blocked: Image = cv2.copyMakeBorder(cv2.compare(mask, 0, cv2.CMP_EQ), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
        inside: Image = blocked[1:-1, 1:-1]
        inside[inside == 255] = 1
        label = 2
        while label < 255:
            free = int(np.argmin(inside))
            row, column = divmod(free, inside.shape[1])
            if inside[row, column] != 0:
                break
            fill = 8 | (label << 8) | cv2.FLOODFILL_MASK_ONLY
            cv2.floodFill(range_m, blocked, (column, row), 0, step, step, fill)
            label += 1
        inside[inside == 1] = 0
        return inside

    return grow


def filterpy_tracker(segments: Segments, dt_s: float, motion: MotionSettings) -> Callable[[], float]:
    """Return a step of as many nine-state filters as there are segments: predict, gate, assign, update.

    Kalman filters, or interacting multiple models where `motion` has modes.
    """
    track = _Tracker(dt_s, motion)
    found = [(s.position_m, s.covariance_m2) for s in segments]
    track(found)
    return partial(track, found)


class _Tracker:
    """Nine-state filters of FilterPy, SciPy's assignment, and the free way to the nearest object."""

    def __init__(self, dt_s: float, motion: MotionSettings) -> None:
        from filterpy.kalman import IMMEstimator, KalmanFilter
        from scipy.optimize import linear_sum_assignment

        self._new, self._interacting, self._assign = KalmanFilter, IMMEstimator, linear_sum_assignment
        self._filters = list[Any]()
        modes = motion.modes or (motion,)
        self._models = [[np.kron(np.eye(3), block) for block in MOTION[mode.model](dt_s, mode)] for mode in modes]
        self._switching = mode_switching(dt_s, len(modes), motion.mode_memory_s)

    def __call__(self, found: list[tuple[Floats, Floats]]) -> float:
        for kalman in self._filters:
            kalman.predict()
        cost = self._distances(found)
        cost[cost > 16.27] = 1e6
        rows, columns = self._assign(cost)
        taken = set()
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
            if cost[i, j] < 1e6:
                for each in getattr(self._filters[i], "filters", [self._filters[i]]):
                    each.R = found[j][1]
                self._filters[i].update(found[j][0])
                taken.add(j)
        for j in set(range(len(found))) - taken:
            if len(self._filters) < 20:
                self._filters.append(self._born(*found[j]))
        return min((float(kalman.x[0, 0]) for kalman in self._filters), default=math.inf)

    def _distances(self, found: list[tuple[Floats, Floats]]) -> Floats:
        """Return the squared Mahalanobis distance of every filter and measurement, on whole arrays."""
        if not (self._filters and found):
            return np.empty((len(self._filters), len(found)))
        expected = np.array([kalman.x[::3, 0] for kalman in self._filters])
        spread = np.array([kalman.P[::3, ::3] for kalman in self._filters])
        innovation = np.array([place for place, _ in found])[None] - expected[:, None]
        scatter = spread[:, None] + np.array([covariance for _, covariance in found])[None]
        squared: Floats = np.einsum("ijk,ijk->ij", innovation, np.linalg.solve(scatter, innovation[..., None])[..., 0])
        return squared

    def _born(self, place: Floats, covariance: Floats) -> Any:
        modes = []
        for transition, noise in self._models:
            kalman = self._new(dim_x=9, dim_z=3)
            kalman.F, kalman.Q, kalman.P = transition, noise, np.eye(9)
            kalman.H = np.kron(np.eye(3), [[1, 0, 0]])
            kalman.x[[0, 3, 6], 0] = place
            modes.append(kalman)
        share = np.full(len(modes), 1 / len(modes))
        return modes[0] if len(modes) == 1 else self._interacting(modes, share, self._switching)


def _start(cv2: Any, passed: Any, reason: Why) -> tuple[Any, Any]:
    """Return mask and reasons after the first test."""
    return passed, cv2.bitwise_and(cv2.bitwise_not(passed), int(reason))


def _refuse(cv2: Any, kept: tuple[Any, Any], passed: Any, reason: Why) -> tuple[Any, Any]:
    """Return mask and reasons after one more test: the first reason stays."""
    mask, why = kept
    failed = cv2.bitwise_and(cv2.bitwise_not(passed), mask)
    return cv2.bitwise_and(mask, passed), cv2.bitwise_or(why, cv2.bitwise_and(failed, int(reason)))


def _cleaned(
    cv2: Any, config: Config, range_m: Floats, sigma: Floats, amplitude: Floats, kept: tuple[Any, Any]
) -> Cleaned:
    """Thresholds, common neighbours, median, floor and area of interest; sigma, mask and reasons kept.

    OpenCV has no median that knows of invalid pixels: the mean of two, with the invalid ones far and near, is the best
    that it offers. The sigma of a median of n is taken as 1.25 sigma / sqrt(n).
    """
    c = config.clean
    weakest, per_square, floor_m, near, far = _limits(config, (range_m.shape[0], range_m.shape[1]))
    kept = _refuse(cv2, kept, cv2.compare(amplitude, weakest, cv2.CMP_GE), Why.LOW_AMPLITUDE)
    light = cv2.multiply(amplitude, cv2.multiply(range_m, range_m))
    kept = _refuse(cv2, kept, cv2.compare(light, per_square, cv2.CMP_GE), Why.WRAPPED)
    mask = kept[0]
    reach = cv2.add(cv2.multiply(sigma, c.neighbour_tolerance_sigmas / math.sqrt(2)), c.neighbour_tolerance_m / 2)
    outside = cv2.bitwise_not(mask)
    range_m[outside > 0] = MARKER
    ranges = cv2.copyMakeBorder(range_m, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=MARKER)
    reaches = cv2.copyMakeBorder(reach, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0.0)
    height, width = range_m.shape
    agree = np.zeros((height, width), np.uint8)
    for i in range(3):
        for j in range(3):
            if (i, j) != (1, 1):
                difference = cv2.absdiff(range_m, ranges[i : i + height, j : j + width])
                allowed = cv2.add(reach, reaches[i : i + height, j : j + width])
                agree = cv2.add(agree, cv2.bitwise_and(cv2.compare(difference, allowed, cv2.CMP_LE), 1))
    kept = _refuse(cv2, kept, cv2.compare(agree, c.min_neighbours, cv2.CMP_GE), Why.ISOLATED)
    mask = kept[0]
    if c.filter != "off":
        outside = cv2.bitwise_not(mask) > 0
        range_m[outside] = MARKER
        upper = cv2.medianBlur(range_m, 3)
        range_m[outside] = -MARKER
        lower = cv2.medianBlur(range_m, 3)
        known = cv2.bitwise_and(cv2.compare(upper, MARKER, cv2.CMP_LT), cv2.compare(lower, -MARKER, cv2.CMP_GT))
        range_m = cv2.copyTo(cv2.addWeighted(upper, 0.5, lower, 0.5, 0.0), known, range_m)
        number = cv2.boxFilter(cv2.min(mask, 1), cv2.CV_32F, (3, 3), normalize=False)
        sigma = cv2.divide(sigma, cv2.sqrt(number), scale=1.25)
    top = cv2.add(range_m, cv2.multiply(sigma, c.floor_margin_sigmas))
    kept = _refuse(cv2, kept, cv2.compare(top, floor_m, cv2.CMP_LE), Why.FLOOR)
    inside = cv2.bitwise_and(cv2.compare(range_m, near, cv2.CMP_GE), cv2.compare(range_m, far, cv2.CMP_LE))
    return range_m, sigma, *_refuse(cv2, kept, inside, Why.OUTSIDE_AREA)


def _measured(cv2: Any, points: Any, sigma: Floats, parts: list[Any], min_pixels: int) -> list[tuple[Floats, Floats]]:
    """Return position and covariance of each part of the image that is large enough; its box and extent as well."""
    found = []
    for part in parts:
        number = cv2.countNonZero(part)
        if number >= min_pixels:
            centre, spread = cv2.meanStdDev(points, mask=part)
            cv2.boundingRect(part)
            noise = cv2.mean(sigma, part)[0] ** 2 / number
            found.append((centre[:, 0], np.diag(noise + (0.1 * spread[:, 0]) ** 2 + 1e-4)))
    return found


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
    if c.x_min_m is not None:
        near = c.x_min_m / world[..., 0]
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
