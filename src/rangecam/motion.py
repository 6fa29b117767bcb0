"""How objects move between two frames: the matrices F and Q of the motion models.

All models share the nine-element state of `types.STATE`: position, velocity, acceleration of each axis (K-KAL-01). The
axes move alike and on their own, so F and Q are the (3, 3) block of one axis, three times on the diagonal (eq 6.28), Q
by the shares of `MotionSettings`; only the coordinated turn couples the horizontal ones, through its turn rate.
"""

import math
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge
from numba import njit

from rangecam.settings import NonNegative, Positive, settings
from rangecam.types import Floats


@settings
class Mode:
    """One way in which objects are expected to move."""

    model: Literal[
        "constant_velocity", "constant_acceleration", "wiener_acceleration", "singer", "coordinated_turn"
    ] = "constant_acceleration"
    """constant_velocity: the velocity drifts; constant_acceleration: the acceleration drifts (white jerk);
    wiener_acceleration: it takes one random step a frame (the thesis); singer: it drifts and dies away;
    coordinated_turn: it turns with the velocity, at the rate that both of them tell, and drifts."""
    velocity_drift_mps: NonNegative = 1.0
    """Standard deviation by which the velocity drifts within one second; its square is the spectral density of the
    acceleration, m2/s3. For constant_velocity."""
    drift_mps2: NonNegative = 3.0
    """Standard deviation by which the acceleration drifts within one second; its square is the spectral density of
    the jerk, m2/s5. For constant_acceleration, singer and coordinated_turn."""
    step_mps2: NonNegative = 1.0
    """Standard deviation of the acceleration's step in each frame (sigma_w of König eq 6.32). For
    wiener_acceleration."""
    memory_s: Positive = 1.0
    """Time after which 63 % of an acceleration has died away. For singer."""


@settings
class MotionSettings(Mode):
    """How objects are expected to move."""

    modes: tuple[Mode, ...] = ()
    """An interacting multiple model (K-FUT-09) of these, in place of the one model above; empty: that one."""
    mode_memory_s: Positive = 1.5
    """How long an object keeps to one of `modes` on the average before it changes to another."""
    lateral_share: NonNegative = 1.0
    """Motion across our way as a share of that along it: of its drift or step, and of the acceleration that a new
    object may have. Small on a road, where what brakes hard does so along our way."""
    vertical_share: NonNegative = 1.0
    """Vertical motion as a share of horizontal motion: of its drift or step, and of what a new object may have of speed
    and acceleration. Small for whatever stands on the ground; 1 where the camera itself flies."""
    adapt_s: NonNegative = 0.0
    """Time over which the process noise of each track follows its innovations (K-FUT-08): more while they are larger
    than they should be, less while they are smaller; 0: the noise stays as it is set."""
    adapt_limit: Annotated[float, Ge(1)] = 100.0
    """Largest factor by which the process noise is raised, and lowered."""


def constant_velocity(dt_s: float, settings: Mode) -> Floats:
    """Return (2, 3, 3): F and Q of each axis, for a velocity that drifts as a Wiener process, without acceleration."""
    model = np.zeros((2, 3, 3))
    _constant_velocity(dt_s, settings.velocity_drift_mps**2, model)
    return model


@njit(cache=True, nogil=True)
def _constant_velocity(T: float, q: float, model: Floats) -> None:
    F, Q = model[0], model[1]
    _transition(F, T, 0.0, 0.0, 0.0)
    Q[0, 0], Q[0, 1], Q[1, 0], Q[1, 1] = q * T**3 / 3, q * T**2 / 2, q * T**2 / 2, q * T


def constant_acceleration(dt_s: float, settings: Mode) -> Floats:
    """Return (2, 3, 3): F and Q of each axis, for an acceleration that drifts as a Wiener process (white jerk).

    F is König 2008, eq 6.18, with the true time between the frames. Q is the integral of the jerk over that time, so
    that two short steps are exactly one long one: a dropped frame or another frame rate changes nothing. The thesis'
    own Q (eq 6.33) lacks this; it is `wiener_acceleration`.
    """
    model = np.empty((2, 3, 3))
    _constant_acceleration(dt_s, settings.drift_mps2**2, model)
    return model


@njit(cache=True, nogil=True)
def _constant_acceleration(T: float, q: float, model: Floats) -> None:
    F, Q = model[0], model[1]
    _transition(F, T, T * T / 2, T, 1.0)
    Q[0, 0], Q[0, 1], Q[0, 2] = q * T**5 / 20, q * T**4 / 8, q * T**3 / 6
    Q[1, 0], Q[1, 1], Q[1, 2] = q * T**4 / 8, q * T**3 / 3, q * T**2 / 2
    Q[2, 0], Q[2, 1], Q[2, 2] = q * T**3 / 6, q * T**2 / 2, q * T


