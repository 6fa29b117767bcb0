"""The UDP stream: bytes on the wire, frames put together from them, sockets, and the command line around both."""

import json
import random
import re
import signal
import socket
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rangecam import pipeline
from rangecam.cli import main
from rangecam.config import Config, load_config
from rangecam.errors import DataError, UsageError
from rangecam.io import open_source
from rangecam.io.udp import MODES, Stream, open_udp, paced
from rangecam.io.udp.address import parse_address
from rangecam.io.udp.assembly import Assembler, PlainAssembler, Received
from rangecam.io.udp.modes import NO_RANGE_MM, capture_of, differing, plain_capture, static_words, words_of
from rangecam.io.udp.packets import (
    OVERHEAD_BYTES,
    PACKET_BYTES,
    encode,
    frame_packets,
    payload_mbit,
    read_control,
    read_start,
    read_text,
    text_packet,
    wire_mbit,
)
from rangecam.io.udp.receiver import KEPT, Receiver
from rangecam.types import Capture, Ego, Image, RawFrame

THESIS = (120, 160)
WORDS = ({"time_s": 0.5}, {"speed_mps": 1.25}, {}, {})


def images_of(count: int, shape: tuple[int, int] = THESIS, seed: int = 0) -> list[Image]:
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 4096, shape, dtype=np.uint16) for _ in range(count)]


def assembled(packets: list[bytes], assembler: Any = None) -> list[Received]:
    assembler = assembler or Assembler()
    found = [received for packet in packets if (received := assembler.take(packet)) is not None]
    assembler.close()
    return found


# -- bytes -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("images", "packets", "payload", "wire"),
    [(4, 394, 37.82, 44.06), (2, 200, 19.20, 22.37), (1, 103, 9.89, 11.52), (0, 6, 0.58, 0.67)],
)
def test_n_s_009_packets_and_data_rates_of_the_modes(images: int, packets: int, payload: float, wire: float) -> None:
    sent = encode(0, WORDS, images_of(images))
    assert len(sent) == frame_packets(images) == packets
    assert {len(packet) for packet in sent} == {PACKET_BYTES} == {400}
    assert payload_mbit(packets, 30.0) == pytest.approx(payload, abs=5e-3)
    assert wire_mbit(packets, 30.0) == pytest.approx(wire, abs=5e-3)
    assert OVERHEAD_BYTES == 8 + 20 + (14 + 4 + 8 + 12)


