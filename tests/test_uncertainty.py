"""Claims about the standard deviations: intervals hold the truth as often as they say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from rangecam.cameras.simulated import frames
from rangecam.clean import clean
from rangecam.config import load_config
from rangecam.pipeline import RANGING
from rangecam.scene.paths import Path
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, SceneObject

# family, settings, distances, images per condition
DIFFERENTIAL = {"camera": {"pixel": "differential"}}
SINGLE_ENDED = {"camera": {"pixel": "single_ended", "black_level_lsb": 100.0}}
OUTDOORS = {"camera": {"pixel": "single_ended", "black_level_lsb": 100.0}, "ambient_wpm2": 8.0}
CASES = {
    "continuous wave": ("scaled_car", DIFFERENTIAL, (0.8, 1.5, 2.5, 4.0), 1),
    "continuous wave, single-ended": ("scaled_car", SINGLE_ENDED, (0.8, 1.5, 2.5, 4.0), 1),
    "continuous wave, in ambient light": ("scaled_car", OUTDOORS, (0.8, 1.5, 2.5, 4.0), 1),
    "pulsed": ("usercams", {}, (2.0, 5.0, 10.0, 18.0), 25),
}
REFLECTIVITIES = (0.1, 0.4, 0.9)


def plane(range_m, reflectivity, ambient_wpm2=0.0):
    box = Box(center_m=(0.5, 0.0, 0.0), size_m=(1.0, 200.0, 200.0), reflectivity=reflectivity)
    thing = SceneObject(name="plane", boxes=(box,), path=Path(start_m=(range_m, 0.0, 0.0)))
    fields = {"name": "plane", "description": "", "preset": "", "ambient_wpm2": ambient_wpm2, "subpixels": 1}
    return Scenario(**fields, duration_s=10.0, objects=(thing,))


def normalised_errors(case, stage):
    """Errors over sigma of the valid pixels for each (range, reflectivity), with the fraction that is valid."""
    preset, settings, ranges, count = CASES[case]
    ambient_wpm2 = settings.get("ambient_wpm2", 0.0)
    config = load_config(preset, {key: value for key, value in settings.items() if key != "ambient_wpm2"})
    for seed, (range_m, rho) in enumerate((r, rho) for r in ranges for rho in REFLECTIVITIES):
        errors, valid = [], []
        for _, capture in zip(range(count), frames(plane(range_m, rho, ambient_wpm2), config, seed), strict=False):
            image = stage(RANGING[config.ranging](capture.raw, config.camera), config)
            errors.append(((image.range_m - capture.truth.range_m) / image.sigma_m)[image.valid])
            valid.append(image.valid.mean())
        yield np.concatenate(errors), float(np.mean(valid))


def inside(errors, k):
    return float(np.mean(np.abs(errors) < k))


@pytest.mark.parametrize("case", CASES)
def test_after_ranging_one_and_two_sigma_hold_the_truth_as_often_as_they_say(case):
    pooled = []
    for errors, valid in normalised_errors(case, lambda image, config: image):
        pooled.append(errors)
        if valid < 0.25:  # of the few that pass a threshold, noise chose too many
            continue
        for k, tolerance in ((1, 0.015), (2, 0.008)):
            expected = float(erf(k / np.sqrt(2)))
            allowed = tolerance + 4 * np.sqrt(expected * (1 - expected) / len(errors))
            assert inside(errors, k) == pytest.approx(expected, abs=allowed)
        assert abs(np.mean(errors)) < 0.05 + 4 / np.sqrt(len(errors))
    all_errors = np.concatenate(pooled)
    assert len(all_errors) > 50_000  # four standard deviations of the fractions are then 0.8 and 0.4 points
    assert 0.66 < inside(all_errors, 1) < 0.70
    assert 0.94 < inside(all_errors, 2) < 0.96


@pytest.mark.parametrize("case", CASES)
def test_after_cleaning_one_and_two_sigma_hold_the_truth_within_three_points(case):
    everywhere = {"floor": "off", "x_min_m": None, "x_max_m": None, "width_m": None, "z_min_m": None, "z_max_m": None}

    def cleaned(image, config):
        return clean(image, config.camera.lens, config.mounting, replace(config.clean, **everywhere))

    all_errors = np.concatenate([errors for errors, _ in normalised_errors(case, cleaned)])
    assert len(all_errors) > 50_000
    assert inside(all_errors, 1) == pytest.approx(0.6827, abs=0.03)
    assert inside(all_errors, 2) == pytest.approx(0.9545, abs=0.03)
