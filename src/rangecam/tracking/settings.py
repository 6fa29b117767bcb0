"""What can be set about tracking."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.motion import MotionSettings
from rangecam.settings import Fraction, NonNegative, NonNegativeInt, Positive, PositiveInt, settings


@settings
class TrackingSettings:
    """How tracks are born, live and die."""

    motion: MotionSettings = MotionSettings()
    association: Literal["global", "by_age"] = "global"
    """global: the best pairing as a whole; by_age: the oldest track chooses first (the thesis)."""
    gate_probability: Annotated[float, Interval(gt=0, le=1)] = 0.999
    """Share of true measurements that lie in the gate around the predicted position. 1: hardly any gate, a thousand
    standard deviations wide."""
    speed_sigma_mps: Positive = 5.0
    """How fast new objects may be: their velocity starts as 0 with this standard deviation, along each axis."""
    acceleration_sigma_mps2: Positive = 3.0
    """The same for their acceleration."""
    position_sigma_m: NonNegative = 0.01
    """Error of a measured position that does not average out, added to the measurement's own covariance."""
    extent_sigma: NonNegative = 0.05
    """Wander of the centroid over an extended object: standard deviation as a share of the object's size."""
    frame_time_sigma_s: NonNegative = 0.0
    """Jitter of the frames' time stamps; it blurs the position of a moving object along its way."""
    confirm_hits: PositiveInt = 3
    """A track is confirmed once seen this often ..."""
    confirm_frames: PositiveInt = 5
    """... within its first frames, this many; otherwise it is dropped."""
    max_misses: NonNegativeInt = 10
    """A confirmed track is deleted when missed more often than this in a row."""
    max_position_sigma_m: Positive = 2.0
    """A track is deleted when its position, along any axis, is less certain than this: the limit for long gaps."""
    max_late_s: NonNegative = 1.0
    """A frame older than the tracks by up to this is late and ignored; one older still means that the camera's clock
    was set back, and tracking starts anew."""
    shape_weight: Fraction = 0.3
    """Weight of the newest size, nearest point and pixel count in their running means."""
