"""The camera that looks at a simulated scene, of whatever family the configuration says."""

from collections.abc import Callable, Iterator

import numpy as np

from rangecam import cw, processed, pulsed
from rangecam.config import Config
from rangecam.processed import ProcessedCamera
from rangecam.scene.paths import OwnMotion
from rangecam.scene.render import RayBundle, ego_of, own_pose, ray_bundle, render, truth
from rangecam.scene.scenario import Scenario
from rangecam.scene.view import View
from rangecam.scene.weather import clouds, in_weather, joined, precipitation
from rangecam.types import Capture, RawFrame
from rangecam.values import changed


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


def frames(scenario: Scenario, config: Config, seed: int = 0, own: OwnMotion | None = None) -> Iterator[Capture]:
    """Yield the captures of a camera that looks at `scenario`, with the truth at the middle of each exposure.

    Frame k is centred on k / frame rate and the same for the same seed whatever came before it. `own` replaces the own
    motion of the scenario; it is asked when a frame is.
    """
    rate_hz = scenario.frame_rate_hz or config.camera.frame_rate_hz
    for k in range(max(1, round(scenario.duration_s * rate_hz))):
        yield frame(scenario, config, k, k / rate_hz, seed, own)


def frame(
    scenario: Scenario, config: Config, frame_id: int, time_s: float, seed: int, own: OwnMotion | None = None
) -> Capture:
    """Return the one capture centred on `time_s`; `seed` and `frame_id` make its noise."""
    camera, shape = config.camera, (config.camera.rows, config.camera.columns)
    bundle = ray_bundle(camera.lens, config.mounting, shape, scenario.subpixels)
    looks = look(scenario, config, bundle, time_s, (seed, frame_id, 1), own)
    raw = SIMULATE[camera.kind](looks, camera, time_s, np.random.default_rng([seed, frame_id]))
    return Capture(
        changed(raw, frame_id=frame_id),
        ego_of(own_pose(scenario, time_s, own), time_s),
        truth(scenario, time_s, camera.lens, config.mounting, shape, own),
    )


def look(
    scenario: Scenario,
    config: Config,
    bundle: RayBundle,
    time_s: float,
    seeds: tuple[int, ...],
    own: OwnMotion | None = None,
) -> Callable[[float], View]:
    """Return what the camera sees of the scenario through its weather, as a function of the time near `time_s`.

    The field of drops is drawn anew for `time_s`, by a generator of `seeds`, and falls from there on.
    """
    weather = scenario.weather
    if not (weather.rain_mm_per_h or weather.snow_mm_per_h or weather.drops or weather.clouds):
        return lambda at_s: render(scenario, at_s, bundle, own)
    camera, mounting = config.camera, config.mounting
    pose, rng = own_pose(scenario, time_s, own), np.random.default_rng(seeds)
    falling = precipitation(weather, camera.lens, mounting, (camera.rows, camera.columns), rng, pose.speed_mps)
    falling = joined(falling, clouds(weather, time_s, pose, rng))

    def seen(at_s: float) -> View:
        return in_weather(render(scenario, at_s, bundle, own), falling, weather, camera.lens, mounting, at_s - time_s)

    return seen
