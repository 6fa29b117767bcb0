"""The imperfections of the simulated camera by name, and the truth beside which each can be judged."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rangecam.cw.camera import simulate
from rangecam.cw.effects import (
    STRAY_FRACTION,
    FixedPattern,
    Interference,
    Link,
    Multipath,
    Scattering,
    Taps,
    Temperature,
    Waveform,
)
from rangecam.cw.light import middle_ray
from rangecam.cw.sequence import single_frequencies
from rangecam.cw.settings import CwCamera
from rangecam.cw.signal import gains, metres_per_radian
from rangecam.errors import UsageError, did_you_mean
from rangecam.scene.view import View
from rangecam.types import Floats, RawFrame


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What an ideal camera would measure with the middle ray of each pixel.

    range_m (H, W): inf where it meets nothing. phasor (F, H, W) complex64, LSB, at each of F modulation frequencies: a
    sample at a phase step is black level + Re(phasor exp(i step)). wraps (F, H, W) int: whole turns of the phase that
    the samples do not tell (phase wrap, S-EFF-07), so that range = mod(range) + wraps x unambiguous range.
    """

    range_m: Floats
    phasor: NDArray[np.complex64]
    wraps: NDArray[np.int32]


def ground_truth(view: View, camera: CwCamera) -> GroundTruth:
    """Return the truth of a pixel without any imperfection but vignetting, which no range depends on."""
    one = middle_ray(view)
    range_m, hit = one.range_m[0], np.isfinite(one.range_m[0])
    near_m = np.where(hit, range_m, 1.0).astype(np.float64)
    strength = np.where(hit, one.reflectivity[0] * one.cos_incidence[0] / near_m**2, 0.0)
    phasors, wraps = [], []
    for single in single_frequencies(camera):
        metres_per_rad = metres_per_radian(single)
        phase = single.phase_sign * (near_m - single.offset_m) / metres_per_rad
        phasors.append(gains(single, range_m.shape)[0] * strength * np.exp(1j * phase))
        wraps.append(np.where(hit, np.floor(near_m / (2 * np.pi * metres_per_rad)), 0))
    return GroundTruth(range_m, np.array(phasors, np.complex64), np.array(wraps, np.int32))


def imperfect(camera: CwCamera) -> CwCamera:
    """Return the camera with everything wrong that can be, but two bounces, as strongly as is usual; *open* values."""
    return replace(
        camera,
        waveform=Waveform(illumination="square", reference="square", bandwidth_hz=4 * camera.modulation_hz),
        taps=Taps(full_well_lsb=2500.0, ambient_suppression_lsb=1000.0),
        fixed_pattern=FixedPattern(global_offset_m=0.1, range_sigma_m=0.01, gain_sigma=0.01, offset_sigma_lsb=2.0),
        temperature=Temperature(drift_m_per_k=2e-3, self_heating_k=15.0),
        scattering=Scattering(stray_fraction=STRAY_FRACTION),
        interference=Interference(strength=0.05, modulation_hz=camera.modulation_hz + 170.0),
        link=Link(missed_clock_probability=1e-5, bit_error_probability=1e-6),
        exposure_samples=3,
    )


def ideal(camera: CwCamera) -> CwCamera:
    """Return the camera with every imperfection off."""
    for switch_off in IMPERFECTIONS.values():
        camera = switch_off(camera)
    return camera


def with_and_without(
    name: str, view: Callable[[float], View], camera: CwCamera, time_s: float, seed: int
) -> tuple[RawFrame, RawFrame]:
    """Return the frame of `camera` and that of the same camera without the imperfection `name`, with the same noise.

    Their difference is exactly what the imperfection does. Raises UsageError for an unknown name.
    """
    if name not in IMPERFECTIONS:
        raise UsageError(f"unknown imperfection '{name}'{did_you_mean(name, sorted(IMPERFECTIONS))}")
    cameras = camera, IMPERFECTIONS[name](camera)
    one, other = (simulate(view, each, time_s, np.random.default_rng(seed)) for each in cameras)
    return one, other


def _without(**settings: Any) -> Callable[[CwCamera], CwCamera]:
    return lambda camera: replace(camera, **settings)


def _without_part(part: str, **settings: Any) -> Callable[[CwCamera], CwCamera]:
    return lambda camera: replace(camera, **{part: replace(getattr(camera, part), **settings)})


IMPERFECTIONS: dict[str, Callable[[CwCamera], CwCamera]] = {
    "wiggling": _without(waveform=Waveform()),
    "vignetting": _without(reference_exponent=0.0),
    "shot_noise": _without(shot_noise_lsb2_per_lsb=0.0),
    "read_noise": _without(read_noise_lsb=0.0),
    "ambient_light": _without(ambient_lsb_per_wpm2=0.0),
    "full_well": _without(taps=Taps()),
    "quantisation": _without(quantisation_lsb=0.0),
    "converter_limits": _without(lower_limit_lsb=None, full_scale_lsb=None),
    "global_offset": _without_part("fixed_pattern", global_offset_m=0.0),
    "fixed_pattern": lambda camera: replace(
        camera,
        fixed_pattern=FixedPattern(
            seed=camera.fixed_pattern.seed, global_offset_m=camera.fixed_pattern.global_offset_m
        ),
    ),
    "temperature": _without(temperature=Temperature()),
    "mixed_pixels": _without(mixed_pixels=False),
    "multipath": _without(multipath=Multipath()),
    "scattering": _without(scattering=Scattering()),
    "motion_between_exposures": _without(freeze_motion=True),
    "motion_within_exposures": _without(exposure_samples=1),
    "interference": _without(interference=Interference()),
    "pseudo_rows": _without(pseudo_rows=0),
    "link_faults": _without(link=Link()),
}
"""How to switch each imperfection off. Phase wrap belongs to the principle: `GroundTruth.wraps` is its truth."""
