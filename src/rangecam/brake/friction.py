"""Friction between tyre and ground, from how a stop looks to the camera (S-FUT-07). Pure.

Wheels that lock say nothing of the speed over ground; the free way d to what stands in front does. With the speed v0
before the brakes bite at t0, and then the deceleration a = mu g until standstill at t0 + v0 / a,

    d(t) = d0 - v0 (t - t0) + a (t - t0)^2 / 2     between the two, a straight line before, constant afterwards

is fitted to a, t0 and d0. A stop that looks otherwise says nothing: the object moved, or the ground changed.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge

from rangecam.brake.machine import Perception
from rangecam.brake.settings import GRAVITY_MPS2
from rangecam.settings import NonNegative, Positive, settings
from rangecam.types import Floats
from rangecam.values import changed, record


@settings
class FrictionSettings:
    """Which stops count, and whether and how carefully the estimate is used."""

    adapt: bool = False
    """Whether the decision reckons with the estimate, once there is one, instead of `decision.friction`."""
    before_s: Positive = 0.4
    """Free ways count from so long before the braking on."""
    min_speed_mps: Positive = 0.8
    """A stop from less than this says nothing."""
    min_images: Annotated[int, Ge(4)] = 6
    """Nor does one of which fewer images were taken between the brakes' biting and standstill."""
    distance_sigma_m: Positive = 0.01
    """Standard deviation of one free way, at least."""
    max_misfit_m: Positive = 0.06
    """The free ways of a stop may scatter by so much about what is fitted (root mean square)."""
    steady: NonNegative = 0.1
    """Before the braking our speed changed by less than this share of it."""
    standing: NonNegative = 0.25
    """Before the brakes bite the free way shrank with our speed, but for this share (a new track lags): else the object
    moved."""
    model: NonNegative = 0.05
    """Standard deviation of what is not in the model (brakes that rise, filtered distances), as a share of mu."""
    change: NonNegative = 0.05
    """Standard deviation of the friction from stop to stop."""
    sigmas: NonNegative = 2.0
    """The decision is made with the estimate less so many standard deviations."""


class Gap(NamedTuple):
    """The free way to one object at one time of the camera's clock, and our speed when that was known."""

    time_s: float
    distance_m: float
    speed_mps: float


@record
class Friction:
    """What is known of the friction after all stops so far (0 and inf before the first), and the stop under way.

    speed_mps: before the braking. track_id: of what stands in front, 0 for none. gaps: to it, the newest last; in
    user control those of the last `before_s`. braking: whether a stop is under way; before: gaps until it began.
    """

    mu: float = 0.0
    sigma: float = math.inf
    speed_mps: float = 0.0
    track_id: int = 0
    gaps: tuple[Gap, ...] = ()
    braking: bool = False
    before: int = 0


def observe(friction: Friction, seen: Perception, speed_mps: float, braking: bool, s: FrictionSettings) -> Friction:
    """Return what is known after a step in which an object made us brake, or not.

    seen, speed_mps: the last good image and the speed that the machine believes.
    """
    if friction.braking and not braking:
        known = after_stop(friction, s)
        return Friction(known.mu, known.sigma)
    if braking and not friction.braking:
        friction = changed(friction, braking=True, before=len(friction.gaps))
    friction = _looked(friction, seen, speed_mps, s)
    return friction if braking or speed_mps == friction.speed_mps else changed(friction, speed_mps=speed_mps)


_MOST_GAPS = 600  # of a stop that does not end, the memory does


def _looked(friction: Friction, seen: Perception, speed_mps: float, s: FrictionSettings) -> Friction:
    """Return the gaps with that of a new image: of the same object, else from it on; none begins during a stop."""
    old = bool(friction.gaps) and seen.time_s <= friction.gaps[-1].time_s
    full = len(friction.gaps) >= _MOST_GAPS
    if seen.track_id == 0 or old or full or not math.isfinite(seen.distance_m):
        return friction
    gap = Gap(seen.time_s, seen.distance_m, speed_mps)
    if friction.braking:
        same = seen.track_id == friction.track_id
        return changed(friction, gaps=(*friction.gaps, gap)) if same else changed(friction, track_id=0, gaps=())
    kept = friction.gaps if seen.track_id == friction.track_id else ()
    recent = tuple(each for each in kept if each.time_s >= seen.time_s - s.before_s)
    return changed(friction, track_id=seen.track_id, gaps=(*recent, gap))


