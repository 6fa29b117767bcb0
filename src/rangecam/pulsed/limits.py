"""What a pulsed camera can do at best: noise equivalent exposure, dynamic range, accuracy over range and reflectivity.

Planned with the same pixel, light and ranging methods that simulate and process its images.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rangecam.errors import UsageError
from rangecam.geometry import Lens
from rangecam.pulsed import RANGING
from rangecam.pulsed.camera import max_frame_rate_hz, simulate
from rangecam.pulsed.pixel import dark_noise, responsivity
from rangecam.pulsed.settings import Pixel, PulsedCamera
from rangecam.scene.view import View
from rangecam.types import Floats

_ON_AXIS = Lens(horizontal_fov_deg=1e-3, vertical_fov_deg=1e-3)


def nee_sensor_jpm2(pixel: Pixel) -> float:
    """Return the exposure that makes as much signal as one accumulation makes noise, J/m2 (König 2008, eq 4.32)."""
    return pixel.sensor_noise_v / responsivity(pixel)


def nee_system_jpm2(n_acc: ArrayLike, pixel: Pixel) -> Floats:
    """Return the exposure whose undamped signal equals the noise of `n_acc` accumulations and a read-out, J/m2.

    König 2008, eq 4.31 at n_acc = 1, where sigma_S, sigma_R and R of the same chapter give 222.5 nJ/m2, not the 225
    of the print (E-K-08). It is the sum of all exposures: that of one of them is 1/n_acc of it.
    """
    return dark_noise(n_acc, pixel) / responsivity(pixel)


def dynamic_range_photodiode_db(pixel: Pixel) -> float:
    """Return full scale over noise of one accumulation without read-out, dB (König 2008, eqs 4.33-4.35)."""
    return _decibel(pixel.saturation_v / pixel.sensor_noise_v)


def dynamic_range_system_db(camera: PulsedCamera) -> float:
    """Return the largest over the smallest exposure of one pulse that the camera tells from noise, dB.

    The largest fills the pixel at one accumulation; the smallest equals the noise at the most accumulations, averaged
    over images (König 2008, eq 4.37). Eq 4.36 is the same only with the NEE at the most accumulations (E-K-07).
    """
    n = max(camera.pixel.accumulations)
    full_jpm2 = camera.pixel.saturation_v / responsivity(camera.pixel)
    least_jpm2 = float(nee_system_jpm2(n, camera.pixel)) / n / math.sqrt(camera.averages)
    return _decibel(full_jpm2 / least_jpm2)


def required_snr(accuracy: float, quotient: float = 1.0) -> float:
    """Return the SNR of the whole signal at which MDSI3 reaches sigma_d / d = `accuracy` (König 2008, eq 4.42).

    quotient: U_b / (U_a + U_b), the range as part of the measurement range. 1 is its end, the limit of eqs 4.43-4.44,
    where U_a vanishes (E-K-09); nearer ranges need more.
    """
    return math.hypot(quotient, 1 - quotient) / quotient / accuracy


def required_input_range_db(range_m: tuple[float, float], reflectivity: tuple[float, float], snr: float) -> float:
    """Return the span of exposures between near and white, far and dark, and noise, dB (König 2008, eqs 4.39-4.47).

    range_m: nearest, farthest. reflectivity: darkest, brightest. snr: that the weakest signal needs (`required_snr`).
    """
    nearest_m, farthest_m = range_m
    darkest, brightest = reflectivity
    return _decibel((farthest_m / nearest_m) ** 2 * brightest / darkest * snr)


def targets_on_axis(
    range_m: ArrayLike, reflectivity: float, camera: PulsedCamera, rows: int = 1
) -> tuple[PulsedCamera, View]:
    """Return a camera with a column for each target, all on its axis, and its view of them.

    range_m (N,): of Lambertian targets across the axis, seen by `rows` pixels each. The camera runs as fast as its
    exposure allows.
    """
    targets_m = np.asarray(range_m, np.float64)
    shape = (1, rows, targets_m.size)
    view = View(np.broadcast_to(targets_m, shape), np.full(shape, reflectivity), np.ones(shape))
    frame_rate_hz = max_frame_rate_hz(camera)
    return replace(camera, rows=rows, columns=targets_m.size, lens=_ON_AXIS, frame_rate_hz=frame_rate_hz), view


def expected_sigma_m(
    range_m: ArrayLike, reflectivity: float, camera: PulsedCamera, method: str = "mdsi3"
) -> tuple[Floats, Floats]:
    """Return the standard deviation of the measured range, m (N,), and the number of accumulations it is reached with.

    range_m (N,): of Lambertian targets on the axis; without ambient light. The signals without noise are ranged, and
    what the method says of its own noise is returned. method: a name of `RANGING` whose windows the camera takes.
    """
    camera, view = targets_on_axis(range_m, reflectivity, camera)
    quiet = replace(camera.pixel, sensor_noise_v=0.0, readout_noise_v=0.0, photon_noise=False, adc_bits=0)
    raw = simulate(lambda _: view, replace(camera, pixel=quiet), 0.0, np.random.default_rng(0))
    sigma_m = np.asarray(RANGING[method](raw, camera).sigma_m, np.float64)
    return sigma_m[0], np.asarray(raw.planes["n_acc"][0])


def required_pulse_width_s(farthest_m: float, camera: PulsedCamera) -> float:
    """Return the pulse width with which the MDSI methods measure up to `farthest_m`, s, given the camera's delays.

    The inverse of the end of the measurement range, c/2 (T_Pw - (T_DL - T_DS)) (König 2008, eq 3.22; E-K-03), of
    windows as long as the pulse. A window that opens later reaches farther with the same pulse, and less near. Raises
    UsageError for a range that the delays alone exceed.
    """
    width_s = 2 * farthest_m / camera.speed_of_light_mps + camera.laser_delay_s - camera.shutter_delay_s
    if width_s <= 0:
        raise UsageError(
            f"farthest_m = {farthest_m:g}: with camera.shutter_delay_s = {camera.shutter_delay_s:g} a pulse of any "
            "width reaches farther"
        )
    return width_s


def _decibel(ratio: float) -> float:
    return 20 * math.log10(ratio)
