"""What every ranging method of every family promises: run over `pipeline.RANGING`."""

from typing import Any

import numpy as np
import pytest

from rangecam import cw, processed, pulsed
from rangecam.config import Config, load_config
from rangecam.errors import DataError
from rangecam.pipeline import RANGING
from rangecam.scene.view import View
from rangecam.types import RangeImage, RawFrame, Why

THREE_WINDOWS = {"camera": {"shutters": "abc", "frame_rate_hz": 30.0}}
# Without a delay of the laser, the second window would see nothing nearer than 4.5 m.
TWO_LATE = {"camera": {"shutters": "bb", "laser_delay_s": 30e-9}}
# A small image has more border, and pixels of two degrees are too coarse for whole steps of the angle.
KEPT_AND_EXACT = {"border": "keep", "angles": "lens", "speed_of_light_mps": 299_792_458.0}
TWO_FREQUENCIES = {"camera": {"modulations_hz": [60e6, 80e6], "phase_steps_deg": [0, 90, 180], "capture_order": []}}
# A camera for each method, and two planes that it needs; a method that is missing here fails the first test.
CAMERAS: dict[str, tuple[str, dict[str, Any], tuple[str, str]]] = {
    "cw_four_phase": ("scaled_car", {}, ("phase_0", "phase_90")),
    "cw_emulation": ("scaled_car", {"camera": {"emulation": KEPT_AND_EXACT}}, ("phase_0", "phase_90")),
    "cw_phases": (
        "scaled_car",
        {"camera": {"phase_steps_deg": [0, 120, 240], "capture_order": []}},
        ("phase_0", "phase_240"),
    ),
    "cw_multi_frequency": ("scaled_car", TWO_FREQUENCIES, ("f0_phase_0", "f1_phase_90")),
    "mdsi1": ("usercams", THREE_WINDOWS, ("shutter_a", "shutter_c")),
    "mdsi2": ("usercams", THREE_WINDOWS, ("shutter_b", "shutter_c")),
    "mdsi3": ("usercams", {}, ("shutter_a", "shutter_b")),
    "mdsi4": ("usercams", {}, ("shutter_b", "shutter_a")),
    "gradient1": ("usercams", {"camera": {"shutters": "aa"}}, ("shutter_a1", "shutter_a2")),
    "gradient2": ("usercams", TWO_LATE, ("shutter_b1", "shutter_b2")),
    "csi": ("usercams", {"camera": {"shutters": "a_delayed", "frame_rate_hz": 5.0}}, ("shutter_a_0", "shutter_a_9")),
    "dcsi": ("usercams", {"camera": {"shutters": "ab_delayed", "frame_rate_hz": 2.0}}, ("shutter_a_3", "shutter_b_9")),
    "shifted": (
        "usercams",
        {"camera": {"shutters": "b_delayed", "frame_rate_hz": 5.0}},
        ("shutter_b_3", "shutter_b_9"),
    ),
    "three_tap": ("generic_pulsed", {}, ("tap_1", "tap_3")),
    "processed": ("generic_range", {}, ("range_m", "range_m")),
}
FILTERED = {"cw_emulation": 2}
"""Methods that clean, too: how far away a pixel counts."""
NEAR, MIDDLE, FAR = 0, 1, 2
RANGES_M: dict[str, tuple[float, ...]] = {
    "cw": (0.7, 1.2, 2.0),
    "shutters": (3.0, 6.0, 10.0),
    "three_tap": (1.0, 2.0, 3.0),
    "processed": (1.0, 2.0, 4.0),
}
"""Where each family sees every pixel of a wall well."""
SIZE = {"camera": {"rows": 24, "columns": 32}}


def config_of(method: str, *layers: dict[str, Any]) -> Config:
    preset, settings, _ = CAMERAS[method]
    return load_config(preset, settings, SIZE, {"ranging": method}, *layers)


def distance_of(config: Config, place: int) -> float:
    family = config.camera.readout if config.camera.kind == "pulsed" else config.camera.kind
    return RANGES_M[family][place]


def frame_of(config: Config, place: int = MIDDLE, reflectivity: float = 0.8, seed: int = 1) -> RawFrame:
    """Simulate a wall that every pixel sees squarely at the same radial range."""
    camera = config.camera
    range_m = distance_of(config, place)
    shape = (1, camera.rows, camera.columns)
    view = View(np.full(shape, range_m), np.full(shape, reflectivity), np.ones(shape))
    rng = np.random.default_rng(seed)
    if camera.kind == "processed":
        return processed.simulate(view, camera, 0.0, rng)
    simulate: Any = {"cw": cw.simulate, "pulsed": pulsed.simulate}[camera.kind]
    frame: RawFrame = simulate(lambda _: view, camera, 0.0, rng)
    return frame


def ranged(method: str, raw: RawFrame, config: Config) -> RangeImage:
    return RANGING[method](raw, config.camera)


def changed(raw: RawFrame, **planes: Any) -> RawFrame:
    return RawFrame(raw.time_s, {**raw.planes, **planes}, raw.frame_id)


def test_every_method_is_held_to_the_contract() -> None:
    assert set(CAMERAS) == set(RANGING)


