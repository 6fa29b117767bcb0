"""What the microcontroller's program is set to: the constants of its source code (Steinbäck 2016, 4.5)."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.settings import Fraction, Positive, PositiveInt, settings


@settings
class Emulation:
    """The constants of the integer chain `cw_emulation`; *open* where the thesis names no value."""

    word_shift: Annotated[int, Interval(ge=0, le=15)] = 4
    """Places by which a sample moves up into a word of 16 bits: 4 for the sensor's 12 bits at the high end of the
    camera interface (S-PIF-01), 0 for recordings of such words."""
    speed_of_light_mps: Positive = 3e8
    """With which the range factor was computed: 3e8 makes the distances of 0 to 8823 mm (N-S-003), 0.07 % too long."""
    angles: Literal["table", "lens"] = "table"
    """Angles of the pixels for the camera angle conversion: table: equal steps from the middle of the image, a cosine
    table for rows and columns (Steinbäck 2016, eqs 3.15-3.16, N-S-027); lens: those of the lens (S-PRE-02)."""
    amplitude_threshold: Fraction = 0.01
    """A pixel weaker than this part of the reference amplitude is discarded (c_th1, eq 3.17); 0: none; *open*."""
    wrap_threshold: Fraction = 0.05
    """A pixel whose amplitude times squared distance is below this part of the reference is discarded (c_th2, eq 3.18);
    0: none; *open*."""
    common_neighbours: Annotated[int, Interval(ge=0, le=8)] = 3
    """A pixel with fewer common neighbours of 8 is discarded (T_1 + 1, eq 2.8); 0: none; *open*."""
    neighbour_tolerance_mm: PositiveInt = 100
    """Common neighbours differ by no more than this (T_2, eq 2.9); *open*."""
    median: bool = True
    """3x3 median over the pixels that were not discarded, with the upper one of two in the middle; *open*: which."""
    fill_holes: bool = False
    """Let the median give discarded pixels a value, too, where it finds any; *open*: the thesis does not say."""
    border: Literal["discard", "keep"] = "discard"
    """What becomes of the outermost rows and columns, which both filters pass over; *open*: `discard` marks them,
    `keep` leaves them as the thresholds did."""
    marker_mm: Annotated[int, Interval(gt=0, le=65535)] = 12500
    """The distance that says discarded; it must lie beyond the unambiguous range (E-S-20: 65535 at 12 MHz and less)."""
