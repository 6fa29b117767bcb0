"""The brake: rules and stopping distance, and what stands around them: health, state machine, gate, friction."""

from rangecam.brake.decision import decide
from rangecam.brake.settings import DecisionSettings
from rangecam.brake.unit import BrakeSettings

__all__ = ["BrakeSettings", "DecisionSettings", "decide"]