def test_n_s_007_and_008_bytes_of_phase_images_and_their_rates() -> None:
    images = images_of(4)
    assert [image.nbytes for image in images] == [38400] * 4
    total = sum(image.nbytes for image in images)
    assert total == 153600
    for rate_hz, mbit in ((10, 12.288), (20, 24.576), (30, 36.864), (40, 49.152)):
        assert payload_mbit(total // PACKET_BYTES, rate_hz) == pytest.approx(mbit)


def test_a_frame_has_the_words_and_the_order_of_the_thesis() -> None:
    images = images_of(2)
    packets = encode(7, WORDS, images)
    assert packets[0][:8] == bytes.fromhex("46524D5F53545254")
    assert packets[-1][:8] == bytes.fromhex("46524D5F53544F50")
    assert packets[5][:5] == bytes.fromhex("494D475F30")
    assert packets[5 + 97][:5] == b"IMG_1"
    assert b"".join(packets[6:102]) == images[0].astype("<u2").tobytes()
    assert b"".join(packets[103:199]) == images[1].astype("<u2").tobytes()
    assert [read_text(packet) for packet in packets[1:5]] == list(WORDS)


def test_samples_are_little_endian_whatever_the_machine_has() -> None:
    packets = encode(0, WORDS, [np.array([[0x0102, 0x0304]], ">u2")])
    assert packets[6][:4] == bytes.fromhex("02010403")


@pytest.mark.parametrize("dtype", ["u2", "i2", "f4", "f8", "u1", "i4", "u4", "i1", "i8", "u8", "?"])
@pytest.mark.parametrize("shape", [(1, 1), (8, 64), (120, 160), (7, 333), (300, 400)])
def test_every_image_comes_back_bit_for_bit_in_strips_where_it_is_larger(dtype: str, shape: tuple[int, int]) -> None:
    bytes_ = np.random.default_rng(1).integers(0, 256, shape[0] * shape[1] * np.dtype(dtype).itemsize, dtype=np.uint8)
    image = (bytes_ & 1).astype(bool).reshape(shape) if dtype == "?" else bytes_.view(dtype).reshape(shape)
    (received,) = assembled(encode(3, WORDS, [image, image[::-1]]))
    assert received.number == 3
    for got, sent in zip(received.images, (image, image[::-1]), strict=True):
        assert got.tobytes() == np.ascontiguousarray(sent).tobytes()
        assert got.shape == shape
        assert got.dtype == (np.uint8 if dtype == "?" else np.dtype(dtype))


@pytest.mark.parametrize(
    ("images", "words"),
    [
        ([np.zeros((2, 2), complex)], "complex128 cannot be streamed; possible are uint16"),
        ([np.zeros((0, 4), np.uint16)], "image of 0 rows"),
        ([np.zeros((1, 20000), np.uint16)], "1 rows of 20000"),
        ([np.zeros((480, 640), np.float32)] * 4, "do not fit into a frame"),
    ],
)
def test_images_that_cannot_travel_are_refused(images: list[Image], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        encode(0, WORDS, images)


def test_text_that_is_too_long_or_no_object_is_refused() -> None:
    with pytest.raises(UsageError, match="do not fit into a packet of 400"):
        text_packet({"long": "x" * 400})
    for packet in (b"\xff" * 400, b"[1]".ljust(400, b"\0"), b"[" * 400, b"\0" * 400):
        with pytest.raises(DataError, match="no JSON"):
            read_text(packet)


def test_a_start_with_a_wrong_checksum_or_impossible_number_announces_nothing() -> None:
    start = encode(5, WORDS, images_of(1))[0]
    assert read_start(start) is not None
    assert read_start(start[:50] + bytes([start[50] ^ 1]) + start[51:]) is None
    forged = bytearray(start)
    forged[14:16] = (5000).to_bytes(2, "little")
    forged[-4:] = zlib.crc32(forged[:-4]).to_bytes(4, "little")
    assert read_start(bytes(forged)) is None
    with pytest.raises(DataError, match="not a control packet"):
        read_control(b"IMG_0" + b"\xff" * 395)


# -- frames from packets -----------------------------------------------------------------------------------------------


def numbers(received: list[Received]) -> list[int]:
    return [each.number for each in received]


def stream_of(count: int, shape: tuple[int, int] = (8, 64)) -> list[list[bytes]]:
    return [encode(k, ({"time_s": k / 30}, {}, {}, {}), images_of(2, shape, k)) for k in range(count)]


def test_frames_are_put_together_from_any_order_of_their_packets() -> None:
    for seed in range(5):
        frames = stream_of(4)
        for packets in frames:
            random.Random(seed).shuffle(packets)
        received = assembled([packet for packets in frames for packet in packets])
        assert numbers(received) == [0, 1, 2, 3]
        for k, each in enumerate(received):
            for got, sent in zip(each.images, images_of(2, (8, 64), k), strict=True):
                np.testing.assert_array_equal(got, sent)


def test_an_image_shuffled_in_full_size_comes_back() -> None:
    packets = encode(0, WORDS, images_of(4))
    random.Random(3).shuffle(packets)
    (received,) = assembled(packets)
    np.testing.assert_array_equal(received.images, images_of(4))


@pytest.mark.parametrize("lost", range(4))
def test_a_frame_that_lacks_any_packet_is_counted_and_never_given(lost: int) -> None:
    frames = stream_of(4)
    place = (0, 2, 7, len(frames[1]) - 1)[lost]
    del frames[1][place]
    assembler = Assembler()
    received = assembled([packet for packets in frames for packet in packets], assembler)
    assert numbers(received) == [0, 2, 3]
    if lost:
        assert (assembler.counts.incomplete, assembler.counts.missing) == (1, 1)
    else:  # without its beginning nobody knows of it
        assert assembler.counts.unexpected == len(frames[1])


def test_a_duplicate_of_every_packet_changes_nothing() -> None:
    frames = stream_of(3)
    assembler = Assembler()
    received = assembled([packet for packets in frames for one in packets for packet in (one, one)], assembler)
    assert numbers(received) == [0, 1, 2]
    assert assembler.counts.unexpected == sum(map(len, frames))
    assert assembler.counts.incomplete == 0


def test_what_one_frame_lost_is_not_taken_from_the_next() -> None:
    dark = [np.zeros((8, 64), np.uint16)] * 2
    frames = [encode(k, ({"time_s": k}, {}, {}, {}), dark) for k in range(6)]
    del frames[1][7]
    received = assembled([packet for packets in frames for packet in packets])
    assert numbers(received) == [0, 2, 3, 4, 5]


def test_the_end_of_a_frame_may_come_after_the_beginning_of_the_next() -> None:
    first, second = stream_of(2)
    assert numbers(assembled([*first[:-2], *second[:5], *first[-2:], *second[5:]])) == [0, 1]
    assert numbers(assembled([*first[:-2], *second, *first[-2:]])) == [1]


def test_samples_that_look_like_control_packets_are_samples() -> None:
    stolen = encode(9, WORDS, images_of(1, (8, 64), 5))
    wicked = b"".join([stolen[0], b"IMG_1".ljust(400, b"\0"), b"FRM_STOP".ljust(400, b"\0"), *stolen])[:38400]
    image = np.frombuffer(wicked.ljust(38400, b"F"), np.uint16).reshape(THESIS)
    (received,) = assembled(encode(0, WORDS, [image]))
    np.testing.assert_array_equal(received.images[0], image)
    plain = assembled(encode(0, WORDS, [image]), PlainAssembler([THESIS]))
    np.testing.assert_array_equal(plain[0].images[0], image)


def test_a_flipped_bit_loses_the_frame_and_nothing_else() -> None:
    frames = stream_of(3)
    broken = bytearray(frames[1][8])
    broken[100] ^= 4
    frames[1][8] = bytes(broken)
    assembler = Assembler()
    assert numbers(assembled([p for packets in frames for p in packets], assembler)) == [0, 2]
    assert (assembler.counts.incomplete, assembler.counts.unexpected) == (1, 1)


def forged(packets: list[bytes], control: bytes) -> list[bytes]:
    """The frame with another control packet, announced as if it belonged there."""
    start = bytearray(packets[0])
    at = 20 + 5 * 4
    start[at : at + 4] = zlib.crc32(control).to_bytes(4, "little")
    start[-4:] = zlib.crc32(start[:-4]).to_bytes(4, "little")
    return [bytes(start), *packets[1:5], control, *packets[6:]]


def test_announced_nonsense_makes_no_frame() -> None:
    packets = encode(0, WORDS, images_of(1, (8, 64)))
    for where, value in ((5, 99), (12, 1), (10, 7), (0, 0)):  # type, number of the image, checksum of the strip, word
        control = bytearray(packets[5])
        control[where] = value
        assembler = Assembler()
        assert not assembled(forged(packets, bytes(control)), assembler)
        assert assembler.counts.incomplete == 1


def test_frames_given_up_make_room_for_others() -> None:
    frames = stream_of(5)
    assembler = Assembler()
    assert not assembled([packets[0] for packets in frames], assembler)
    assert assembler.counts.incomplete == 5


def test_a_sender_that_begins_again_is_heard_again() -> None:
    again = [packet for packets in stream_of(12) for packet in packets]
    assert numbers(assembled(again + again)) == [*range(12), *range(12)]


_FRAMES = stream_of(3)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_whatever_the_network_does_only_frames_that_were_sent_come_out(data: st.DataObject) -> None:
    sent = [packet for packets in _FRAMES for packet in packets]
    garbage = st.one_of(
        st.binary(max_size=450),
        st.sampled_from(sent).map(lambda packet: packet[:200]),
        st.sampled_from(sent),
        st.tuples(st.sampled_from(sent), st.integers(0, 399)).map(lambda t: t[0][: t[1]] + b"#" + t[0][t[1] + 1 :]),
    )
    kept = [packet for packet in sent if data.draw(st.integers(0, 40)) > 0]
    for position, packet in data.draw(st.lists(st.tuples(st.integers(0, len(kept)), garbage), max_size=12)):
        kept.insert(position, packet)
    assembler = Assembler()
    for received in assembled(kept, assembler):
        for got, wanted in zip(received.images, images_of(2, (8, 64), received.number), strict=True):
            np.testing.assert_array_equal(got, wanted)
    assert assembler.counts.packets == len(kept)
    assembled(kept, PlainAssembler([(8, 64)] * 2))


# -- by order and number -----------------------------------------------------------------------------------------------


def plain_stream(count: int) -> list[list[bytes]]:
    """Frames as a sender writes them who knows nothing of checksums."""

    def bare(packet: bytes) -> bytes:
        return packet[:8] + b"?" * 392 if packet.startswith(b"FRM_") else packet[:5] + b"!" * 395

    def controls(k: int, packet: bytes) -> bool:
        return k == 0 or packet.startswith((b"IMG_", b"FRM_STOP"))

    return [[bare(p) if controls(k, p) else p for k, p in enumerate(packets)] for packets in stream_of(count)]


def test_a_sender_without_checksums_is_understood_by_order_and_number() -> None:
    received = assembled([p for packets in plain_stream(3) for p in packets], PlainAssembler([(8, 64)] * 2))
    assert numbers(received) == [1, 2, 3]
    np.testing.assert_array_equal(received[2].images, images_of(2, (8, 64), 2))
    assert not assembled([p for packets in plain_stream(3) for p in packets])


@pytest.mark.parametrize("lost", [0, 1, 4, 5, 6, 12, -1])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_without_checksums_a_loss_costs_the_frames_it_touches_and_no_other(lost: int, count: int) -> None:
    frames = plain_stream(4)
    place = lost % len(frames[1])
    gone = frames[1][place : place + count]
    frames[1] = [*frames[1][:place], *frames[1][place + len(gone) :]]
    assembler = PlainAssembler([(8, 64)] * 2)
    received = assembled([p for packets in frames for p in packets], assembler)
    assert len(received) == 3
    for each, k in zip(received, (0, 2, 3), strict=True):
        np.testing.assert_array_equal(each.images, images_of(2, (8, 64), k))
    assert assembler.counts.incomplete + (place == 0) >= 1


def test_without_checksums_other_lengths_and_strangers_are_counted() -> None:
    assembler = PlainAssembler([(8, 64)] * 2)
    (frame,) = plain_stream(1)
    assert len(assembled([b"x" * 400, b"short", *frame, frame[0]], assembler)) == 1
    assert (assembler.counts.unexpected, assembler.counts.incomplete) == (2, 1)


# -- what travels ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene() -> tuple[Config, list[Capture], list[Any]]:
    source = open_source("scenario:approach-box", layers=[{"camera": {"rows": 24, "columns": 32}}])
    captures = [capture for capture, _ in zip(source.captures, range(12), strict=False)]
    return source.config, captures, list(pipeline.run(captures, source.config))


def travelled(config: Config, mode: str, capture: Capture, frame: Any) -> Capture:
    planes = MODES[mode].images(capture, frame, config)
    packets = encode(0, words_of(capture, frame, static_words(config, mode, planes)), list(planes.values()))
    (received,) = assembled(packets)
    return capture_of(read_text(received.debug[0]), read_text(received.debug[1]), received.images, config)


def test_raw_samples_arrive_bit_for_bit_with_the_state_of_the_car(scene: Any) -> None:
    config, captures, frames = scene
    for capture, frame in zip(captures, frames, strict=True):
        got = travelled(config, "raw", capture, frame)
        assert got.ego == capture.ego
        assert (got.raw.time_s, got.raw.frame_id) == (capture.raw.time_s, capture.raw.frame_id)
        for name, plane in capture.raw.planes.items():
            np.testing.assert_array_equal(got.raw.planes[name], plane)
            assert got.raw.planes[name].dtype == plane.dtype


def test_an_unknown_speed_stays_unknown(scene: Any) -> None:
    config, captures, _ = scene
    got = travelled(config, "raw", replace(captures[0], ego=Ego(forward=False)), None)
    assert got.ego.speed_mps is None
    assert np.isnan(got.ego.time_s)
    assert not got.ego.forward


def test_differences_of_phases_give_the_same_range_and_amplitude_as_the_phases(scene: Any) -> None:
    config, captures, _ = scene
    got = travelled(config, "real_imaginary", captures[0], None)
    again = pipeline.RANGING[config.ranging](got.raw, config.camera)
    whole = pipeline.RANGING[config.ranging](captures[0].raw, config.camera)
    both = again.valid & whole.valid
    assert both.mean() > 0.2
    np.testing.assert_allclose(again.range_m[both], whole.range_m[both], atol=1e-5)
    np.testing.assert_allclose(again.amplitude[both], whole.amplitude[both], rtol=1e-5)


@pytest.mark.parametrize(("top", "dtype"), [(4095, np.int16), (65535, np.int32)])
def test_differences_take_16_bits_where_they_fit_and_32_where_not(top: int, dtype: Any) -> None:
    planes = {f"phase_{step}": np.full((2, 2), top * (step < 180), np.uint16) for step in (0, 90, 180, 270)}
    found = MODES["real_imaginary"].images(Capture(RawFrame(0.0, planes)), None, load_config())
    assert {plane.dtype for plane in found.values()} == {np.dtype(dtype)}
    assert found["real"][0, 0] == top
    assert found["imaginary"][0, 0] == -top
    floats = {name: plane.astype(np.float32) for name, plane in planes.items()}
    found = MODES["real_imaginary"].images(Capture(RawFrame(0.0, floats)), None, load_config())
    assert found["real"].dtype == np.float32


def test_ranges_travel_in_millimetres_and_invalid_pixels_as_none(scene: Any) -> None:
    config, captures, frames = scene
    frame = frames[-1]
    got = travelled(config, "range", captures[-1], frame)
    valid = frame.image.valid
    np.testing.assert_allclose(got.raw.planes["range_m"][valid], frame.image.range_m[valid], atol=5.1e-4)
    assert (got.raw.planes["range_m"][~valid] == 0).all()
    sent = MODES["range"].images(captures[-1], frame, config)["range_mm"]
    assert (sent[~valid] == NO_RANGE_MM).all()


def test_modes_that_need_what_is_not_there_say_so(scene: Any) -> None:
    config, captures, _ = scene
    with pytest.raises(UsageError, match="which computes them"):
        MODES["range"].images(captures[0], None, config)
    with pytest.raises(UsageError, match="needs four phase images; the frame holds shutter_a"):
        MODES["real_imaginary"].images(Capture(RawFrame(0.0, {"shutter_a": np.zeros((2, 2))})), None, config)


def test_the_processing_units_tell_what_they_found(scene: Any) -> None:
    config, captures, frames = scene
    metadata, zero, one, two = words_of(captures[-1], frames[-1], static_words(config, "raw", ["a"]))
    frame = frames[-1]
    assert metadata["preset"] == "scaled_car"
    assert zero["speed_mps"] == 3.0
    assert zero["brake"] is frame.decision.brake
    assert one["valid_px"] + one["invalid_px"] == frame.image.why.size
    assert two["segments"] == len(frame.segments)
    assert sum(two["histogram_px"]) == one["valid_px"]
    assert words_of(captures[-1], None, {})[2:] == ({}, {})


def test_calibration_of_each_pixel_stays_at_home() -> None:
    planes = {"shutter_a": np.zeros((8, 64)), "offset_a": np.zeros((8, 64))}
    assert [*MODES["raw"].images(Capture(RawFrame(0.0, planes)), None, load_config("usercams"))] == ["shutter_a"]


def test_settings_that_differ_from_the_preset_travel_and_too_many_are_left_out() -> None:
    assert static_words(load_config("scaled_car"), "raw", ["a"])["settings"] == {}
    changed = load_config("scaled_car", {"camera": {"modulation_hz": 12e6}, "mounting": {"z_m": 0.3}})
    assert static_words(changed, "raw", ["a"])["settings"] == {
        "camera": {"modulation_hz": 12e6},
        "mounting": {"z_m": 0.3},
    }
    much = load_config("scaled_car", {"camera": {"wiggling_table_m": [[0.001 * k for k in range(64)]]}})
    assert "settings" not in static_words(much, "raw", ["a"])
    assert "settings" not in static_words(replace(changed, preset="mine"), "raw", ["a"])
    assert differing({"a": {"b": 1, "c": 2}, "d": [1]}, {"a": {"b": 1}, "d": [1]}) == {"a": {"c": 2}}
    assert static_words(changed, "range", ["range_mm"])["preset"] == "generic_range"


def test_words_of_other_programs_are_refused(scene: Any) -> None:
    config = scene[0]
    for metadata in ({}, {"mode": "raw"}, {"mode": "raw", "planes": ["a"], "time_s": "x", "frame_id": 0}):
        with pytest.raises(DataError, match="cannot be read"):
            capture_of(metadata, {}, (np.zeros((2, 2)),), config)


def test_plain_images_are_what_the_receiver_calls_them() -> None:
    config = load_config("scaled_car")
    image = np.array([[1000, NO_RANGE_MM]], np.uint16)
    ranged = plain_capture(1.5, 3, {"range_mm": image}, config).raw
    np.testing.assert_array_equal(ranged.planes["range_m"], np.array([[1.0, 0.0]], np.float32))
    assert (ranged.time_s, ranged.frame_id) == (1.5, 3)
    signed = np.array([[0xFFFE, 4]], np.uint16)
    phases = plain_capture(0.0, 0, {"real": signed, "imaginary": image}, config).raw.planes
    np.testing.assert_array_equal(phases["phase_0"] - phases["phase_180"], [[-2, 4]])
    assert [*plain_capture(0.0, 0, {"phase_0": image}, config).raw.planes] == ["phase_0"]


# -- sockets -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        free: int = probe.getsockname()[1]
        return free


@pytest.fixture
def sending() -> Iterator[Any]:
    """Start a function again and again, beside the test, until the test is over."""
    threads, over = [], threading.Event()

    def start(function: Any, pause_s: float = 0.05) -> None:
        def again() -> None:
            while not over.wait(pause_s):
                with suppress(DataError, OSError):  # its socket may be closed before the test is over
                    function()

        threads.append(threading.Thread(target=again))
        threads[-1].start()

    yield start
    over.set()
    for thread in threads:
        thread.join()


def listened_to(port: int) -> bool:
    """Whether somebody has bound the port: asked of the kernel, because trying it would take it."""
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("udp://127.0.0.1", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:x", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:99999", "expected udp://HOST:PORT"),
        ("tcp://127.0.0.1:1", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:5/path", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:5?weit=1", "did you mean 'wait'"),
        ("udp://127.0.0.1:5?wait=long", "wait=long: expected a number"),
        ("udp://127.0.0.1:5?rows=0", "at least 1"),
        ("udp://127.0.0.1:5?idle=nan", "expected a number"),
    ],
)
def test_addresses_that_are_none_are_named(url: str, words: str) -> None:
    with pytest.raises(UsageError, match=words.replace("?", r"\?")):
        parse_address(url)


