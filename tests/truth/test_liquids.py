"""The liquids' solver against analytic and independent numbers."""

import numpy as np
import pytest

from capsbayes.membrane import NeoHookean
from capsbayes.simulation.rigid import rigid_sphere
from capsbayes.simulation.steady_state import SteadyProblem
from capsbayes.stokes.channel import SquareChannel
from capsbayes.stokes.single_layer import SingleLayer
from capsbayes.surface import octasphere


def test_stokes_drag_of_a_translating_sphere():
    """A uniform traction of total force 6 pi mu a V moves a sphere of radius a with velocity V everywhere."""
    mesh, radius = octasphere(8), 0.8
    nodes = radius * mesh.nodes
    matrices = SingleLayer(mesh, radius, nodes).matrices(nodes[mesh.wedge], target_nodes=mesh.wedge)
    traction = 6 * np.pi * radius / (4 * np.pi * radius**2)
    velocity = (matrices.velocity @ np.tile([0, 0, traction], len(mesh.wedge))).reshape(-1, 3)
    np.testing.assert_allclose(velocity, np.tile([0, 0, 1.0], (len(velocity), 1)), atol=1e-4)


def test_constant_pressure_moves_nothing():
    mesh = octasphere(8)
    matrices = SingleLayer(mesh, 1.0, mesh.nodes).matrices(mesh.nodes[mesh.wedge], target_nodes=mesh.wedge)
    velocity = matrices.velocity @ mesh.nodes[mesh.wedge].ravel()
    assert np.max(np.abs(velocity)) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size_ratio", "velocity_ratio", "extra_pressure_drop", "tolerance"),
    [
        (0.3, 1.990163, 0.024220, 1e-4),
        (0.5, 1.808701, 0.320879, 1e-4),
        (0.7, 1.563738, 1.94190, 1e-4),
        (0.8, 1.42899, 4.3363, 1e-4),
        (0.85, 1.36050, 6.5400, 1e-4),
        (0.9, 1.2916, 10.198, 1e-3),
    ],
)
def test_rigid_sphere_in_a_square_channel(size_ratio, velocity_ratio, extra_pressure_drop, tolerance):
    """Values that two independent methods gave, the last digit believed; refinement 12."""
    motion = rigid_sphere(SteadyProblem(NeoHookean(), SquareChannel(), 12, 0.0), size_ratio)
    assert motion.velocity_ratio == pytest.approx(velocity_ratio, rel=tolerance)
    assert motion.extra_pressure_drop == pytest.approx(extra_pressure_drop, rel=tolerance)
