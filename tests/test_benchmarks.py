"""No benchmark prints a number that is none."""

import importlib.util
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
NAMES = runpy.run_path(str(BENCHMARKS / "run.py"))["NAMES"]
NONE = re.compile(r"\b(nan|inf)\b", re.IGNORECASE)


def test_the_table_of_surrogates_has_a_number_in_each_cell(monkeypatch, capsys):
    spec = importlib.util.spec_from_file_location("benchmark", BENCHMARKS / "surrogate.py")
    benchmark = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "benchmark", benchmark)  # where dataclasses look for names of types
    spec.loader.exec_module(benchmark)
    monkeypatch.setattr(benchmark, "BATCH", 100)
    monkeypatch.setattr(benchmark, "SMALL_BATCH", 100)
    monkeypatch.setattr(benchmark, "gaussian_process", benchmark.moving_least_squares)  # needs another library
    monkeypatch.setattr(sys, "argv", ["surrogate.py"])
    benchmark.main()
    printed = capsys.readouterr().out
    assert "surrogate" in printed
    assert len(re.findall(r"\d+ / \d+", printed)) == 3 * 6
    assert not NONE.search(printed)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_benchmark_ends_well_and_prints_numbers(name):
    pytest.importorskip("sklearn")
    done = subprocess.run([sys.executable, BENCHMARKS / f"{name}.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not NONE.search(done.stdout), done.stdout
