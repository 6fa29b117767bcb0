"""From a range image to a clean one: fewer valid pixels, less noise, sigma kept true."""

from rangecam.settings import settings


@settings
class CleanSettings:
    """What is cleaned, and how strictly."""
