"""Assistance: short functions of a `Frame`, the state of the own vehicle and their own: see docs/applications.md.

They say what would be right to do; none of them reaches the bus. All are pure: the same arguments, the same answer.
- distance_control: keep a distance in time to the car ahead; following: drive after one object
- parking: nearest distances around the bumper, and a beep
- blind_spot: may the vehicle start; laser_guard: may the laser be on
"""

from rangecam.apps.blind_spot import BlindSpot, BlindSpotState, may_start
from rangecam.apps.distance_control import DistanceControl, keep_distance
from rangecam.apps.following import Following, FollowState, follow
from rangecam.apps.laser_guard import LaserGuard, LaserState, guard_laser
from rangecam.apps.parking import Parking, park

__all__ = [
    "BlindSpot",
    "BlindSpotState",
    "DistanceControl",
    "FollowState",
    "Following",
    "LaserGuard",
    "LaserState",
    "Parking",
    "follow",
    "guard_laser",
    "keep_distance",
    "may_start",
    "park",
]
