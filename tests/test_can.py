"""The car's bus: golden bytes by hand from tables A.1 to A.5, round trips, refusals, the bus, and its command."""

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rangecam.can import bus as bus_module
from rangecam.can import layout
from rangecam.can.bus import GROUP, INTERFACES, Bus, Received, read
from rangecam.can.codec import (
    FIELDS,
    MAGIC_NUMBER,
    PERIOD_S,
    TIMEOUT_S,
    CarStatus1,
    CarStatus2,
    CodecError,
    DriveMode,
    GiveBack,
    Message,
    Reason,
    RemoteValues,
    SteeringMode,
    TakeOver,
    database,
    decode,
    encode,
    name_of,
)
from rangecam.can.monitor import as_json, describe, observe
from rangecam.cli import main
from rangecam.errors import DataError, UsageError

# Little endian; mA, mV, mW, mm/s; degrees Celsius; thousandths; hundredths of steering.
GOLDEN: list[tuple[Message, int, str]] = [
    (CarStatus1(1.0, 7.2, 7.2, 3.0), 0xA0, "e8 03 20 1c 20 1c b8 0b"),
    (CarStatus1(0.0, 6.0, 65.535, 5.556), 0xA0, "00 00 70 17 ff ff b4 15"),
    (CarStatus1(65.535, 65.535, 0.256, 65.535), 0xA0, "ff ff ff ff 00 01 ff ff"),
    (CarStatus2(7.5, 20.0, -1.0, 127.0, -128.0, 0.0), 0xA1, "4c 1d 14 ff 7f 80 00 00"),
    (RemoteValues(1.0, -1.0, 0.001), 0xDB, "e8 03 18 fc 01 00"),
    (TakeOver(DriveMode.BRAKE, 1.0), 0x50, "03 e8 03 00 00 00 ca fe"),
    (TakeOver(DriveMode.FORWARD, 0.256, SteeringMode.LEFT, 1.0), 0x50, "01 00 01 01 64 00 ca fe"),
    (TakeOver(DriveMode.BACKWARD, 0.001, SteeringMode.RIGHT, 0.01), 0x50, "02 01 00 02 01 00 ca fe"),
    (TakeOver(DriveMode.NONE, 0.0), 0x50, "00 00 00 00 00 00 ca fe"),
    (GiveBack(), 0x50, "00 00 00 00 00 00 00 00"),
]


@pytest.mark.parametrize(("message", "can_id", "data"), GOLDEN)
def test_messages_are_the_bytes_of_the_tables(message: Message, can_id: int, data: str) -> None:
    assert encode(message) == (can_id, bytes.fromhex(data))
    assert decode(can_id, bytes.fromhex(data)) == message


u16, i8, i16 = st.integers(0, 65535), st.integers(-128, 127), st.integers(-1000, 1000)
LEGAL = st.one_of(
    st.tuples(st.just(0xA0), st.tuples(u16, u16, u16, u16).map(lambda v: b"".join(n.to_bytes(2, "little") for n in v))),
    st.tuples(
        st.just(0xA1),
        st.tuples(u16, i8, i8, i8, i8, i8).map(
            lambda v: v[0].to_bytes(2, "little") + b"".join(n.to_bytes(1, signed=True) for n in v[1:]) + b"\0"
        ),
    ),
    st.tuples(
        st.just(0xDB),
        st.tuples(i16, i16, i16).map(lambda v: b"".join(n.to_bytes(2, "little", signed=True) for n in v)),
    ),
    st.tuples(
        st.just(0x50),
        st.tuples(st.integers(0, 3), st.integers(0, 1000), st.integers(0, 2), st.integers(0, 100)).map(
            lambda v: bytes([v[0], v[1] & 255, v[1] >> 8, v[2], v[3], 0, 0xCA, 0xFE])
        ),
    ),
)


share, celsius = st.floats(-1, 1), st.floats(-128, 127)
SENDABLE = st.one_of(
    st.builds(CarStatus1, *[st.floats(0, 65.535)] * 4),
    st.builds(CarStatus2, st.floats(0, 65.535), *[celsius] * 5),
    st.builds(RemoteValues, share, share, share),
    st.builds(TakeOver, st.sampled_from(DriveMode), st.floats(0, 1), st.sampled_from(SteeringMode), st.floats(0, 1)),
)


