"""Files that appear whole or not at all, and the check of their names before anything is computed."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rangecam.errors import UsageError


def check_source(path: Path | str) -> Path:
    """Return `path` if it is a file that can be read; raises UsageError if not."""
    path = Path(path)
    if not path.exists():
        raise UsageError(f"{path}: there is no such file")
    if not path.is_file():
        raise UsageError(f"{path}: not a file; a recording is one file")
    if not os.access(path, os.R_OK):
        raise UsageError(f"{path}: no permission to read it")
    return path


def check_target(path: Path | str, source: str = "") -> Path:
    """Return `path` if a file can be written there; raises UsageError if not, or if it is the file `source` being read.

    A file is made in the folder to see that it can be, and is gone at once. Devices and pipes are refused: a finished
    file takes the place of what was there, which would be the device itself.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise UsageError(f"cannot write {path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise UsageError(f"cannot write {path}: it is a folder; name a file")
    if path.exists() and not path.is_file():
        raise UsageError(f"cannot write {path}: it is a device or a pipe; name a file")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise UsageError(f"cannot write {path}: no permission")
    if source and path.exists() and Path(source).exists() and path.samefile(source):
        raise UsageError(f"cannot write {path}: it is the file that is read; name another file")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            return path
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror or error}") from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Lend a temporary path beside `path`: it takes the place of `path` if the block ends well, else it is removed."""
    part = path.with_name(f".{path.name}-{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
