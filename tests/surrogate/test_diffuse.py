import numpy as np
import pytest

from capsbayes.surrogate import diffuse
from capsbayes.surrogate.diffuse import each_left_out, leave_one_out


def cubic(nodes, values, *, degree=3, neighbours=14, **options):
    return diffuse.DiffuseApproximation(nodes, values, degree=degree, neighbours=neighbours, **options)


def jittered(spacing, *, seed=0):
    """Nodes of a disturbed grid over the unit square : (m, 2) array."""
    axis = np.arange(0, 1 + spacing / 2, spacing)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return nodes + np.random.default_rng(seed).uniform(-0.2, 0.2, nodes.shape) * spacing


def wave(points):
    """Manufactured smooth function and its gradient."""
    x, y = 3 * points[:, 0], 2 * points[:, 1]
    value = np.sin(x) * np.cos(y) + 0.3 * x * y
    slope_x = 3 * (np.cos(x) * np.cos(y) + 0.3 * y)
    slope_y = 2 * (-np.sin(x) * np.sin(y) + 0.3 * x)
    return value[:, None], np.stack([slope_x, slope_y], axis=-1)[:, None]


QUERIES = np.random.default_rng(1).uniform(0.02, 0.98, (200, 2))


@pytest.mark.parametrize(("degree", "neighbours"), [(1, 6), (2, 9), (3, 14), (4, 22)])
def test_polynomials_of_the_degree_are_reproduced_with_their_gradient(degree, neighbours):
    def polynomial(p):
        return ((1 + p[:, :1] - 2 * p[:, 1:]) ** degree,), degree * (1 + p[:, 0] - 2 * p[:, 1]) ** (degree - 1)

    nodes = jittered(0.08)
    approximation = cubic(nodes, polynomial(nodes)[0][0], degree=degree, neighbours=neighbours)
    value, gradient = approximation.with_gradient(QUERIES)
    exact, slope = polynomial(QUERIES)
    np.testing.assert_allclose(value, exact[0], atol=1e-11)
    np.testing.assert_allclose(gradient[:, 0], slope[:, None] * [1.0, -2.0], atol=1e-9)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_gradient_is_the_derivative_of_the_value(degree):
    nodes = jittered(0.1)
    approximation = cubic(nodes, wave(nodes)[0], degree=degree)
    step = 1e-5
    differences = [
        (approximation(QUERIES + shift) - approximation(QUERIES - shift)) / (2 * step) for shift in step * np.eye(2)
    ]
    gradient = approximation.with_gradient(QUERIES)[1]
    np.testing.assert_allclose(gradient, np.stack(differences, axis=-1), atol=1e-6)


def test_value_and_gradient_do_not_jump_where_nodes_come_and_go():
    nodes = jittered(0.1)
    approximation = cubic(nodes, wave(nodes)[0])
    path = np.linspace([0.1, 0.15], [0.9, 0.8], 20001)
    value, gradient = approximation.with_gradient(path)
    assert np.abs(np.diff(value, axis=0)).max() < 1e-3
    assert np.abs(np.diff(gradient, axis=0)).max() < 1e-3


@pytest.mark.parametrize(("degree", "neighbours"), [(1, 6), (2, 9), (3, 14)])
def test_the_error_falls_at_the_order_of_the_basis(degree, neighbours):
    spacings, errors = np.array([0.1, 0.07, 0.05, 0.035]), []
    for spacing in spacings:
        nodes = jittered(spacing)
        approximation = cubic(nodes, wave(nodes)[0], degree=degree, neighbours=neighbours)
        value, gradient = approximation.with_gradient(QUERIES)
        exact, slope = wave(QUERIES)
        errors.append([np.sqrt(np.mean((value - exact) ** 2)), np.sqrt(np.mean((gradient - slope) ** 2))])
    rates = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    assert rates[0] == pytest.approx(degree + 1, abs=0.5)
    assert rates[1] > degree - 0.3  # odd degrees gain on nearly regular nodes


def test_leaving_one_out_is_building_without_it():
    nodes = jittered(0.15)
    approximation = cubic(nodes, wave(nodes)[0])
    predicted = leave_one_out(approximation)
    for i, rest in enumerate(each_left_out(approximation)):
        rebuilt = cubic(np.delete(nodes, i, axis=0), np.delete(approximation.values, i, axis=0))
        np.testing.assert_allclose(rest.radii, rebuilt.radii, rtol=1e-14)
        query = nodes[i : i + 1]
        np.testing.assert_allclose(predicted[i], rebuilt.covering(query)(query)[0], rtol=1e-12)


def test_there_is_no_value_where_too_few_nodes_reach():
    nodes = jittered(0.1)
    value, gradient = cubic(nodes, wave(nodes)[0]).with_gradient(np.array([[3.0, 3.0]]))
    assert np.isnan(value).all()
    assert np.isnan(gradient).all()


def test_radii_grow_just_enough_to_reach_every_query():
    nodes = jittered(0.1)
    narrow = cubic(nodes, wave(nodes)[0], dilation=0.9)
    assert np.isnan(narrow(QUERIES)).any()
    wide = narrow.covering(QUERIES)
    np.testing.assert_allclose(wide(QUERIES), wave(QUERIES)[0], atol=5e-3)
    assert 0.9 < wide.dilation < 2.0
    assert wide.covering(QUERIES) is wide
    with pytest.raises(ValueError, match="too few or too unevenly spread"):
        wide.covering(np.array([[9.0, 9.0]]))


def test_radii_grow_until_no_value_is_a_difference_of_large_multiples():
    """Three rows of nodes hardly determine a cubic across them: its weights grow without bound as they line up."""
    x, rows = np.linspace(0.0, 1.0, 21), [0.0, 0.5, 1.0]
    nodes = np.array([(place, row + 1e-6 * (k % 2)) for row in rows for k, place in enumerate(x)] + [(0.5, 2.0)])
    query = np.array([[0.3, 0.75]])
    narrow = cubic(nodes, nodes[:, 1:], dilation=1.5).covering(query)
    assert np.abs(narrow.shape_functions(query)).sum() > 25.0
    wide = narrow.covering(query, 25.0)
    assert np.abs(wide.shape_functions(query)).sum() < 25.0


def test_too_many_neighbours_are_refused():
    with pytest.raises(ValueError, match="fewer than the 4 nodes"):
        cubic(np.eye(4)[:, :2], np.zeros((4, 1)), neighbours=4)
