"""The camera that looks at a simulated scene, of whatever family the configuration says."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rangecam import cw, processed, pulsed
from rangecam.config import Config
from rangecam.processed import ProcessedCamera
from rangecam.scene.render import RayBundle, ego_at, ray_bundle, render, truth
from rangecam.scene.scenario import Scenario
from rangecam.scene.view import View
from rangecam.scene.weather import in_weather, precipitation
from rangecam.types import Capture, RawFrame


def _simulate_processed(
    view: Callable[[float], View], camera: ProcessedCamera, time_s: float, rng: np.random.Generator
) -> RawFrame:
    return processed.simulate(view(time_s), camera, time_s, rng)


SIMULATE: dict[str, Callable[..., RawFrame]] = {
    "cw": cw.simulate,
    "pulsed": pulsed.simulate,
    "processed": _simulate_processed,
}
"""Forward models by the `kind` of camera settings: (view at a time, camera, time_s, rng) -> RawFrame."""


def frames(scenario: Scenario, config: Config, seed: int = 0) -> Iterator[Capture]:
    """Yield the captures of a camera that looks at `scenario`, with the truth at the middle of each exposure.

    Frame k is centred on k / frame rate and the same for the same seed whatever came before it.
    """
    camera, shape = config.camera, (config.camera.rows, config.camera.columns)
    bundle = ray_bundle(camera.lens, config.mounting, shape, scenario.subpixels)
    rate_hz = scenario.frame_rate_hz or camera.frame_rate_hz
    for k in range(max(1, round(scenario.duration_s * rate_hz))):
        time_s = k / rate_hz
        looks = look(scenario, config, bundle, time_s, np.random.default_rng([seed, k, 1]))
        raw = SIMULATE[camera.kind](looks, camera, time_s, np.random.default_rng([seed, k]))
        yield Capture(
            replace(raw, frame_id=k),
            ego_at(scenario.ego, time_s),
            truth(scenario, time_s, camera.lens, config.mounting, shape),
        )


def look(
    scenario: Scenario, config: Config, bundle: RayBundle, time_s: float, rng: np.random.Generator
) -> Callable[[float], View]:
    """Return what the camera sees of the scenario through its weather, as a function of the time near `time_s`.

    The field of drops is drawn anew for `time_s`, and falls from there on.
    """
    weather = scenario.weather
    if not (weather.rain_mm_per_h or weather.snow_mm_per_h or weather.drops):
        return lambda at_s: render(scenario, at_s, bundle)
    camera, mounting = config.camera, config.mounting
    speed_mps = ego_at(scenario.ego, time_s).speed_mps or 0.0
    falling = precipitation(weather, camera.lens, mounting, (camera.rows, camera.columns), rng, speed_mps)

    def seen(at_s: float) -> View:
        return in_weather(render(scenario, at_s, bundle), falling, weather, camera.lens, mounting, at_s - time_s)

    return seen
