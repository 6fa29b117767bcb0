"""Exports: what the files hold, that they appear whole or not at all, and what cannot be written."""

import csv
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangecam.config import load_config
from rangecam.errors import DataError, UsageError
from rangecam.io import ImagesWriter, TracksWriter, open_source
from rangecam.io.exports import COLUMNS, IMAGES
from rangecam.io.files import check_target, replacing
from rangecam.pipeline import run
from rangecam.types import CLASSES, Capture, Frame, TrackStatus

WRITERS = {"images.npz": ImagesWriter, "tracks.csv": TracksWriter}


@pytest.fixture(scope="module")
def scene() -> tuple[list[Capture], list[Frame]]:
    """Return captures and frames of a scene in which tracks begin, are confirmed and coast."""
    layers = [{"camera": {"rows": 48, "columns": 64}}, {"segments": {"min_pixels": 4}}]
    source = open_source("scenario:approach-box", layers=layers)
    captures = list(source.captures)
    # a frame in which nothing is seen lets confirmed tracks coast
    blank = {name: np.zeros_like(plane) for name, plane in captures[50].raw.planes.items()}
    captures[50] = replace(captures[50], raw=replace(captures[50].raw, planes=blank))
    return captures, list(run(captures, source.config))


def write(writer: Any, scene: tuple[list[Capture], list[Frame]]) -> None:
    with writer:
        for capture, frame in zip(*scene, strict=True):
            writer.write(capture, frame)


def test_images_hold_every_bit_of_every_frame(scene: tuple[list[Capture], list[Frame]], tmp_path: Path) -> None:
    write(ImagesWriter(tmp_path / "i.npz"), scene)
    frames = scene[1]
    with np.load(tmp_path / "i.npz", allow_pickle=False) as file:
        assert set(file.files) == {"range_m", "sigma_m", "amplitude", "valid", "why", "time_s"}
        np.testing.assert_array_equal(file["time_s"], [frame.image.time_s for frame in frames])
        assert file["time_s"].dtype == np.float64
        for name, dtype in IMAGES.items():
            wanted = np.stack([getattr(frame.image, name) for frame in frames])
            assert file[name].dtype == dtype
            assert file[name].tobytes() == wanted.tobytes()
            assert file[name].shape == (len(frames), 48, 64)
        np.testing.assert_array_equal(file["valid"], file["why"] == 0)


def test_images_can_be_opened_as_a_source_again(scene: tuple[list[Capture], list[Frame]], tmp_path: Path) -> None:
    write(ImagesWriter(tmp_path / "i.npz"), scene)
    source = open_source(tmp_path / "i.npz")
    assert source.n_frames == len(scene[1])
    captures = list(source.captures)
    assert [c.raw.time_s for c in captures] == [f.image.time_s for f in scene[1]]


def test_a_row_of_the_table_is_a_frame_of_a_confirmed_or_coasting_track(
    scene: tuple[list[Capture], list[Frame]], tmp_path: Path
) -> None:
    write(TracksWriter(tmp_path / "t.csv"), scene)
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    wanted = [
        (frame, i, track)
        for frame in scene[1]
        for i, track in enumerate(frame.tracks)
        if track.status != TrackStatus.TENTATIVE
    ]
    assert {track.status for _, _, track in wanted} == {TrackStatus.CONFIRMED, TrackStatus.COASTING}
    assert sum(len(frame.tracks) for frame in scene[1]) > len(wanted)
    assert len(rows) == len(wanted)
    for row, (frame, i, track) in zip(rows, wanted, strict=True):
        numbers = [float(row[name]) for name in COLUMNS if name != "class"]
        collisions = frame.decision.collisions
        exact = [
            *(frame.image.time_s, track.track_id),
            *track.state[[0, 3, 6, 1, 4, 7, 2, 5, 8]],
            *np.sqrt(track.covariance.diagonal()[:2]),
            *(track.size_m[1], track.size_m[2]),
            *(track.class_probability.max(), collisions.ttc_s[i], collisions.ttc_sigma_s[i], collisions.p_collision[i]),
        ]
        np.testing.assert_array_equal(numbers, exact)
        assert row["class"] == track.class_name
        assert row["class"] in CLASSES


