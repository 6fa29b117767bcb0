"""Claims about the studies of the environment, and about ambient light and its filter (König 2008, 5.2)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from rangecam.geometry import Lens, Mounting
from rangecam.optics import Objective, ambient_on_sensor, band_share
from rangecam.pulsed import PulsedCamera, simulate
from rangecam.pulsed.limits import targets_on_axis
from rangecam.scene.render import ray_bundle, render
from rangecam.scene.scenario import AMBIENT_WPM2, parse_scenario
from rangecam.studies import STUDIES, Study, run_study
from rangecam.studies.virtual import measured_edges, ranged

NAMES = [
    "pulsed-sensor", "pulsed-laser", "pulsed-experiment", "pulsed-scenes", "pulsed-ambient", "pulsed-rain",
    "pulsed-gating", "pulsed-saturation",
]  # fmt: skip
ORACLES = {
    ("pulsed-rain", "N-K-070", "as bright"): ([0.43, 0.86, 1.36], 0.005),
    ("pulsed-rain", "N-K-071", "exponent"): ([-4.0, -2.0], 1e-3),
    ("pulsed-rain", "N-K-071", "sees all"): ([0.72], 0.005),
    ("pulsed-rain", "N-K-072", "through a drop"): ([0.41, 1.26, 3.39, 5.50, 7.36, 7.80, 7.97], 0.015),
    ("pulsed-gating", "N-K-073", ""): ([3.33, 1.50], 0.005),
    ("pulsed-gating", "N-K-074.5", ""): ([1.50, 2.25, 28.50], 0.005),
    ("pulsed-gating", "N-K-074.20", ""): ([1.50, 4.50, 28.50], 0.005),
    ("pulsed-gating", "N-K-074.50", ""): ([1.50, 9.00, 28.50], 0.005),
    ("pulsed-gating", "N-K-076", "over the target's, ideal"): ([2.76], 0.03),
    ("pulsed-gating", "N-K-076", "ns, ideal edges"): ([-105, -49, -1.4, 0, 0, 0, 0], 0.6),
    ("pulsed-saturation", "N-K-094", ""): ([0.60, 9.0], 0.005),
    ("pulsed-saturation", "N-K-095", ""): ([1.72, 1.22, 0.38, 17.20], 0.005),
    ("pulsed-ambient", "N-K-098", "full sun on"): ([389], 0.5),
    ("pulsed-ambient", "N-K-098", "laser over"): ([6.1, 0.061], 0.05),
    ("pulsed-ambient", "N-K-098", "both are equal"): ([4.9], 0.05),
    ("pulsed-ambient", "N-K-098", "its signal"): ([183], 0.5),
    ("pulsed-ambient", "N-K-098", "shot noise"): ([0.181], 5e-4),
    ("pulsed-laser", "N-K-046", "power"): ([71.0, 68.1], 0.05),
    ("pulsed-laser", "N-K-092", "a few mm"): ([4.5], 0.05),
    ("pulsed-sensor", "F-K-01", ""): ([2617], 5),
    ("pulsed-sensor", "F-K-03", "fitted"): ([0.0153], 2e-4),
    ("pulsed-sensor", "N-K-084.1", ""): ([0.6827], 7e-3),
    ("pulsed-sensor", "N-K-084.3", ""): ([0.9973], 8e-4),
}
"""What the numbers must give, by study, claim and words of its text: values, tolerance."""


@pytest.fixture(scope="module")
def results() -> dict[str, Study]:
    return {name: run_study(name) for name in NAMES}


@pytest.mark.parametrize("key", ORACLES, ids=" ".join)
def test_the_studies_find_the_numbers_of_the_thesis_in_the_whole_camera(key, results):
    name, number, words = key
    values, tolerance = ORACLES[key]
    found = [c.computed for c in results[name].claims if c.id == number and words in c.text]
    assert found == pytest.approx(values, abs=tolerance)


@pytest.mark.parametrize("name", NAMES)
def test_the_verdicts_of_simulated_measurements_do_not_hang_on_the_seed(name, results):
    again = run_study(name, seed=1)
    assert [c.agrees for c in again.claims] == [c.agrees for c in results[name].claims]
    assert again.name == name
    assert name in STUDIES


def test_mdsi3_is_better_than_mdsi1_at_every_distance_and_accumulation(results):
    """F-K-17, K-CMP-07: 19 distances, 4 numbers of accumulations."""
    least = [c.computed for c in results["pulsed-experiment"].claims if c.id == "F-K-17"]
    assert len(least) == 4
    assert min(least) > 1.1
    enough = [c.computed for c in results["pulsed-experiment"].claims if c.id == "K-CMP-07"]
    assert enough == [19] * 4


def test_the_older_sensor_fails_with_mdsi3_alone(results):
    """K-CMP-09."""
    worst = {c.text: c.computed for c in results["pulsed-experiment"].claims if c.id == "K-CMP-09"}
    (bad,) = [cm for text, cm in worst.items() if "MDSI3, older" in text]
    assert bad > 100
    assert all(cm < 5 for text, cm in worst.items() if "MDSI3, older" not in text)


def test_the_treatment_of_saturation_has_its_price(results):
    """K-ENV-07: fewer images and a larger sigma than a pixel that held the light would have."""
    claims = [c for c in results["pulsed-saturation"].claims if c.id == "K-ENV-07"]
    rates = [c.computed for c in claims if "images a second" in c.text]
    assert rates == pytest.approx([16.4, 44.4], abs=0.1)  # 1 / (1/50 + pulses / 10 kHz)
    worse = [c.computed for c in claims if "would hold" in c.text]
    assert worse[0] == pytest.approx(1.4, abs=0.2)
    assert worse[1] > worse[0]


def test_a_filter_passes_the_share_of_a_black_body_that_planck_gives():
    """Against the integral in wavelengths; the whole spectrum is 1 (Stefan and Boltzmann)."""
    c1, c2, t = 3.741771852e-16, 14.387769e-3, 5778.0
    part = quad(lambda w: c1 / w**5 / np.expm1(c2 / (w * t)), 880e-9, 930e-9)[0] / (5.670374419e-8 * t**4)
    assert band_share((880e-9, 930e-9), t) == pytest.approx(part, rel=1e-6)
    assert band_share((50e-9, 1e-3), t) == pytest.approx(1.0, abs=1e-5)


def test_a_band_pass_takes_ambient_light_off_and_leaves_the_laser():
    one = np.ones(3)
    clear, filtered = Objective(), Objective(ambient_transmission=0.04)
    share = ambient_on_sensor(100.0, one, one, filtered) / ambient_on_sensor(100.0, one, one, clear)
    np.testing.assert_allclose(share, 0.04)
    planes = []
    for objective in (clear, filtered):
        camera, view = targets_on_axis([5.0], 0.5, PulsedCamera(objective=objective))
        view = replace(view, ambient_wpm2=100.0)
        planes.append(simulate(lambda _, seen=view: seen, camera, 0.0, np.random.default_rng(0)).planes)
    assert planes[1]["ambient"] == pytest.approx(0.04 * planes[0]["ambient"], rel=1e-5)
    assert planes[1]["shutter_a"] == pytest.approx(planes[0]["shutter_a"], rel=0.02)


@pytest.mark.parametrize("source", AMBIENT_WPM2)
def test_the_light_of_a_source_comes_to_that_of_a_scenario(source):
    text = f'description = ""\npreset = "usercams"\nduration_s = 1.0\nambient_wpm2 = 2.0\nambient_light = "{source}"\n'
    bundle = ray_bundle(Lens(), Mounting(), (2, 2))
    assert render(parse_scenario("t", text), 0.0, bundle).ambient_wpm2 == 2.0 + AMBIENT_WPM2[source]
    assert set(AMBIENT_WPM2) == {"none", "sun", "street_light", "headlights"}


def test_measured_ranges_know_how_many_were_usable():
    camera = PulsedCamera(max_range_m=9.0)
    found = ranged([5.0, 30.0], 0.5, camera, "mdsi3", 50, np.random.default_rng(0))
    assert found.usable.tolist()[0] == 1.0
    assert found.mean_m[0] == pytest.approx(5.0, abs=0.05)
    assert found.n_acc[0] <= found.n_acc[1]
    assert measured_edges(camera).shutter_edge_s == 65e-9
