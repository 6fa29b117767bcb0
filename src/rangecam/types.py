"""The values that flow through the chain, with their axes and units, said once.

Image axes: arrays are (H, W), rows downwards, columns to the right as the camera looks.
Camera axes: x along the optical axis, y left, z up, right-handed (K-CS-04). Vehicle ("world") axes: x forward, y left,
z up, origin on the floor below the reference point of the vehicle (K-CS-05, ISO 8855).
Units are SI and stand in the names: m, s, rad, m/s. `range_m` is radial, along the pixel's ray; depth along the axis.

Every value is frozen. Arrays inside are shared, not copied: nobody writes into an array that was handed to them.
Collections (`Segments`, `Tracks`, `Collisions`) are structs of arrays, one row an object; indexing gives one object.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rangecam.values import record, value

Image = NDArray[Any]
"""An array of shape (H, W)."""
Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]

SPEED_OF_LIGHT = 299_792_458.0
"""m/s. The theses compute with 3e8 (X-01); cameras take it as a setting so that their numbers can be reproduced."""


class Why(IntEnum):
    """Why a pixel is invalid; VALID is zero. The first stage that refuses a pixel gives the reason."""

    VALID = 0
    NO_SIGNAL = 1
    """The sensor delivered nothing: an empty pixel, a missing target."""
    NOT_FINITE = 2
    """A sample is NaN or infinite."""
    LOW_AMPLITUDE = 3
    """Too little light for a range worth having."""
    SATURATED = 4
    """Too much light: a sample is at or above full scale."""
    OUT_OF_RANGE = 5
    """Outside the interval in which the camera or method can measure."""
    WRAPPED = 6
    """Beyond the unambiguous range, or the unwrapping cannot decide."""
    SENSOR_FLAG = 7
    """The sensor itself marked the pixel as bad."""
    FLYING = 8
    """Between two surfaces: light of both in one pixel."""
    ISOLATED = 9
    """Too few neighbours agree with it."""
    FLOOR = 10
    """Belongs to the floor."""
    OUTSIDE_AREA = 11
    """Outside the area of interest."""
    BORDER = 12
    """At the image border, where a filter has no full neighbourhood."""
    MOTION = 13
    """Something moved between its samples, which contradict each other."""
    MULTIPATH = 14
    """Light came on more than one way: modulation frequencies contradict each other."""


@value
class RawFrame:
    """What a sensor delivers for one image: named planes of samples, as they came.

    planes: name -> (H, W) array. The names are the vocabulary of recordings and files alike:
        continuous wave   phase_0, phase_90, phase_180, phase_270 (the step in degrees); of frequency number k of
                          several f<k>_phase_0..
        several exposures exposure_<microseconds>us_ before the name of each plane
        pulsed shutter    shutter_a, shutter_b, shutter_c (V, after correlated double sampling), n_acc,
                          ambient (V/s, rate of the background signal before the double sampling); gradient methods
                          shutter_a1, shutter_a2 or shutter_b1, shutter_b2; (D)CSI shutter_a_0.. (shutter_b_0..), one
                          for each laser delay; with a calibration offset_a.. (V), range_slope, range_intercept_m
        pulsed taps       tap_1..3, dark_1..3, tap_std_1..3
        beside them       reference_range_m (range by another instrument, for calibration; 0: none), temperature_c (of
                          the camera); with a calibration range_offset_m
        processed         range_m or depth_m, amplitude, noise_m (one sigma), status, confidence
    time_s: middle of the exposure on the camera's own clock.
    """

    time_s: float
    planes: Mapping[str, Image]
    frame_id: int = 0

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the sensor image."""
        height, width = next(iter(self.planes.values())).shape
        return height, width


@value
class RangeImage:
    """The waist of the system: from here on nobody knows which family of camera it was.

    range_m (H, W) float32: radial range; where `why` is not VALID the estimate is kept if there was one, else NaN.
    sigma_m (H, W) float32: one standard deviation of range_m, from the sensor's noise model.
    amplitude (H, W) float32: strength of the received active light, in the unit of the sensor.
    why (H, W) uint8: `Why` code of each pixel.
    """

    time_s: float
    range_m: Floats
    sigma_m: Floats
    amplitude: Floats
    why: NDArray[np.uint8]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: True where the range may be used."""
        return np.equal(self.why, Why.VALID)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.range_m.shape
        return height, width


class Rows:
    """A struct of arrays: the first axis of every array field is the object (see `Segments`, `Tracks`)."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))