@settings(max_examples=200, deadline=None)
@given(SENDABLE)
def test_every_message_is_packed_as_cantools_packs_it(message: Message) -> None:
    values = {signal: float(getattr(message, field)) for field, signal in FIELDS[name_of(message)][1].items()}
    rest = {"Magic": MAGIC_NUMBER, "Reserved": 0, "AutoReserved": 0}
    known = database().get_message_by_name(name_of(message))
    assert encode(message) == (known.frame_id, known.encode({**rest, **values}, strict=False))


@settings(max_examples=300, deadline=None)
@given(LEGAL)
def test_every_legal_frame_is_the_same_after_a_round_trip(frame: tuple[int, bytes]) -> None:
    assert encode(decode(*frame)) == frame


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.sampled_from([0x50, 0xA0, 0xA1, 0xDB]), st.integers()), st.binary(max_size=64))
def test_garbage_is_a_message_or_a_refusal_and_nothing_else(can_id: int, data: bytes) -> None:
    received = read(0.0, can_id, data)
    assert (received.message is None) == (received.refusal is not None)
    if isinstance(received.message, TakeOver):
        assert data[6:] == b"\xca\xfe"


@settings(max_examples=100, deadline=None)
@given(st.binary(min_size=8, max_size=8).filter(lambda data: data[6:] != b"\xca\xfe"))
def test_without_the_whole_magic_number_whatever_else_it_holds_control_is_given_back(data: bytes) -> None:
    assert decode(0x50, data) == GiveBack()


REFUSED_FRAMES = [
    (0x51, "00 00 00 00 00 00 00 00", Reason.UNKNOWN_ID, "0x51 is no message of the car"),
    (0x50, "03 e8 03 00 00 00 ca", Reason.LENGTH, "MasterID has 8 bytes, not 7"),
    (0x50, "", Reason.LENGTH, "not 0"),
    (0x50, "03 e8 03 00 00 00 ca fe 00", Reason.LENGTH, "not 9"),
    (0xDB, "00 00 00 00 00 00 00 00", Reason.LENGTH, "DeviceDBG has 6 bytes, not 8"),
    (0x50, "04 e8 03 00 00 00 ca fe", Reason.RANGE, "MasterID.AutoMode = 4: expected 0 to 3"),
    (0x50, "03 e9 03 00 00 00 ca fe", Reason.RANGE, "MasterID.AutoValue = 1.001: expected 0 to 1"),
    (0x50, "03 e8 03 03 00 00 ca fe", Reason.RANGE, "SteeringMode = 3"),
    (0x50, "03 e8 03 00 65 00 ca fe", Reason.RANGE, "SteeringValue = 1.01"),
    (0xDB, "e9 03 00 00 00 00", Reason.RANGE, "RemoteCh1 = 1.001: expected -1 to 1"),
    (0xDB, "00 00 00 00 17 fc", Reason.RANGE, "RemoteCh3 = -1.001"),
]


@pytest.mark.parametrize(("can_id", "data", "reason", "words"), REFUSED_FRAMES)
def test_frames_that_are_no_message_are_refused_with_the_reason(
    can_id: int, data: str, reason: Reason, words: str
) -> None:
    with pytest.raises(CodecError, match=words.replace(".", r"\.")) as caught:
        decode(can_id, bytes.fromhex(data))
    assert caught.value.reason is reason
    assert isinstance(caught.value, DataError)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (CarStatus1(-0.001, 0.0, 0.0, 0.0), "AutoMotorCurrent = -0.001: expected 0 to 65.535 A"),
        (CarStatus1(0.0, 65.536, 0.0, 0.0), "AutoBattVoltage"),
        (CarStatus1(0.0, 0.0, -1.0, 0.0), "AutoPower"),
        (CarStatus1(0.0, 0.0, 0.0, float("nan")), "AutoRotationSpeed = nan"),
        (CarStatus1(0.0, 0.0, 0.0, float("inf")), "AutoRotationSpeed = inf"),
        (CarStatus2(0.0, 128.0, 0.0, 0.0, 0.0, 0.0), "AutoTemp1 = 128: expected -128 to 127 degC"),
        (RemoteValues(0.0, -1.1, 0.0), "RemoteCh2"),
        (TakeOver(DriveMode.BRAKE, 1.001), "AutoValue"),
        (TakeOver(DriveMode.BRAKE, 0.5, SteeringMode.LEFT, -0.01), "SteeringValue"),
    ],
)
def test_values_that_do_not_fit_are_refused_with_the_limits(message: Message, words: str) -> None:
    with pytest.raises(CodecError, match=words) as caught:
        encode(message)
    assert caught.value.reason is Reason.RANGE
    assert str(caught.value) == str(caught.value).rstrip()


