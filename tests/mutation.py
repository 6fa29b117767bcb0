"""Mutation test of the safety core: `python tests/mutation.py [MODULE[:FUNCTION] ...]`, for the night (an hour).

Every comparison, constant, operator, negation and branch of a module is changed, one at a time, in memory; the module's
tests must then fail. What survives is printed, and is an error unless it stands in `tests/mutants_accepted.txt`
(equivalent mutants, each with its reason). Each mutant runs in a forked process, so that libraries are imported once.
"""

import ast
import copy
import importlib.abc
import importlib.machinery
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCE, TESTS = ROOT / "src" / "rangecam", ROOT / "tests"
VALUES = "test_brake_values.py"
TARGETS = {
    "brake.machine": [VALUES, "test_brake_machine.py", "test_brake_gate.py"],
    "brake.unit": [VALUES, "test_brake_gate.py", "test_brake_health.py"],
    "brake.decision": ["test_brake.py", "test_brake_probability.py"],
    "brake.probability": ["test_brake_probability.py"],
    "brake.rule": ["test_brake.py", "test_brake_probability.py"],
    "brake.gate": [VALUES, "test_brake_gate.py"],
    "brake.health": [VALUES, "test_brake_health.py"],
    "brake.friction": [VALUES, "test_brake_health.py", "test_brake_gate.py"],
    "can.codec": [VALUES, "test_can.py"],
}
LIMIT_S = 60
"""A mutant that runs longer than this loops, and counts as found. The module itself may run five times as long: others
may need the machine, too, and kernels may have to be compiled."""
COMPARE = {
    ast.Lt: [ast.LtE, ast.GtE],
    ast.LtE: [ast.Lt, ast.Gt],
    ast.Gt: [ast.GtE, ast.LtE],
    ast.GtE: [ast.Gt, ast.Lt],
    ast.Eq: [ast.NotEq],
    ast.NotEq: [ast.Eq],
    ast.Is: [ast.IsNot],
    ast.IsNot: [ast.Is],
}
BINARY = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitAnd: ast.BitOr}
KERNEL = re.compile(r"njit|kernel")
Change = Callable[[ast.AST], None]


def set_field(name: str, value: object) -> Change:
    return lambda node: setattr(node, name, value)


def changes(node: ast.AST) -> Iterator[tuple[str, Change]]:
    """Yield what can be changed of one node: a word for it, and a function that does it to a copy."""
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            for other in COMPARE.get(type(operator), []):
                ops = [*node.ops[:i], other(), *node.ops[i + 1 :]]
                yield f"{type(operator).__name__} -> {other.__name__}", set_field("ops", ops)
    if isinstance(node, ast.BoolOp):
        other_bool = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "and <-> or", set_field("op", other_bool)
        for i in range(len(node.values)):
            yield f"without term {i}", set_field("values", node.values[:i] + node.values[i + 1 :])
    if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
        yield "operator", set_field("op", BINARY[type(node.op)]())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        if isinstance(node.op, ast.Not):
            yield "without not", set_field("operand", ast.UnaryOp(ast.Not(), node.operand))
        else:
            yield "without minus", set_field("op", ast.UAdd())
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "constant", set_field("value", not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield "constant", set_field("value", node.value + 1)
    if isinstance(node, ast.If | ast.IfExp):
        for value in (True, False):
            yield f"if {value}", set_field("test", ast.Constant(value))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("min", "max"):
        yield "min <-> max", set_field("func", ast.Name("max" if node.func.id == "min" else "min", ast.Load()))
    if isinstance(node, ast.Call) and node.keywords and isinstance(node.func, ast.Name) and node.func.id == "replace":
        for i in range(len(node.keywords)):
            yield f"without {node.keywords[i].arg}", set_field("keywords", node.keywords[:i] + node.keywords[i + 1 :])


def mutants(tree: ast.Module) -> Iterator[tuple[str, ast.Module]]:
    """Yield every mutant with its name; settings are left out, for their defaults are choices."""
    places = []
    for top in tree.body:
        of_settings = isinstance(top, ast.ClassDef) and any(ast.unparse(d) == "settings" for d in top.decorator_list)
        if isinstance(top, ast.FunctionDef | ast.ClassDef) and not of_settings:
            name = top.name
            places += [(name, node) for node in ast.walk(top)]
    numbers = {id(node): n for n, node in enumerate(ast.walk(tree))}
    for name, node in places:
        for word, change in changes(node):
            mutant = copy.deepcopy(tree)
            target = next(each for n, each in enumerate(ast.walk(mutant)) if n == numbers[id(node)])
            change(target)
            text = ast.unparse(node).splitlines()[0]
            yield f"{name}: {text}: {word}", ast.fix_missing_locations(mutant)


class Substitute(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the mutant in place of the module."""

    def __init__(self, name: str, tree: ast.Module, path: Path) -> None:
        self.name, self.tree, self.path = name, tree, path

    def find_spec(self, name, path=None, target=None):
        if name == self.name:
            return importlib.machinery.ModuleSpec(name, self, origin=str(self.path))
        return None

    def exec_module(self, module):
        module.__file__ = str(self.path)
        exec(compile(self.tree, str(self.path), "exec"), module.__dict__)


def parsed(path: Path) -> ast.Module:
    """Return a module whose kernels are plain functions: kept on disk, they would not see that a constant changes."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for top in tree.body:
        if isinstance(top, ast.FunctionDef):
            top.decorator_list = [each for each in top.decorator_list if not KERNEL.match(ast.unparse(each))]
    return tree


def survives(name: str, tree: ast.Module, path: Path, tests: list[str], limit_s: int = LIMIT_S) -> bool:
    """Return whether the tests pass with the mutant, which runs in a process of its own."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            signal.alarm(limit_s)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            sys.meta_path.insert(0, Substitute(name, tree, path))
            import pytest

            select = [
                "-k",
                "not bus and not command and not monitor and not socketcan and not any_message and not calls",
            ]
            call = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *(select if name.endswith("codec") else [])]
            code = int(pytest.main([*call, *(str(TESTS / test) for test in tests)]))
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    return status == 0


def main(names: list[str]) -> int:
    """Run the mutants of the modules named, or of all, and return 1 if one survives that is not accepted."""
    import can  # noqa: F401 (imported once, before the forks)
    import cantools  # noqa: F401
    import numpy  # noqa: F401
    import pytest  # noqa: F401
    import scipy.optimize  # noqa: F401

    lines = (TESTS / "mutants_accepted.txt").read_text(encoding="utf-8").splitlines()
    accepted = {line.split(" # ")[0].strip() for line in lines if line.strip() and not line.startswith("#")}
    bad = 0
    for wanted in names or TARGETS:
        target, _, function = wanted.partition(":")
        path = SOURCE / (target.replace(".", "/") + ".py")
        made = survived = known = 0
        start_s = time.monotonic()
        if not survives(f"rangecam.{target}", parsed(path), path, TARGETS[target], 5 * LIMIT_S):
            print(f"{target}: its tests fail without any mutant", flush=True)
            return 1
        for name, tree in mutants(parsed(path)):
            if not name.startswith(f"{function}:" if function else ""):
                continue
            made += 1
            if survives(f"rangecam.{target}", tree, path, TARGETS[target]):
                survived += 1
                label = f"{target} {name}"
                known += label in accepted
                bad += label not in accepted
                print(f"{'accepted' if label in accepted else 'SURVIVED'} {label}", flush=True)
        seconds = time.monotonic() - start_s
        print(f"{target}: {made} mutants, {made - survived} found, {known} accepted, {seconds:.0f} s", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
