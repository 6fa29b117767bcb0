"""Cameras that compute the range themselves: their images enter the chain here, with a noise model."""

from collections.abc import Callable, Mapping
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from rangecam.errors import DataError
from rangecam.geometry import Lens, rays
from rangecam.scene.view import View
from rangecam.settings import NonNegative, NonNegativeInt, Positive, PositiveInt, settings
from rangecam.types import Floats, Image, Ints, RangeImage, RawFrame, Why


@settings
class ProcessedCamera:
    """A camera whose raw frame is a range or depth image."""

    kind: Literal["processed"] = "processed"
    name: str = "generic"
    rows: PositiveInt = 120
    columns: PositiveInt = 160
    frame_rate_hz: Positive = 30.0
    lens: Lens = Lens()
    measures: Literal["as_named", "range", "depth"] = "as_named"
    """What the values are: `range_m` radial and `depth_m` along the optical axis as the planes are named, or the one
    or the other whatever the name."""
    noise_floor_m: Positive = 0.005
    """Standard deviation of the range at close range."""
    noise_relative: NonNegative = 0.01
    """Standard deviation that grows with the range, as a fraction of it."""
    noise_amplitude_m: NonNegative = 0.0
    """Standard deviation at amplitude 1; falls with the amplitude. Needs a plane `amplitude`."""
    min_range_m: NonNegative = 0.0
    max_range_m: Positive = 100.0
    min_amplitude: NonNegative = 0.0
    """Weaker pixels are LOW_AMPLITUDE."""
    valid_status: tuple[int, ...] = ()
    """Codes of a plane `status` that mean a good range; none listed: the plane is ignored."""
    valid_targets: NonNegativeInt = 0
    """Number of targets that a pixel of a plane `targets` must see; 0: any."""
    min_confidence: float | None = None
    """Smallest good value of a plane `confidence`."""
    max_confidence: float | None = None
    """Largest good value of a plane `confidence`, for cameras where a small one is good."""
    invalid_confidence_bits: Annotated[int, Interval(ge=0, le=0xFFFFFFFF)] = 0
    """Bits of a plane `confidence` any of which makes the pixel invalid, for cameras that report flags there."""
    mixing: Literal["mean", "nearest"] = "mean"
    """What a simulated pixel reads where it sees two surfaces: the mean weighted with their light, or the nearest."""
    amplitude_at_1m: Positive = 1000.0
    """Amplitude of a simulated white surface at 1 m, seen squarely."""


def processed(raw: RawFrame, camera: ProcessedCamera) -> RangeImage:
    """Take the range that the camera computed, and say how good it is and where it is none.

    raw.planes: `range_m` or `depth_m` (H, W) m; optional `amplitude`, `noise_m` (m, one sigma), `status`, `targets`,
    `confidence`. Depth becomes range along the pixel's ray. Sigma is `noise_m` where the camera gives it, else the
    noise model. Amplitude is NaN where the camera has none. Raises DataError without a range plane.
    """
    planes = raw.planes
    range_m, axis = _measured(planes, camera, raw.shape)
    amplitude = np.asarray(planes.get("amplitude", np.full(raw.shape, np.nan)), dtype=np.float32)
    sigma = planes["noise_m"] / axis if "noise_m" in planes else noise_model(range_m, amplitude, camera)
    why = np.zeros(raw.shape, np.uint8)
    with np.errstate(invalid="ignore"):  # a comparison with NaN is false, as wanted
        for reason, refused in (
            (Why.NOT_FINITE, ~np.isfinite(range_m)),
            (Why.NO_SIGNAL, range_m == 0),
            (Why.SENSOR_FLAG, _flagged(planes, camera, raw.shape)),
            (Why.SENSOR_FLAG, ~(np.isfinite(sigma) & (sigma > 0))),
            (Why.OUT_OF_RANGE, (range_m < camera.min_range_m) | (range_m > camera.max_range_m)),
            (Why.LOW_AMPLITUDE, amplitude < camera.min_amplitude),
        ):
            why[(why == Why.VALID) & refused] = reason
    range_m = np.where((why == Why.NO_SIGNAL) | (why == Why.NOT_FINITE), np.nan, range_m)
    return RangeImage(raw.time_s, range_m.astype(np.float32), sigma.astype(np.float32), amplitude, why)


