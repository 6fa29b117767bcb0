"""The microcontroller's integer chain beside exact ranging of the same frames: where and by how much they differ."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rangecam.cameras.simulated import frames
from rangecam.clean import CleanSettings, clean
from rangecam.config import Config, load_config
from rangecam.cw import RANGING
from rangecam.cw.register_map import PRINTED
from rangecam.cw.registers import FRAME_DELAY_TICK_S, PIXEL_CLOCK_HZ, SENSOR_COLUMNS, SENSOR_ROWS, apply, modulation_hz
from rangecam.cw.sequence import fastest_frame_rate_hz
from rangecam.cw.settings import CwCamera
from rangecam.geometry import Mounting
from rangecam.scene.scenario import load_scenario
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed
from rangecam.types import Capture, Floats, RangeImage, Why

FRAMES = 6
_ARITHMETIC: dict[str, Any] = {
    **{"amplitude_threshold": 0.0, "wrap_threshold": 0.0, "common_neighbours": 0, "median": False, "border": "keep"},
    **{"angles": "lens", "speed_of_light_mps": 299_792_458.0},
}
"""All filters off and nothing approximated: what is left is the arithmetic."""


def emulation(rng: np.random.Generator) -> Study:
    """The microcontroller's integers beside exact ranging: what the arithmetic costs, and which pixels differ, why.

    rng: of the noise of the simulated frames.
    """
    config = load_config("scaled_car_emulation", {"camera": {"pseudo_rows": 0}})
    camera = _camera(config)
    scene = replace(load_scenario("test-scene"), duration_s=FRAMES / 30)
    captures = list(frames(scene, config, int(rng.integers(1 << 31))))
    steps = _arithmetic(captures, camera)
    exact = [_exactly(capture, camera) for capture in captures]
    integers = [RANGING["cw_emulation"](capture.raw, camera) for capture in captures]
    claims = [*_registers(), *_arithmetic_claims(steps), *_chain_claims(captures, exact, integers)]
    return Study("emulation", "Steinbäck 2016, 4.3.2, 4.5 and A.10", claims, _panels(steps, exact, integers))


def _camera(config: Config) -> CwCamera:
    assert isinstance(config.camera, CwCamera)
    return config.camera


def _exactly(capture: Capture, camera: CwCamera) -> RangeImage:
    """Return the frame's range image in floating point, with the filters that the microcontroller has."""
    same = camera.emulation
    settings = CleanSettings(
        amplitude_threshold=same.amplitude_threshold,
        wrap_threshold=same.wrap_threshold,
        min_neighbours=same.common_neighbours,
        neighbour_tolerance_m=same.neighbour_tolerance_mm / 1e3,
        neighbour_tolerance_sigmas=0.0,
        discard_border=same.border == "discard",
        median_across_edges=True,
    )
    return clean(RANGING["cw_four_phase"](capture.raw, camera), camera.lens, Mounting(), settings)


def _arithmetic(captures: list[Capture], camera: CwCamera) -> dict[str, tuple[Floats, Floats]]:
    """Return the range and what the integers differ from the exact one, m, with one property after another as it is."""
    kinds: dict[str, dict[str, Any]] = {
        "integers": {},
        "speed of light 3e8": {"speed_of_light_mps": 3e8},
        "angles by the table": {"angles": "table"},
    }
    found: dict[str, tuple[Floats, Floats]] = {}
    for name, kind in kinds.items():
        settings = replace(camera, emulation=replace(camera.emulation, **(_ARITHMETIC | kind)))
        ranges, differences = [], []
        for capture in captures:
            exact = RANGING["cw_four_phase"](capture.raw, camera)
            difference = RANGING["cw_emulation"](capture.raw, settings).range_m - exact.range_m
            ranges.append(exact.range_m[exact.valid])
            differences.append(difference[exact.valid])
        found[name] = (np.concatenate(ranges), np.concatenate(differences))
    return found


def _registers() -> list[Claim]:
    """Return what the printed registers say, and the times that follow."""
    contents = dict(PRINTED)
    camera = apply(PRINTED, _camera(load_config("scaled_car")))
    presets = {k: modulation_hz([contents[f"CFGCNT_PLLCFG{i}_LUT{k}"] for i in (1, 2, 3)]) / 1e6 for k in (1, 2, 3, 4)}
    claims = [printed(f"N-S-021.LUT{k}", f"PLL preset {k}", text, presets[k], "MHz") for k, text in _STATED.items()]
    claims.append(derived("N-S-021.LUT4", "PLL preset 4", presets[4], "MHz", "the thesis does not state it"))
    read_out_ms = camera.rows * camera.columns / PIXEL_CLOCK_HZ * 1e3
    before_ms = SENSOR_ROWS * SENSOR_COLUMNS * (240 * 320) / (288 * 352) / PIXEL_CLOCK_HZ * 1e3
    why = f"a pixel a clock takes {read_out_ms:.3f} ms, {before_ms:.3f} ms before binning: kept as measured (E-S-14)"
    fastest, clock = fastest_frame_rate_hz(camera), PIXEL_CLOCK_HZ / 8e6
    return [
        *claims,
        printed("N-S-020", "illumination time, EXPOTIME 0x109A", "2", camera.illumination_time_s * 1e3, "ms"),
        derived("N-S-022", "unit of FRAMERATE that makes 30 frames a second", FRAME_DELAY_TICK_S * 1e6, "us", _SISTER),
        printed("N-S-023", "rows of the image", "120", camera.rows, ""),
        printed("N-S-023", "columns of the image", "160", camera.columns, ""),
        judged("N-S-018", "read-out of a phase image at 66.6 MHz", 1.23, read_out_ms, "ms", False, why),
        derived("N-S-019.2", "frames a second without a pause, 2 ms of light", fastest, "Hz"),
        judged(
            "N-S-041", "pixel clock over 8", 8.33, clock, "MHz", abs(clock - 8.33) < 0.006, "66.6 MHz over 8 (E-S-32)"
        ),
        derived("N-S-053", "writes before the first image", len(PRINTED), ""),
    ]


