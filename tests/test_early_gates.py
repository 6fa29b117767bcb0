"""Gates shorter than the pulse, and the pulse sent before gate 2 opens: a scheme of three-tap recordings."""

import os
from pathlib import Path

import numpy as np
import pytest

from rangecam.errors import DataError
from rangecam.io import open_source
from rangecam.pulsed import RANGING

C, CLOCK_S = 299_792_458.0, 2.65e-9
FOLDER = Path(os.environ.get("RANGECAM_DATA", "")) / "pulsed_bec80t"
recorded = pytest.mark.skipif(
    not (FOLDER / "clear_early.npz").is_file(), reason="RANGECAM_DATA does not name a folder with pulsed_bec80t"
)
BOARD = (slice(55, 225), slice(58, 120))  # the board with a house on it, where the image is not rotated


def write(path, **facts):
    taps = {f"tap_{i}": np.full((2, 3), 400.0 + i) for i in (1, 2, 3)}
    np.savez(path, **taps, **{"pulse_width_s": 11 * CLOCK_S, "gate_width_s": 10 * CLOCK_S, **facts})
    return path


def test_the_lead_of_a_file_counts_from_gates_as_long_as_the_pulse(tmp_path):
    """Gate 1 opens when it always does, so gates shorter by one clock open gate 2 one clock earlier."""
    lead_s = open_source(write(tmp_path / "a.npz", pulse_lead_s=3 * CLOCK_S)).config.camera.pulse_lead_s
    assert lead_s == pytest.approx(2 * CLOCK_S)
    assert open_source(write(tmp_path / "b.npz", pulse_lead_s=0.0)).config.camera.pulse_lead_s == 0
    with pytest.raises(DataError, match="the lead must be longer than that"):
        open_source(write(tmp_path / "c.npz", pulse_lead_s=0.5 * CLOCK_S))


def decode(name):
    source = open_source(FOLDER / name)
    capture = next(iter(source.captures))
    return RANGING[source.config.ranging](capture.raw, source.config.camera)


@recorded
def test_both_schemes_see_the_board_at_the_same_range():
    """Within 5 cm up to a common offset, and that offset is less than 1 cm: nothing is fitted here."""
    standard, early = (decode(f"clear_{name}.npz") for name in ("standard", "early"))
    ok = standard.valid[BOARD] & early.valid[BOARD]
    difference_m = (early.range_m - standard.range_m)[BOARD][ok]
    assert ok.mean() > 0.99
    common_m = np.median(difference_m)
    assert abs(common_m) < 0.01
    assert np.abs(difference_m - common_m).max() < 0.05
    spread_m = np.hypot(early.sigma_m, standard.sigma_m)[BOARD][ok]
    assert np.median(np.abs(difference_m - common_m) / spread_m) < 2
