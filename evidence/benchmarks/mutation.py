"""Do the tests notice a mistake? Change one operator, number or sign of a module at a time and run its tests.

Run ``python -m evidence.benchmarks.mutation [--only laws] [--most 40] [--seed 1] [--out FILE]``. The mutants of a
module are a random sample of its places, or all of them if there are no more than asked for. The first failing test
kills a mutant, and so does work without end. What is done is kept in the file given by ``--out``, and a second run
continues: killed mutants stay dead as long as their module is unchanged, the others are tried again. The share that is
killed is that of the mutants that change a result: `EQUIVALENT` lists those that do not, with the reason.

Nothing is changed in texts, type hints, defaults of arguments and errors that are raised. A mutant is tested in a copy
of the tree by a process that is forked where the other libraries are imported already. Rooms with compiled functions
are interpreted: numba keeps compiled functions by the time of change of their own file alone, with what they call from
other files. Properties are tried with fewer examples than in the tests. All this is stricter than the tests are, so
that the share that dies is a lower bound, but for divisions by zero, which only stop a program that is interpreted.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import json
import os
import pkgutil
import random
import re
import resource
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "evidence" / "results" / "mutation.json"
PACKAGE = "capsbayes"
CPU_SECONDS = 15  # of a mutant, in addition to three times what the tests need without one
MEMORY = 8 << 30


@dataclass(frozen=True)
class Room:
    """Modules under test, and the tests that must notice their mutants, the quickest first."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    interpreted: bool = False


_WHOLE_PICTURES = "integrals_and_centroids_of_drawn_pictures_are_the_truth_within_their_errors"  # slow if interpreted

ROOMS = {
    "laws": Room(("physics/membrane.py",), ("tests/physics/membrane",)),
    "kernel": Room(
        ("infer/likelihood.py", "infer/log_grid.py"),
        ("tests/infer/test_likelihood.py", "tests/infer/test_log_grid.py", "tests/infer/test_density.py"),
    ),
    "likelihood": Room(("infer/outline.py",), ("tests/infer/outline",)),
    "scoring": Room(
        ("diagnosis/scores.py",),
        (
            "tests/diagnosis/test_scoring.py",
            "tests/diagnosis/test_evidence.py::test_evidence_of_a_gaussian_likelihood_with_a_gaussian_prior",
        ),
    ),
    "edges": Room(
        ("image/edges.py", "image/edge_models.py"),
        (
            "tests/image/test_edges.py",
            "tests/image/test_edge_models.py",
            f"--deselect=tests/image/test_edges.py::test_{_WHOLE_PICTURES}",
        ),
        interpreted=True,
    ),
}

ENDS = ("killed", "equivalent", "alive")
_NO_LENGTH = "without L_a nothing reads its covariance"
EQUIVALENT = {
    ("infer/likelihood.py", "float(c[0, 1]) if both else 0.0,", "0.0 -> 1.0"): _NO_LENGTH,
    ("infer/likelihood.py", "float(c[1, 1]) if both else 0.0,", "0.0 -> 1.0"): _NO_LENGTH,
    ("infer/likelihood.py", "share, other = (error / centre) ** 2, a or 0.0", "0.0 -> 1.0"): _NO_LENGTH,
    (
        "image/edge_models.py",
        "jacobian, step, normal = np.empty((m, 2)), np.empty(2), np.empty((2, 2))",
        "2 -> 3",
    ): "a work array of which nothing reads what was added",
    (
        "image/edges.py",
        "samples = np.arange(-reach, reach + 1.0)  # positive inwards",
        "1.0 -> 1.5",
    ): "no window holds the sample that is added",
    (
        "image/edges.py",
        "normal, sides, row = np.empty((3, 3)), np.empty((3, 2)), np.empty(3)",
        "2 -> 3",
    ): "a right-hand side of which nothing reads the solution",
}
"""Mutants that change no result, with the reason: module, line and change. A mutant that is killed is none of them."""

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
    """Transformer that changes one place of a module, or none, and lists what can be changed: line and change."""

    def __init__(self, chosen: int = -1) -> None:
        self.chosen = chosen
        self.changes: list[tuple[int, str]] = []

    def _here(self, node: ast.AST, what: str) -> bool:
        self.changes.append((getattr(node, "lineno", 0), what))
        return len(self.changes) - 1 == self.chosen

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
        if type(node.value) not in (int, float):
            return node
        new = node.value + 1 if isinstance(node.value, int) else 1.5 * node.value or 1.0
        return ast.copy_location(ast.Constant(new), node) if self._here(node, f"{node.value} -> {new}") else node

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node  # the wording of an error

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.body = [self.visit(statement) for statement in node.body]  # no default, annotation or decorator
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node


