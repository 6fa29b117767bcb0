"""The brake: rule and stopping distance."""

from rangecam.brake.rule import DecisionSettings, decide

__all__ = ["DecisionSettings", "decide"]
