"""The bit pattern and the sequencer that executes it (König 2008, 4.1.1.5)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangecam.config import load_config
from rangecam.errors import UsageError
from rangecam.pulsed import RANGING, PulsedCamera, simulate
from rangecam.pulsed.bit_pattern import Sequencer, cycle_of, execute, table_of
from rangecam.pulsed.settings import Pixel
from rangecam.pulsed.signal import shutter_windows, switch_times
from rangecam.scene.view import View

CLOCK_S = 30e-9
SEQUENCER = Sequencer()
SILENT = Pixel(photon_noise=False, adc_bits=0, sensor_noise_v=0.0, readout_noise_v=0.0)
CAMERA = PulsedCamera(speed_of_light_mps=3e8, pixel=SILENT)
TABLE = table_of((0.0, 180e-9), SEQUENCER)


def changed(signal, step, level="1", table=TABLE):
    """The table with one level changed."""
    rows = list(table)
    rows[signal] = rows[signal][:step] + level + rows[signal][step + 1 :]
    return tuple(rows)


@given(
    opens=st.integers(-20, 40), width=st.integers(1, 40), reset=st.integers(1, 6), transfer=st.integers(1, 6),
    clock_s=st.sampled_from([10e-9, 30e-9]),
)  # fmt: skip
def test_what_the_sequencer_does_with_a_table_is_what_it_was_made_for(opens, width, reset, transfer, clock_s):
    """Round trip: settings to table to times."""
    sequencer = Sequencer(clock_step_s=clock_s, reset_steps=reset, transfer_steps=transfer)
    window_s = (opens * clock_s, (opens + width) * clock_s)
    cycle = execute(table_of(window_s, sequencer), clock_s)
    np.testing.assert_allclose(cycle.window_s, window_s, atol=1e-15)
    assert cycle.off_after_s * 2 < cycle.length_s + 1e-12
    np.testing.assert_allclose(cycle_of(window_s, sequencer).window_s, window_s, atol=1e-15)


def test_the_levels_are_those_of_a_cycle():
    """Reset, exposure with the laser, four transfers to the sample; the same without the laser to the accumulator."""
    reset, select, hold, sample, accumulate, end, shutter, laser = TABLE
    assert laser.count("1") == 1
    assert laser.index("1") == shutter.index("1") == 4
    assert shutter.split("0")[4] == "111111"
    assert shutter.count("1") == 12
    assert reset.count("1") == 8
    assert select.count("01") == 8  # four pixels of a half column share a read-out stage
    assert hold.count("1") == 2
    assert sample.index("1") < accumulate.index("1")
    assert end.endswith("01")
    assert execute(TABLE, CLOCK_S).off_after_s == pytest.approx(27 * CLOCK_S)


def test_times_between_the_steps_need_the_delay_of_the_laser():
    """N-K-093: one step is 4.5 m."""
    with pytest.raises(UsageError, match=r"2e-07 s: the bit pattern has steps of 3e-08 s, the nearest is 2\.1e-07"):
        table_of((0.0, 200e-9), SEQUENCER)
    np.testing.assert_allclose(cycle_of((10e-9, 200e-9), SEQUENCER).window_s, (0.0, 210e-9), atol=1e-15)


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        (TABLE[:7], "must be 8 strings"),
        ((*TABLE[:7], "01"), "must be 8 strings"),
        ((*TABLE[:7], TABLE[7].replace("1", "2")), "must be 8 strings"),
        (changed(0, 5), "Phi1 resets the pixel while Phi7 collects"),
        (changed(6, 14), "Phi7 collects before Phi1 has reset"),
        (changed(7, 2), "the laser is triggered 2 times"),
        (changed(7, 4, "0"), "the laser is triggered 0 times"),
        ((*TABLE[:3], "0" * len(TABLE[0]), *TABLE[4:]), "not sampled with Phi4"),
        ((*TABLE[:4], "0" * len(TABLE[0]), *TABLE[5:]), "not accumulated with Phi5"),
        (changed(6, 6, "0"), "opens more than once"),
        (changed(6, 4, "0"), "not equally long"),
        ((*TABLE[:4], TABLE[3], *TABLE[5:]), "laser on is accumulated again"),
    ],
)
def test_a_table_that_the_circuit_could_not_use_is_refused_with_the_reason(table, reason):
    with pytest.raises(UsageError, match=rf"(?s)camera\.sequencer\.table_a.*{reason}"):
        switch_times(replace(CAMERA, sequencer=Sequencer(table_a=table)))


def wall(range_m, camera):
    ones = np.ones((1, camera.rows, camera.columns))
    return lambda time_s: View(ones * range_m, ones * 0.5, ones)


def shoot(camera, range_m=9.0):
    return simulate(wall(range_m, camera), camera, 0.0, np.random.default_rng(0))


def test_the_camera_with_the_tables_of_its_own_windows_takes_the_same_frames():
    """K-PIX-12."""
    times = switch_times(CAMERA)
    tables = {f"table_{name}": table_of(times[name], SEQUENCER) for name in "abc"}
    camera = replace(CAMERA, shutters="abc", frame_rate_hz=30.0)
    by_table = replace(camera, sequencer=Sequencer(**tables))
    ours, theirs = shoot(camera), shoot(by_table)
    for name in ours.planes:
        np.testing.assert_allclose(ours.planes[name], theirs.planes[name], rtol=1e-6, atol=1e-9)


def test_another_table_is_another_window_and_the_range_knows():
    """Both windows one step later: near light is lost from b to a, the range of the quotient begins 4.5 m later."""
    tables = {
        f"table_{name}": table_of((opens + CLOCK_S, closes + CLOCK_S), SEQUENCER)
        for name, (opens, closes) in switch_times(CAMERA).items()
    }
    later = replace(CAMERA, sequencer=Sequencer(**tables))
    assert shutter_windows(later)["b"] == pytest.approx((210e-9, 390e-9))
    assert (shoot(later).planes["shutter_a"] > shoot(CAMERA).planes["shutter_a"]).all()
    np.testing.assert_allclose(RANGING["mdsi3"](shoot(later, 12.0), later).range_m, 12.0, atol=1e-4)
    np.testing.assert_allclose(
        shutter_windows(later)["a"], shutter_windows(replace(CAMERA, shutter_delay_s=CLOCK_S))["a"]
    )


def test_a_finer_shift_is_that_of_the_laser():
    """K-PIX-13: the delay component moves the pulse against the windows by less than a step."""
    tables = {f"table_{name}": table_of(times, SEQUENCER) for name, times in switch_times(CAMERA).items()}
    camera = replace(CAMERA, sequencer=Sequencer(**tables), laser_delay_s=7e-9)
    np.testing.assert_allclose(RANGING["mdsi3"](shoot(camera), camera).range_m, 9.0, atol=1e-4)
    assert (shoot(camera).planes["shutter_b"] > shoot(CAMERA).planes["shutter_b"]).all()


def test_tables_come_from_a_configuration():
    config = load_config("usercams", {"camera": {"sequencer": {"table_a": list(TABLE), "clock_step_s": 60e-9}}})
    assert switch_times(config.camera)["a"] == pytest.approx((0.0, 360e-9))
