"""Friction between tyre and ground, estimated from the speed while braking fully (S-FUT-07). Pure.

While the brakes are full and hold, v(t) = v0 - mu g t. A straight line through the speeds of one stop gives mu and,
with the noise of one speed, its standard deviation. The delay of the brakes at its begin and the creeping at its end
are left out; so is a stop whose speeds lie on no straight line: there the wheels locked or the ground changed.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge

from rangecam.brake.machine import CarState
from rangecam.brake.rule import GRAVITY_MPS2, DecisionSettings
from rangecam.settings import NonNegative, Positive, settings
from rangecam.values import changed


@settings
class FrictionSettings:
    """Which speeds of a stop count, and how carefully the estimate is used."""

    brake_delay_s: NonNegative = 0.1
    """From the take-over to the brakes biting (eq 3.10)."""
    min_speed_mps: NonNegative = 0.3
    """Below this speed the car creeps, and the sensor counts few holes."""
    speed_sigma_mps: Positive = 0.02
    """Standard deviation of one speed."""
    min_speeds: Annotated[int, Ge(3)] = 5
    """A stop with fewer speeds says nothing."""
    change: NonNegative = 0.05
    """Standard deviation of the friction from stop to stop."""
    max_misfit: Positive = 3.0
    """The speeds of a stop may scatter about their line by so many times the noise of one."""
    sigmas: NonNegative = 2.0
    """The decision is made with the estimate less so many standard deviations."""


@dataclass(frozen=True)
class Friction:
    """What is known of the friction, and the sums of the stop that is under way (times from its begin on).

    mu, sigma: after all stops so far, 0 and inf before the first. began_s: take-over of this stop, NaN outside one.
    heard_s: arrival of the last car state. n, t, v, tt, tv, vv: sums for the line.
    """

    mu: float = 0.0
    sigma: float = math.inf
    began_s: float = math.nan
    heard_s: float = -math.inf
    n: int = 0
    t: float = 0.0
    v: float = 0.0
    tt: float = 0.0
    tv: float = 0.0
    vv: float = 0.0


def observe(friction: Friction, car: CarState, braking: bool, time_s: float, settings: FrictionSettings) -> Friction:
    """Return what is known after a step in which the car was told to brake, or not; `car` is its last good state."""
    if not braking:
        return friction if math.isnan(friction.began_s) else _finished(friction, settings)
    if math.isnan(friction.began_s):
        return Friction(friction.mu, friction.sigma, began_s=time_s, heard_s=car.received_s)
    since_s = car.received_s - friction.began_s
    known = car.received_s > friction.heard_s and since_s >= settings.brake_delay_s
    if not (known and car.speed_mps >= settings.min_speed_mps):
        return friction
    return changed(
        friction,
        heard_s=car.received_s,
        n=friction.n + 1,
        t=friction.t + since_s,
        v=friction.v + car.speed_mps,
        tt=friction.tt + since_s**2,
        tv=friction.tv + since_s * car.speed_mps,
        vv=friction.vv + car.speed_mps**2,
    )


def _finished(stop: Friction, settings: FrictionSettings) -> Friction:
    """Return what is known after a stop: its line, weighted with what was known before."""
    before = Friction(stop.mu, stop.sigma)
    if stop.n < settings.min_speeds:
        return before
    spread = stop.tt - stop.t**2 / stop.n
    slope = (stop.tv - stop.t * stop.v / stop.n) / spread
    scatter = max(0.0, stop.vv - stop.v**2 / stop.n - slope**2 * spread) / (stop.n - 2)
    if slope >= 0 or scatter > (settings.max_misfit * settings.speed_sigma_mps) ** 2:
        return before
    mu, variance = -slope / GRAVITY_MPS2, (settings.speed_sigma_mps / GRAVITY_MPS2) ** 2 / spread
    prior = stop.sigma**2 + settings.change**2
    weight = 1 / (1 + variance / prior)  # 1 before the first stop, where the prior is inf
    return Friction(stop.mu + weight * (mu - stop.mu), math.sqrt(weight * variance))


def with_friction(decision: DecisionSettings, friction: Friction, settings: FrictionSettings) -> DecisionSettings:
    """Return the settings of the decision with the estimated friction, where there is one; else as set."""
    cautious = friction.mu - settings.sigmas * friction.sigma
    if not cautious > 0:
        return decision
    return replace(decision, friction=cautious, deceleration_mps2=None)
