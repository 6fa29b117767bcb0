"""Settings of what makes a continuous-wave camera imperfect, for the simulation; all of it is off by default."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.settings import Fraction, NonNegative, NonNegativeInt, Positive, PositiveInt, settings

Signal = Literal["sine", "square"]
DutyCycle = Annotated[float, Interval(gt=0, lt=1)]


@settings
class Waveform:
    """Shape of light and reference signal; their harmonics make the wiggling error (S-EFF-01)."""

    illumination: Signal = "sine"
    """Modulation of the light."""
    reference: Signal = "sine"
    """Signal that switches the taps of the pixels."""
    illumination_duty_cycle: DutyCycle = 0.5
    """Part of a period in which a square light is on; a third has no third harmonic."""
    reference_duty_cycle: DutyCycle = 0.5
    """Part of a period in which a square reference switches to the first tap."""
    bandwidth_hz: Positive | None = None
    """The light source is a low-pass filter of first order with this limit; none: it follows at once."""


@settings
class Taps:
    """What the two taps of a pixel can hold (S-EFF-02, S-EFF-03)."""

    full_well_lsb: Positive | None = None
    """Light that saturates a tap, in LSB of a sample; none: no limit. *Open* in the thesis."""
    ambient_suppression_lsb: NonNegative = 0.0
    """Light, the same for both taps of a differential pixel, that its circuit takes out of each before it saturates it;
    beyond it the pixel saturates although the difference of its taps is small. *Open* in the thesis."""
    saturated_reads_full_scale: bool = True
    """A saturated pixel reads `full_scale_lsb` where that is known, as a flag; else the difference of its full taps.
    *Open* in the thesis."""


@settings
class FixedPattern:
    """What differs from pixel to pixel and stays (S-EFF-11); pixels of a binned sensor average it."""

    seed: NonNegativeInt = 0
    """Which sensor it is."""
    global_offset_m: float = 0.0
    """Every range is measured too long by it, beside what the camera's `offset_m` takes out."""
    range_sigma_m: NonNegative = 0.0
    """Standard deviation over the pixels by which a range is measured too long."""
    gain_sigma: NonNegative = 0.0
    """Standard deviation over the pixels of the gain, over its mean."""
    offset_sigma_lsb: NonNegative = 0.0
    """Standard deviation over the pixels of a sample without light."""


@settings
class Temperature:
    """Warm drivers are slow: the range drifts with the temperature of the camera (S-EFF-11)."""

    drift_m_per_k: float = 0.0
    """Every range is measured too long by it for each kelvin over the reference. *Open*: some mm per K are usual."""
    reference_c: float = 25.0
    """Temperature at which the camera measures right."""
    temperature_c: float = 25.0
    """Temperature of the camera when it is switched on, at time 0."""
    self_heating_k: NonNegative = 0.0
    """How much warmer it becomes by itself in the end."""
    heating_time_s: Positive = 600.0
    """Time constant of that."""
    measured: bool = False
    """Frames carry the temperature, as plane temperature_c."""


@settings
class Scattering:
    """Light that is reflected between lens and sensor lands elsewhere in the image (S-EFF-04)."""

    stray_fraction: Fraction = 0.0
    """Part of the light of every pixel that is spread over the image. *Open*: 1 % is a usual case, `STRAY_FRACTION`."""
    width: Positive = 0.25
    """Standard deviation of the Gaussian over which it is spread, in widths of the image. *Open*."""


STRAY_FRACTION = 0.01
"""Stray light of the standard case; *open* in the thesis."""


@settings
class Multipath:
    """Light that comes by way of a second surface, two bounces in all (S-EFF-09)."""

    two_bounces: bool = False
    """Whether it is simulated: between all surfaces that the camera sees, without shadows between them."""
    block_pixels: PositiveInt = 4
    """Surfaces light each other as patches of so many pixels squared."""


@settings
class Interference:
    """A second camera beside ours that lights the same scene and is not synchronised with it."""

    strength: NonNegative = 0.0
    """Its light over ours."""
    modulation_hz: Positive = 17.0002e6
    """Its modulation frequency; the beat with ours moves the range from image to image."""
    phase_deg: float = 0.0
    """Phase of its light before ours at time 0."""


@settings
class Link:
    """The parallel interface between sensor and processor, and its faults (S-PIF-01, S-EFF-15; Steinbäck 2016, A.1)."""

    pixel_clock_hz: Positive | None = None
    """Pixels a second, 66.6e6 or a half, a quarter or an eighth of it in the thesis: no phase image is read out in less
    time than its pixels take (N-S-018, N-S-041). None: `readout_time_s` alone counts."""
    missed_clock_probability: Fraction = 0.0
    """Probability that the edge of the pixel clock of a pixel is missed: that pixel is lost, the rest of its row moves
    one column to the left, and the row ends with zeros."""
    bit_error_probability: Fraction = 0.0
    """Probability that crosstalk turns over a bit of a sample."""
    bits: Annotated[int, Interval(ge=1, le=16)] = 12
    """Data lines of the interface (S-PIF-01)."""
