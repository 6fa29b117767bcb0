"""Friction between tyre and ground, estimated from the speed while braking fully (S-FUT-07). Pure.

While the brakes are full and hold, v(t) = v0 - mu g t. A straight line through the speeds of one stop gives mu and, with the
noise of one speed, its standard deviation. The delay of the brakes at its begin and the creeping at its end are left out.
"""

import math
from dataclasses import dataclass, replace

from rangecam.brake.machine import BrakeState, CarState, Mode
from rangecam.brake.rule import GRAVITY_MPS2, DecisionSettings
from rangecam.settings import NonNegative, Positive, PositiveInt, settings


@settings
class FrictionSettings:
    """Which speeds of a stop count, and how carefully the estimate is used."""

    brake_delay_s: NonNegative = 0.1
    """From the take-over to the brakes biting (eq 3.10)."""
    min_speed_mps: NonNegative = 0.3
    """Below this speed the car creeps, and the sensor counts few holes."""
    speed_sigma_mps: Positive = 0.02
    """Standard deviation of one speed."""
    min_speeds: PositiveInt = 5
    """A stop with fewer speeds says nothing."""
    sigmas: NonNegative = 2.0
    """The decision is made with the estimate less so many standard deviations."""


@dataclass(frozen=True)
class Friction:
    """What is known of the friction, and the sums of the stop that is under way (times from its begin on).

    mu, sigma: of all stops so far, 0 and inf before the first. began_s: take-over of this stop, NaN outside one.
    heard_s: arrival of the last car state that counted. n, t, v, tt, tv: sums for the line.
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


def observe(friction: Friction, state: BrakeState, time_s: float, settings: FrictionSettings) -> Friction:
    """Return what is known after a step of the machine, whose state this is."""
    if state.mode is Mode.USER_CONTROL:
        return friction if math.isnan(friction.began_s) else _finished(friction, settings)
    if math.isnan(friction.began_s):
        return Friction(friction.mu, friction.sigma, began_s=time_s)
    car: CarState = state.car
    since_s = car.received_s - friction.began_s
    if (
        not car.received_s > friction.heard_s
        or since_s < settings.brake_delay_s
        or car.speed_mps < settings.min_speed_mps
    ):
        return friction
    return replace(
        friction,
        heard_s=car.received_s,
        n=friction.n + 1,
        t=friction.t + since_s,
        v=friction.v + car.speed_mps,
        tt=friction.tt + since_s**2,
        tv=friction.tv + since_s * car.speed_mps,
    )


def _finished(stop: Friction, settings: FrictionSettings) -> Friction:
    """Return what is known after a stop: its line, weighted with what was known before."""
    spread = stop.tt - stop.t**2 / stop.n if stop.n >= settings.min_speeds else 0.0
    if spread <= 0:
        return Friction(stop.mu, stop.sigma)
    mu = -(stop.tv - stop.t * stop.v / stop.n) / spread / GRAVITY_MPS2
    sigma = settings.speed_sigma_mps / math.sqrt(spread) / GRAVITY_MPS2
    if mu <= 0:
        return Friction(stop.mu, stop.sigma)
    weight = sigma**-2 / (sigma**-2 + stop.sigma**-2)
    return Friction(stop.mu + weight * (mu - stop.mu), (sigma**-2 + stop.sigma**-2) ** -0.5)


def with_friction(decision: DecisionSettings, friction: Friction, settings: FrictionSettings) -> DecisionSettings:
    """Return the settings of the decision with the estimated friction, where there is one; else as set."""
    cautious = friction.mu - settings.sigmas * friction.sigma
    if not cautious > 0:
        return decision
    return replace(decision, friction=cautious, deceleration_mps2=None)
