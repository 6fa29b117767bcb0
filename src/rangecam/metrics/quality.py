"""A run of the chain against the truth of its simulation: scores, errors and honesty in one dict."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from rangecam.config import Config
from rangecam.geometry import to_world
from rangecam.metrics.consistency import chi_square_bounds, nees, rmse
from rangecam.metrics.scores import Moment, clear_mot, gospa, hota, moment
from rangecam.types import VELOCITY, Capture, Floats, Frame, RangeImage, TrackStatus, Why

LIMIT_M = 1.0
"""A track farther from an object than this is not one of it, unless asked otherwise."""
MIN_PIXELS = 3
"""An object counts as there while so many valid pixels look at it, unless asked otherwise."""


class Scored(NamedTuple):
    """A frame against the truth: who was where, and velocities and their covariances of all pairs of both.

    velocity_error_mps (n, m, 3): of track j if it follows object i; velocity_covariance (m, 3, 3).
    """

    moment: Moment
    velocity_error_mps: Floats
    velocity_covariance: Floats


def quality(
    captures: Iterable[Capture],
    frames: Iterable[Frame],
    config: Config,
    limit_m: float = LIMIT_M,
    min_pixels: int = MIN_PIXELS,
) -> dict[str, Any] | None:
    """Return how well the tracks of `frames` follow the objects of `captures`, None where no truth is known.

    `scored` says who counts. Keys: see `quality_of`.
    """
    pairs = zip(captures, frames, strict=True)
    steps = [step for pair in pairs if (step := scored(*pair, config, min_pixels)) is not None]
    return quality_of(steps, limit_m) if steps else None


def scored(capture: Capture, frame: Frame, config: Config, min_pixels: int = MIN_PIXELS) -> Scored | None:
    """Return one frame against its truth, None where none is known.

    An object is there while at least `min_pixels` valid pixels look at it: what the camera could not measure, or what
    cleaning took away on purpose (floor, outside of the area of interest), is nobody's miss. It is where the mean of
    the points is that these pixels truly see, because a camera measures the surface and not the middle of a body. The
    confirmed tracks count, also while they coast; places are compared from above (x, y).
    """
    truth = capture.truth
    if truth is None:
        return None
    image = RangeImage(frame.image.time_s, truth.range_m, frame.image.sigma_m, frame.image.amplitude, frame.image.why)
    points = to_world(image, config.camera.lens, config.mounting)
    usable = (frame.image.why == Why.VALID) & np.isfinite(truth.range_m)
    seen = [usable & (truth.object_id == k + 1) for k in range(len(truth.names))]
    present = [k for k, pixels in enumerate(seen) if pixels.sum() >= min_pixels]
    places = np.array([points[seen[k]].mean(axis=0)[:2] for k in present]).reshape(-1, 2)
    tracks = frame.tracks
    own = np.flatnonzero(tracks.status != TrackStatus.TENTATIVE)
    state, velocity = tracks.state[own], np.array(VELOCITY)
    return Scored(
        moment(present, places, tracks.track_id[own], state[:, [0, 3]]),
        state[None, :, VELOCITY] - truth.velocities_mps[present].reshape(-1, 1, 3),
        tracks.covariance[own][:, velocity[:, None], velocity],
    )


def quality_of(steps: Sequence[Scored], limit_m: float = LIMIT_M) -> dict[str, Any]:
    """Return the scores of frames as JSON values; None where there was nothing to measure.

    frames, objects (most at a time), gospa_m (RMS over the frames, and the part of its square by localisation, missed,
    false), clear, hota, rmse_position_m, rmse_velocity_mps, velocity_nees (mean over 3). Errors are of pairs that are
    at most `limit_m` apart and each other's nearest.
    """
    frames = [step.moment for step in steps]
    parts = np.array([gospa(frame, limit_m) for frame in frames])
    pairs = [_nearest(frame, limit_m) for frame in frames]
    distance = _joined([frame.distance[pair] for frame, pair in zip(frames, pairs, strict=True)], 0)
    error = _joined([step.velocity_error_mps[pair] for step, pair in zip(steps, pairs, strict=True)], 3)
    spread = np.concatenate([step.velocity_covariance[pair[1]] for step, pair in zip(steps, pairs, strict=True)])
    clear, order = clear_mot(frames, limit_m), hota(frames, limit_m)
    found = {
        "frames": len(frames),
        "objects": max((len(frame.truth_id) for frame in frames), default=0),
        "limit_m": limit_m,
        "gospa_m": dict(zip(("total", *_PARTS), [rmse(parts[:, 0]), *parts[:, 1:].mean(axis=0)], strict=True)),
        "clear": clear._asdict(),
        "hota": order._asdict(),
        "rmse_position_m": rmse(distance) if len(distance) else None,
        "rmse_velocity_mps": rmse(np.linalg.norm(error, axis=1)) if len(error) else None,
        "velocity_nees": nees(error, spread).mean() / 3 if len(error) else None,
    }
    plain: dict[str, Any] = _plain(found)
    return plain


_PARTS = "localisation_m2", "missed_m2", "false_m2"


def _nearest(frame: Moment, limit_m: float) -> tuple[Any, Any]:
    """Return rows and columns of the pairs that are each other's nearest."""
    if not frame.distance.size:
        return np.zeros(0, int), np.zeros(0, int)
    rows = np.arange(len(frame.truth_id))
    columns = frame.distance.argmin(axis=1)
    good = (frame.distance.argmin(axis=0)[columns] == rows) & (frame.distance[rows, columns] <= limit_m)
    return rows[good], columns[good]


def _joined(arrays: list[Floats], width: int) -> Floats:
    return np.concatenate([np.zeros((0, width) if width else 0), *arrays])


def honesty(nis: Floats) -> dict[str, Any] | None:
    """Return whether NIS of three degrees of freedom are as they should be, None where all are NaN.

    mean (over 3; 1 where the innovations are as large as their covariance says), bounds (of that mean, for 95 %),
    inside (share of single values within their bounds, to be 0.95). No truth is needed.
    """
    nis = nis[np.isfinite(nis)]
    if not len(nis):
        return None
    low, high = chi_square_bounds(3)
    bounds = [bound / 3 for bound in chi_square_bounds(3, len(nis))]
    found: dict[str, Any] = _plain(
        {"mean": nis.mean() / 3, "bounds": bounds, "inside": np.mean((nis >= low) & (nis <= high))}
    )
    return found


def _plain(value: Any) -> Any:
    """Return values for JSON: rounded, None for what is not a number."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if value is None or isinstance(value, int):
        return value
    return round(float(value), 6) if np.isfinite(value) else None