def after_stop(friction: Friction, s: FrictionSettings) -> Friction:
    """Return what is known if the stop under way ends here: what it says, weighted with what was known before."""
    found = _fitted(friction, s) if friction.braking else None
    if found is None:
        return friction
    mu, variance = found
    prior = friction.sigma**2 + s.change**2
    weight = 1 / (1 + variance / prior)  # 1 before the first stop, where the prior is inf
    return changed(friction, mu=friction.mu + weight * (mu - friction.mu), sigma=math.sqrt(weight * variance))


def _fitted(stop: Friction, s: FrictionSettings) -> tuple[float, float] | None:
    """Return mu of a stop and its variance, None where it says nothing."""
    v0 = stop.speed_mps
    if not v0 >= s.min_speed_mps or len(stop.gaps) < _EARLY + s.min_images:
        return None
    from scipy.optimize import least_squares

    time_s, gap_m, speed_mps = np.array(stop.gaps).T
    if not np.abs(speed_mps[: stop.before] - v0).max(initial=0.0) <= s.steady * v0:
        return None
    starts = _starts(stop.gaps, s.before_s)
    fits = [least_squares(_misfit, start, _slopes, method="lm", args=(time_s, gap_m, v0)) for start in starts]
    fit = min(fits, key=lambda each: each.cost)
    a, bites_s, _ = fit.x
    scatter_m = math.sqrt(fit.fun @ fit.fun / (len(time_s) - len(fit.x)))
    if not (a > 0 and scatter_m <= s.max_misfit_m):
        return None
    early = time_s < bites_s
    between = ~early & (time_s < bites_s + v0 / a)
    if early.sum() < _EARLY or between.sum() < s.min_images:
        return None
    closing_mps = -np.polyfit(time_s[early], gap_m[early], 1)[0]
    if not abs(closing_mps - v0) <= s.standing * v0:
        return None
    slopes = np.asarray(fit.jac)
    spread = float(np.linalg.inv(slopes.T @ slopes)[0, 0]) * max(scatter_m, s.distance_sigma_m) ** 2
    mu = a / GRAVITY_MPS2
    return mu, spread / GRAVITY_MPS2**2 + (s.model * mu) ** 2


def _starts(gaps: tuple[Gap, ...], before_s: float) -> list[tuple[float, float, float]]:
    """Return where the fit begins, in turn."""
    return [(a, gaps[0].time_s + before_s, gaps[0].distance_m) for a in _STARTS_MPS2]


_STARTS_MPS2 = 0.5, 2.0, 8.0  # from one alone the fit may end beside the best
_EARLY = 2  # images before the brakes bite, at least: they tell whether the object stands


def _misfit(parameters: Floats, time_s: Floats, gap_m: Floats, v0: float) -> Floats:
    """Return free ways of the model less those seen, (N,), for a (kept above zero), t0 and d0 (the equation above)."""
    a, since_s = _since(parameters, time_s, v0)
    return np.asarray(parameters[2] - v0 * since_s + a * np.maximum(since_s, 0.0) ** 2 / 2 - gap_m)


def _slopes(parameters: Floats, time_s: Floats, gap_m: Floats, v0: float) -> Floats:
    """Return the derivatives of `_misfit` by a, t0 and d0 (N, 3); at standstill those of the way v0^2 / 2 a, and 0."""
    a, since_s = _since(parameters, time_s, v0)
    braked_s = np.maximum(since_s, 0.0)
    return np.stack([braked_s**2 / 2, v0 - a * braked_s, np.ones(len(time_s))], axis=1)


def _since(parameters: Floats, time_s: Floats, v0: float) -> tuple[float, Floats]:
    """Return a, and how long the brakes have bitten (N,): negative before they do, at most until standstill."""
    a = max(float(parameters[0]), 1e-3)
    return a, np.minimum(time_s - parameters[1], v0 / a)


def cautious(friction: Friction, s: FrictionSettings) -> float | None:
    """Return the friction to reckon with: the estimate less its uncertainty, None where there is none or not wanted."""
    least = friction.mu - s.sigmas * friction.sigma
    return least if s.adapt and least > 0 else None
