"""Retro-reflectors: where a pixel saturates, and what ranging with shifted pulses recovers, at which price."""

from dataclasses import replace

import numpy as np

from rangecam.pulsed import RANGING, simulate
from rangecam.pulsed.camera import laser_exposure, max_frame_rate_hz
from rangecam.pulsed.limits import expected_sigma_m, targets_on_axis
from rangecam.pulsed.pixel import responsivity
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.pulsed.signal import collected_s, exposures, shutter_windows
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import Ranged, looking_at, measured_edges, quiet, ranged
from rangecam.types import Floats, Why

RETRO = 300.0
_AT_M = np.arange(3.0, 20.5, 1.0) + 0.037
_REPEATS = 400


def pulsed_saturation(rng: np.random.Generator) -> Study:
    """Saturation treatment: retro-reflectors ranged by shifted pulses, its price in frame rate and accuracy.

    rng: of the simulated images.
    """
    usual = PulsedCamera(speed_of_light_mps=3e8)
    cameras = {"ideal edges": _fine(usual), "edges of the thesis": _coarse(usual)}
    found = {name: ranged(_AT_M, RETRO, camera, "shifted", _REPEATS, rng) for name, camera in cameras.items()}
    claims = [*_overlap(usual), *_saturates(usual), _lost(usual, rng)]
    for name, camera in cameras.items():
        expected_m = expected_sigma_m(_AT_M, RETRO, camera, "shifted")[0]
        mean_m, sigma_m, _, usable = found[name]
        off_m, ratio = float(np.abs(mean_m - _AT_M).max()), float(np.mean(sigma_m / expected_m))
        back = bool(usable.min() == 1 and off_m < 0.01)
        same = abs(ratio - 1) < 0.05
        claims += [
            judged(
                "K-ENV-07",
                f"300 times too bright, 3-20 m, {name}: largest error of the mean",
                None,
                off_m * 100,
                "cm",
                back,
                "every pixel is ranged, within 1 cm",
            ),
            judged("K-ENV-07", f"sigma_d simulated over calculated, {name}", 1, ratio, "", same, "within 5 %"),
            *_price(name, camera, usual, sigma_m),
        ]
    return Study("pulsed-saturation", "König 2008, 5.2.2", claims, _panels(cameras, found))


def _fine(camera: PulsedCamera) -> PulsedCamera:
    """Return the camera with delays close enough for ideal edges: two within 0.6 ns (N-K-094), from 2 to 20 m."""
    return replace(
        camera, shutters="b_delayed", delay_first_s=-134e-9, delay_step_s=0.3e-9, delay_count=410, pixel=_once(camera)
    )


def _coarse(camera: PulsedCamera) -> PulsedCamera:
    """Return the camera with the edges of the thesis, whose toe leaves the pixel free for much longer."""
    return replace(
        measured_edges(camera),
        shutters="b_delayed",
        delay_first_s=-215e-9,
        delay_step_s=8e-9,
        delay_count=25,
        pixel=_once(camera),
    )


def _once(camera: PulsedCamera) -> Pixel:
    return replace(camera.pixel, accumulations=(1,))


def _overlap(camera: PulsedCamera) -> list[Claim]:
    """Return how much of the pulse may fall into window b to keep the pixel at full scale, 300 times too bright."""
    window = shutter_windows(camera)["b"]
    late_s = np.linspace(0.0, 2e-9, 2001)
    overlap_s = float(np.interp(1.0, RETRO * collected_s(late_s, window, camera) / camera.pulse_width_s, late_s))
    text = "overlap that keeps a pixel at full scale, 300 times too bright"
    range_cm = camera.speed_of_light_mps / 2 * overlap_s * 100
    why = "0.60 ns of 180 ns: the pattern needs small steps"
    return [
        judged("N-K-094", text, None, overlap_s * 1e9, "ns", abs(overlap_s - 0.6e-9) < 5e-12, why),
        derived("N-K-094", "range that this is", range_cm, "cm"),
    ]


