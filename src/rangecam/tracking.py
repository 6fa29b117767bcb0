"""From segments to tracks."""

from rangecam.settings import settings


@settings
class TrackingSettings:
    """How tracks live."""
