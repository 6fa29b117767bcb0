"""The command line as a user meets it: what it prints, what it leaves behind, and how it fails."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangecam.cli import main

SHORT = ["--set", "camera.rows=24", "--set", "camera.columns=32"]


def phases(**changes: Any) -> dict[str, Any]:
    """Return the arrays of a small, valid raw recording of a plane at 2 m, with some of them changed."""
    phase = 4 * np.pi * 20e6 / 299_792_458.0 * 2.0
    arrays: dict[str, Any] = {
        f"phase_{step}": np.full((12, 16), 2000 + 200 * np.cos(phase + np.radians(step)), np.float32)
        for step in (0, 90, 180, 270)
    }
    arrays["modulation_hz"] = 20e6
    return {key: value for key, value in {**arrays, **changes}.items() if value is not None}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    np.savez(tmp_path / "raw.npz", **phases())
    return tmp_path / "raw.npz"


def fails(arguments: list[str], capsys: pytest.CaptureFixture[str], code: int, *words: str) -> None:
    """Check that a call ends with the exit code and one line that holds the words, and prints nothing else."""
    assert main(arguments) == code
    captured = capsys.readouterr()
    errors = [line for line in captured.err.splitlines() if not line.startswith("rangecam: note")]
    assert captured.out == ""
    assert len(errors) == 1, captured.err
    assert errors[0].startswith("rangecam: ")
    for word in words:
        assert word in errors[0]
    assert "Traceback" not in captured.err


def test_run_prints_one_json_object_and_writes_what_was_asked(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = [tmp_path / name for name in ("out.mcap", "out.html", "images.npz", "tracks.csv")]
    options = [
        str(o) for pair in zip(["--record", "--report", "--images", "--tracks"], outputs, strict=True) for o in pair
    ]
    assert main(["run", str(recording), "--json", *options]) == 0
    result = json.loads(capsys.readouterr().out)
    needed = {
        "frames",
        "duration_s",
        "latency_ms",
        "valid_fraction",
        "tracks",
        "decisions",
        "camera",
        "preset",
        "version",
    }
    assert needed <= set(result)
    assert result["frames"] == 1
    assert result["preset"] == "generic_cw"
    assert {"ranging", "clean", "segmentation", "tracking", "decision", "sum"} <= set(result["latency_ms"])
    assert set(result["latency_ms"]["sum"]) == {"p50", "p99", "max"}
    assert all(path.stat().st_size > 0 for path in outputs)
    images = np.load(outputs[2])
    assert {"range_m", "sigma_m", "amplitude", "valid", "why", "time_s"} == set(images.files)
    np.testing.assert_allclose(images["range_m"][images["valid"]], 2.0, atol=1e-3)
    assert images["valid"].all()
    assert images["range_m"].shape == (1, 12, 16)
    assert outputs[1].read_text().count("data:image/png;base64,") == 4
    assert "http" not in outputs[1].read_text()


def test_run_without_json_prints_a_summary_for_people(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(recording)]) == 0
    out = capsys.readouterr().out
    assert "1 frame in" in out
    assert "0 confirmed tracks" in out
    assert "100.0 % valid" in out
    assert "brake      never" in out


def test_settings_of_the_command_line_win_over_file_and_preset(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my.toml").write_text("[camera]\noffset_m = 0.5\nphase_sign = -1\n")
    images = tmp_path / "images.npz"
    call = ["run", str(recording), "--config", str(tmp_path / "my.toml"), "--set", "camera.phase_sign=1"]
    assert main([*call, "--images", str(images), "--json"]) == 0
    capsys.readouterr()
    with np.load(images) as file:
        np.testing.assert_allclose(file["range_m"], 2.5, atol=1e-3)


BAD_FILES: dict[str, tuple[Callable[[Path], object], int, tuple[str, ...]]] = {
    "empty file": (lambda p: p.write_bytes(b""), 1, ("raw.npz", "empty")),
    "text named .npz": (lambda p: p.write_text("time,range\n1,2\n"), 1, ("raw.npz",)),
    "cut-off file": (lambda p: p.write_bytes(p.read_bytes()[:900]), 1, ("raw.npz",)),
    "different shapes": (
        lambda p: np.savez(p, **phases(phase_90=np.zeros((12, 15)))),
        1,
        ("phase_90", "(12, 15)", "(12, 16)"),
    ),
    "NaN samples": (lambda p: np.savez(p, **phases(phase_90=np.full((12, 16), np.nan))), 1, ("phase_90", "NaN")),
    "one NaN sample": (
        lambda p: np.savez(p, **phases(phase_90=np.where(np.eye(12, 16), np.nan, 1.0))),
        1,
        ("phase_90", "NaN"),
    ),
    "missing key": (lambda p: np.savez(p, **phases(phase_270=None)), 1, ("phase_270",)),
    "no known key": (lambda p: np.savez(p, something=np.zeros(3)), 1, ("something",)),
    "modulation of zero": (lambda p: np.savez(p, **phases(modulation_hz=0.0)), 1, ("modulation_hz", "0")),
    "words for samples": (lambda p: np.savez(p, **phases(phase_0=np.full((12, 16), "a"))), 1, ("phase_0",)),
    "pickled objects": (lambda p: np.savez(p, **phases(phase_0=np.full((2, 2), None))), 1, ("phase_0",)),
    "no frames": (
        lambda p: np.savez(p, **{f"phase_{s}": np.zeros((0, 4, 4)) for s in (0, 90, 180, 270)}, modulation_hz=1e7),
        1,
        ("raw.npz",),
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_gives_one_line_and_no_output(
    name: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, code, words = BAD_FILES[name]
    spoil(recording)
    before = sorted(tmp_path.iterdir())
    outputs = [
        "--report",
        str(tmp_path / "r.html"),
        "--images",
        str(tmp_path / "i.npz"),
        "--tracks",
        str(tmp_path / "t.csv"),
    ]
    fails(["run", str(recording), "--record", str(tmp_path / "r.mcap"), *outputs, "--json"], capsys, code, *words)
    assert sorted(tmp_path.iterdir()) == before


BAD_CALLS: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "no source": (["run"], ("SOURCE",)),
    "unknown command": (["rnu", "x"], ("rnu",)),
    "unknown option": (["run", "RAW", "--perset", "generic_cw"], ("perset",)),
    "missing file": (["run", "nowhere.npz"], ("nowhere.npz",)),
    "unknown suffix": (["run", "film.mp4"], ("film.mp4",)),
    "unknown scenario": (["run", "scenario:test-scen"], ("test-scen", "did you mean 'test-scene'")),
    "unknown preset": (["run", "RAW", "--preset", "generic-cw"], ("generic-cw", "did you mean 'generic_cw'")),
    "preset of another family": (["run", "RAW", "--preset", "usercams"], ("usercams", "generic_cw")),
    "misspelled setting": (["run", "RAW", "--set", "camera.ofset_m=1"], ("camera.ofset_m", "did you mean 'offset_m'")),
    "impossible value": (
        ["run", "RAW", "--set", "camera.modulation_hz=-1"],
        ("camera.modulation_hz", "-1", "greater than 0"),
    ),
    "assignment without value": (["run", "RAW", "--set", "camera"], ("key=value",)),
    "missing configuration": (["run", "RAW", "--config", "nowhere.toml"], ("nowhere.toml",)),
    "report in a missing folder": (["run", "RAW", "--report", "FOLDER/x/r.html"], ("r.html",)),
    "images in a missing folder": (["run", "RAW", "--images", "FOLDER/x/i.npz"], ("i.npz",)),
    "tracks in a missing folder": (["run", "RAW", "--tracks", "FOLDER/x/t.csv"], ("t.csv",)),
    "recording in a missing folder": (["run", "RAW", "--record", "FOLDER/x/r.mcap"], ("r.mcap",)),
    "report onto a folder": (["run", "RAW", "--report", "FOLDER"], ("FOLDER",)),
    "simulation without output": (["simulate", "test-scene"], ("-o OUT.mcap", "--stream")),
    "repair of nothing": (["repair", "nowhere.mcap"], ("nowhere.mcap",)),
}


@pytest.mark.parametrize("name", BAD_CALLS)
def test_a_bad_call_gives_one_line_and_exit_code_two(
    name: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, words = BAD_CALLS[name]
    before = sorted(tmp_path.iterdir())

    def fill(text: str) -> str:
        return text.replace("RAW", str(recording)).replace("FOLDER", str(tmp_path))

    fails([fill(a) for a in arguments], capsys, 2, *map(fill, words))
    assert sorted(tmp_path.iterdir()) == before


def test_the_recording_that_is_read_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = tmp_path / "a.mcap"
    assert main(["simulate", "test-scene", "-o", str(recording), *SHORT]) == 0
    content = recording.read_bytes()
    capsys.readouterr()
    fails(["run", str(recording), "--record", str(recording)], capsys, 2, "a.mcap", "another file")
    fails(["repair", str(recording), "-o", str(recording)], capsys, 2, "a.mcap", "another file")
    assert recording.read_bytes() == content


def test_an_error_in_the_middle_of_a_run_leaves_no_half_written_output(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import rangecam.pipeline

    def broken(*arguments: object) -> None:
        raise ValueError("a fault of ours")

    monkeypatch.setattr(rangecam.pipeline, "decide", broken)
    names = ["--report", "r.html", "--images", "i.npz", "--tracks", "t.csv", "--record", "r.mcap"]
    options = [n if n.startswith("--") else str(tmp_path / n) for n in names]
    fails(["run", str(recording), *options], capsys, 1, "internal error", "a fault of ours", "--debug")
    assert sorted(tmp_path.iterdir()) == [recording]
    with pytest.raises(ValueError, match="a fault of ours"):
        main(["run", str(recording), "--debug"])


def test_a_full_disk_is_named_without_a_traceback(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import rangecam.pipeline

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device", "out.mcap")

    monkeypatch.setattr(rangecam.pipeline, "decide", full)
    fails(["run", str(recording)], capsys, 1, "out.mcap: No space left on device")


def test_an_interrupt_ends_with_code_130(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import rangecam.pipeline

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(rangecam.pipeline, "decide", interrupted)
    fails(["run", str(recording)], capsys, 130, "interrupted")


def test_the_demo_leaves_a_report_and_a_recording_that_decodes_to_the_same_decisions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--folder", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    recording, report = tmp_path / "rangecam-approach-box.mcap", tmp_path / "rangecam-approach-box.html"
    assert "brake      at" in out
    assert str(report) in out
    assert report.stat().st_size > 50_000
    digests = []
    for _ in range(2):
        assert main(["run", str(recording), "--json"]) == 0
        digests.append(json.loads(capsys.readouterr().out)["digest"])
    assert main(["run", "scenario:approach-box", "--json"]) == 0
    digests.append(json.loads(capsys.readouterr().out)["digest"])
    assert len(set(digests)) == 1
    assert main(["run", str(recording), "--set", "camera.offset_m=0.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["digest"] != digests[0]


def test_repair_keeps_the_complete_frames_of_a_cut_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "a.mcap"
    assert main(["simulate", "test-scene", "-o", str(recording), "--json", *SHORT]) == 0
    frames = json.loads(capsys.readouterr().out)["frames"]
    recording.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    assert main(["repair", str(recording), "--json"]) == 0
    repaired = json.loads(capsys.readouterr().out)
    assert 0 < repaired["frames"] < frames
    assert main(["run", repaired["output"], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == repaired["frames"]
    recording.write_bytes(b"\x89MCAP0\r\n")
    fails(["repair", str(recording)], capsys, 1, "a.mcap")


def test_the_command_works_as_an_installed_program_and_as_a_module(recording: Path) -> None:
    program = Path(sys.executable).parent / "rangecam"
    for command in ([str(program)], [sys.executable, "-m", "rangecam"]):
        done = subprocess.run([*command, "run", str(recording), "--json"], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["frames"] == 1
    assert subprocess.run([str(program), "run", "nowhere.npz"], capture_output=True, check=False).returncode == 2


def test_help_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(command in out for command in ("demo", "run", "simulate", "repair", "bench"))
    assert os.linesep not in capsys.readouterr().err
