"""Claims about the sensor's registers: what they make the simulated camera do, and which writes are refused."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rangecam.config import load_config, overrides, tree
from rangecam.cw import simulate
from rangecam.cw.register_map import ADDRESSES, PRINTED
from rangecam.cw.registers import (
    FRAME_DELAY_TICK_S,
    HIGHEST_HZ,
    LOWEST_HZ,
    apply,
    encode,
    modulation_hz,
    parse_transfers,
    pll_words,
)
from rangecam.errors import UsageError
from rangecam.geometry import Lens
from rangecam.scene.view import View

CAMERA = load_config("scaled_car").camera
PRESET = [(f"CFGCNT_S{k:02}_PLLSET", 1) for k in range(4)]
EXPOSURE = [(f"CFGCNT_S{k:02}_EXPOTIME", 0x084D) for k in range(4)]


def test_the_printed_list_has_74_writes_of_four_kinds_each_once():
    assert len(PRINTED) == 74  # N-S-053
    assert Counter(name.split("_")[0] for name, _ in PRINTED) == {"ANAIP": 24, "CFGCNT": 47, "MTCU": 1, "PIF": 2}
    assert len(dict(PRINTED)) == 74
    assert all(name in ADDRESSES and 0 <= value <= 0xFFFF for name, value in PRINTED)
    assert len(set(ADDRESSES.values())) == len(ADDRESSES)


def test_the_printed_list_makes_the_camera_of_the_thesis_out_of_another():
    other = replace(CAMERA, modulation_hz=30e6, illumination_time_s=1e-3, rows=144, columns=176, frame_rate_hz=20.0)
    other = replace(other, capture_order=(), lens=replace(CAMERA.lens, horizontal_fov_deg=88, vertical_fov_deg=72))
    camera = apply(PRINTED, other)
    assert (camera.modulation_hz, camera.illumination_time_s) == (17e6, 2e-3)
    assert (camera.rows, camera.columns, camera.binning) == (120, 160, 2)
    assert camera.capture_order == (0, 180, 90, 270)
    assert camera.frame_rate_hz == pytest.approx(30, abs=1e-9)
    assert camera.lens == Lens(horizontal_fov_deg=80, vertical_fov_deg=60, projection="equiangular")


def test_the_thesis_camera_needs_exactly_the_printed_list_and_is_not_changed_by_it():
    assert dict(encode(CAMERA)) == dict(PRINTED)
    assert apply(PRINTED, CAMERA) == CAMERA
    assert apply((), CAMERA) == CAMERA


@hypothesis_settings(max_examples=60, deadline=None)
@given(
    hertz=st.floats(LOWEST_HZ, HIGHEST_HZ),
    second_hz=st.none() | st.sampled_from([12e6, 30e6, 80e6]),
    lit_s=st.floats(1e-4, 3e-3),
    rate_hz=st.floats(5, 15),
    order=st.permutations([0.0, 90.0, 180.0, 270.0]),
    rows=st.integers(2, 72),
    columns=st.integers(2, 88),
    binning=st.sampled_from([1, 2]),
)
def test_what_is_encoded_is_decoded_to_the_rounding_of_the_sensor(
    hertz, second_hz, lit_s, rate_hz, order, rows, columns, binning
):
    several = () if second_hz is None or abs(second_hz - hertz) < 2 else (hertz, second_hz)
    wanted = replace(CAMERA, modulation_hz=hertz, modulations_hz=several, illumination_time_s=lit_s)
    wanted = replace(wanted, frame_rate_hz=rate_hz, capture_order=tuple(order), rows=2 * rows, columns=2 * columns)
    wanted = replace(wanted, binning=binning)
    camera = apply(encode(wanted), CAMERA)
    np.testing.assert_allclose(camera.modulations_hz, several, atol=1)
    assert camera.modulation_hz == pytest.approx(hertz, abs=1)
    assert camera.illumination_time_s == pytest.approx(lit_s, abs=4 / hertz + 1e-9)
    assert 1 / camera.frame_rate_hz == pytest.approx(1 / rate_hz, abs=FRAME_DELAY_TICK_S + 8 * 4 / hertz)
    assert camera.capture_order == tuple(order)
    assert (camera.rows, camera.columns, camera.binning) == (2 * rows, 2 * columns, binning)


@pytest.mark.parametrize("hertz", [2.0833e6, 10e6, 12e6, 17e6, 20e6, 30e6, 60.24e6, 80.32e6, 99.5e6, 100e6])
def test_the_words_of_a_preset_make_the_frequency_that_they_were_made_for(hertz):
    assert modulation_hz(pll_words(hertz)) == pytest.approx(hertz, abs=1)
    assert all(0 <= word <= 0xFFFF for word in pll_words(hertz))


def test_the_words_for_17_and_12_mhz_are_the_printed_ones():
    assert pll_words(17e6) == (0x6449, 0x2762, 0x03F6)
    assert pll_words(12e6) == (0x466D, 0xEC4F, 0x0BC4)


def test_a_preset_with_a_whole_divider_takes_it_from_the_first_word():
    whole = 4 << 13 | 1 << 12 | 1 << 9 | 20 << 2 | 1  # 13 MHz (4/2 + 40 + 4) / 4 / 4
    assert modulation_hz((whole, 0x1234, 0x0000)) == pytest.approx(13e6 * 46 / 16, abs=1)


def frame_of(camera):
    shape = (1, camera.rows, camera.columns)
    view = View(*(np.full(shape, value, np.float32) for value in (1.5, 0.8, 1.0)))
    return simulate(lambda _: view, replace(camera, pseudo_rows=0), 0.0, np.random.default_rng(1))


def amplitude_of(raw):
    re, im = (
        raw.planes[a].astype(float) - raw.planes[b] for a, b in (("phase_0", "phase_180"), ("phase_270", "phase_90"))
    )
    return np.hypot(re, im)[58:62, 78:82].mean() / 2


def test_writing_registers_changes_what_the_simulated_camera_does():
    plain = frame_of(CAMERA)
    shorter = apply(EXPOSURE, CAMERA)
    assert amplitude_of(frame_of(shorter)) == pytest.approx(amplitude_of(plain) / 2, rel=0.05)
    assert 1 / shorter.frame_rate_hz == pytest.approx(1 / 30 - 4 * 1e-3, abs=1e-5)
    faster = apply(PRESET, CAMERA)
    assert faster.modulation_hz == 30e6
    assert faster.illumination_time_s == pytest.approx(2e-3 * 17 / 30)  # the same count of shorter periods
    small = apply(parse_transfers("A888 0068 A889 00B7 8002 0028"), CAMERA)
    assert frame_of(small).shape == (40, 160)
    assert small.lens.vertical_fov_deg == pytest.approx(20)
    slower = apply([("CFGCNT_S03_FRAMERATE", 0x2000)], CAMERA)
    assert 1 / slower.frame_rate_hz - 1 / 30 == pytest.approx(4096 * FRAME_DELAY_TICK_S)
    swapped = apply([("CFGCNT_S01_PS", 0x0444), ("CFGCNT_S02_PS", 0x0888)], CAMERA)
    assert swapped.capture_order == (0, 90, 180, 270)


def test_a_sequence_of_eight_exposures_has_two_frequencies():
    longer = [("CFGCNT_CTRLSEQ", 7), ("CFGCNT_S03_FRAMERATE", 0)]
    for k, code in enumerate((0x0000, 0x0888, 0x0444, 0x0CCC), start=4):
        names = [f"CFGCNT_S{k:02}_{name}" for name in ("EXPOTIME", "FRAMERATE", "PS", "PLLSET")]
        longer += zip(names, (7500, 0x100 * (k == 7), code, 1), strict=True)
    camera = apply(longer, CAMERA)
    assert camera.modulations_hz == (17e6, 30e6)
    assert set(frame_of(camera).planes) == {f"f{f}_phase_{step}" for f in (0, 1) for step in (0, 90, 180, 270)}


def test_the_angle_that_a_region_shows_follows_the_lens():
    half = [("CFGCNT_ROICMINREG", 96), ("CFGCNT_ROICMAXREG", 255), ("PIF_PIFHSIZE", 80)]
    assert apply(half, CAMERA).lens.horizontal_fov_deg == pytest.approx(40)
    straight = replace(CAMERA, lens=Lens(horizontal_fov_deg=80.0))
    shown = apply(half, straight).lens
    assert np.tan(np.radians(shown.horizontal_fov_deg / 2)) == pytest.approx(np.tan(np.radians(40)) / 2)
    assert shown.vertical_fov_deg is None


def test_the_command_line_takes_names_addresses_and_transfers_and_keeps_what_they_set():
    for text in (
        '[["CFGCNT_S03_FRAMERATE", 0x2000]]',
        "[[0xA80D, 0x2000]]",
        '"A80D 2000"',
        '"A80D2000 A80D 2000"',
    ):
        config = load_config("scaled_car", overrides([f"camera.registers={text}"]))
        assert 1 / config.camera.frame_rate_hz == pytest.approx(1 / 30 + 4096 * FRAME_DELAY_TICK_S)
        assert config.camera.registers == ()
        again = load_config("scaled_car", tree(config), {"camera": {"frame_rate_hz": 10.0}})
        assert again.camera.frame_rate_hz == 10


@pytest.mark.parametrize(
    ("writes", "words"),
    [
        ([("CFGCNT_S00_EXPOTIM", 1)], ["unknown register 'CFGCNT_S00_EXPOTIM'", "did you mean 'CFGCNT_S00_EXPOTIME'"]),
        ([(0x1234, 1)], ["unknown register 0x1234"]),
        ([("CFGCNT_TRIG", 0x10000)], ["CFGCNT_TRIG = 65536", "16 bits"]),
        ([("CFGCNT_TRIG", -1)], ["CFGCNT_TRIG = -1"]),
        ("A800 10", ["eight hexadecimal digits"]),
        ("A800 10GG", ["eight hexadecimal digits"]),
        ("", ["eight hexadecimal digits"]),
        ([("CFGCNT_CTRLSEQ", 40)], ["CFGCNT_CTRLSEQ = 0x0028", "0 to 31"]),
        ([("CFGCNT_CTRLSEQ", 7)], ["8 entries", "CFGCNT_S04_EXPOTIME was not written"]),
        ([("CFGCNT_S02_PLLSET", 1)], ["presets [3, 3, 2, 3]", "one frequency after the other"]),
        ([("CFGCNT_S00_PLLSET", 4)], ["CFGCNT_S00_PLLSET = 0x0004", "0 to 3"]),
        ([("CFGCNT_S01_PS", 0x0884)], ["CFGCNT_S01_PS = 0x0884", "three equal digits"]),
        ([("CFGCNT_S01_EXPOTIME", 0x2000)], ["exposures of 2 ms, 3.855 ms", "one for all"]),
        ([(f"CFGCNT_S{k:02}_EXPOTIME", 0) for k in range(4)], ["above 0"]),
        ([("CFGCNT_S01_FRAMERATE", 5)], ["FRAMERATEs [0, 5, 0, 4096]", "last exposure only"]),
        ([("CFGCNT_BINCFG", 7)], ["CFGCNT_BINCFG = 0x0007", "2x2"]),
        ([("CFGCNT_ROICMAXREG", 352)], ["CFGCNT_ROICMAXREG = 352", "within 0 to 351"]),
        ([("CFGCNT_ROIRMINREG", 0x0107)], ["CFGCNT_ROIRMINREG = 263"]),
        ([("CFGCNT_ROICMINREG", 0), ("PIF_PIFHSIZE", 168)], ["region 0 to 335 of 352", "middle"]),
        ([("PIF_PIFVSIZE", 100)], ["PIF_PIFVSIZE = 0x0064", "120"]),
        ([("CFGCNT_BINCFG", 4)], ["PIF_PIFVSIZE = 0x0078", "240"]),
        ([("CFGCNT_PLLCFG1_LUT3", 0x6249)], []),
        ([("CFGCNT_PLLCFG1_LUT3", 0x61FD)], ["422.25 MHz", "2.0833 to 100 MHz"]),
    ],
)
def test_contents_that_the_camera_cannot_follow_are_refused_by_name(writes, words):
    if not words:  # half of the divider by a power of two: 34 MHz is possible
        assert apply(writes, CAMERA).modulation_hz == 34e6
        return
    with pytest.raises(UsageError) as failure:
        apply(writes, CAMERA)
    assert all(word in str(failure.value) for word in words), failure.value


def test_a_region_beyond_what_the_lens_shows_is_refused():
    wide = replace(CAMERA, rows=60, columns=80, lens=replace(CAMERA.lens, horizontal_fov_deg=100))
    with pytest.raises(UsageError, match="200 degrees"):
        apply(PRINTED, wide)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"columns": 200}, ["camera.columns = 200 with binning 2", "352 columns"]),
        ({"rows": 150}, ["camera.rows = 150", "288 rows"]),
        ({"binning": 3}, ["camera.binning = 3"]),
        ({"modulation_hz": 120e6}, ["120 MHz"]),
        ({"modulations_hz": (20e6, 21e6, 22e6, 23e6, 24e6), "frame_rate_hz": 5.0}, ["5 frequencies", "four presets"]),
        ({"phase_steps_deg": (0.0, 120.0, 240.0), "capture_order": ()}, ["120", "22.5 degrees"]),
        (
            {"phase_steps_deg": tuple(22.5 * k for k in range(16)), "modulations_hz": (12e6, 17e6, 30e6)},
            ["48 exposures"],
        ),
        ({"frame_rate_hz": 100.0}, ["frame_rate_hz = 100"]),
        ({"frame_rate_hz": 1.0}, ["frame_rate_hz = 1:"]),
        ({"illumination_time_s": 1e-8}, ["illumination_time_s"]),
        ({"illumination_time_s": 1.0}, ["illumination_time_s = 1"]),
    ],
)
def test_a_camera_that_the_sensor_cannot_be_is_refused(settings, words):
    with pytest.raises(UsageError) as failure:
        encode(replace(CAMERA, **{"capture_order": (), **settings}))
    assert all(word in str(failure.value) for word in words), failure.value
