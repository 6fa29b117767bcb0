"""The brake: rule and stopping distance."""

from rangecam.settings import settings


@settings
class DecisionSettings:
    """When to brake."""
