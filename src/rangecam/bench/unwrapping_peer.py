"""Several modulation frequencies as a skilled user would decode them today with OpenCV and NumPy, on whole images."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rangecam.config import Config
from rangecam.types import Floats, Image

Planes = Mapping[str, Image]


def opencv_multi_frequency(config: Config) -> Callable[[Planes], Floats]:
    """Return a function of the planes of three frequencies: range (H, W), NaN where it is refused, by OpenCV and NumPy.

    Phasors, filtered jointly by the distance of the unit phasors, every wrap of the anchor with rounding of the others,
    residual and runner-up, and pixels between two surfaces; on whole images.
    """
    import cv2

    cv2.setNumThreads(1)
    camera = config.camera
    assert camera.kind == "cw"
    modulations = camera.modulations_hz
    anchor = min(f for f in modulations if max(modulations) <= 2 * f)
    ordered = sorted(modulations, key=lambda f: f != anchor)
    steps = np.radians(camera.phase_steps_deg)
    weights = 2 / len(steps) * np.array([np.cos(steps), -np.sin(steps)])  # the steps are equally spaced
    names = [[f"f{modulations.index(f)}_phase_{step:g}" for step in camera.phase_steps_deg] for f in ordered]
    ratios, step_m = [f / anchor for f in ordered], camera.speed_of_light_mps / (2 * anchor)
    unambiguous_m = camera.speed_of_light_mps / (2 * math.gcd(*(round(f) for f in modulations)))
    candidates = math.ceil(min(camera.unwrap_to_m or unambiguous_m, unambiguous_m) / step_m)
    sigma_lsb = math.sqrt((camera.read_noise_lsb**2 + camera.quantisation_lsb**2 / 12) * float(weights[0] @ weights[0]))
    lead = 2 * math.log(1 / camera.unwrap_error)

    def decode(planes: Planes) -> Floats:
        phasors = [_phasor(cv2, [planes[name] for name in group], weights) for group in names]
        sizes = [cv2.magnitude(real, imaginary) for real, imaginary in phasors]
        units = [(cv2.divide(p[0], a), cv2.divide(p[1], a)) for p, a in zip(phasors, sizes, strict=True)]
        noise = sum(cv2.pow(cv2.divide(sigma_lsb, a), 2.0) for a in sizes)
        if camera.phasor_filter == "3x3":
            phasors, noises = _joint_filter(cv2, phasors, units, noise, sizes, sigma_lsb, camera.phasor_filter_sigmas)
        else:
            noises = [cv2.divide(sigma_lsb, a) for a in sizes]
        turns = [cv2.multiply(cv2.phase(real, imaginary), 0.5 / math.pi) for real, imaginary in phasors]
        certain = [cv2.pow(cv2.divide(2 * math.pi, s), 2.0) for s in noises]
        place, best, second = _likeliest(turns, certain, ratios, candidates)
        range_m = cv2.multiply(place, step_m)
        sound = (best < camera.unwrap_residual_sigmas**2) & (second - best > lead)
        return np.where(sound & ~_flies(cv2, range_m), range_m, np.float32(np.nan))

    return decode


def _phasor(cv2: Any, samples: list[Image], weights: Floats) -> tuple[Floats, Floats]:
    """Return Re and Im (H, W) float32 of one frequency."""
    parts = [np.zeros(samples[0].shape, np.float32) for _ in range(2)]
    for row, part in zip(weights.tolist(), parts, strict=True):
        for weight, sample in zip(row, samples, strict=True):
            cv2.addWeighted(part, 1.0, sample, weight, 0.0, dst=part, dtype=cv2.CV_32F)
    return parts[0], parts[1]


def _joint_filter(
    cv2: Any, phasors: Any, units: Any, noise: Floats, sizes: Any, sigma_lsb: float, sigmas: float
) -> tuple[Any, Any]:
    """Return the phasors averaged over the neighbours that are near at all frequencies together, and phase noises."""
    height, width = noise.shape

    def framed(image: Floats, value: float = 0.0) -> Floats:
        bordered: Floats = cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=value)
        return bordered

    rims = [(framed(p[0]), framed(p[1]), framed(u[0]), framed(u[1])) for p, u in zip(phasors, units, strict=True)]
    noise_rim, count = framed(noise, -1e9), np.zeros(noise.shape, np.float32)
    sums = [(np.zeros_like(noise), np.zeros_like(noise)) for _ in phasors]
    for i in range(3):
        for j in range(3):
            near = (slice(i, i + height), slice(j, j + width))
            distance = np.zeros_like(noise)
            for unit, rim in zip(units, rims, strict=True):
                for here, there in zip(unit, rim[2:], strict=True):
                    difference = cv2.subtract(here, there[near])
                    cv2.accumulateSquare(difference, distance)
            allowed = cv2.multiply(cv2.add(noise, noise_rim[near]), sigmas**2)
            take = cv2.compare(distance, allowed, cv2.CMP_LE)
            count = cv2.add(count, cv2.multiply(take, 1 / 255, dtype=cv2.CV_32F))
            for (real, imaginary), rim in zip(sums, rims, strict=True):
                cv2.accumulate(rim[0][near], real, mask=take)
                cv2.accumulate(rim[1][near], imaginary, mask=take)
    root = cv2.sqrt(count)
    noises = [cv2.divide(cv2.multiply(root, sigma_lsb), cv2.magnitude(*each)) for each in sums]
    return sums, noises


def _likeliest(turns: Any, certain: Any, ratios: list[float], wraps: int) -> tuple[Floats, Floats, Floats]:
    """Return the range in turns of the anchor, its squared residual and that of the runner-up (H, W), with NumPy."""
    shape = turns[0].shape
    best, second = np.full(shape, np.inf, np.float32), np.full(shape, np.inf, np.float32)
    place = np.zeros(shape, np.float32)
    precision = sum(np.float32(q * q) * w for q, w in zip(ratios, certain, strict=True))
    for candidate in range(wraps):
        anchor = turns[0] + np.float32(candidate)
        slope, square = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        for u, w, q in zip(turns[1:], certain[1:], ratios[1:], strict=True):
            error = np.float32(q) * anchor - u
            error -= np.rint(error)
            weighted = w * error
            slope += np.float32(q) * weighted
            square += weighted * error
        offset = slope / precision
        cost = square - slope * offset
        better = cost < best
        np.minimum(second, np.maximum(cost, best), out=second)
        np.minimum(best, cost, out=best)
        np.copyto(place, anchor - offset, where=better)
    return place, best, second


def _flies(cv2: Any, range_m: Floats) -> Image:
    """Return which pixels lie between both neighbours of a row or column, 5 cm and more from each (H, W) bool."""
    rim = cv2.copyMakeBorder(range_m, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    left, right = cv2.subtract(range_m, rim[1:-1, :-2]), cv2.subtract(rim[1:-1, 2:], range_m)
    above, below = cv2.subtract(range_m, rim[:-2, 1:-1]), cv2.subtract(rim[2:, 1:-1], range_m)
    across = (cv2.min(left, right) > 0.05) | (cv2.max(left, right) < -0.05)
    between: Image = across | (cv2.min(above, below) > 0.05) | (cv2.max(above, below) < -0.05)
    return between
