"""Messages of the car's bus to bytes and back (Steinbäck 2016, appendix A.4); docs/can.md decides what is open there.

Values are SI. cantools reads `messages.dbc`, scales and unpacks; what it lets pass silently (a wrong magic number,
values beyond their limits, codes without a name) is refused here, always as a `CodecError` that says why.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

from rangecam.can.layout import BRAKE_MODE, GIVE_BACK_DATA, MAGIC, MASTER_ID
from rangecam.errors import DataError
from rangecam.values import record


class DriveMode(IntEnum):
    """Auto Mode of a take-over."""

    NONE = 0
    FORWARD = 1
    BACKWARD = 2
    BRAKE = BRAKE_MODE


class SteeringMode(IntEnum):
    """Steering Mode of a take-over."""

    NONE = 0
    LEFT = 1
    RIGHT = 2


class Reason(StrEnum):
    """Why a frame or a message was refused."""

    UNKNOWN_ID = "unknown identifier"
    LENGTH = "wrong length"
    RANGE = "value out of range"
    UNREADABLE = "not readable at all"


class CodecError(DataError):
    """A frame that is no message of the car, or a message that is no frame; `reason` is for counting."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


@record
class CarStatus1:
    """0xA0, table A.2. speed_mps: of the wheels, without direction. power_w: 65.535 means that or more (E-S-31)."""

    motor_current_a: float
    battery_voltage_v: float
    power_w: float
    speed_mps: float


@record
class CarStatus2:
    """0xA1, table A.3: motor voltage and five temperatures."""

    motor_voltage_v: float
    temperature_1_c: float
    temperature_2_c: float
    temperature_3_c: float
    temperature_4_c: float
    temperature_5_c: float


@record
class RemoteValues:
    """0xDB, table A.4: what the driver's remote says, each -1..1.

    throttle: accelerate > 0, brake < 0. steering: left > 0. direction: backward < 0, else forward.
    """

    throttle: float
    steering: float
    direction: float


@record
class TakeOver:
    """0x50 with the magic number, table A.5: the car obeys this and no longer the remote. Values are shares 0..1."""

    mode: DriveMode
    value: float
    steering: SteeringMode = SteeringMode.NONE
    steering_value: float = 0.0


@dataclass(frozen=True)
class GiveBack:
    """0x50 without the magic number: the driver has control again, whatever else the frame holds."""


Message = CarStatus1 | CarStatus2 | RemoteValues | TakeOver | GiveBack


MAGIC_NUMBER = int.from_bytes(MAGIC, "little")

FIELDS: dict[str, tuple[type[Message], dict[str, str]]] = {
    "DeviceID1": (
        CarStatus1,
        {
            "motor_current_a": "AutoMotorCurrent",
            "battery_voltage_v": "AutoBattVoltage",
            "power_w": "AutoPower",
            "speed_mps": "AutoRotationSpeed",
        },
    ),
    "DeviceID2": (
        CarStatus2,
        {"motor_voltage_v": "AutoMotorVoltage", **{f"temperature_{n}_c": f"AutoTemp{n}" for n in range(1, 6)}},
    ),
    "DeviceDBG": (RemoteValues, {"throttle": "RemoteCh1", "steering": "RemoteCh2", "direction": "RemoteCh3"}),
    "MasterID": (
        TakeOver,
        {"mode": "AutoMode", "value": "AutoValue", "steering": "SteeringMode", "steering_value": "SteeringValue"},
    ),
}
"""Messages by their name in the DBC file: our value, and the signal that each of its fields is."""
PERIOD_S = 0.02
"""Of every message that is sent periodically (S-CAN-07); the DBC file says so as well."""
TIMEOUT_S = 0.1
"""Without a take-over for longer than this the car gives control back by itself (E-S-25)."""
_NAMES = {kind: name for name, (kind, _) in FIELDS.items()} | {GiveBack: "MasterID"}
_CONSTANT = {"MasterID": {"Magic": MAGIC_NUMBER, "Reserved": 0}, "DeviceID2": {"AutoReserved": 0}}


