"""Several modulation frequencies: how far they reach, how often unwrapping fails, and what the phasor filter saves."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from rangecam.cw.light import correlate
from rangecam.cw.ranging import cw_multi_frequency
from rangecam.cw.sequence import exposures
from rangecam.cw.settings import CwCamera
from rangecam.cw.unwrapping import Combination, combine, gross_error_probability
from rangecam.geometry import Lens
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats, Image, RawFrame

ROWS, COLUMNS = 424, 512
GROSS_M = 0.3
_NOISES_LSB = (2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0)
_FILTERS: tuple[Literal["off", "3x3", "5x5"], ...] = ("off", "3x3", "5x5")
_RAYS = 3
_LENS = Lens(horizontal_fov_deg=70.0, vertical_fov_deg=60.0)
_CAMERA = CwCamera(
    rows=ROWS,
    columns=COLUMNS,
    lens=_LENS,
    phase_steps_deg=(0, 120, 240),
    black_level_lsb=2048.0,
    shot_noise_lsb2_per_lsb=0.0,
    reference_amplitude_lsb=1000.0,
    reference_exponent=1.0,
    max_phase_sigma_rad=0.5,
)
CAMERAS = {
    "60 + 80 MHz": replace(_CAMERA, modulations_hz=(60e6, 80e6)),
    "80 + 16 + 120 MHz": replace(_CAMERA, modulations_hz=(80e6, 16e6, 120e6)),
}


@dataclass(frozen=True)
class Outcome:
    """What became of the pixels away from edges, as fractions; how many mixed ones passed with a range that none has.

    covered: fraction of the good pixels within one sigma of the truth.
    """

    gross: float
    rejected: float
    flying: int
    covered: float


def unwrapping(rng: np.random.Generator) -> Study:
    """Unwrapping by several modulation frequencies: unambiguous range, gross and rejected pixels over the noise.

    rng: of the simulated noise.
    """
    reach = {pair: combine((pair[0] * 1e6, pair[1] * 1e6), 3e8) for pair in ((17, 12), (30, 20), (30, 17), (30, 12))}
    claims = [
        derived("N-S-039", f"unambiguous range of {a} + {b} MHz", together.unambiguous_m, "m")
        for (a, b), together in reach.items()
    ]
    panels = []
    for name, camera in CAMERAS.items():
        view, edges = _scene(camera)
        curves = {
            filter_: [
                _outcome(replace(camera, phasor_filter=filter_), view, edges, noise, rng) for noise in _NOISES_LSB
            ]
            for filter_ in _FILTERS
        }
        claims += _at_a_tenth(name, camera, view, edges, curves["off"], rng)
        panels += [_over_noise(name, curves), _panel(name, curves)]
    chances, theory_panel = _theory(rng)
    return Study("cw-unwrapping", "Steinbäck 2016, 2.2.2, and beyond it", [*claims, *chances], [*panels, theory_panel])


def _scene(camera: CwCamera) -> tuple[View, Image]:
    """Return a slanted wall behind boxes and discs, 3 x 3 rays a pixel, and which pixels mix surfaces (H, W)."""
    across = (np.arange(COLUMNS * _RAYS) + 0.5) / COLUMNS / _RAYS
    down = (np.arange(ROWS * _RAYS) + 0.5) / ROWS / _RAYS
    u, v = np.meshgrid(across, down)
    range_m, reflectivity = 4.0 + 2.0 * u, 0.35 + 0.25 * np.sin(9 * u) * np.sin(7 * v)
    surface = np.zeros(u.shape, np.int32)
    for k, (left, top, width, height, distance_m, share) in enumerate(
        [(0.08, 0.2, 0.2, 0.6, 2.0, 0.5), (0.4, 0.5, 0.15, 0.4, 3.0, 0.2), (0.7, 0.1, 0.22, 0.5, 2.6, 0.8)], 1
    ):
        inside = (u > left) & (u < left + width) & (v > top) & (v < top + height)
        range_m[inside], reflectivity[inside], surface[inside] = distance_m, share, k
    for k, (x, y, radius, distance_m, share) in enumerate([(0.5, 0.25, 0.12, 1.5, 0.3), (0.8, 0.8, 0.1, 3.5, 0.6)], 4):
        inside = (u - x) ** 2 + (v - y) ** 2 < radius**2
        range_m[inside], reflectivity[inside], surface[inside] = distance_m, share, k
    parts = [_rays_of(each.astype(np.float32)) for each in (range_m, reflectivity, surface)]
    edges: Image = parts[2].min(axis=0) != parts[2].max(axis=0)
    return View(parts[0], parts[1], np.ones_like(parts[0])), edges


def _rays_of(fine: Floats) -> Floats:
    """Return an image of rays as (K, H, W): those of each pixel."""
    blocks = fine.reshape(ROWS, _RAYS, COLUMNS, _RAYS).transpose(1, 3, 0, 2)
    rays: Floats = blocks.reshape(_RAYS * _RAYS, ROWS, COLUMNS)
    return rays


def _outcome(camera: CwCamera, view: View, edges: Image, noise_lsb: float, rng: np.random.Generator) -> Outcome:
    """Return what one frame with this raw noise comes to."""
    camera = replace(camera, read_noise_lsb=noise_lsb)
    planes = {
        exposure.plane: correlate(view, exposure.camera, exposure.step_deg)[0]
        + np.float32(noise_lsb) * rng.standard_normal((ROWS, COLUMNS), np.float32)
        for exposure in exposures(camera)
    }
    image = cw_multi_frequency(RawFrame(0.0, planes), camera)
    error = image.range_m - view.range_m.mean(axis=0)
    inner = ~edges
    near = np.abs(error) < GROSS_M
    sound = image.valid & inner & near
    return Outcome(
        gross=float(np.mean((image.valid & ~near)[inner])),
        rejected=float(np.mean(~image.valid[inner])),
        flying=int(np.sum(image.valid & edges & _between(image.range_m, view))),
        covered=float(np.mean(np.abs(error[sound]) < image.sigma_m[sound])) if sound.any() else float("nan"),
    )


def _between(range_m: Floats, view: View) -> Image:
    """Return the pixels (H, W) whose range is none of the surfaces that they see, by more than 0.1 m."""
    away: Image = np.abs(range_m - view.range_m).min(axis=0) > 0.1
    return away


def _at_a_tenth(
    name: str, camera: CwCamera, view: View, edges: Image, bare: list[Outcome], rng: np.random.Generator
) -> list[Claim]:
    """Return what the filter leaves at the noise with which a tenth of the pixels fail without it."""
    failed = [outcome.gross + outcome.rejected for outcome in bare]
    noise_lsb = float(np.interp(0.1, failed, _NOISES_LSB))
    without, with_it = (
        _outcome(replace(camera, phasor_filter=filter_), view, edges, noise_lsb, rng) for filter_ in _FILTERS[:2]
    )
    beyond = "beyond the thesis; 3x3 joint bilateral filter of the phasors; gross: more than 300 mm, away from edges"
    return [
        derived("S-EFF-08", f"{name}: raw noise at which a tenth fails unfiltered", noise_lsb, "LSB", beyond),
        derived("S-EFF-08", f"{name}: gross errors without a filter", without.gross * 100, "%", beyond),
        derived("S-EFF-08", f"{name}: rejected without a filter", without.rejected * 100, "%", beyond),
        _wanted(f"{name}: gross errors with the filter", with_it.gross * 100, 0.01, beyond),
        _wanted(f"{name}: rejected with the filter", with_it.rejected * 100, 15.0, beyond),
        derived("S-EFF-08", f"{name}: flying pixels left without a filter", without.flying, "", beyond),
        derived("S-EFF-08", f"{name}: flying pixels left with the filter", with_it.flying, "", beyond),
        judged(
            "S-EFF-08",
            f"{name}: within one sigma of the truth after the filter",
            None,
            with_it.covered,
            "",
            abs(with_it.covered - 0.683) < 0.03,
            "68.3 % within three points; " + beyond,
        ),
    ]


def _wanted(text: str, computed: float, most: float, why: str) -> Claim:
    return judged("S-EFF-08", text, None, computed, "%", computed < most, f"wanted: under {most:g} %; {why}")


def _over_noise(name: str, curves: Mapping[Any, list[Outcome]]) -> Panel:
    series = [
        Series(f"filter {label}", _NOISES_LSB, [100 * outcome.rejected for outcome in outcomes], line="o-")
        for label, outcomes in curves.items()
    ]
    return Panel(f"{name}: what is given up", "raw noise (LSB)", "rejected (%)", series)


def _panel(name: str, curves: Mapping[Any, list[Outcome]]) -> Panel:
    """Return gross errors against rejected pixels, both in per cent, along the noise."""
    floor = 100 / (ROWS * COLUMNS)
    series = [
        Series(
            f"filter {label}",
            [100 * outcome.rejected for outcome in outcomes],
            [max(100 * outcome.gross, floor / 2) for outcome in outcomes],
            line="o-",
        )
        for label, outcomes in curves.items()
    ]
    low, high = _NOISES_LSB[0], _NOISES_LSB[-1]
    return Panel(f"{name}: what is wrong, {low:g} to {high:g} LSB", "rejected (%)", "gross errors (%)", series, log="y")


def _theory(rng: np.random.Generator) -> tuple[list[Claim], Panel]:
    """Return the probability of wrong wraps of the likeliest candidate beside what is counted."""
    sigmas, claims, series = np.array([0.16, 0.2, 0.25, 0.3]), [], []
    for number, (name, camera) in enumerate(CAMERAS.items()):
        together = combine(camera.modulations_hz, camera.speed_of_light_mps)
        theory = [gross_error_probability([s] * len(together.wraps), together) for s in sigmas]
        counted = [_counted(camera, together, float(s), rng) for s in sigmas]
        bound = "exact" if len(together.wraps) == 2 else "the union bound is an upper limit"
        slack = 4 * np.sqrt(theory[1] / (ROWS * COLUMNS)) + 0.02 * theory[1]
        claims.append(
            judged(
                "S-EFF-08",
                f"{name}: gross errors of the likeliest wraps at 0.2 rad, theory {theory[1]:.3g}",
                None,
                counted[1],
                "",
                abs(counted[1] - theory[1]) < slack,
                f"within four standard errors of counting in {ROWS * COLUMNS} simulated pixels and 2 %; {bound}",
            )
        )
        series.append(Series(f"{name}, theory", sigmas, theory, colour=number))
        series.append(Series(f"{name}, counted", sigmas, counted, line="o", colour=number))
    return claims, Panel("Nothing rejected", "phase noise (rad)", "probability of a gross error", series, log="y")


def _counted(camera: CwCamera, together: Combination, sigma_rad: float, rng: np.random.Generator) -> float:
    """Return the fraction of pixels whose likeliest range is wrong by more than a metre, for one phase noise."""
    amplitude = 1000.0
    noise_lsb = sigma_rad * amplitude * np.sqrt(len(camera.phase_steps_deg) / 2)
    truth = rng.uniform(0.1, 0.9, (ROWS, COLUMNS)) * together.unambiguous_m
    planes = {}
    for exposure in exposures(camera):
        turns = truth * 2 * exposure.camera.modulation_hz / camera.speed_of_light_mps
        sample = amplitude * np.cos(2 * np.pi * turns + np.radians(exposure.step_deg))
        noise = noise_lsb * rng.standard_normal(truth.shape)
        planes[exposure.plane] = (camera.black_level_lsb + sample + noise).astype(np.float32)
    lenient = replace(camera, unwrap_error=1 - 1e-9, unwrap_residual_sigmas=100.0, unwrap_phase_error_rad=0.0)
    image = cw_multi_frequency(RawFrame(0.0, planes), replace(lenient, read_noise_lsb=noise_lsb))
    step_m = together.unambiguous_m / max(together.wraps)
    return float(np.mean(np.abs(image.range_m - truth) > step_m / 2))
