"""Lens and light of the 64x8 camera: opening angles, blur, diffraction, power, irradiance."""

import math

import numpy as np

from rangecam.optics import (
    Objective,
    blur_radius_m,
    diffraction,
    footprint_m,
    irradiance_on_sensor,
    lit_area_m2,
    module_power_w,
)
from rangecam.pulsed.pixel import dark_noise, responsivity
from rangecam.pulsed.settings import Laser, Pixel, PulsedCamera
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed
from rangecam.types import Floats

WAVELENGTH_M = 905e-9
WIDE = Objective(focal_length_m=7.30e-3, aperture_m=7.60e-3)


def pulsed_optics(rng: np.random.Generator) -> Study:
    """Lens and light of the pulsed camera: opening angles, blur, diffraction, power, irradiance.

    rng: not used, nothing here is random.
    """
    camera = PulsedCamera()
    claims = [*_lens(camera.objective), *_image(camera), *_light(camera)]
    return Study("pulsed-optics", "König 2008, 4.1.3, 4.2.1.4 and 4.2.2.2", claims, _panels(camera))


def _lens(lens: Objective) -> list[Claim]:
    angles, wide = np.degrees(lens.opening_angles_rad), np.degrees(WIDE.opening_angles_rad)
    nominal = "59.35 and 18.67 degrees: the printed 60 and 18 are nominal (E-K-39)"
    return [
        printed("N-K-010", "light-sensitive area of the sensor", "19.97", lens.sensor_area_m2 * 1e6, "mm2"),
        printed("N-K-011.30", "horizontal opening angle of the 30 degree lens", "30", angles[0], "deg"),
        printed("N-K-011.30", "vertical opening angle of the 30 degree lens", "9", angles[1], "deg"),
        printed("N-K-011.30", "f-number of the 30 degree lens", "0.8", lens.f_number, ""),
        judged(
            "N-K-011.60", "horizontal angle of the 60 degree lens", 60, wide[0], "deg", abs(wide[0] - 60) < 1, nominal
        ),
        judged(
            "N-K-011.60", "vertical angle of the 60 degree lens", 18, wide[1], "deg", abs(wide[1] - 18) < 1, nominal
        ),
        printed("N-K-011.60", "f-number of the 60 degree lens", "0.96", WIDE.f_number, ""),
    ]


def _image(camera: PulsedCamera) -> list[Claim]:
    lens, pitch_m = camera.objective, camera.pixel.pitch_horizontal_m
    blur_m = float(blur_radius_m(2.0, lens))
    similar = "to 1 %: eq 4.19 divides by f, similar triangles by the image distance v (E-K-06)"
    beyond = diffraction(np.linspace(3e-6, 30e-6, 20_001), WAVELENGTH_M, lens).max() * 100
    person_px = 0.4 / float(footprint_m(pitch_m, 20.0, lens))
    return [
        judged(
            "N-K-012", "radius of the blur disc at 2 m", 76, blur_m * 1e6, "um", abs(blur_m * 1e6 - 76) < 0.76, similar
        ),
        judged(
            "N-K-013",
            "blur radius at 2 m over the pixel's width: more than half of it, and direct neighbours only",
            None,
            blur_m / pitch_m,
            "",
            0.5 < blur_m / pitch_m < 1,
            "between a half and one",
        ),
        judged(
            "N-K-014",
            "largest intensity of the diffraction pattern beyond 3 um",
            0.1,
            beyond,
            "%",
            beyond < 0.1,
            "the thesis says below 0.1 %",
        ),
        derived("N-K-015.2", "width of a pixel's footprint at 2 m", float(footprint_m(pitch_m, 2.0, lens)) * 100, "cm"),
        judged(
            "N-K-015.20",
            "pixels across a person of 0.4 m at 20 m: enough for the sampling theorem",
            None,
            person_px,
            "px",
            person_px >= 2,
            "at least two",
        ),
    ]


def _light(camera: PulsedCamera) -> list[Claim]:
    power_w = module_power_w(0.245, 5.03e-7, 3.85e-3)
    area_m2 = float(lit_area_m2(0.1, math.radians(30), math.radians(9)))
    laser, pixel = camera.laser, camera.pixel
    near, far = (_irradiance(range_m, camera) for range_m in (2.0, 20.0))
    volts = responsivity(pixel) * camera.pulse_width_s
    snr = 0.05 * float(far) * volts * 100 / float(dark_noise(100, pixel))
    other_field = "the area fits a beam of about 60 x 18 degrees, not the 30 x 9 of the front view (E-K-29)"
    truncated = "1875.2 W, truncated in print, not rounded (E-K-38)"
    return [
        judged(
            "N-K-040",
            "power of a laser module from a diode's",
            1870,
            power_w,
            "W",
            power_w // 10 == 187,
            truncated,
        ),
        printed("N-K-041", "area that 30 x 9 degrees light at 0.1 m", "3.85e-3", area_m2, "m2", other_field),
        derived("N-K-042", "energy of a pulse", laser.peak_power_w * camera.pulse_width_s * 1e6, "uJ"),
        derived("N-K-043", "irradiance of the sensor, one module, white target at 2 m", float(near), "W/m2"),
        derived("N-K-043", "exposure of it by one pulse", float(near) * camera.pulse_width_s * 1e6, "uJ/m2"),
        derived("N-K-043", "output voltage of it", float(near) * volts, "V"),
        derived("N-K-043", "output voltage, 5 % target at 20 m", 0.05 * float(far) * volts * 1e3, "mV"),
        derived("N-K-043", "SNR of it after 100 accumulations", snr, "", "undamped, dark noise alone; 3 % need 35.3"),
    ]


def _irradiance(range_m: Floats | float, camera: PulsedCamera) -> Floats:
    """Return what one module makes on the sensor by way of a white target across the axis, W/m2."""
    one = np.ones_like(np.asarray(range_m, np.float64))
    laser: Laser = camera.laser
    return irradiance_on_sensor(laser.peak_power_w * laser.modules, range_m * one, one, one, one, camera.objective)


def _panels(camera: PulsedCamera) -> list[Panel]:
    range_m = np.geomspace(0.5, 25, 200)
    radius_m = np.linspace(0, 6e-6, 300)
    pixel: Pixel = camera.pixel
    half = np.full(range_m.shape, pixel.pitch_horizontal_m / 2 * 1e6)
    blur = [
        Series("30 degree lens", range_m, blur_radius_m(range_m, camera.objective) * 1e6),
        Series("60 degree lens", range_m, blur_radius_m(range_m, WIDE) * 1e6),
        Series("half a pixel's width", range_m, half, line="--"),
    ]
    airy = diffraction(radius_m, WAVELENGTH_M, camera.objective) * 100
    light = [Series(f"reflectivity {rho:g}", range_m, rho * _irradiance(range_m, camera)) for rho in (1.0, 0.5, 0.05)]
    return [
        Panel("Blur, focus at infinity", "object distance (m)", "radius of the blur disc (µm)", blur, "xy"),
        Panel(
            "Diffraction, 905 nm",
            "distance from the image point (µm)",
            "intensity (% of the centre)",
            [
                Series("30 degree lens", radius_m * 1e6, airy),
                Series("0.1 %", radius_m * 1e6, np.full(radius_m.shape, 0.1), line="--"),
            ],
            "y",
        ),
        Panel("Light of one 2 kW module", "range (m)", "irradiance of the sensor (W/m²)", light, "xy"),
    ]
