"""Recordings: what goes in comes out bit by bit, and a file that ends anywhere opens up to its last complete frame."""

import hashlib
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from rangecam.config import Config, load_config
from rangecam.errors import DataError, RangecamError, UsageError
from rangecam.geometry import rays, rotation
from rangecam.io import Recorder, open_source, repair
from rangecam.io.messages import MARKER, capture_messages, image_message, marker_message, read_capture, to_bytes
from rangecam.pipeline import run
from rangecam.types import Capture, Ego, Frame, RawFrame, Truth

DATA = os.environ.get("RANGECAM_DATA")
SMALL = {"camera": {"rows": 12, "columns": 16}}


def captures_of(n: int, shape: tuple[int, int] = (3, 4)) -> list[Capture]:
    """Return n captures with samples that no two frames share."""
    rng = np.random.default_rng(5)
    steps = (0, 90, 180, 270)
    return [
        Capture(
            RawFrame(0.1 * k, {f"phase_{s}": rng.integers(0, 4095, shape, np.uint16) for s in steps}, k + 10),
            Ego(0.1 * k, 1 / 3, 0.01, friction=0.25 if k else None),
        )
        for k in range(n)
    ]


def record(path: Path, captures: list[Capture], config: Config | None = None) -> Path:
    with Recorder(path, config or load_config("generic_cw"), "test") as recorder:
        for capture in captures:
            recorder.write(capture)
    return path


def same(a: Capture, b: Capture) -> bool:
    """Return whether two captures are equal bit by bit."""
    return key(a) == key(b)


def key(capture: Capture) -> str:
    return hashlib.sha256(repr([(t, to_bytes(p)) for t, p in capture_messages(capture)]).encode()).hexdigest()


def read(path: Path) -> list[Capture]:
    return list(open_source(path).captures)