def test_an_address_without_a_host_is_this_machine() -> None:
    address = parse_address("udp://:5005?wait=1&idle=0.5&planes=a,b&rows=3&columns=4")
    assert (address.host, address.port, address.wait_s, address.idle_s) == ("127.0.0.1", 5005, 1.0, 0.5)
    assert (address.planes, address.shape) == (("a", "b"), (3, 4))


def test_a_stream_that_does_not_come_says_what_was_awaited(port: int) -> None:
    with pytest.raises(DataError, match=r"no complete frame within 0.2 s \(nothing came\); awaited packets of 400"):
        open_udp(f"//127.0.0.1:{port}?wait=0.2")


def test_a_stream_of_strangers_says_what_came(port: int, sending: Any) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        sending(lambda: other.sendto(b"hello", ("127.0.0.1", port)))
        with pytest.raises(DataError, match=r"\([1-9]\d* packets came, 0 incomplete"):
            open_udp(f"//127.0.0.1:{port}?wait=0.4")


def test_an_address_that_is_taken_or_none_is_refused(port: int) -> None:
    receiver = Receiver(parse_address(f"udp://127.0.0.1:{port}"), time.monotonic)
    try:
        with pytest.raises(UsageError, match=f"{port}: cannot listen there: Address already in use"):
            open_udp(f"//127.0.0.1:{port}?wait=0.1")
    finally:
        receiver.close()
    with pytest.raises(UsageError, match=r"nowhere\.invalid"):
        Stream("udp://nowhere.invalid:5", load_config())
    with pytest.raises(UsageError, match="did you mean 'range'"):
        Stream(f"udp://127.0.0.1:{port}", load_config(), "ranges")


