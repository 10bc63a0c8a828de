from math import factorial

import numpy as np
import pytest

from capsbayes.physics.surface import LOCAL_NODES, dunavant, p2, p2_gradient, singular, subdivided


def monomial(p, q):
    """Integral of s^p t^q over the unit triangle."""
    return factorial(p) * factorial(q) / factorial(p + q + 2)


@pytest.mark.parametrize("degree", [2, 4, 5, 6])
@pytest.mark.parametrize("times", [0, 1, 2])
def test_regular_rules_integrate_polynomials_of_their_degree(degree, times):
    rule = subdivided(dunavant(degree), times)
    for p in range(degree + 1):
        q = degree - p
        value = rule.weights @ (rule.points[:, 0] ** p * rule.points[:, 1] ** q)
        assert value == pytest.approx(monomial(p, q), abs=1e-13)


@pytest.mark.parametrize("node", range(6))
def test_singular_rules_integrate_one_over_distance(node):
    """Against the rule of a much higher order, to which they converge exponentially."""
    coarse, fine = singular(node, 8), singular(node, 40)
    values = [rule.weights @ (1 / np.linalg.norm(rule.points - LOCAL_NODES[node], axis=1)) for rule in (coarse, fine)]
    assert values[0] == pytest.approx(values[1], rel=2e-5)
    assert np.sum(coarse.weights) == pytest.approx(0.5, rel=1e-13)


def test_shape_functions_are_one_at_their_node_and_sum_to_one():
    np.testing.assert_allclose(p2(LOCAL_NODES), np.eye(6), atol=1e-15)
    points = np.random.default_rng(1).uniform(0, 0.5, (20, 2))
    np.testing.assert_allclose(p2(points).sum(-1), 1.0)
    step = 1e-6
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        difference = (p2(points + shift) - p2(points - shift)) / (2 * step)
        np.testing.assert_allclose(p2_gradient(points)[..., axis], difference, atol=1e-9)