@dataclass
class Source:
    """A module, and what can be changed in it."""

    text: str

    def __post_init__(self) -> None:
        mutator = Mutator()
        mutator.visit(ast.parse(self.text))
        lines = self.text.splitlines()
        self.changes = [(lines[number - 1].strip(), what) for number, what in mutator.changes]
        self.named = [f"{n}, line {number}: {what}" for n, (number, what) in enumerate(mutator.changes)]
        self.places = len(self.changes)

    def mutant(self, place: int) -> tuple[str, str]:
        """Return the description of a mutant and its text."""
        changed = Mutator(place).visit(ast.parse(self.text))
        return self.named[place], ast.unparse(ast.fix_missing_locations(changed))

    def drawn(self, most: int, seed: int) -> list[int]:
        """Return the places to change, in random order; more of them begin with the same ones."""
        places = list(range(self.places))
        random.Random(f"{seed} {self.text}").shuffle(places)
        return places[:most]


class Order:
    """Plugin of pytest: the tests that killed before come first; what fails is remembered."""

    def __init__(self, kills: Counter[str]) -> None:
        self.kills, self.failed = kills, ""

    def pytest_collection_modifyitems(self, items: list) -> None:
        items.sort(key=lambda item: -self.kills[item.nodeid])

    def pytest_runtest_logreport(self, report) -> None:  # type: ignore[no-untyped-def]
        if report.failed:
            self.failed = report.nodeid


