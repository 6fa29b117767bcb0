"""The settings of a pulsed camera: everything that simulation and ranging need to know of it."""

from typing import Annotated, Literal

from annotated_types import Gt, Interval, Len

from rangecam.geometry import Lens
from rangecam.optics import Objective
from rangecam.pulsed.bit_pattern import Sequencer
from rangecam.pulsed.crosstalk import Crosstalk
from rangecam.pulsed.laser import Laser
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings
from rangecam.types import SPEED_OF_LIGHT

__all__ = ["Background", "Crosstalk", "Laser", "Pixel", "PulsedCamera", "Sequencer", "Taps"]

SensorNoise = Literal[
    "photodiode", "reset", "shutter", "follower", "amplifier", "select", "discharge", "accumulate", "ddpix", "ref3",
    "ref4",
]  # fmt: skip
"""Parts of the noise of one accumulation, sigma_S (König 2008, 4.2.3.1)."""
ReadoutNoise = Literal["buffer", "board"]
"""Parts of the noise of one read-out, sigma_R, besides the rounding of the converter."""


@settings
class Pixel:
    """The shutter pixel with its charge, accumulation and read-out (König 2008, 4.1.1 and 4.2); voltages at the output.

    The thesis does not give the bits of the converter (K-PIX-14).
    """

    pitch_horizontal_m: Positive = 130e-6
    pitch_vertical_m: Positive = 300e-6
    sensitivity_apw: Positive = 0.1204
    """Spectral sensitivity at the laser's wavelength, A/W; 0.1204 gives the measured 2617 V/(J/m2) (N-K-024)."""
    diode_capacitance_f: Positive = 5.1e-12
    sense_capacitance_f: Positive = 1e-12
    follower_gain: Positive = 0.85
    clamp_capacitance_f: Positive = 10e-12
    feedback_capacitance_f: Positive = 2.5e-12
    saturation_v: Positive = 1.5
    """Largest output voltage (4.2.3.1)."""
    accumulations: Annotated[tuple[Annotated[int, Interval(ge=1, le=255)], ...], Len(1)] = (1, 4, 16, 64, 100)
    """Numbers of pulses at which the accumulated signal is read without destroying it (4.1.1.4)."""
    damping: NonNegative = 0.0153
    """Loss of the accumulated signal with every further pulse (eq 4.17); 0: none."""
    sensor_noise_v: NonNegative = 0.379e-3
    """sigma_S, noise of one accumulation (eq 4.22)."""
    readout_noise_v: NonNegative = 0.442e-3
    """sigma_R, noise of one read-out (eq 4.23)."""
    photon_noise: bool = True
    """Shot noise of laser and ambient light (eqs 4.24-4.28)."""
    noise_off: tuple[SensorNoise | ReadoutNoise, ...] = ()
    """Parts of sigma_S and sigma_R that are switched off, to see what a better circuit would gain (`pulsed.noise`)."""
    adc_bits: Annotated[int, Interval(ge=0, le=24)] = 12
    """Bits of the converter over 0..saturation_v; 0: no rounding. *open*"""
    fixed_pattern_v: NonNegative = 0.0
    """Standard deviation, over pixels and shutters, of the offset of a read-out (simulation; 4.3.1). *open*"""
    fixed_pattern_per_pulse_v: NonNegative = 0.0
    """The same of the offset of every pulse, which accumulates as the signal does (simulation). *open*"""
    fixed_pattern_per_step_v: NonNegative = 0.0
    """The same of an offset that each number of accumulations has of its own (simulation; K-PIX-16). *open*"""
    fixed_pattern_vps: NonNegative = 0.0
    """The same of the rate of an offset that grows with the length of the shutter, for every pulse (simulation;
    K-PIX-16). *open*"""
    offset_drift_vpk: float = 0.0
    """Change of the offset of every read-out for each kelvin from 25 °C (simulation; 5.2.1.1). *open*"""
    offset_drift_spread_vpk: NonNegative = 0.0
    """Standard deviation of that change over pixels and shutters (simulation). *open*"""
    fixed_pattern_seed: Annotated[int, Interval(ge=0)] = 0
    """Which sensor it is: other seeds, other patterns (simulation)."""
    noise_threshold_v: NonNegative = 0.0
    """A signal (both shutters, or the long one) below it is LOW_AMPLITUDE (4.1.5); 0: `min_snr` alone decides."""