def test_a_take_over_that_was_decoded_names_its_modes() -> None:
    message = decode(*encode(TakeOver(DriveMode.BRAKE, 0.5)))
    assert isinstance(message, TakeOver)
    assert (type(message.mode), type(message.steering)) == (DriveMode, SteeringMode)


def test_a_power_beyond_the_sixteen_bits_is_sent_as_the_most_they_hold() -> None:
    assert encode(CarStatus1(20.0, 7.2, 144.0, 0.0))[1][4:6] == b"\xff\xff"
    assert decode(*encode(CarStatus1(20.0, 7.2, 144.0, 0.0))) == CarStatus1(20.0, 7.2, 65.535, 0.0)


def test_the_dbc_file_says_what_the_layout_and_the_periods_say() -> None:
    master = database().get_message_by_name("MasterID")
    assert master.frame_id == layout.MASTER_ID == min(each.frame_id for each in database().messages)
    assert {str(v): k for k, v in master.get_signal_by_name("AutoMode").choices.items()}["brake"] == layout.BRAKE_MODE
    assert master.get_signal_by_name("AutoValue").scale == 1 / layout.VALUE_PER_UNIT
    assert {each.cycle_time for each in database().messages} == {round(PERIOD_S * 1000)}
    assert TIMEOUT_S >= 5 * PERIOD_S
    for name, (_, fields) in FIELDS.items():
        signals = {each.name for each in database().get_message_by_name(name).signals}
        assert signals - set(fields.values()) <= {"Magic", "Reserved", "AutoReserved"}
    assert [name_of(message) for message, _, _ in GOLDEN[-2:]] == ["MasterID", "MasterID"]


# -- the bus ----------------------------------------------------------------------------------------------------------


@pytest.fixture(params=["virtual", "udp_multicast"])
def pair(request: pytest.FixtureRequest) -> Any:
    channel = {"virtual": "test", "udp_multicast": "239.74.163.77"}[request.param]
    with Bus(request.param, channel) as one, Bus(request.param, channel) as other:
        yield one, other


def test_messages_cross_from_one_end_of_the_bus_to_the_other(pair: tuple[Bus, Bus]) -> None:
    one, other = pair
    for message, can_id, data in GOLDEN:
        one.send(message)
        received = other.receive(5.0)
        assert received is not None
        assert (received.message, received.can_id, received.data) == (message, can_id, bytes.fromhex(data))
        assert received.refusal is None


def test_what_is_no_message_is_counted_and_not_raised(pair: tuple[Bus, Bus]) -> None:
    one, other = pair
    one.send_frame(0x123, b"\x01")
    one.send_frame(0xA0, b"\x01")
    refusals = [received.refusal for received in (other.receive(5.0), other.receive(5.0)) if received]
    assert refusals == [Reason.UNKNOWN_ID, Reason.LENGTH]
    assert other.refused == {Reason.UNKNOWN_ID: 1, Reason.LENGTH: 1}


def test_receiving_waits_no_longer_than_told(pair: tuple[Bus, Bus]) -> None:
    assert pair[0].receive() is None
    assert pair[0].receive(0.01) is None


def test_frames_of_another_kind_are_not_the_cars() -> None:
    import can

    kinds = ({"is_extended_id": True}, {"is_remote_frame": True}, {"is_error_frame": True})
    with Bus("virtual", "kinds") as ours, can.Bus(interface="virtual", channel="kinds") as theirs:
        for kind in kinds:
            theirs.send(can.Message(arbitration_id=0x50, **{"is_extended_id": False, **kind}))
            received = ours.receive(5.0)
            assert received is not None
            assert received.refusal is Reason.UNKNOWN_ID


