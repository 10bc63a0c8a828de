"""Do the tests notice a mistake? Change one operator, number or sign of a module at a time and run its tests.

Run ``python -m evidence.benchmarks.mutation [--only laws] [--most 40] [--seed 1] [--out FILE]``. The mutants of a
module are a random sample of its places, or all of them if there are no more than asked for; a place is named by its
line of text, so that the sample outlives changes elsewhere. The first failing test kills a mutant, and so does work
without end. What is done is kept in the file given by ``--out``, and a second run continues: killed mutants stay dead
as long as their module is unchanged, the others are tried again. The share that is killed is that of the mutants that
change a result: `EQUIVALENT` lists those that do not, with the reason. ``--write`` renews the table in
``evidence/results/mutants.md``.

Nothing is changed in texts, type hints, defaults of arguments and errors that are raised. A mutant is tested in a copy
of the tree by a process that is forked where the other libraries are imported already. Rooms whose compiled functions
are called by those of other files are interpreted: numba keeps compiled functions by the time of change of their own
file alone, with what they call from other files. Properties are tried with fewer examples than in the tests. All this
is stricter than the tests are, so that the share that dies is a lower bound, but for divisions by zero, which only stop
a program that is interpreted.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import json
import os
import pkgutil
import resource
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from scipy.stats import binomtest

from evidence.benchmarks.stored import ROOT, Stored, read, with_write
from evidence.markdown import table

PACKAGE = "capsbayes"
CPU_SECONDS = 60  # of a mutant, to compile it, in addition to three times what the tests need without one
MEMORY = 8 << 30


class Room(NamedTuple):
    """Modules under test, and the tests that must notice their mutants, the quickest first."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    interpreted: bool = False


_WHOLE_PICTURES = "integrals_and_centroids_of_drawn_pictures_are_the_truth_within_their_errors"  # slow if interpreted

ROOMS = {
    "laws": Room(("physics/membrane.py",), ("tests/physics/test_laws.py",)),
    "kernel": Room(
        ("infer/likelihood.py", "infer/log_grid.py"),
        ("tests/infer/test_likelihood.py", "tests/infer/test_log_grid.py", "tests/infer/test_density.py"),
        interpreted=True,
    ),
    "likelihood": Room(("infer/outline.py",), ("tests/infer/outline",)),
    "scoring": Room(("diagnosis/scores.py",), ("tests/diagnosis/test_scoring.py", "tests/diagnosis/test_evidence.py")),
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
    ("infer/likelihood.py", "float(c[0, 1]) if both else 0.0,: 0.0 -> 1.0"): _NO_LENGTH,
    ("infer/likelihood.py", "float(c[1, 1]) if both else 0.0,: 0.0 -> 1.0"): _NO_LENGTH,
    ("infer/likelihood.py", "share, other = (error / centre) ** 2, a or 0.0: 0.0 -> 1.0"): _NO_LENGTH,
    (
        "image/edge_models.py",
        "jacobian, step, normal = np.empty((m, 2)), np.empty(2), np.empty((2, 2)): 2 -> 3",
    ): "a work array of which nothing reads what was added",
    (
        "image/edges.py",
        "samples = np.arange(-reach, reach + 1.0)  # positive inwards: 1.0 -> 1.5",
    ): "no window holds the sample that is added",
}
"""Mutants that change no result, with the reason, by module and name. A mutant that is killed is none of them."""

OPERATOR = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
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

    def visit_BinOp(self, node: ast.BinOp | ast.BoolOp | ast.AugAssign, sign: str = "") -> ast.AST:
        self.generic_visit(node)
        other = OPERATOR.get(type(node.op))
        if other and self._here(node, f"{type(node.op).__name__}{sign} -> {other.__name__}{sign}"):
            node.op = other()
        return node

    visit_BoolOp = visit_BinOp

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        return self.visit_BinOp(node, "=")

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        other = COMPARISON.get(type(node.ops[0]))
        if other and self._here(node, f"{type(node.ops[0]).__name__} -> {other.__name__}"):
            node.ops[0] = other()
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


class Source:
    """A module, and the places where it can be changed, by the names of the mutants: line of text and change."""

    def __init__(self, text: str) -> None:
        mutator = Mutator()
        mutator.visit(ast.parse(text))
        self.text, lines, names = text, text.splitlines(), Counter[str]()
        self.places: dict[str, int] = {}
        for place, (number, change) in enumerate(mutator.changes):
            name = f"{lines[number - 1].strip()}: {change}"
            names[name] += 1
            self.places[name if names[name] == 1 else f"{name} ({names[name]})"] = place

    def mutant(self, name: str) -> str:
        """Return the text of a mutant."""
        changed = Mutator(self.places[name]).visit(ast.parse(self.text))
        return ast.unparse(ast.fix_missing_locations(changed))

    def drawn(self, most: int, seed: int) -> list[str]:
        """Return mutants in random order; those of a place do not depend on what else the module holds."""
        return sorted(self.places, key=lambda name: hashlib.sha256(f"{seed} {name}".encode()).digest())[:most]


