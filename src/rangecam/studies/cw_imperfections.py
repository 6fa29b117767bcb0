"""What each imperfection of the continuous-wave camera does to its ranges, and how settings trade them."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from rangecam.config import load_config
from rangecam.cw import RANGING, CwCamera
from rangecam.cw.effects import STRAY_FRACTION, Link, Multipath, Scattering, Taps, Temperature, Waveform
from rangecam.cw.imperfections import IMPERFECTIONS, ideal, imperfect, with_and_without
from rangecam.cw.light import correlate
from rangecam.cw.signal import metres_per_radian
from rangecam.geometry import Mounting
from rangecam.scene.paths import EgoMotion
from rangecam.scene.render import ray_bundle, render
from rangecam.scene.scenario import Scenario, load_scenario
from rangecam.scene.view import View
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats, RangeImage, RawFrame, Why

_NOISE = {
    "shot_noise": "S-EFF-10",
    "read_noise": "S-EFF-10",
    "quantisation": "S-EFF-10",
    "ambient_light": "S-EFF-02",
}
_SHIFTS = {
    "wiggling": "S-EFF-01",
    "scattering": "S-EFF-04",
    "motion_within_exposures": "S-EFF-05",
    "motion_between_exposures": "S-EFF-06",
    "multipath": "S-EFF-09",
    "global_offset": "S-EFF-11",
    "fixed_pattern": "S-EFF-11",
    "temperature": "S-EFF-11",
    "mixed_pixels": "K-OPT-13",
    "interference": "S-TOF-01",
}
"""Imperfections that change ranges, looked at without noise; the others end pixels or move them."""
_DRIVING = EgoMotion(speed_mps=10 / 3.6)
_HEIGHTS_M = (0.05, 0.1, 0.2, 0.4)
_ILLUMINATION_S = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3)


def cw_imperfections(rng: np.random.Generator) -> Study:
    """Imperfections of the continuous-wave camera one by one; illumination time, modulation frequency, mounting height.

    rng: of the noise of the simulated frames.
    """
    camera, seed = _camera(), int(rng.integers(1 << 31))
    ranges, wiggling, expected = _wiggling(replace(ideal(camera), speed_of_light_mps=3e8))
    scene = replace(load_scenario("test-scene"), ambient_wpm2=2.0, ego=_DRIVING)
    errors = _errors(camera, scene, seed)
    by_time, by_height = _illumination(camera, scene, seed), _heights(camera, scene, seed)
    claims = [
        *_wiggling_claims(wiggling, expected),
        *(_caused(name, error) for name, error in errors.items()),
        *_trade_claims(camera, by_time, by_height),
    ]
    panels = (
        Panel(
            "wiggling of rectangular signals, 17 MHz", "range, m", "error, mm",
            [Series("simulated", ranges, wiggling * 1e3), Series("triangle", ranges, expected * 1e3, line="--")],
        ),
        Panel("what each changes", "change of the range, mm", "part of the pixels with less", _cumulated(errors), "x"),
        _time_panel(by_time),
        Panel(
            "1 % of stray light, 2 ms", "height of the camera, m", "part of the pixels",
            [
                Series("saturated", _HEIGHTS_M, [row[0] for row in by_height], line="-o"),
                Series("shifted by more than 50 mm", _HEIGHTS_M, [row[1] for row in by_height], line="-o"),
            ],
        ),
    )  # fmt: skip
    return Study("cw-imperfections", "Steinbäck 2016, 2.2.2, 5.1.2, 5.2 and A.1", claims, panels)


def _camera() -> CwCamera:
    camera = load_config("scaled_car", {"camera": {"pseudo_rows": 0}}).camera
    assert isinstance(camera, CwCamera)
    return camera


def _wiggling(camera: CwCamera) -> tuple[Floats, Floats, Floats]:
    """Return ranges, their simulated error with rectangular signals, and that of a triangular correlation, m."""
    unit = metres_per_radian(camera)
    ranges = 2 * np.pi * unit * (np.arange(400) + 0.5) / 400
    row = ranges.astype(np.float32).reshape(1, 1, -1)
    view, square = View(row, row**2, np.ones_like(row)), Waveform(illumination="square", reference="square")
    samples = {step: correlate(view, replace(camera, waveform=square), step)[0][0] for step in (0, 90, 180, 270)}
    phasor = samples[0] - samples[180] + 1j * (samples[270] - samples[90])
    part = 2 * ranges / unit / np.pi % 1  # of a quarter turn: two neighbouring samples are 1 - part and part
    expected = np.arctan2(part, 1 - part) - part * np.pi / 2
    return ranges, np.angle(phasor * np.exp(-1j * ranges / unit)) * unit, expected * unit


def _wiggling_claims(wiggling: Floats, expected: Floats) -> list[Claim]:
    largest, periods = np.abs(wiggling).max() * 1e3, int(np.argmax(np.abs(np.fft.rfft(wiggling))))
    off = np.abs(wiggling - expected).max() * 1e3
    first = np.abs(np.fft.rfft(wiggling)) ** 2
    share = first[4] / first[1:].sum()
    why = "the thesis: the error follows a sinusoidal shape; 9 of 10 parts of its power are one sine"
    return [
        judged("F-S-01", "power of the wiggling error in one sine", None, share, "", bool(share > 0.9), why),
        derived("N-S-035", "greatest wiggling error, rectangular signals at 17 MHz", largest, "mm"),
        derived("N-S-035", "periods of it in the unambiguous range", periods, ""),
        derived("S-EFF-01", "greatest difference from the closed form", off, "mm"),
    ]


def _errors(camera: CwCamera, scene: Scenario, seed: int) -> dict[str, Floats]:
    """Return, for each imperfection, by how much it changes the ranges of pixels that are valid with it, m."""
    warm = Temperature(drift_m_per_k=2e-3, temperature_c=35.0)
    everything = replace(imperfect(camera), link=Link(), taps=Taps(), temperature=warm)
    quiet = everything
    for name in (*_NOISE, "converter_limits"):
        quiet = IMPERFECTIONS[name](quiet)
    view, result = _looker(scene, camera, load_config("scaled_car").mounting), {}
    for name in (*_SHIFTS, *_NOISE):
        its = everything if name in _NOISE else quiet
        if name == "multipath":  # takes so long that the others do without
            its = replace(quiet, multipath=Multipath(two_bounces=True, block_pixels=8), exposure_samples=1)
        one, other = (_ranged(raw, camera) for raw in with_and_without(name, view, its, 0.1, seed))
        both = one.valid & other.valid
        result[name] = _wrapped(one.range_m[both] - other.range_m[both], camera)
    return result


def _looker(scene: Scenario, camera: CwCamera, mounting: Mounting) -> "partial[View]":
    bundle = ray_bundle(camera.lens, mounting, (camera.rows, camera.columns), scene.subpixels)
    return partial(render, scene, bundle=bundle)


def _ranged(raw: RawFrame, camera: CwCamera) -> RangeImage:
    return RANGING["cw_four_phase"](raw, camera)


def _wrapped(difference_m: Floats, camera: CwCamera) -> Floats:
    """Return a difference of ranges, the short way round the unambiguous range."""
    turn = 2 * np.pi * metres_per_radian(camera)
    result: Floats = (difference_m + turn / 2) % turn - turn / 2
    return result


def _caused(name: str, error_m: Floats) -> Claim:
    typical, large = np.percentile(np.abs(error_m), [50, 95]) * 1e3
    why = f"median of {len(error_m)} pixels, one of 20 over {large:.3g} mm; same noise with and without"
    return derived((_SHIFTS | _NOISE)[name], f"{name.replace('_', ' ')}: change of the range", typical, "mm", why)


def _cumulated(errors: dict[str, Floats]) -> list[Series]:
    shown = (*("wiggling", "fixed_pattern", "mixed_pixels", "multipath", "scattering"), "motion_between_exposures")
    part = np.linspace(0.1, 0.99, 90)
    curves = {name.replace("_", " "): np.quantile(np.abs(errors[name]), part) * 1e3 for name in shown}
    return [Series(name, np.maximum(curve, 0.1), part) for name, curve in curves.items()]


def _illumination(camera: CwCamera, scene: Scenario, seed: int) -> list[tuple[float, float, float]]:
    """Return the median noise, m, the part of valid and of saturated pixels for each illumination time."""
    rows = []
    view = _looker(scene, camera, load_config("scaled_car").mounting)
    for time_s in _ILLUMINATION_S:
        its = replace(camera, illumination_time_s=time_s, frame_rate_hz=10.0)
        image = _ranged(with_and_without("pseudo_rows", view, its, 0.1, seed)[0], its)
        rows.append((float(np.nanmedian(image.sigma_m)), float(image.valid.mean()), _saturated(image)))
    return rows


def _saturated(image: RangeImage) -> float:
    return float(np.mean(image.why == Why.SATURATED))


def _heights(camera: CwCamera, scene: Scenario, seed: int) -> list[tuple[float, float]]:
    """Return for each mounting height the part of saturated pixels and of those that stray light shifts by 50 mm."""
    rows = []
    scattering = replace(camera, scattering=Scattering(stray_fraction=STRAY_FRACTION))
    for height_m in _HEIGHTS_M:
        view = _looker(scene, camera, Mounting(z_m=height_m))
        raws = with_and_without("scattering", view, scattering, 0.1, seed)
        one, other = (_ranged(raw, camera) for raw in raws)
        both = one.valid & other.valid
        shift_m = np.abs(_wrapped(one.range_m[both] - other.range_m[both], camera))
        rows.append((_saturated(one), float(np.mean(shift_m > 0.05))))
    return rows


def _trade_claims(
    camera: CwCamera, by_time: list[tuple[float, float, float]], by_height: list[tuple[float, float]]
) -> list[Claim]:
    noises, parts, saturated = zip(*by_time, strict=True)
    falls = all(a > b for a, b in pairwise(noises)) and saturated[0] < saturated[-1]
    why = "noise falls with the illumination time, and saturation comes"
    claims = [
        judged("S-EFF-12", "noise at 0.25 ms over that at 16 ms", None, noises[0] / noises[-1], "", bool(falls), why),
        derived("S-EFF-12", "saturated pixels at 16 ms over all", saturated[-1], ""),
        derived("S-EFF-12", "valid pixels at 2 ms over all", parts[3], ""),
        judged(
            "S-EFF-14", "pixels that stray light shifts, at 5 cm over at 20 cm", None,
            by_height[0][1] / by_height[2][1], "", by_height[0][1] > by_height[2][1],
            "the thesis: near the ground scattering makes it worse, 20 cm is good",
        ),
    ]  # fmt: skip
    for mhz in (12, 30):
        ratio = metres_per_radian(replace(camera, modulation_hz=mhz * 1e6)) / metres_per_radian(camera)
        claims.append(derived("S-EFF-13", f"noise of the range at {mhz} MHz over that at 17 MHz", ratio, ""))
    return claims


def _time_panel(by_time: list[tuple[float, float, float]]) -> Panel:
    noises, parts, saturated = zip(*by_time, strict=True)
    times_ms = [time_s * 1e3 for time_s in _ILLUMINATION_S]
    series = [
        Series("median noise, m", times_ms, noises, line="-o"),
        Series("valid, part of the pixels", times_ms, parts, line="-o"),
        Series("saturated, part of the pixels", times_ms, saturated, line="-o"),
    ]
    return Panel("illumination time", "illumination time, ms", "m, and part of the pixels", series, "x")
