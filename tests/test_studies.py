"""The studies: what they claim, how they judge it, and what the command line makes of them."""

import json
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from rangecam import studies
from rangecam.cli import main
from rangecam.studies import STUDIES, Claim, Panel, Series, Study, as_json, draw, run_study, study_list, table
from rangecam.studies.study import derived, judged, printed
from rangecam.studies.thesis_camera import thesis_camera

KEYS = {"id", "text", "thesis", "computed", "unit", "agrees", "why"}

# What the numbers of the thesis must give, by claim: (value, half a unit of the last digit).
ORACLES = {
    "N-K-010": [(19.968, 5e-4)],
    "N-K-011.30": [(29.95, 5e-3), (8.83, 5e-3), (0.8015, 5e-5)],
    "N-K-011.60": [(59.35, 5e-3), (18.67, 5e-3), (0.9605, 5e-5)],
    "N-K-012": [(75.42, 5e-3)],
    "N-K-013": [(0.580, 5e-4)],
    "N-K-014": [(0.0779, 5e-5)],
    "N-K-015.2": [(1.7, 5e-2)],
    "N-K-015.20": [(2.4, 5e-2)],
    "N-K-023": [(89.3, 5e-2)],
    "N-K-025": [(573.2, 0.1), (1.68e7, 5e4)],
    "N-K-026.4": [(0.97745, 5e-6)],
    "N-K-026.16": [(0.89381, 5e-6)],
    "N-K-026.64": [(0.64254, 5e-6)],
    "N-K-026.100": [(0.51600, 5e-6)],
    "N-K-027": [(65.86, 5e-3)],
    "N-K-028.1": [(0.5822, 5e-5)],
    "N-K-028.4": [(0.8775, 5e-5)],
    "N-K-028.16": [(1.5791, 5e-5)],
    "N-K-028.64": [(3.0640, 5e-5)],
    "N-K-028.100": [(3.8157, 5e-5)],
    "N-K-029.4": [(2.654, 5e-4)],
    "N-K-029.16": [(5.899, 5e-4)],
    "N-K-029.64": [(12.162, 5e-4)],
    "N-K-029.100": [(15.259, 5e-4)],
    "N-K-030.1": [(18.114, 5e-3)],
    "N-K-031": [(144.82, 0.02)],
    "N-K-032": [(222.48, 0.02)],
    "N-K-033": [(71.95, 5e-3)],
    "N-K-034": [(91.89, 5e-3)],
    "N-K-035.3": [(96.66, 5e-3)],
    "N-K-035.4": [(97.91, 5e-3)],
    "N-K-036": [(33.33, 5e-3)],
    "N-K-037": [(96.48, 5e-3)],
    "N-K-038": [(96.98, 5e-3), (96.66 - 96.98, 1e-2)],
    "N-K-039": [(1458, 0.5)],
    "N-K-040": [(1875.2, 0.05)],
    "N-K-041": [(0.844e-3, 5e-7)],
    "N-K-042": [(360, 0.5)],
    "N-K-043": [(2356, 0.5), (424.1, 0.05), (1.110, 5e-4), (0.5549, 1e-4), (14.5, 0.05)],
    "N-K-044": [(6.077e-4, 5e-8), (5.06, 5e-3), (0.51, 5e-3)],
    "N-K-045": [(208, 0.5), (1.44, 5e-3), (46, 0.5), (0.68, 5e-3)],
    "N-K-021": [(0.0, 20.0)],
    "N-K-047": [(21.75, 1e-9)],
    "N-K-048": [(126, 3)],  # straight edges; by the length that is taken for the edge of the shutter, 122 to 128
    "N-K-049.100.1.10": [(50.0, 5e-3)],
    "N-K-049.100.3.10": [(16.67, 5e-3)],
    "N-K-049.100.4.10": [(12.5, 5e-3)],
    "N-K-049.100.1.20": [(100.0, 5e-3)],
    "N-K-049.64.1.10": [(78.125, 5e-3)],
    "N-K-050": [(15, 1e-6)],
    "N-K-060.3": [(1.494, 5e-4), (1.123, 5e-4)],
    "N-K-060.5": [(1.544, 5e-4), (1.217, 5e-4)],
    "N-K-060.8": [(1.601, 6e-4), (1.366, 5e-4)],
    "N-K-060.10": [(1.618, 5e-4), (1.460, 5e-4)],
    "N-K-060.13.5": [(1.581, 5e-4), (1.581, 5e-4)],
    "N-K-060.16": [(1.502, 6e-4), (1.616, 5e-4)],
    "N-K-060.18": [(1.414, 5e-4), (1.612, 6e-4)],
    "N-K-060.20": [(1.316, 5e-4), (1.586, 5e-4)],
    "N-K-060.21": [(1.266, 5e-4), (1.566, 5e-4)],
    "N-K-061": [(1.6180, 1e-4)],
    "N-K-062": [(1.316, 5e-4), (1.217, 5e-4), (0.0, 1e-5)],
    "N-K-063.10": [(24.0, 5e-2), (21.0, 5e-2), (14.9, 5e-2)],
    "N-K-063.30": [(7.5, 5e-2), (6.4, 5e-2), (4.4, 5e-2)],
    "N-K-063.50": [(4.2, 5e-2), (3.6, 5e-2), (2.4, 5e-2)],
    "N-K-064": [(0.500, 5e-4), (0.316, 5e-4), (0.224, 5e-4), (0.158, 5e-4)],
    "N-K-064b": [(0.726, 5e-4), (0.749, 5e-4), (0.792, 5e-4)],
}

