"""What can be set about the prediction of collisions."""

from rangecam.settings import Fraction, NonNegative, NonNegativeInt, Positive, settings


@settings
class CorridorSettings:
    """The space that the vehicle needs, in vehicle axes, and how objects are expected to go on."""

    width_m: Positive = 0.6
    """Width of the vehicle's outline and of its path, with a margin."""
    length_m: Positive = 1.0
    """Length of the outline, from `front_m` backwards."""
    front_m: float = 0.0
    """x of the vehicle's foremost point."""
    corner_radius_m: NonNegative = 0.0
    """Radius of the outline's rounded corners, at most half of its width and length; 0: a rectangle."""
    horizon_s: Positive = 5.0
    """How far ahead collisions are predicted."""
    use_acceleration: bool = False
    """Whether objects are expected to keep their estimated acceleration. It is noisy: at 30 frames a second it takes
    half a second to tell 3 m/s2 from nothing, and meanwhile cries wolf."""
    drift_mps: NonNegative = 0.3
    """Standard deviation by which the velocity of an object, along each axis, is expected to change within a second."""
    surface_sigma_m: NonNegative = 0.01
    """Standard deviation of the place of an object's nearest surface that no number of frames makes smaller."""
    size_sigma_m: NonNegative = 0.05
    """Standard deviation of an object's width."""
    lag_s: NonNegative = 0.0
    """How much older than its time stamp an image of moving things is: where the samples of one image are taken one
    after the other, their range is that of an earlier moment."""
    crossing_sigmas: NonNegative = 3.0
    """What is beside the corridor is in the path only if its speed across differs from that of a standing object by
    more than so many standard deviations, or if our own bend takes us to it. What is not seen now must overlap the
    corridor by so many standard deviations of its place."""
    crossing_hits: NonNegativeInt = 6
    """And only if it was seen in so many frames: the first ones tell no speed across; ..."""
    crossing_share: Fraction = 0.6
    """... and in this share of the frames since its first: what comes and goes is not the same each time."""
