"""From points to objects: which pixels belong together, and what they measure."""

from collections.abc import Callable

from rangecam.segmentation.clusters import connected_slices, k_means, mean_shift
from rangecam.segmentation.growing import region_growing
from rangecam.segmentation.growing_3d import region_growing_3d, region_growing_seeded
from rangecam.segmentation.histogram import range_histogram
from rangecam.segmentation.measure import measure_segments
from rangecam.segmentation.settings import SegmentSettings
from rangecam.types import Floats, Ints, RangeImage, Tracks

__all__ = ["SEEDED", "SEGMENTATION", "SegmentSettings", "measure_segments", "segment"]

SEEDED: dict[str, Callable[[RangeImage, Floats, SegmentSettings, Tracks], Ints]] = {
    "region_growing_seeded": region_growing_seeded,
}
"""Methods that also take the tracks of the last frame: (image, points, settings, tracks) -> labels."""

SEGMENTATION: dict[str, Callable[[RangeImage, Floats, SegmentSettings], Ints]] = {
    "region_growing": region_growing,
    "region_growing_3d": region_growing_3d,
    "region_growing_seeded": region_growing_seeded,
    "range_histogram": range_histogram,
    "connected_slices": connected_slices,
    "mean_shift": mean_shift,
    "k_means": k_means,
}
"""Methods: (image, points (H, W, 3) m, settings) -> labels (H, W) int32, 0 for background, segments 1..N."""


def segment(method: str, image: RangeImage, points: Floats, settings: SegmentSettings, tracks: Tracks) -> Ints:
    """Return the labels (H, W) by a method of `SEGMENTATION`; those of `SEEDED` get the tracks of the last frame."""
    if method in SEEDED:
        return SEEDED[method](image, points, settings, tracks)
    return SEGMENTATION[method](image, points, settings)
