"""Milliseconds a stage and a chain, beside peers in the same process: `rangecam bench`.

- race: how two functions are timed against each other
- peers: the same steps written with OpenCV, NumPy and FilterPy
- unwrapping_peer: the same for several modulation frequencies
- works: what is measured
"""

from rangecam.bench.works import measure, table

__all__ = ["measure", "table"]
