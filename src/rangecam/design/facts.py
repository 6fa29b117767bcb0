"""The numbers of a design that need no simulation: light, eye safety, dynamic range, pixels, frame and data rate."""

import math
from typing import Any

import numpy as np

from rangecam.config import Config
from rangecam.cw import CwCamera
from rangecam.cw.unwrapping import accepted_error_probability, combine, combined_sigma_m, gross_error_probability
from rangecam.design.families import DESIGNED, AnyCamera, finite
from rangecam.design.settings import Plan
from rangecam.errors import UsageError
from rangecam.geometry import pixel_pitch
from rangecam.optics import lit_area_m2, mpe_jpm2
from rangecam.pulsed import PulsedCamera
from rangecam.pulsed.limits import (
    dynamic_range_system_db,
    nee_sensor_jpm2,
    nee_system_jpm2,
    required_input_range_db,
    required_snr,
)
from rangecam.pulsed.pixel import ELEMENTARY_CHARGE_C, responsivity, volts_per_coulomb
from rangecam.types import RawFrame

EYE_DISTANCES_M = (0.1, 0.3, 1.0)
_FOOTPRINTS = 4
_NEAR_TO_FAR = 10.0
_PHASE_SIGMAS_RAD = (0.05, 0.1, 0.2)


def field_of_view_deg(camera: AnyCamera) -> tuple[float, float]:
    """Return the full horizontal and vertical opening angle."""
    lens = camera.lens
    if lens.vertical_fov_deg is not None:
        return lens.horizontal_fov_deg, lens.vertical_fov_deg
    half = pixel_pitch(lens, (camera.rows, camera.columns))[1] * camera.rows / 2
    vertical = math.atan(half) if lens.projection == "perspective" else half
    return lens.horizontal_fov_deg, 2 * math.degrees(vertical)


def facts(config: Config, plan: Plan, reach: tuple[float, float], raw: RawFrame) -> dict[str, Any]:
    """Return the numbers of a design as plain values, None where unknown. raw: any frame of the camera."""
    camera = config.camera
    fastest_hz = DESIGNED[camera.kind].fastest_hz(camera)
    per_pixel = sum(np.asarray(plane).itemsize for plane in raw.planes.values())
    frame_bytes = per_pixel * camera.rows * camera.columns
    pitch = pixel_pitch(camera.lens, (camera.rows, camera.columns))
    result: dict[str, Any] = {
        "camera": camera.name,
        "family": camera.kind,
        "ranging": config.ranging,
        "rows": camera.rows,
        "columns": camera.columns,
        "field_of_view_deg": list(field_of_view_deg(camera)),
        "measurement_range_m": [finite(end) for end in reach],
        "frame_rate_hz": camera.frame_rate_hz,
        "fastest_frame_rate_hz": fastest_hz,
        "raw_planes": list(raw.planes),
        "bytes_per_frame": frame_bytes,
        "mbit_per_s": frame_bytes * 8 * camera.frame_rate_hz / 1e6,
        "pixel_footprints": [
            {"range_m": at_m, "width_m": at_m * pitch[0], "height_m": at_m * pitch[1]}
            for at_m in (np.linspace(0, reach[1], _FOOTPRINTS + 1)[1:].tolist() if math.isfinite(reach[1]) else ())
        ],
    }
    if isinstance(camera, CwCamera) and camera.modulations_hz:
        result["unwrapping"] = unwrapping(camera)
    if isinstance(camera, PulsedCamera):
        result["eye_safety"] = eye_safety(camera, plan)
        if camera.readout == "shutters":
            result["light"] = pulsed_light(camera, plan, reach)
    return result


