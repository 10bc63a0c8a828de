"""No benchmark prints a number that is none."""

import ast
import json
import re
import subprocess
import sys

import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.surrogate import Surrogate
from evidence.benchmarks import film_silhouettes, mutation, off_axis, silhouettes, speed
from evidence.benchmarks.stored import ROOT

QUICK = ("pictures", "films", "off_nodes", "sensitivity")
"""Benchmarks of a few minutes that print a table."""
NONE = re.compile(r"\b(nan|inf)\b", re.IGNORECASE)


def test_methods_learn_the_same_cases():
    part = Surrogate.open("square-neo-hookean").branches[0]
    known, others = speed.held_out(Database.open("square-neo-hookean").converged, part.branch.rows)
    assert len(others) > 0.1 * len(known)
    for learn in (speed.of_surrogate, speed.of_thin_plates):
        errors = speed.accuracy(learn(known, part.scaling), others, part.scaling)
        assert np.all((errors > 1e-7) & (errors < 0.02))


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_benchmark_ends_well_and_prints_numbers(name):
    command = [sys.executable, "-m", f"evidence.benchmarks.{name}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert not NONE.search(done.stdout), done.stdout


def test_a_command_is_timed_with_the_processes_that_it_starts():
    found = speed.clocked(lambda: subprocess.run([sys.executable, "-c", "sum(range(10**6))"], check=True), runs=1)
    assert 0.0 < found["processor"] < found["wall"] + 1.0


LAW = """
from numba import njit

@njit(cache=True)
def area(length: float, width: float = 3.0) -> float:
    if length < 0.0:
        raise ValueError("at least", 0.0)
    return length * width + 0
"""
TEST = "from capsule.law import area\n\ndef test_area():\n    assert area(2.0) == 6.0\n"


def test_mutants_that_are_said_to_change_no_result_exist():
    for module, name in mutation.EQUIVALENT:
        assert name in source_of(module).places


def source_of(module):
    return mutation.Source((ROOT / "src" / mutation.PACKAGE / module).read_text())


@pytest.mark.parametrize("room", mutation.ROOMS.values(), ids=mutation.ROOMS)
def test_each_mutant_of_the_sample_is_another_text_of_a_module_of_today_and_its_tests_exist(room):
    for module in room.modules:
        source = source_of(module)
        texts = [source.mutant(name) for name in source.drawn(10, seed=1)]
        assert len({ast.unparse(ast.parse(source.text)), *texts}) == len(texts) + 1 == 11
        for text in texts:
            compile(text, module, "exec")
    for test in room.tests:
        file, _, name = test.removeprefix("--deselect=").partition("::")
        assert (ROOT / file).exists(), file
        assert not name or f"def {name}(" in (ROOT / file).read_text(), test


def test_a_mutant_is_named_by_its_line_so_that_the_sample_outlives_other_changes():
    source, longer = mutation.Source(LAW), mutation.Source(f"further = 3 - 1\n{LAW}")
    new = {"further = 3 - 1: Sub -> Add", "further = 3 - 1: 3 -> 4", "further = 3 - 1: 1 -> 2"}
    assert {*longer.places} - {*source.places} == new
    drawn = [name for name in longer.drawn(99, seed=1) if name not in new]
    assert drawn == source.drawn(99, seed=1) != source.drawn(99, seed=2)


def test_mutants_differ_in_one_place_and_never_in_texts_defaults_or_errors():
    source = mutation.Source(LAW)
    texts = [source.mutant(name) for name in source.places]
    assert len({*texts, ast.unparse(ast.parse(LAW))}) == len(source.places) + 1 == 6
    assert all("'at least', 0.0" in text and "width: float=3.0" in text for text in texts)
    assert list(source.places)[-1] == "return length * width + 0: Add -> Sub"


@pytest.mark.slow
def test_a_mutant_of_a_compiled_function_is_run_and_what_is_done_is_kept(tmp_path):
    tree = tmp_path / "tree"
    for name, text in {"src/capsule/__init__.py": "", "src/capsule/law.py": LAW, "tests/test_law.py": TEST}.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    script = (
        "import json, sys; from pathlib import Path; from evidence.benchmarks import mutation\n"
        "bench, done = mutation.Bench(Path(sys.argv[1]), 'capsule'), {}\n"
        "room = mutation.Room(('law.py',), ('tests/test_law.py',), interpreted=True)\n"
        "text = (bench.src / 'capsule' / 'law.py').read_text()\n"
        "for _ in range(2):\n"
        "    (bench.src / 'capsule' / 'law.py').write_text(text)\n"
        "    mutation.examine(bench, room, done, 9, 1, lambda: None)\n"
        "print(json.dumps(done))\n"
    )
    printed = subprocess.run([sys.executable, "-c", script, tree], capture_output=True, text=True, cwd=ROOT)
    *lines, done = printed.stdout.splitlines()
    outcome = json.loads(done)["law.py"]
    assert outcome["places"] == 5, printed.stderr
    assert {name.split(": ")[-1] for name in outcome["killed"]} == {"Mult -> Div", "Lt -> GtE", "0 -> 1"}
    assert {name.split(": ")[-1] for name in outcome["alive"]} == {"Add -> Sub", "0.0 -> 1.0"}
    assert sum(line.startswith("killed") for line in lines) == 3  # the second time only those alive are tried
    assert sum(line.startswith("alive") for line in lines) == 4


def test_the_tables_of_silhouettes_have_a_number_in_each_cell():
    tally = silhouettes.Tally()
    tally.residuals, tally.waves = [[4e-6, 4e-6, 1e-6, 2e-6, 0.9]] * 4, [np.array([0.5, 1.5])] * 4
    tally.ranks = {"silhouette": [[0.5, 0.9]] * 4, "lengths": [[0.5, 0.99]] * 4}
    tally.widths[False] = [[0.01, 0.001, 1.0, 0.03]] * 4
    made = silhouettes.summary({"2 px": tally, "0.5 to 1 px": silhouettes.Tally()})
    coverage, widths = silhouettes.tables(made).values()
    first = "| 2 px | 4 | 0.0020 | 0.0020 | 0.90 | 50%, 100% | 100%, 100% | 0%, 100% |"
    assert coverage.splitlines()[2:] == [first, "| from L_z and L_a alone | 4 |  |  |  |  | 100%, 100% | 0%, 0% |"]
    assert widths.splitlines()[2] == "| not seen | 2 px | 4 | 0.010 | 1 | 0.0010 | 0.03 |"


def test_half_of_a_channel_is_unfolded_from_its_eighth():
    for channel, area in ((off_axis.HalfSquare(), 2.0), (off_axis.HalfTube(), 0.5 * np.pi)):
        points, areas = channel.filling(0.1, 0.0)
        assert areas.sum() == pytest.approx(area, rel=0.02)
        assert points[:, 0].min() > 0.0
        assert np.sort(points[:, 1]) == pytest.approx(-np.sort(points[:, 1])[::-1], abs=1e-12)
        points, lengths = channel.outline(0.1, 0.0)
        assert lengths.sum() == pytest.approx(2.0 * area, rel=0.01)


def test_the_silhouette_of_an_ellipsoid_off_the_axis_is_an_ellipse():
    from capsbayes.physics.surface import octasphere

    mesh = octasphere(8, off_axis.CS)
    nodes = mesh.nodes * [0.6, 0.7, 0.8] + [0.0, 0.1, 0.0]
    angle = 2.0 * np.pi * np.arange(off_axis.RAYS) / off_axis.RAYS
    for view, breadth, offset in zip(off_axis.VIEWS, (0.7, 0.6), (0.1, 0.0), strict=True):
        reach = off_axis.radii(mesh.elements, nodes, view)
        z, y = reach * np.cos(angle), reach * np.sin(angle) - offset
        assert (z / 0.8) ** 2 + (y / breadth) ** 2 == pytest.approx(1.0, abs=5e-3)


@pytest.mark.slow
def test_a_film_is_drawn_and_identified_by_all_that_it_shows():
    from capsbayes import Database

    made = film_silhouettes.row(0, Database.open("square-neo-hookean").converged)
    assert made["status"] == "DONE"
    assert len(made["frames"]) == film_silhouettes.FRAMES
    assert made["film"][1] < made["lengths of the film"][1]
    lines = film_silhouettes.tables({"0": made})["films"].splitlines()
    assert [len(line.split("|")) for line in lines] == [len(film_silhouettes.HEAD) + 2] * 8