def test_without_tracks_the_table_has_its_heading_only(tmp_path: Path) -> None:
    with TracksWriter(tmp_path / "t.csv"):
        pass
    assert (tmp_path / "t.csv").read_text() == ",".join(COLUMNS) + "\n"


def test_without_frames_the_images_are_empty(tmp_path: Path) -> None:
    with ImagesWriter(tmp_path / "i.npz"):
        pass
    with np.load(tmp_path / "i.npz") as file:
        assert {name: file[name].shape for name in file.files} == {
            **dict.fromkeys(IMAGES, (0, 0, 0)),
            "time_s": (0,),
        }


def test_images_of_two_sizes_are_refused(scene: tuple[list[Capture], list[Frame]], tmp_path: Path) -> None:
    capture, frame = scene[0][0], scene[1][0]
    cut = replace(
        frame.image, **{name: getattr(frame.image, name)[1:] for name in ("range_m", "sigma_m", "amplitude", "why")}
    )
    with ImagesWriter(tmp_path / "i.npz") as writer:
        writer.write(capture, frame)
        with pytest.raises(DataError, match=r"frame 1 has shape \(47, 64\), the ones before have \(48, 64\)"):
            writer.write(capture, replace(frame, image=cut))


@pytest.mark.parametrize("name", WRITERS)
def test_nothing_appears_before_the_end_and_nothing_is_left_after_an_error(
    name: str, scene: tuple[list[Capture], list[Frame]], tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_text("from an earlier run")

    def fail() -> None:
        with WRITERS[name](path) as writer:
            for capture, frame in zip(*scene, strict=True):
                writer.write(capture, frame)
            assert sorted(tmp_path.iterdir()) == [path]
            raise ValueError("elsewhere")

    with pytest.raises(ValueError, match="elsewhere"):
        fail()
    assert path.read_text() == "from an earlier run"
    assert sorted(tmp_path.iterdir()) == [path]
    write(WRITERS[name](path), scene)
    assert path.read_bytes() != b"from an earlier run"
    assert sorted(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", WRITERS)
def test_closing_twice_writes_once(name: str, scene: tuple[list[Capture], list[Frame]], tmp_path: Path) -> None:
    writer = WRITERS[name](tmp_path / name)
    writer.write(scene[0][0], scene[1][0])
    writer.close()
    (tmp_path / name).unlink()
    writer.close()
    with writer:
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", WRITERS)
def test_what_cannot_be_written_is_refused_at_once(name: str, tmp_path: Path) -> None:
    read = tmp_path / name
    read.touch()
    (tmp_path / "link").symlink_to(read)
    for path, source, words in (
        (tmp_path / "none" / name, "", f"cannot write .*{name}: the folder .*none does not exist"),
        (tmp_path, "", "it is a folder"),
        (read, str(read), "name another file"),
        (tmp_path / "link", str(read), "name another file"),
    ):
        with pytest.raises(UsageError, match=words):
            WRITERS[name](path, load_config(), source)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_folder_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(UsageError, match="no permission"):
        check_target(tmp_path / "a.npz")


def test_a_target_beside_a_source_that_is_no_file_is_fine(tmp_path: Path) -> None:
    (tmp_path / "a.npz").touch()
    assert check_target(tmp_path / "a.npz", "scenario:test-scene") == tmp_path / "a.npz"


def test_a_replaced_file_has_the_permissions_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with replacing(tmp_path / "a") as part:
        part.write_text("new")
        assert not (tmp_path / "a").exists()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_device_is_refused_and_stays_a_device() -> None:
    with pytest.raises(UsageError, match="it is a device or a pipe; name a file"):
        check_target("/dev/null")
    assert Path("/dev/null").is_char_device()


def test_a_folder_in_which_nothing_can_be_made_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    with pytest.raises(UsageError, match=r"cannot write .*a.npz: No space left on device"):
        check_target(tmp_path / "a.npz")
    assert not list(tmp_path.iterdir())
