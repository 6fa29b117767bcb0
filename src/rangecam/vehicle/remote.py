"""The remote control: a hand that holds three channels (S-VEH-01)."""

from typing import NamedTuple

from rangecam.vehicle.dynamics import Command


class Hand(NamedTuple):
    """Where the channels are held: 1 full throttle, -1 full brake; 1 full lock to the left; forward or backward."""

    throttle: float = 0.0
    steer: float = 0.0
    forward: bool = True


def command_of(hand: Hand) -> Command:
    """Return what the actuators are told when the remote control is obeyed."""
    return Command(max(hand.throttle, 0.0), max(-hand.throttle, 0.0), max(-1.0, min(hand.steer, 1.0)), hand.forward)
