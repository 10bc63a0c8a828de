"""Do the tests notice a mistake? Change one operator, number or sign of a module at a time and run its tests.

Run ``python benchmarks/mutation.py [--only laws] [--most 40] [--out mutation.json]``. Each mutant is tested in a copy
of the tree; the first failing test kills it. What is done is kept in the file given by ``--out``, and a second run
continues. Mutants are drawn evenly from all places of a module, the same ones each time. Those that cannot change a
result, as the wording of an error or a default that every caller gives, are not excluded: the share that dies is a
lower bound.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
SRC = Path("src/capsbayes")
SECONDS = 600.0


@dataclass(frozen=True)
class Target:
    """Modules under test, and the test files that must notice their mutants."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]


TARGETS = {
    "laws": Target(
        tuple(
            f"physics/membrane/{name}.py"
            for name in ("general", "hooke", "neo_hookean", "skalak", "strain_hardening", "law")
        ),
        ("tests/physics/membrane",),
    ),
    "kernel": Target(
        ("infer/kernel.py",), ("tests/infer/test_likelihood.py", "tests/infer/grid", "tests/infer/test_density.py")
    ),
    "likelihood": Target(
        ("infer/likelihood.py",),
        ("tests/infer/test_likelihood.py", "tests/infer/test_density.py", "tests/infer/outline"),
    ),
    "scoring": Target(
        ("diagnosis/scoring.py",), ("tests/diagnosis/test_scoring.py", "tests/diagnosis/test_evidence.py")
    ),
    "edges": Target(
        tuple(f"image/edges/{name}.py" for name in ("extent", "integrals", "models", "rear", "robust")),
        ("tests/image/edges",),
    ),
}

BINARY = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
COMPARISON = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}


class Mutator(ast.NodeTransformer):
    """Transformer that changes one place of a module, or with none chosen counts them."""

    def __init__(self, chosen: int = -1) -> None:
        self.chosen, self.places, self.changed = chosen, 0, ""

    def _here(self, node: ast.AST, what: str) -> bool:
        self.places += 1
        if self.places - 1 != self.chosen:
            return False
        self.changed = f"line {getattr(node, 'lineno', 0)}: {what}"
        return True

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        other = BINARY.get(type(node.op))
        if other and self._here(node, f"{type(node.op).__name__} -> {other.__name__}"):
            node.op = other()
        return node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        self.generic_visit(node)
        other = BINARY.get(type(node.op))
        if other and self._here(node, f"{type(node.op).__name__}= -> {other.__name__}="):
            node.op = other()
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        other = COMPARISON.get(type(node.ops[0]))
        if other and self._here(node, f"{type(node.ops[0]).__name__} -> {other.__name__}"):
            node.ops[0] = other()
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        other = ast.Or if isinstance(node.op, ast.And) else ast.And
        if self._here(node, f"{type(node.op).__name__} -> {other.__name__}"):
            node.op = other()
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.USub | ast.Invert | ast.Not) and self._here(node, f"no {type(node.op).__name__}"):
            return node.operand
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        number = type(node.value) in (int, float)
        if number and self._here(node, f"{node.value} -> {1.5 * node.value if node.value else 1}"):
            new = node.value + 1 if isinstance(node.value, int) else 1.5 * node.value or 1.0
            return ast.copy_location(ast.Constant(new), node)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.body = [self.visit(statement) for statement in node.body]  # no default, annotation or decorator
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node


def mutants(source: str, most: int) -> Iterator[tuple[str, str]]:
    """Yield the description and the source of at most so many mutants."""
    counter = Mutator()
    counter.visit(ast.parse(source))
    for place in np.unique(np.linspace(0, counter.places - 1, min(most, counter.places)).astype(int)):
        mutator = Mutator(int(place))
        tree = ast.fix_missing_locations(mutator.visit(ast.parse(source)))
        yield f"{place}, {mutator.changed}", ast.unparse(tree)


def dies(tree: Path, tests: tuple[str, ...], module: Path, source: str) -> bool:
    """Return whether a test fails with this source of a module."""
    original = (tree / module).read_text()
    (tree / module).write_text(source)
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "OPENBLAS_NUM_THREADS": "1"}
    caches = [tree / "numba"] if "njit" in original else []  # compiled callers contain the code of the original
    if caches:
        environment["NUMBA_CACHE_DIR"] = str(caches[0])
    command = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *tests]
    try:
        return subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=SECONDS).returncode != 0
    except subprocess.TimeoutExpired:
        return True
    finally:
        (tree / module).write_text(original)
        for folder in caches:
            shutil.rmtree(folder, ignore_errors=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=TARGETS, nargs="*", default=list(TARGETS))
    parser.add_argument("--most", type=int, default=40, help="mutants of each module")
    parser.add_argument("--out", type=Path, default=Path("mutation.json"), help="file of what is done")
    asked = parser.parse_args()
    done: dict[str, dict[str, bool]] = json.loads(asked.out.read_text()) if asked.out.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(
            ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv", "site", ".mypy_cache"), symlinks=True
        )
        for name in asked.only:
            for module in TARGETS[name].modules:
                before = done.setdefault(module, {})
                for what, source in mutants((tree / SRC / module).read_text(), asked.most):
                    if what not in before:
                        before[what] = dies(tree, TARGETS[name].tests, SRC / module, source)
                        asked.out.write_text(json.dumps(done, indent=1))
                        print("killed  " if before[what] else "SURVIVED", module, what, flush=True)
    print(f"\n{'module':40} killed")
    for module, outcome in done.items():
        print(f"{module:40} {sum(outcome.values())} of {len(outcome)}")
    everything = [dead for outcome in done.values() for dead in outcome.values()]
    print(f"{'all':40} {sum(everything)} of {len(everything)}, {100 * np.mean(everything):.0f} %")


if __name__ == "__main__":
    main()
