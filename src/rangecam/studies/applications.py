"""What the applications ask of the pulsed camera: time to react, pulses to reach far, pixels on a target."""

import numpy as np

from rangecam.collision import time_to_reach
from rangecam.optics import footprint_m
from rangecam.pulsed.feasible import max_frame_rate_hz
from rangecam.pulsed.limits import required_pulse_width_s
from rangecam.pulsed.settings import PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived
from rangecam.types import Floats

SPEED_MPS, RANGE_M = 15.0, 20.0
"""Of urban traffic (König 2008, 7.1)."""
TARGET_M = (0.7, 2.0)
"""Width and height of the plywood target of fig 6.11."""


def applications(rng: np.random.Generator) -> Study:
    """What applications ask of the pulsed camera: time to react, pulse widths for their ranges, pixels on a target.

    rng: not used, nothing here is random.
    """
    camera = PulsedCamera(speed_of_light_mps=3e8)
    claims = [*_traffic(camera), *_reach(camera), *_pixels(camera)]
    panels = [_reaction(), _pulses(camera), _target(camera)]
    return Study("applications", "König 2008, 6.4.3.4 and chapter 7", claims, panels)


def _traffic(camera: PulsedCamera) -> list[Claim]:
    frame_s = 1 / max_frame_rate_hz(camera)
    return [
        derived("N-K-088", "time to react at 15 m/s with 20 m of sight", time_to_reach(RANGE_M, -SPEED_MPS, 0.0), "s"),
        derived("N-K-088", "way from image to image", SPEED_MPS * frame_s, "m"),
    ]


def _reach(camera: PulsedCamera) -> list[Claim]:
    names = {5.0: "orientation aid, up to 5 m", 100.0: "light curtain, up to 100 m"}
    return [
        derived("N-K-089", f"pulse width for the {name}", required_pulse_width_s(far_m, camera) * 1e9, "ns")
        for far_m, name in names.items()
    ]


def _pixels(camera: PulsedCamera) -> list[Claim]:
    claims = []
    for at_m in (5.0, 10.0, 20.0):
        across, down = _seen_px(np.array([at_m]), camera)
        claims += [
            derived("N-K-090", f"pixels across the plywood target at {at_m:g} m", across[0], "px"),
            derived("N-K-090", f"pixels down it at {at_m:g} m, of a sensor with rows enough", down[0], "px"),
        ]
    return claims


def _seen_px(range_m: Floats, camera: PulsedCamera) -> tuple[Floats, Floats]:
    """Return how many pixels wide and high the plywood target is; the sensor has 8 rows."""
    pitches = camera.pixel.pitch_horizontal_m, camera.pixel.pitch_vertical_m
    across, down = (
        size / footprint_m(pitch, range_m, camera.objective) for size, pitch in zip(TARGET_M, pitches, strict=True)
    )
    return across, down


def _reaction() -> Panel:
    speed_mps = np.linspace(2, 30, 60)
    series = [
        Series(f"sight of {range_m:g} m", speed_mps * 3.6, [time_to_reach(range_m, -v, 0.0) for v in speed_mps])
        for range_m in (10.0, 20.0, 40.0)
    ]
    return Panel("Time to react", "speed (km/h)", "time to collision (s)", series)


def _pulses(camera: PulsedCamera) -> Panel:
    range_m = np.geomspace(2, 120, 60)
    width_ns = [required_pulse_width_s(float(r), camera) * 1e9 for r in range_m]
    named = np.array([5.0, 20.0, 100.0])
    series = [
        Series("MDSI", range_m, width_ns),
        Series(
            "orientation aid, car, light curtain",
            named,
            [required_pulse_width_s(r, camera) * 1e9 for r in named],
            line="o",
        ),
    ]
    return Panel("Pulse that a range needs", "farthest range (m)", "pulse width (ns)", series, "xy")


def _target(camera: PulsedCamera) -> Panel:
    range_m = np.linspace(3, 25, 60)
    across, down = _seen_px(range_m, camera)
    series = [
        Series("across", range_m, across),
        Series("down", range_m, np.minimum(down, camera.rows)),
        Series("rows of the sensor", range_m, np.full(range_m.shape, camera.rows), line="--"),
    ]
    return Panel("Plywood of 0.7 m x 2 m", "range (m)", "pixels", series)
