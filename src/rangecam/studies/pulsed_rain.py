"""Rain and snow before the pulsed camera: the light of a drop, the range that it leaves, fields of drops."""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from rangecam.geometry import Lens, Mounting, rays
from rangecam.pulsed import RANGING, simulate
from rangecam.pulsed.camera import laser_exposure
from rangecam.pulsed.settings import Crosstalk, PulsedCamera
from rangecam.pulsed.signal import shutter_windows
from rangecam.scene.view import View
from rangecam.scene.weather import Drop, Particles, Weather, extinction_perm, in_weather, precipitation
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import looking_at, quiet
from rangecam.types import Floats

DROP_M, DARK, TARGET_M = 6e-3, 0.1, 8.0
TABLE_M = {0.3: 0.41, 0.5: 1.26, 0.75: 3.39, 1.0: 5.50, 1.5: 7.36, 2.0: 7.80, 3.0: 7.97}
"""Measured range of the target by the range of the drop (N-K-072)."""
_PIXEL = (4, 32)
_FRONT = Weather(rear_reflection=False)
_FRAMES = 8


def pulsed_rain(rng: np.random.Generator) -> Study:
    """Rain and snow: light of a drop and its power law, the range measured through it, fields of drops.

    rng: of the fields of drops and the noise of their images.
    """
    camera = quiet(PulsedCamera(speed_of_light_mps=3e8))
    rates, shares, errors = _fields(rng)
    claims = [
        *_equal_power(camera),
        *_power_laws(camera),
        *_measured(camera),
        *(
            derived("K-ENV-04", f"pixels wrong by over 5 sigma or lost, {name}, target of 0.1 at 8 m", share, "%")
            for name, share in zip(rates, shares, strict=True)
        ),
        derived("K-ENV-04", "light lost on the way to 20 m and back, 25 mm/h", _lost(25.0), "%"),
    ]
    return Study("pulsed-rain", "König 2008, 5.2.1.3", claims, [*_panels(camera), _field_panel(errors)])


def _through(camera: PulsedCamera, range_m: float, weather: Weather, target: float, kind: str = "water") -> View:
    """Return the view of a target of that reflectivity through one drop on the axis of a pixel."""
    shape = (camera.rows, camera.columns)
    x, y, z = (float(v) for v in rays(camera.lens, shape)[_PIXEL] * range_m)
    what: Literal["water", "snow"] = "snow" if kind == "snow" else "water"
    weather = replace(weather, drops=(Drop(position_m=(x, y, z), diameter_m=DROP_M, kind=what),))
    one = np.ones((1, *shape))
    hanging = precipitation(weather, camera.lens, Mounting(), shape, np.random.default_rng(0), 0.0)
    return in_weather(View(TARGET_M * one, target * one, one), hanging, weather, camera.lens, Mounting(), 0.0)


def _drop_light(camera: PulsedCamera, range_m: Floats, kind: str = "water", weather: Weather = _FRONT) -> Floats:
    """Return the exposure of the pixel by a drop alone, J/m2 (N,)."""
    whole = shutter_windows(camera)["c"]
    views = (_through(camera, float(d), weather, 0.0, kind) for d in range_m)
    return np.array([laser_exposure(view, whole, 0.0, camera)[_PIXEL] for view in views])


def _target_light(camera: PulsedCamera, range_m: float) -> float:
    one = np.ones((1, camera.rows, camera.columns))
    view = View(range_m * one, DARK * one, one)
    return float(laser_exposure(view, shutter_windows(camera)["c"], 0.0, camera)[_PIXEL])


