import manufactured
import numpy as np
import pytest

from capsbayes.errors import DatabaseError
from capsbayes.surrogate.branches import branches_of


def test_one_branch_holds_every_converged_case_and_no_more():
    database = manufactured.database(failed=(0, 15, 40))
    (branch,) = branches_of(database)
    cases = database.converged
    assert branch.name == "parachute"
    assert branch.gap is None
    assert branch.region.contains(cases["capillary_number"], cases["size_ratio"]).all()
    lost = database["status"] != "DONE"
    ca, size = database["capillary_number"][lost], database["size_ratio"][lost]
    np.testing.assert_array_equal(branch.region.contains(ca, size), [False, False, True])
    np.testing.assert_array_equal(branch.region.limit, manufactured.limit(branch.region.size_ratio) < 0.15)


def test_two_branches_share_the_plane_at_the_jump():
    database = manufactured.two_branches()
    parachute, convex = branches_of(database)
    assert (parachute.name, convex.name) == ("parachute", "convex")
    depth = database["parachute_depth"]
    np.testing.assert_array_equal(np.sort(np.concatenate([parachute.rows, convex.rows])), np.arange(len(database)))
    assert np.all(depth[convex.rows] == 0)
    assert np.all(depth[parachute.rows] > 0)
    ca, size = np.random.default_rng(8).uniform([0.005, 0.7], [0.2, 1.15], (2000, 2)).T
    assert not np.any(parachute.region.contains(ca, size) & convex.region.contains(ca, size))
    for branch in (parachute, convex):
        assert branch.region.contains(
            database["capillary_number"][branch.rows], database["size_ratio"][branch.rows]
        ).all()


def test_the_gap_lies_between_the_last_cases_of_the_branches():
    database = manufactured.two_branches()
    parachute, convex = branches_of(database)
    gap, ca, size = parachute.gap, database["capillary_number"], database["size_ratio"]
    assert gap is convex.gap
    for column, low, high in zip(gap.size_ratio[1:], gap.lowest[1:], gap.highest[1:], strict=True):
        here = np.isclose(size, column)
        assert low == ca[here & (database["parachute_depth"] == 0)].max()
        assert high == ca[here & (database["parachute_depth"] > 0)].min()
    assert gap.lowest[0] == gap.highest[0]  # it closes on the column before, which has one branch alone


def test_one_column_is_no_domain():
    with pytest.raises(DatabaseError, match=r"two columns of a/l with two each, got 16 cases in 1 columns"):
        branches_of(manufactured.database(columns=1))