def chunk_ends(path: Path) -> list[int]:
    """Return where in a whole file the chunk of each frame ends."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]


DTYPES = ["u1", "<u2", "<f4", "<i2", "<f8", "?", "i1", "<u4", "<i8", "<u8", ">u2", ">f4", "<f2", "<c8", "<f16"]


@pytest.mark.parametrize("dtype", DTYPES)
@settings(deadline=None, max_examples=15)
@given(data=st.data())
def test_a_plane_of_any_number_type_comes_back_bit_by_bit(dtype: str, data: st.DataObject) -> None:
    plane = data.draw(npst.arrays(dtype, npst.array_shapes(min_dims=2, max_dims=2, max_side=5)))
    capture = Capture(RawFrame(0.5, {"a": plane, "b": plane[::-1].T}))
    messages = {topic: to_bytes(payload) for topic, payload in capture_messages(capture)}
    topic, marker = marker_message(capture.raw, [])
    planes = read_capture({**messages, topic: to_bytes(marker)}).raw.planes
    for name, wanted in capture.raw.planes.items():
        assert planes[name].dtype == wanted.dtype
        assert planes[name].shape == wanted.shape
        assert planes[name].tobytes() == wanted.tobytes()


def test_types_that_other_tools_know_have_their_names() -> None:
    names = {dtype: image_message(np.zeros((2, 3), dtype), 0.0).encoding for dtype in ("u1", "<u2", "<f4", "<f8", "?")}
    assert names == {"u1": "mono8", "<u2": "mono16", "<f4": "32FC1", "<f8": "numpy:<f8", "?": "numpy:|b1"}


@pytest.mark.parametrize("plane", [np.full((2, 2), None), np.full((2, 2), "a"), np.zeros(3), np.zeros((1, 2, 3))])
def test_what_is_no_image_of_numbers_is_not_recorded(plane: Any, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="image of numbers"):
        record(tmp_path / "a.mcap", [Capture(RawFrame(0.0, {"a": plane}))])
    assert not list(tmp_path.iterdir())


numbers = st.floats(allow_nan=True, allow_infinity=True)


@settings(deadline=None)
@given(
    time_s=numbers,
    frame_id=st.integers(0, 2**53),
    ego=st.builds(Ego, numbers, st.none() | numbers, numbers, st.booleans()),
    positions=st.lists(st.tuples(numbers, numbers, numbers), max_size=3),
)
def test_times_ego_and_truth_come_back_exactly(
    time_s: float, frame_id: int, ego: Ego, positions: list[tuple[float, float, float]]
) -> None:
    rows = np.array(positions).reshape(-1, 3)
    images = (np.full((2, 3), np.inf, np.float32), np.ones((2, 3)), np.arange(6, dtype=np.int32).reshape(2, 3))
    truth = Truth(*images, tuple(f"thing {i}" for i in range(len(rows))), rows, -rows)
    capture = Capture(RawFrame(time_s, {"a": np.zeros((2, 3), np.uint8)}, frame_id), ego, truth)
    messages = {topic: to_bytes(payload) for topic, payload in capture_messages(capture)}
    topic, marker = marker_message(capture.raw, [])
    back = read_capture({**messages, topic: to_bytes(marker)})
    np.testing.assert_equal(vars(back.ego), vars(ego))
    np.testing.assert_equal((back.raw.time_s, back.raw.frame_id), (time_s, frame_id))
    assert back.truth is not None
    np.testing.assert_equal(vars(back.truth), vars(truth))


def test_a_recording_comes_back_with_its_frames_in_order_and_its_configuration(tmp_path: Path) -> None:
    config = load_config("generic_cw", {"camera": {"offset_m": 0.1 + 0.2}})
    captures = captures_of(5)
    source = open_source(record(tmp_path / "a.mcap", captures, config))
    assert source.config == config
    assert source.n_frames == 5
    assert source.notes == ()
    for _ in range(2):
        assert all(same(a, b) for a, b in zip(source.captures, captures, strict=True))


def digest(frames: Iterator[Frame]) -> str:
    """Return what stands for every bit of images, tracks and decisions."""
    parts = []
    for frame in frames:
        arrays = [*vars(frame.image).values(), *vars(frame.tracks).values(), *vars(frame.decision.collisions).values()]
        parts += [a.tobytes() if isinstance(a, np.ndarray) else repr(a).encode() for a in arrays]
        parts.append(repr([v for k, v in vars(frame.decision).items() if k != "collisions"]).encode())
    return hashlib.sha256(b"|".join(parts)).hexdigest()


SOURCES = ["scenario:approach-box", "scenario:crossing-person", "vl53l5cx_flights/A0.npz"]


@pytest.mark.parametrize("name", SOURCES)
def test_a_recorded_run_can_be_repeated_bit_by_bit_again_and_again(name: str, tmp_path: Path) -> None:
    if name.endswith(".npz") and DATA is None:
        pytest.skip("RANGECAM_DATA does not name the folder of real recordings")
    layers = [] if name.endswith(".npz") else [{"camera": {"rows": 24, "columns": 32}}]
    url, wanted = name if name.startswith("scenario") else f"{DATA}/{name}", ""
    for generation in ("a.mcap", "b.mcap"):
        source = open_source(url, layers=layers)
        with Recorder(tmp_path / generation, source.config, source.name) as recorder:
            wanted = wanted or digest(run(source.captures, source.config))
            assert digest(run(source.captures, source.config, [recorder])) == wanted
        url, layers = str(tmp_path / generation), []
    again = open_source(url)
    assert digest(run(again.captures, again.config)) == wanted
    truths = [capture.truth for capture in again.captures]
    assert all((truth is not None) == name.startswith("scenario") for truth in truths)


def test_a_recording_can_be_decoded_otherwise(tmp_path: Path) -> None:
    source = open_source("scenario:test-scene", layers=[SMALL])
    record(tmp_path / "a.mcap", list(source.captures)[:2], source.config)
    plain, moved = (
        open_source(tmp_path / "a.mcap", layers=[{"camera": {"offset_m": m}, "clean": {"filter": "off"}}])
        for m in (0.0, 0.5)
    )
    a, b = (next(run(s.captures, s.config)).image.range_m for s in (plain, moved))
    assert np.nanmedian(b - a) == pytest.approx(0.5, abs=1e-3)


def test_other_tools_find_calibration_pose_images_boxes_and_numbers(tmp_path: Path) -> None:
    source = open_source("scenario:approach-box")
    frames = []
    with Recorder(tmp_path / "a.mcap", source.config, source.name) as recorder:
        for frame in run(source.captures, source.config, [recorder]):
            frames.append(frame)
            if any(frame.tracks.status == 1):
                break
    found: dict[str, list[Any]] = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            decoder = DecoderFactory().decoder_for(channel.message_encoding, schema)
            value = decoder(message.data) if decoder else json.loads(message.data)
            found.setdefault(channel.topic, []).append(value)
            if schema.encoding == "jsonschema":
                assert set(value) <= set(json.loads(schema.data)["properties"])
    last = frames[-1]
    image = found["/image/range"][-1]
    np.testing.assert_array_equal(
        np.frombuffer(image.data, "<f4").reshape(image.height, image.width), last.image.range_m
    )
    assert image.encoding == "32FC1"
    assert {t for t in found if t.startswith("/image/")} == {
        f"/image/{name}" for name in ("range", "sigma", "amplitude", "why")
    }
    segments, tracks = found["/objects"][-1].entities
    assert len(segments.cubes) == len(last.segments)
    assert len(tracks.cubes) == len(tracks.texts) == len(tracks.lines) == len(last.tracks)
    np.testing.assert_allclose(
        [tracks.cubes[0].pose.position.x, tracks.cubes[0].pose.position.y], last.tracks[0].position_m[:2]
    )
    row = found["/tracks"][-1]["tracks"][0]
    np.testing.assert_array_equal(row["state"], last.tracks.state[0])
    np.testing.assert_array_equal(row["covariance"], last.tracks.covariance[0])
    assert found["/decision"][-1]["reason"] == last.decision.reason
    assert found["/decision"][-1]["brake"] is last.decision.brake
    assert len(found["/decision"]) == len(found[MARKER]) == len(frames)


@pytest.mark.parametrize("shape", [(12, 16), (5, 9)])
def test_the_calibration_projects_the_ray_of_each_pixel_onto_it(shape: tuple[int, int], tmp_path: Path) -> None:
    mounting = {"x_m": 1.0, "z_m": 0.7, "pitch_deg": 20.0, "yaw_deg": -35.0, "roll_deg": 5.0}
    config = load_config("generic_cw", {"mounting": mounting})
    record(tmp_path / "a.mcap", captures_of(1, shape), config)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages(topics=["/camera/calibration", "/tf"]))
    (calibration,) = (m for _, channel, _, m in decoded if channel.topic == "/camera/calibration")
    body, optical = (m for _, channel, _, m in decoded if channel.topic == "/tf")
    turn_body, turn_optical = (
        Rotation.from_quat([t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w]) for t in (body, optical)
    )
    np.testing.assert_allclose(turn_body.as_matrix(), rotation(config.mounting), atol=1e-12)
    assert (body.parent_frame_id, body.child_frame_id) == ("vehicle", "camera")
    assert (optical.parent_frame_id, optical.child_frame_id) == ("camera", calibration.frame_id)
    assert (body.translation.x, body.translation.y, body.translation.z) == (1.0, 0.0, 0.7)
    seen = turn_optical.inv().apply(np.array(rays(config.camera.lens, shape)).reshape(-1, 3))
    for matrix, width in ((calibration.K, 3), (calibration.P, 4)):
        u, v, w = np.array(matrix).reshape(3, width)[:, :3] @ seen.T
        rows, columns = np.indices(shape)
        np.testing.assert_allclose(u / w, columns.ravel(), atol=1e-9)
        np.testing.assert_allclose(v / w, rows.ravel(), atol=1e-9)


def test_an_equiangular_lens_has_no_pinhole_matrix(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", captures_of(1), load_config("scaled_car"))
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        ((_, _, _, calibration),) = reader.iter_decoded_messages(topics=["/camera/calibration"])
    assert calibration.distortion_model == "equiangular"
    np.testing.assert_allclose(calibration.D, np.radians([80 / 4, 60 / 3]))
    assert not calibration.K


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> "Whole":
    folder = tmp_path_factory.mktemp("cut")
    captures = captures_of(4)
    path = record(folder / "whole.mcap", captures)
    return Whole(folder, path.read_bytes(), [key(capture) for capture in captures], chunk_ends(path))


class Whole(NamedTuple):
    """A recording of four frames: a folder to work in, its bytes, what is in each frame, and where each ends."""

    folder: Path
    content: bytes
    keys: list[str]
    ends: list[int]

    def __repr__(self) -> str:
        return "Whole(...)"


def check_cut(whole: Whole, length: int) -> None:
    """Check that the first `length` bytes of the file hold just the frames that lie in them."""
    folder, content, keys, ends = whole
    path = folder / "cut.mcap"
    path.write_bytes(content[:length])
    n = sum(end <= length for end in ends)
    if n == 0:
        with pytest.raises(DataError, match=r"no complete frame|not an MCAP file|empty|damaged"):
            open_source(path)
        with pytest.raises(DataError):
            repair(path, folder / "repaired.mcap")
        assert not (folder / "repaired.mcap").exists()
        return
    source = open_source(path)
    assert source.n_frames == n
    assert [key(capture) for capture in source.captures] == keys[:n]
    assert (len(source.notes) == 1) == (length < len(content))


def test_a_recording_cut_at_any_byte_opens_up_to_its_last_complete_frame(whole: Whole) -> None:
    _, content, _, ends = whole
    near = {end + d for end in (*ends, 0, len(content) - 60) for d in range(-12, 13)}
    for length in sorted({*near, *range(1, len(content), 97), *range(len(content) - 40, len(content) + 1)}):
        if 0 <= length <= len(content):
            check_cut(whole, length)


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1))
def test_a_recording_cut_anywhere_else_does_so_too(share: float, whole: Whole) -> None:
    check_cut(whole, round(share * len(whole[1])))


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 10**7), bit=st.integers(0, 7))
def test_a_flipped_bit_never_changes_a_sample_or_a_setting(place: int, bit: int, whole: Whole) -> None:
    folder, content, keys, _ = whole
    damaged = bytearray(content)
    damaged[place % len(content)] ^= 1 << bit
    path = folder / "flipped.mcap"
    path.write_bytes(damaged)
    found = []
    try:
        source = open_source(path)
        assert source.config == load_config("generic_cw")
        found += [key(capture) for capture in source.captures]
        assert len(found) == 4 or source.notes
    except DataError as error:
        assert "flipped.mcap" in str(error)  # noqa: PT017 (either outcome is right)
    assert found == [k for k in keys if k in found]


@settings(deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    places=st.lists(st.tuples(st.integers(0, 10**7), st.binary(min_size=1, max_size=20)), max_size=5),
    head=st.booleans(),
    content=st.binary(max_size=200),
)
def test_garbage_is_refused_or_read_but_never_crashes(
    places: list[tuple[int, bytes]], head: bool, content: bytes, whole: Whole
) -> None:
    folder, valid, keys, _ = whole
    damaged = bytearray(valid if places else (valid[:8] if head else b"") + content)
    for place, change in places:
        start = place % len(valid)
        damaged[start : start + len(change)] = change
    path = folder / "garbage.mcap"
    path.write_bytes(damaged)
    try:
        assert {key(capture) for capture in open_source(path).captures} <= set(keys)
        repair(path, folder / "repaired.mcap")
    except RangecamError as error:
        assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)


def test_frames_behind_a_damaged_one_are_not_lost(whole: Whole) -> None:
    folder, content, keys, ends = whole
    damaged = bytearray(content)
    damaged[ends[2] - 5] ^= 1
    path = folder / "damaged.mcap"
    path.write_bytes(damaged)
    source = open_source(path)
    with pytest.raises(DataError, match="damaged after 2 frames; rangecam repair"):
        list(source.captures)
    assert repair(path, folder / "repaired.mcap") == 3
    assert [key(capture) for capture in read(folder / "repaired.mcap")] == [keys[0], keys[1], keys[3]]


def test_a_frame_that_vanished_without_a_trace_is_missed(whole: Whole) -> None:
    folder, content, keys, ends = whole
    damaged = bytearray(content)
    start = content.index(b"zstd", ends[1]) - 8 - 8 - 8 - 4 - 4 - 9
    assert damaged[start] == 6  # a chunk
    damaged[start] = 0x70  # a record that readers pass over
    path = folder / "vanished.mcap"
    path.write_bytes(damaged)
    with pytest.raises(DataError, match="3 of 4 frames"):
        read(path)
    assert repair(path, folder / "found.mcap") == 3
    assert [key(capture) for capture in read(folder / "found.mcap")] == [keys[0], keys[1], keys[3]]


def test_repair_keeps_every_message_settings_and_index(whole: Whole) -> None:
    folder, content, _, ends = whole
    (folder / "half.mcap").write_bytes(content[: ends[1] + 7])
    assert repair(folder / "half.mcap", folder / "out.mcap") == 2
    again = open_source(folder / "out.mcap")
    assert (again.n_frames, again.notes) == (2, ())
    assert again.config == load_config("generic_cw")
    with (folder / "out.mcap").open("rb") as a, io.BytesIO(content) as b:
        one, two = (list(make_reader(file).iter_messages(log_time_order=False)) for file in (a, b))
    assert [(c.topic, m.data, m.log_time) for _, c, m in one] == [
        (c.topic, m.data, m.log_time) for _, c, m in two[: len(one)]
    ]
    assert repair(folder / "out.mcap", folder / "again.mcap") == 2
    assert sorted(p.name for p in folder.iterdir() if p.name.startswith(".")) == []


def test_repair_refuses_what_it_cannot_read_or_write(whole: Whole, tmp_path: Path) -> None:
    path = whole[0] / "whole.mcap"
    for source, out, words in (
        (tmp_path / "none.mcap", tmp_path / "b.mcap", "no such file"),
        (tmp_path, tmp_path / "b.mcap", "not a file"),
        (path, path, "another file"),
        (path, tmp_path / "x" / "b.mcap", "does not exist"),
        (path, tmp_path, "folder"),
    ):
        with pytest.raises(UsageError, match=words):
            repair(source, out)


def foreign(path: Path, profile: str, metadata: dict[str, str] | None = None, messages: tuple[Any, ...] = ()) -> Path:
    """Write an MCAP file with others' means."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile=profile)
        if metadata is not None:
            writer.add_metadata("rangecam", metadata)
        for topic, data in messages:
            schema = writer.register_schema("x", "jsonschema", b"{}")
            writer.add_message(writer.register_channel(topic, "json", schema), 0, data, 0)
        writer.finish()
    return path


