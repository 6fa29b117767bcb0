"""From points to objects: which pixels belong together, and what they measure."""

from collections.abc import Callable

from rangecam.segmentation.growing import region_growing
from rangecam.segmentation.histogram import range_histogram
from rangecam.segmentation.measure import measure_segments
from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage

__all__ = ["SEGMENTATION", "SegmentSettings", "measure_segments"]

SEGMENTATION: dict[str, Callable[[RangeImage, Floats, SegmentSettings], Ints]] = {
    "region_growing": region_growing,
    "range_histogram": range_histogram,
}
"""Methods: (image, points (H, W, 3) m, settings) -> labels (H, W) int32, 0 for background, segments 1..N."""