@settings
class Taps:
    """The pixel of a sensor with three gates, in counts of its converter.

    The noise was fitted to recordings of a Brookman BEC80T.
    """

    black_level_counts: float = 270.0
    """Tap without any light."""
    read_noise_counts: NonNegative = 3.05
    """Standard deviation of a tap without light."""
    shot_noise_counts2_per_count: NonNegative = 0.025
    """Variance per count of light: one over the electrons per count."""
    counts_per_jpm2: Positive = 3e6
    """Counts per exposure, J/m2 (simulation); *open*: 10 um pixels of 30 % quantum efficiency."""
    pulses: PositiveInt = 3000
    """Pulses of one image (simulation). *open*"""
    dark_frames: PositiveInt = 30
    """Frames that were averaged into the dark image."""
    saturation_counts: Positive = 4000.0
    """A tap at or above it is saturated; more is never counted (simulation)."""
    noise_threshold_counts: NonNegative = 0.0
    """Light of the pulse (all taps together) below it is LOW_AMPLITUDE; 0: `min_snr` alone decides."""


@settings
class Background:
    """How ambient light varies while the sensor subtracts it (K-PIX-07, K-ENV-01): as a random walk around its mean.

    What it changes between the exposures with the laser on and off stays in the signal; sigma does not know of it.
    """

    fluctuation: NonNegative = 0.0
    """Standard deviation of the ambient light over its mean (simulation); 0: constant, as the thesis takes it."""
    correlation_s: Positive = 1e-3
    """Time in which the correlation of the ambient light with itself falls to 1/e (simulation). *open*"""