def facts(path: Path) -> dict[str, str]:
    with path.open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    return metadata.metadata


def test_a_foreign_mcap_file_is_named_as_such(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="not a recording of rangecam's"):
        open_source(foreign(tmp_path / "a.mcap", "ros1"))


def test_a_file_that_is_no_mcap_file_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("this is text")
    with pytest.raises(DataError, match="not an MCAP file"):
        open_source(tmp_path / "a.mcap")


def test_a_recording_of_another_layout_is_refused_with_both_versions(whole: Whole, tmp_path: Path) -> None:
    changed = {**facts(whole[0] / "whole.mcap"), "layout": "2", "version": "9.9"}
    with pytest.raises(DataError, match=r"rangecam 9\.9 in layout 2; this version reads layout 1"):
        open_source(foreign(tmp_path / "a.mcap", "rangecam", changed))


def test_damaged_settings_are_noticed(whole: Whole, tmp_path: Path) -> None:
    known = facts(whole[0] / "whole.mcap")
    changed = {**known, "settings": known["settings"].replace('"phase_sign": 1', '"phase_sign":-1')}
    assert changed != known
    with pytest.raises(DataError, match="settings are damaged"):
        open_source(foreign(tmp_path / "a.mcap", "rangecam", changed))


def test_a_whole_file_without_a_frame_is_refused(whole: Whole, tmp_path: Path) -> None:
    known = facts(whole[0] / "whole.mcap")
    with pytest.raises(DataError, match="no complete frame"):
        open_source(foreign(tmp_path / "a.mcap", "rangecam", known))
    with pytest.raises(DataError, match="damaged after 0 frames"):
        read(foreign(tmp_path / "b.mcap", "rangecam", known, ((MARKER, b"{}"),)))