def test_settings_and_frames_arrive_over_a_socket_and_the_stream_ends_when_nothing_comes(
    port: int, sending: Any, scene: Any
) -> None:
    config, captures, _ = scene
    changed = replace(config, mounting=replace(config.mounting, z_m=0.35))
    with Stream(f"udp://127.0.0.1:{port}", changed) as stream:
        sending(lambda: stream.frames or (listened_to(port) and stream.write(captures[0])))
        source = open_source(f"udp://127.0.0.1:{port}?idle=0.3&wait=20")
        for capture in captures[1:6]:
            stream.write(capture)
        got = [capture.raw.frame_id for capture in source.captures]
    assert source.config == changed
    assert source.n_frames is None
    assert got == [0, 1, 2, 3, 4, 5]
    assert source.live is not None
    assert source.live.counts()["frames"] == 6
    assert source.live.counts()["incomplete"] == 0


def test_frames_that_nobody_takes_in_time_are_skipped_and_counted(port: int, scene: Any) -> None:
    config, captures, _ = scene
    receiver = Receiver(parse_address(f"udp://127.0.0.1:{port}"), time.monotonic)
    with Stream(f"udp://127.0.0.1:{port}", config) as stream:
        for capture in captures:
            stream.write(capture)
    until = time.monotonic() + 10
    while receiver.counts()["frames"] < len(captures) and time.monotonic() < until:
        time.sleep(0.01)
    assert receiver.counts()["skipped"] == len(captures) - KEPT
    kept = receiver.next_frame(0.0)
    assert kept is not None
    assert kept[1].number == len(captures) - KEPT
    receiver.close()
    assert receiver.ended


