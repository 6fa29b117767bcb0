"""Kernels on disk: what they are made of may change, and is then compiled anew."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

from rangecam import types

HEAD = "from rangecam.compiled import kernel\n\n\n"
INNERMOST = HEAD + "@kernel\ndef innermost(x: float) -> float:\n    return {factor} * x\n"
INNER = (
    "from innermost_part import innermost\n"
    + HEAD
    + "@kernel\ndef inner(x: float) -> float:\n    return innermost(x)\n"
)
OUTER = "from inner_part import inner\n" + HEAD + "@kernel\ndef outer(x: float) -> float:\n    return inner(x) + 1\n"


def freshly_imported(folder: Path, factor: str) -> ModuleType:
    """The outermost of three modules, as a new process would see them."""
    for name, text in (
        ("innermost_part", INNERMOST.format(factor=factor)),
        ("inner_part", INNER),
        ("outer_part", OUTER),
    ):
        (folder / f"{name}.py").write_text(text)
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    return importlib.import_module("outer_part")


def test_a_kernel_is_compiled_anew_when_the_columns_of_the_tracks_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    assert freshly_imported(tmp_path, "2").outer(3.0) == 7.0
    (tmp_path / "types.py").write_text("MEMORY = ()\n")
    monkeypatch.setattr(types, "__file__", str(tmp_path / "types.py"))
    again = freshly_imported(tmp_path, "2")
    assert again.outer(3.0) == 7.0
    assert sum(again.outer.stats.cache_hits.values()) == 0


def test_a_kernel_is_compiled_anew_when_one_that_it_takes_in_from_another_file_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    assert freshly_imported(tmp_path, "2").outer(3.0) == 7.0
    again = freshly_imported(tmp_path, "2")
    assert again.outer(3.0) == 7.0
    assert sum(again.outer.stats.cache_hits.values()) == 1
    assert freshly_imported(tmp_path, "10").outer(3.0) == 31.0
