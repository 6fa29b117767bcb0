"""From segments to tracks: predict, associate, update, initiate, delete."""

from rangecam.tracking.association import ASSOCIATION
from rangecam.tracking.settings import TrackingSettings
from rangecam.tracking.update import update_tracks

__all__ = ["ASSOCIATION", "TrackingSettings", "update_tracks"]
