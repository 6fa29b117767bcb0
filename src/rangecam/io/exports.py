"""What a run leaves for other programs: images as a NumPy file, tracks as a table. Both are sinks of `pipeline.run`.

Frames wait in unnamed temporary files, so that a long recording does not fill the memory; the output appears whole
when the writer is closed, and not at all after an error.
"""

import csv
import io
import shutil
import tempfile
import zipfile
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from numpy.lib import format as npy

from rangecam.config import Config
from rangecam.errors import DataError
from rangecam.io.files import check_target, replacing
from rangecam.types import CLASSES, Capture, Frame, TrackStatus

IMAGES = {
    "range_m": np.float32,
    "sigma_m": np.float32,
    "amplitude": np.float32,
    "valid": np.bool_,
    "why": np.uint8,
}
"""Images of each frame in the NumPy file, (N, H, W) each, and their types."""
COLUMNS = (
    *("time_s", "track_id", "x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps", "ax_mps2", "ay_mps2", "az_mps2"),
    *("sigma_x_m", "sigma_vx_mps", "width_m", "height_m", "class", "p_class", "ttc_s", "ttc_sigma_s", "p_collision"),
)
"""Columns of the table of tracks."""


class _Export(ABC):
    """A sink whose file appears when it is left without an error; what was kept for it is given back in any case."""

    @abstractmethod
    def close(self) -> None:
        """Write the file."""

    @abstractmethod
    def _release(self) -> None:
        """Give back the temporary files."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.close()
        finally:
            self._release()


class ImagesWriter(_Export):
    """Writes the range images of all frames to a NumPy file: `IMAGES` and time_s (N,).

    Raises UsageError at once if `path` cannot be written or is the file `source` that is read.
    """

    def __init__(self, path: Path | str, config: Config | None = None, source: str = "") -> None:
        self._path = check_target(path, source)
        self._parts: dict[str, IO[bytes]] = {
            name: tempfile.TemporaryFile(dir=self._path.parent)  # noqa: SIM115 (closed by __exit__)
            for name in IMAGES
        }
        self._times: list[float] = []
        self._shape = (0, 0)

    def write(self, capture: Capture, frame: Frame) -> None:
        """Take in one frame; raises DataError if its size differs from that of the first."""
        if self._times and frame.image.shape != self._shape:
            raise DataError(
                f"cannot write {self._path}: frame {len(self._times)} has shape {frame.image.shape}, "
                f"the ones before have {self._shape}"
            )
        self._shape = frame.image.shape
        self._times.append(frame.image.time_s)
        for name, kind in IMAGES.items():
            self._parts[name].write(np.ascontiguousarray(getattr(frame.image, name), kind).tobytes())

    def close(self) -> None:
        """Write the file; a second time does nothing."""
        if all(part.closed for part in self._parts.values()):
            return
        shape = (len(self._times), *self._shape)
        with replacing(self._path) as path, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            for name, kind in IMAGES.items():
                self._parts[name].seek(0)
                with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                    _write_header(member, shape, np.dtype(kind))
                    shutil.copyfileobj(self._parts[name], member, 1 << 20)
            with file.open("time_s.npy", "w") as member:
                npy.write_array(member, np.array(self._times, np.float64))
        self._release()

    def _release(self) -> None:
        for part in self._parts.values():
            part.close()


def _write_header(file: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    npy.write_array_header_1_0(file, header)


class TracksWriter(_Export):
    """Writes a table (CSV) with a row for each frame and track that is confirmed or, unseen for a while, coasting.

    Numbers read back exactly; inf and nan stand where there is no time to collision.
    Raises UsageError at once if `path` cannot be written or is the file `source` that is read.
    """

    def __init__(self, path: Path | str, config: Config | None = None, source: str = "") -> None:
        self._path = check_target(path, source)
        self._part = tempfile.TemporaryFile(dir=self._path.parent)  # noqa: SIM115 (closed by __exit__)
        self._text = io.TextIOWrapper(self._part, "utf-8", newline="")
        self._table = csv.writer(self._text, lineterminator="\n")
        self._table.writerow(COLUMNS)

    def write(self, capture: Capture, frame: Frame) -> None:
        """Take in one frame."""
        collisions = frame.decision.collisions
        for i, track in enumerate(frame.tracks):
            if track.status == TrackStatus.TENTATIVE:
                continue
            numbers = (
                *(*track.position_m, *track.velocity_mps, *track.acceleration_mps2),
                *np.sqrt(track.covariance.diagonal()[:2]),
                *track.size_m[1:],
            )
            best = int(np.argmax(track.class_probability))
            chances = (track.class_probability[best], collisions.ttc_s[i], collisions.ttc_sigma_s[i])
            self._table.writerow(
                [
                    repr(float(frame.image.time_s)),
                    track.track_id,
                    *(repr(float(number)) for number in numbers),
                    CLASSES[best],
                    *(repr(float(number)) for number in (*chances, collisions.p_collision[i])),
                ]
            )

    def close(self) -> None:
        """Write the file; a second time does nothing."""
        if self._text.closed:
            return
        self._text.flush()
        self._part.seek(0)
        with replacing(self._path) as path, path.open("wb") as file:
            shutil.copyfileobj(self._part, file, 1 << 20)
        self._text.close()

    def _release(self) -> None:
        self._text.close()
