"""The tuning of the thesis again (König 2008, 6.4.3.4): the error of the tracks over sigma_w and over sigma_u.

50 runs of a scene whose truth is known, filtered with the Q of the thesis (eq 6.33) and fixed association. Beyond the
thesis: where the minimum moves when noise, frame rate or jerk do, and what the likelihood of the innovations chooses,
which needs no truth.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rangecam import tuning
from rangecam.metrics import amse
from rangecam.motion import MotionSettings
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed
from rangecam.studies.tracking_models import side_by_side
from rangecam.tracking import TrackingSettings, update_tracks
from rangecam.types import Floats, Segments, Tracks

STEPS_MPS2 = (0.01, 0.1, 1.0, 10.0, 100.0)
"""The five values of sigma_w that the thesis tries (fig 6.15)."""

_RUNS, _FRAMES_PER_S, _FIRST, _LAST = 50, 25.0, 40, 160  # k_min and k_max of eq 6.45
_SIGMA_M, _SIGMA_PERSON_M = 0.02, 0.05  # of the centroids, of a few hundred and of a few dozen pixels
_FINE_MPS2 = np.geomspace(0.01, 100.0, 25)
_SIGMA_U = np.geomspace(2e-3, 1.0, 22)
_PIXEL_RAD = np.radians(30 / 64)  # the camera of the thesis: 30 degrees over 64 columns
_QUANTITIES = ("position", "velocity", "acceleration")


class Way(NamedTuple):
    """Where something truly is along one axis: times (K,), and position, velocity, acceleration (K, 3)."""

    time_s: Floats
    state: Floats


def phases(time_s: Floats, start: tuple[float, float], *parts: tuple[float, float]) -> Way:
    """Return the way from position and velocity at 0 through (seconds, acceleration) one after the other."""
    x, v, a = start[0] + start[1] * time_s, np.full_like(time_s, start[1]), np.zeros_like(time_s)
    begin = 0.0
    for duration_s, acceleration in parts:
        within, after = np.clip(time_s - begin, 0.0, duration_s), np.maximum(time_s - begin - duration_s, 0.0)
        x += acceleration * within * (within / 2 + after)
        v += acceleration * within
        a += acceleration * ((time_s >= begin) & (time_s < begin + duration_s))
        begin += duration_s
    return Way(time_s, np.stack([x, v, a], axis=1))


def smooth_car(time_s: Floats) -> Way:
    """Return the way of a car 20 m ahead that comes nearer, its acceleration a single smooth wave to -1.6 m/s2."""
    T, peak = float(time_s[-1]), 1.6
    w = 2 * np.pi / T
    a = -peak / 2 * (1 - np.cos(w * time_s))
    v = -peak / 2 * (time_s - np.sin(w * time_s) / w)
    x = 20 - peak / 2 * (time_s**2 / 2 + (np.cos(w * time_s) - 1) / w**2)
    return Way(time_s, np.stack([x, v, a], axis=1))


def stepping_car(time_s: Floats, peak_mps2: float = 2.5) -> Way:
    """Return the way of a car 20 m ahead whose brakes are stepped on and let go."""
    return phases(time_s, (20.0, 0.0), (1.6, 0.0), (1.6, -peak_mps2), (1.6, 0.0), (1.6, 0.6 * peak_mps2))


def crossing_person(time_s: Floats) -> Way:
    """Return the way of a person from the right to the left who stops in the middle for 1.5 s (fig 6.12)."""
    return phases(time_s, (-3.8, 1.4), (2.464, 0.0), (0.5, -2.8), (1.5, 0.0), (0.5, 2.8))


def twice_stopping_person(time_s: Floats) -> Way:
    """Return the way of a person who comes from 23 m to 11 m, stands for 1 s, and walks off with a stop at 18 m.

    At 15 frames a second the second stop lasts from step 220 to 240, and 23 m are reached again at its end (fig 6.18).
    """
    walk, change_s = 1.5, 0.4
    stop_s, on_s = 220 / 15 - change_s / 2, 240 / 15 - change_s / 2
    gone_s = stop_s - 7.0 / walk
    stand_s = gone_s - 1.0 - change_s
    brake, start = (change_s, walk / change_s), (change_s, -walk / change_s)
    begin = 11.0 + walk * (stand_s + change_s / 2)
    parts = [(stand_s, 0.0), brake, (gone_s - stand_s - change_s, 0.0), brake, (stop_s - gone_s - change_s, 0.0), start]
    return phases(time_s, (begin, -walk), *parts, (on_s - stop_s - change_s, 0.0), brake)


def seen_person(y_m: Floats, at_m: float, runs: int, rng: np.random.Generator) -> Floats:
    """Return the centroids (runs, K) that pixels give of a person at y (K,), as the thesis' sensor sees one.

    A pixel belongs to the person if more than half of it does, but for noise: in steps, and nothing like a Gaussian.
    Head, trunk with arms and legs are rows of different width.
    """
    pitch_m = at_m * np.tan(_PIXEL_RAD)
    columns = (np.arange(-32, 32) + 0.5) * pitch_m
    total, weight = np.zeros((runs, len(y_m))), np.zeros((runs, len(y_m)))
    for width_m in (0.2, 0.4, 0.5, 0.5, 0.4, 0.35, 0.35, 0.3):
        low = np.maximum(columns - pitch_m / 2, y_m[:, None] - width_m / 2)
        high = np.minimum(columns + pitch_m / 2, y_m[:, None] + width_m / 2)
        covered = np.maximum(high - low, 0.0) / pitch_m
        inside = covered + 0.1 * rng.standard_normal((runs, *covered.shape)) * (covered > 0) > 0.5
        total += inside @ columns
        weight += inside.sum(axis=-1)
    return total / weight


def frames_of(measured_m: Floats, sigma_m: float) -> list[Segments]:
    """Return what is measured along one axis in runs (runs, K) as frames, the runs side by side."""
    place, covariance = np.zeros((len(measured_m), 3)), np.broadcast_to(sigma_m**2 * np.eye(3), (len(measured_m), 3, 3))
    return [side_by_side(place + np.outer(one, [1.0, 0.0, 0.0]), covariance) for one in measured_m.T]


def filtered(frames: list[Segments], way: Way, step_mps2: float) -> Floats:
    """Return the errors (runs, K, 3) of the thesis' filter on the frames of a way."""
    settings, tracks, states = _tracking(step_mps2), Tracks.empty(), []
    for frame, time_s in zip(frames, way.time_s, strict=True):
        tracks = update_tracks(tracks, frame, float(time_s), settings)
        states.append(tracks.state[:, :3])
    return np.array(states).swapaxes(0, 1) - way.state