class Cut(IntFlag):
    """What cuts a segment short, so that its extent is more than what is seen of it; bits, zero for nothing."""

    LEFT = 1
    """Touches the left edge of the image, or of the area of interest, ..."""
    RIGHT = 2
    """... the right one, ..."""
    TOP = 4
    """... the upper one, ..."""
    BOTTOM = 8
    """... the lower one."""
    OCCLUDED = 16
    """Something nearer hides a part of it, ..."""
    HIDDEN_LEFT = 32
    """... along most of its left side, ..."""
    HIDDEN_RIGHT = 64
    """... or of its right one, ..."""
    HIDDEN_UP = 128
    """... or more than a few pixels above or below. None of these: a small part of a side."""


@value
class Segment:
    """One connected object of one image: row i of `Segments`, same fields."""

    label: int
    position_m: Floats
    covariance_m2: Floats
    size_m: Floats
    near_m: float
    n_pixels: int
    box: Ints
    range_m: float
    sigma_range_m: float
    amplitude: float
    cut: int
    nearest_m: Floats
    profile: Floats | None = None
    surface: Floats | None = None
    ends_m: Floats | None = None


PROFILE_BANDS = 4
"""Parts of equal height, from the top, in which the outline of a segment is looked at."""
SURFACE = ("rough_m", "lean_across", "lean_up", "bend_across", "bend_up", "shade", "inner", "pieces")
"""Columns of `Segments.surface`, from the parabola that fits the inner pixels of a segment best, distance over places
across the line of sight and up: root mean square of what is left (m), slopes, coefficients of the squares (1/m); that
across of the same parabola through their light, as a share of its mean (1/m2); the share of the pixels that are inner
ones; the mean number of pieces in a row."""


@value
class Segments(Rows):
    """The object list of one image (K-SEG-05, S-SEG-03): N segments.

    label (N,) int: value of the segment's pixels in the label image, 1..N.
    position_m (N, 3): centroid in vehicle axes. covariance_m2 (N, 3, 3): its covariance.
    size_m (N, 3): extent of the points along x, y, z. near_m (N,): smallest x of the segment, robustly.
    n_pixels (N,) int. box (N, 4) int: first row, first column, last row + 1, last column + 1.
    range_m, sigma_range_m, amplitude (N,): mean over the pixels, standard deviation of that mean range, mean.
    cut (N,) uint8: bits of `Cut`. nearest_m (N, 3): the nearest point of its surface: near_m, and the mean y and z of
        the pixels that are nearer.
    profile (N, 3, B): of `PROFILE_BANDS` from the top to the bottom of its box: from its first to its last pixel in a
        row, as a share of the box's width; the share of the band that it fills; how much farther away it is than as a
        whole, along the ground (m). None where nobody measured it.
    surface (N, 8): how its surface is bent, see `SURFACE`. None where nobody measured it.
    ends_m (N, 2): y of its left and its right end, mean over its rows. None where nobody measured them.
    """

    label: Ints
    position_m: Floats
    covariance_m2: Floats
    size_m: Floats
    near_m: Floats
    n_pixels: Ints
    box: Ints
    range_m: Floats
    sigma_range_m: Floats
    amplitude: Floats
    cut: NDArray[np.uint8]
    nearest_m: Floats
    profile: Floats | None = None
    surface: Floats | None = None
    ends_m: Floats | None = None

    def __getitem__(self, i: int) -> Segment:
        return Segment(
            int(self.label[i]),
            self.position_m[i],
            self.covariance_m2[i],
            self.size_m[i],
            float(self.near_m[i]),
            int(self.n_pixels[i]),
            self.box[i],
            float(self.range_m[i]),
            float(self.sigma_range_m[i]),
            float(self.amplitude[i]),
            int(self.cut[i]),
            self.nearest_m[i],
            None if self.profile is None else self.profile[i],
            None if self.surface is None else self.surface[i],
            None if self.ends_m is None else self.ends_m[i],
        )

    def __iter__(self) -> Iterator[Segment]:
        return (self[i] for i in range(len(self)))


class TrackStatus(IntEnum):
    """Life of a track: TENTATIVE until seen often enough, COASTING while a confirmed one is not seen."""

    TENTATIVE = 0
    CONFIRMED = 1
    COASTING = 2


class Refused(IntEnum):
    """What the tracker did not use: nothing; a frame of the time of the last one; a late one; its tracks so far."""

    NOTHING = 0
    REPEATED = 1
    LATE = 2
    CLOCK_SET_BACK = 3