def _equal_power(camera: PulsedCamera) -> list[Claim]:
    at_m = np.geomspace(0.3, 3.0, 41)
    light = _drop_light(camera, at_m)
    claims = []
    for target_m, drop_m in ((2.0, 0.43), (8.0, 0.86), (20.0, 1.36)):
        found = float(np.exp(np.interp(-np.log(_target_light(camera, target_m)), -np.log(light), np.log(at_m))))
        text = f"range of a 6 mm drop that is as bright as a target of 0.1 at {target_m:g} m"
        agrees = 0.2 < found < 2.0
        why = f"near drops outshine targets beyond 2 m, as fig 5.5 shows; its equal powers are at {drop_m:g} m"
        claims.append(judged("N-K-070", text, None, found, "m", agrees and abs(found - drop_m) < 0.01, why))
    rear = float(_drop_light(camera, np.ones(1), weather=Weather())[0] / _drop_light(camera, np.ones(1))[0])
    text = "light of a drop with that which its rear mirrors, over that of its front"
    return [*claims, derived("N-K-070", text, rear, "", "geometric optics; the thesis counts the surface alone")]


def _power_laws(camera: PulsedCamera) -> list[Claim]:
    def exponent(light: Floats, at_m: Floats) -> float:
        return float(np.polyfit(np.log(at_m), np.log(light), 1)[0])

    far_m, near_m = np.linspace(0.75, 3.0, 12), np.linspace(0.08, 0.2, 12)
    target = np.array([_target_light(camera, float(d)) for d in far_m])
    drop, of_target = exponent(_drop_light(camera, far_m), far_m), exponent(target, far_m)
    flake_far, flake_near = (exponent(_drop_light(camera, d, "snow"), d) for d in (far_m, near_m))
    footprint_m = DROP_M * camera.objective.focal_length_m / camera.pixel.pitch_horizontal_m
    printed = "the thesis prints the exponents 4 and 2 without their sign (E-K-14)"
    return [
        judged("N-K-071", "exponent of a drop's light over range", -4, drop, "", abs(drop + 4) < 0.01, printed),
        judged("N-K-071", "exponent of a target's", -2, of_target, "", abs(of_target + 2) < 0.01, printed),
        derived("N-K-071", "range from which a pixel sees all of 6 mm", footprint_m, "m", "its footprint is as wide"),
        judged(
            "E-K-14",
            "exponent of a diffuse flake of 6 mm beyond it",
            None,
            flake_far,
            "",
            abs(flake_far + 4) < 0.05,
            "while it is smaller than the footprint; a drop's glint is a point, and keeps it at all ranges",
        ),
        judged(
            "E-K-14",
            "exponent of that flake where it covers the pixel",
            None,
            flake_near,
            "",
            abs(flake_near + 2) < 0.1,
            "as a target's: the law changes as the flake fills the footprint",
        ),
        derived(
            "E-K-14",
            "range at which blur leaves half of a drop's light in its pixel",
            _half_blurred(camera),
            "m",
            "the lens is focused at infinity: nearer, other pixels share it, and its own gets it with the square",
        ),
    ]


def _half_blurred(camera: PulsedCamera) -> float:
    at_m = np.geomspace(0.3, 5.0, 30)
    blurred = replace(camera, crosstalk=Crosstalk(blur=True))
    kept = _drop_light(blurred, at_m) / _drop_light(camera, at_m)
    return float(np.interp(0.5, kept, at_m))


def _ranges(camera: PulsedCamera, at_m: Floats, weather: Weather = _FRONT) -> Floats:
    found = []
    for d in at_m:
        view = _through(camera, float(d), weather, DARK)
        raw = simulate(looking_at(view), camera, 0.0, np.random.default_rng(0))
        found.append(RANGING["mdsi3"](raw, camera).range_m[_PIXEL])
    return np.array(found, np.float64)


def _measured(camera: PulsedCamera) -> list[Claim]:
    found_m = _ranges(camera, np.array(list(TABLE_M)))
    claims = []
    for (drop_m, table_m), range_m in zip(TABLE_M.items(), found_m, strict=True):
        text = f"range of a target of 0.1 at 8 m through a drop at {drop_m:g} m"
        why = f"{table_m:g} m for a mean of both ranges by their light"
        claims.append(judged("N-K-072", text, None, range_m, "m", abs(range_m - table_m) < 0.015, why))
    off_m = TARGET_M - _ranges(camera, np.array([0.9, 1.0, 1.5, 2.0, 2.5]))
    shape = "very significant up to 1 m, small from 1 to 2 m, none beyond (fig 5.6)"
    return [
        *claims,
        judged("F-K-19", "error by a drop at 1 m", None, off_m[1], "m", off_m[0] > off_m[1] > 1, shape),
        judged("F-K-19", "error by a drop at 1.5 m", None, off_m[2], "m", 0.1 < off_m[2] < 1, shape),
        judged("F-K-19", "error by a drop at 2.5 m", None, off_m[4], "m", off_m[4] < 0.1 < off_m[3] + 0.1, shape),
    ]


