"""Which way each pixel looks, and which pixel looks a way."""

import math
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from rangecam.errors import UsageError
from rangecam.geometry.distortion import Coefficients, distort, folded, undistort
from rangecam.geometry.table import measured_rays
from rangecam.settings import settings
from rangecam.types import Floats


@settings
class Lens:
    """How the sensor sees: opening angles and projection, distortion, or the measured ray of every pixel."""

    horizontal_fov_deg: Annotated[float, Interval(gt=0, lt=175)] = 60.0
    """Opening angle over the whole width, outer edge to outer edge; of a lens that distorts, without its distortion."""
    vertical_fov_deg: Annotated[float, Interval(gt=0, lt=175)] | None = None
    """The same over the height; none: square pixels."""
    projection: Literal["perspective", "equiangular"] = "perspective"
    """perspective: tan(angle) grows with the pixel offset; equiangular: the angle itself does (f-theta lens)."""
    k1: float = 0.0
    """Radial distortion of a perspective lens, over the square of the tangent off the axis (Brown-Conrady, as in OpenCV
    and in most data sheets), ..."""
    k2: float = 0.0
    """... over its fourth power, ..."""
    k3: float = 0.0
    """... over its sixth power."""
    p1: float = 0.0
    """Tangential distortion, which is along the vertical, ..."""
    p2: float = 0.0
    """... and along the horizontal."""
    axis_right: Annotated[float, Interval(gt=-0.5, lt=0.5)] = 0.0
    """How far the optical axis passes to the right of the image centre, as a part of the image's width."""
    axis_down: Annotated[float, Interval(gt=-0.5, lt=0.5)] = 0.0
    """How far it passes below the image centre, as a part of the height."""
    table: str = ""
    """File (.npz) with the array `rays` (rows, columns, 3): the ray of every pixel in camera axes, x forward, y left,
    z up, of any length, as a calibration of the lens gives it; empty: none. It replaces all the above."""


def coefficients(lens: Lens) -> Coefficients:
    """Return the coefficients of the distortion."""
    return lens.k1, lens.k2, lens.k3, lens.p1, lens.p2


def is_plain(lens: Lens) -> bool:
    """Return whether neither distortion nor a table bends the lens, so that its projection has closed derivatives."""
    return not (lens.table or any(coefficients(lens)))


@lru_cache(maxsize=16)
def rays(lens: Lens, shape: tuple[int, int]) -> Floats:
    """Return the unit direction of every pixel's centre in camera axes (x forward, y left, z up): (H, W, 3) float64.

    Perspective pixels are equal steps of the tangent, equiangular ones equal steps of the angle (Steinbäck eq 3.16
    with rows and columns the right way round, E-S-02); the vertical angle is the elevation above the plane of the
    horizontal angle (E-K-17). The array is shared and read-only. Raises UsageError for a distortion that folds the
    image over or is of an equiangular lens, and what `measured_rays` raises.
    """
    if lens.table:
        table = measured_rays(lens.table, shape)
        table.setflags(write=False)
        return table
    (height, width), (pitch_h, pitch_v) = shape, pixel_pitch(lens, shape)
    left = (1 - (2 * np.arange(width) + 1) / width + 2 * lens.axis_right) * (pitch_h * width / 2)
    up = (1 - (2 * np.arange(height) + 1) / height + 2 * lens.axis_down) * (pitch_v * height / 2)
    y, z = (np.asarray(plane, float) for plane in np.meshgrid(left, up))
    if lens.projection == "perspective":
        if any(coefficients(lens)):
            right, down = undistort(-y, -z, coefficients(lens))
            y, z = -right, -down
        ray = np.stack([np.ones_like(y), y, z], axis=-1)
    elif any(coefficients(lens)):
        raise UsageError("camera.lens.projection = 'equiangular': k1, k2, k3, p1, p2 are of a perspective lens")
    else:
        ray = np.stack([np.cos(z) * np.cos(y), np.cos(z) * np.sin(y), np.sin(z)], axis=-1)
    unit: Floats = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    unit.setflags(write=False)
    return unit


