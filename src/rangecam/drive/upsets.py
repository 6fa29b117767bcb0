"""What goes wrong on purpose: processes killed, restarted and frozen while the car drives, and what is stated of it."""

import signal
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rangecam.brake.machine import Mode
from rangecam.brake.rule import GRAVITY_MPS2
from rangecam.config import Config
from rangecam.drive.mind import brake_settings
from rangecam.drive.rig import STANDS_MPS, Rig
from rangecam.drive.roles import SIGN_S, at_once
from rangecam.drive.settings import DriveSettings
from rangecam.errors import DataError
from rangecam.vehicle.unit import Control

KINDS = tuple((role, action) for role in ("camera", "perception", "car") for action in ("kill", "restart", "freeze"))
"""kill: the process is gone until the car stands; restart: it is started again at once; freeze: it stands still until
the car stands, that of the car for some tenths of a second."""
_SLOW_MPS = 0.3
"""What is upset drives at least so fast."""
_TRIES = 10
_RECOVERS_S = 300.0  # at most; nothing is compiled anew


@dataclass(frozen=True)
class Upset:
    """What was done to a process at what speed, and what came of it.

    claim: "stops" within `stated_s` after that, or, where the car itself is gone, it "is noticed" by perception and
    watchdog. took_s: how long it took; recovered_s: from when the process was helped up until all worked and the driver
    drove; both None where it never came. tries: starts until the car drove so fast.
    """

    role: str
    action: str
    speed_mps: float
    claim: str
    stated_s: float
    took_s: float | None
    recovered_s: float | None
    tries: int

    @property
    def held(self) -> bool:
        """Whether what is stated came true."""
        return self.took_s is not None and self.took_s <= self.stated_s and self.recovered_s is not None


def noticed_s(config: Config, settings: DriveSettings) -> float:
    """Return within what time it is noticed that something has ceased to come.

    The timeout of images, of signs of life or of the car's state runs out, the perception says so or ceases to give
    signs (twice: the last one was just sent, and the watchdog's own timeout begins with it), two looks and the way over
    the bus pass, and an image may have been on its way.
    """
    machine = brake_settings(config, at_once(settings)).machine
    timeout_s = max(machine.image_timeout_s, machine.car_timeout_s)
    return timeout_s + 2 * SIGN_S + 4 * settings.step_s + 2 / config.camera.frame_rate_hz


def stated_stop_s(speed_mps: float, config: Config, settings: DriveSettings) -> float:
    """Return within what time the car stands after a process has ceased.

    That is noticed, the brakes begin and rise, and friction does the rest, with the speed that the car may have gained
    until then. A tenth of the friction is left out of account.
    """
    vehicle, waits_s = settings.vehicle, noticed_s(config, settings)
    gained_mps = speed_mps + vehicle.drive_mps2 * (waits_s + vehicle.brake_delay_s)
    slows_s = min(gained_mps, vehicle.max_speed_mps) / (0.9 * settings.friction * GRAVITY_MPS2)
    return waits_s + vehicle.brake_delay_s + vehicle.brake_rise_s + slows_s


def upset(rig: Rig, role: str, action: str, rng: np.random.Generator) -> Upset:
    """Do something to a process while the car drives, see what comes of it, help the process up, see all recover.

    Raises DataError if the car does not get to drive, because something else goes wrong each time.
    """
    tries = _driving(rig, rng)
    began_s, speed = rig.job.now_s(), float(rig.car["speed_mps"])
    rig.send(role, signal.SIGSTOP if action == "freeze" else signal.SIGKILL)
    if action == "restart":
        rig.start(role)
    gone = role == "car" and action != "freeze"
    took_s, stated_s = _noticed(rig, began_s) if gone else _stopped(rig, role, began_s, speed, rng)
    rig.put_back()
    helped_s = rig.job.now_s()
    if action == "kill":
        rig.start(role)
    elif action == "freeze" and role != "car":
        rig.send(role, signal.SIGCONT)
    recovered = rig.watch(_RECOVERS_S, lambda: rig.ready and (not gone or _held(rig, began_s)))
    recovered_s = round(rig.job.now_s() - helped_s, 3) if recovered else None
    claim = "is noticed" if gone else "stops"
    return Upset(role, action, round(speed, 3), claim, round(stated_s, 3), took_s, recovered_s, tries)


def _driving(rig: Rig, rng: np.random.Generator) -> int:
    """Let the driver drive for a while that is drawn, until the car obeys him at speed; return how many starts."""
    for tries in range(1, _TRIES + 1):
        rig.put_back()
        rig.await_ready()
        rig.go()
        rig.watch(float(rng.uniform(0.4, 1.6)))
        if rig.ready and rig.car["speed_mps"] > _SLOW_MPS:
            return tries
    raise DataError(f"the car did not get to drive in {_TRIES} starts: {rig.events[-3:]}")


def _stopped(
    rig: Rig, role: str, began_s: float, speed_mps: float, rng: np.random.Generator
) -> tuple[float | None, float]:
    """Return how long the car took until it stood, None for more than three times as stated; and what is stated."""
    stated_s = stated_stop_s(speed_mps, rig.job.config, rig.job.settings)
    if role == "car":
        frozen_s = float(rng.uniform(0.3, 0.6))
        rig.watch(frozen_s)
        rig.send(role, signal.SIGCONT)
        stated_s += frozen_s + _gained_s(frozen_s, rig.job.settings)
    stands = rig.watch(3 * stated_s, lambda: rig.car["time_s"] > began_s and rig.car["speed_mps"] < STANDS_MPS)
    return round(rig.car["time_s"] - began_s, 3) if stands else None, stated_s


def _gained_s(frozen_s: float, settings: DriveSettings) -> float:
    """Return how much longer a stop takes after full throttle for a while in which nobody could do anything."""
    return settings.vehicle.drive_mps2 * frozen_s / (0.9 * settings.friction * GRAVITY_MPS2)


def _noticed(rig: Rig, began_s: float) -> tuple[float | None, float]:
    """Return when perception and watchdog both knew of a fault, None if late; and what is stated."""
    stated_s = noticed_s(rig.job.config, rig.job.settings)
    both = rig.watch(3 * stated_s, lambda: rig.mode is Mode.FAULT and rig.guard is Mode.FAULT)
    return round(rig.job.now_s() - began_s, 3) if both else None, stated_s


def _held(rig: Rig, began_s: float) -> bool:
    """Return whether the car that came back was held by the bus at standstill before its driver had it."""
    since = [each for each in rig.cars[-20_000:] if each["born_s"] > began_s]
    held = next((k for k, each in enumerate(since) if each["control"] == int(Control.BUS)), len(since))
    return held < len(since) and all(each["speed_mps"] < STANDS_MPS for each in since[: held + 1])


def upsets(rig: Rig, count: int, rng: np.random.Generator) -> Iterator[Upset]:
    """Yield so many upsets as they happen: each kind once in a drawn order, again and again."""
    order: list[tuple[str, str]] = []
    for _ in range(count):
        order = order or [KINDS[k] for k in rng.permutation(len(KINDS))]
        role, action = order.pop()
        yield upset(rig, role, action, rng)
