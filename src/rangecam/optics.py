"""Lens and radiometry: how much of the emitted light reaches a pixel; for both camera families."""

import math

import numpy as np

from rangecam.settings import Fraction, Positive, settings
from rangecam.types import Floats


@settings
class Objective:
    """A thin lens before a rectangular sensor; the default is the 30 degree lens of König 2008, table 4.1 (K-OPT-05)."""

    focal_length_m: Positive = 15.55e-3
    """Focal length f; the image distance equals it for everything that is far away (eqs 3.2-3.3)."""
    aperture_m: Positive = 19.40e-3
    """Diameter D of the entrance pupil."""
    transmission: Fraction = 1.0
    """Part of the light that passes lens and filters, kappa; *open* in the thesis."""
    sensor_width_m: Positive = 8.32e-3
    """Width of the light-sensitive area."""
    sensor_height_m: Positive = 2.40e-3
    """Height of the light-sensitive area."""

    @property
    def f_number(self) -> float:
        """F-number f/D (König 2008, eq 3.6)."""
        return self.focal_length_m / self.aperture_m

    @property
    def sensor_area_m2(self) -> float:
        """Light-sensitive area."""
        return self.sensor_width_m * self.sensor_height_m


def irradiance_on_sensor(
    power_w: Floats | float,
    range_m: Floats,
    reflectivity: Floats,
    cos_incidence: Floats,
    cos_axis: Floats,
    objective: Objective,
) -> Floats:
    """Return the irradiance that the camera's own light makes on its sensor, W/m2 (broadcast of the arguments).

    power_w: optical power now, spread so that it lights a plane across the axis evenly over exactly the imaged area
    (K-ILL-05). range_m: radial, inf gives 0. reflectivity: Lambertian. cos_incidence: between ray and surface normal.
    cos_axis: between ray and optical axis.
    On a plane across the axis, at depth u = range cos_axis and with cos_incidence = cos_axis, this is König 2008,
    eqs 3.9-3.10: P / A_object rho kappa cos^4(alpha) / (4 f#^2), A_object = A_sensor (u/f)^2. Elsewhere the light's
    intensity P f^2 / (A_sensor cos^3 alpha) falls on the tilted surface with cos(incidence) / range^2.
    """
    on_axis = np.asarray(power_w) / objective.sensor_area_m2 * objective.focal_length_m**2  # eq 3.11, without d
    lit = on_axis * cos_incidence / (cos_axis**3 * np.square(range_m))
    result: Floats = lit * _seen(reflectivity, cos_axis, objective)
    return result


def ambient_on_sensor(ambient_wpm2: float, reflectivity: Floats, cos_axis: Floats, objective: Objective) -> Floats:
    """Return the irradiance that ambient light makes on the sensor by way of the scene, W/m2.

    ambient_wpm2: irradiance of every surface by ambient light in the camera's band. It does not fall with the range.
    """
    return ambient_wpm2 * _seen(reflectivity, cos_axis, objective)


def natural_vignetting(cos_axis: Floats) -> Floats:
    """Return cos^4 of the angle to the axis: what an off-axis pixel gets of what the centre gets (eq 3.9)."""
    result: Floats = np.asarray(cos_axis) ** 4
    return result


def _seen(reflectivity: Floats, cos_axis: Floats, objective: Objective) -> Floats:
    """Return irradiance on the sensor over irradiance of the surface: radiance rho E / pi through the aperture.

    pi / (4 f#^2) is the aplanatic solid angle factor of the thesis (E-K-45).
    """
    solid_angle = math.pi / (4 * objective.f_number**2)
    result: Floats = reflectivity / math.pi * objective.transmission * solid_angle * natural_vignetting(cos_axis)
    return result
