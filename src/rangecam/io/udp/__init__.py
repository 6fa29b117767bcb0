"""Frames over UDP, byte for byte as the debug stream of Steinbäck 2016, 4.3.4: see docs/stream.md.

- packets: what a frame looks like on the wire, and how much of the wire it takes
- modes: which images of a frame travel, and what a receiver makes of them
- assembly: from packets back to frames, whatever the network does to them
- sender: a sink that streams; receiver, source: a socket with its thread, and the source udp://HOST:PORT
"""

from rangecam.io.udp.modes import MODES
from rangecam.io.udp.sender import Stream, paced
from rangecam.io.udp.source import open_udp

__all__ = ["MODES", "Stream", "open_udp", "paced"]