STATE = ("x", "vx", "ax", "y", "vy", "ay", "z", "vz", "az")
"""Order of the state vector (K-KAL-01): m, m/s, m/s2 in vehicle axes."""
MEMORY = (
    *("log_width", "log_height", "log_fill", "log_width_variance", "log_height_variance", "log_fill_variance"),
    *("reliability", "process_noise", "placed_width", "placed_side", "merged", "parts"),
)
"""Columns of `Tracks.memory`: running mean and variance of the logarithms of width (m), height (m) and fill (pixels
times squared range over width and height), running mean of amplitude over sigma of the range (per m), factor of the
process noise, running mean of the width whose middle the position is (m), side at which it was cut when it was placed
by its other end (1 left, -1 right, 0: by its middle), number of the group that is seen as one
segment (0: none), frames in a row in which it was seen in parts."""
POSITION, VELOCITY, ACCELERATION = [0, 3, 6], [1, 4, 7], [2, 5, 8]
CLASSES = ("unknown", "vru", "vehicle", "obstacle")
"""Object classes (K-CLS-01): vulnerable road user, vehicle, obstacle."""
ACTIONS = ("standing", "walking", "crossing", "approaching", "leaving")
"""What an object does over ground; walking: it goes, in a direction between the three others."""


@value
class Track:
    """One tracked object: row i of `Tracks`, with names for parts of the state."""

    track_id: int
    status: TrackStatus
    state: Floats
    covariance: Floats
    age: int
    hits: int
    misses: int
    size_m: Floats
    near_offset_m: float
    n_pixels: float
    segment: int
    class_probability: Floats
    action_probability: Floats | None = None

    @property
    def position_m(self) -> Floats:
        """(3,) x, y, z."""
        return self.state[POSITION]

    @property
    def velocity_mps(self) -> Floats:
        """(3,) vx, vy, vz."""
        return self.state[VELOCITY]

    @property
    def acceleration_mps2(self) -> Floats:
        """(3,) ax, ay, az."""
        return self.state[ACCELERATION]

    @property
    def class_name(self) -> str:
        """The most probable class."""
        return CLASSES[int(np.argmax(self.class_probability))]

    @property
    def action_name(self) -> str:
        """The most probable action; empty before classification."""
        return "" if self.action_probability is None else ACTIONS[int(np.argmax(self.action_probability))]


@record
class Ego:
    """The own vehicle at one moment. speed_mps is None where nobody measures it; forward is False in reverse gear.

    braking: whether it brakes for an object already, so that the decision does not flicker. friction: between tyres and
    ground, where its stops have shown it and the decision is to reckon with it instead of with its setting.
    """

    time_s: float = float("nan")
    speed_mps: float | None = None
    yaw_rate_radps: float = 0.0
    forward: bool = True
    braking: bool = False
    friction: float | None = None


@value
class Tracks(Rows):
    """All tracks after one frame: the whole memory of the system, handed back into the next step.

    track_id (N,) int, unique for ever. status (N,) int: `TrackStatus`. state (N, 9), covariance (N, 9, 9): see `STATE`.
    age, hits, misses (N,) int: frames since birth, frames seen, frames missed in a row.
    size_m (N, 3): smoothed extent. near_offset_m (N,): centroid x minus nearest x, smoothed. n_pixels (N,) smoothed.
    segment (N,) int: label of the segment of this frame that the track took, 0 for none.
    class_probability (N, 4): over `CLASSES`.
    time_s: time of the last frame, NaN before the first. next_id: the next new track's number.
    class_memory (N, F): what only the classification needs; None before it has seen the tracks.
    action_probability (N, 5): over `ACTIONS`; None before classification.
    nis (N,): normalised innovation squared of the last update (3 degrees of freedom), NaN where there was none.
    mode_probability (N, K), mode_state (N, K, 9), mode_covariance (N, K, 9, 9): the K modes of an interacting multiple
        model, of which state and covariance are the mean; K = 0 where one motion model does.
    memory (N, 12): what only the tracker needs, see `MEMORY`; None where it has not seen the tracks yet.
    ego: own motion that the velocities are relative to; None before the first frame.
    refused: `Refused`. ignored: segments of the last frame whose position or covariance was not finite.
    """

    track_id: Ints
    status: Ints
    state: Floats
    covariance: Floats
    age: Ints
    hits: Ints
    misses: Ints
    size_m: Floats
    near_offset_m: Floats
    n_pixels: Floats
    segment: Ints
    class_probability: Floats
    nis: Floats
    mode_probability: Floats
    mode_state: Floats
    mode_covariance: Floats
    time_s: float = float("nan")
    next_id: int = 1
    class_memory: Floats | None = None
    action_probability: Floats | None = None
    memory: Floats | None = None
    ego: Ego | None = None
    refused: int = 0
    ignored: int = 0

    @classmethod
    def empty(cls) -> Tracks:
        """Return the state before the first frame."""
        n0, i0 = np.zeros(0), np.zeros(0, np.int64)
        return cls(
            track_id=i0,
            status=i0,
            state=np.zeros((0, 9)),
            covariance=np.zeros((0, 9, 9)),
            age=i0,
            hits=i0,
            misses=i0,
            size_m=np.zeros((0, 3)),
            near_offset_m=n0,
            n_pixels=n0,
            segment=i0,
            class_probability=np.zeros((0, len(CLASSES))),
            nis=n0,
            mode_probability=np.zeros((0, 0)),
            mode_state=np.zeros((0, 0, 9)),
            mode_covariance=np.zeros((0, 0, 9, 9)),
        )

    def __getitem__(self, i: int) -> Track:
        return Track(
            int(self.track_id[i]),
            TrackStatus(int(self.status[i])),
            self.state[i],
            self.covariance[i],
            int(self.age[i]),
            int(self.hits[i]),
            int(self.misses[i]),
            self.size_m[i],
            float(self.near_offset_m[i]),
            float(self.n_pixels[i]),
            int(self.segment[i]),
            self.class_probability[i],
            None if self.action_probability is None else self.action_probability[i],
        )

    def __iter__(self) -> Iterator[Track]:
        return (self[i] for i in range(len(self)))


