"""Configuration: layers, round trip, and errors that name the key, the value and what is allowed."""

import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from rangecam.config import Config, load_config, merge, overrides, parse, preset_names, preset_tree, read_toml, tree
from rangecam.errors import UsageError


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_loads_and_survives_the_round_trip_through_json_values(name: str) -> None:
    config = load_config(name)
    assert config.preset == name
    assert config.description
    assert parse(Config, tree(config), "again") == config


def test_the_presets_of_both_theses_and_the_generic_ones_ship() -> None:
    assert {"usercams", "scaled_car", "generic_cw", "generic_pulsed", "vl53l5cx"} <= set(preset_names())


def test_later_layers_win_and_leave_the_rest_alone() -> None:
    config = load_config("scaled_car", {"camera": {"frame_rate_hz": 25.0}}, overrides(["camera.frame_rate_hz=20"]))
    assert config.camera.frame_rate_hz == 20
    assert config.camera.lens == load_config("scaled_car").camera.lens


def test_a_camera_of_another_kind_replaces_the_whole_camera() -> None:
    merged = merge({"camera": {"kind": "cw", "rows": 3}}, {"camera": {"kind": "pulsed"}})
    assert merged == {"camera": {"kind": "pulsed"}}


def test_merging_changes_neither_of_its_arguments() -> None:
    first, second = {"a": {"b": 1}}, {"a": {"c": 2}}
    assert merge(first, second) == {"a": {"b": 1, "c": 2}}
    assert (first, second) == ({"a": {"b": 1}}, {"a": {"c": 2}})


def test_assignments_are_toml_values_or_else_strings() -> None:
    given = ["a.b=1.5", "a.c=true", "name=usercams", "list=[1, 2]", 'quoted="x=y"']
    assert overrides(given) == {"a": {"b": 1.5, "c": True}, "name": "usercams", "list": [1, 2], "quoted": "x=y"}


@pytest.mark.parametrize("assignment", ["clean.median", "=3", " =3"])
def test_an_assignment_without_key_or_value_is_refused(assignment: str) -> None:
    with pytest.raises(UsageError, match="expected key=value"):
        overrides([assignment])


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ({"camera": {"lense": {}}}, "unknown setting 'camera.lense'; did you mean 'lens'\\?"),
        ({"mountin": {}}, "unknown setting 'mountin'; did you mean 'mounting'\\?"),
        ({"camera": {"lens": {"horizontal_fov_deg": 200}}}, "camera.lens.horizontal_fov_deg = 200: .* less than 175"),
        ({"camera": {"rows": 0}}, "camera.rows = 0: .* greater than 0"),
        ({"camera": {"kind": "sonar"}}, "camera .*'sonar'.*'cw', 'pulsed', 'processed'"),
        ({"ranging": "mdsi3"}, "ranging = 'mdsi3'; possible here: .*cw_four_phase"),
        ({"segmentation": "region_growin"}, "did you mean 'region_growing'\\?"),
        ({"camera": {"modulation_hz": 0}}, "camera.modulation_hz = 0: .* greater than 0"),
        ({"camera": {"frame_rate_hz": float("nan")}}, "camera.frame_rate_hz = nan"),
    ],
)
def test_a_wrong_setting_is_named_with_what_would_be_right(layer: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        load_config("scaled_car", layer)


def test_an_unknown_preset_is_answered_with_the_nearest_and_the_list() -> None:
    with pytest.raises(UsageError, match=r"unknown preset 'scaled-car'; did you mean 'scaled_car'\?.*usercams"):
        load_config("scaled-car")
    with pytest.raises(UsageError, match="unknown preset"):
        preset_tree("../config")


def test_a_configuration_file_that_is_missing_or_no_toml_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere.toml: cannot read the configuration: No such file"):
        read_toml(tmp_path / "nowhere.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("a = = 1")
    with pytest.raises(UsageError, match=r"broken.toml: not a TOML file"):
        read_toml(broken)
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="not a TOML file"):
        read_toml(broken)


def test_equal_settings_hash_alike_in_every_process() -> None:
    config = load_config("usercams")
    assert hash(config) == hash(load_config("usercams"))
    assert hash(config) != hash(load_config("scaled_car"))
    copy = pickle.loads(pickle.dumps(config))
    assert copy == config
    code = (
        "import pickle, sys; from rangecam.config import load_config;"
        "config = pickle.load(sys.stdin.buffer); print(hash(config) == hash(load_config('usercams')))"
    )
    done = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(config), capture_output=True, check=True)
    assert done.stdout.strip() == b"True"


@pytest.mark.parametrize(("preset", "pitch_deg"), [("scaled_car", 0.5), ("usercams", 0.72), ("vl53l5cx", 45 / 8)])
def test_the_brake_rule_counts_pixels_of_the_camera_that_looks(preset: str, pitch_deg: float) -> None:
    assert load_config(preset).decision.pixel_pitch_deg == pytest.approx(pitch_deg, rel=0.02)
    columns = load_config(preset).camera.columns
    finer = load_config(preset, {"camera": {"columns": 4 * columns}})
    lens = finer.camera.lens
    factor = 2 if lens.vertical_fov_deg is not None else 4  # square pixels shrink both ways
    assert finer.decision.pixel_pitch_deg == pytest.approx(load_config(preset).decision.pixel_pitch_deg / factor)
    assert load_config(preset, {"decision": {"pixel_pitch_deg": 3.0}}).decision.pixel_pitch_deg == 3.0


def test_noise_that_segments_share_is_that_of_the_filter_unless_it_is_set():
    from rangecam.clean import CleanSettings, shared_noise_pixels

    for changes in ({"filter": "off"}, {"filter": "mean"}, {"filter": "median", "temporal_frames": 4.0}):
        said = load_config("scaled_car", {"clean": changes}).segments.shared_noise_pixels
        assert said == shared_noise_pixels(CleanSettings(**changes))
    smoothed = load_config("scaled_car", {"clean": {"filter": "off"}, "camera": {"phasor_filter": "5x5"}})
    assert smoothed.segments.shared_noise_pixels == 25.0
    assert load_config("scaled_car", {"segments": {"shared_noise_pixels": 3.0}}).segments.shared_noise_pixels == 3.0
