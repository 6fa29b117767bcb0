"""What `rangecam bench` measures: the stages of both theses' chains, chains, tracker, simulation and closed loop."""

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from rangecam import cw, pulsed
from rangecam.bench import peers, unwrapping_peer
from rangecam.bench.race import Row, race
from rangecam.clean import clean
from rangecam.config import Config, load_config
from rangecam.cw.imperfections import imperfect
from rangecam.drive.loop import drive
from rangecam.drive.opening import opened
from rangecam.io import open_source
from rangecam.motion import Mode, MotionSettings
from rangecam.pipeline import RANGING, call, process_frame
from rangecam.scene.view import View
from rangecam.segmentation import SEGMENTATION
from rangecam.tracking import update_tracks
from rangecam.types import Capture, RangeImage, Segments, Tracks

Maker = Callable[..., Callable[..., Any]]


@dataclass(frozen=True)
class Moment:
    """One frame in the middle of a scenario, with the tracks that came before it."""

    config: Config
    capture: Capture
    tracks: Tracks


def measure(seconds: float) -> dict[str, Any]:
    """Time everything, about `seconds` a row, and return JSON values: rows and the machine."""
    rows = [
        row
        for family in (
            _continuous_wave,
            _three_frequencies,
            _pulsed,
            _tracker,
            _segmentation,
            _simulation,
            _closed_loop,
        )
        for row in family(seconds)
    ]
    return {
        "rows": [
            {
                "work": r.work,
                "ms": round(r.ms, 5),
                "peer": r.peer,
                "peer_ms": _rounded(r.peer_ms),
                "ratio": _rounded(r.ratio),
            }
            for r in rows
        ],
        "machine": f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}, one thread",
    }


def table(result: dict[str, Any]) -> str:
    """Return the rows as lines for people."""
    lines = [result["machine"], f"{'work':34}{'ms':>9}{'peer ms':>10}{'ratio':>8}  peer"]
    for row in result["rows"]:
        numbers = "".join(
            f"{row[key]:>{width}.{digits}f}" if row[key] is not None else f"{'-':>{width}}"
            for key, width, digits in (("ms", 9, 4), ("peer_ms", 10, 4), ("ratio", 8, 1))
        )
        lines.append(f"{row['work']:34}{numbers}  {row['peer']}")
    return "\n".join(lines)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 5)


def _peer(package: str, name: str, make: Maker, *arguments: Any) -> tuple[str, Callable[..., Any] | None]:
    """Return the peer's name and function, or that it is not installed."""
    if find_spec(package) is None:
        return f"{name}: not installed (pip install rangecam[bench])", None
    return name, make(*arguments)


def _given(function: Callable[..., Any] | None, *arguments: Any) -> Callable[[], Any] | None:
    return None if function is None else partial(function, *arguments)


def _moment(url: str, number: int, *layers: dict[str, Any]) -> Moment:
    source = open_source(url, layers=layers)
    tracks = Tracks.empty()
    for capture, _ in zip(source.captures, range(number), strict=False):
        tracks = process_frame(capture.raw, tracks, capture.ego, source.config).tracks
    return Moment(source.config, capture, _one_step_back(tracks, capture.raw.time_s, source.config))


def _one_step_back(tracks: Tracks, time_s: float, config: Config) -> Tracks:
    """Let the tracks be those of one frame ago, so that the same frame can be processed again and again."""
    return replace(tracks, time_s=time_s - 1 / config.camera.frame_rate_hz)


