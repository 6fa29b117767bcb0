"""Sources by URL: what opens, which settings win, and what is said when nothing opens."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rangecam
from rangecam.cameras import open_camera
from rangecam.config import load_config, tree
from rangecam.errors import DataError, UsageError
from rangecam.io import Recorder, open_source
from rangecam.io.sources import SCHEMES, SUFFIXES
from rangecam.scene.scenario import load_scenario, scenario_names
from rangecam.types import Capture, RawFrame

SMALL = {"camera": {"rows": 6, "columns": 8}}


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    phases = {f"phase_{step}": np.full((6, 8), 100.0 + step, np.float32) for step in (0, 90, 180, 270)}
    np.savez(tmp_path / "raw.npz", **phases, modulation_hz=20e6, phase_sign=-1)
    return tmp_path / "raw.npz"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    config = load_config("generic_cw", {"camera": {"modulation_hz": 33e6}, "clean": {"filter": "off"}})
    with Recorder(tmp_path / "a.mcap", config, "elsewhere") as recorder:
        planes = {f"phase_{step}": np.full((6, 8), step, np.int16) for step in (0, 90, 180, 270)}
        recorder.write(Capture(RawFrame(0.5, planes, 7)))
    return tmp_path / "a.mcap"


def test_the_package_opens_sources_by_itself() -> None:
    assert rangecam.open_source is open_source


@pytest.mark.parametrize("name", scenario_names())
def test_a_scenario_is_seen_with_its_own_preset_and_knows_how_many_frames_it_has(name: str) -> None:
    source = open_source(f"scenario:{name}", layers=[SMALL])
    assert source.config.preset == load_scenario(name).preset
    assert source.config.camera.rows == 6
    assert source.n_frames == sum(1 for _ in source.captures)
    assert source.name == f"scenario:{name}"


def test_a_scenario_is_the_same_for_the_same_seed_and_can_be_seen_again() -> None:
    first, other = (open_source("scenario:test-scene", layers=[SMALL], seed=seed) for seed in (3, 4))
    a, b, c = (next(iter(source.captures)).raw.planes["phase_0"] for source in (first, first, other))
    wanted = next(open_camera("simulated")(load_scenario("test-scene"), first.config, 3)).raw.planes["phase_0"]
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(a, wanted)
    assert (a != c).any()


def test_a_scenario_of_ones_own_is_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('description = "nothing"\npreset = "generic_range"\nduration_s = 0.1\nframe_rate_hz = 50.0\n')
    source = open_source(f"scenario:{file}", layers=[SMALL])
    assert source.n_frames == 5
    assert source.config.preset == "generic_range"
    with pytest.raises(UsageError, match="cannot be read"):
        open_source(f"scenario:{tmp_path / 'none.toml'}")


def test_facts_win_over_the_preset_and_layers_win_over_facts(raw: Path) -> None:
    assert open_source(raw).config.preset == "generic_cw"
    assert open_source(raw).config.camera.modulation_hz == 20e6
    assert open_source(raw).config.camera.phase_sign == -1
    assert open_source(raw).config.camera.rows == 6
    other = open_source(raw, preset="scaled_car")
    assert (other.config.preset, other.config.camera.modulation_hz) == ("scaled_car", 20e6)
    layers = [{"camera": {"modulation_hz": 1e6, "phase_sign": 1}}, {"camera": {"modulation_hz": 2e6}}]
    last = open_source(raw, layers=layers).config.camera
    assert (last.modulation_hz, last.phase_sign) == (2e6, 1)


def test_a_preset_named_in_a_layer_is_the_one_to_begin_with_unless_another_is_asked_for(raw: Path) -> None:
    layers = [{"preset": "generic_cw"}, {"preset": "scaled_car"}]
    in_layer = open_source(raw, layers=layers).config
    asked = open_source(raw, preset="scaled_car").config
    assert in_layer == asked
    assert open_source(raw, preset="generic_cw", layers=[{"preset": "scaled_car"}]).config.mounting == (
        load_config("generic_cw").mounting
    )


def test_a_camera_of_the_right_family_in_a_layer_replaces_that_of_the_preset_but_not_the_facts(raw: Path) -> None:
    layer = {"camera": {"kind": "cw", "offset_m": 0.25}, "ranging": "cw_four_phase"}
    camera = open_source(raw, preset="usercams", layers=[layer]).config.camera
    assert (camera.kind, camera.offset_m, camera.modulation_hz) == ("cw", 0.25, 20e6)


def test_a_ready_configuration_is_taken_as_it_is(raw: Path) -> None:
    config = load_config("generic_cw", {"camera": {"modulation_hz": 5e6}})
    assert open_source(raw, config).config is config
    with pytest.raises(UsageError, match="not both"):
        open_source(raw, config, preset="generic_cw")
    with pytest.raises(UsageError, match="not both"):
        open_source(raw, config, layers=[SMALL])


@pytest.mark.parametrize("how", ["preset", "config", "layer"])
def test_settings_of_another_family_are_refused_with_one_that_fits(raw: Path, how: str) -> None:
    arguments: dict[str, Any] = {
        "preset": {"preset": "usercams"},
        "config": {"config": load_config("usercams")},
        "layer": {"layers": [{"camera": {"kind": "pulsed"}}]},
    }[how]
    with pytest.raises(UsageError, match=r"raw continuous-wave samples.* pulsed camera.* generic_cw"):
        open_source(raw, **arguments)


def test_a_recording_brings_its_settings_with_it(recording: Path) -> None:
    source = open_source(recording)
    assert source.config == load_config("generic_cw", {"camera": {"modulation_hz": 33e6}, "clean": {"filter": "off"}})
    assert open_source(recording, layers=[SMALL]).config.camera.modulation_hz == 33e6
    assert open_source(recording, preset="scaled_car").config == load_config("scaled_car")
    with pytest.raises(UsageError, match="pulsed camera"):
        open_source(recording, preset="usercams")


def record_settings(path: Path, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> Path:
    """Write a recording whose settings are changed, as another version of rangecam might have done."""
    config = load_config("generic_cw")
    changed = {**tree(config), **changes}
    monkeypatch.setattr("rangecam.io.recorder.tree", lambda _: changed)
    with Recorder(path, config) as recorder:
        recorder.write(Capture(RawFrame(0.0, {"phase_0": np.zeros((2, 3))})))
    return path


def test_a_recording_made_with_a_preset_that_is_gone_keeps_its_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rangecam.io.sources.preset_names", lambda: ["scaled_car"])
    path = record_settings(tmp_path / "a.mcap", monkeypatch)
    assert open_source(path).config == load_config("generic_cw")


def test_a_recording_with_settings_that_do_not_fit_says_so_and_opens_with_a_preset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record_settings(tmp_path / "a.mcap", monkeypatch, telepathy=True)
    with pytest.raises(DataError, match=r"telepathy.*") as caught:
        open_source(path)
    assert "--preset" in str(caught.value)
    assert open_source(path, preset="generic_cw").config == load_config("generic_cw")


BAD = {
    "missing.npz": (UsageError, "no such file"),
    "folder.npz": (UsageError, "not a file"),
    "empty.npz": (DataError, "empty"),
    "empty.mcap": (DataError, "empty"),
    "film.mp4": (UsageError, "scenario:NAME"),
    "tcp://127.0.0.1:5000": (UsageError, "nobody knows"),
    "udp://127.0.0.1": (UsageError, "udp://HOST:PORT"),
    "scenario:test-scen": (UsageError, "did you mean 'test-scene'"),
    "scenaro:test-scene": (UsageError, "scenario:NAME"),
    "": (UsageError, "scenario:NAME"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_opened_is_named_with_what_could(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.npz").mkdir()
    for empty in ("empty.npz", "empty.mcap", "film.mp4"):
        (tmp_path / empty).touch()
    kind, words = BAD[name]
    with pytest.raises(kind, match=words) as caught:
        open_source(name)
    assert "\n" not in str(caught.value)
    assert name.removeprefix("scenario:") in str(caught.value)


def test_a_file_without_permission_is_named(raw: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(UsageError, match="no permission"):
        open_source(raw)


def test_suffixes_may_be_written_in_capitals(raw: Path) -> None:
    assert open_source(raw.rename(raw.with_name("RAW.NPZ"))).n_frames == 1


def test_every_opener_is_reached_by_a_url() -> None:
    assert set(SCHEMES) == {"scenario", "udp"}
    assert set(SUFFIXES) == {".npz", ".mcap"}


def test_a_laser_above_its_thermal_limit_is_a_note_that_names_the_limit() -> None:
    hot = open_source("scenario:braking-car", layers=[{"camera": {"laser": {"repetition_hz": 11e3}}}])
    assert [note for note in hot.notes if "thermal limit" in note and "1.034e+04 Hz" in note]
    assert not [note for note in open_source("scenario:braking-car").notes if "thermal" in note]
