"""The forward model of a continuous-wave camera up to its pixels: from what the rays meet to demodulated light."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from rangecam.cw.effects import Waveform
from rangecam.cw.multipath import emitters_of, irradiance, surfaces_of
from rangecam.cw.pixel import range_shift_m, respond
from rangecam.cw.scattering import scatter
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import gains, metres_per_radian
from rangecam.cw.waveform import correlation_table, harmonics
from rangecam.scene.view import View
from rangecam.types import Floats


def correlate(view: View, camera: CwCamera, step_deg: float, time_s: float = 0.0) -> tuple[Floats, Floats]:
    """Return the mean sample and the light collected for it, each (H, W) float32 in LSB, at one phase step.

    `collect` and `respond` in one: what an exposure gives that looks at the scene once, at `time_s`.
    """
    return respond(collect(view, camera, step_deg, time_s), camera)


def collect(view: View, camera: CwCamera, step_deg: float, time_s: float) -> Floats:
    """Return the light that a pixel demodulates and all its light, (2, H, W) float32 in LSB, at one phase step.

    With sinusoidal modulation the first is amplitude cos(phase + step), with which atan2(C270 - C90, C0 - C180) is
    +phase (N-S-045); else the correlation function of `waveform`. The rays of a pixel add as phasors, so that a pixel
    at an edge mixes two ranges (K-OPT-13). The amplitude of a ray goes with reflectivity cos(incidence) / range^2
    (Steinbäck 2016, eq 2.5), and so that a white plane 1 m before the camera makes `reference_amplitude`. All the
    light, whose shot noise a sample has, is amplitude / contrast plus the ambient light. Light of a second camera and
    of second bounces comes on top, then the lens scatters.
    """
    view = view if camera.mixed_pixels else middle_ray(view)
    gain, vignetting = gains(camera, view.range_m.shape[1:])
    shift_m = range_shift_m(camera, time_s, gain.shape)
    ambient = np.float32(camera.ambient_lsb_per_wpm2 * view.ambient_wpm2) * vignetting
    per_amplitude = np.float32(1 / camera.demodulation_contrast)
    light, own = np.zeros((2, *gain.shape), np.float32), _own_light(camera, step_deg)
    _add_light(view, own, shift_m, (gain, per_amplitude, ambient), light)
    if camera.interference.strength:
        theirs, its_gain = _interfering_light(camera, step_deg, time_s), gain * np.float32(camera.interference.strength)
        _add_light(view, theirs, shift_m, (its_gain, per_amplitude, np.zeros_like(ambient)), light)
    if camera.multipath.two_bounces:
        light += _second_bounces(middle_ray(view), camera, own, shift_m)
    return scatter(light, camera.scattering)


def middle_ray(view: View) -> View:
    """Return the view with one ray a pixel, the middle one of its list."""
    k = view.range_m.shape[0] // 2
    one = slice(k, k + 1)
    return replace(
        view, range_m=view.range_m[one], reflectivity=view.reflectivity[one], cos_incidence=view.cos_incidence[one]
    )


@dataclass(frozen=True, eq=False)
class _Light:
    """Modulated light as the pixels see it: correlation over a period; phase = turns_per_m range + start_turns."""

    table: Floats
    turns_per_m: float
    start_turns: float


def _own_light(camera: CwCamera, step_deg: float) -> _Light:
    turns_per_m = camera.phase_sign / (2 * math.pi * metres_per_radian(camera))
    table = _own_table(camera.waveform, camera.modulation_hz)
    return _Light(table, turns_per_m, step_deg / 360 - turns_per_m * camera.offset_m)


@lru_cache(maxsize=16)
def _own_table(waveform: Waveform, modulation_hz: float) -> Floats:
    return correlation_table(harmonics(waveform, modulation_hz))


def _interfering_light(camera: CwCamera, step_deg: float, time_s: float) -> _Light:
    """Return the light of the second camera, which ours demodulates with its own frequency.

    cos(w2 t + phase2 - delay) times the reference cos(w1 t + step), averaged over an exposure T around t, leaves
    cos(delay - phase2 - (w2 - w1) t + step) sinc((f2 - f1) T): a beat; of harmonic k, k times as fast.
    """
    its = camera.interference
    beat_hz = its.modulation_hz - camera.modulation_hz
    turns_per_m = camera.phase_sign * 2 * its.modulation_hz / camera.speed_of_light_mps
    beat = camera.phase_sign * math.fmod(its.phase_deg / 360 + beat_hz * time_s, 1.0)
    exposure_s = camera.illumination_time_s / camera.exposure_samples
    table = _interfering_table(camera.waveform, its.modulation_hz, beat_hz * exposure_s)
    return _Light(table, turns_per_m, step_deg / 360 - turns_per_m * camera.offset_m - beat)


@lru_cache(maxsize=16)
def _interfering_table(waveform: Waveform, modulation_hz: float, beats: float) -> Floats:
    h = harmonics(waveform, modulation_hz)
    return correlation_table(h * np.sinc(beats * np.arange(1, len(h) + 1)))


def _second_bounces(view: View, camera: CwCamera, light: _Light, shift_m: Floats) -> Floats:
    """Return the light (2, H, W) that comes by way of a second surface, in LSB.

    The gain of a pixel is the intensity of the camera's light there times vignetting of the lens, and only the latter
    acts on light that comes from elsewhere.
    """
    gain, vignetting = gains(camera, shift_m.shape)
    surfaces = surfaces_of(view, camera.lens)
    emitters = emitters_of(surfaces, view, gain / vignetting, camera.lens, camera.multipath.block_pixels)
    start_turns = (light.start_turns + light.turns_per_m * shift_m).ravel()
    parts = irradiance(emitters, surfaces, light.table, light.turns_per_m, start_turns)
    seen = vignetting * view.reflectivity[0]
    signal, total = (part.reshape(seen.shape) * seen for part in parts)
    return np.stack([signal, total / camera.demodulation_contrast]).astype(np.float32)


def _rays_of(view: View) -> tuple[Floats, Floats, Floats]:
    """Return range, reflectivity and incidence as the kernel reads them: (K, H W) float32."""
    range_m, reflectivity, cos_incidence = (
        np.ascontiguousarray(a, np.float32).reshape(len(a), -1)
        for a in (view.range_m, view.reflectivity, view.cos_incidence)
    )
    return range_m, reflectivity, cos_incidence


def _add_light(
    view: View, modulated: _Light, shift_m: Floats, levels: tuple[Floats, np.float32, Floats], light: Floats
) -> None:
    """Add to `light` (2, H, W) what the rays bring; levels: LSB of amplitude, light per amplitude, LSB of ambient."""
    gain, per_amplitude, ambient = levels
    _sum_rays(
        _rays_of(view),
        (modulated.table, np.float32(modulated.turns_per_m), np.float32(modulated.start_turns % 1)),
        shift_m.ravel(),
        (gain.ravel(), per_amplitude, ambient.ravel()),
        light[0].ravel(),
        light[1].ravel(),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_rays(view: Any, light: Any, shift_m: Any, levels: Any, signal: Any, total: Any) -> Any:
    """Average over the rays of each pixel: demodulated light, and active with ambient light; added to the outputs."""
    range_m, reflectivity, cos_incidence = view
    table, turns_per_m, start_turns = light
    gain, per_contrast, ambient = levels
    n_rays, n_pixels = range_m.shape
    share, period = np.float32(1) / np.float32(n_rays), np.float32(len(table) - 2)
    for i in range(n_pixels):
        s, a, r = np.float32(0), np.float32(0), np.float32(0)
        start = start_turns + turns_per_m * shift_m[i]
        for k in range(n_rays):
            distance = range_m[k, i]
            if distance < np.inf:
                strength = reflectivity[k, i] * cos_incidence[k, i] / (distance * distance)
                turns = turns_per_m * distance + start
                place = (turns - np.floor(turns)) * period
                n = int(place)
                s += strength * (table[n] + (place - np.float32(n)) * (table[n + 1] - table[n]))
                a += strength
                r += reflectivity[k, i]
        signal[i] += gain[i] * s * share
        total[i] += gain[i] * per_contrast * a * share + ambient[i] * r * share
