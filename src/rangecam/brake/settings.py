"""What can be set about the decision to brake."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.collision import CorridorSettings
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings
from rangecam.values import changed

GRAVITY_MPS2 = 9.81


@settings
class DecisionSettings:
    """When to brake."""

    corridor: CorridorSettings = CorridorSettings()
    rule: Literal["stopping_distance", "collision_probability"] = "stopping_distance"
    """What demands braking, a key of `brake.rule.RULES`."""
    reaction_time_s: NonNegative = 4 / 30 + 0.1
    """From exposure to the brakes biting: four frame periods and 0.1 s (eq 4.1 corrected by E-S-06, 30 frames/s)."""
    friction: Positive = 0.3
    """Between tyre and ground (mu of eq 3.3): 0.3 PVC floor, 0.7 dry asphalt."""
    deceleration_mps2: Positive | None = None
    """Of full braking; none: friction times g."""
    deceleration_sigma: NonNegative = 0.05
    """Standard deviation of the deceleration of full braking, as a share of it. For collision_probability."""
    margin: Positive = 1.5
    """Braking begins at this multiple of the stopping distance."""
    range_m: Positive | None = None
    """What is said to be farther away never brakes; a loaded configuration takes it from how far the camera measures
    and the area of interest reaches. Above the speed whose stopping distance this is, stopping in time is luck."""
    false_brake_probability: Annotated[float, Interval(gt=0, lt=1)] = 0.1
    """How likely braking may be premature: that braking from the next frame on would have done as well, or that the
    object would have missed us. For collision_probability."""
    standstill_gap_m: NonNegative = 0.1
    """Way that is to be left before the object when the gap has stopped shrinking. For collision_probability."""
    frame_period_s: Positive = 1 / 30
    """Time until the next chance to decide; a loaded configuration takes it from the camera. For
    collision_probability."""
    release_share: Fraction = 0.3
    """Braking that has begun ends when less than this share of full braking would do."""
    min_speed_mps: NonNegative = 0.5
    """At or below this speed there is no emergency braking."""
    min_object_m: Positive = 0.1
    """An object must be seen with the pixels of a square with this side (min_area of algorithm 4.4) ..."""
    large_object_px: NonNegative = 750.0
    """... or with more pixels than this ..."""
    min_object_px: NonNegative = 10.0
    """... and always with more than this."""
    min_seen: Fraction = 0.6
    """An object must have been seen in this share of the frames since its first ..."""
    sure_hits: PositiveInt = 10
    """... or in so many: one that is there is hardly ever missed, but may be seen together with another for long."""
    pixel_pitch_deg: Positive = 0.5
    """Angle between neighbouring pixels (geometric mean of both directions); a loaded configuration takes it from the
    camera's lens and size."""
    min_probability: Fraction = 0.5
    """An object beside the corridor counts if it will collide with at least this probability."""
    speed_sigmas: NonNegative = 2.0
    """A closing speed counts if it exceeds zero by this many standard deviations; one that differs by less from the
    own speed is that of a standing object."""


def on_ground(settings: DecisionSettings, friction: float | None) -> DecisionSettings:
    """Return the settings with this friction in place of theirs; None: as they are."""
    return settings if friction is None else changed(settings, friction=friction, deceleration_mps2=None)


def full_deceleration(settings: DecisionSettings) -> float:
    """Return the deceleration of full braking in m/s2: as set, else mu g."""
    return settings.friction * GRAVITY_MPS2 if settings.deceleration_mps2 is None else settings.deceleration_mps2
