import numpy as np
import pytest

from capsbayes.surface import D4, octasphere
from capsbayes.surface.prolongation import prolonged


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
