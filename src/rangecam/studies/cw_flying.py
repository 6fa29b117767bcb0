"""Flying pixels of the continuous-wave camera: where a pixel sees two surfaces, its range belongs to neither."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rangecam.clean import clean
from rangecam.config import Config, load_config
from rangecam.cw import RANGING, CwCamera, simulate
from rangecam.scene.paths import Path as Way
from rangecam.scene.render import ray_bundle, render
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, Cylinder, SceneObject
from rangecam.studies.study import Claim, Panel, Picture, Series, Study, derived, judged
from rangecam.types import Floats, RangeImage, Why

_GROSS_M, _MIXED_M, _RAYS = 0.03, 0.06, 4
_TOLERANCE_M = 0.01
"""So far below what counts as gross that noise leaves none; the preset, with 3 cm, loses less of a real scene."""
_SHAPE = (120, 160)
_LIGHT_LSB = (200.0, 400.0, 800.0, 1500.0, 4000.0)
_IMAGES = 3
_RECORDING = Path("cw_mlx75027") / "tools_scene.npz"


def cw_flying(rng: np.random.Generator) -> Study:
    """Flying pixels at edges of boxes and poles: how many gross ones there are, what rejecting them leaves; real tools.

    rng: of the noise. The recording of real tools is looked at if the environment variable RANGECAM_DATA names the
    folder that holds it.
    """
    rows = []
    for light_lsb in _LIGHT_LSB:
        config = _config(light_lsb)
        seen_m = _seen_m(config)
        rows.append(np.mean([_counted(config, seen_m, rng) for _ in range(_IMAGES)], axis=0))
    before, after, lost, sigma_mm = np.transpose(rows)
    bright = _LIGHT_LSB.index(1500.0)
    why = f"{_GROSS_M * 1e3:.0f} mm from both surfaces; an image of {_SHAPE[0]} x {_SHAPE[1]}, mean of {_IMAGES}"
    claims = [
        derived("S-PRE-09", "gross flying pixels", before[bright], "pixels", why),
        judged("S-PRE-09", "gross ones left by the rejection", None, after[bright], "pixels", after[bright] == 0,
               f"none at a noise of {sigma_mm[bright]:.1f} mm"),
        judged("S-PRE-09", "good pixels lost", None, 100 * lost[bright], "%", lost[bright] < 0.03, "at most 3 %"),
        derived("S-PRE-09", f"gross ones left at a noise of {sigma_mm[0]:.0f} mm", after[0], "pixels",
                "what lies within the noise cannot be told"),
        *_real_claims(),
    ]  # fmt: skip
    config = _config(_LIGHT_LSB[bright])
    image, cleaned = _both(config, rng)
    panels = [
        _picture("simulated, as it came", image, (1.5, 4.5)),
        _picture("simulated, flying pixels rejected", cleaned, (1.5, 4.5)),
        Panel(
            "gross flying pixels over the noise", "median noise (mm)", "pixels of an image, mean",
            [Series("as it came", sigma_mm, before, line="-o"), Series("rejected", sigma_mm, after, line="-o")],
        ),
        *_real_panels(),
    ]  # fmt: skip
    return Study("cw-flying", "Steinbäck 2016, 2.2.2 and 4.5.2", claims, panels)


def _config(light_lsb: float) -> Config:
    lens = {"horizontal_fov_deg": 60, "vertical_fov_deg": 46, "projection": "perspective"}
    camera = {
        "rows": _SHAPE[0], "columns": _SHAPE[1], "lens": lens, "modulation_hz": 20e6,
        "read_noise_lsb": 0.5, "shot_noise_lsb2_per_lsb": 0.002, "reference_amplitude_lsb": 4 * light_lsb,
    }  # fmt: skip
    return load_config("generic_cw", {"camera": camera, "mounting": {"z_m": 0.5}})


def _seen_m(config: Config) -> Floats:
    """Return the ranges of all rays of each pixel (K, H, W): wall, floor, box, slanted board and a pole."""
    return render(_scene(), 0.0, ray_bundle(config.camera.lens, config.mounting, _SHAPE, _RAYS)).range_m


def _scene() -> Scenario:
    box, board, pole = (
        Box(center_m=(0.1, 0, 0.25), size_m=(0.2, 0.5, 0.5)),
        Box(center_m=(0, 0, 0.6), size_m=(0.05, 0.6, 0.8)),
        Cylinder(base_m=(0, 0, 0), radius_m=0.08, height_m=1.2),
    )
    things = (
        SceneObject(name="wall", boxes=(Box(center_m=(0.5, 0, 0), size_m=(1, 30, 30)),), path=Way(start_m=(4, 0, 0))),
        SceneObject(name="box", boxes=(box,), path=Way(start_m=(2.2, 0.35, 0)), heading_deg=20),
        SceneObject(name="board", boxes=(board,), path=Way(start_m=(3.0, -0.9, 0)), heading_deg=-35),
        SceneObject(name="pole", cylinders=(pole,), path=Way(start_m=(1.7, -0.35, 0))),
    )
    return Scenario(name="edges", description="", preset="", duration_s=1, subpixels=_RAYS, ground_reflectivity=0.4,
                    objects=things)  # fmt: skip


def _both(config: Config, rng: np.random.Generator) -> tuple[RangeImage, RangeImage]:
    """Return a simulated image as it came, and without flying pixels."""
    camera = config.camera
    assert isinstance(camera, CwCamera)
    view = render(_scene(), 0.0, ray_bundle(camera.lens, config.mounting, _SHAPE, _RAYS))
    image = RANGING["cw_four_phase"](simulate(lambda _: view, camera, 0.0, rng), camera)
    return image, _rejected(image, config)


def _rejected(image: RangeImage, config: Config) -> RangeImage:
    settings = replace(config.clean, reject_flying=True, flying_tolerance_m=_TOLERANCE_M, filter="off", floor="off")
    return clean(image, config.camera.lens, config.mounting, settings)


def _counted(config: Config, seen_m: Floats, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Return gross flying pixels before and after rejection, the part of good pixels lost, and the noise, mm."""
    image, cleaned = _both(config, rng)
    mixed = np.diff(np.sort(seen_m, axis=0), axis=0).max(axis=0) > _MIXED_M
    gross = mixed & (np.abs(image.range_m - seen_m).min(axis=0) > _GROSS_M)
    good = image.valid & ~mixed
    return (
        float(np.sum(gross & image.valid)),
        float(np.sum(gross & cleaned.valid)),
        float(np.mean(~cleaned.valid[good])),
        float(1e3 * np.median(image.sigma_m[good])),
    )