# What does not agree, and must say why.
DIFFERING = {
    "pulsed-optics": ["N-K-041"],
    "pulsed-noise": ["N-K-032", "N-K-038", "N-K-038"],
    "pulsed-correlation": ["N-K-048"],
    "pulsed-methods": ["N-K-061", "N-K-064b", "N-K-064b", "N-K-064b"],
    "pulsed-distance": ["N-K-052", "N-K-052", "N-K-052", "E-K-11", "N-K-049.100.4.10"],
    "pulsed-scenes": ["F-K-11"],
    "pulsed-ambient": ["N-K-098"],
    "pulsed-gating": ["N-K-076"],
    "eye-safety": ["N-K-044", "N-K-045", "N-K-045"],
    "emulation": ["N-S-018"],
    "embedded-schedule": ["N-S-046"],
    "embedded-memory": ["N-S-033"],
    "tracking-tuning": ["N-K-086"],
}


result = lru_cache(maxsize=None)(run_study)
"""Each study takes seconds: run once in a process, and only by the tests that ask for it."""
NUMBERED = ("pulsed-optics", "pulsed-noise", "pulsed-correlation", "pulsed-methods", "pulsed-distance", "eye-safety")
"""Studies whose claims have the numbers of `ORACLES`."""
FEW = {name: STUDIES[name] for name in ("eye-safety", "pulsed-optics")}
"""Enough to see what the command line makes of all of them."""


def computed(study: Study, number: str, *words: str) -> list[float]:
    return [c.computed for c in study.claims if c.id == number and all(word in c.text for word in words)]


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_agrees_or_is_known_to_differ_says_why_and_draws_labelled_panels(name: str, tmp_path: Path) -> None:
    study = result(name)
    assert [claim.id for claim in study.claims if claim.agrees is False] == DIFFERING.get(name, [])
    for claim in study.claims:
        assert re.fullmatch(r"(N-[KS]-\d{3}b?(\.[\w.]+)?|E-[KS]-\d\d|[KS]-[A-Z]{3}-\d\d|F-[KS]-\d\d)", claim.id)
        assert claim.text
        assert claim.why
        assert np.isfinite(claim.computed)
        assert claim.agrees is not None or claim.thesis is None
    assert study.name == name
    assert study.section.startswith(("König 2008", "Steinbäck 2016"))
    assert study.panels
    for panel in study.panels:
        assert panel.title
        assert panel.x_label
        assert panel.y_label
        for series in panel.series:
            assert np.shape(series.x) == np.shape(series.y)
            assert series.sigma is None or np.all(np.asarray(series.sigma) > 0)
    (tmp_path / "figure.png").write_bytes(draw(study))
    picture = matplotlib.image.imread(tmp_path / "figure.png")
    assert picture.shape[1] >= 800
    assert picture[..., :3].std() > 0.05


