import numpy as np
import pytest

from capsbayes.physics.surface import C_INF_V, D4, octasphere, prolonged


@pytest.mark.parametrize(("refinement", "unknowns"), [(6, 235), (8, 409), (12, 901)])
def test_counts_of_elements_nodes_and_free_coordinates(refinement, unknowns):
    mesh = octasphere(refinement)
    assert len(mesh.elements) == 8 * refinement**2
    assert len(mesh.nodes) == 16 * refinement**2 + 2
    assert mesh.expansion.shape == (3 * len(mesh.nodes), unknowns)


@pytest.mark.parametrize("operation", range(8))
def test_every_operation_of_the_group_maps_the_mesh_onto_itself(operation):
    mesh = octasphere(5)
    turned = mesh.nodes @ D4.operations[operation].T
    distance = np.linalg.norm(turned[:, None] - mesh.nodes[None], axis=-1)
    assert np.max(np.min(distance, axis=1)) < 1e-12


def test_expansion_of_the_reduced_sphere_is_the_sphere():
    mesh = octasphere(6)
    free = mesh.reduced(mesh.nodes[mesh.wedge])
    np.testing.assert_allclose(mesh.expanded(free), mesh.nodes, atol=1e-14)


def test_elements_are_counterclockwise_seen_from_outside():
    mesh = octasphere(4)
    a, b, c = (mesh.nodes[mesh.elements[:, k]] for k in range(3))
    assert np.all(np.einsum("ei,ei->e", np.cross(b - a, c - a), a) > 0)


def test_quarter_is_that_of_positive_x_and_y():
    mesh = octasphere(4)
    assert np.all(mesh.nodes[mesh.quarter][..., :2] > -1e-12)
    assert 4 * len(mesh.quarter) == len(mesh.elements)


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
