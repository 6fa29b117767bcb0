"""One HTML page about a run that opens offline: what the camera saw, how one frame was understood, when it braked.

`Report` is a sink; the pictures are in `figures.py`, the frame of the page in `template.py`.
"""

from rangecam.report.page import Report

__all__ = ["Report"]