class Order:
    """Plugin of pytest: the tests that killed before come first; what fails is remembered."""

    def __init__(self, kills: Counter[str]) -> None:
        self.kills, self.failed = kills, ""

    def pytest_collection_modifyitems(self, items: list) -> None:
        items.sort(key=lambda item: -self.kills[item.nodeid])

    def pytest_runtest_logreport(self, report) -> None:  # type: ignore[no-untyped-def]
        if report.failed:
            self.failed = report.nodeid


class Bench:
    """Copy of a tree in which mutants are tested."""

    def __init__(self, tree: Path, package: str = PACKAGE) -> None:
        self.tree, self.package, self.kills = tree, package, Counter[str]()
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
        before, killer = resource.getrusage(resource.RUSAGE_CHILDREN), self.tree / "killer"
        killer.unlink(missing_ok=True)
        child = os.fork()
        if not child:
            self._test(tests, seconds, killer)
        status = os.waitpid(child, 0)[1]
        if killer.exists():
            self.kills[killer.read_text()] += 1
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return status == 0, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def _test(self, tests: tuple[str, ...], seconds: float, killer: Path) -> None:
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
                killer.write_text(order.failed)
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


def examine(bench: Bench, room: Room, done: dict, most: int, seed: int, keep: Callable[[], None]) -> None:
    """Test the mutants of a room that are not killed yet; `done` has an entry for each module, kept after each one."""
    import numba

    sources = {module: bench.normalised(module) for module in room.modules}
    numba.config.DISABLE_JIT = room.interpreted
    bench.passes(room.tests)  # which compiles what no mutant changes
    passed, seconds = bench.passes(room.tests)
    if not passed:
        raise SystemExit(f"the tests fail without a mutant:\n{bench.log.read_text()}")
    print(f"{seconds:.0f} s of processor time without a mutant", flush=True)
    for module, source in sources.items():
        digest = hashlib.sha256(source.text.encode()).hexdigest()[:16]
        if done.get(module, {}).get("sha256") != digest:
            done[module] = {"sha256": digest, "places": len(source.places)} | {end: [] for end in ENDS}
        outcome = done[module]
        again = [*outcome["equivalent"], *outcome["alive"]]
        for name in [*(name for name in source.drawn(most, seed) if name not in again), *again]:
            if name in outcome["killed"]:
                continue
            end = "killed"
            if bench.survives(module, source.mutant(name), room.tests, CPU_SECONDS + 3.0 * seconds):
                end = "equivalent" if (module, name) in EQUIVALENT else "alive"
            for other in ENDS:
                outcome[other] = [mutant for mutant in outcome[other] if mutant != name] + [name] * (other == end)
            keep()
            print(f"{end:10}", module, name, flush=True)


def tables(done: dict[str, dict[str, Any]]) -> dict[str, str]:
    """Return the table of the counts by room and module."""
    rows, of_rooms = [], []
    for room, modules in done.items():
        counts = [[entry["places"], *(len(entry[end]) for end in ENDS)] for entry in modules.values()]
        rows += [_row(f"`{module}`", count) for module, count in zip(modules, counts, strict=True)]
        of_rooms.append([sum(column) for column in zip(*counts, strict=True)])
        rows.append(_row(f"**{room}**", of_rooms[-1]))
    rows.append(_row("**all**", [sum(column) for column in zip(*of_rooms, strict=True)]))
    head = ("module", "places", "mutants", "killed", "equivalent", "alive", "share killed")
    return {"mutants": table(head, rows)}


def _row(name: str, counts: list[int]) -> tuple[str, ...]:
    places, killed, equivalent, alive = counts
    share = f"{100 * killed / (killed + alive):.0f} %"
    if sum(counts[1:]) < places:
        low, high = binomtest(killed, killed + alive).proportion_ci()
        share += f" ({100 * low:.0f} to {100 * high:.0f} %)"
    return name, *map(str, (places, sum(counts[1:]), killed, equivalent, alive)), share


STORED = Stored("mutation.json", "evidence/results/mutants.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("--only", choices=ROOMS, nargs="*", default=list(ROOMS))
    parser.add_argument("--most", type=int, default=40, help="mutants of each module")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--out", type=Path, default=STORED.file, help="file of what is done")
    parser.add_argument("--folder", type=Path, help="for the copy of the tree and its compiled functions, to be kept")
    given = parser.parse_args()
    done: dict[str, Any] = read(given.out)
    done = {name: {module: of[module] for module in ROOMS[name].modules if module in of} for name, of in done.items()}
    done = {name: modules for name, modules in done.items() if modules}  # of earlier files nothing is kept
    with tempfile.TemporaryDirectory() as temporary:
        tree = (given.folder or Path(temporary)).resolve() / "tree"
        shutil.rmtree(tree, ignore_errors=True)
        leave = shutil.ignore_patterns(".git", ".venv", "site", "*_cache", "__pycache__")
        shutil.copytree(ROOT, tree, ignore=leave, symlinks=True)
        bench = Bench(tree)
        for name in given.only:
            modules = done.setdefault(name, {})
            examine(bench, ROOMS[name], modules, given.most, given.seed, lambda: _write(given.out, done))
    STORED.show(done, write=given.write)


def _write(out: Path, done: dict[str, Any]) -> None:
    in_order = {name: done[name] for name in ROOMS if name in done}
    out.with_suffix(".new").write_text(json.dumps(in_order, indent=1) + "\n")
    out.with_suffix(".new").replace(out)


if __name__ == "__main__":
    main()
