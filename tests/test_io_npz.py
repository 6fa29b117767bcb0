"""NumPy files: which keys make which planes, and what is said of a file that cannot be."""

import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from rangecam.config import preset_names, preset_tree
from rangecam.errors import DataError, RangecamError
from rangecam.io import open_source
from rangecam.io.npz import FACTS, FORMATS, Format
from rangecam.pipeline import RANGING, run

DATA = os.environ.get("RANGECAM_DATA")
STEPS = (0, 90, 180, 270)


def phases(shape: tuple[int, ...] = (4, 6), **changes: Any) -> dict[str, Any]:
    """Return the keys of a small raw recording, with some changed or, being None, left out."""
    keys: dict[str, Any] = {f"phase_{step}": np.full(shape, step, np.float32) for step in STEPS}
    return {key: value for key, value in {**keys, "modulation_hz": 20e6, **changes}.items() if value is not None}


def ranges(shape: tuple[int, ...] = (3, 4, 6), **changes: Any) -> dict[str, Any]:
    """Return the keys of a few range images, with some changed."""
    return {"range_m": np.linspace(1, 2, int(np.prod(shape))).reshape(shape), **changes}


def save(path: Path, keys: Mapping[str, Any]) -> Path:
    np.savez(path, **keys)
    return path


def example(format_: Format, n: int) -> dict[str, Any]:
    """Return a file of a format with n frames, in which every image is filled with its frame's number plus one."""
    shape = (n, *(format_.shape or (4, 6)))
    numbers = np.arange(1, n + 1, dtype=np.int16)[:, None, None] * np.ones(shape, np.int16)
    return dict.fromkeys((*format_.needs, *format_.takes), numbers) | dict.fromkeys(format_.asks, 1e7)


@pytest.mark.parametrize("format_", FORMATS, ids=lambda f: "-".join(f.needs))
def test_every_format_is_recognised_and_decoded_by_the_preset_that_it_suggests(format_: Format, tmp_path: Path) -> None:
    source = open_source(save(tmp_path / "a.npz", example(format_, 2)))
    assert source.config.preset == format_.preset
    assert source.config.camera.kind == format_.kind
    frames = list(source.captures)
    assert source.n_frames == len(frames) == 2
    rows, columns = format_.shape or (4, 6)
    assert (source.config.camera.rows, source.config.camera.columns) == (rows, columns)
    for key, plane in {**format_.needs, **format_.takes}.items():
        scale = 1000 if key.endswith("_mm") else 1
        for k, capture in enumerate(frames):
            np.testing.assert_allclose(capture.raw.planes[plane], (k + 1) / scale, rtol=1e-6)
    assert [capture.raw.frame_id for capture in frames] == [0, 1]
    assert len(list(run(frames, source.config))) == 2


@pytest.mark.parametrize("format_", FORMATS, ids=lambda f: "-".join(f.needs))
def test_every_suggested_preset_exists_and_is_for_the_family(format_: Format) -> None:
    assert format_.preset in preset_names()
    assert preset_tree(format_.preset)["camera"]["kind"] == format_.kind


def test_one_image_is_one_frame(tmp_path: Path) -> None:
    source = open_source(save(tmp_path / "a.npz", phases()))
    (capture,) = source.captures
    assert capture.raw.shape == (4, 6)
    assert capture.raw.time_s == 0.0
    assert source.notes == ()
    assert capture.ego.speed_mps is None
    assert capture.truth is None


def test_a_key_of_range_is_not_taken_for_depth(tmp_path: Path) -> None:
    for key, plane in (
        ("range_m", "range_m"),
        ("depth_m", "depth_m"),
        ("range_mm", "range_m"),
        ("depth_mm", "depth_m"),
    ):
        source = open_source(save(tmp_path / "a.npz", {key: np.full((4, 6), 1500)}))
        (capture,) = source.captures
        assert set(capture.raw.planes) == {plane}
        np.testing.assert_allclose(capture.raw.planes[plane], 1.5 if key.endswith("_mm") else 1500)


def test_times_are_those_of_the_file_or_follow_the_frame_rate(tmp_path: Path) -> None:
    timed = open_source(save(tmp_path / "a.npz", ranges(time_s=[1.0, 1.5, 1.5])))
    assert [capture.raw.time_s for capture in timed.captures] == [1.0, 1.5, 1.5]
    assert timed.notes == ()
    plain = open_source(save(tmp_path / "b.npz", ranges()), layers=[{"camera": {"frame_rate_hz": 8.0}}])
    assert [capture.raw.time_s for capture in plain.captures] == [0.0, 0.125, 0.25]
    assert "frame_rate_hz" in plain.notes[0]


