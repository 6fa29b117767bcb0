"""Lens, radiometry and eye safety: where light goes, how much reaches a pixel, how much an eye may get.

For both camera families.
"""

import math

import numpy as np
from scipy.special import j1

from rangecam.errors import UsageError
from rangecam.settings import Fraction, Positive, settings
from rangecam.types import Floats

_PLANCK_STEPS = 2001


@settings
class Objective:
    """A thin lens before a rectangular sensor; by default the 30 degree lens of König 2008, table 4.1 (K-OPT-05)."""

    focal_length_m: Positive = 15.55e-3
    """Focal length f; the image distance equals it for everything that is far away (eqs 3.2-3.3)."""
    aperture_m: Positive = 19.40e-3
    """Diameter D of the entrance pupil."""
    transmission: Fraction = 1.0
    """Part of the light that passes lens and filters, kappa; *open* in the thesis."""
    ambient_transmission: Fraction = 1.0
    """Part of the ambient light that a band-pass lets through besides (`band_share`); 1: none, as in 5.2.1.2."""
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

    @property
    def opening_angles_rad(self) -> tuple[float, float]:
        """Horizontal and vertical opening angle, edge to edge, of a lens without distortion (K-OPT-05)."""
        half_h, half_v = (
            math.atan(size / 2 / self.focal_length_m) for size in (self.sensor_width_m, self.sensor_height_m)
        )
        return 2 * half_h, 2 * half_v


def image_distance_m(object_distance_m: Floats | float, objective: Objective) -> Floats:
    """Return where a thin lens makes the image of a point, m behind it (König 2008, eqs 3.2-3.3); f for infinity.

    Raises UsageError for an object that is not farther away than the focal length: it has no real image.
    """
    u = np.asarray(object_distance_m, np.float64)
    if not (u > objective.focal_length_m).all():
        raise UsageError(
            f"object_distance_m = {float(np.min(u)):g}: must exceed the focal length, {objective.focal_length_m:g} m"
        )
    return np.asarray(1 / (1 / objective.focal_length_m - 1 / u))


def footprint_m(size_m: Floats | float, object_distance_m: Floats | float, objective: Objective) -> Floats:
    """Return how large a part of the scene is whose image is `size_m` large, at a depth (König 2008, eqs 3.4, 3.10)."""
    return np.asarray(size_m * np.asarray(object_distance_m, np.float64) / objective.focal_length_m)


def blur_radius_m(object_distance_m: Floats | float, objective: Objective) -> Floats:
    """Return the radius of the disc that a point becomes on the sensor of a lens focused at infinity, m.

    König 2008, eq 4.19 with similar triangles behind the lens: the image lies at v, not at f (E-K-06).
    Raises UsageError as `image_distance_m` does.
    """
    v = image_distance_m(object_distance_m, objective)
    return np.asarray(objective.aperture_m / 2 * (v - objective.focal_length_m) / v)


def diffraction(radius_m: Floats | float, wavelength_m: float, objective: Objective) -> Floats:
    """Return the intensity of the Airy pattern over that of its centre, `radius_m` from it on the sensor (4.2.1.4)."""
    x = math.pi * np.asarray(radius_m, np.float64) / (wavelength_m * objective.f_number)
    inside = np.where(x == 0, 1.0, x)
    return np.where(x == 0, 1.0, (2 * j1(inside) / inside) ** 2)


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
    return objective.ambient_transmission * ambient_wpm2 * _seen(reflectivity, cos_axis, objective)


def band_share(band_m: tuple[float, float], temperature_k: float) -> float:
    """Return the part of a black body's radiation between two wavelengths (Planck): what a band-pass leaves of it."""
    a_b = [14.387769e-3 / (wavelength * temperature_k) for wavelength in band_m]  # h c / (lambda k T)
    x = np.linspace(a_b[1], a_b[0], _PLANCK_STEPS)
    return float(np.trapezoid(x**3 / np.expm1(x), x) * 15 / math.pi**4)


def module_power_w(diode_power_w: float, diode_area_m2: float, lit_area_m2: float) -> float:
    """Return the power of a laser module from what a small diode gets of its evenly lit area (König 2008, eq 4.20)."""
    return diode_power_w * lit_area_m2 / diode_area_m2


def lit_area_m2(range_m: Floats | float, horizontal_rad: float, vertical_rad: float) -> Floats:
    """Return the area of a plane across the axis that a beam of these full opening angles lights, m2."""
    area_at_1_m = 4 * math.tan(horizontal_rad / 2) * math.tan(vertical_rad / 2)
    return area_at_1_m * np.asarray(range_m, np.float64) ** 2


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


SMALL_SOURCE_RAD = 1.5e-3
"""alpha_min of IEC 60825-1: the eye sees what is smaller as a point."""
_LARGE_SOURCE_RAD = 100e-3
_TIME_BASE_S = 10.0
_LONGEST_PULSE_S = 18e-6


def mpe_jpm2(
    pulse_width_s: float, repetition_hz: float, wavelength_m: float, source_rad: Floats | float = 0.0
) -> Floats:
    """Return the exposure of the cornea by one pulse of a train that IEC 60825-1:2001 permits, J/m2.

    source_rad: angle that the apparent source subtends at the eye (broadcast); up to SMALL_SOURCE_RAD it is a point.
    The smallest of three limits counts: of one pulse, of the mean of all pulses within 10 s (T2 of a point; a little
    more for larger sources), and of one pulse of many, N^-1/4 of the first. This is the edition of the thesis' time
    (K-ILL-10); it is an estimate for the design of a camera, not a classification.
    Raises UsageError outside of 700-1050 nm, 1 ns-18 us and pulses at least 18 us apart: other limits hold there.
    """
    _check_pulses(pulse_width_s, repetition_hz, wavelength_m)
    c4 = 10 ** (0.002 * (wavelength_m * 1e9 - 700))
    c6 = np.clip(np.asarray(source_rad, np.float64), SMALL_SOURCE_RAD, _LARGE_SOURCE_RAD) / SMALL_SOURCE_RAD
    pulses = max(1.0, repetition_hz * _TIME_BASE_S)
    single = 5e-3 * c4 * c6
    mean = 18 * _TIME_BASE_S**0.75 * c4 * c6 / pulses
    of_many = single * pulses**-0.25  # C5
    return np.asarray(np.minimum(mean, of_many))


def _check_pulses(pulse_width_s: float, repetition_hz: float, wavelength_m: float) -> None:
    allowed = {
        "wavelength_m": (wavelength_m, 700e-9, 1050e-9),
        "pulse_width_s": (pulse_width_s, 1e-9, _LONGEST_PULSE_S),
        "repetition_hz": (repetition_hz, 0.0, 1 / _LONGEST_PULSE_S),
    }
    for name, (value, low, high) in allowed.items():
        if not low <= value <= high:
            raise UsageError(f"{name} = {value:g}: the limits of eye safety are known from {low:g} to {high:g}")