def test_packets_that_nobody_can_read_are_counted() -> None:
    import socket

    with Bus("udp_multicast", "239.74.163.78") as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(bus_module.LOOPBACK))
        sender.sendto(b"no message", ("239.74.163.78", bus_module.PORT))
        assert bus.receive(5.0) is None
        assert bus.refused == {Reason.UNREADABLE: 1}


def test_errors_of_the_bus_are_told() -> None:
    with pytest.raises(UsageError, match="unknown CAN interface 'pcan'; interfaces: virtual, udp_multicast, socketcan"):
        Bus("pcan")
    with pytest.raises(UsageError, match="expected an IPv4 multicast group"):
        Bus("udp_multicast", "example.org")
    with pytest.raises(UsageError, match=r"channel '127\.0\.0\.1': expected an IPv4 multicast group"):
        Bus("udp_multicast", "127.0.0.1")
    bus = Bus("virtual", "closed")
    bus.close()
    for action in (lambda: bus.send(GiveBack()), bus.receive):
        with pytest.raises(DataError, match="virtual:closed: cannot"):
            action()


def test_a_socketcan_bus_carries_messages_where_the_system_has_one() -> None:
    try:
        one = Bus("socketcan")
    except DataError as error:
        pytest.skip(f"no vcan0 here: {error}")
    with one, Bus("socketcan") as other:
        one.send(GOLDEN[0][0])
        received = other.receive(5.0)
        assert received is not None
        assert received.message == GOLDEN[0][0]


def test_every_interface_has_a_usual_channel() -> None:
    assert {name: channel for name, (_, channel) in INTERFACES.items()}["udp_multicast"] == GROUP


# -- the table of the monitor -----------------------------------------------------------------------------------------


def test_the_monitor_counts_times_and_decodes() -> None:
    table: dict[int, Any] = {}
    for time_s, data in ((1.0, "e8 03 20 1c 20 1c b8 0b"), (1.02, "00"), (1.05, "e8 03 20 1c 20 1c 00 00")):
        table = observe(table, read(time_s, 0xA0, bytes.fromhex(data)))
    table = observe(table, read(1.0, 0x50, bytes.fromhex("03 e8 03 00 00 00 ca fe")))
    take_over, status = as_json(table)
    assert (take_over["id"], take_over["message"], take_over["count"]) == ("0x50", "take-over", 1)
    assert (take_over["period_s"], take_over["shortest_s"], take_over["longest_s"]) == (None, None, None)
    assert take_over["values"] == {"mode": "brake", "value": 1.0, "steering": "none", "steering_value": 0.0}
    assert (status["count"], status["refused"], status["values"]["speed_mps"]) == (3, 1, 0.0)
    assert status["period_s"] == pytest.approx(0.025)
    assert (status["shortest_s"], status["longest_s"]) == (pytest.approx(0.02), pytest.approx(0.03))
    assert describe(read(0.0, 0x50, bytes(8))) == ("give-back", {})
    assert describe(Received(0.0, 1, b"", None, Reason.UNKNOWN_ID)) == ("refused: unknown identifier", {})


# -- the command ------------------------------------------------------------------------------------------------------


def test_the_list_says_where_each_field_lies(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["can", "list", "--json"]) == 0
    messages = {each["name"]: each for each in json.loads(capsys.readouterr().out)["messages"]}
    assert {name: each["id"] for name, each in messages.items()} == {
        "DeviceID1": "0xA0",
        "DeviceID2": "0xA1",
        "DeviceDBG": "0xDB",
        "MasterID": "0x50",
    }
    speed = messages["DeviceID1"]["fields"]["speed_mps"]
    assert (speed["first_byte"], speed["bits"], speed["unit"], speed["maximum"]) == (6, 16, "m/s", 65.535)
    assert messages["MasterID"]["fields"]["mode"]["codes"] == {"none": 0, "forward": 1, "backward": 2, "brake": 3}
    assert main(["can", "list"]) == 0
    out = capsys.readouterr().out
    assert "speed_mps          byte 6, 16 bits: 0 to 65.535 m/s" in out
    assert "none, forward, backward, brake" in out