def test_the_numbers_are_those_that_the_equations_must_give() -> None:
    claims = [claim for name in NUMBERED for claim in result(name).claims]
    wrong = {}
    for number, expected in ORACLES.items():
        found = [claim.computed for claim in claims if claim.id == number]
        if len(found) != len(expected) or any(
            abs(value - oracle) > half for value, (oracle, half) in zip(found, expected, strict=True)
        ):
            wrong[number] = found, expected
    assert not wrong


@pytest.mark.parametrize("name", ["pulsed-noise", "pulsed-methods", "pulsed-distance"])
def test_the_verdicts_do_not_hang_on_the_seed(name: str) -> None:
    again = run_study(name, 1)
    assert [claim.agrees for claim in again.claims] == [claim.agrees for claim in result(name).claims]
    assert [claim.computed for claim in again.claims] != [claim.computed for claim in result(name).claims]
    same = run_study(name)
    assert same.claims == result(name).claims


def test_the_distance_study_finds_the_sawtooth_and_the_accuracy() -> None:
    study = result("pulsed-distance")
    assert computed(study, "N-K-053", "range at which") == pytest.approx([2.70, 5.10, 9.20])
    assert computed(study, "N-K-053", "before") == pytest.approx([3.34, 4.20, 5.52], abs=0.006)
    assert computed(study, "N-K-053", "after") == pytest.approx([1.30, 1.92, 2.71], abs=0.006)
    assert computed(study, "N-K-052", "full at 2 m", "from this range") == pytest.approx([12.4], abs=0.06)
    assert computed(study, "N-K-052", "at 20 m") == pytest.approx([5.39, 3.11, 2.70, 3.65], abs=0.006)
    assert computed(study, "E-K-11") == pytest.approx([4.0], rel=0.1)


def test_the_methods_study_finds_the_calculated_sigmas_by_simulation() -> None:
    calculated = {"1.5": 2.864, "1.12": 14.632, "1.20": 36.705, "3.5": 1.856, "3.12": 9.100, "3.20": 27.884}
    for number, sigma_cm in calculated.items():
        assert computed(result("pulsed-methods"), f"N-K-065.{number}") == pytest.approx([sigma_cm] * 2, rel=0.04)


def test_the_thesis_camera_is_full_at_two_metres_on_white() -> None:
    camera = thesis_camera()
    assert camera.laser.peak_power_w == pytest.approx(2000 * 1.5 / 1.110, rel=1e-3)  # N-K-043
    assert camera.shutters == "ab"
    assert thesis_camera("abc") == replace(camera, shutters="abc")


@pytest.mark.parametrize(
    ("thesis", "value", "agrees"),
    [("145", 145.5, True), ("145", 145.51, False), ("0.46", 0.4649, True), ("1.87e3", 1875.2, False)],
)
def test_a_printed_number_agrees_within_half_a_unit_of_its_last_digit(thesis: str, value: float, agrees: bool) -> None:
    claim = printed("N-K-000", "a number", thesis, value, "m", "because")
    assert (claim.agrees, claim.thesis) == (agrees, float(thesis))
    assert claim.why == ("within half a unit of the last printed digit" if agrees else "because")


def test_json_has_the_fixed_shape_and_plain_numbers() -> None:
    plain = json.loads(json.dumps(as_json([result(name) for name in FEW]), allow_nan=False))
    assert [set(study) for study in plain["studies"]] == [{"name", "section", "claims"}] * len(FEW)
    for claim in (claim for study in plain["studies"] for claim in study["claims"]):
        assert set(claim) == KEYS
        assert isinstance(claim["computed"], float)
        assert claim["thesis"] is None or isinstance(claim["thesis"], float)
        assert claim["agrees"] in (True, False, None)


