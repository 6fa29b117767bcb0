"""Ranging and cleaning in integers, step by step as on the microcontroller (Steinbäck 2016, algs 4.1 and 4.2).

Words of 16 bits come in, whole millimetres go out; a discarded pixel is the marker inside and a `Why` at the edge.
What the thesis does not say is chosen here and named *open*: angles in 2^-27 rad, thresholds and cosines in 2^-15;
every product is cut, but for the camera angle conversion, which rounds. No product has more than 64 bits.
- program: the constant tables of a camera
- chain: the loops of the microcontroller
- edge: samples to words, and millimetres to a range image
"""

from rangecam.cw.fixed_point.edge import cw_emulation

__all__ = ["cw_emulation"]
