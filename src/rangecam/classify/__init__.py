"""What a track is and what it does: class and action, each with its probability (K-CLS-01, K-CLS-02, S-SEG-06)."""

from rangecam.classify.classify import CLASSIFICATION, classify
from rangecam.classify.settings import ClassificationSettings

__all__ = ["CLASSIFICATION", "ClassificationSettings", "classify"]
