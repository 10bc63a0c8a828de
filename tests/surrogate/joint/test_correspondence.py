"""Corresponding points have the same place between the borders of their branch."""

import numpy as np
import pytest

from capsbayes.surrogate.effect import Borders, matched, moved_along, moving_borders, place

COLUMNS = np.array([0.8, 0.9, 1.0])
PARACHUTE, CONVEX, NONE = 0, 1, -1


def borders(lowest, division, highest, *, limit=False):
    rows = np.stack([np.broadcast_to(np.asarray(row, float), 3) for row in (lowest, division, highest)])
    return Borders(COLUMNS, rows, np.full(3, limit), np.ones((2, 2), dtype=bool))


SLICES = [borders(0.005, 0.015, 0.11), borders(0.005, 0.04, [0.13, 0.12, 0.12]), borders(0.005, 0.07, 0.15)]
KNOTS = np.array([0.0, 0.02, 0.05])


def placed(ca, size, distance, cubics):
    position = np.full(4, np.nan)
    branch, column = place(ca, size, distance, COLUMNS, cubics, position)
    return branch, column, *position[:2]


@pytest.mark.parametrize(
    ("ca", "size", "branch", "column", "position"),
    [
        (0.010, 0.80, CONVEX, 0, (0.5, 0.0)),
        (0.005, 0.85, CONVEX, 0, (0.0, 0.5)),
        (0.015, 0.90, PARACHUTE, 1, (0.0, 0.0)),
        (0.110, 1.00, PARACHUTE, 1, (1.0, 1.0)),
        (0.0625, 0.95, PARACHUTE, 1, (0.5, 0.5)),
    ],
)
def test_a_point_has_a_place_on_its_branch(ca, size, branch, column, position):
    cubics = moving_borders(KNOTS, SLICES, 0, SLICES[0])[0]
    assert placed(ca, size, 0.0, cubics) == pytest.approx((branch, column, *position))


@pytest.mark.parametrize(
    ("ca", "size"), [(0.0049, 0.9), (0.1101, 0.9), (0.05, 0.79), (0.05, 1.01), (np.nan, 0.9), (0.05, np.nan)]
)
def test_beyond_the_borders_there_is_no_place(ca, size):
    cubics = moving_borders(KNOTS, SLICES, 0, SLICES[0])[0]
    assert placed(ca, size, 0.0, cubics)[0] == NONE


def test_the_borders_are_the_slices_on_them_and_move_monotonically_between():
    cubics = moving_borders(KNOTS, SLICES, 0, SLICES[0])
    for k in range(2):
        powers = np.linspace(0.0, KNOTS[k + 1] - KNOTS[k], 21)[:, None] ** np.arange(4)
        between = np.tensordot(powers, cubics[k], axes=1)
        for end, one in ((0, SLICES[k]), (-1, SLICES[k + 1])):
            np.testing.assert_allclose(between[end], one.capillary_number, atol=1e-15)
        steps = np.diff(between, axis=0) * np.sign(between[-1] - between[0])
        assert np.all(steps >= -1e-15)


def test_the_base_sets_the_borders_at_its_value_and_is_moved_with_the_slices():
    base = borders(0.005, 0.016, 0.12)
    cubics = moving_borders(KNOTS, SLICES, 0, base)
    np.testing.assert_array_equal(cubics[0, 0], base.capillary_number)
    moved = SLICES[1].capillary_number + base.capillary_number - SLICES[0].capillary_number
    np.testing.assert_allclose(cubics[1, 0, ::2], moved[::2], atol=1e-15)
    np.testing.assert_array_equal(cubics[1, 0, 1], SLICES[1].capillary_number[1])  # it snaps where its own shapes do


def test_base_and_null_slice_correspond_at_equal_ca_but_for_folds():
    base, null = matched(borders(0.003, 0.016, 0.15), borders(0.005, 0.015, 0.12))
    np.testing.assert_array_equal(base.capillary_number[:, 0], [0.005, 0.016, 0.12])
    np.testing.assert_array_equal(null.capillary_number[:, 0], [0.005, 0.015, 0.12])
    base, null = matched(borders(0.005, 0.016, 0.117, limit=True), borders(0.005, 0.015, 0.11, limit=True))
    assert (base.capillary_number[2, 0], null.capillary_number[2, 0]) == (0.117, 0.11)


def test_where_only_one_of_them_has_convex_shapes_it_says_where_they_end():
    """A base that follows the dimpled branch down, compared with a null slice that was reached from rest."""
    base, null = matched(borders(0.0075, 0.0075, 0.15), borders(0.005, 0.015, 0.15))
    np.testing.assert_array_equal(base.capillary_number, null.capillary_number)
    np.testing.assert_array_equal(base.capillary_number[:, 0], [0.005, 0.015, 0.15])


@pytest.mark.parametrize("there", [(0.02, 0.1), (0.012, 0.12), (0.05, 0.11), (0.09, 0.1), (0.005, 0.15), (0.01, 0.02)])
def test_points_follow_the_borders_and_keep_their_order(there):
    places = np.linspace(0.0, 1.0, 501)
    found = np.array([moved_along(one, 0.01, 0.11, *there) for one in places])
    assert (found[0], found[-1]) == pytest.approx(there)
    assert np.all(np.diff(found) > 0.0)


def test_points_far_from_borders_that_move_a_little_keep_their_ca():
    assert moved_along(0.5, 0.01, 0.11, 0.015, 0.108) == pytest.approx(0.06, abs=4e-5)
    assert moved_along(0.05, 0.01, 0.11, 0.015, 0.108) == pytest.approx(0.0176, abs=1e-4)