def _saturates(camera: PulsedCamera) -> list[Claim]:
    on_axis, view = targets_on_axis([1.0], 1.0, camera)
    at_1_m = responsivity(camera.pixel) * float(
        laser_exposure(view, shutter_windows(camera)["c"], 0.0, replace(on_axis, shutters="ab"))[0, 0]
    )
    claims = []
    for reflectivity in (1.0, 0.5, 0.05, 100.0):
        limit_m = float(np.sqrt(reflectivity * at_1_m / camera.pixel.saturation_v))
        claims.append(
            derived("N-K-095", f"reflectivity {reflectivity:g} saturates one accumulation up to", limit_m, "m")
        )
    return claims


def _lost(camera: PulsedCamera, rng: np.random.Generator) -> Claim:
    many, view = targets_on_axis(_AT_M, RETRO, camera)
    image = RANGING["mdsi3"](simulate(looking_at(view), many, 0.0, rng), many)
    share = 100 * float(np.mean(image.why == Why.SATURATED))
    return judged("K-ENV-07", "of them saturated for MDSI3, 3-20 m", None, share, "%", share == 100, "all")


def _price(name: str, camera: PulsedCamera, usual: PulsedCamera, sigma_m: Floats) -> list[Claim]:
    """Return what the treatment costs: images a second with it beside the usual ones, and sigma at equal signals."""
    alone_hz, usual_hz = max_frame_rate_hz(camera), max_frame_rate_hz(usual)
    both_hz = 1 / (1 / alone_hz + 1 / usual_hz)
    # MDSI3 with one accumulation, in a pixel that would hold all of the light.
    deep = replace(usual, pixel=replace(_once(usual), saturation_v=1e5, adc_bits=0))
    mdsi3_m = expected_sigma_m(_AT_M, RETRO, deep)[0]
    slow = "the thesis found it too slow for the standard firmware; ideal edges need many small steps, soft ones few"
    worse = float(np.median(sigma_m / mdsi3_m))
    drops = "accuracy drops, as 5.2.2 says; the light makes it small nevertheless"
    text = f"sigma_d over that of MDSI3 in a pixel that would hold the light, {name}: median"
    return [
        judged("K-ENV-07", f"images a second with it, {name}", None, both_hz, "Hz", both_hz < usual_hz, slow),
        derived("K-ENV-07", f"delays of the laser that it takes, 2-20 m, {name}", len(exposures(camera)), ""),
        derived("K-ENV-07", f"sigma_d at 20 m, {name}", 100 * sigma_m[-1], "cm"),
        judged("K-ENV-07", text, None, worse, "", worse > 1, drops),
    ]


def _panels(cameras: dict[str, PulsedCamera], found: dict[str, Ranged]) -> list[Panel]:
    signals, errors = [], []
    for i, (name, camera) in enumerate(cameras.items()):
        for rho, line in ((RETRO, "-"), (1.0, "--")):
            one, view = targets_on_axis([10.0], rho, quiet(camera))
            raw = simulate(looking_at(view), one, 0.0, np.random.default_rng(0))
            volts = [float(raw.planes[f"shutter_b_{k}"][0, 0]) for k in range(camera.delay_count)]
            at_ns = 1e9 * (camera.delay_first_s + camera.delay_step_s * np.arange(camera.delay_count))
            signals.append(Series(f"reflectivity {rho:g}, {name}", at_ns, volts, line=line, colour=i))
        result = found[name]
        expected_m = expected_sigma_m(_AT_M, RETRO, camera, "shifted")[0]
        errors += [
            Series(name, _AT_M, 100 * result.sigma_m, 100 * result.sigma_m / np.sqrt(2 * (_REPEATS - 1)), colour=i),
            Series("", _AT_M, 100 * expected_m, colour=i),
        ]
    title = "300 times white; points: simulated, ±2σ"
    return [
        Panel("Target at 10 m", "laser delay (ns)", "signal of window b (V)", signals),
        Panel(title, "range (m)", "standard deviation of the range (cm)", errors),
    ]
