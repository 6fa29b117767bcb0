"""The rules of ARCHITECTURE.md that a program can check."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "src" / "rangecam"
MODULES = sorted(PACKAGE.rglob("*.py"))
BEFORE_THE_WAIST = ("rangecam.pulsed", "rangecam.cw", "rangecam.processed", "rangecam.cameras", "rangecam.scene")
# Those who put the chain together, or stand before the waist themselves, may know the families.
COMPOSERS = {
    "pipeline.py": "chooses the ranging method",
    "config.py": "puts the settings of all modules together",
    "io/sources.py": "opens simulated scenarios as a source",
    "bench/works.py": "measures the families' stages beside peers",
}
# Studies, designs and training characterise the families, drives simulate the whole; nothing of the chain imports them.
FORWARD = ("pulsed/", "cw/", "processed", "cameras/", "scene/", "studies/", "design/", "training/", "drive/")


def imports(path: Path) -> set[str]:
    """Return every module that a file imports, at its top or inside a function."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), filename=str(path))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def after_the_waist() -> list[Path]:
    names = [(path, path.relative_to(PACKAGE).as_posix()) for path in MODULES]
    return [path for path, name in names if not name.startswith(FORWARD) and name not in COMPOSERS]


@pytest.mark.parametrize("path", after_the_waist(), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_no_module_after_the_waist_knows_a_camera_family(path: Path) -> None:
    known = {name for name in imports(path) if name.startswith(BEFORE_THE_WAIST)}
    assert not known, f"{path} imports {known}: after RangeImage nobody may know which family of camera it was"


@pytest.mark.parametrize(
    "name", ["clean", "segmentation", "tracking", "motion", "classify", "collision", "brake", "report"]
)
def test_the_waist_is_watched_on_both_sides(name: str) -> None:
    watched = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in after_the_waist()}
    assert name in watched


def test_a_module_that_imports_a_family_would_be_noticed(tmp_path: Path) -> None:
    module = tmp_path / "clean.py"
    module.write_text("def f():\n    from rangecam import cw\n    from rangecam.pulsed.ranging import RANGING\n")
    assert {name for name in imports(module) if name.startswith(BEFORE_THE_WAIST)} >= {
        "rangecam.cw",
        "rangecam.pulsed.ranging",
    }


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_only_config_imports_pydantic(path: Path) -> None:
    if path.name != "config.py":
        assert not {name for name in imports(path) if name.split(".")[0] == "pydantic"}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_no_library_module_prints_or_exits_or_reads_the_clock_or_a_global_generator(path: Path) -> None:
    at_the_edge = path.parent.name == "cli" or path.name == "__main__.py"
    clocks = {"summary.py", "race.py", "can.py"}
    text = ast.parse(path.read_text(encoding="utf-8"))
    calls = {ast.unparse(node.func) for node in ast.walk(text) if isinstance(node, ast.Call)}
    if not at_the_edge:
        assert not calls & {"print", "exit", "sys.exit", "os._exit"}
    if path.name not in clocks:
        assert not calls & {"time.time", "time.perf_counter", "time.monotonic", "datetime.now", "datetime.datetime.now"}
    assert not {
        c for c in calls if c.startswith("np.random.") and c not in {"np.random.default_rng", "np.random.SeedSequence"}
    }


def test_process_frame_stays_under_forty_lines() -> None:
    tree = ast.parse((PACKAGE / "pipeline.py").read_text())
    function = next(n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == "process_frame")
    assert function.end_lineno is not None
    assert function.end_lineno - function.lineno < 40


def test_help_needs_neither_numba_nor_scipy_nor_matplotlib() -> None:
    code = (
        "import sys, rangecam.cli; print([m for m in ('numba', 'scipy', 'matplotlib', 'pydantic') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_every_public_function_and_class_says_what_it_is() -> None:
    silent = []
    for path in MODULES:
        module = ast.parse(path.read_text(encoding="utf-8"))
        inside = [node for one in ast.walk(module) if isinstance(one, ast.ClassDef) for node in one.body]
        for node in [*module.body, *inside]:
            named = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
            named = named and "overload" not in map(ast.unparse, node.decorator_list)
            if named and not ast.get_docstring(node):
                silent.append(f"{path.relative_to(PACKAGE)}:{node.lineno} {node.name}")
    assert not silent


def kernels_of(path: Path) -> dict[str, str]:
    """Return the compiled functions of a file, and how each is marked."""
    marked = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        for each in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
            if ast.unparse(each).startswith(("njit", "kernel")):
                marked[node.name] = ast.unparse(each)
    return marked


def test_a_file_whose_kernels_use_those_of_another_marks_all_as_kernel() -> None:
    everywhere = {path: kernels_of(path) for path in MODULES}
    modules = {".".join(("rangecam", *path.relative_to(PACKAGE).with_suffix("").parts)): path for path in MODULES}
    stale = []
    for path, kernels in everywhere.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        froms = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module in modules]
        foreign = {a.asname or a.name for f in froms for a in f.names if a.name in everywhere[modules[str(f.module)]]}
        bodies = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name in kernels]
        used = {name.id for body in bodies for name in ast.walk(body) if isinstance(name, ast.Name)} & foreign
        if used and any(mark.startswith("njit") for mark in kernels.values()):
            stale.append(f"{path.relative_to(PACKAGE)}: {sorted(used)}")
    assert not stale