def unwrapping(camera: CwCamera) -> dict[str, Any]:
    """Return what several frequencies come to: unambiguous range, and at some phase noises sigma and error rates.

    The noise is the same at every frequency. gross: that the likeliest wraps are wrong; for two frequencies also what
    the camera's `unwrap_error` accepts of it, and what it rejects.
    """
    together = combine(camera.modulations_hz, camera.speed_of_light_mps)
    count, at = len(camera.modulations_hz), []
    for sigma_rad in _PHASE_SIGMAS_RAD:
        sigmas = [sigma_rad] * count
        row = {
            "phase_sigma_rad": sigma_rad,
            "sigma_m": combined_sigma_m(sigmas, together),
            "gross": gross_error_probability(sigmas, together),
        }
        if count == 2:
            row["accepted_gross"], row["rejected"] = accepted_error_probability(sigmas, together, camera.unwrap_error)
        at.append(row)
    return {"modulations_hz": list(camera.modulations_hz), "unambiguous_m": together.unambiguous_m, "at": at}


def pulsed_light(camera: PulsedCamera, plan: Plan, reach: tuple[float, float]) -> dict[str, Any]:
    """Return responsivity, noise equivalent exposure, full scale, dynamic range, and the range that the plan needs.

    The plan needs (König 2008, eqs 4.39-4.47) from a tenth of the measurement range to its end, from the darkest to
    the brightest of its reflectivities.
    """
    pixel = camera.pixel
    volts = responsivity(pixel)
    ends = (max(reach[0], reach[1] / _NEAR_TO_FAR), reach[1])
    rho = (min(plan.reflectivities), max(plan.reflectivities))
    needed = required_input_range_db(ends, rho, required_snr(plan.accuracy)) if math.isfinite(ends[1]) else math.nan
    most = max(pixel.accumulations)
    return {
        "responsivity_v_per_jpm2": volts,
        "full_scale_jpm2": pixel.saturation_v / volts,
        "full_scale_electrons": pixel.saturation_v / (ELEMENTARY_CHARGE_C * volts_per_coulomb(pixel)),
        "nee_sensor_jpm2": nee_sensor_jpm2(pixel),
        "nee_system_jpm2": float(nee_system_jpm2(1, pixel)),
        "nee_system_most_accumulations_jpm2": float(nee_system_jpm2(most, pixel)),
        "dynamic_range_db": dynamic_range_system_db(camera),
        "needed_input_range_db": finite(needed),
        "needed_for": {"range_m": [finite(end) for end in ends], "reflectivity": list(rho)},
    }


def eye_safety(camera: PulsedCamera, plan: Plan) -> dict[str, Any]:
    """Return pulse energy, mean power and the margin to class 1 of IEC 60825-1:2001 at `EYE_DISTANCES_M`.

    All modules shine evenly on exactly the field of view, and the eye takes in the exposure of its place; margin: the
    permitted over the present exposure. An estimate for a design, not a classification.
    """
    laser = camera.laser
    energy_j = laser.peak_power_w * laser.modules * camera.pulse_width_s
    horizontal, vertical = (math.radians(angle) for angle in field_of_view_deg(camera))
    source = "a point source" if plan.source_m == 0 else f"a source of {plan.source_m * 1e3:g} mm"
    result: dict[str, Any] = {
        "pulse_energy_j": energy_j,
        "mean_power_w": energy_j * laser.repetition_hz,
        "assumed": f"{source} of {plan.wavelength_m * 1e9:g} nm that lights exactly the field of view evenly",
    }
    try:
        rows = [
            _eye_at(camera, plan, energy_j / float(lit_area_m2(r, horizontal, vertical)), r) for r in EYE_DISTANCES_M
        ]
    except UsageError as error:
        return {**result, "at": [], "class_1_from_m": None, "unknown": str(error)}
    # beside a point source the permitted exposure does not depend on the distance, and the margin grows with its square
    safe_m = EYE_DISTANCES_M[0] / math.sqrt(rows[0]["margin"]) if plan.source_m == 0 else None
    return {**result, "at": rows, "class_1_from_m": safe_m, "unknown": ""}


def _eye_at(camera: PulsedCamera, plan: Plan, exposure_jpm2: float, range_m: float) -> dict[str, float]:
    allowed = float(
        mpe_jpm2(camera.pulse_width_s, camera.laser.repetition_hz, plan.wavelength_m, plan.source_m / range_m)
    )
    return {
        "range_m": range_m,
        "exposure_jpm2": exposure_jpm2,
        "permitted_jpm2": allowed,
        "margin": allowed / exposure_jpm2,
    }
