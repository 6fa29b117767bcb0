"""What a camera could see at one moment: the meeting point of the scene and the simulated cameras."""

from rangecam.types import Floats
from rangecam.values import value


@value
class View:
    """Range, reflectivity and incidence along K rays within each pixel (more than one gives mixed pixels at edges).

    range_m (K, H, W): radial range from the camera, inf where the ray hits nothing.
    reflectivity (K, H, W): Lambertian, 0..1 (more for retro-reflectors), 0 where the ray hits nothing.
    cos_incidence (K, H, W): cosine between ray and surface normal, 0..1.
    ambient_wpm2: irradiance of the scene by ambient light within the camera's band, W/m2.
    """

    range_m: Floats
    reflectivity: Floats
    cos_incidence: Floats
    ambient_wpm2: float = 0.0