def test_the_time_of_a_single_frame_may_be_a_single_number(tmp_path: Path) -> None:
    (capture,) = open_source(save(tmp_path / "a.npz", phases(time_s=2.5))).captures
    assert capture.raw.time_s == 2.5


def test_keys_that_are_not_used_are_named(tmp_path: Path) -> None:
    (note,) = open_source(save(tmp_path / "a.npz", phases(camera_amplitude=np.zeros(3), **{"vicon": 1}))).notes
    assert "camera_amplitude, vicon" in note


@pytest.mark.parametrize("key", ["camera_range_m", "reference_range_m"])
def test_ranges_by_the_camera_itself_or_another_instrument_stand_beside_the_samples(tmp_path: Path, key: str) -> None:
    images = phases()
    known_m = np.arange(images["phase_0"].size).reshape(images["phase_0"].shape) / 8
    (capture,) = open_source(save(tmp_path / "a.npz", {**images, key: known_m})).captures
    np.testing.assert_array_equal(capture.raw.planes["reference_range_m"], known_m)


def test_of_many_unused_keys_a_few_are_named(tmp_path: Path) -> None:
    (note,) = open_source(save(tmp_path / "a.npz", phases(**{f"more_{i}": 1 for i in range(20)}))).notes
    assert "more_11 and 8 more" in note


def test_one_dark_image_serves_all_frames(tmp_path: Path) -> None:
    taps = {f"tap_{i}": np.full((3, 4, 6), 100.0 * i) for i in (1, 2, 3)}
    dark = {f"dark_{i}": np.full((4, 6), 7.0) for i in (1, 2, 3)}
    captures = list(open_source(save(tmp_path / "a.npz", {**taps, **dark, "pulse_width_s": 2e-8})).captures)
    assert len(captures) == 3
    assert all((capture.raw.planes["dark_3"] == 7).all() for capture in captures)


FACT_VALUES = {
    "modulation_hz": 12e6,
    "phase_sign": -1,
    "pulse_width_s": 4e-8,
    "gate_width_s": 3e-8,
    "pulse_lead_s": 1e-9,
}


@pytest.mark.parametrize("key", FACTS)
def test_every_fact_becomes_a_setting_of_the_camera(key: str, tmp_path: Path) -> None:
    taps = {f"tap_{i}": np.full((4, 6), 100) for i in (1, 2, 3)}
    keys = phases() if key in {"modulation_hz", "phase_sign"} else taps
    for value in (FACT_VALUES[key], np.array([FACT_VALUES[key]])):
        source = open_source(save(tmp_path / "a.npz", {**keys, key: value}))
        assert getattr(source.config.camera, FACTS[key].setting) == FACT_VALUES[key]


def test_planes_keep_their_type_but_not_a_foreign_byte_order(tmp_path: Path) -> None:
    for kind, wanted in (("<i2", "<i2"), (">u2", "<u2"), (">f4", "<f4"), ("u1", "|u1"), ("f8", "<f8")):
        keys = {f"phase_{step}": np.arange(24, dtype=kind).reshape(4, 6) for step in STEPS}
        (capture,) = open_source(save(tmp_path / "a.npz", {**keys, "modulation_hz": 1e7})).captures
        assert capture.raw.planes["phase_0"].dtype.str == wanted
        np.testing.assert_array_equal(capture.raw.planes["phase_0"].ravel(), np.arange(24))


def test_planes_are_contiguous_however_they_were_saved(tmp_path: Path) -> None:
    keys = {f"phase_{step}": np.asfortranarray(np.arange(24.0).reshape(4, 6)) for step in STEPS}
    (capture,) = open_source(save(tmp_path / "a.npz", {**keys, "modulation_hz": 1e7})).captures
    assert capture.raw.planes["phase_0"].flags.c_contiguous
    assert capture.raw.planes["phase_0"][1, 0] == 6


