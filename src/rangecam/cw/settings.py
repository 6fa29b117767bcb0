"""The settings of a continuous-wave camera: everything that simulation and ranging need to know of it."""

from typing import Annotated, Literal

from annotated_types import Ge, Interval

from rangecam.cw.effects import FixedPattern, Interference, Link, Multipath, Scattering, Taps, Temperature, Waveform
from rangecam.cw.emulation import Emulation
from rangecam.geometry import Lens
from rangecam.settings import Fraction, NonNegative, NonNegativeInt, Positive, PositiveInt, settings
from rangecam.types import SPEED_OF_LIGHT

Register = tuple[str | int, int]
PhaseStep = Annotated[float, Interval(ge=0, lt=360)]


@settings
class CwCamera:
    """A camera that lights the scene with modulated light and samples its correlation at several phase steps.

    Levels and amplitudes are in LSB of the samples. The noise model is one for simulation and ranging alike
    (`cw.signal`). What a camera's maker does not say is named *open* below.
    """

    kind: Literal["cw"] = "cw"
    name: str = "continuous-wave camera"
    """What people call it."""
    rows: PositiveInt = 120
    """Height of the image, pixels (simulation)."""
    columns: PositiveInt = 160
    """Width of the image, pixels (simulation)."""
    frame_rate_hz: Positive = 30.0
    """Images a second (simulation)."""
    lens: Lens = Lens(horizontal_fov_deg=80.0, vertical_fov_deg=60.0, projection="equiangular")

    modulation_hz: Positive = 17e6
    """Modulation frequency; the unambiguous range is c / (2 f) (Steinbäck 2016, eq 2.4)."""
    modulations_hz: tuple[Positive, ...] = ()
    """Several modulation frequencies of one frame, in order of capture (S-EFF-08); none: `modulation_hz` alone."""
    phase_steps_deg: tuple[PhaseStep, ...] = (0, 90, 180, 270)
    """Phase steps of the reference signal at which samples are taken; three or more."""
    phase_sign: Literal[1, -1] = 1
    """1 if the phase of atan2(C270 - C90, C0 - C180) grows with the range, -1 if it falls."""
    calibration: str = ""
    """File with settings and images of each pixel (`rangecam.calibration`), read when a source is opened; empty: none.
    A recording holds the calibration that it was made with."""
    offset_m: float = 0.0
    """Added to every range, then wrapped into the unambiguous range; minus d_global of Steinbäck 2016, eq 3.13."""
    speed_of_light_mps: Positive = SPEED_OF_LIGHT
    """3e8 reproduces the numbers of the thesis, which were computed with it (N-S-003)."""
    wiggling_table_m: tuple[tuple[float, ...], ...] = ()
    """How much too long a range is measured (S-EFF-01), m, at equal steps of the phase from zero on, before `offset_m`;
    between them the periodic cubic spline. Four values or more for each modulation frequency; none: no correction."""
    wiggling_harmonics_m: tuple[tuple[tuple[float, float], ...], ...] = ()
    """The same as harmonics of the phase: cosine and sine parts of the first, second, ... one, m, for each modulation
    frequency; none: no correction."""
    drift_m_per_k: float = 0.0
    """How much more each range is measured too long for each kelvin above `drift_reference_c`; 0: no correction."""
    drift_reference_c: float = 25.0
    """Temperature for which `offset_m` and the images of a calibration hold, degrees Celsius."""
    temperature_c: float = 25.0
    """Temperature of the camera for the correction of drift, where the frames do not carry it in temperature_c."""

    pixel: Literal["differential", "single_ended"] = "differential"
    """differential: a sample is the difference of two taps, ambient light cancels in it and leaves only its shot noise;
    single_ended: a sample is all the light of one tap, so that the samples themselves show how much light there was."""
    black_level_lsb: float = 0.0
    """Sample without light."""
    read_noise_lsb: NonNegative = 1.0
    """Standard deviation of a sample without light, before rounding; *open*: 1 LSB reproduces the 4-5 m of the thesis
    (N-S-052)."""
    shot_noise_lsb2_per_lsb: NonNegative = 0.01
    """Variance per LSB of collected light: one over the electrons per LSB; *open*: 100 electrons per LSB."""
    binning: PositiveInt = 1
    """Each sample is the mean of binning x binning pixels of the sensor, which alone have the noise said here: two make
    half of it (N-S-042)."""
    demodulation_contrast: Annotated[float, Interval(gt=0, le=1)] = 0.8
    """Amplitude of the samples over the mean active light collected with them; *open*: typical of the pixel."""
    ambient_lsb: NonNegative = 0.0
    """Ambient light that ranging reckons with, as a level of its own; for a differential pixel only, where the samples
    do not tell."""
    quantisation_lsb: NonNegative = 0.0
    """Step of the samples; 0 for averaged samples or a step far below the noise."""

    full_scale_lsb: Positive | None = None
    """A sample at or above it is saturated; none: not known."""
    lower_limit_lsb: float | None = None
    """A sample at or below it is saturated, too; none: not known."""
    min_amplitude: NonNegative = 0.0
    """Pixels with less are LOW_AMPLITUDE, LSB (Steinbäck 2016, eq 2.10)."""
    max_phase_sigma_rad: Annotated[float, Interval(gt=0, le=0.5)] = 0.1
    """Pixels with a greater phase noise are LOW_AMPLITUDE; beyond 0.1 the arctangent leaves its linear regime, and of
    weak pixels mostly those pass whose noise points away from the truth, so that sigma_m holds it too seldom."""
    phasor_filter: Literal["off", "3x3", "5x5"] = "off"
    """Neighbours that are averaged with each pixel as phasors, at all frequencies together and before the arctangent,
    which is right across the wrap; only those of the same surface by `phasor_filter_sigmas` and `_contrast`."""
    phasor_filter_sigmas: Positive = 2.5
    """Neighbours whose phases differ by more standard deviations, in the mean over the frequencies, are left out."""
    phasor_filter_tolerance_m: NonNegative = 0.0
    """Difference of range that is allowed beside the noise, so that inclined surfaces are averaged, too."""
    phasor_filter_contrast: Annotated[float, Ge(1)] = 3.0
    """Neighbours whose amplitude differs by a greater factor are left out."""
    phasor_min_support: Fraction = 0.0
    """Pixels with which a smaller share of their neighbours could be averaged are FLYING: a mixture of two surfaces is
    like neither of them. Inclined surfaces need a `phasor_filter_tolerance_m`."""
    unwrap_error: Annotated[float, Interval(gt=0, lt=1)] = 1e-3
    """A pixel is WRAPPED where another number of wraps is more than this fraction as likely as the likeliest."""
    unwrap_residual_sigmas: Positive = 4.0
    """A pixel is WRAPPED if its phases contradict each other by more, even with the likeliest number of wraps."""
    unwrap_phase_error_rad: NonNegative = 0.03
    """What the phases of different frequencies may contradict each other by beside noise: wiggling, fixed pattern, and
    the way that things come nearer from one frequency to the next, 4 pi f / c times it."""
    unwrap_to_m: Positive | None = None
    """Greatest range that unwrapping looks for; none: the unambiguous range of all frequencies together."""
    unwrap_spatially: bool = False
    """Pixels that cannot decide the number of wraps alone take the one that agrees with neighbours that could."""
    stray_light: Scattering = Scattering()
    """Stray light that ranging takes out of the samples, as it is known of the lens (`cw.scattering_fit`). Neither
    this nor the next three are done by the program of the microcontroller (`cw_emulation`)."""
    motion_sigmas: NonNegative = 0.0
    """A pixel is MOTION if its samples, of four or more steps, contradict each other by more standard deviations than
    this, ... 0: off."""
    motion_tolerance: NonNegative = 0.02
    """... plus this part of its amplitude, for surfaces that come nearer: samples of the thesis' camera contradict each
    other by up to 3 % of it at 5 m/s and 2 m."""
    multipath_sigmas: NonNegative = 0.0
    """A pixel is MULTIPATH if its modulation frequencies contradict each other by more standard deviations, yet not so
    much that it is WRAPPED; 0: off."""
    pseudo_rows: NonNegativeInt = 0
    """First rows of the image that carry the sensor's own data instead of light: SENSOR_FLAG."""

    illumination_time_s: Positive = 2e-3
    """Exposure of one phase image (simulation); amplitudes grow with it."""
    illumination_times_s: tuple[Positive, ...] = ()
    """Several exposures of a frame, all phase images at the first, then at the next (simulation); whole microseconds.
    Ranging merges them (`hdr`). None: one, of `illumination_time_s`."""
    readout_time_s: NonNegative = 1.23e-3
    """Pause after each phase image (simulation); measured, not explained by the pixel clock (E-S-14)."""
    capture_order: tuple[PhaseStep, ...] = ()
    """Phase steps in the order of their exposure (simulation); none: as `phase_steps_deg` lists them."""
    reference_amplitude_lsb: Positive = 145.0
    """Amplitude in the image centre of a white plane 1 m before the camera, lit for 2 ms (simulation; Steinbäck 2016,
    A.5)."""
    reference_floor_lsb: NonNegative = 10.0
    """The part of it that does not fall off towards the image border (simulation; A.5)."""
    reference_exponent: NonNegative = 7.0
    """Power of the cosines of azimuth and elevation with which the rest falls off (simulation; A.5)."""
    ambient_lsb_per_wpm2: NonNegative = 60.0
    """Light level of a white surface by 1 W/m2 of ambient light in the camera's band, 2 ms (simulation); *open*: 3.4 W
    of the camera's own light over 80 x 60 degrees make the level of the reference."""

    waveform: Waveform = Waveform()
    """Shape of light and reference signal (simulation): wiggling."""
    taps: Taps = Taps()
    """What the taps of a pixel can hold (simulation): overexposure, ambient light."""
    fixed_pattern: FixedPattern = FixedPattern()
    """What differs from pixel to pixel (simulation)."""
    temperature: Temperature = Temperature()
    """Drift of the range with the temperature (simulation)."""
    scattering: Scattering = Scattering()
    """Stray light of the lens (simulation)."""
    multipath: Multipath = Multipath()
    """Light that comes by way of a second surface (simulation)."""
    interference: Interference = Interference()
    """A second camera beside ours (simulation)."""
    link: Link = Link()
    """The interface to the processor and its faults (simulation)."""
    mixed_pixels: bool = True
    """All rays of a pixel count (simulation); false: the middle one alone, so that no pixel mixes two surfaces."""
    freeze_motion: bool = False
    """All exposures of a frame see the scene at the time of the frame (simulation)."""
    exposure_samples: PositiveInt = 1
    """Moments within each exposure at which the scene is looked at (simulation); more than one blur what moves."""
    region_of_interest: tuple[NonNegativeInt, NonNegativeInt, PositiveInt, PositiveInt] | None = None
    """First row, first column, rows and columns that are read out (simulation), in less time if there are fewer rows;
    the others keep `black_level_lsb`. None: the whole image."""

    registers: tuple[Register, ...] | str = ()
    """Writes to the sensor's registers, made when the configuration has been put together, after every other setting:
    pairs of a register (name or address) and its 16-bit value, or the transfers on the bus as hexadecimal text. What
    they set stands in the other settings afterwards, and this is empty (`cw.registers`, S-CAM-01)."""
    emulation: Emulation = Emulation()
    """The program of the microcontroller, for the ranging method `cw_emulation`."""