def test_a_stop_ends_the_captures(port: int, sending: Any, scene: Any) -> None:
    config, captures, _ = scene
    with Stream(f"udp://127.0.0.1:{port}", config) as stream:
        sending(lambda: stream.write(captures[0]))
        source = open_source(f"udp://127.0.0.1:{port}?wait=20")
        assert source.live is not None
        for count, _ in enumerate(source.captures):
            if count == 2:
                source.live.stop()
        assert source.live.ended  # type: ignore[attr-defined]


def test_frames_that_cannot_be_read_or_are_of_another_size_are_counted(port: int, sending: Any, scene: Any) -> None:
    config, captures, _ = scene
    small = {name: plane[:4] for name, plane in captures[0].raw.planes.items()}
    good = static_words(config, "raw", captures[0].raw.planes)
    to = ("127.0.0.1", port)
    sent = []

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def frame(planes: Any, words: Any) -> None:
            for packet in encode(len(sent), words, list(planes.values())):
                out.sendto(packet, to)
            sent.append(0)

        sending(
            lambda: sent or (listened_to(port) and frame(captures[0].raw.planes, words_of(captures[0], None, good)))
        )
        source = open_source(f"udp://127.0.0.1:{port}?idle=0.3&wait=20")
        frame(small, words_of(captures[1], None, good))
        frame(captures[0].raw.planes, WORDS)
        frame(captures[0].raw.planes, words_of(captures[1], None, good))
        assert len(list(source.captures)) == 2
    assert source.live is not None
    assert source.live.counts()["unreadable"] == 2