@njit(cache=True, nogil=True)
def _transition(F: Floats, T: float, a_to_x: float, a_to_v: float, a_to_a: float) -> None:
    F[0, 0], F[0, 1], F[0, 2] = 1.0, T, a_to_x
    F[1, 0], F[1, 1], F[1, 2] = 0.0, 1.0, a_to_v
    F[2, 0], F[2, 1], F[2, 2] = 0.0, 0.0, a_to_a


def wiener_acceleration(dt_s: float, settings: Mode) -> Floats:
    """Return (2, 3, 3): F and Q of each axis, of König 2008, eq 6.18 and 6.33: the acceleration steps in each frame.

    The step is as large whether the frame was long or short, so sigma_w belongs to a frame rate; in a gap the
    uncertainty grows only as if the one step had come at its start.
    """
    model = np.empty((2, 3, 3))
    _wiener_acceleration(dt_s, settings.step_mps2**2, model)
    return model


@njit(cache=True, nogil=True)
def _wiener_acceleration(T: float, variance: float, model: Floats) -> None:
    F, Q = model[0], model[1]
    _transition(F, T, T * T / 2, T, 1.0)
    gamma = (T * T / 2, T, 1.0)  # eq 6.20
    for a in range(3):
        for b in range(3):
            Q[a, b] = variance * gamma[a] * gamma[b]  # eq 6.32


def singer(dt_s: float, settings: Mode) -> Floats:
    """Return (2, 3, 3): F and Q of each axis, for an acceleration that drifts and dies away (Singer 1970).

    da/dt = -a / memory_s + jerk. For long memories this is `constant_acceleration`, for short ones constant velocity.
    """
    model = np.zeros((2, 3, 3))
    _singer(dt_s, settings.drift_mps2**2, 1 / settings.memory_s, model)
    return model


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@njit(cache=True, nogil=True)
def _singer(T: float, q: float, rate: float, model: Floats) -> None:
    """Integrate the response to the jerk numerically: the closed form of Q loses all digits for small rate * T."""
    F, Q = model[0], model[1]
    for node in range(_NODES.size):
        response = _response(T * (1 + _NODES[node]) / 2, rate)
        for a in range(3):
            for b in range(3):
                Q[a, b] += q * _WEIGHTS[node] * T / 2 * (response[a] * response[b])
    a_to_x, a_to_v, a_to_a = _response(T, rate)
    _transition(F, T, a_to_x, a_to_v, a_to_a)


@njit(cache=True, nogil=True)
def _response(t: float, rate: float) -> tuple[float, float, float]:
    """Return what an acceleration of 1 has made of position, velocity and acceleration after t."""
    u = rate * t
    to_v = -math.expm1(-u)
    to_x = u - to_v if u > 1e-3 else u * u * (0.5 - u / 6 + u * u / 24)
    return to_x / rate**2, to_v / rate, math.exp(-u)


def coordinated_turn(dt_s: float, settings: Mode) -> Floats:
    """Return (2, 3, 3): F and Q of each axis for an object that turns in the horizontal plane, at the turn rate 0.

    At a constant turn rate w and speed, da/dt = -w^2 v on both horizontal axes (Li and Jilkov 2003, part I, V.B), to
    which the white jerk adds; so F of both is alike. The state holds w = (v x a) / v^2: the tracker puts it
    in for each track and linearises about it (`tracking.moving.turning`). At w = 0, and on the vertical axis,
    this is `constant_acceleration`; its Q differs from that of the turn by less than (w dt)^2 / 2 of itself.
    """
    return constant_acceleration(dt_s, settings)


MOTION: dict[str, Callable[[float, Mode], Floats]] = {
    "constant_velocity": constant_velocity,
    "constant_acceleration": constant_acceleration,
    "wiener_acceleration": wiener_acceleration,
    "singer": singer,
    "coordinated_turn": coordinated_turn,
}
"""Motion models by name: (seconds between the frames, settings) -> F, Q of one axis."""

TURNS = "coordinated_turn"
"""The one whose F depends on the state."""


def mode_switching(dt_s: float, count: int, memory_s: float) -> Floats:
    """Return (K, K): the probability that an object in mode j is in mode k after `dt_s`.

    A Markov chain in continuous time that leaves a mode after `memory_s` on the average, for any other alike; so a gap
    of two frames is exactly two frames (the fixed matrix that is usual would hold for one frame rate only).
    """
    if count == 1:
        return np.ones((1, 1))
    switching = np.empty((count, count))
    _switching(math.exp(-dt_s / memory_s * count / (count - 1)), switching)
    return switching


@njit(cache=True, nogil=True)
def _switching(kept: float, switching: Floats) -> None:
    count = len(switching)
    for j in range(count):
        for k in range(count):
            switching[j, k] = (1 - kept) / count + (kept if j == k else 0.0)