BAD_IMAGE = RawImage(width=3, height=2, encoding="mono8", data=b"12345").SerializeToString()
OBJECTS = RawImage(width=1, height=1, encoding="numpy:O", data=b"12345678").SerializeToString()
UNKNOWN = RawImage(width=1, height=1, encoding="rgb8", data=b"123").SerializeToString()
EGO = b'{"time_s": 0, "yaw_rate_radps": 0, "forward": true}'
BAD_FRAMES: dict[str, tuple[dict[str, bytes], str]] = {
    "no planes": ({"/ego": EGO}, "no raw plane"),
    "a plane of the wrong size": ({"/raw/a": BAD_IMAGE, "/ego": EGO}, "/raw/a"),
    "a plane of objects": ({"/raw/a": OBJECTS, "/ego": EGO}, "/raw/a"),
    "a plane of an unknown encoding": ({"/raw/a": UNKNOWN, "/ego": EGO}, "/raw/a"),
    "a plane that is none": ({"/raw/a": b"\xff\xff\xff", "/ego": EGO}, "/raw/a"),
    "no ego": ({"/raw/a": image_message(np.ones((2, 2)), 0.0).SerializeToString()}, "/ego"),
    "an ego of words": ({"/raw/a": image_message(np.ones((2, 2)), 0.0).SerializeToString(), "/ego": b"[]"}, "/ego"),
    "half a truth": (
        {"/raw/a": image_message(np.ones((2, 2)), 0.0).SerializeToString(), "/ego": EGO, "/truth": b'{"names": 1}'},
        "/truth",
    ),
}