@dataclass
class Bench:
    """Copy of a tree in which mutants are tested."""

    tree: Path
    package: str = PACKAGE
    kills: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.src, self.now = self.tree / "src", 2_000_000_000
        self.log = self.tree.parent / "log"
        os.environ |= {
            "PYTHONPATH": str(self.src),
            "NUMBA_CACHE_DIR": str(self.tree.parent / "numba"),
            "OPENBLAS_NUM_THREADS": "1",
        }
        sys.path.insert(0, str(self.src))
        for module in pkgutil.walk_packages([str(self.src / self.package)], f"{self.package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
        for name in [name for name in sys.modules if name.partition(".")[0] == self.package]:
            del sys.modules[name]  # the other libraries stay
        import hypothesis

        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)  # a failure need not be shrunk
        hypothesis.settings.register_profile(
            "mutants", deadline=None, derandomize=True, database=None, phases=phases, max_examples=25
        )
        hypothesis.settings.load_profile("mutants")

    def normalised(self, module: str) -> Source:
        """Return a module, written as its mutants are."""
        path = self.src / self.package / module
        source, when = Source(path.read_text()), path.stat().st_mtime_ns
        path.write_text(ast.unparse(ast.parse(source.text)))
        os.utime(path, ns=(when, when))
        return source

    def passes(self, tests: tuple[str, ...], seconds: float = 3600.0) -> tuple[bool, float]:
        """Return whether the tests pass, and their processor time [s]."""
        before, told = resource.getrusage(resource.RUSAGE_CHILDREN), self.tree / "killer"
        told.unlink(missing_ok=True)
        child = os.fork()
        if not child:
            self._test(tests, seconds, told)
        status = os.waitpid(child, 0)[1]
        if told.exists():
            self.kills[told.read_text()] += 1
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return status == 0, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def _test(self, tests: tuple[str, ...], seconds: float, told: Path) -> None:
        try:
            import pytest

            os.chdir(self.tree)
            quiet = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 1))
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            order = Order(self.kills)
            options = ["-n0", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
            options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # hypothesis is imported already
            status = int(pytest.main([*options, *tests], plugins=[order]))
            if order.failed:
                told.write_text(order.failed)
        except BaseException:
            traceback.print_exc()
            status = 1
        sys.stdout.flush()
        os._exit(status)

    def survives(self, module: str, text: str, tests: tuple[str, ...], seconds: float) -> bool:
        """Return whether the tests pass with this text of a module."""
        path, self.now = self.src / self.package / module, self.now + 1
        original, when = path.read_text(), path.stat().st_mtime_ns
        try:
            path.write_text(text)
            os.utime(path, (self.now, self.now))  # no mutant is taken for another that was compiled earlier
            return self.passes(tests, seconds)[0]
        finally:
            path.write_text(original)
            os.utime(path, ns=(when, when))


_COMPILED = re.compile(r"^@(njit|compiled)", re.MULTILINE)


def examine(bench: Bench, room: Room, done: dict, most: int, seed: int, keep: Callable[[], None]) -> None:
    """Test the mutants of a room that are not killed yet; `done` has an entry for each module, kept after each one."""
    import numba

    sources = {module: bench.normalised(module) for module in room.modules}
    assert room.interpreted or not any(_COMPILED.search(source.text) for source in sources.values())
    numba.config.DISABLE_JIT = room.interpreted
    passed, seconds = bench.passes(room.tests)
    if not passed:
        raise SystemExit(f"the tests fail without a mutant:\n{bench.log.read_text()}")
    print(f"{seconds:.0f} s of processor time without a mutant", flush=True)
    for module, source in sources.items():
        digest = hashlib.sha256(source.text.encode()).hexdigest()[:16]
        if done.get(module, {}).get("sha256") != digest:
            done[module] = {"sha256": digest, "places": source.places} | {end: [] for end in ENDS}
        outcome = done[module]
        again = [int(what.partition(",")[0]) for what in outcome["equivalent"] + outcome["alive"]]
        for place in [*(place for place in source.drawn(most, seed) if place not in again), *again]:
            what, text = source.mutant(place)
            if what in outcome["killed"]:
                continue
            end = "killed"
            if bench.survives(module, text, room.tests, CPU_SECONDS + 3.0 * seconds):
                end = "equivalent" if (module, *source.changes[place]) in EQUIVALENT else "alive"
            for other in ENDS:
                outcome[other] = [mutant for mutant in outcome[other] if mutant != what] + [what] * (other == end)
            keep()
            print(f"{end:10}", module, what, flush=True)


def table(done: dict) -> str:
    """Return the counts by room and module as a table in Markdown."""
    lines = [
        "| module | places | mutants | killed | equivalent | alive | share killed |",
        "| --- | ---: | ---: | ---: | ---: | ---: | --- |",
    ]
    rooms: list[list[int]] = []
    for room, modules in done.items():
        counts = [[entry["places"], *(len(entry[end]) for end in ENDS)] for entry in modules.values()]
        lines += [_row(f"`{module}`", count) for module, count in zip(modules, counts, strict=True)]
        rooms.append([sum(column) for column in zip(*counts, strict=True)])
        lines.append(_row(f"**{room}**", rooms[-1]))
    return "\n".join([*lines, _row("**all**", [sum(column) for column in zip(*rooms, strict=True)])])


def _row(name: str, counts: list[int]) -> str:
    from scipy.stats import binomtest

    places, killed, equivalent, alive = counts
    share = f"{100 * killed / (killed + alive):.0f} %"
    if sum(counts[1:]) < places:
        low, high = binomtest(killed, killed + alive).proportion_ci()
        share += f" ({100 * low:.0f} to {100 * high:.0f} %)"
    return f"| {name} | {places} | {sum(counts[1:])} | {killed} | {equivalent} | {alive} | {share} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=ROOMS, nargs="*", default=list(ROOMS))
    parser.add_argument("--most", type=int, default=40, help="mutants of each module")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--out", type=Path, default=DATA, help="file of what is done")
    parser.add_argument("--folder", type=Path, help="for the copy of the tree and its compiled functions, to be kept")
    asked = parser.parse_args()
    done: dict = json.loads(asked.out.read_text()) if asked.out.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        tree = (asked.folder or Path(temporary)).resolve() / "tree"
        shutil.rmtree(tree, ignore_errors=True)
        leave = shutil.ignore_patterns(".git", ".venv", "site", "*_cache", "__pycache__")
        shutil.copytree(ROOT, tree, ignore=leave, symlinks=True)
        bench = Bench(tree)
        for name in asked.only:
            modules = done.setdefault(name, {})
            examine(bench, ROOMS[name], modules, asked.most, asked.seed, lambda: _write(asked.out, done))
    print(table(done))


def _write(out: Path, done: dict) -> None:
    in_order = {name: done[name] for name in ROOMS if name in done}
    out.with_suffix(".new").write_text(json.dumps(in_order, indent=1) + "\n")
    out.with_suffix(".new").replace(out)


if __name__ == "__main__":
    main()
