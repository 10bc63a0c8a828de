import numpy as np
import pytest

from capsbayes.surrogate.inversion import solve


def fold(x):
    """Manufactured fold: the first value has its largest value 1 at x = 0."""
    return np.array([1 - x[0] ** 2, x[1] + 0.2 * x[0]]), np.array([[-2 * x[0], 0.0], [0.2, 1.0]])


def test_a_smooth_map_is_inverted_to_roundoff():
    solution = solve(fold, np.array([0.75, 2.0]), np.array([[1.5, 0.0]]))
    np.testing.assert_allclose(solution.point, [0.5, 1.9], atol=1e-9)
    assert solution.exact


def test_each_side_of_a_fold_is_found_from_its_side():
    sides = [solve(fold, np.array([0.75, 2.0]), np.array([[start, 0.0]])).point[0] for start in (-2.0, 2.0)]
    np.testing.assert_allclose(sides, [-0.5, 0.5], atol=1e-9)


def test_beyond_a_fold_the_nearest_point_is_the_answer_and_says_so():
    solution = solve(fold, np.array([1.2, 2.0]), np.array([[0.7, 1.0], [-0.4, 3.0]]))
    assert not solution.exact
    assert solution.misfit == pytest.approx(0.2, abs=1e-6)
    assert solution.point[0] == pytest.approx(0.0, abs=1e-2)


def test_a_start_where_the_map_is_not_defined_is_passed_over():
    def somewhere(x):
        return fold(x) if x[0] > 0 else (np.full(2, np.nan), np.full((2, 2), np.nan))

    solution = solve(somewhere, np.array([0.75, 2.0]), np.array([[-1.0, 0.0], [1.0, 0.0]]))
    assert solution.exact
    assert np.isinf(solve(somewhere, np.array([0.75, 2.0]), np.array([[-1.0, 0.0]])).misfit)
