"""The table of coverage in the docs is that of the stored counts, and its intervals cover as the page says."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest
from scipy import stats

ROOT = Path(__file__).parents[4]


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("population_coverage", ROOT / "benchmarks" / "population_coverage.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["population_coverage"] = module  # where dataclasses look for names of types
    spec.loader.exec_module(module)
    yield module
    del sys.modules["population_coverage"]


@pytest.fixture(scope="module")
def counts(benchmark):
    return json.loads(benchmark.STORED.read_text())


def test_the_page_shows_the_stored_counts(benchmark, counts):
    before, after = benchmark.MARKS
    assert before + benchmark.table(counts) + after in benchmark.PAGE.read_text()


def test_there_are_200_sessions_of_each_kind(benchmark, counts):
    assert list(counts) == [name for name in benchmark.ROWS if name in counts]
    assert all(row["sessions"] >= 200 for row in counts.values())
    assert 0.65 < counts["lost"]["seen"] / counts["lost"]["drawn"] < 0.75


def test_intervals_cover_as_often_as_they_say(benchmark, counts):
    row = counts["lost"]
    for quantity in benchmark.QUANTITIES:
        for level in benchmark.LEVELS:
            held = row[f"{quantity} {level}"]
            assert stats.binomtest(held, row["sessions"], level / 100).pvalue > 1e-3, (quantity, level, held)


def test_the_limit_ignored_biases_the_mean_and_heavy_tails_the_spread(benchmark, counts):
    assert counts["lost, ignored"]["surface_shear_modulus 95"] < 0.75 * counts["lost"]["surface_shear_modulus 95"]
    for spread in benchmark.SPREADS:
        assert counts["t3, t fitted"][f"{spread} 95"] > 1.3 * counts["t3"][f"{spread} 95"]


def test_the_check_of_the_tails_objects_where_they_are_heavy(counts):
    rate = {name: row["objections"] / row["sessions"] for name, row in counts.items()}
    assert max(rate["lost"], rate["lost, ignored"]) < 0.1
    assert rate["t3"] > 0.5


def test_one_session_is_counted(benchmark):
    counted = benchmark.session("lost", 0)
    assert counted["sessions"] == counted["passed"] == 1
    assert 40 < counted["seen"] < counted["drawn"] == benchmark.DRAWN
