"""The registers of the continuous-wave sensor: what a list of writes makes the camera do, and which writes make it so.

The fields of the PLL words are those that are public for the same family of sensors; all three frequencies that the
thesis states confirm them (N-S-021).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rangecam.cw.register_map import ADDRESSES, LAST_ENTRY, NAMES, OF_AN_ENTRY, PRINTED
from rangecam.cw.sequence import exposures, fastest_frame_rate_hz
from rangecam.cw.settings import CwCamera, Register
from rangecam.errors import UsageError, did_you_mean
from rangecam.geometry import Lens

Contents = Mapping[str, int]
"""What stands in the registers, by name."""

SENSOR_ROWS, SENSOR_COLUMNS = 288, 352
PIXEL_CLOCK_HZ, CONVERTER_BITS, WORD_BITS = 66.6e6, 12, 16
"""The parallel interface: 12 bits a pixel, at the high end of the microcontroller's 16 (S-PIF-01)."""
LOWEST_HZ, HIGHEST_HZ = 2.0833e6, 100e6
"""Selectable modulation frequencies (Steinbäck 2016, 3.3.2)."""
FRAME_DELAY_TICK_S = (1 / 30 - 4 * 3.23e-3) / 0x1000
"""Unit of FRAMERATE, *open* (E-S-33): 4.98 us, with which 0x1000 makes the printed 30 frames a second with four
exposures of 2 ms and their read-out; a sister sensor counts 7.68 us (N-S-022)."""

_REFERENCE_HZ = 26e6


def apply(writes: Iterable[Register] | str, camera: CwCamera) -> CwCamera:
    """Return the camera after register writes, in their order; what they do not touch stays as it is.

    writes: pairs of a register (name or 16-bit address) and a 16-bit value; or text: transfers on the bus, each four
    hexadecimal digits of address and four of value. They change modulation frequencies, exposure, frame rate, phase
    steps and their order, size of the image, binning, and with the region of interest the opening angles of the lens.
    Raises UsageError for an unknown register, a value beyond 16 bits, and contents that the camera cannot follow.
    """
    before = dict(encode(camera))
    after = {**before, **_checked(parse_transfers(writes) if isinstance(writes, str) else writes)}
    was, now = _fields(before, camera), _fields(after, camera)
    changed = {key: value for key, value in now.items() if value != was[key]}
    return replace(camera, **changed)


def written(camera: CwCamera) -> CwCamera:
    """Return the camera with `camera.registers` written into it, and none left to write."""
    return replace(apply(camera.registers, camera), registers=())


def parse_transfers(text: str) -> list[tuple[int, int]]:
    """Return the writes of transfers on the bus as text; raises UsageError unless they are whole and hexadecimal."""
    digits = "".join(text.split())
    try:
        words = [int(digits[i : i + 4], 16) for i in range(0, len(digits), 4)]
    except ValueError:
        words = []
    if len(digits) % 8 or len(words) * 4 != len(digits) or not words:
        raise UsageError(
            f"camera.registers = '{text}': expected transfers of eight hexadecimal digits, address and value, "
            "for example A800 109A"
        )
    return list(zip(words[::2], words[1::2], strict=True))


def encode(camera: CwCamera) -> list[tuple[str, int]]:
    """Return the writes that make the sensor do what the settings say: the printed list with other values.

    Times are rounded to the sensor's units. Raises UsageError if the sensor cannot do it.
    """
    contents = dict(PRINTED)
    for k in range(4):
        for name in OF_AN_ENTRY:
            del contents[f"CFGCNT_S{k:02}_{name}"]
    presets = _presets(sorted({each.camera.modulation_hz for each in exposures(camera)}), contents)
    for k, each in enumerate(exposures(camera)):
        hertz = each.camera.modulation_hz
        values = {
            "EXPOTIME": _whole(
                "illumination_time_s", camera.illumination_time_s, camera.illumination_time_s * hertz / 8
            ),
            "FRAMERATE": 0,
            "PS": _phase_code(each.step_deg),
            "PLLSET": presets[hertz],
        }
        contents |= {f"CFGCNT_S{k:02}_{name}": value for name, value in values.items()}
    last = len(exposures(camera)) - 1
    if last > LAST_ENTRY:
        raise UsageError(f"camera: {last + 1} exposures a frame; the sensor makes up to {LAST_ENTRY + 1}")
    pause_s = 1 / camera.frame_rate_hz - 1 / fastest_frame_rate_hz(camera)
    contents[f"CFGCNT_S{last:02}_FRAMERATE"] = _whole(
        "frame_rate_hz", camera.frame_rate_hz, pause_s / FRAME_DELAY_TICK_S
    )
    contents["CFGCNT_CTRLSEQ"] = last
    return list({**contents, **_image_registers(camera)}.items())