def _stages(name: str, moment: Moment, seconds: float) -> Iterator[Row]:
    """Yield a row for each stage of the chain."""
    calls: dict[str, Callable[[], Any]] = {}

    def keep(stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        calls[stage] = partial(function, *arguments)
        return calls[stage]()

    process_frame(moment.capture.raw, moment.tracks, moment.capture.ego, moment.config, keep)
    for stage, function in calls.items():
        yield race(f"{name}: {stage}", function, "", None, seconds / 4)


def _chain(moment: Moment) -> Callable[[], Any]:
    return partial(process_frame, moment.capture.raw, moment.tracks, moment.capture.ego, moment.config)


def _cleaned_range(moment: Moment) -> RangeImage:
    config = moment.config
    image = call("ranging", RANGING[config.ranging], moment.capture.raw, config.camera)
    return clean(image, config.camera.lens, config.mounting, config.clean)


def _continuous_wave(seconds: float) -> Iterator[Row]:
    for height, width in ((120, 160), (480, 640)):
        moment = _moment("scenario:test-scene", 12, {"camera": {"rows": height, "columns": width}})
        config, planes = moment.config, moment.capture.raw.planes
        if height == 120:
            yield from _stages("scaled_car", moment, seconds)

        works: list[tuple[str, Callable[[], Any], Maker]] = [
            ("cw_range", partial(_cleaned_range, moment), peers.opencv_cw_range),
            ("cw_chain", _chain(moment), peers.opencv_cw_chain),
        ]
        for work, ours, make in works:
            name, theirs = _peer("cv2", "OpenCV", make, config)
            yield race(f"{work}_{width}x{height}", ours, name, _given(theirs, planes), seconds)


def _three_frequencies(seconds: float) -> Iterator[Row]:
    """Yield the row of a camera with three modulation frequencies: a slanted wall behind boxes, no pixels mixed."""
    config = load_config("kinect2_like")
    camera = config.camera
    assert camera.kind == "cw"
    column, row = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    range_m = 3.0 + 1.5 * column / camera.columns
    for number in range(4):
        range_m[(np.abs(column - 80 - 120 * number) < 40) & (np.abs(row - 210) < 60 + 30 * number)] = 1.2 + 0.5 * number
    view = View(range_m[None], np.full((1, *row.shape), 0.5), np.ones((1, *row.shape)))
    raw = cw.simulate(partial(_same_view, view), camera, 0.0, np.random.default_rng(1))
    moment = Moment(config, Capture(raw), Tracks.empty())
    name, theirs = _peer("cv2", "OpenCV and NumPy", unwrapping_peer.opencv_multi_frequency, config)
    ranging = partial(RANGING[config.ranging], raw, camera)
    yield race("kinect2_like: ranging", ranging, "", None, seconds / 4)
    yield race("kinect2_decode_512x424", partial(_cleaned_range, moment), name, _given(theirs, raw.planes), seconds)


def _pulsed(seconds: float) -> Iterator[Row]:
    moment = _moment("scenario:braking-car", 40)
    yield from _stages("usercams", moment, seconds)
    name, theirs = _peer("cv2", "OpenCV", peers.opencv_pulsed_chain, moment.config)
    planes = moment.capture.raw.planes
    yield race("pulsed_chain_64x8", _chain(moment), name, _given(theirs, planes), seconds)


def _tracker(seconds: float) -> Iterator[Row]:
    segments, dt_s = _twenty_segments(), 0.02
    tracking = load_config("usercams").tracking
    for work, motion in (("tracker_20_ca", tracking.motion), ("tracker_20_imm", _INTERACTING)):
        settings, tracks = replace(tracking, motion=motion), Tracks.empty()
        for k in range(10):
            tracks = update_tracks(tracks, segments, k * dt_s, settings)
        ours = partial(update_tracks, tracks, segments, 10 * dt_s, settings)
        name, theirs = _peer("filterpy", "FilterPy", peers.filterpy_tracker, segments, dt_s, motion)
        yield race(work, ours, name, theirs, seconds)


_INTERACTING = MotionSettings(modes=(Mode(model="constant_velocity"), Mode(model="constant_acceleration")))


def _twenty_segments() -> Segments:
    """Return twenty objects, two metres apart, as a camera would measure them."""
    n = 20
    place = np.stack([5.0 + 2 * (np.arange(n) // 5), 2.0 * (np.arange(n) % 5) - 4, np.full(n, 0.8)], axis=1)
    return Segments(
        label=np.arange(1, n + 1),
        position_m=place,
        covariance_m2=np.tile(np.diag([0.01, 0.02, 0.02]), (n, 1, 1)),
        size_m=np.tile([0.3, 0.5, 1.6], (n, 1)),
        near_m=place[:, 0] - 0.15,
        n_pixels=np.full(n, 20),
        box=np.zeros((n, 4), int),
        range_m=np.linalg.norm(place, axis=1),
        sigma_range_m=np.full(n, 0.1),
        amplitude=np.full(n, 100.0),
        cut=np.zeros(n, np.uint8),
        nearest_m=place - [0.15, 0.0, 0.0],
        ends_m=place[:, 1:2] + [0.25, -0.25],
    )


def _segmentation(seconds: float) -> Iterator[Row]:
    moment = _moment("scenario:test-scene", 12)
    kept: dict[str, Any] = {}

    def keep(stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        kept[stage] = function(*arguments)
        return kept[stage]

    process_frame(moment.capture.raw, moment.tracks, moment.capture.ego, moment.config, keep)
    image, points = kept["clean"], kept["geometry"]
    ours = partial(SEGMENTATION["region_growing"], image, points, moment.config.segments)
    name, theirs = _peer("skimage", "scikit-image flood", peers.skimage_segments, moment.config)
    yield race("region_growing_160x120", ours, name, _given(theirs, image.range_m, image.valid), seconds)


def _simulation(seconds: float) -> Iterator[Row]:
    """Yield a row for each forward model: samples of a plane at 4 m, given its range and reflectivity.

    The continuous-wave camera has every imperfection but a second bounce, which takes a hundred times as long.
    """
    simulators: dict[str, Callable[..., Any]] = {"cw": cw.simulate, "pulsed": pulsed.simulate}
    for work, preset in (("simulate_cw_160x120", "scaled_car"), ("simulate_pulsed_64x8", "usercams")):
        camera = load_config(preset).camera
        camera = imperfect(camera) if camera.kind == "cw" else camera
        shape = (1, camera.rows, camera.columns)
        view = View(np.full(shape, 4.0), np.full(shape, 0.5), np.ones(shape))
        rng = np.random.default_rng(1)
        ours = partial(simulators[camera.kind], partial(_same_view, view), camera, 0.0, rng)
        yield race(work, ours, "", None, seconds)


def _closed_loop(seconds: float) -> Iterator[Row]:
    """Yield a row for each camera: milliseconds a simulated frame of a whole drive, beside the period of its frames.

    Scene, sensor, perception, brake, bus and vehicle, for 0.6 s; so the ratio says how much faster than real time
    a campaign is driven on one core. The second camera has every imperfection that the simulation alone has.
    """
    works = (("loop_cw_160x120", "approach-box"), ("loop_cw_160x120_imperfect", "approach-box"),
             ("loop_pulsed_64x8", "braking-car"))  # fmt: skip
    for work, name in works:
        scenario, config, settings = opened(name, None, [])
        camera = config.camera
        if work.endswith("imperfect") and camera.kind == "cw":
            config = replace(config, camera=imperfect(camera))
        ours = partial(drive, replace(scenario, duration_s=0.5), config, replace(settings, run_in_s=0.1))
        frames = ours().frames
        row = race(work, ours, "", None, seconds)
        yield Row(work, row.ms / frames, "real time: the period of its frames", 1e3 / camera.frame_rate_hz)


def _same_view(view: View, time_s: float) -> View:
    """Return the view of a scene in which nothing moves."""
    return view