def _tracking(step_mps2: float) -> TrackingSettings:
    motion = MotionSettings(model="wiener_acceleration", step_mps2=step_mps2)
    return TrackingSettings(motion=motion, position_sigma_m=0.0, extent_sigma=0.0, gate_probability=1.0, confirm_hits=1)


Path = Callable[[Floats], Way]


def tracking_tuning(rng: np.random.Generator) -> Study:
    """Process noise of the thesis' filter by the error over 50 runs, its pixel noise, and a person who stops twice."""
    parts = [_over_sigma_w("smooth", smooth_car, rng), _over_sigma_w("steps", stepping_car, rng)]
    parts += [_over_jerk(rng), _over_sigma_u(rng), _two_stops(rng)]
    claims = [claim for part in parts for claim in part[0]]
    return Study("tracking-tuning", "König 2008, 6.4.3.4 and 6.4.3.5", claims, [part[1] for part in parts])


def _over_sigma_w(name: str, path: Path, rng: np.random.Generator) -> tuple[list[Claim], Panel]:
    """Return fig 6.15 for one car: U of the errors over sigma_w, lag on its left and noise on its right."""
    way = path(np.arange(_LAST + 1) / _FRAMES_PER_S)
    frames = _measured(way, _SIGMA_M, rng)
    id, of = f"N-K-085.{name}", f"car, {name}"
    errors = {step: filtered(frames, way, step)[:, _FIRST:] for step in (*_FINE_MPS2.tolist(), *STEPS_MPS2)}
    five = np.array([amse(errors[step]) for step in STEPS_MPS2])
    fine = np.array([amse(errors[step]) for step in _FINE_MPS2.tolist()])
    lowest = np.array(STEPS_MPS2)[five.argmin(axis=0)]
    claims = []
    for k, quantity in enumerate(_QUANTITIES):
        why = "a U with its minimum inside, at most a decade off: it follows how hard a car brakes, and the frame rate"
        fits = _is_u(five[:, k]) and 0.1 <= lowest[k] <= 10
        claims.append(judged(id, f"{of}: best of the five sigma_w, {quantity}", 1.0, lowest[k], "m/s2", fits, why))
        place = lowest_of(_FINE_MPS2, fine[:, k])
        claims.append(derived(id, f"{of}: minimum over sigma_w, {quantity}", place, "m/s2", "on a fine grid"))
    for step, what, is_lag in ((STEPS_MPS2[0], "lag at", True), (STEPS_MPS2[-1], "noise at", False)):
        lag = float((errors[step].mean(axis=0)[:, 0] ** 2).mean() / amse(errors[step])[0])
        share = lag if is_lag else 1 - lag
        why = "more than nine tenths of the AMSE of x: the best sigma_w is where both balance"
        claims.append(judged(id, f"{of}: share of {what} {step:g} m/s2", None, share, "", share > 0.9, why))
    chosen = tuning.tune([_paths(way, frames)]).best[0]
    claims.append(derived(id, f"{of}: most likely sigma_w", chosen, "m/s2", "by the innovations, without the truth"))
    shown = [Series(q, _FINE_MPS2, fine[:, k] / fine[:, k].min()) for k, q in enumerate(_QUANTITIES)]
    shown += [Series("", STEPS_MPS2, five[:, k] / fine[:, k].min(), line="o", colour=k) for k in range(3)]
    shown.append(Series("most likely", [chosen, chosen], [0.8, 30.0], line="--"))
    return claims, Panel(f"approaching car, {name}", "sigma_w / (m/s2)", "AMSE / least AMSE", shown, log="xy")


