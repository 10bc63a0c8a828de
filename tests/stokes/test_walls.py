import numpy as np
import pytest

from capsbayes.stokes.channel import SquareChannel
from capsbayes.stokes.stokeslet import images_gradient, images_matrix
from capsbayes.stokes.walls import WallOperator, Walls
from capsbayes.surface import D4


def test_stokeslet_and_its_gradient():
    """Against the closed form at one point, and finite differences."""
    source, identity = np.zeros((1, 3)), np.eye(3)[None]
    target = np.array([[0.0, 0.0, 2.0]])
    np.testing.assert_allclose(images_matrix(target, source, identity), np.diag([0.5, 0.5, 1.0]))
    rng = np.random.default_rng(4)
    targets, sources, forces = rng.normal(size=(5, 3)), rng.normal(size=(4, 3)) + 4, rng.normal(size=(4, 3))
    gradient = images_gradient(targets, sources, D4, forces)
    for axis in range(3):
        shift = 1e-6 * np.eye(3)[axis]
        change = images_matrix(targets + shift, sources, D4) - images_matrix(targets - shift, sources, D4)
        difference = (change @ forces.ravel()).reshape(-1, 3) / 2e-6
        np.testing.assert_allclose(gradient[:, :, axis], difference, atol=1e-7)


@pytest.mark.slow
def test_velocity_on_the_walls_is_cancelled_between_the_collocation_points():
    """A ring of Stokeslets 0.3 from the wall; the residual is measured at other points."""
    channel = SquareChannel()
    operator = WallOperator(channel, Walls(), D4)
    source = np.array([[0.7, 0.2, 0.1]])
    force = np.array([0.3, -0.2, 1.0])
    on_wall = images_matrix(operator.points, source, D4) @ force
    strengths = operator.strengths(on_wall)
    y, z = (array.ravel() for array in np.meshgrid(np.linspace(0, 0.99, 28), np.linspace(-1.5, 1.5, 41)))
    probes = np.column_stack([np.ones_like(y), y, z])
    left = images_matrix(probes, source, D4) @ force + operator.velocity_matrix(probes) @ strengths.ravel()
    assert np.max(np.abs(left)) < 0.01 * np.max(np.abs(on_wall))
    assert np.sqrt(np.mean(left**2)) < 1e-3 * np.sqrt(np.mean(on_wall**2))
