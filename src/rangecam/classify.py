"""What a track is."""

from rangecam.settings import settings


@settings
class ClassificationSettings:
    """How tracks are classified."""
