"""Light that reaches a surface by way of another one: two bounces between all that the camera sees (S-EFF-09)."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.geometry import Lens, rays
from rangecam.scene.view import View
from rangecam.types import Floats

_LARGEST_DISAGREEMENT = 0.1


@dataclass(frozen=True, eq=False)
class Surfaces:
    """N pieces of surface: point_m and normal (N, 3) in camera axes, range_m (N,), float32.

    A normal of zeros takes and gives no light: there is no surface, or its direction is not known.
    """

    point_m: Floats
    normal: Floats
    range_m: Floats


@dataclass(frozen=True, eq=False)
class Emitters:
    """Surfaces that the camera lights: power (N,) is what each sends back, reflectivity times what it gets; area_m2."""

    surfaces: Surfaces
    power: Floats
    area_m2: Floats


def surfaces_of(view: View, lens: Lens) -> Surfaces:
    """Return what the ray of each pixel meets, H W of them; `view` has one ray a pixel.

    A normal is that of the triangle with two neighbours, of four, which fits the incidence that the view tells best;
    none, where even that is more than 0.1 off, on things thinner than a pixel.
    """
    shape = view.range_m.shape[1:]
    ray = rays(lens, (shape[0], shape[1]))
    hit = np.isfinite(view.range_m[0])
    range_m = np.where(hit, view.range_m[0], 0.0)
    point = ray * range_m[..., None]
    normal, best = np.zeros_like(point), np.full(shape, _LARGEST_DISAGREEMENT)
    for down in _differences(point, axis=0):
        for across in _differences(point, axis=1):
            candidate = np.cross(down, across)
            length = np.linalg.norm(candidate, axis=-1)
            candidate /= np.maximum(length, 1e-12)[..., None]
            cosine = np.einsum("ijk,ijk->ij", candidate, ray)
            error = np.abs(np.abs(cosine) - view.cos_incidence[0])
            better = hit & (error < best)
            best[better] = error[better]
            normal[better] = (candidate * -np.sign(cosine)[..., None])[better]
    return Surfaces(
        *(np.ascontiguousarray(a, np.float32) for a in (point.reshape(-1, 3), normal.reshape(-1, 3), range_m.ravel()))
    )


def emitters_of(surfaces: Surfaces, view: View, intensity: Floats, lens: Lens, block_pixels: int) -> Emitters:
    """Return the surfaces as patches of `block_pixels` squared, each like the pixel in its middle.

    intensity (H, W): of the camera's light into the direction of each pixel.
    """
    height, width = intensity.shape
    starts = [np.arange(0, count, block_pixels) for count in (height, width)]
    middles = np.ix_(*(np.minimum(s + block_pixels // 2, n - 1) for s, n in zip(starts, (height, width), strict=True)))
    angle = np.add.reduceat(np.add.reduceat(solid_angles(lens, (height, width)), starts[0], 0), starts[1], 1)
    chosen = np.arange(height * width).reshape(height, width)[middles].ravel()
    range_m, cosine = surfaces.range_m[chosen], view.cos_incidence[0][middles].ravel()
    power = view.reflectivity[0][middles] * intensity[middles] * angle
    area = angle.ravel() * range_m**2 / np.maximum(cosine, 1e-3)
    patches = Surfaces(surfaces.point_m[chosen], surfaces.normal[chosen], range_m)
    return Emitters(patches, power.ravel().astype(np.float32), area.astype(np.float32))


@lru_cache(maxsize=8)
def solid_angles(lens: Lens, shape: tuple[int, int]) -> Floats:
    """Return the solid angle of every pixel, (H, W) sr."""
    ray = rays(lens, shape)
    down, across = (np.gradient(ray, axis=axis) if shape[axis] > 1 else np.zeros_like(ray) for axis in (0, 1))
    return np.asarray(np.linalg.norm(np.cross(down, across), axis=-1))


def irradiance(
    emitters: Emitters, receivers: Surfaces, table: Floats, turns_per_m: float, start_turns: Floats
) -> tuple[Floats, Floats]:
    """Return what receivers get from emitters, each (N,) float32: correlated by `table`, and in all.

    Every emitter is a Lambertian disc: irradiance rho E cos(out) cos(in) A / (pi d^2 + A), which is the exact form
    factor on its axis and finite where surfaces meet. The light went from the camera to the emitter, over d to the
    receiver and back, half of that way is the range that it claims (S-EFF-09). start_turns (N,): added to its phase.
    """
    signal, total = np.empty(len(receivers.range_m), np.float32), np.empty(len(receivers.range_m), np.float32)
    sent, got = emitters.surfaces, receivers
    givers = np.column_stack([sent.point_m, sent.normal, sent.range_m, emitters.power, emitters.area_m2])
    takers = np.column_stack([got.point_m, got.normal, got.range_m, start_turns]).astype(np.float32)
    _exchange(givers[emitters.power > 0], takers, table, np.float32(turns_per_m), signal, total)
    return signal, total


@njit(cache=True, nogil=True, error_model="numpy")
def _exchange(givers: Any, takers: Any, table: Any, turns_per_m: Any, signal: Any, total: Any) -> Any:
    period, half, pi = np.float32(len(table) - 2), np.float32(0.5), np.float32(math.pi)
    for j in range(len(takers)):
        x, y, z, nx, ny, nz, range_m, start = takers[j]
        s, t = np.float32(0), np.float32(0)
        for i in range(len(givers)):
            dx, dy, dz = x - givers[i, 0], y - givers[i, 1], z - givers[i, 2]
            leaves = dx * givers[i, 3] + dy * givers[i, 4] + dz * givers[i, 5]  # cosines times d
            arrives = -(dx * nx + dy * ny + dz * nz)
            if leaves > 0 and arrives > 0:
                d2 = dx * dx + dy * dy + dz * dz
                part = givers[i, 7] * leaves * arrives / (d2 * (pi * d2 + givers[i, 8]))
                turns = turns_per_m * half * (givers[i, 6] + np.sqrt(d2) + range_m) + start
                place = (turns - np.floor(turns)) * period
                k = int(place)
                s += part * (table[k] + (place - np.float32(k)) * (table[k + 1] - table[k]))
                t += part
        signal[j], total[j] = s, t


def _differences(point: Floats, axis: int) -> tuple[Floats, Floats]:
    """Return the steps to the pixel after and from the pixel before; at the border, where there is none, zeros."""
    step = np.diff(point, axis=axis)
    none = np.zeros_like(point.take([0], axis=axis))
    return np.concatenate([step, none], axis=axis), np.concatenate([none, step], axis=axis)
