"""Ambient light on the pulsed camera: how strong beside the laser, what double sampling leaves, what a filter does."""

from dataclasses import replace

import numpy as np

from rangecam.optics import band_share
from rangecam.pulsed.camera import ambient_irradiance, laser_exposure
from rangecam.pulsed.limits import targets_on_axis
from rangecam.pulsed.pixel import photon_noise, responsivity
from rangecam.pulsed.settings import Background, PulsedCamera
from rangecam.pulsed.signal import shutter_windows
from rangecam.scene.scenario import AMBIENT_WPM2
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import Ranged, ranged
from rangecam.types import Floats

BAND_M = (880e-9, 930e-9)
"""Of a band-pass filter of 50 nm about the laser."""
SUN_K = 5778.0
_AT_M = np.array([3.0, 5.0, 8.0, 12.0, 16.0])
_REFLECTIVITY = 0.5
_REPEATS = 1500
_IMAGES, _PIXELS = 60, 400


def pulsed_ambient(rng: np.random.Generator) -> Study:
    """Ambient light: its strength beside the laser, its shot noise, what correlated double sampling leaves of it.

    rng: of the simulated images.
    """
    camera = PulsedCamera(speed_of_light_mps=3e8)
    filtered = replace(camera.objective, ambient_transmission=band_share(BAND_M, SUN_K))
    found = {
        "darkness": _measured(camera, 0.0, rng),
        "full sun": _measured(camera, AMBIENT_WPM2["sun"], rng),
        "full sun, 50 nm filter": _measured(replace(camera, objective=filtered), AMBIENT_WPM2["sun"], rng),
    }
    sources = _sources(camera, filtered.ambient_transmission)
    claims = [*_strength(camera), *_double_sampling(found), *_varying(camera, rng), *sources]
    return Study("pulsed-ambient", "König 2008, 5.2.1.2", claims, [_light_panel(camera), _sigma_panel(found)])


def _measured(camera: PulsedCamera, ambient_wpm2: float, rng: np.random.Generator) -> Ranged:
    return ranged(_AT_M, _REFLECTIVITY, camera, "mdsi3", _REPEATS, rng, ambient_wpm2)


def _on_sensor(camera: PulsedCamera, range_m: float, ambient_wpm2: float) -> tuple[float, float]:
    """Return what laser and ambient light make on the sensor by way of a white target, W/m2."""
    on_axis, view = targets_on_axis([range_m], 1.0, camera)
    view = replace(view, ambient_wpm2=ambient_wpm2)
    whole = laser_exposure(view, shutter_windows(camera)["c"], 0.0, on_axis)
    return float(whole[0, 0]) / camera.pulse_width_s, float(ambient_irradiance(view, on_axis)[0, 0])


def _strength(camera: PulsedCamera) -> list[Claim]:
    near, sun = _on_sensor(camera, 2.0, AMBIENT_WPM2["sun"])
    far, _ = _on_sensor(camera, 20.0, 0.0)
    charge_v = responsivity(camera.pixel) * sun * camera.pulse_width_s
    noise_mv = float(np.sqrt(2) * photon_noise(charge_v, camera.pixel)) * 1e3
    why = "a multiple in the near range only, with one 2 kW module and the unfiltered sun on white (E-K-16)"
    small = "well below the 1.5 V of the pixel, so that double sampling works"
    below = "below the noise of one accumulation, 0.379 mV"
    return [
        derived("N-K-098", "full sun on a white target, on the sensor", sun, "W/m2"),
        judged("N-K-098", "laser over it at 2 m: a multiple", None, near / sun, "", near > 2 * sun, why),
        judged("N-K-098", "laser over it at 20 m: a multiple", None, far / sun, "", far > 2 * sun, why),
        derived("N-K-098", "range at which both are equal", 2.0 * float(np.sqrt(near / sun)), "m"),
        judged("N-K-098", "its signal in a window of 180 ns", None, charge_v * 1e3, "mV", charge_v < 0.3, small),
        judged("N-K-098", "shot noise of it, laser on and off", None, noise_mv, "mV", noise_mv < 0.379, below),
    ]


def _double_sampling(found: dict[str, Ranged]) -> list[Claim]:
    sun, dark, clear = found["full sun"], found["darkness"], found["full sun, 50 nm filter"]
    error_m = sun.sigma_m / np.sqrt(_REPEATS)
    off = float((np.abs(sun.mean_m - _AT_M) / (error_m + 2e-3)).max())
    worse, filtered = float((sun.sigma_m / dark.sigma_m).max()), float((clear.sigma_m / dark.sigma_m).max())
    return [
        judged("K-ENV-01", "bias by the full sun, 3-16 m, over its standard error", 0, off, "", off < 4, "below 4"),
        derived("K-ENV-01", "sigma_d in the full sun over that in darkness, 3-16 m: largest", worse, ""),
        derived("K-ENV-01", "the same behind a filter of 50 nm", filtered, ""),
    ]


def _varying(camera: PulsedCamera, rng: np.random.Generator) -> list[Claim]:
    """Return how the range wanders from image to image in light that changes, the same for all pixels."""
    claims = []
    for correlation_s in (10e-3, 10e-6):
        flicker = replace(camera, background=Background(fluctuation=0.1, correlation_s=correlation_s))
        images = [
            ranged([8.0], _REFLECTIVITY, flicker, "mdsi3", _PIXELS, rng, AMBIENT_WPM2["sun"]).mean_m[0]
            for _ in range(_IMAGES)
        ]
        text = f"wandering of the range at 8 m with a sun that varies by 10 % within {correlation_s * 1e3:g} ms"
        why = "light must be correlated over the two exposures, here 0.8 us apart, under 10 us in 4.1.1.2"
        claims.append(derived("K-ENV-01", text, 100 * float(np.std(images)), "cm", why))
    return claims


def _sources(camera: PulsedCamera, share: float) -> list[Claim]:
    claims = [derived("K-ENV-01", "part of the sun's light that a filter of 880-930 nm leaves", share * 100, "%")]
    for name in ("street_light", "headlights"):
        laser, ambient = _on_sensor(camera, 20.0, AMBIENT_WPM2[name])
        text = f"laser over {name.replace('_', ' ')} at 20 m"
        claims.append(judged("K-ENV-01", text, None, laser / ambient, "", laser > 2 * ambient, "a multiple"))
    return claims


def _light_panel(camera: PulsedCamera) -> Panel:
    range_m = np.geomspace(1.0, 25.0, 60)
    laser: Floats = _on_sensor(camera, 1.0, 0.0)[0] / range_m**2
    series = [Series("laser, one 2 kW module", range_m, laser)]
    for name, label in (("sun", "full sun"), ("headlights", "headlights, 100 lx"), ("street_light", "street, 20 lx")):
        level = _on_sensor(camera, 1.0, AMBIENT_WPM2[name])[1]
        series.append(Series(label, range_m, np.full(range_m.shape, level), line="--"))
    return Panel("White target", "range (m)", "irradiance of the sensor (W/m²)", series, "xy")


def _sigma_panel(found: dict[str, Ranged]) -> Panel:
    series = [
        Series(name, _AT_M, 100 * one.sigma_m, 100 * one.sigma_m / np.sqrt(2 * (_REPEATS - 1)))
        for name, one in found.items()
    ]
    title = f"Reflectivity {_REFLECTIVITY:g}, MDSI3; simulated, ±2σ"
    return Panel(title, "range (m)", "standard deviation of the range (cm)", series)