def test_a_compressed_file_is_read_too(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", **phases())
    assert open_source(tmp_path / "a.npz").n_frames == 1


def test_missing_measurements_of_a_processed_image_are_pixels_not_errors(tmp_path: Path) -> None:
    range_m = np.full((4, 6), 2.0)
    range_m[0, 0] = np.nan
    source = open_source(save(tmp_path / "a.npz", {"range_m": range_m}), layers=[{"clean": {"filter": "off"}}])
    (frame,) = run(source.captures, source.config)
    assert frame.image.why[0, 0] != 0


BAD: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "a phase is missing": (phases(phase_270=None), ("continuous-wave", "need phase_270,", "is missing", "phase_0")),
    "phases and frequency are missing": (phases(phase_0=None, modulation_hz=None), ("phase_0, modulation_hz", "are")),
    "a tap is missing": ({"tap_1": np.ones((2, 2)), "tap_2": np.ones((2, 2))}, ("three-tap", "tap_3")),
    "nothing known": ({"hist": np.ones((2, 2)), "conf": 1}, ("hist, conf", "range_mm", "phase_0 phase_90")),
    "nothing at all": ({}, ("nothing",)),
    "different shapes": (phases(phase_90=np.zeros((4, 5))), ("phase_90", "(4, 5)", "phase_0", "(4, 6)")),
    "frames and a single image": (phases(phase_90=np.zeros((2, 4, 6))), ("phase_90", "(2, 4, 6)")),
    "status of another shape": (ranges(status=np.zeros((4, 6))), ("status", "(4, 6)", "(3, 4, 6)")),
    "a vector": (phases(shape=(5,)), ("phase_0", "(5,)", "(H, W)")),
    "four axes": (phases(shape=(1, 1, 2, 2)), ("phase_0", "(1, 1, 2, 2)")),
    "no frames": (phases(shape=(0, 4, 6)), ("phase_0", "no frame")),
    "no pixels": (phases(shape=(0, 6)), ("phase_0", "no frame")),
    "NaN samples": (phases(phase_90=np.full((4, 6), np.nan)), ("phase_90", "NaN", "24 of 24")),
    "one infinite sample": (phases(phase_90=np.where(np.eye(4, 6), np.inf, 1)), ("phase_90", "infinity", "4 of 24")),
    "nothing but NaN": (ranges(range_m=np.full((2, 4, 6), np.nan)), ("range_m", "nothing but NaN")),
    "words": (phases(phase_0=np.full((4, 6), "a")), ("phase_0", "<U1", "numbers")),
    "complex numbers": (phases(phase_0=np.ones((4, 6), complex)), ("phase_0", "complex", "numbers")),
    "pickled objects": (phases(phase_0=np.full((4, 6), None)), ("phase_0", "cannot be read")),
    "frequency of zero": (phases(modulation_hz=0.0), ("modulation_hz is 0", "greater than 0")),
    "negative frequency": (phases(modulation_hz=-2e7), ("modulation_hz is -2e+07", "greater than 0")),
    "frequency NaN": (phases(modulation_hz=np.nan), ("modulation_hz is nan",)),
    "infinite frequency": (phases(modulation_hz=np.inf), ("modulation_hz is inf",)),
    "two frequencies": (phases(modulation_hz=[1e7, 2e7]), ("modulation_hz", "(2,)", "one number")),
    "a word for the frequency": (phases(modulation_hz="20 MHz"), ("modulation_hz", "numbers")),
    "sign of two": (phases(phase_sign=2), ("phase_sign is 2", "1 or -1")),
    "too few times": (ranges(time_s=[0.0, 1.0]), ("time_s", "(2,)", "3 frames")),
    "times of many axes": (ranges(time_s=np.zeros((3, 1))), ("time_s", "(3, 1)")),
    "times that fall": (
        ranges(time_s=[0.0, 1.0, 0.5]),
        ("time_s", "decrease", "frame 2 is at 0.5 s", "1.0 s"),
    ),
    "times NaN": (ranges(time_s=[0.0, np.nan, 0.5]), ("time_s", "NaN")),
}


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_cannot_be_is_refused_in_one_line_that_names_the_fault(name: str, tmp_path: Path) -> None:
    keys, words = BAD[name]
    with pytest.raises(DataError) as caught:
        open_source(save(tmp_path / "a.npz", keys))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'a.npz'}: ")
    assert "\n" not in message
    for word in words:
        assert word in message


def as_text(path: Path) -> None:
    path.write_text("time,range\n1,2\n")


