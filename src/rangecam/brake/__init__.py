"""The brake: rules, stopping distance, probability that braking comes too late."""

from rangecam.brake.decision import decide
from rangecam.brake.settings import DecisionSettings

__all__ = ["DecisionSettings", "decide"]