def noise_model(range_m: Floats, amplitude: Floats, camera: ProcessedCamera) -> Floats:
    """Return one standard deviation of the range (m): a floor, a part of the range and a part that light makes smaller.

    Arrays of one shape; amplitude matters only where `noise_amplitude_m` is set.
    """
    variance = camera.noise_floor_m**2 + (camera.noise_relative * range_m) ** 2
    if camera.noise_amplitude_m:
        with np.errstate(divide="ignore"):
            variance = variance + (camera.noise_amplitude_m / amplitude) ** 2
    sigma: Floats = np.sqrt(variance)
    return sigma


def simulate(view: View, camera: ProcessedCamera, time_s: float, rng: np.random.Generator) -> RawFrame:
    """Return what the camera would deliver for a view: its range or depth with noise, amplitude, status and targets.

    view: (K, H, W) rays within each pixel. The light of a ray falls with the square of its range; pixels without any
    deliver 0 (no target). The inverse of `processed`.
    """
    hit = np.isfinite(view.range_m) & (view.reflectivity > 0)
    true = np.where(hit, view.range_m, 1.0)
    light = np.where(hit, view.reflectivity * view.cos_incidence / true**2, 0.0)
    total = light.sum(axis=0)
    seen = total > 0
    if camera.mixing == "mean":
        mixed = (light * true).sum(axis=0) / np.where(seen, total, 1.0)
    else:
        mixed = np.where(light > 0, true, np.inf).min(axis=0)
    amplitude = camera.amplitude_at_1m * total / len(light)
    range_m = np.where(seen, mixed, 0.0)
    sigma = np.where(seen, noise_model(range_m, np.where(seen, amplitude, 1.0), camera), 0.0)
    # a range of zero or less is what a sensor reports as no signal
    range_m = np.maximum(range_m + sigma * rng.standard_normal(range_m.shape), 0.0)
    planes: dict[str, Image] = {"amplitude": amplitude, "targets": (range_m > 0).astype(np.uint8)}
    if camera.valid_status:
        planes["status"] = np.where(range_m > 0, camera.valid_status[0], _NO_TARGET).astype(np.uint8)
    if camera.measures == "depth":
        planes["depth_m"] = range_m * rays(camera.lens, (range_m.shape[0], range_m.shape[1]))[..., 0]
    else:
        planes["range_m"] = range_m
    return RawFrame(time_s, planes)


_NO_TARGET = 255  # status of a zone without a target, as the VL53L5CX reports it


def _measured(planes: Mapping[str, Image], camera: ProcessedCamera, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return the radial range and the factor between it and the measured quantity (the cosine for depth)."""
    name = next((name for name in ("range_m", "depth_m") if name in planes), None)
    if name is None:
        raise DataError(f"no range in the frame: planes are {', '.join(planes)}; needed is range_m or depth_m")
    is_depth = (name if camera.measures == "as_named" else camera.measures).startswith("depth")
    axis = rays(camera.lens, shape)[..., 0] if is_depth else np.ones(shape)
    return planes[name] / axis, axis


def _flagged(planes: Mapping[str, Image], camera: ProcessedCamera, shape: tuple[int, int]) -> Ints:
    """Return where the sensor itself calls its pixel bad."""
    bad = np.zeros(shape, bool)
    if camera.valid_status and "status" in planes:
        bad |= ~np.isin(planes["status"], camera.valid_status)
    if camera.valid_targets and "targets" in planes:
        bad |= planes["targets"] != camera.valid_targets
    if "confidence" in planes:
        confidence = planes["confidence"]
        if camera.min_confidence is not None:
            bad |= ~(confidence >= camera.min_confidence)
        if camera.max_confidence is not None:
            bad |= ~(confidence <= camera.max_confidence)
        if camera.invalid_confidence_bits:
            bad |= (confidence.astype(np.int64) & camera.invalid_confidence_bits) != 0
    return bad


RANGING: dict[str, Callable[[RawFrame, ProcessedCamera], RangeImage]] = {"processed": processed}
