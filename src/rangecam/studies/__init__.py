"""The experiments of the theses: what they claim beside what this program computes, and a figure each.

A study is a function of a random generator; it returns its claims and the series of its figure.
- study: claims, studies, JSON, table
- figure: how a study is drawn
- literature, applications: ranging principles side by side; what applications ask of the pulsed camera
- thesis_camera: the pulsed camera as the numbers of the thesis assume it
- pulsed_optics, pulsed_noise, pulsed_correlation, pulsed_methods, pulsed_distance, eye_safety: one experiment each
- calibration, noise_fit: what calibration leaves, by planes and by laser delays; noise parameters from recordings
- pulsed_sensor, pulsed_laser, pulsed_scenes, pulsed_experiment: the same on the bench, measured with the whole camera
- pulsed_ambient, pulsed_rain, pulsed_gating, pulsed_saturation: the environment of the pulsed camera
- virtual: how the whole camera measures in them
- tracking_models, tracking_tuning: the motion models side by side; process and pixel noise of the thesis' filter
- honesty: whether what is stated of collisions holds, over simulated drives
- classification: rules and trained trees side by side
- tracking_crowds: identities of people who hide each other, merge and part; its scenes and its peers
- cw_imperfections: what each imperfection of the continuous-wave camera does; trades of its settings
- cw_scattering, cw_motion, cw_flying, cw_hdr, cw_multipath: and what its correction leaves; plates: scenes
- cw_calibration: what calibration leaves of wiggling, offset, fixed pattern and drift with the temperature
- arctangents, emulation: ways to the phase, and the microcontroller's integers beside exact ranging
- embedded: processing units, memories and debug stream of the microcontroller
- filters: the filters of cleaning side by side; segmentation: its methods
- unwrapping: several modulation frequencies, their errors and what the phasor filter saves
"""

from collections.abc import Callable

import numpy as np

from rangecam.errors import UsageError, did_you_mean
from rangecam.studies.applications import applications
from rangecam.studies.arctangents import arctangents
from rangecam.studies.calibration import calibration
from rangecam.studies.classification import classification
from rangecam.studies.cw_calibration import cw_calibration
from rangecam.studies.cw_flying import cw_flying
from rangecam.studies.cw_hdr import cw_hdr
from rangecam.studies.cw_imperfections import cw_imperfections
from rangecam.studies.cw_motion import cw_motion
from rangecam.studies.cw_multipath import cw_multipath
from rangecam.studies.cw_scattering import cw_scattering
from rangecam.studies.embedded import embedded_memory, embedded_schedule
from rangecam.studies.emulation import emulation
from rangecam.studies.eye_safety import eye_safety
from rangecam.studies.figure import draw
from rangecam.studies.filters import filters
from rangecam.studies.honesty import honesty
from rangecam.studies.literature import ranging_principles
from rangecam.studies.noise_fit import noise_fit
from rangecam.studies.pulsed_ambient import pulsed_ambient
from rangecam.studies.pulsed_correlation import pulsed_correlation
from rangecam.studies.pulsed_distance import pulsed_distance
from rangecam.studies.pulsed_experiment import pulsed_experiment
from rangecam.studies.pulsed_gating import pulsed_gating
from rangecam.studies.pulsed_laser import pulsed_laser
from rangecam.studies.pulsed_methods import pulsed_methods
from rangecam.studies.pulsed_noise import pulsed_noise
from rangecam.studies.pulsed_optics import pulsed_optics
from rangecam.studies.pulsed_rain import pulsed_rain
from rangecam.studies.pulsed_saturation import pulsed_saturation
from rangecam.studies.pulsed_scenes import pulsed_scenes
from rangecam.studies.pulsed_sensor import pulsed_sensor
from rangecam.studies.segmentation import segmentation
from rangecam.studies.study import Claim, Panel, Picture, Series, Study, as_json, table, verdicts
from rangecam.studies.tracking_crowds import tracking_crowds
from rangecam.studies.tracking_models import tracking_models
from rangecam.studies.tracking_tuning import tracking_tuning
from rangecam.studies.unwrapping import unwrapping

STUDIES: dict[str, Callable[[np.random.Generator], Study]] = {
    "ranging-principles": ranging_principles,
    "pulsed-optics": pulsed_optics,
    "pulsed-noise": pulsed_noise,
    "pulsed-correlation": pulsed_correlation,
    "pulsed-methods": pulsed_methods,
    "pulsed-distance": pulsed_distance,
    "pulsed-sensor": pulsed_sensor,
    "pulsed-laser": pulsed_laser,
    "pulsed-experiment": pulsed_experiment,
    "pulsed-scenes": pulsed_scenes,
    "pulsed-ambient": pulsed_ambient,
    "pulsed-rain": pulsed_rain,
    "pulsed-gating": pulsed_gating,
    "pulsed-saturation": pulsed_saturation,
    "calibration": calibration,
    "noise-fit": noise_fit,
    "eye-safety": eye_safety,
    "applications": applications,
    "classification": classification,
    "tracking-models": tracking_models,
    "tracking-tuning": tracking_tuning,
    "honesty": honesty,
    "tracking-crowds": tracking_crowds,
    "cw-imperfections": cw_imperfections,
    "cw-calibration": cw_calibration,
    "cw-scattering": cw_scattering,
    "cw-motion": cw_motion,
    "cw-flying": cw_flying,
    "cw-hdr": cw_hdr,
    "cw-multipath": cw_multipath,
    "arctangents": arctangents,
    "emulation": emulation,
    "embedded-schedule": embedded_schedule,
    "embedded-memory": embedded_memory,
    "filters": filters,
    "segmentation": segmentation,
    "cw-unwrapping": unwrapping,
}
"""Studies by name."""


def study_names(name: str) -> list[str]:
    """Return the studies that a name means, all of them for "all"; raises UsageError for an unknown one."""
    known = [*STUDIES, "all"]
    if name not in known:
        raise UsageError(f"unknown study '{name}'{did_you_mean(name, known)} (known: {', '.join(known)})")
    return list(STUDIES) if name == "all" else [name]


def run_study(name: str, seed: int = 0) -> Study:
    """Return the study of that name (one of `study_names`), its simulated noise from a seed."""
    return STUDIES[name](np.random.default_rng(seed))


def study_list() -> str:
    """Return a line for each study: its name and what it is about."""
    lines = ((name, (function.__doc__ or "").splitlines()[0]) for name, function in STUDIES.items())
    return "\n".join(f"{name:18} {line}" for name, line in lines)


__all__ = [
    "STUDIES",
    "Claim",
    "Panel",
    "Picture",
    "Series",
    "Study",
    "as_json",
    "draw",
    "run_study",
    "study_list",
    "study_names",
    "table",
    "verdicts",
]
