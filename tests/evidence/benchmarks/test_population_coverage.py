"""The intervals of populations cover as the pages say."""

import pytest
from scipy import stats

from evidence.benchmarks import population_coverage as benchmark
from evidence.benchmarks.stored import ROOT


@pytest.fixture(scope="module")
def counts():
    return benchmark.STORED.read()


def test_the_guide_states_the_share_of_intervals_that_hold_with_and_without_the_correction(counts):
    held = {name: counts[name]["surface_shear_modulus 95"] / counts[name]["sessions"] for name in counts}
    words = " ".join((ROOT / "docs" / "many-capsules.md").read_text().split())
    assert f"held the truth in {held['lost']:.1%}".replace("%", " %") in words
    assert f"without the correction in {held['lost, ignored']:.1%}".replace("%", " %") in words


def test_there_are_200_sessions_of_each_kind(counts):
    assert list(counts) == [name for name in benchmark.ROWS if name in counts]
    assert all(row["sessions"] >= 200 for row in counts.values())
    assert 0.65 < counts["lost"]["seen"] / counts["lost"]["drawn"] < 0.75


def test_intervals_cover_as_often_as_they_say(counts):
    row = counts["lost"]
    for quantity in benchmark.QUANTITIES:
        for level in benchmark.LEVELS:
            held = row[f"{quantity} {level}"]
            assert stats.binomtest(held, row["sessions"], level / 100).pvalue > 1e-3, (quantity, level, held)


def test_the_limit_ignored_biases_the_mean_and_heavy_tails_the_spread(counts):
    assert counts["lost, ignored"]["surface_shear_modulus 95"] < 0.75 * counts["lost"]["surface_shear_modulus 95"]
    for spread in benchmark.SPREADS:
        assert counts["t3, t fitted"][f"{spread} 95"] > 1.3 * counts["t3"][f"{spread} 95"]


def test_the_check_of_the_tails_objects_where_they_are_heavy(counts):
    rate = {name: row["objections"] / row["sessions"] for name, row in counts.items()}
    assert max(rate["lost"], rate["lost, ignored"]) < 0.1
    assert rate["t3"] > 0.5


def test_one_session_is_counted():
    counted = benchmark.session("lost", 0)
    assert counted["sessions"] == counted["passed"] == 1
    assert 40 < counted["seen"] < counted["drawn"] == benchmark.DRAWN


def test_sessions_of_the_other_two_tables_are_counted():
    shared = benchmark.with_shared_errors(60, 0)
    assert {*benchmark.TRUTH, "gates"} < {*shared}
    assert any("shared errors ignored" in name for name in shared)
    kept = benchmark.with_a_cut(0)
    assert len(kept) == 2 * len(benchmark.TRUTH)