@lru_cache(maxsize=16)
def pixel_pitch(lens: Lens, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the step from column to column and from row to row: rad (equiangular) or of the tangent (perspective).

    Of a lens that distorts, on its axis, where it does not; of a table, the mean over the image, rad.
    """
    if lens.table:
        across, down = np.linalg.norm(pixel_steps(lens, shape), axis=-1).mean(axis=(0, 1))
        return float(across), float(down)
    height, width = shape
    half_h = math.radians(lens.horizontal_fov_deg / 2)
    half_v = None if lens.vertical_fov_deg is None else math.radians(lens.vertical_fov_deg / 2)
    if lens.projection == "perspective":
        half_h, half_v = math.tan(half_h), None if half_v is None else math.tan(half_v)
    pitch_h = 2 * half_h / width
    return pitch_h, pitch_h if half_v is None else 2 * half_v / height


@lru_cache(maxsize=16)
def pixel_steps(lens: Lens, shape: tuple[int, int]) -> Floats:
    """Return how each pixel's ray changes from column to column and from row to row: (H, W, 2, 3), rad.

    Central differences, at the edge of the image one-sided ones; an image of one row or column has none there, and is
    taken for square pixels. The array is shared and read-only.
    """
    ray = rays(lens, shape)
    steps = np.zeros((*shape, 2, 3))
    for k, axis in enumerate((1, 0)):
        if shape[axis] > 1:
            steps[:, :, k] = np.gradient(ray, axis=axis)
    if shape[1] == 1:
        steps[:, :, 0] = np.cross(ray, -steps[:, :, 1])
    if shape[0] == 1:
        steps[:, :, 1] = np.cross(ray, steps[:, :, 0])
    steps.setflags(write=False)
    return steps


def pixel_of(directions: Floats, lens: Lens, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return where the image shows directions in camera axes (N, 3) of any length: row, column, whole at pixel centres.

    NaN for directions that the lens does not show at all: behind the camera, or where a distortion folds over. Beyond
    the edge of the image the numbers go on; of a table, only for about a pixel's reach.
    """
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    if lens.table:
        return _pixel_in_table(unit, lens, shape)
    (height, width), (pitch_h, pitch_v) = shape, pixel_pitch(lens, shape)
    x, y, z = unit.T
    if lens.projection == "perspective":
        with np.errstate(divide="ignore", invalid="ignore"):
            left, up = np.where(x > 0, y / x, np.nan), np.where(x > 0, z / x, np.nan)
        if any(coefficients(lens)):
            shown_x, shown_y, _ = distort(-left, -up, coefficients(lens))
            fold = folded(left * -1, up * -1, coefficients(lens))
            left, up = np.where(fold, np.nan, -shown_x), np.where(fold, np.nan, -shown_y)
    else:
        left, up = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    row = height / 2 - 0.5 + height * lens.axis_down - up / pitch_v
    column = width / 2 - 0.5 + width * lens.axis_right - left / pitch_h
    return row, column


def _pixel_in_table(unit: Floats, lens: Lens, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Find the nearest of all rays, then the part of a pixel beside it on the plane of its steps."""
    ray, steps = rays(lens, shape).reshape(-1, 3), pixel_steps(lens, shape).reshape(-1, 2, 3)
    nearest = np.array([int(np.argmax(ray @ one)) for one in unit], int)
    along = steps[nearest]
    gram = along @ along.transpose(0, 2, 1)
    off = (along @ (unit - ray[nearest])[..., None])[..., 0]
    beside = np.clip(np.linalg.solve(gram, off[..., None])[..., 0], -_REACH, _REACH)
    seen = np.einsum("ij,ij->i", ray[nearest], unit) > 0
    row, column = np.divmod(nearest, shape[1])
    return np.where(seen, row + beside[:, 1], np.nan), np.where(seen, column + beside[:, 0], np.nan)


_REACH = 1.0  # pixels beside the nearest ray of a table
