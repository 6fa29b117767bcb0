"""The brake: rule and stopping distance."""

from rangecam.brake.decision import decide
from rangecam.brake.rule import DecisionSettings

__all__ = ["DecisionSettings", "decide"]
