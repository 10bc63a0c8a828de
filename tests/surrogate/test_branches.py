import manufactured
import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.errors import DatabaseError
from capsbayes.surrogate.plane import branches_of


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


def test_a_snap_through_that_the_database_names_divides_the_branches():
    plain = manufactured.two_branches()
    split = manufactured.is_convex(0.02, np.unique(plain["size_ratio"]))
    borders = plain.dataset.isel(border=np.concatenate([np.arange(len(split)), np.flatnonzero(split)])).copy(deep=True)
    borders["border_kind"].values[len(split) :] = "snap-through"
    borders["border_capillary_number"].values[len(split) :] = 0.0299
    parachute, convex = branches_of(Database(borders))
    np.testing.assert_array_equal(convex.region.highest, 0.0299)
    np.testing.assert_array_equal(parachute.region.lowest[split], 0.0299)
    np.testing.assert_array_equal(parachute.region.limit, branches_of(plain)[0].region.limit)


def test_where_the_rear_turns_concave_smoothly_the_branches_meet_at_the_onset():
    """The depth of a rear that flattens as a quartic grows as the square of the distance from the onset."""
    plain = manufactured.database()
    dataset = plain.dataset.copy(deep=True)
    dataset["parachute_depth"].values[:] = 1e3 * np.maximum(plain["capillary_number"] - 0.03, 0.0) ** 2
    parachute, convex = branches_of(Database(dataset))
    np.testing.assert_allclose(convex.region.highest, 0.03, rtol=1e-9)
    np.testing.assert_array_equal(parachute.region.lowest, convex.region.highest)