@settings
class PulsedCamera:
    """A camera that lights the scene with short pulses and integrates what returns in shutter windows.

    Window a opens at `shutter_delay_s`, b opens when a closes, c spans both. The laser fires at `laser_delay_s`.
    What the makers do not say is named *open*.
    """

    kind: Literal["pulsed"] = "pulsed"
    name: str = "pulsed camera"
    """What people call it."""
    rows: PositiveInt = 8
    """Height of the image, pixels (simulation)."""
    columns: PositiveInt = 64
    """Width of the image, pixels (simulation)."""
    frame_rate_hz: Positive = 50.0
    """Images a second (simulation)."""
    lens: Lens = Lens(horizontal_fov_deg=29.95, vertical_fov_deg=8.83, projection="perspective")

    readout: Literal["shutters", "three_tap"] = "shutters"
    """shutters: one window after the other, on pulses of their own, with analogue accumulation; three_tap: three gates
    on the same pulses (simulation)."""
    shutters: Literal["ab", "ac", "bc", "abc", "aa", "bb", "a_delayed", "b_delayed", "ab_delayed"] = "ab"
    """Windows taken, in this order: mdsi1 needs a and c, mdsi2 b and c, mdsi3 and mdsi4 a and b, gradient1 two as a,
    gradient2 two as b; csi needs a_delayed, shifted b_delayed, dcsi ab_delayed: their windows once for each laser delay
    (simulation)."""
    shutter_order: Literal["sequential", "alternating"] = "sequential"
    """sequential: all pulses of a window, then all of the next; alternating: pulse by pulse, which needs a memory for
    each window (simulation; König 2008, chapter 8)."""
    averages: PositiveInt = 1
    """Images averaged into one (n_av of König 2008, 4.1.5)."""

    pulse_width_s: Positive = 180e-9
    """Width of the light pulse, at half of its height; it also is the measurement range, c/2 of it."""
    pulse_rise_s: NonNegative = 0.0
    """Length of the rising edge; the laser of the thesis has 60 ns (König 2008, 4.2.2.1)."""
    pulse_fall_s: NonNegative = 0.0
    """Length of the falling edge; the laser of the thesis has 30 ns."""
    pulse_edges: Literal["straight", "rounded"] = "straight"
    """rounded: edges of the pulse as half a period of a cosine, without corners (fig 4.9)."""
    pulse_rounding: Fraction = 0.0
    """Part of its height by which the plateau of the pulse is lower at its ends than in the middle (fig 4.9). *open*"""
    laser_delay_s: float = 0.0
    """T_DL: delay of the laser pulse."""
    shutter_delay_s: float = 0.0
    """T_DS: delay of the shutter windows."""
    shutter_a_width_s: Positive | None = None
    """T_Int,a; none: as long as the pulse."""
    shutter_b_width_s: Positive | None = None
    """T_Int,b; none: as long as the pulse."""
    gradient_step_s: Positive = 30e-9
    """Delta T_Int of the gradient methods: window a2 closes so much before a1, b2 opens so much after b1; 5-50 ns in
    5.2.1.3."""
    gating_s: NonNegative = 0.0
    """T_G: how long after window b window b1 opens; what returns earlier is not seen (eq 5.11)."""
    delay_first_s: float = -200e-9
    """csi, dcsi, shifted: the first delay of the laser, beside `laser_delay_s`; negative where the shutter waits.
    *open*"""
    delay_step_s: Positive = 20e-9
    """csi, dcsi, shifted: from one laser delay to the next. *open*"""
    delay_count: Annotated[int, Interval(ge=3, le=1000)] = 19
    """csi, dcsi, shifted: number of laser delays. *open*"""
    linear_part_s: Positive = 120e-9
    """dcsi: length of the middle part of the difference curve to which the line is fitted; 126 ns of the measured
    shapes are linear (N-K-048)."""
    shutter_edge_s: NonNegative = 0.0
    """Length of both edges of a window, which end with the switch; the sensor of the thesis has 60-70 ns (4.2.1.2)."""
    shutter_opening_s: NonNegative | None = None
    """Length of the opening edge alone; none: as the other. The sensor before that of the thesis has 300 ns (5.1.3)."""
    gate_width_s: Positive | None = None
    """Width of each gate of a three-tap sensor; none: as long as the pulse."""
    pulse_lead_s: NonNegative = 0.0
    """Three-tap: how long before gate 2 opens the pulse is sent. If 0, tap 1 sees background only."""

    calibration: str = ""
    """File with dark images, settings and the range line of each pixel (`rangecam.calibration`), read when a source is
    opened; empty: none. A recording holds the calibration that it was made with."""
    range_curve_m: tuple[tuple[float, float], ...] = ()
    """Points (measured, true) of the curve by which ranges are corrected, both increasing; a calibration sets it where
    soft edges bend the quotient; empty: none."""
    temperature_c: float = 25.0
    """Ambient temperature of the camera; a calibration that was taken at one 10 K away or more is out of date, and the
    camera of the thesis worked from 0 to 50 (König 2008, 5.2.1.1)."""
    offset_m: float = 0.0
    """Added to every range."""
    speed_of_light_mps: Positive = SPEED_OF_LIGHT
    """3e8 reproduces the numbers of the thesis (X-01)."""
    min_range_m: NonNegative = 0.0
    """Nearer pixels are OUT_OF_RANGE, as are those outside of the method's own range (König 2008, eq 3.22)."""
    max_range_m: Positive | None = None
    """Farther pixels are OUT_OF_RANGE; none: the end of the method's own range."""
    far_margin_sigmas: NonNegative = 2.0
    """Pixels that are not so many of their standard deviations nearer than the end of the method's own range are
    OUT_OF_RANGE: they may as well lie beyond it, where the quotient stays at its limit. For gradient2 that is the near
    end."""
    min_snr: Annotated[float, Gt(0)] = 6.0
    """Pixels whose total signal is below so many of its standard deviations are LOW_AMPLITUDE: only above it is the
    noise of the quotient Gaussian."""

    objective: Objective = Objective()
    laser: Laser = Laser()
    pixel: Pixel = Pixel()
    sequencer: Sequencer = Sequencer()
    crosstalk: Crosstalk = Crosstalk()
    background: Background = Background()
    taps: Taps = Taps()
