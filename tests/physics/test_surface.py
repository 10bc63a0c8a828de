"""The mesh of the sphere, its shape functions, and quadrature on the unit triangle."""

from math import factorial

import numpy as np
import pytest

from capsbayes.physics.surface import (
    C_INF_V,
    LOCAL_NODES,
    dunavant,
    octasphere,
    p2,
    p2_gradient,
    prolonged,
    singular,
    subdivided,
)


@pytest.mark.parametrize(("refinement", "unknowns"), [(6, 235), (8, 409), (12, 901)])
def test_counts_of_elements_nodes_and_free_coordinates(refinement, unknowns):
    mesh = octasphere(refinement)
    assert len(mesh.elements) == 8 * refinement**2
    assert len(mesh.nodes) == 16 * refinement**2 + 2
    assert mesh.expansion.shape == (3 * len(mesh.nodes), unknowns)


def test_expansion_of_the_reduced_sphere_is_the_sphere():
    mesh = octasphere(6)
    free = mesh.reduced(mesh.nodes[mesh.wedge])
    np.testing.assert_allclose(mesh.expanded(free), mesh.nodes, atol=1e-14)


def test_prolongation_keeps_a_smooth_symmetric_field():
    coarse, fine = octasphere(8), octasphere(12)

    def field(x):
        return x * (1 + 0.2 * x[:, 2:] + 0.1 * (x[:, :1] ** 4 + x[:, 1:2] ** 4))

    free = prolonged(coarse.reduced(field(coarse.nodes)[coarse.wedge]), coarse, fine)
    np.testing.assert_allclose(fine.expanded(free), field(fine.nodes), atol=2e-5)


def test_axisymmetric_fields_are_the_same_in_every_direction():
    """Any free coordinates; the knots are the latitudes of the mesh, so that its own fields are met at every node."""
    mesh = octasphere(6, C_INF_V)
    free = np.random.default_rng(1).normal(size=mesh.basis.shape[1])
    vectors, nodes = mesh.expanded(free), mesh.nodes
    radial = np.einsum("ni,ni->n", vectors[:, :2], nodes[:, :2]) / np.maximum(np.hypot(*nodes[:, :2].T), 1e-12)
    np.testing.assert_allclose(np.hypot(*vectors[:, :2].T), np.abs(radial), atol=1e-12)
    for values in (radial, vectors[:, 2]):
        for height in np.unique(np.round(nodes[:, 2], 9)):
            assert np.ptp(values[np.abs(nodes[:, 2] - height) < 1e-8]) < 1e-10
    assert mesh.largest(free) == pytest.approx(np.max(np.abs(vectors[mesh.wedge])))


def test_axisymmetric_fields_are_met_by_splines_of_the_latitude():
    mesh = octasphere(8, C_INF_V)

    def field(x):
        return x * (1 + 0.2 * x[:, 2:] + 0.1 * x[:, 2:] ** 3)

    free = mesh.reduced(field(mesh.nodes)[mesh.wedge])
    assert len(free) == 64
    np.testing.assert_allclose(mesh.basis.T @ (mesh.basis @ free), free, atol=1e-13)
    np.testing.assert_allclose(mesh.expanded(free), field(mesh.nodes), atol=1e-6)


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
