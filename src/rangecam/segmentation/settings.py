"""What can be set about segmentation and the measurement of segments."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings


@settings
class SegmentSettings:
    """How segments are found, and how sure their positions are."""

    min_pixels: PositiveInt = 10
    """Smaller segments are background."""
    growing_threshold_m: NonNegative = 0.5
    """Region growing: a pixel joins if its range differs from the mean range of the object by less than this, ..."""
    growing_threshold_sigmas: NonNegative = 3.0
    """... plus so many standard deviations of the pixel's range."""
    growing_step_m: NonNegative = 0.0
    """Region growing: a pixel also joins if its range differs by less than this from the pixel next to it; 0: never.

    Keeps long inclined objects whole, at the risk of joining what touches.
    """
    connectivity: Literal[4, 8] = 8
    """Region growing: how many neighbours a pixel has."""
    histogram_of: Literal["depth", "range"] = "depth"
    """Histogram: count the distance along the vehicle's x axis (a plane ahead is one peak), or the radial range."""
    bin_width_m: Positive = 0.05
    smoothing_bins: PositiveInt = 3
    """Histogram: number of bins averaged into each before looking for minima; even numbers act like the next odd."""
    min_peak: NonNegative = 3.0
    """Histogram: least pixels in the highest (smoothed) bin of an object."""
    max_valley_to_peak: Fraction = 0.6
    """Histogram: a minimum separates if it is at most this fraction of the peak next to it."""
    max_valley_difference: Fraction = 0.5
    """Histogram: the minima on both sides of an object may differ by at most this fraction of its peak."""
    small_bin: NonNegative = 0.5
    """Histogram: bins with at most so many (smoothed) pixels belong to no object and are borders."""
    sigma_pixel: NonNegative = 0.015
    """Standard deviation of a centroid's image position that no number of pixels makes smaller, pixels."""
    edge_jitter: NonNegative = 0.3
    """Standard deviation of the position of a segment's outline at each of its border pixels, pixels."""
    sigma_systematic_m: NonNegative = 0.005
    """Standard deviation of a segment's range that no number of pixels makes smaller."""
    shared_noise_pixels: Annotated[float, Interval(ge=1)] = 6.6
    """Over how many pixels the noise is the same; 1: independent. Unless it is set, what the filter of `clean` says."""
    near_fraction: Annotated[float, Interval(gt=0, le=0.5)] = 0.05
    """Part of a segment's pixels that may lie nearer than its nearest distance."""
    occluder_step_m: NonNegative = 0.2
    """Something hides a part of a segment if it is nearer at the segment's outline by more than this, ..."""
    occluder_sigmas: NonNegative = 3.0
    """... plus so many standard deviations of the difference of range, ..."""
    occluder_fraction: Fraction = 0.05
    """... along more than this part of the outline, and at more than one of its pixels."""
