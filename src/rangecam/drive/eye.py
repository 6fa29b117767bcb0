"""The camera of a drive: takes its frames while the vehicle moves, and hands them over when they are read out."""

import heapq
import itertools
from collections.abc import Iterator

import numpy as np

from rangecam.cameras.simulated import SIMULATE, frame, look
from rangecam.config import Camera, Config
from rangecam.cw.sequence import fastest_frame_rate_hz
from rangecam.drive.faults import arrivals, kept
from rangecam.drive.settings import DriveSettings
from rangecam.pulsed.feasible import max_frame_rate_hz
from rangecam.scene.paths import OwnMotion
from rangecam.scene.render import ray_bundle
from rangecam.scene.scenario import Scenario
from rangecam.types import Capture
from rangecam.values import changed


def sequence_s(camera: Camera) -> float:
    """Return how long a frame takes from the start of its first exposure to the end of its last read-out."""
    if camera.kind == "cw":
        return 1 / fastest_frame_rate_hz(camera)
    return 1 / max_frame_rate_hz(camera) if camera.kind == "pulsed" else 0.0


_AT_A_TIME = 32


def _generators(seed: int) -> Iterator[np.random.Generator]:
    """Yield the generator of the noise of each frame, as `cameras.simulated.frame` makes it.

    Many are made at a time: alone, between all else that a frame needs, one takes five times as long.
    """
    for first in itertools.count(0, _AT_A_TIME):
        yield from [np.random.default_rng([seed, number]) for number in range(first, first + _AT_A_TIME)]


class Eye:
    """Takes frame k with the middle of its exposures at (k + 1) / rate after `start_s`, where the vehicle is by `own`.

    with_truth: captures carry the truth, which costs as much as a look at the scene.
    """

    def __init__(
        self, scenario: Scenario, config: Config, settings: DriveSettings, seed: int, own: OwnMotion, with_truth: bool
    ) -> None:
        self._scene, self._config, self._settings, self._seed, self._own = scenario, config, settings, seed, own
        self._with_truth, self._next = with_truth, 0
        self._period_s = 1 / config.camera.frame_rate_hz
        self._sequence_s, self._noise = sequence_s(config.camera), _generators(seed)
        shape = config.camera.rows, config.camera.columns
        self._bundle = ray_bundle(config.camera.lens, config.mounting, shape, scenario.subpixels)
        self._held: Capture | None = None
        self._under_way: list[tuple[float, int, Capture]] = []

    def arrived(self, time_s: float) -> Iterator[tuple[float, Capture]]:
        """Yield what has arrived by `time_s` and when, in order of arrival."""
        while self._middle_s(self._next) + self._sequence_s / 2 <= time_s:
            capture, ready_s = self._take(self._next), self._middle_s(self._next) + self._sequence_s / 2
            faults = self._settings.faults
            self._held = capture if self._held is None else kept(capture, self._held, faults)
            for at_s, each in arrivals(capture, ready_s, self._held, faults, self._config):
                heapq.heappush(self._under_way, (at_s, len(self._under_way) + 1000 * self._next, each))
            self._next += 1
        while self._under_way and self._under_way[0][0] <= time_s:
            at_s, _, capture = heapq.heappop(self._under_way)
            yield at_s, capture

    def _middle_s(self, number: int) -> float:
        return (number + 1) * self._period_s - self._settings.run_in_s

    def _take(self, number: int) -> Capture:
        scenario, config, time_s = self._scene, self._config, self._middle_s(number)
        if self._with_truth:
            return frame(scenario, config, number, time_s, self._seed, self._own)
        looks = look(scenario, config, self._bundle, time_s, (self._seed, number, 1), self._own)
        raw = SIMULATE[config.camera.kind](looks, config.camera, time_s, next(self._noise))
        return Capture(changed(raw, frame_id=number))
