"""The benchmark: rows by their fixed names, peers that compute the same thing, absent peers named."""

import json
from typing import Any

import numpy as np
import pytest

import rangecam.bench.works as works
from rangecam.bench import measure, peers, table, unwrapping_peer
from rangecam.bench.race import Row, race
from rangecam.cli import main
from rangecam.config import load_config
from rangecam.cw import simulate
from rangecam.pipeline import RANGING, call, process_frame
from rangecam.scene.view import View
from rangecam.types import Tracks

ROWS = {
    *("cw_range_160x120", "cw_chain_160x120", "cw_range_640x480", "cw_chain_640x480", "pulsed_chain_64x8"),
    *("kinect2_decode_512x424", "tracker_20_ca", "tracker_20_imm", "region_growing_160x120"),
    *("simulate_cw_160x120", "simulate_pulsed_64x8"),
    *("loop_cw_160x120", "loop_cw_160x120_imperfect", "loop_pulsed_64x8"),
}


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    return measure(0.01)


def test_every_row_has_its_name_and_positive_times(result: dict[str, Any]) -> None:
    names = [row["work"] for row in result["rows"]]
    assert set(names) >= ROWS
    assert {
        f"{camera}: {stage}" for camera in ("scaled_car", "usercams") for stage in ("ranging", "clean", "tracking")
    } <= {*names}
    assert all(row["ms"] > 0 for row in result["rows"])
    assert all(
        row["ratio"] == pytest.approx(row["peer_ms"] / row["ms"], rel=0.05) for row in result["rows"] if row["peer_ms"]
    )


def test_the_table_has_a_line_for_every_row(result: dict[str, Any]) -> None:
    assert len(table(result).splitlines()) == len(result["rows"]) + 2


def test_a_peer_that_is_not_installed_is_named_and_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(works, "find_spec", lambda package: None)
    name, function = works._peer("cv2", "OpenCV", peers.opencv_cw_range)
    assert function is None
    assert "OpenCV: not installed" in name
    row = race("work", lambda: None, name, function, 0.001)
    assert (row.peer_ms, row.ratio) == (None, None)
    assert "-" in table(
        {"machine": "m", "rows": [{"work": "w", "ms": 1.0, "peer": name, "peer_ms": None, "ratio": None}]}
    )


def test_the_ratio_says_how_many_times_faster_we_are() -> None:
    assert Row("w", 2.0, "p", 8.0).ratio == 4.0


def test_the_opencv_composition_finds_the_same_cleaned_range() -> None:
    moment = works._moment("scenario:test-scene", 12)
    kept: dict[str, Any] = {}

    def keep(stage: str, function: Any, *arguments: Any) -> Any:
        kept[stage] = call(stage, function, *arguments)
        return kept[stage]

    process_frame(moment.capture.raw, Tracks.empty(), moment.capture.ego, moment.config, keep)
    range_m, _, mask, why = peers.opencv_cw_range(moment.config)(moment.capture.raw.planes)
    ours, both = kept["clean"], kept["clean"].valid & (mask > 0)
    assert both.sum() > 0.7 * ours.valid.sum()
    assert np.median(np.abs(range_m - ours.range_m)[both]) < 0.02
    np.testing.assert_array_equal(why == 0, mask > 0)
    assert np.mean(why == ours.why) > 0.9  # the reasons, too, but for the pixels at edges


def test_the_opencv_composition_of_three_frequencies_finds_the_same_ranges() -> None:
    config = load_config("kinect2_like", {"camera": {"rows": 40, "columns": 60}})
    range_m = np.where(np.arange(60) < 30, 1.5, 4.0) + np.zeros((1, 40, 1))
    view = View(range_m, np.full(range_m.shape, 0.5), np.ones(range_m.shape))
    raw = simulate(lambda _: view, config.camera, 0.0, np.random.default_rng(1))
    theirs = unwrapping_peer.opencv_multi_frequency(config)(raw.planes)
    ours = RANGING["cw_multi_frequency"](raw, config.camera)
    both = ours.valid & np.isfinite(theirs)
    assert both.mean() > 0.9
    assert np.abs(theirs - ours.range_m)[both].max() < 0.05
    unfiltered = load_config("kinect2_like", {"camera": {"phasor_filter": "off", "rows": 40, "columns": 60}})
    assert np.isfinite(unwrapping_peer.opencv_multi_frequency(unfiltered)(raw.planes)).mean() > 0.8


def test_the_opencv_chains_find_the_same_nearest_object() -> None:
    for url, number, make in (
        ("scenario:approach-box", 45, peers.opencv_cw_chain),
        ("scenario:braking-car", 120, peers.opencv_pulsed_chain),
    ):
        moment = works._moment(url, number)
        frame = works._chain(moment)()
        assert moment.config.ranging in RANGING
        nearest = make(moment.config)(moment.capture.raw.planes)
        assert nearest == pytest.approx(frame.segments.position_m[:, 0].min(), abs=0.5)


def test_the_command_prints_one_json_object(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {"rows": [{"work": "w", "ms": 1.0, "peer": "p", "peer_ms": 2.0, "ratio": 2.0}], "machine": "m"}
    monkeypatch.setattr("rangecam.bench.measure", lambda seconds: short)
    assert main(["bench", "--seconds", "0.01", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == short
    assert main(["bench"]) == 0
    assert "ratio" in capsys.readouterr().out
