"""The camera as the numbers of the thesis assume it: ideal but for its dark noise, full at 2 m on white."""

from dataclasses import replace
from typing import Literal

import numpy as np

from rangecam.optics import irradiance_on_sensor
from rangecam.pulsed.pixel import responsivity
from rangecam.pulsed.settings import Laser, Pixel, PulsedCamera


def thesis_camera(shutters: Literal["ab", "abc"] = "ab") -> PulsedCamera:
    """Return a pulsed camera without damping, photon noise and rounding, with the light speed of the thesis.

    Its light is such that a white target at 2 m fills the pixel at one accumulation, as König 2008, 4.2.3.3, plans it.
    """
    pixel = Pixel(damping=0.0, photon_noise=False, adc_bits=0)
    camera = PulsedCamera(speed_of_light_mps=3e8, shutters=shutters, pixel=pixel)
    range_m, one = np.array(2.0), np.array(1.0)
    one_watt = float(irradiance_on_sensor(1.0, range_m, one, one, one, camera.objective))
    power_w = pixel.saturation_v / (one_watt * camera.pulse_width_s * responsivity(pixel))
    return replace(camera, laser=Laser(peak_power_w=power_w))
