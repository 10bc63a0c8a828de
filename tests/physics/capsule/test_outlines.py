import numpy as np
import pytest

from capsbayes.physics.load import profile, silhouette
from capsbayes.physics.surface import octasphere

MESH = octasphere(8)


def test_outlines_of_a_sphere_are_circles():
    for outline in (profile(MESH, MESH.nodes), silhouette(MESH, MESH.nodes)):
        assert outline.axial_extent == pytest.approx(2.0, abs=1e-4)
        assert outline.axial_length == pytest.approx(2.0, abs=1e-4)
        assert outline.perimeter == pytest.approx(2 * np.pi, rel=5e-4)


def test_concave_rear_shows_in_the_profile_and_not_in_the_silhouette():
    x = MESH.nodes
    pushed = np.where(x[:, 2] < 0, 0.8 * (1 - x[:, 0] ** 2 - x[:, 1] ** 2) ** 2, 0.0)
    nodes = x + np.column_stack([0 * pushed, 0 * pushed, pushed])
    assert profile(MESH, nodes).parachute_depth > 0.3
    assert silhouette(MESH, nodes).axial_length > profile(MESH, nodes).axial_length + 0.3
    assert silhouette(MESH, nodes).axial_extent == pytest.approx(profile(MESH, nodes).axial_extent, abs=5e-3)


def test_rim_that_lies_further_back_on_the_diagonals_lengthens_the_silhouette_only():
    x = MESH.nodes
    back = np.where(x[:, 2] < 0, -2.0 * x[:, 0] ** 2 * x[:, 1] ** 2, 0.0)
    nodes = x + np.column_stack([0 * back, 0 * back, back])
    assert profile(MESH, nodes).axial_extent == pytest.approx(2.0, abs=1e-4)
    rearmost = nodes[:, 2].min()
    assert silhouette(MESH, nodes).points[:, 0].min() == pytest.approx(rearmost, abs=2e-3)