def _lost(rain_mm_per_h: float) -> float:
    return 100 * (1 - float(np.exp(-40 * extinction_perm(Weather(rain_mm_per_h=rain_mm_per_h)))))


def _fields(rng: np.random.Generator) -> tuple[list[str], list[float], dict[str, Floats]]:
    """Return what fields of drops do to a wall of 0.1 at 8 m: names, wrong pixels (%), sorted errors (m)."""
    weathers = {
        "rain 5 mm/h": Weather(rain_mm_per_h=5.0),
        "rain 25 mm/h": Weather(rain_mm_per_h=25.0),
        "snow 1 mm/h": Weather(snow_mm_per_h=1.0),
    }
    camera, shape = PulsedCamera(), (8, 64)
    one = np.ones((1, *shape))
    wall = View(TARGET_M * one, DARK * one, one)
    wrong, errors = [], {}
    for name, weather in weathers.items():
        off = []
        for _ in range(_FRAMES):
            falling = precipitation(weather, camera.lens, Mounting(), shape, rng, 0.0)
            raw = simulate(partial(_seen, wall, falling, weather, camera.lens), camera, 0.0, rng)
            image = RANGING["mdsi3"](raw, camera)
            off.append(np.where(image.valid, image.range_m - TARGET_M, np.nan))
            wrong.append(~image.valid | (np.abs(image.range_m - TARGET_M) > 5 * image.sigma_m))
        errors[name] = np.sort(np.array(off)[np.isfinite(off)])
    shares = 100 * np.array(wrong).reshape(len(weathers), -1).mean(axis=1)
    return list(weathers), shares.tolist(), errors


def _seen(wall: View, falling: Particles, weather: Weather, lens: Lens, time_s: float) -> View:
    return in_weather(wall, falling, weather, lens, Mounting(), time_s)


def _panels(camera: PulsedCamera) -> list[Panel]:
    at_m = np.geomspace(0.1, 4.0, 60)
    volts = 1e6
    lights = [
        Series("drop of 6 mm", at_m, volts * _drop_light(camera, at_m)),
        Series("the same, blurred", at_m, volts * _drop_light(replace(camera, crosstalk=Crosstalk(blur=True)), at_m)),
        Series("with its rear", at_m, volts * _drop_light(camera, at_m, weather=Weather())),
        Series("flake of 6 mm", at_m, volts * _drop_light(camera, at_m, "snow")),
        *(
            Series(f"target of 0.1 at {d:g} m", at_m[[0, -1]], volts * np.full(2, _target_light(camera, d)), line="--")
            for d in (2.0, 8.0, 20.0)
        ),
    ]
    through_m = np.geomspace(0.35, 4.0, 40)
    table_m = np.array(list(TABLE_M))
    ranges = [
        Series("drop of 6 mm", through_m, _ranges(camera, through_m)),
        Series("with its rear", through_m, _ranges(camera, through_m, Weather())),
        Series("mean of both ranges by their light", table_m, list(TABLE_M.values()), line="o", colour=3),
    ]
    return [
        Panel("Light of a drop in its pixel", "range (m)", "exposure by a pulse (µJ/m²)", lights, "xy"),
        Panel("Target of 0.1 at 8 m behind a drop", "range of the drop (m)", "measured range (m)", ranges),
    ]


def _field_panel(errors: dict[str, Floats]) -> Panel:
    series = []
    for name, off_m in errors.items():
        part = np.linspace(0, 100, 400)
        series.append(Series(name, np.interp(part, np.linspace(0, 100, len(off_m)), off_m), part))
    return Panel("Wall of 0.1 at 8 m, valid pixels", "error of the range (m)", "pixels below it (%)", series)
