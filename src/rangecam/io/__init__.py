"""Where frames come from and go to: sources by URL, recordings, exports."""

from rangecam.io.content import Captures, Source
from rangecam.io.exports import ImagesWriter, TracksWriter
from rangecam.io.recorder import Recorder
from rangecam.io.recording import repair
from rangecam.io.sources import open_source

__all__ = ["Captures", "ImagesWriter", "Recorder", "Source", "TracksWriter", "open_source", "repair"]