def _checked(writes: Iterable[Register]) -> dict[str, int]:
    """Return what stands in the registers that were written, by name; the last write to each counts."""
    contents: dict[str, int] = {}
    for register, value in writes:
        name = NAMES.get(register, "") if isinstance(register, int) else register
        if name not in ADDRESSES:
            raise UsageError(
                f"camera.registers: unknown register {_told(register)}; known are those of cw.registers.ADDRESSES"
            )
        if not 0 <= value <= 0xFFFF:
            raise UsageError(f"camera.registers: {name} = {value}: expected 16 bits, 0 to 0xFFFF")
        contents[name] = value
    return contents


def _fields(contents: Contents, camera: CwCamera) -> dict[str, Any]:
    """Return the settings of the camera that follow from what stands in the registers."""
    return {**_sequence_fields(contents, camera), **_image_fields(contents, camera)}


def _sequence_fields(contents: Contents, camera: CwCamera) -> dict[str, Any]:
    last = contents["CFGCNT_CTRLSEQ"]
    if last > LAST_ENTRY:
        raise _impossible("CFGCNT_CTRLSEQ", last, f"a last entry of 0 to {LAST_ENTRY}")
    missing = [
        f"CFGCNT_S{k:02}_{n}" for k in range(last + 1) for n in OF_AN_ENTRY if f"CFGCNT_S{k:02}_{n}" not in contents
    ]
    if missing:
        raise UsageError(
            f"camera.registers: CFGCNT_CTRLSEQ = {last} asks for {last + 1} entries; {missing[0]} was not written"
        )
    exposure, delay, phase, preset = (
        [contents[f"CFGCNT_S{k:02}_{name}"] for k in range(last + 1)] for name in OF_AN_ENTRY
    )
    hertz = [_preset_hz(contents, k, each) for k, each in enumerate(preset)]
    frequencies = list(dict.fromkeys(hertz))
    order = [_step_deg(k, code) for k, code in enumerate(phase[: len(hertz) // len(frequencies)])]
    each_deg = [_step_deg(k, code) for k, code in enumerate(phase)]
    if each_deg != order * len(frequencies) or hertz != [f for f in frequencies for _ in order]:
        raise UsageError(
            f"camera.registers: phases {each_deg} at presets {[p + 1 for p in preset]}; expected the same phases in "
            "the same order at one frequency after the other"
        )
    times_s = [value * 8 / f for value, f in zip(exposure, hertz, strict=True)]
    if max(times_s) - min(times_s) > max(8 / f for f in hertz) or min(times_s) <= 0:
        listed = ", ".join(f"{t * 1e3:.4g} ms" for t in times_s)
        raise UsageError(f"camera.registers: the EXPOTIMEs make exposures of {listed}; expected one for all, above 0")
    if any(delay[:-1]):
        raise UsageError(f"camera.registers: FRAMERATEs {delay}: expected a pause after the last exposure only")
    fields: dict[str, Any] = {"illumination_time_s": times_s[0]}
    fields |= {"modulation_hz": frequencies[0], "modulations_hz": tuple(frequencies if len(frequencies) > 1 else ())}
    fields |= {"phase_steps_deg": tuple(sorted(order)), "capture_order": tuple(order)}
    period_s = len(times_s) * (times_s[0] + camera.readout_time_s) + delay[-1] * FRAME_DELAY_TICK_S
    return {**fields, "frame_rate_hz": 1 / period_s}


def _image_fields(contents: Contents, camera: CwCamera) -> dict[str, Any]:
    """Return size, binning and opening angles from the region of interest (N-S-023)."""
    code = contents["CFGCNT_BINCFG"]
    if code not in _BINNINGS:
        raise _impossible("CFGCNT_BINCFG", code, "0 or 4 (single pixels) or 5 (2x2)")
    binning, sizes = _BINNINGS[code], []
    for axis, limit, size_register in (("R", SENSOR_ROWS, "PIF_PIFVSIZE"), ("C", SENSOR_COLUMNS, "PIF_PIFHSIZE")):
        first, last = contents[f"CFGCNT_ROI{axis}MINREG"], contents[f"CFGCNT_ROI{axis}MAXREG"]
        if not first < last < limit or (last - first + 1) % binning:
            raise UsageError(
                f"camera.registers: CFGCNT_ROI{axis}MINREG = {first}, CFGCNT_ROI{axis}MAXREG = {last}: expected a "
                f"region within 0 to {limit - 1} of a multiple of {binning}"
            )
        if abs(first - (limit - 1 - last)) > 1:
            raise UsageError(
                f"camera.registers: region {first} to {last} of {limit}: expected one in the middle of the lens' view"
            )
        sizes.append((last - first + 1) // binning)
        if contents[size_register] != sizes[-1]:
            raise _impossible(size_register, contents[size_register], f"{sizes[-1]}, the region after binning")
    lens = _cut_lens(camera.lens, sizes[1] * binning, camera.columns * camera.binning, sizes[0] * binning, camera)
    return {"rows": sizes[0], "columns": sizes[1], "binning": binning, "lens": lens}


_BINNINGS = {0: 1, 4: 1, 5: 2}


def _cut_lens(lens: Lens, width: int, width_before: int, height: int, camera: CwCamera) -> Lens:
    """Return what the lens shows on a region of another size, in pixels of the sensor."""
    horizontal = _cut_angle(lens, lens.horizontal_fov_deg, width / width_before)
    vertical = lens.vertical_fov_deg
    if vertical is not None:
        vertical = _cut_angle(lens, vertical, height / (camera.rows * camera.binning))
    return replace(lens, horizontal_fov_deg=horizontal, vertical_fov_deg=vertical)


def _cut_angle(lens: Lens, fov_deg: float, share: float) -> float:
    if share == 1:
        return fov_deg
    if lens.projection == "equiangular":
        angle = fov_deg * share
    else:
        angle = 2 * math.degrees(math.atan(share * math.tan(math.radians(fov_deg / 2))))
    if angle >= 175:
        raise UsageError(f"camera.registers: this region would show {angle:.0f} degrees through the camera's lens")
    return angle


def _image_registers(camera: CwCamera) -> dict[str, int]:
    if camera.binning not in (1, 2):
        raise UsageError(f"camera.binning = {camera.binning}: the sensor bins 1 or 2 x 2")
    contents = {"CFGCNT_BINCFG": 5 if camera.binning == 2 else 4}
    for axis, size, limit in (("R", camera.rows, SENSOR_ROWS), ("C", camera.columns, SENSOR_COLUMNS)):
        pixels = size * camera.binning
        if pixels > limit:
            what = "rows" if axis == "R" else "columns"
            raise UsageError(f"camera.{what} = {size} with binning {camera.binning}: the sensor has {limit} {what}")
        contents[f"CFGCNT_ROI{axis}MINREG"] = (limit - pixels) // 2
        contents[f"CFGCNT_ROI{axis}MAXREG"] = (limit - pixels) // 2 + pixels - 1
        contents["PIF_PIFVSIZE" if axis == "R" else "PIF_PIFHSIZE"] = size
    return contents


def modulation_hz(words: Sequence[int]) -> float:
    """Return the modulation frequency that the three words of a PLL preset make, to the hertz.

    A quarter of 26 MHz (halved) times a divider in steps of 2^-22, divided by a power of two (N-S-021). Raises
    UsageError if it lies outside the range of the sensor.
    """
    first, low, third = words
    sum_word = (third & 0xFF) << 16 | low
    swallow = (sum_word - (1 << 24) if sum_word >> 23 else sum_word) / 2**21 + 4
    if first >> 12 & 1:
        swallow = first >> 13
    divider = swallow / 2 + 2 * (first >> 2 & 0x7F) + 4
    oscillator_hz = _REFERENCE_HZ / (2 if first & 1 else 1) * divider
    hertz = round(oscillator_hz / 2 ** ((first >> 9 & 7) + 1) / 4)
    return float(_selectable(hertz))


def pll_words(hertz: float) -> tuple[int, int, int]:
    """Return the three words of a PLL preset for a modulation frequency; raises UsageError if there is no such."""
    out_hz = 4 * _selectable(hertz)
    halvings = math.floor(math.log2(4 * HIGHEST_HZ / out_hz)) + 1
    divider = out_hz * 2**halvings / (_REFERENCE_HZ / 2)
    pairs = math.ceil((divider - 3) / 2)  # leaves 1 to 3 for the part in fractions
    swallow = 2 * (divider - 2 * pairs)
    sum_word = round((swallow - 4) * 2**21) & 0xFFFFFF
    oscillator_hz = out_hz * 2**halvings
    pump = 0 if oscillator_hz < 570e6 else 1 if oscillator_hz < 800e6 else 2
    first = int(swallow) << 13 | (halvings - 1) << 9 | (pairs - 2) << 2 | 1
    return first, sum_word & 0xFFFF, pump << 11 | 0b11 << 8 | sum_word >> 16


def _selectable(hertz: float) -> float:
    if not LOWEST_HZ <= hertz <= HIGHEST_HZ:
        raise UsageError(
            f"modulation frequency {hertz / 1e6:g} MHz: the sensor has {LOWEST_HZ / 1e6:g} to {HIGHEST_HZ / 1e6:g} MHz"
        )
    return hertz


def _presets(needed_hz: Sequence[float], contents: dict[str, int]) -> dict[float, int]:
    """Return the preset (0 to 3) of each frequency, written over one that nobody needs where none has it."""
    there = {_preset_hz(contents, 0, k): k for k in range(4)}
    free = [k for hertz, k in there.items() if hertz not in needed_hz]
    if len(needed_hz) > 4:
        raise UsageError(f"camera.modulations_hz: {len(needed_hz)} frequencies; the sensor has four presets")
    for hertz in needed_hz:
        if hertz not in there:
            there[hertz] = free.pop()
            words = pll_words(hertz)
            contents |= {f"CFGCNT_PLLCFG{i}_LUT{there[hertz] + 1}": word for i, word in enumerate(words, start=1)}
    return there


def _preset_hz(contents: Contents, entry: int, preset: int) -> float:
    if preset > 3:
        raise _impossible(f"CFGCNT_S{entry:02}_PLLSET", preset, "0 to 3, the preset less one")
    return modulation_hz([contents[f"CFGCNT_PLLCFG{i}_LUT{preset + 1}"] for i in (1, 2, 3)])


def _phase_code(step_deg: float) -> int:
    """Return the PS code: the step in sixteenths of a turn in each of three digits (E-S-13)."""
    sixteenths = step_deg / 22.5
    if sixteenths != int(sixteenths):
        raise UsageError(f"camera.phase_steps_deg: {step_deg:g}; the sensor makes multiples of 22.5 degrees")
    return int(sixteenths) * 0x111


def _step_deg(entry: int, code: int) -> float:
    if code != (code & 0xF) * 0x111:
        raise _impossible(f"CFGCNT_S{entry:02}_PS", code, "three equal digits, for example 0x0444 for 90 degrees")
    return (code & 0xF) * 22.5


def _whole(key: str, value: float, counts: float) -> int:
    """Return a register's value for a setting; raises UsageError if it does not fit."""
    if not 0 <= round(counts) <= 0xFFFF or (key == "illumination_time_s" and round(counts) == 0):
        raise UsageError(f"camera.{key} = {value:g}: the register would hold {counts:.4g}; it has 16 bits")
    return round(counts)


def _told(register: str | int) -> str:
    return f"0x{register:04X}" if isinstance(register, int) else f"'{register}'{did_you_mean(register, ADDRESSES)}"


def _impossible(register: str, value: int, expected: str) -> UsageError:
    return UsageError(f"camera.registers: {register} = 0x{value:04X}: expected {expected}")
