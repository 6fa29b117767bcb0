"""The one call of the chain: `classify`."""

from collections.abc import Callable

from rangecam.classify.action import actions
from rangecam.classify.learned import learned
from rangecam.classify.rules import rules
from rangecam.classify.settings import ClassificationSettings
from rangecam.types import Ego, Segments, Tracks
from rangecam.values import changed

Method = Callable[[Tracks, Ego, ClassificationSettings, Segments], Tracks]


def classify(tracks: Tracks, ego: Ego, settings: ClassificationSettings, segments: Segments) -> Tracks:
    """Return the tracks with the probabilities of their classes, by `settings.method`, and of their actions.

    `segments` are those of the frame, which `tracks.segment` names. Tentative tracks are unknown; unseen ones keep what
    they were.
    """
    classified = CLASSIFICATION[settings.method](tracks, ego, settings, segments)
    return changed(classified, action_probability=actions(tracks, ego, settings.moving_mps))


CLASSIFICATION: dict[str, Method] = {"rules": rules, "learned": learned}
"""Methods of classification by name."""