def test_streams_that_cannot_be_decoded_are_refused_with_the_reason(port: int, sending: Any, scene: Any) -> None:
    config, captures, _ = scene
    good = words_of(captures[0], None, static_words(config, "raw", captures[0].raw.planes))
    planes = list(captures[0].raw.planes.values())
    cases = [
        ((good[0], *good[1:]), [], "mode 'raw' without images"),
        (({**good[0], "mode": "film"}, *good[1:]), planes, "mode 'film'"),
        (({**good[0], "preset": "yours"}, *good[1:]), planes, "'yours' is none of this version's"),
        (({**good[0], "settings": {"camera": {"rovs": 3}}}, *good[1:]), planes, "do not fit this version"),
    ]
    to, current = ("127.0.0.1", port), [cases[0]]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        sending(lambda: [out.sendto(packet, to) for packet in encode(0, *current[0][:2])])
        for case in cases:
            current[0] = case
            time.sleep(0.12)
            with pytest.raises(DataError, match=case[2]):
                open_udp(f"//127.0.0.1:{port}?wait=20")


def test_a_receiver_is_told_where_the_settings_do_not_fit_into_the_stream(port: int, sending: Any, scene: Any) -> None:
    config, captures, _ = scene
    with Stream(f"udp://127.0.0.1:{port}", replace(config, description="x" * 400)) as stream:
        sending(lambda: stream.write(captures[0]))
        source = open_source(f"udp://127.0.0.1:{port}?wait=20")
        assert source.live is not None
        source.live.stop()
    assert any("give them here" in note for note in source.notes)