def _over_jerk(rng: np.random.Generator) -> tuple[list[Claim], Panel]:
    """Return why the minimum may lie elsewhere: how hard the brakes are stepped on and the frame rate move it.

    Not the noise of the range, which R knows.
    """
    peaks_mps2 = np.geomspace(0.5, 16.0, 6)
    claims, series = [], []
    for rate_hz in (15.0, 25.0, 50.0):
        best = np.array([_best_step(peak, rate_hz, _SIGMA_M, rng) for peak in peaks_mps2])
        series.append(Series(f"{rate_hz:g} frames/s", peaks_mps2, best, line="o-"))
        text = f"car, steps, {rate_hz:g} frames/s: size of the steps for which 1 m/s2 is best"
        needed = float(np.exp(np.interp(0.0, np.log(best), np.log(peaks_mps2))))
        claims.append(derived("N-K-085.steps", text, needed, "m/s2", "a car that brakes like that is why 1 was best"))
    for sigma_m, colour in ((_SIGMA_M / 10, 4), (_SIGMA_M * 10, 5)):
        best_m = [_best_step(peak, _FRAMES_PER_S, sigma_m, rng) for peak in peaks_mps2]
        series.append(Series(f"25 frames/s, {sigma_m:g} m", peaks_mps2, best_m, None, "o:", colour))
    text, change = "car, steps: best sigma_w with ten times the noise over that with a tenth", best_m[2]
    change /= np.interp(peaks_mps2[2], peaks_mps2, np.asarray(series[-2].y))
    why = "noise a hundredfold changes it by less than three: R takes the noise up, sigma_w belongs to the motion"
    claims.append(judged("N-K-085.steps", text, None, change, "", 1 / 3 < change < 3, why))
    return claims, Panel(
        "minimum for the position", "steps of the acceleration / (m/s2)", "sigma_w / (m/s2)", series, "xy"
    )


