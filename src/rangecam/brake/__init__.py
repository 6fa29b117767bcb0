"""The brake: rule and stopping distance, and the function around them: health, state machine, gate, friction."""

from rangecam.brake.decision import decide
from rangecam.brake.rule import DecisionSettings
from rangecam.brake.unit import BrakeSettings

__all__ = ["BrakeSettings", "DecisionSettings", "decide"]
