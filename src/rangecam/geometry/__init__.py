"""Where a pixel looks and where its range lies: pixel -> ray -> camera -> vehicle, with covariances.

- lens: rays of the pixels, and the pixel of a ray; distortion: Brown-Conrady and its inverse; table: measured rays
- pose: camera to vehicle; covariance: of a point, from those of its pixel and range
"""

from rangecam.geometry.covariance import point_covariance
from rangecam.geometry.lens import Lens, coefficients, is_plain, pixel_of, pixel_pitch, pixel_steps, rays
from rangecam.geometry.pose import Mounting, polar, position, rotation, to_world, vehicle_rays

__all__ = [
    "Lens",
    "Mounting",
    "coefficients",
    "is_plain",
    "pixel_of",
    "pixel_pitch",
    "pixel_steps",
    "point_covariance",
    "polar",
    "position",
    "rays",
    "rotation",
    "to_world",
    "vehicle_rays",
]