def _best_step(peak_mps2: float, rate_hz: float, sigma_m: float, rng: np.random.Generator) -> float:
    """Return the best sigma_w for the position of a car that brakes by steps of this size."""
    time_s = np.arange(round(_LAST / _FRAMES_PER_S * rate_hz) + 1) / rate_hz
    way = stepping_car(time_s, peak_mps2)
    frames, grid = _measured(way, sigma_m, rng), np.geomspace(0.01, 30.0, 12)
    settled = round(_FIRST / _FRAMES_PER_S * rate_hz)
    return lowest_of(grid, np.array([amse(filtered(frames, way, step)[:, settled:])[0] for step in grid]))


def _over_sigma_u(rng: np.random.Generator) -> tuple[list[Claim], Panel]:
    """Return fig 6.16: errors of a crossing person over the pixel noise that the filter believes in, sigma_w = 1."""
    printed_px, at_m = (5e-2, 1.5e-2, 1.5e-2), 15.0
    claims, series = [], []
    for rate_hz, line in ((15.0, "-"), (50.0, "--")):
        way = crossing_person(np.arange(round(7 * rate_hz)) / rate_hz)
        measured = seen_person(way.state[:, 0], at_m, _RUNS, rng)
        errors = []
        for sigma_u in _SIGMA_U:
            frames = frames_of(measured, at_m * np.arctan(sigma_u * np.tan(_PIXEL_RAD)))  # eq 6.38
            errors.append(amse(filtered(frames, way, 1.0)[:, round(1.6 * rate_hz) :]))
        error = np.array(errors)
        best = [lowest_of(_SIGMA_U, error[:, k]) for k in range(3)]
        for k, (quantity, thesis) in enumerate(zip(_QUANTITIES, printed_px, strict=True)):
            text = f"person, {rate_hz:g} frames/s: best sigma_u, {quantity}"
            series.append(
                Series(f"{quantity}, {rate_hz:g} /s", _SIGMA_U, error[:, k] / error[:, k].min(), None, line, k)
            )
            if rate_hz == 15.0:
                why = "a U with its minimum inside, at most a decade off: only sigma_u / sigma_w counts, and our pixels"
                fits = _is_u(error[:, k]) and 0.1 < best[k] / thesis < 10
                claims.append(judged("N-K-086", text, thesis, best[k], "px", fits, why))
            else:
                claims.append(derived("N-K-086", text, best[k], "px", "more frames: each may count less"))
        if rate_hz == 15.0:
            claims += _apart(best, error)
        true_px = (measured - way.state[:, 0]).std() / (at_m * np.tan(_PIXEL_RAD))
        text = f"person, {rate_hz:g} frames/s: true error of the centroid"
        claims.append(derived("N-K-086", text, true_px, "px", "steps of the pixels that belong to the person"))
    return claims, Panel("crossing person, sigma_w = 1 m/s2", "sigma_u / px", "AMSE / least AMSE", series, log="xy")


def _apart(best: list[float], error: Floats) -> list[Claim]:
    """Return what becomes of the statement that the minima are apart, and that it matters little for y."""
    text, thesis, ratio = "person: best sigma_u of y over that of its velocity", 5e-2 / 1.5e-2, best[0] / best[1]
    why = "ours lie together: lag and noise of all three follow sigma_u / sigma_w; y is flat, and few values part them"
    claim = judged("N-K-086", text, thesis, ratio, "", ratio > 2, why)
    at_low, at_high = (float(np.interp(px, _SIGMA_U, error[:, 0])) for px in (1.5e-2, 5e-2))
    text, why = "person: AMSE of y at 1.5e-2 px over that at 5e-2 px", "only slightly higher: less than 1.5"
    return [claim, judged("N-K-086", text, None, at_low / at_high, "", 1 < at_low / at_high < 1.5, why)]