@cache
def database() -> Any:
    """Return the messages as cantools knows them, from the DBC file that ships with rangecam."""
    import cantools

    return cantools.database.load_string(files("rangecam.can").joinpath("messages.dbc").read_text("utf-8"), "dbc")


@cache
def _by_identifier() -> dict[int, Any]:
    return {each.frame_id: each for each in database().messages}


@cache
def _limits(name: str) -> dict[str, tuple[float, float, str]]:
    """Return least and greatest value and unit of each signal of a message."""
    signals = database().get_message_by_name(name).signals
    return {each.name: (each.minimum, each.maximum, each.unit or "") for each in signals}


def name_of(message: Message) -> str:
    """Return the name of a message in the DBC file."""
    return _NAMES[type(message)]


def encode(message: Message) -> tuple[int, bytes]:
    """Return identifier and data bytes of a message. Raises CodecError for a value that its bytes cannot hold.

    A power above 65.535 W is sent as that.
    """
    if isinstance(message, GiveBack):
        return MASTER_ID, GIVE_BACK_DATA
    name = name_of(message)
    frame_id, length, bits, signals = _packing(name)
    for field, signal, least, most, to_raw, start, mask in signals:
        value = float(getattr(message, field))
        if signal == "AutoPower":
            value = min(value, most)
        if not least <= value <= most:
            raise _beyond(name, signal, value)
        bits |= (to_raw(value) & mask) << start
    return frame_id, bits.to_bytes(length, "little")


_Packed = tuple[str, str, float, float, Callable[[float], int], int, int]
"""Field, signal, least and greatest value, the scaling of cantools, first bit, as many ones as the signal has bits."""


@cache
def _packing(name: str) -> tuple[int, int, int, list[_Packed]]:
    """Return identifier, bytes and constant bits of a message, and of each field how it is packed, little endian."""
    known = database().get_message_by_name(name)
    signal_of = {each.name: each for each in known.signals}
    bits = sum(value << signal_of[signal].start for signal, value in _CONSTANT.get(name, {}).items())
    packed: list[_Packed] = []
    for field, signal in FIELDS[name][1].items():
        to_raw, its = signal_of[signal].conversion.numeric_scaled_to_raw, signal_of[signal]
        packed.append((field, signal, *_limits(name)[signal][:2], to_raw, its.start, 2**its.length - 1))
    return known.frame_id, known.length, bits, packed


def decode(can_id: int, data: bytes) -> Message:
    """Return the message of a frame. Raises CodecError, and nothing else, for whatever is none."""
    return _decoded(can_id, bytes(data))


@lru_cache(maxsize=256)
def _decoded(can_id: int, data: bytes) -> Message:
    known = _by_identifier().get(can_id)
    if known is None:
        raise CodecError(Reason.UNKNOWN_ID, f"0x{can_id:X} is no message of the car")
    if len(data) != known.length:
        raise CodecError(Reason.LENGTH, f"{known.name} has {known.length} bytes, not {len(data)}")
    if can_id == MASTER_ID and data[6:] != MAGIC:
        return GiveBack()
    values = known.decode(data, decode_choices=False)
    kind, fields = FIELDS[known.name]
    for signal in fields.values():
        _check_range(known.name, signal, values[signal])
    made: dict[str, Any] = {field: values[signal] for field, signal in fields.items()}
    if kind is TakeOver:
        made |= {"mode": DriveMode(made["mode"]), "steering": SteeringMode(made["steering"])}
    return kind(**made)


def _check_range(name: str, signal: str, value: float) -> None:
    least, most, _ = _limits(name)[signal]
    if not least <= value <= most:
        raise _beyond(name, signal, value)


def _beyond(name: str, signal: str, value: float) -> CodecError:
    least, most, unit = _limits(name)[signal]
    allowed = f"{least:g} to {most:g} {unit}".rstrip()
    return CodecError(Reason.RANGE, f"{name}.{signal} = {value:g}: expected {allowed}")
