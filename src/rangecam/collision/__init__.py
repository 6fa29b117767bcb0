"""Which tracks will hit us, when, on which side, and how sure that is.

- settings: the vehicle's outline and what is expected of objects
- predict: `look_ahead`
- kernels: its loops over tracks
- arrival: when an object gets somewhere along one axis
- outline: where a path touches the vehicle, how close it comes
- touch: how probable that is
- gaussian: distribution functions and roots of covariances
- points: where a Gaussian distribution is looked at, where no closed form exists
"""

from rangecam.collision.arrival import time_to_reach
from rangecam.collision.predict import InPath, look_ahead
from rangecam.collision.settings import CorridorSettings

__all__ = ["CorridorSettings", "InPath", "look_ahead", "time_to_reach"]