def _two_stops(rng: np.random.Generator) -> tuple[list[Claim], Panel]:
    """Return fig 6.18: a person comes to 11 m, stands, and walks off with a stop at 18 m, at 15 and at 50 frames/s."""
    claims = [printed("N-K-087", "person: stop from step 220 to 240 at 15 frames/s", "1.33", (240 - 220) / 15, "s")]
    series, noise = [], []
    for rate_hz, step_mps2 in ((15.0, 1.0), (50.0, 1.0), (50.0, float(np.sqrt(15 / 50)))):
        way, settled = twice_stopping_person(np.arange(round(20 * rate_hz)) / rate_hz), round(2 * rate_hz)
        errors = filtered(_measured(way, _SIGMA_PERSON_M, rng), way, step_mps2)[:, settled:]
        time_s, estimated = way.time_s[settled:], errors[:, :, 2] + way.state[settled:, 2]
        noise.append(errors.std(axis=0).mean(axis=0))
        for at_s, sign, what in ((220 / 15, -1, "stops"), (240 / 15, 1, "moves on")):
            peak = (sign * estimated.mean(axis=0))[np.abs(time_s - at_s - 0.25) < 0.75].max()
            text = f"person at 18 m, {rate_hz:g} frames/s, sigma_w {step_mps2:.2g}: acceleration when it {what}"
            why = f"{'negative' if sign < 0 else 'positive'}, more than twice its noise of {noise[-1][2]:.2g} m/s2"
            claims.append(judged("K-TUN-08", text, None, sign * peak, "m/s2", peak > 2 * noise[-1][2], why))
        label = f"{rate_hz:g} frames/s, sigma_w {step_mps2:.2g} m/s2"
        series.append(Series(label, time_s, estimated.mean(axis=0)))
        if rate_hz == 15.0:
            series.append(Series("", time_s, estimated[0], None, ":", 0))
    series.append(Series("true", way.time_s, way.state[:, 2], None, "--", 5))
    for k, quantity in enumerate(_QUANTITIES):
        text = f"person: noise of the {quantity} at 50 frames/s over that at 15"
        why = "with the same sigma_w, which is of a step a frame, so a faster camera lets more motion in"
        claims.append(derived("K-TUN-08", text, noise[1][k] / noise[0][k], "", why))
        ratio, why = noise[2][k] / noise[0][k], "less: 50 frames/s improve it, with sigma_w for the same motion"
        claims.append(judged("K-TUN-08", f"{text}, sigma_w by its root", None, ratio, "", ratio < 1, why))
    return claims, Panel("person who stops at 11 and 18 m", "time / s", "acceleration / (m/s2)", series)


def lowest_of(x: Floats, y: Floats) -> float:
    """Return where y over x is lowest (the arg min of eq 6.47, E-K-25): the vertex of a parabola in logarithms."""
    k = int(np.clip(np.argmin(y), 1, len(x) - 2))
    a, b, _ = np.polyfit(np.log(x[k - 1 : k + 2]), np.log(y[k - 1 : k + 2]), 2)
    vertex = -b / (2 * a) if a > 0 else np.log(x[np.argmin(y)])
    return float(np.exp(np.clip(vertex, np.log(x[k - 1]), np.log(x[k + 1]))))


def _is_u(y: Floats) -> bool:
    """Return whether y falls to a minimum inside and rises after it."""
    k = int(np.argmin(y))
    return bool(0 < k < len(y) - 1 and (np.diff(y[: k + 1]) < 0).all() and (np.diff(y[k:]) > 0).all())


def _measured(way: Way, sigma_m: float, rng: np.random.Generator) -> list[Segments]:
    """Return the frames of a way, measured in each run with Gaussian noise."""
    return frames_of(way.state[:, 0] + sigma_m * rng.standard_normal((_RUNS, len(way.time_s))), sigma_m)


def _paths(way: Way, frames: list[Segments]) -> tuning.Paths:
    """Return the runs as the paths of as many tracks."""
    return tuning.side_by_side("runs", list(zip(way.time_s.tolist(), frames, strict=True)), _tracking(1.0))
