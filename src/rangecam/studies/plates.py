"""Scenes of upright plates before a wall, as the continuous-wave camera of the thesis sees them."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rangecam.config import load_config
from rangecam.cw import CwCamera
from rangecam.geometry import Mounting
from rangecam.scene.paths import Path, Vector
from rangecam.scene.render import ray_bundle, render
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, SceneObject
from rangecam.scene.view import View

_WALL_M = 60.0


def thesis_cw_camera(**changes: Any) -> CwCamera:
    """Return the camera of Steinbäck 2016 without its row of pseudo data, with these settings changed."""
    camera = load_config("scaled_car", {"camera": {"pseudo_rows": 0, **changes}}).camera
    assert isinstance(camera, CwCamera)
    return camera


def plate(
    place_m: Vector, size_m: tuple[float, float], reflectivity: float, velocity_mps: Vector = (0.0, 0.0, 0.0)
) -> SceneObject:
    """Return an upright plate that faces us: where the middle of its face is at time 0, width and height, velocity."""
    body = Box(center_m=(0.05, 0.0, 0.0), size_m=(0.1, *size_m), reflectivity=reflectivity)
    return SceneObject(name="plate", boxes=(body,), path=Path(start_m=place_m, velocity_mps=velocity_mps))


def wall(range_m: float, reflectivity: float) -> SceneObject:
    """Return a wall across the optical axis that fills the image."""
    return plate((range_m, 0.0, 0.0), (_WALL_M, _WALL_M), reflectivity)


def looking_at(camera: CwCamera, *things: SceneObject, subpixels: int = 3) -> Callable[[float], View]:
    """Return what the camera sees of things, as a function of the time."""
    scenario = Scenario(
        name="plates", description="", preset="", duration_s=1.0, subpixels=subpixels, objects=tuple(things)
    )
    bundle = ray_bundle(camera.lens, Mounting(), (camera.rows, camera.columns), subpixels)
    return partial(render, scenario, bundle=bundle)