@pytest.mark.parametrize("name", BAD_FRAMES)
def test_a_frame_that_somebody_else_wrote_wrongly_is_named_with_its_topic(
    name: str, whole: Whole, tmp_path: Path
) -> None:
    messages, word = BAD_FRAMES[name]
    marker = json.dumps({"frame_id": 0, "time_s": 0.0, "topics": list(messages)}).encode()
    known = facts(whole[0] / "whole.mcap")
    path = foreign(tmp_path / "a.mcap", "rangecam", known, (*messages.items(), (MARKER, marker)))
    with pytest.raises(DataError, match=f"frame 0: .*{word}"):
        read(path)


def test_the_file_appears_with_the_first_frame_and_holds_each_frame_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Recorder(path, load_config("generic_cw")) as recorder:
        assert not path.exists()
        for n, capture in enumerate(captures_of(3), 1):
            recorder.write(capture)
            source = open_source(path)
            assert source.n_frames == n
            assert "still being written" in source.notes[0]
    assert open_source(path).notes == ()


def test_nothing_is_left_of_a_recorder_that_got_no_frame(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", load_config("generic_cw")):
        pass
    assert not list(tmp_path.iterdir())


def test_an_error_elsewhere_leaves_a_whole_recording_of_the_frames_before(tmp_path: Path) -> None:
    def record_two_and_fail() -> None:
        with Recorder(tmp_path / "a.mcap", load_config("generic_cw")) as recorder:
            for capture in captures_of(2):
                recorder.write(capture)
            raise ValueError("elsewhere")

    with pytest.raises(ValueError, match="elsewhere"):
        record_two_and_fail()
    assert open_source(tmp_path / "a.mcap").n_frames == 2
    assert open_source(tmp_path / "a.mcap").notes == ()


def test_a_recorder_refuses_at_once_what_it_cannot_write(whole: Whole, tmp_path: Path) -> None:
    config = load_config("generic_cw")
    for path, source, words in (
        (tmp_path / "x" / "a.mcap", "", "does not exist"),
        (tmp_path, "", "folder"),
        (whole[0] / "whole.mcap", str(whole[0] / "whole.mcap"), "another file"),
    ):
        with pytest.raises(UsageError, match=words):
            Recorder(path, config, source)


CHILD = """
import sys, itertools
sys.path.insert(0, {tests!r})
from test_io_mcap import captures_of
from rangecam.config import load_config
from rangecam.io import Recorder
import resource
if {limit}:
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
with Recorder({path!r}, load_config("generic_cw")) as recorder:
    for n, capture in enumerate(itertools.cycle(captures_of(4))):
        recorder.write(capture)
        print(n + 1, flush=True)
"""


def test_a_killed_process_leaves_every_frame_that_it_had_recorded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    code = CHILD.format(tests=str(Path(__file__).parent), path=str(path), limit=0)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        for line in child.stdout:
            if int(line) >= 30:
                break
        child.send_signal(signal.SIGKILL)
        last = [int(line), *(int(rest) for rest in child.stdout.read().split())][-1]
    source = open_source(path)
    captures = list(source.captures)
    assert source.n_frames == len(captures)
    assert last <= len(captures) <= last + 1
    wanted = captures_of(4)
    assert all(same(capture, wanted[n % 4]) for n, capture in enumerate(captures))


def test_a_full_disk_leaves_every_frame_that_found_room(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    code = CHILD.format(tests=str(Path(__file__).parent), path=str(path), limit=100_000)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "OSError" in done.stderr or "FileTooLarge" in done.stderr
    n = int(done.stdout.split()[-1])
    source = open_source(path)
    assert source.n_frames == len(list(source.captures))
    assert n <= source.n_frames <= n + 1
    assert "cut off" in source.notes[0]


def test_a_full_disk_at_the_very_end_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "a.mcap", load_config("generic_cw"))
    recorder.write(captures_of(1)[0])

    def full(self: Writer) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "finish", full)
    with pytest.raises(OSError, match="No space left"):
        recorder.close()
    recorder.close()
    assert len(read(tmp_path / "a.mcap")) == 1
