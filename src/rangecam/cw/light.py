"""The forward model of a continuous-wave camera up to its pixels: from what the rays meet to demodulated light."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from rangecam.cw.multipath import emitters_of, irradiance, surfaces_of
from rangecam.cw.pixel import drift_m, fixed_pattern, range_shift_m, respond
from rangecam.cw.scattering import scatter
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import gains, metres_per_radian
from rangecam.cw.waveform import TABLE_SIZE, correlation_table, harmonics
from rangecam.scene.view import View
from rangecam.types import Floats


def correlate(view: View, camera: CwCamera, step_deg: float, time_s: float = 0.0) -> tuple[Floats, Floats]:
    """Return the mean sample and the light collected for it, each (H, W) float32 in LSB, at one phase step.

    `collect`, `scatter` and `respond` in one: what an exposure gives that looks at the scene once, at `time_s`.
    """
    return respond(scatter(collect(view, camera, step_deg, time_s), camera.scattering), camera)


def collect(view: View, camera: CwCamera, step_deg: float, time_s: float) -> Floats:
    """Return the light that a pixel demodulates and all its light, (2, H, W) float32 in LSB, at one phase step.

    With sinusoidal modulation the first is amplitude cos(phase + step), with which atan2(C270 - C90, C0 - C180) is
    +phase (N-S-045); else the correlation function of `waveform`. The rays of a pixel add as phasors, so that a pixel
    at an edge mixes two ranges (K-OPT-13). The amplitude of a ray goes with reflectivity cos(incidence) / range^2
    (Steinbäck 2016, eq 2.5), and so that a white plane 1 m before the camera makes `reference_amplitude`. All the
    light, whose shot noise a sample has, is amplitude / contrast plus the ambient light. Light of a second camera and
    of second bounces comes on top. The lens scatters it on its way (`scatter`).
    """
    view = view if camera.mixed_pixels else middle_ray(view)
    lights = [_own_light(camera, step_deg)]
    if camera.interference.strength:
        lights.append(_interfering_light(camera, step_deg, time_s))
    result = _sum_over_rays(view, camera, lights, time_s)
    if camera.multipath.two_bounces:
        shift_m = range_shift_m(camera, time_s, view.range_m.shape[1:])
        result += _second_bounces(middle_ray(view), camera, lights[0], shift_m)
    return result


def middle_ray(view: View) -> View:
    """Return the view with one ray a pixel, the middle one of its list."""
    k = view.range_m.shape[0] // 2
    one = slice(k, k + 1)
    return replace(
        view, range_m=view.range_m[one], reflectivity=view.reflectivity[one], cos_incidence=view.cos_incidence[one]
    )


class _Light(NamedTuple):
    """Modulated light as the pixels see it: phase = turns_per_m range + start_turns.

    strength: over that of our own light. Its correlation over a period is a row of `_tables`.
    """

    turns_per_m: float
    start_turns: float
    strength: float = 1.0


@lru_cache(maxsize=64)
def _own_light(camera: CwCamera, step_deg: float) -> _Light:
    turns_per_m = camera.phase_sign / (2 * math.pi * metres_per_radian(camera))
    return _Light(turns_per_m, step_deg / 360 - turns_per_m * camera.offset_m)


def _interfering_light(camera: CwCamera, step_deg: float, time_s: float) -> _Light:
    """Return the light of the second camera, which ours demodulates with its own frequency.

    cos(w2 t + phase2 - delay) times the reference cos(w1 t + step), averaged over an exposure T around t, leaves
    cos(delay - phase2 - (w2 - w1) t + step) sinc((f2 - f1) T): a beat; of harmonic k, k times as fast.
    """
    its = camera.interference
    beat_hz = its.modulation_hz - camera.modulation_hz
    turns_per_m = camera.phase_sign * 2 * its.modulation_hz / camera.speed_of_light_mps
    beat = camera.phase_sign * math.fmod(its.phase_deg / 360 + beat_hz * time_s, 1.0)
    return _Light(turns_per_m, step_deg / 360 - turns_per_m * camera.offset_m - beat, its.strength)


def _tables_of(lights: list[_Light], camera: CwCamera) -> tuple[Floats, list[_Light]]:
    """Return `_tables` and the lights that they belong to: both lights as one, where that is what the pixels see.

    If both are modulated so nearly alike that the second moves against the first by less than `_TOGETHER` of the first
    in every metre, their sum is a signal of one frequency: what is left falls with the range, from `_TOGETHER` of the
    light of a white surface 1 m away.
    """
    tables, own = _tables(camera), lights[0]
    if len(lights) == 1 or lights[1].strength * 2 * math.pi * abs(lights[1].turns_per_m - own.turns_per_m) > _TOGETHER:
        return tables, lights
    turns = (lights[1].start_turns - own.start_turns) % 1
    first, part = divmod(turns * TABLE_SIZE, 1)
    other, at = _over_two_periods(camera), int(first)
    one, next_one = other[at : at + TABLE_SIZE + 2], other[at + 1 : at + TABLE_SIZE + 3]
    met = one + np.float32(part) * (next_one - one)
    met *= np.float32(lights[1].strength)
    met += tables[0]
    return met[None], lights[:1]


_TOGETHER = 1e-6


@lru_cache(maxsize=16)
def _over_two_periods(camera: CwCamera) -> Floats:
    """Return the correlation with the light of a second camera, so that a period of it can begin anywhere."""
    period = _tables(camera)[1, :TABLE_SIZE]
    return np.concatenate([period, period, period[:3]])


@lru_cache(maxsize=16)
def _tables(camera: CwCamera) -> Floats:
    """Return the correlation over a period with our light, and in a second row with that of a second camera."""
    own, its = harmonics(camera.waveform, camera.modulation_hz), camera.interference
    if not its.strength:
        return correlation_table(own)[None]
    other = harmonics(camera.waveform, its.modulation_hz)
    exposure_s = camera.illumination_time_s / camera.exposure_samples
    beats = (its.modulation_hz - camera.modulation_hz) * exposure_s
    other = other * np.sinc(beats * np.arange(1, len(other) + 1))
    return np.stack([correlation_table(own), correlation_table(other)])


def _second_bounces(view: View, camera: CwCamera, light: _Light, shift_m: Floats) -> Floats:
    """Return the light (2, H, W) that comes by way of a second surface, in LSB.

    The gain of a pixel is the intensity of the camera's light there times vignetting of the lens, and only the latter
    acts on light that comes from elsewhere.
    """
    gain, vignetting = gains(camera, shift_m.shape)
    surfaces = surfaces_of(view, camera.lens)
    emitters = emitters_of(surfaces, view, gain / vignetting, camera.lens, camera.multipath.block_pixels)
    start_turns = (light.start_turns + light.turns_per_m * shift_m).ravel()
    parts = irradiance(emitters, surfaces, _tables(camera)[0], light.turns_per_m, start_turns)
    seen = vignetting * view.reflectivity[0]
    signal, total = (part.reshape(seen.shape) * seen for part in parts)
    return np.stack([signal, total / camera.demodulation_contrast]).astype(np.float32)


def _sum_over_rays(view: View, camera: CwCamera, lights: list[_Light], time_s: float) -> Floats:
    """Return the light (2, H, W) that the rays bring."""
    shape = view.range_m.shape[1:]
    rays_met = tuple(
        np.ascontiguousarray(a, np.float32).reshape(len(a), -1)
        for a in (view.range_m, view.reflectivity, view.cos_incidence)
    )
    gain, vignetting = gains(camera, shape)
    of_pixels = fixed_pattern(camera, shape).range_m.reshape(-1), gain.reshape(-1), vignetting.reshape(-1)
    per_amplitude = np.float32(1 / camera.demodulation_contrast) * sum([each.strength for each in lights])
    ambient = camera.ambient_lsb_per_wpm2 * view.ambient_wpm2
    of_all = np.array([drift_m(camera, time_s), per_amplitude, ambient], np.float32)
    tables, apart = _tables_of(lights, camera)
    numbers = np.array([(each.turns_per_m, each.start_turns % 1, each.strength) for each in apart], np.float32)
    result = np.empty((2, *shape), np.float32)
    _sum_rays(rays_met, tables, numbers, of_pixels, of_all, result.reshape(2, -1))
    return result


_BLOCK = 1024  # pixels at a time, which leave what is known of them in the fastest memory


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_rays(view: Any, tables: Any, numbers: Any, of_pixels: Any, of_all: Any, result: Any) -> Any:
    """Fill the light of each pixel, demodulated and all, with that of its rays.

    of_pixels: what its pattern adds to the range, LSB of amplitude, share of ambient light. of_all: what the drift adds
    to the range, light per amplitude, LSB of ambient light.
    """
    (range_m, reflectivity, cos_incidence), (pattern_m, gain, vignetting) = view, of_pixels
    drift, per_amplitude, level = of_all
    share = np.float32(1) / np.float32(len(range_m))
    distance, strength = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    shift, ambient = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    for first in range(0, len(gain), _BLOCK):
        last = min(first + _BLOCK, len(gain))
        signal, total = result[0, first:last], result[1, first:last]
        for i in range(len(signal)):
            signal[i], total[i] = 0, 0
            shift[i], ambient[i] = pattern_m[first + i] + drift, level * vignetting[first + i]
        for k in range(len(range_m)):
            met = (range_m[k, first:last], reflectivity[k, first:last], cos_incidence[k, first:last])
            levels = (gain[first:last], per_amplitude, ambient)
            if _reflect(met, share, levels, (distance, strength), total):
                for i in range(len(numbers)):
                    _demodulate((distance, strength), tables[i], numbers[i], shift, signal)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})
def _reflect(met: Any, share: Any, levels: Any, result: Any, total: Any) -> Any:
    """Fill range and amplitude of a ray of each pixel and add all its light; return whether any of them met something.

    Short loops without branches, which become vectors.
    """
    (range_m, reflectivity, cos_incidence), (gain, per_amplitude, ambient), (distance, strength) = met, levels, result
    zero, one, largest = np.float32(0), np.float32(1), np.float32(1e30)
    hits = 0
    for i in range(len(total)):
        hits += range_m[i] < largest
    if hits:
        for i in range(len(total)):
            hit = range_m[i] < largest
            distance[i] = range_m[i] if hit else one
            reflected = share * reflectivity[i] if hit else zero
            strength[i] = gain[i] * reflected * cos_incidence[i] / (distance[i] * distance[i])
            total[i] += strength[i] * per_amplitude + ambient[i] * reflected
    return hits > 0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})
def _demodulate(ray: Any, table: Any, numbers: Any, shift_m: Any, signal: Any) -> Any:
    """Add what the pixels demodulate of a light: the table at its phase, between whose values it is interpolated."""
    (distance, strength), (turns_per_m, start, factor) = ray, numbers
    period, place, met = np.float32(len(table) - 2), np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    for i in range(len(signal)):
        turns = turns_per_m * (distance[i] + shift_m[i]) + start
        place[i] = (turns - np.floor(turns)) * period
    for i in range(len(signal)):
        n = np.int32(place[i])
        at = np.uintp(n)  # without a sign it needs no check whether it counts from the end
        here = table[at]
        met[i] = here + (place[i] - np.float32(n)) * (table[at + np.uintp(1)] - here)
    for i in range(len(signal)):
        signal[i] += factor * strength[i] * met[i]