class Side(IntEnum):
    """Where an object hits us."""

    NONE = 0
    FRONT = 1
    LEFT = 2
    RIGHT = 3
    REAR = 4


QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)
"""Of the time to collision: between the outer two it lies with 95 %, between the inner two with 68 %."""


@value
class Collisions(Rows):
    """What each track would do to us: row i belongs to row i of `Tracks`.

    ttc_s, ttc_sigma_s (N,): time to collision and its standard deviation; inf and NaN where there is none (K-CLS-03).
    lateral_m (N,): y of the track when it reaches us. p_collision (N,): probability that it hits our outline.
    ttc_quantiles_s (N, 5): of the time to collision, see `QUANTILES`; inf where even that share may never come.
    side (N,) int: `Side` that is hit on the expected way, else the likeliest one.
    closest_m, closest_s (N,): smallest gap on the expected way until the horizon (0 at a contact), and in which time.
    """

    ttc_s: Floats
    ttc_sigma_s: Floats
    lateral_m: Floats
    p_collision: Floats
    ttc_quantiles_s: Floats
    side: Ints
    closest_m: Floats
    closest_s: Floats


@value
class Decision:
    """What to do now, and why.

    brake: True while the rule demands braking. reason: one phrase for people.
    track_id: the track that decides, 0 for none; distance_m: free way to its nearest surface;
    closing_speed_mps, stopping_distance_m, needed_deceleration_mps2: of that track (NaN without one).
    ttc_s, ttc_sigma_s, p_collision: of that track. collisions: of every track.
    """

    time_s: float
    brake: bool
    reason: str
    collisions: Collisions
    track_id: int = 0
    distance_m: float = float("nan")
    closing_speed_mps: float = float("nan")
    stopping_distance_m: float = float("nan")
    needed_deceleration_mps2: float = float("nan")
    ttc_s: float = float("inf")
    ttc_sigma_s: float = float("nan")
    p_collision: float = 0.0


@value
class Frame:
    """Everything known about one image: what recorder, report, workbench, bus and applications receive.

    labels (H, W) int32: 0 for background, else the segment's label.
    """

    raw: RawFrame
    image: RangeImage
    labels: Ints
    segments: Segments
    tracks: Tracks
    decision: Decision


@value
class Truth:
    """What a simulation knows and a camera does not.

    range_m, reflectivity (H, W): of the ray through the pixel centre, inf and 0 where it hits nothing.
    object_id (H, W) int: 0 for nothing. positions_m, velocities_mps (K, 3) of the objects named in `names`.
    """

    range_m: Floats
    reflectivity: Floats
    object_id: Ints
    names: tuple[str, ...] = ()
    positions_m: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    velocities_mps: Floats = field(default_factory=lambda: np.zeros((0, 3)))


@value
class Capture:
    """What a source yields: a raw frame, the state of the own vehicle at that time, and the truth where it is known."""

    raw: RawFrame
    ego: Ego = Ego()
    truth: Truth | None = None