_SISTER = "open (E-S-33): with the 12.92 ms of four exposures and read-outs; a sister sensor counts 7.68 us"
_STATED = {1: "12", 2: "30", 3: "17"}


def _arithmetic_claims(steps: dict[str, tuple[Floats, Floats]]) -> list[Claim]:
    claims = []
    for name, (_, difference) in steps.items():
        claims.append(derived("S-DST-06", f"{name}: mean difference to exact ranging", difference.mean() * 1e3, "mm"))
        largest = np.abs(difference).max() * 1e3
        claims.append(derived("S-DST-06", f"{name}: largest difference", largest, "mm"))
    _, cut = steps["integers"]
    inside = bool(np.all((cut > -2.1e-3) & (cut < 1e-3)))
    why = "one millimetre is cut, and half of one rounded; both divided by the cosine of up to 50 degrees"
    largest = float(np.abs(cut).max() * 1e3)
    return [*claims, judged("S-DST-06", "integers: no difference beyond rounding", None, largest, "mm", inside, why)]


def _chain_claims(captures: list[Capture], exact: list[RangeImage], integers: list[RangeImage]) -> list[Claim]:
    """Return which pixels only one of the chains keeps, by the other's reason, and how far they are off."""
    both = np.stack([e.valid & i.valid for e, i in zip(exact, integers, strict=True)])
    e_m, i_m = (np.stack([image.range_m for image in images])[both] for images in (exact, integers))
    truth_m = np.stack([capture.truth.range_m for capture in captures if capture.truth is not None])[both]
    near = np.isfinite(truth_m) & (np.abs(e_m - truth_m) < 0.5)  # edges aside, where the truth jumps
    claims = [
        derived("S-PRE-07", "pixels that both chains keep", both.mean() * 100, "%", "the test scene of 5.1.1"),
        derived("S-PRE-07", "RMS difference of these", float(np.sqrt(np.mean((e_m - i_m) ** 2))) * 1e3, "mm", _UPPER),
        derived("S-PRE-07", "median difference of these", float(np.median(i_m - e_m)) * 1e3, "mm", _UPPER),
        derived("S-PRE-07", "RMS error of the integers", _rms_mm(i_m - truth_m, near), "mm", "pixels near the truth"),
        derived("S-PRE-07", "RMS error of the exact chain", _rms_mm(e_m - truth_m, near), "mm", "the same pixels"),
    ]
    for text, kept, refused in (
        ("exact alone keeps", exact, integers),
        ("integers alone keep", integers, exact),
    ):
        share = _only(kept, refused)
        for reason, percent in share.items():
            claims.append(derived("S-PRE-07", f"{text}: the other says {reason}", percent, "%", "of all pixels"))
    return claims


_UPPER = "the integer median takes the upper one of two; c = 3e8, angles half a pixel off, cut millimetres"


def _rms_mm(error_m: Floats, chosen: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(error_m[chosen] ** 2))) * 1e3


def _only(kept: list[RangeImage], refused: list[RangeImage]) -> dict[str, float]:
    """Return the share of pixels, %, that are valid in the first images alone, by the reason in the others."""
    reasons = np.concatenate([r.why[k.valid & ~r.valid] for k, r in zip(kept, refused, strict=True)])
    total = sum(image.why.size for image in kept)
    return {
        Why(int(code)).name: 100 * float(np.mean(reasons == code)) * reasons.size / total for code in np.unique(reasons)
    }


def _panels(
    steps: dict[str, tuple[Floats, Floats]], exact: list[RangeImage], integers: list[RangeImage]
) -> list[Panel]:
    arithmetic = []
    for name, (range_m, difference) in steps.items():
        chosen = np.argsort(range_m)[:: max(1, range_m.size // 1500)]
        arithmetic.append(Series(name, range_m[chosen], difference[chosen] * 1e3, line="."))
    both = exact[0].valid & integers[0].valid
    e_m, i_m = exact[0].range_m, integers[0].range_m
    edges = np.linspace(-40, 40, 81)
    counts, _ = np.histogram((i_m - e_m)[both] * 1e3, edges)
    names = [why.name for why in Why if np.any([image.why == why for image in (*exact, *integers)])]
    shares = [
        [100 * float(np.mean([np.mean(image.why == Why[name]) for image in images])) for name in names]
        for images in (exact, integers)
    ]
    words = [f"{k}: {name.lower().replace('_', ' ')}" for k, name in enumerate(names)]
    reasons = "\n".join("; ".join(words[k : k + 4]) for k in range(0, len(words), 4))
    return [
        Panel("The arithmetic alone, without filters", "range (m)", "integers less exact (mm)", arithmetic),
        Panel("Whole chain, pixels that both keep", "integers less exact (mm)", "pixels", [_steps("", edges, counts)]),
        Panel(
            "Reasons",
            reasons,
            "pixels (%)",
            [
                Series("exact", np.arange(len(names)) - 0.08, shares[0], line="o"),
                Series("integers", np.arange(len(names)) + 0.08, shares[1], line="s"),
            ],
        ),
    ]


def _steps(label: str, edges: Floats, counts: Floats) -> Series:
    """Return a histogram as a line."""
    return Series(label, np.repeat(edges, 2)[1:-1], np.repeat(counts, 2))
