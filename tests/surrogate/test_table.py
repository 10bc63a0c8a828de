import numpy as np
import pytest

from capsbayes.surrogate.diffuse import HermiteTable

QUERIES = np.random.default_rng(2).uniform([0.05, 0.05], [0.95, 1.95], (500, 2))
LOW, HIGH = np.array([0.0, 0.0]), np.array([1.0, 2.0])


def lattice(cells):
    axes = (np.linspace(0.0, end, cells + 1) for end in HIGH)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def function(points):
    """Manufactured smooth function with its gradient."""
    x, y = points.T
    slopes = np.stack([2 * np.cos(2 * x) * np.exp(y / 2), np.sin(2 * x) * np.exp(y / 2) / 2], axis=-1)
    return (np.sin(2 * x) * np.exp(y / 2))[:, None], slopes[:, None]


def tabulated(cells):
    return HermiteTable.of(function, lattice(cells), np.ones((cells + 1,) * 2, dtype=bool))


def test_the_error_falls_with_the_fourth_power_of_the_cell():
    cells, errors = np.array([8, 16, 32, 64]), []
    for count in cells:
        value, gradient = tabulated(count).with_gradient(QUERIES)
        exact, slope = function(QUERIES)
        errors.append([np.abs(value - exact).max(), np.abs(gradient - slope).max()])
    rates = -np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert rates[0] == pytest.approx(4, abs=0.3)
    assert rates[1] == pytest.approx(3, abs=0.3)


def test_the_gradient_is_the_derivative_of_the_value():
    table, step = tabulated(10), 1e-6
    numbers = [
        (table.with_gradient(QUERIES + d)[0] - table.with_gradient(QUERIES - d)[0]) / (2 * step)
        for d in step * np.eye(2)
    ]
    np.testing.assert_allclose(table.with_gradient(QUERIES)[1], np.stack(numbers, axis=-1), atol=1e-6)


def test_values_and_gradients_at_the_lattice_are_kept_and_the_last_point_is_reached():
    table = tabulated(8)
    value, gradient = table.with_gradient(np.array([LOW, [0.5, 0.25], HIGH]))
    exact, slope = function(np.array([LOW, [0.5, 0.25], HIGH]))
    np.testing.assert_allclose(value, exact, atol=1e-14)
    np.testing.assert_allclose(gradient, slope, atol=1e-13)


def test_lattice_points_not_wanted_are_not_asked_and_give_nan_around():
    wanted = np.ones((9, 9), dtype=bool)
    wanted[:4] = False
    table = HermiteTable.of(function, lattice(8), wanted)
    value = table.with_gradient(np.array([[0.3, 1.0], [0.45, 1.0], [0.6, 1.0]]))[0][:, 0]
    np.testing.assert_array_equal(np.isnan(value), [True, True, False])
    assert value[2] == pytest.approx(function(np.array([[0.6, 1.0]]))[0][0, 0], abs=1e-3)