@pytest.mark.parametrize("method", CAMERAS)
@pytest.mark.parametrize("place", [NEAR, MIDDLE, FAR])
def test_a_wall_is_found_where_it_is_within_the_stated_sigma_of_the_mean(method: str, place: int) -> None:
    config = config_of(method)
    range_m = distance_of(config, place)
    image = ranged(method, frame_of(config, place), config)
    assert image.valid.mean() > 0.9
    error = (image.range_m - range_m)[image.valid]
    sigma = image.sigma_m[image.valid]
    assert abs(error.mean()) < 5 * np.sqrt((sigma**2).mean() / error.size) + 1e-3
    assert np.abs(error / sigma).max() < 6


@pytest.mark.parametrize("method", CAMERAS)
def test_the_images_have_the_types_and_shapes_of_the_waist(method: str) -> None:
    config = config_of(method)
    raw = frame_of(config)
    image = ranged(method, raw, config)
    assert image.time_s == raw.time_s
    for plane, kind in ((image.range_m, np.float32), (image.sigma_m, np.float32), (image.why, np.uint8)):
        assert plane.shape == raw.shape
        assert plane.dtype == kind
    assert image.amplitude.shape == raw.shape
    assert np.all(image.sigma_m[image.valid] > 0)
    assert np.isfinite(image.range_m[image.valid]).all()
    assert set(np.unique(image.why)) <= {int(why) for why in Why}


@pytest.mark.parametrize("method", CAMERAS)
def test_sigma_falls_with_more_light_where_the_model_knows_light(method: str) -> None:
    config = config_of(method)
    bright = ranged(method, frame_of(config, reflectivity=0.9), config)
    dark = ranged(method, frame_of(config, reflectivity=0.3), config)
    assert np.nanmedian(bright.sigma_m) <= np.nanmedian(dark.sigma_m)
    assert np.nanmedian(bright.amplitude) > np.nanmedian(dark.amplitude)


@pytest.mark.parametrize("method", CAMERAS)
def test_range_does_not_depend_on_reflectivity(method: str) -> None:
    config = config_of(method)
    means = []
    for rho in (0.3, 0.9):
        image = ranged(method, frame_of(config, reflectivity=rho), config)
        means.append(image.range_m[image.valid].mean())
    assert means[0] == pytest.approx(means[1], abs=0.02)


@pytest.mark.parametrize("method", CAMERAS)
def test_a_broken_sample_is_a_pixel_that_is_not_finite_and_no_neighbour_suffers(method: str) -> None:
    config = config_of(method)
    raw = frame_of(config)
    name = CAMERAS[method][2][0]
    for broken in (np.nan, np.inf):
        plane = np.array(raw.planes[name], dtype=np.float32)
        plane[5, 7] = broken
        image = ranged(method, changed(raw, **{name: plane}), config)
        assert image.why[5, 7] == Why.NOT_FINITE
        whole = ranged(method, changed(raw, **{name: np.array(raw.planes[name], dtype=np.float32)}), config)
        elsewhere = np.ones(raw.shape, bool)
        reach = FILTERED.get(method, 0)
        elsewhere[5 - reach : 6 + reach, 7 - reach : 8 + reach] = False
        np.testing.assert_array_equal(image.why[elsewhere], whole.why[elsewhere])
        np.testing.assert_allclose(image.range_m[elsewhere], whole.range_m[elsewhere], equal_nan=True)


@pytest.mark.parametrize("method", CAMERAS)
def test_a_frame_without_light_is_invalid_everywhere_and_says_why(method: str) -> None:
    config = config_of(method)
    raw = frame_of(config)
    image = ranged(method, RawFrame(0.0, {name: np.zeros_like(p) for name, p in raw.planes.items()}), config)
    assert not image.valid.any()
    assert set(np.unique(image.why)) <= {
        int(Why.NO_SIGNAL),
        int(Why.LOW_AMPLITUDE),
        int(Why.SATURATED),
        int(Why.SENSOR_FLAG),
    }


@pytest.mark.parametrize("method", CAMERAS)
def test_a_missing_plane_is_named_with_those_that_are_there(method: str) -> None:
    config = config_of(method)
    raw = frame_of(config)
    name = CAMERAS[method][2][0]
    rest = {key: plane for key, plane in raw.planes.items() if key != name} or {"something": raw.planes[name]}
    with pytest.raises(DataError, match=name):
        ranged(method, RawFrame(0.0, rest), config)


@pytest.mark.parametrize("method", [m for m in CAMERAS if m != "processed"])
def test_planes_of_different_shapes_are_refused_by_name(method: str) -> None:
    config = config_of(method)
    raw = frame_of(config)
    name = CAMERAS[method][2][1]
    with pytest.raises(DataError, match=name):
        ranged(method, changed(raw, **{name: np.asarray(raw.planes[name])[:, :-1]}), config)


@pytest.mark.parametrize("method", CAMERAS)
def test_the_raw_samples_stay_as_they_are(method: str) -> None:
    config = config_of(method)
    raw = frame_of(config)
    before = {name: plane.copy() for name, plane in raw.planes.items()}
    ranged(method, raw, config)
    for name, plane in raw.planes.items():
        np.testing.assert_array_equal(plane, before[name])
