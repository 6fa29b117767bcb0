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
    """Region growing and slices: how many neighbours a pixel has."""
    surface_incidence_deg: Annotated[float, Interval(ge=0, lt=90)] = 80.0
    """Region growing in 3D: neighbours join if a surface that is seen under at most this angle of incidence could hold
    both, ..."""
    surface_sigmas: NonNegative = 3.0
    """... give or take so many standard deviations of the difference of their ranges."""
    amplitude_difference: NonNegative = 0.0
    """Region growing in 3D: amplitudes of neighbours may differ by this fraction of their mean; 0: by any."""
    seed_reach_m: Positive = 0.3
    """Seeded region growing: how far from the predicted position of a track its first pixel may lie."""
    slice_m: Positive = 0.5
    """Slices: width of a slice of distance."""
    bandwidth_m: Positive = 0.5
    """Mean shift: radius within which points attract each other."""
    cluster_radius_m: Positive = 1.5
    """k-means: farther from the middle of an object no point belongs to it."""
    histogram_of: Literal["depth", "range"] = "depth"
    """Histogram and slices: distance along the vehicle's x axis (a plane ahead is one peak), or the radial range."""
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
    max_gap_m: Positive | None = None
    """Histogram: what is as far away, but farther apart beside each other than this, is two objects; none: one, however
    far apart (the thesis)."""
    sigma_pixel: NonNegative = 0.015
    """Standard deviation of a centroid's image position that no number of pixels makes smaller, pixels."""
    edge_jitter: NonNegative = 0.3
    """Standard deviation of the position of a segment's outline at each of its border pixels, pixels."""
    edge_step: NonNegative = 0.29
    """The same of a whole side of the outline: a straight edge between two columns or rows belongs to one or the other
    with all of its pixels, so that it is off by up to half a pixel, evenly."""
    sigma_systematic_m: NonNegative = 0.005
    """Standard deviation of a segment's range that no number of pixels makes smaller."""
    depth_scatter: Fraction = 0.0
    """Share of the variance of a segment's points along x that is chance: 0 for a solid surface, whose depth is its
    shape; more where shutters that are taken one after the other tear the edges of what moves apart."""
    edge_range_sigma_m: NonNegative = 0.0
    """Standard deviation of the range of a segment's leftmost and rightmost pixels, alike in all rows, for something
    90 degrees beside our way; less by the sine elsewhere. Shutters that are taken one after the other see such pixels
    filled by different parts of what we pass. It is that of the whole segment where this is one column wide."""
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
    dim_sigma_m: NonNegative = 0.0
    """A thing ends at its sides where its surface does, also where that goes on outside the area of interest, or is too
    dim to be used: pixels refused for their light or their neighbours count if the standard deviation of their range is
    at most this. 0: it ends with its label, and seems to move as more of it becomes bright enough."""
    pieces_slide: bool = False
    """Whether the middle of a piece of a surface that goes on at its ends is as uncertain, along the surface, as the
    piece is long: what is grown by range falls into pieces where a rail or a wall is seen at a grazing angle, others in
    each image where the range is noisy."""
