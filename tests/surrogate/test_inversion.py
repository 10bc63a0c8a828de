import numpy as np
import pytest

from capsbayes.surrogate.inverse import solve


def fold(points, rows):
    """Manufactured fold: the first value has its largest value 1 at x = 0."""
    x, y = points.T
    gradient = np.stack([np.stack([-2 * x, 0 * x], axis=1), np.full((len(x), 2), [0.2, 1.0])], axis=1)
    return np.stack([1 - x**2, y + 0.2 * x], axis=1), gradient


def solved(forward, wanted, *starts):
    """One problem from several starting points."""
    found = solve(forward, np.array([wanted]), np.array(starts)[:, None])
    return found.points[0], found.misfit[0], found.exact[0]


def test_a_smooth_map_is_inverted_to_roundoff():
    point, _, exact = solved(fold, [0.75, 2.0], [1.5, 0.0])
    np.testing.assert_allclose(point, [0.5, 1.9], atol=1e-9)
    assert exact


def test_each_side_of_a_fold_is_found_from_its_side():
    sides = [solved(fold, [0.75, 2.0], [start, 0.0])[0][0] for start in (-2.0, 2.0)]
    np.testing.assert_allclose(sides, [-0.5, 0.5], atol=1e-9)


def test_beyond_a_fold_the_nearest_point_is_the_answer_and_says_so():
    point, misfit, exact = solved(fold, [1.2, 2.0], [0.7, 1.0], [-0.4, 3.0])
    assert not exact
    assert misfit == pytest.approx(0.2, abs=1e-6)
    assert point[0] == pytest.approx(0.0, abs=1e-2)


def test_a_start_where_the_map_is_not_defined_is_passed_over():
    def somewhere(points, rows):
        value, gradient = fold(points, rows)
        value[points[:, 0] <= 0.0] = np.nan
        return value, gradient

    assert solved(somewhere, [0.75, 2.0], [-1.0, 0.0], [1.0, 0.0])[2]
    assert np.isinf(solved(somewhere, [0.75, 2.0], [-1.0, 0.0])[1])


def test_the_problems_of_a_batch_do_not_touch_each_other():
    rng = np.random.default_rng(2)
    wanted = np.stack([rng.uniform(-1.0, 1.2, 40), rng.uniform(-2.0, 2.0, 40)], axis=1)
    starts = rng.uniform(-2.0, 2.0, (3, 40, 2))
    together = solve(fold, wanted, starts)
    for row in range(40):
        alone = solve(fold, wanted[[row]], starts[:, [row]])
        np.testing.assert_array_equal(together.points[row], alone.points[0])
        assert together.exact[row] == alone.exact[0] == (wanted[row, 0] < 1.0)
    rows = []
    solve(lambda points, which: (rows.append(which), fold(points, which))[1], wanted, starts)
    assert all(len(which) == len(set(which)) for which in rows)