def test_the_table_says_of_each_claim_what_became_of_it() -> None:
    claims = [
        printed("N-K-001", "one", "2", 2.1, "m"),
        judged("N-K-002", "two", None, 3.0, "s", False, "why not"),
        derived("N-K-003", "three", 4.0, ""),
    ]
    lines = table(Study("x", "König 2008", claims)).splitlines()
    assert len(lines) == 5
    assert re.search(r"N-K-001 +2 +2\.1 m +agrees +one", lines[2])
    assert re.search(r"N-K-002 +- +3 s +DIFFERS +two \(why not\)", lines[3])
    assert "agrees" not in lines[4]
    assert "the thesis prints no number" in lines[4]


def test_simulated_results_have_error_bars() -> None:
    for name in ("pulsed-noise", "pulsed-methods", "pulsed-distance"):
        assert any(series.sigma is not None for panel in result(name).panels for series in panel.series)


def test_series_take_the_colour_and_axes_the_scale_that_they_ask_for() -> None:
    plain = Series("line", [1.0, 10.0, 100.0], [1.0, 2.0, 3.0])
    pictures = {
        draw(Study("x", "s", [], [Panel("t", "x (m)", "y (m)", [series], log)]))
        for series in (plain, replace(plain, colour=3), replace(plain, label=""), replace(plain, line="--"))
        for log in ("", "x")
    }
    assert len(pictures) == 8


def test_panels_stand_in_rows_of_three(tmp_path: Path) -> None:
    panel = Panel("t", "x (m)", "y (m)", [Series("line", [0.0, 1.0], [0.0, 1.0])])
    sizes = []
    for count in (1, 3, 4):
        (tmp_path / "figure.png").write_bytes(draw(Study("x", "s", [], [panel] * count)))
        sizes.append(matplotlib.image.imread(tmp_path / "figure.png").shape[:2])
    assert sizes[0][1] < sizes[1][1] == sizes[2][1]
    assert sizes[0][0] == sizes[1][0] < sizes[2][0]


def test_the_command_line_lists_the_studies(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(STUDIES)
    assert lines == study_list().splitlines()
    assert all(len(line) > 40 for line in lines)


def test_the_command_line_prints_a_table_and_leaves_the_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", "eye-safety", "--folder", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert "N-K-044" in captured.out
    assert captured.err == ""
    assert [path.name for path in tmp_path.iterdir()] == ["eye-safety.png"]
    assert (tmp_path / "eye-safety.png").read_bytes()[:4] == b"\x89PNG"


def test_the_command_line_prints_all_as_one_json_object_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(studies, "STUDIES", FEW)
    assert main(["study", "all", "--json", "--seed", "3"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [study["name"] for study in said["studies"]] == list(FEW)
    assert not list(tmp_path.iterdir())
    assert all(isinstance(Claim(**claim), Claim) for study in said["studies"] for claim in study["claims"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["study", "eye-safty"], ["unknown study 'eye-safty'; did you mean 'eye-safety'?", "pulsed-noise"]),
        (["study", "--json"], ["study --json needs a name", "all"]),
        (["study", "eye-safety", "--folder", "nowhere"], ["the folder nowhere does not exist"]),
    ],
)
def test_a_wrong_call_is_one_line_and_exit_code_two(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert all(word in captured.err for word in words)


def test_all_studies_make_one_page_that_opens_offline(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studies, "STUDIES", FEW)
    assert main(["study", "all", "--folder", str(tmp_path)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["studies.html"]
    page = (tmp_path / "studies.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(FEW)
    assert all(f"<h2>{name}</h2>" in page for name in FEW)
    assert not [word for word in ("http://", "https://", "<script") if word in page]
    (total,) = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("all ")]
    claims = [claim.agrees for name in FEW for claim in result(name).claims]
    assert [int(n) for n in total[1:]] == [len(claims), claims.count(True), claims.count(False), claims.count(None)]
