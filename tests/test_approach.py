"""Real approaches to a wall, flown with an 8x8 sensor on a small drone, against motion capture."""

import os
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.io import open_source
from rangecam.pipeline import run
from rangecam.types import Frame, TrackStatus

FOLDER = Path(os.environ.get("RANGECAM_DATA", "")) / "vl53l5cx_flights"
FLIGHTS = ("A0", "A1", "A2", "A4")
LAG_S = 0.08  # of the sensor behind the truth
pytestmark = pytest.mark.skipif(
    "RANGECAM_DATA" not in os.environ or not FOLDER.is_dir(),
    reason="needs the recordings: set RANGECAM_DATA to the folder that holds vl53l5cx_flights",
)


class Flight(NamedTuple):
    frames: list[Frame]
    gap_m: np.ndarray
    """True gap to the wall when the sensor measured what it delivered in each frame."""
    speed_mps: np.ndarray
    """True rate of the gap."""


@lru_cache(maxsize=8)
def flight(name: str) -> Flight:
    recording = np.load(FOLDER / f"{name}.npz")
    drone, surface, time_s = recording["vicon_Drone"], recording["vicon_Surface"], recording["time_s"]
    grid = np.arange(drone[0, 0], drone[-1, 0], 0.02)
    gap = np.interp(grid, drone[:, 0], np.abs(surface[:, 1].mean() - drone[:, 1]))
    gap = np.convolve(np.pad(gap, 7, "edge"), np.ones(15) / 15, "valid")
    config = load_config("vl53l5cx")
    frames = list(run(open_source(str(FOLDER / f"{name}.npz"), config).captures, config))
    seen_s = time_s - LAG_S
    return Flight(frames, np.interp(seen_s, grid, gap), np.interp(seen_s, grid, np.gradient(gap, grid)))


class Wall(NamedTuple):
    """The track nearest to the optical axis."""

    speed_mps: float
    sigma_mps: float
    ttc_s: float


def wall(frame: Frame) -> Wall | None:
    x, y, z = frame.tracks.state[:, [0, 3, 6]].T
    off = np.hypot(y, z) / np.where(x > 0, x, np.nan)
    off[frame.tracks.status == TrackStatus.TENTATIVE] = np.nan
    if not (off < np.tan(np.radians(15))).any():
        return None
    i = int(np.nanargmin(off))
    sigma = float(np.sqrt(frame.tracks.covariance[i, 1, 1]))
    return Wall(float(frame.tracks.state[i, 1]), sigma, float(frame.decision.collisions.ttc_s[i]))


def approaching(flight: Flight) -> np.ndarray:
    return np.flatnonzero((flight.speed_mps < -0.25) & (flight.gap_m > 0.4) & (flight.gap_m < 3))


def test_closing_speed_and_time_to_collision_are_those_of_motion_capture() -> None:
    speed, ttc, inside, present = [], [], [], []
    for f in map(flight, FLIGHTS):
        for k in approaching(f):
            found = wall(f.frames[k])
            present.append(found is not None)
            if found is not None:
                error = abs(found.speed_mps - f.speed_mps[k])
                speed.append(error)
                inside.append(error < 2 * found.sigma_mps)
                ttc.append(abs(min(found.ttc_s, 100.0) / (f.gap_m[k] / -f.speed_mps[k]) - 1))
    assert len(present) > 250
    assert np.median(speed) <= 0.045
    assert np.median(ttc) <= 0.07
    assert np.mean(present) >= 0.9
    assert 0.85 <= np.mean(inside) <= 0.99


def brakes(flight: Flight) -> np.ndarray:
    """Frames in which braking begins."""
    brake = np.array([frame.decision.brake for frame in flight.frames])
    return np.flatnonzero(brake & ~np.r_[False, brake[:-1]])


def test_the_drone_that_crashed_would_have_braked_in_time() -> None:
    f = flight("A1")
    contact = int(np.flatnonzero(f.gap_m < 0.1)[0])
    last = brakes(f)[brakes(f) < contact][-1]
    gap_now_m = f.gap_m[last] + f.speed_mps[last] * LAG_S
    speed = -f.speed_mps[last]
    assert speed > 0.25
    # what is left after another lag is enough to stop at 3 m/s2
    assert gap_now_m > speed * LAG_S + speed**2 / (2 * 3.0)
    assert f.frames[last].decision.time_s < f.frames[contact].decision.time_s - 0.3


def test_flights_that_turn_back_by_themselves_are_hardly_ever_braked() -> None:
    for f in map(flight, ("A0", "A2", "A4")):
        assert len(brakes(f)) <= 3
        assert sum(frame.decision.brake for frame in f.frames) <= 0.06 * len(
            f.frames
        )  # each comes within 0.5 m of the wall, and lands


def test_far_from_everything_nothing_is_braked_for() -> None:
    for f in map(flight, FLIGHTS):
        cruising = approaching(f)[f.gap_m[approaching(f)] > 1.0]
        assert not any(f.frames[k].decision.brake for k in cruising)