def _real() -> tuple[RangeImage, RangeImage] | None:
    """Return the image of the recording of real tools before and after rejection, None where there is none."""
    from rangecam.io import open_source

    path = Path(os.environ.get("RANGECAM_DATA", "")) / _RECORDING
    if not path.is_file():
        return None
    source = open_source(path)
    camera = source.config.camera
    assert isinstance(camera, CwCamera)
    image = RANGING[source.config.ranging](next(iter(source.captures)).raw, camera)
    return image, _rejected(image, source.config)


def _real_claims() -> list[Claim]:
    real = _real()
    if real is None:
        return [
            derived("S-PRE-09", "real recordings looked at", 0, "", f"RANGECAM_DATA names no folder with {_RECORDING}")
        ]
    cleaned = real[1]
    flies = cleaned.why == Why.FLYING
    jumps = [_lonely(each) for each in real]
    return [
        derived("S-PRE-09", "real tools: flying pixels", 100 * flies.mean(), "%", f"{_RECORDING}, no truth known"),
        derived("S-PRE-09", "real tools: pixels between two surfaces, as it came", 100 * jumps[0], "%",
                "over 30 mm from the next pixels on both sides, in the same sense, across or down"),
        judged("S-PRE-09", "real tools: such pixels left", None, 100 * jumps[1], "%", jumps[1] < jumps[0] / 5,
               "reduced fivefold"),
    ]  # fmt: skip


def _lonely(image: RangeImage) -> float:
    """Return the part of the image that is valid and lies between two neighbours, over 30 mm from both."""
    range_m = np.where(image.valid, image.range_m, np.nan)
    lonely: NDArray[np.bool_] = np.zeros(image.shape, bool)
    for axis in (0, 1):
        step = np.diff(range_m, axis=axis)
        size = step.shape[axis]
        before, after = step.take(range(size - 1), axis), step.take(range(1, size), axis)
        between = (np.minimum(np.abs(before), np.abs(after)) > _GROSS_M) & (before * after > 0)
        lonely |= np.insert(np.insert(between, 0, False, axis), size, False, axis)
    return float(lonely.mean())


def _real_panels() -> list[Panel]:
    real = _real()
    if real is None:
        return []
    limits = tuple(np.percentile(real[1].range_m[real[1].valid], [2, 98]).tolist())
    return [
        _picture(f"real tools, {what}", each, (limits[0], limits[1]))
        for what, each in zip(("as they came", "flying pixels rejected"), real, strict=True)
    ]


def _picture(title: str, image: RangeImage, limits: tuple[float, float]) -> Panel:
    values = np.where(image.valid, image.range_m, np.nan)
    return Panel(title, "column", "row", [], picture=Picture(values, "range (m)", limits))
