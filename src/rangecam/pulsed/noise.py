"""What the noise of the pixel is made of (König 2008, 4.2.3.1 and fig 4.12).

The thesis measures two totals, sigma_S of one accumulation and sigma_R of one read-out, and names their parts without
sizes. The totals stay the measure here; of sigma_S, reset and shutter are the thermal noise of the known capacitors,
all others share what is left as if each had the same noise at its own place, which the amplifier raises C_Cl/C_F times,
its own 1 + C_Cl/C_F times. Buffer and board share sigma_R. The thesis counts the rounding of its converter into
sigma_R; as its bits are *open*, `adc_bits` rounds in addition, by its step over the root of 12. Photon shot noise is
not a part of sigma_S, which was measured in darkness.
"""

import math
from functools import lru_cache
from typing import get_args

from rangecam.pulsed.settings import Pixel, ReadoutNoise, SensorNoise

_BOLTZMANN_JPK = 1.380649e-23
_ROOM_K = 298.15


def sensor_parts_v(pixel: Pixel) -> dict[str, float]:
    """Return the parts of sigma_S, V at the output: their squares add up to its square (K-NOI-02)."""
    gain = pixel.clamp_capacitance_f / pixel.feedback_capacitance_f
    diode_f, sense_f = pixel.diode_capacitance_f, pixel.sense_capacitance_f
    # Thermal noise of C_D + C_sense as the reset ends, and of the charge that both share as the shutter does; each
    # happens twice, with the laser on and off.
    thermal_v2 = 2 * _BOLTZMANN_JPK * _ROOM_K * (pixel.follower_gain * gain) ** 2
    known = {
        "reset": thermal_v2 / (diode_f + sense_f),
        "shutter": thermal_v2 * diode_f / (sense_f * (diode_f + sense_f)),
    }
    total = pixel.sensor_noise_v**2
    scale = min(1.0, total / sum(known.values()))  # a circuit that is quieter than its capacitors cools them
    left = total - scale * sum(known.values())
    weight = {name: (1 + gain if name == "amplifier" else gain) ** 2 for name in get_args(SensorNoise)}
    unknown = sum(weight[name] for name in weight if name not in known)
    return {name: math.sqrt(scale * known[name] if name in known else left * weight[name] / unknown) for name in weight}


def readout_parts_v(pixel: Pixel) -> dict[str, float]:
    """Return the parts of sigma_R, V: their squares add up to its square (K-NOI-02)."""
    names = get_args(ReadoutNoise)
    return {name: pixel.readout_noise_v / math.sqrt(len(names)) for name in names}


@lru_cache(maxsize=16)
def remaining_v(pixel: Pixel) -> tuple[float, float]:
    """Return sigma_S and sigma_R, V, without the parts in `pixel.noise_off`."""
    if not pixel.noise_off:
        return pixel.sensor_noise_v, pixel.readout_noise_v
    sensor, readout = (
        math.sqrt(sum(part_v**2 for name, part_v in parts.items() if name not in pixel.noise_off))
        for parts in (sensor_parts_v(pixel), readout_parts_v(pixel))
    )
    return sensor, readout