def test_settings_that_do_not_suit_the_stream_give_its_address_back(port: int, sending: Any, scene: Any) -> None:
    config, captures, _ = scene
    with Stream(f"udp://127.0.0.1:{port}", config) as stream:
        sending(lambda: stream.write(captures[0]))
        for _ in range(2):
            with pytest.raises(UsageError, match="is for a pulsed camera"):
                open_source(f"udp://127.0.0.1:{port}?wait=20", preset="usercams")
            time.sleep(0.15)


def test_a_plain_sender_is_a_source_when_its_planes_are_named(port: int, sending: Any) -> None:
    (packets,) = plain_stream(1)
    to = ("127.0.0.1", port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        sending(lambda: [out.sendto(packet, to) for packet in packets])
        names = "?planes=phase_0,phase_90&rows=8&columns=64&wait=20"
        source = open_source(f"udp://127.0.0.1:{port}{names}")
        captures = iter(source.captures)
        first, second = next(captures), next(captures)
        assert source.live is not None
        source.live.stop()
        assert len(list(captures)) >= 0
    assert source.config.preset == "scaled_car"
    assert [*first.raw.planes] == ["phase_0", "phase_90"]
    np.testing.assert_array_equal(first.raw.planes["phase_90"], images_of(2, (8, 64), 0)[1])
    assert second.raw.time_s > first.raw.time_s


def test_packets_leave_at_the_pace_of_the_link(scene: Any, port: int) -> None:
    config, captures, _ = scene
    now, naps = [0.0], []

    def sleep(seconds: float) -> None:
        naps.append(seconds)
        now[0] += seconds

    with Stream(f"udp://127.0.0.1:{port}", config, link_mbit=10.0, clock=lambda: now[0], sleep=sleep) as stream:
        stream.write(captures[0])
    n_packets = frame_packets(4, 24 * 32 * 2)
    assert sum(naps) == pytest.approx(n_packets * 466 * 8 / 10e6)
    with Stream(f"udp://127.0.0.1:{port}", config, link_mbit=0.0, clock=lambda: now[0], sleep=sleep) as stream:
        naps.clear()
        stream.write(captures[0])
    assert not naps


def test_a_link_that_is_too_slow_says_what_it_carries(port: int) -> None:
    config = load_config("scaled_car")
    planes = {f"phase_{step}": np.zeros(THESIS, np.uint16) for step in (0, 90, 180, 270)}
    with (
        Stream(f"udp://127.0.0.1:{port}", config, link_mbit=10.0, sleep=lambda _: None) as stream,
        pytest.raises(UsageError, match=r"394 packets are 44.1 Mbit/s .* enough for 6.8 frames/s"),
    ):
        stream.write(Capture(RawFrame(0.0, planes)))


def test_a_network_that_refuses_is_named(port: int, scene: Any) -> None:
    config, captures, _ = scene
    stream = Stream(f"udp://127.0.0.1:{port}", config)
    stream.close()
    with pytest.raises(DataError, match="cannot send: Bad file descriptor"):
        stream.write(captures[0])


def test_captures_come_when_their_time_has_come_and_late_ones_at_once() -> None:
    now, naps = [5.0], []

    def sleep(seconds: float) -> None:
        naps.append(seconds)
        now[0] += seconds

    came = []
    for capture in paced((Capture(RawFrame(t, {})) for t in (1.0, 1.5, 1.75)), lambda: now[0], sleep):
        came.append((capture.raw.time_s, now[0]))
        now[0] += 0.4
    assert came == [(1.0, 5.0), (1.5, 5.5), (1.75, 5.9)]
    assert naps == [pytest.approx(0.1)]


# -- the command line --------------------------------------------------------------------------------------------------


def test_a_simulation_streamed_in_real_time_is_perceived_and_braked_for(
    port: int, scene: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    url, found = f"udp://127.0.0.1:{port}", []

    def perceive() -> None:
        source = open_source(f"{url}?idle=0.6&wait=30")
        found.extend(pipeline.run(source.captures, source.config))
        found.append(source)

    listener = threading.Thread(target=perceive)
    listener.start()
    until = time.monotonic() + 10
    while not listened_to(port) and time.monotonic() < until:
        time.sleep(0.02)
    small = ["--set", "camera.rows=24", "--set", "camera.columns=32", "--set", "segments.min_pixels=3"]
    assert main(["simulate", "approach-box", "--stream", url, "--real-time", "--json", *small]) == 0
    listener.join()
    assert json.loads(capsys.readouterr().out)["stream"] == url
    *frames, source = found
    counts = source.live.counts()
    assert (counts["frames"], counts["incomplete"], counts["unexpected"]) == (66, 0, 0)
    assert len(frames) == 66 - counts["skipped"]
    assert source.config.camera.rows == 24
    assert any(frame.decision.brake for frame in frames)


def test_a_run_can_pass_its_ranges_on_and_says_for_people_what_came(
    port: int, sending: Any, scene: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    config, captures, _ = scene
    url = f"udp://127.0.0.1:{port}"
    with Stream(url, config) as stream:
        sending(lambda: listened_to(port) and stream.frames < 8 and stream.write(captures[stream.frames]))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as elsewhere:
            elsewhere.bind(("127.0.0.1", 0))
            there = f"udp://127.0.0.1:{elsewhere.getsockname()[1]}"
            arguments = ["run", f"{url}?idle=0.4&wait=20", "--stream", there, "--stream-mode", "range"]
            assert main([*arguments, "--link-mbit", "0"]) == 0
            assert elsewhere.recv(500).startswith(b"FRM_STRT")
            assert read_text(elsewhere.recv(500))["mode"] == "range"
    out = capsys.readouterr().out
    assert re.search(r"stream     8 complete frames, none lost", out)


def test_ctrl_c_ends_a_live_run_with_its_summary(
    port: int, sending: Any, scene: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    config, captures, _ = scene
    with Stream(f"udp://127.0.0.1:{port}", config) as stream:
        sending(lambda: stream.write(captures[0]), 0.02)

        def interrupt() -> None:
            if stream.frames > 20 and signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
                signal.raise_signal(signal.SIGINT)

        before = signal.signal(signal.SIGALRM, lambda *_: interrupt())
        signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
        try:
            assert main(["run", f"udp://127.0.0.1:{port}?wait=20", "--json"]) == 0
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
    assert json.loads(capsys.readouterr().out)["frames"] > 0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_simulation_must_go_somewhere(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "approach-box"]) == 2
    assert "--stream udp://HOST:PORT" in capsys.readouterr().err