def as_array(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


def as_zip_of_text(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("range_m", "none")


def with_junk_before(path: Path) -> None:
    path.write_bytes(b"junk" + save(path, phases()).read_bytes())


def cut(path: Path) -> None:
    path.write_bytes(save(path, phases()).read_bytes()[:-30])


@pytest.mark.parametrize("spoil", [as_text, as_array, as_zip_of_text, with_junk_before, cut])
def test_what_is_no_numpy_archive_is_refused(spoil: Any, tmp_path: Path) -> None:
    spoil(tmp_path / "a.npz")
    with pytest.raises(DataError, match=r"a\.npz: "):
        open_source(tmp_path / "a.npz")


@pytest.fixture(scope="module")
def valid_bytes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    folder = tmp_path_factory.mktemp("fuzz")
    return folder, save(folder / "a.npz", phases(shape=(2, 4, 6), time_s=[0.0, 1.0])).read_bytes()


def open_all(path: Path) -> Iterator[Any]:
    """Open a file and read its frames to the end."""
    yield from open_source(path).captures


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), min_size=1, max_size=4))
def test_damaged_bytes_are_refused_or_read_but_never_crash(
    flips: list[tuple[int, int]], valid_bytes: tuple[Path, bytes]
) -> None:
    folder, content = valid_bytes
    damaged = bytearray(content)
    for place, change in flips:
        damaged[place % len(damaged)] ^= change
    (folder / "b.npz").write_bytes(damaged)
    try:
        assert len(list(open_all(folder / "b.npz"))) > 0
    except RangecamError as error:
        assert "b.npz" in str(error)  # noqa: PT017 (either outcome is right)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(min_size=1, max_size=300))
def test_random_bytes_are_refused(content: bytes, valid_bytes: tuple[Path, bytes]) -> None:
    path = valid_bytes[0] / "c.npz"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"c\.npz"):
        open_source(path)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    array=npst.arrays(
        st.sampled_from(["u1", "i2", "u2", "i4", "f4", "f8", "?", "U3", "c8", "M8[s]", "f2"]),
        npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
    ),
    key=st.sampled_from(["phase_90", "modulation_hz", "time_s", "phase_sign"]),
)
def test_any_array_in_any_place_is_taken_or_refused(
    array: np.ndarray[Any, Any], key: str, valid_bytes: tuple[Path, bytes]
) -> None:
    path = save(valid_bytes[0] / "d.npz", phases(shape=(3, 3), **{key: array}))
    try:
        assert len(list(open_all(path))) == 1
    except DataError as error:
        assert key in str(error) or "phase_0" in str(error)  # noqa: PT017 (either outcome is right)


REAL = {
    "cw_mlx75027/tools_scene.npz": ("generic_cw", 1, (385, 640)),
    "pulsed_bec80t/clear_standard.npz": ("generic_pulsed", 1, (248, 328)),
    "pulsed_bec80t/clear_early.npz": ("generic_pulsed", 1, (248, 328)),
    "vl53l5cx_flights/A0.npz": ("vl53l5cx", 339, (8, 8)),
    "vl53l5cx_flights/O17.npz": ("vl53l5cx", 1463, (8, 8)),
    "terabee_overhead/two_people_cross.npz": ("terabee_overhead", 107, (60, 80)),
    "adtf3175/person_mode2.npz": ("adtf3175", 1, (512, 512)),
    "ifm_o3r/frame.npz": ("ifm_o3r", 1, (172, 224)),
    "azure_kinect/nfov.npz": ("azure_kinect", 1, (576, 640)),
}


@pytest.mark.parametrize("name", REAL)
@pytest.mark.skipif(DATA is None, reason="RANGECAM_DATA does not name the folder of real recordings")
def test_real_recordings_open_with_the_preset_of_their_camera(name: str) -> None:
    preset, n_frames, shape = REAL[name]
    source = open_source(Path(str(DATA)) / name)
    assert source.config.preset == preset
    assert source.n_frames == sum(1 for _ in source.captures) == n_frames
    shares = []
    for capture in list(source.captures)[::50]:
        assert capture.raw.shape == shape
        image = RANGING[source.config.ranging](capture.raw, source.config.camera)
        shares.append(image.valid.mean())
        assert (image.range_m[image.valid] < 12).all()
        assert (image.sigma_m[image.valid] > 0).all()
    assert np.mean(shares) > 0.2


@pytest.mark.skipif(DATA is None, reason="RANGECAM_DATA does not name the folder of real recordings")
def test_a_real_recording_of_histograms_is_refused_by_its_keys() -> None:
    with pytest.raises(DataError, match="hist"):
        open_source(Path(str(DATA)) / "tmf8820_planes" / "planes.npz")