def watched(arguments: list[str], talk: Callable[[], None]) -> int:
    """Run the monitor while something is said on the bus."""
    talker = threading.Thread(target=talk)
    talker.start()
    try:
        return main(["can", "monitor", *arguments])
    finally:
        talker.join()


def test_what_one_command_sends_the_other_shows_and_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    channel = ["--channel", "239.74.163.79"]

    def talk() -> None:
        with Bus("udp_multicast", "239.74.163.79") as bus:
            for _ in range(200):
                bus.send(CarStatus1(0.0, 0.0, 0.0, 3.0))
                time.sleep(0.02)

    log = tmp_path / "bus.csv"
    call = [*channel, "--frames", "3", "--duration", "30", "--log", str(log), "--json"]
    assert watched(call, talk) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["bus"] == "udp_multicast:239.74.163.79"
    (row,) = shown["rows"]
    assert (row["message"], row["count"], row["values"]["speed_mps"]) == ("DeviceID1", 3, 3.0)
    assert len(log.read_text().splitlines()) == 4
    assert main(["can", "monitor", *channel, "--duration", "0"]) == 0
    assert capsys.readouterr().out == "udp_multicast:239.74.163.79: 0 frames\n"


def test_the_monitor_shows_for_people_what_it_heard_and_refused(capsys: pytest.CaptureFixture[str]) -> None:
    def talk() -> None:
        with Bus("virtual", "people") as bus:
            for _ in range(100):
                bus.send_frame(0x50, bytes.fromhex("09 e8 03 00 00 00 ca fe"))
                bus.send(TakeOver(DriveMode.BRAKE, 0.5))
                time.sleep(0.02)

    assert watched(["--interface", "virtual", "--channel", "people", "--frames", "4"], talk) == 0
    out = capsys.readouterr().out
    assert "4 frames" in out
    assert "refused, value out of range: 2" in out
    assert "mode brake, value 0.5" in out


def test_any_message_can_be_sent_once_or_periodically(capsys: pytest.CaptureFixture[str]) -> None:
    with Bus("virtual", "send") as bus:
        call = ["can", "send", "--interface", "virtual", "--channel", "send"]
        assert main([*call, "DeviceID1", "speed_mps=3", "battery_voltage_v=7.2", "--json"]) == 0
        sent = json.loads(capsys.readouterr().out)
        assert sent == {"bus": "virtual:send", "id": "0xA0", "data": "00 00 20 1c 00 00 b8 0b", "sent": 1}
        assert main([*call, "MasterID", "mode=brake", "value=1", "--arm", "--every", "0.001", "--count", "3"]) == 0
        assert capsys.readouterr().out == "virtual:send: 0x50 [03 e8 03 00 00 00 ca fe] sent 3 times\n"
        assert main([*call, "GiveBack"]) == 0
        messages = [bus.receive(1.0) for _ in range(5)]
    assert [type(each.message) for each in messages if each] == [CarStatus1, TakeOver, TakeOver, TakeOver, GiveBack]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (["send", "DeviceID3"], "unknown message 'DeviceID3'; did you mean 'DeviceID"),
        (["send", "DeviceID1", "speed=3"], "speed=3: expected field=value; fields of DeviceID1: motor_current_a"),
        (["send", "DeviceID1", "speed_mps=fast"], "speed_mps=fast: expected a number"),
        (["send", "MasterID", "mode=fly"], "mode=fly: expected none, forward, backward, brake"),
        (["send", "MasterID", "mode=brake"], "add --arm"),
        (["send", "GiveBack", "--every", "0"], "--every 0: must be greater than 0 s"),
        (["send", "GiveBack", "x=1"], "x=1: expected no fields: GiveBack has none"),
        (["monitor", "--interface", "none"], "unknown CAN interface 'none'"),
        (["monitor", "--interface", "virtual", "--duration", "0", "--log", "x.xyz"], "--log x.xyz: expected a file"),
    ],
)
def test_wrong_calls_are_told(call: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["can", *call]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.out == ""


def test_a_value_that_does_not_fit_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["can", "send", "DeviceID1", "speed_mps=70", "--interface", "virtual"]) == 1
    assert "AutoRotationSpeed = 70: expected 0 to 65.535 m/s" in capsys.readouterr().err
