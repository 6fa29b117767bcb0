"""What can be set about cleaning."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.settings import Fraction, NonNegative, Positive, settings


@settings
class CleanSettings:
    """What is cleaned, and how strictly."""

    amplitude_threshold: NonNegative = 0.0
    """A pixel weaker than this fraction of the reference amplitude is LOW_AMPLITUDE (c_th1); 0: off."""
    wrap_threshold: NonNegative = 0.0
    """A pixel whose amplitude times squared depth is below this fraction of the reference is WRAPPED (c_th2); 0: off.

    An object beyond the unambiguous range seems near but sends little light, as do drops and dust. Dark near objects
    are lost too.
    """
    reference_amplitude: Positive = 145.0
    """Amplitude of a white surface at 1 m in the image centre, in the unit of the sensor."""
    reference_floor: Fraction = 10 / 145
    """Part of the reference that does not fall off towards the image border."""
    reference_falloff: NonNegative = 7.0
    """Exponent of the cosines of azimuth and elevation by which the rest of the reference falls off."""
    min_neighbours: Annotated[int, Interval(ge=0, le=8)] = 3
    """How many of the 8 neighbours must be common neighbours, else the pixel is ISOLATED; fewer at the image border."""
    neighbour_tolerance_m: NonNegative = 0.1
    """Two pixels are common neighbours up to this difference of range, ..."""
    neighbour_tolerance_sigmas: NonNegative = 3.0
    """... plus so many standard deviations of the difference."""
    discard_border: bool = False
    """Refuse the outermost rows and columns, which have no full neighbourhood (BORDER)."""
    reject_flying: bool = False
    """Refuse pixels between two surfaces (FLYING)."""
    flying_tolerance_m: NonNegative = 0.01
    """A flying pixel differs from its neighbours on both sides by more than this, ..."""
    flying_tolerance_sigmas: NonNegative = 2.0
    """... plus so many standard deviations of the difference."""
    filter: Literal["off", "median", "mean", "bilateral", "cross_bilateral", "total_variation"] = "median"
    """How the valid pixels around each valid pixel lower its noise, a key of `clean.FILTERS`."""
    window: Literal["3x1", "3x3"] = "3x3"
    """Neighbourhood of median and mean: 3 columns in 1 row, or 3 in 3."""
    median_across_edges: bool = False
    """Let the median take every valid neighbour, not only common ones; at edges it then leans to the other surface."""
    bilateral_sigma_px: Positive = 1.5
    """Bilateral filters: standard deviation of the weight over the distance in the image, of 5x5 pixels."""
    amplitude_tolerance: Positive = 0.5
    """Cross-bilateral filter: amplitudes that differ by this fraction of their mean have nothing to do with each other;
    it should be well above the noise of the amplitude."""
    total_variation: Positive = 1.0
    """Total variation: strength; 1 weighs a step of one sigma between neighbours like a residual of sqrt(2) sigma."""
    temporal_frames: Annotated[float, Interval(ge=1)] = 1.0
    """Number of images over which the range of a pixel at rest is averaged; 1: off."""
    temporal_gate_sigmas: Positive = 3.0
    """A pixel whose range changed by more than so many standard deviations begins anew."""
    floor: Literal["off", "mounting", "fit", "image"] = "off"
    """Remove the floor: where the mounting says it is, where a plane fits the far side of the image, or where an image
    that was taken without objects saw it."""
    floor_file: str = ""
    """File (.npz) with images of the bare floor, as `rangecam run ... --images FILE` writes it."""
    floor_max_tilt_deg: Annotated[float, Interval(ge=0, le=90)] = 20.0
    """A fitted plane that leans further than this away from the floor of the mounting is no floor."""
    floor_margin_m: NonNegative = 0.1
    """Height above the floor up to which a point belongs to it."""
    floor_margin_sigmas: NonNegative = 2.0
    """The same in standard deviations of the range, in addition."""
    x_min_m: float | None = None
    """Area of interest, a box in vehicle axes: beginning ahead of the vehicle's reference point; none: no limit."""
    x_max_m: float | None = None
    """End of the area of interest."""
    width_m: Positive | None = None
    """Full width of the area of interest, half of it on either side."""
    z_min_m: float | None = None
    """Lower side of the area of interest."""
    z_max_m: float | None = None
    """Upper side of the area of interest."""
