"""What can be set about tracking."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.motion import MotionSettings
from rangecam.settings import Fraction, NonNegative, NonNegativeInt, Positive, PositiveInt, settings


@settings
class TrackingSettings:
    """How tracks are born, live and die."""

    motion: MotionSettings = MotionSettings()
    frame: Literal["vehicle", "ground"] = "vehicle"
    """vehicle: objects are expected to keep their motion relative to the vehicle; ground: that over the ground, which
    takes the own speed and yaw rate. Either way states are relative to the vehicle, in its present axes."""
    rear_axle_m: float = 0.0
    """x of the rear axle in vehicle axes, whose velocity points straight ahead. For the frame ground."""
    association: Literal["global", "greedy", "by_age", "joint_probabilistic"] = "global"
    """global: the best pairing as a whole; greedy: the best pair first; by_age: the track of the highest priority
    (age, pixels and reliability) chooses first (the thesis); joint_probabilistic: where tracks compete, each takes
    every segment in its gate by the probability that it is its own."""
    distance: Literal["mahalanobis", "euclidean"] = "mahalanobis"
    """mahalanobis: measured in standard deviations of the innovation; euclidean: in metres."""
    euclidean_gate_m: Positive = 1.0
    """Radius of the gate where the distance is euclidean, in place of that of `gate_probability`."""
    gate_probability: Annotated[float, Interval(gt=0, le=1)] = 0.999
    """Share of true measurements that lie in the gate around the predicted position. 1: hardly any gate, a thousand
    standard deviations wide."""
    detection_probability: Annotated[float, Interval(gt=0, lt=1)] = 0.9
    """How often an object that is there is seen. For joint_probabilistic."""
    clutter_density_per_m3: Positive = 0.01
    """Segments that belong to no object, in a frame. For joint_probabilistic."""
    new_density_per_m3: NonNegative = 0.0
    """How many objects appear, in a frame: a track that was missed takes a segment only where that is likelier its own
    than that of a new object. 0: wherever it is in the gate."""
    speed_sigma_mps: Positive = 5.0
    """How fast new objects may be: their velocity starts as 0 with this standard deviation, along each axis."""
    acceleration_sigma_mps2: Positive = 3.0
    """The same for their acceleration."""
    position_sigma_m: NonNegative = 0.01
    """Error of a measured position that does not average out, added to the measurement's own covariance."""
    position_lasts_s: NonNegative = 0.0
    """How long that error lasts: the correlation between two frames falls by e in this time. 0: each frame has its own.
    What lasts is in the position of the track, with its uncertainty at the start, and moves it slowly."""
    extent_sigma: NonNegative = 0.05
    """Wander of the centroid over an extended object: standard deviation as a share of the object's size."""
    outline_sigma: NonNegative = 0.0
    """The same, across and up, as a share of how much the track's own width and height change from frame to frame:
    1/2 where both ends of the outline err on their own. Large while something comes into sight, small once its outline
    stands still."""
    cut_sigma: NonNegative = 0.29
    """The same, beside it, where the image's edge or something nearer cuts an object short: 1 over the root
    of 12 is that of missing anything, evenly, up to as much as is seen. Beside the image ends what is near first, so
    that the depth is cut as well."""
    cut_width_m: NonNegative = 0.0
    """How wide something is expected to be that is cut short when it is seen first, if it is not seen to be wider."""
    end_sigma_m: NonNegative = 0.1
    """Error, from frame to frame, of where something ends that is cut short at its other side, added to that of the
    pixels: it is placed by this end, and as it comes into sight its speed is that of this end."""
    beside_m: NonNegative | None = None
    """What lies wholly beside our way, by more than this from the camera's axis, is placed by its near end, too: only
    that can meet us. Its far end comes into sight late, gets dim, or is seen less and less; none: by its middle."""
    own_braking_mps2: NonNegative = 0.0
    """While we brake for an object (`Ego.braking`) our deceleration begins, rises and ends within frames, and wheels
    that lock tell nothing of it: standard deviation of its change in a tenth of a second. For the frame vehicle."""
    frame_time_sigma_s: NonNegative = 0.0
    """Jitter of the frames' time stamps; it blurs the position of a moving object along its way."""
    confirm_hits: PositiveInt = 3
    """A track is confirmed once seen this often ..."""
    confirm_frames: PositiveInt = 5
    """... within its first frames, this many; otherwise it is dropped."""
    max_misses: NonNegativeInt = 10
    """A confirmed track is deleted when missed more often than this in a row."""
    max_misses_vru: NonNegativeInt | None = None
    """The same for one that is most probably a vulnerable road user; none: as any other."""
    max_misses_vehicle: NonNegativeInt | None = None
    """The same for a vehicle; none: as any other."""
    max_misses_obstacle: NonNegativeInt | None = None
    """The same for an obstacle; none: as any other."""
    max_position_sigma_m: Positive = 2.0
    """A track is deleted when its position, along any axis, is less certain than this: the limit for long gaps."""
    max_late_s: NonNegative = 1.0
    """A frame older than the tracks by up to this is late and ignored; one older still means that the camera's clock
    was set back, and tracking starts anew."""
    shape_weight: Fraction = 0.3
    """Weight of the newest size, nearest point and pixel count in their running means, and in those of the shape."""
    use_shape: bool = True
    """Whether tracks that compete for segments are told apart by width, height and fill, too (K-FUT-05)."""
    shape_sigma: Positive = 0.3
    """How much they differ from frame to frame, as the standard deviation of their logarithms, before that is known of
    a track itself."""
    recognise_merges: bool = True
    """Whether a segment that is as large as two tracks together is taken for both of them, and segments that together
    are as large as one track for its parts (K-FUT-06)."""
    max_parts_frames: NonNegativeInt = 10
    """An object seen in parts for more frames in a row than this is no longer one."""
