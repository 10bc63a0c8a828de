import numpy as np
import pytest

from capsbayes.physics.channel import (
    CircularChannel,
    FourfoldTube,
    RectangularChannel,
    RoundedSquareChannel,
    SquareChannel,
)
from capsbayes.physics.stokes import WallDiscretisation, WallOperator, images_gradient, images_matrix
from capsbayes.physics.surface import D4


def test_stokeslet_and_its_gradient():
    """Against the closed form at one point, and finite differences."""
    source, identity = np.zeros((1, 3)), np.eye(3)[None]
    target = np.array([[0.0, 0.0, 2.0]])
    np.testing.assert_allclose(images_matrix(target, source, identity), np.diag([0.5, 0.5, 1.0]))
    rng = np.random.default_rng(4)
    targets, sources, forces = rng.normal(size=(5, 3)), rng.normal(size=(4, 3)) + 4, rng.normal(size=(4, 3))
    gradient = images_gradient(targets, sources, D4.operations, forces)
    for axis in range(3):
        shift = 1e-6 * np.eye(3)[axis]
        change = images_matrix(targets + shift, sources, D4.operations) - images_matrix(
            targets - shift, sources, D4.operations
        )
        difference = (change @ forces.ravel()).reshape(-1, 3) / 2e-6
        np.testing.assert_allclose(gradient[:, :, axis], difference, atol=1e-7)


@pytest.mark.parametrize(
    ("channel", "walls"),
    [
        (SquareChannel(), WallDiscretisation()),
        (FourfoldTube(), WallDiscretisation()),
        (RoundedSquareChannel(0.02), WallDiscretisation()),
        (RoundedSquareChannel(0.3), WallDiscretisation()),
        (RectangularChannel(1.2), WallDiscretisation(spacing=0.16, far_spacing=0.3)),
        pytest.param(RectangularChannel(0.8), WallDiscretisation(), marks=pytest.mark.slow),
    ],
)
def test_velocity_on_the_walls_is_cancelled_between_the_collocation_points(channel, walls):
    """A ring of Stokeslets four spacings from the wall; the residual is measured at other points."""
    operator = WallOperator(channel, walls)
    turns = channel.symmetry.operations
    side = float(np.max(channel.outline(walls.spacing, 0.0)[0][:, 0]))
    source = np.array([[side - 4.0 * walls.spacing, 0.2, 0.1]])
    force = np.array([0.3, -0.2, 1.0])
    on_wall = images_matrix(operator.points, source, turns) @ force
    strengths = operator.strengths(on_wall)
    ring, _ = channel.outline(0.037, 0.0)
    axial = np.linspace(-1.5, 1.5, 41)
    probes = np.column_stack([np.tile(ring, (len(axial), 1)), np.repeat(axial, len(ring))])
    left = images_matrix(probes, source, turns) @ force + operator.velocity_matrix(probes) @ strengths.ravel()
    assert np.max(np.abs(left)) < 5e-3 * np.max(np.abs(on_wall))
    assert np.sqrt(np.mean(left**2)) < 5e-4 * np.sqrt(np.mean(on_wall**2))


def test_in_a_tube_one_point_of_each_ring_tells_an_axisymmetric_velocity():
    """A Stokeslet along the axis, off the middle: the walls answer as to its velocity on all of their points."""
    rings, all_points = (
        WallOperator(CircularChannel(), WallDiscretisation()),
        WallOperator(FourfoldTube(), WallDiscretisation()),
    )
    source, force = np.array([[0.0, 0.0, 0.3]]), np.array([0.0, 0.0, 1.0])
    once = np.eye(3)[None]
    at_rings, everywhere = (images_matrix(one.points, source, once) @ force for one in (rings, all_points))
    assert 5 * len(at_rings) < len(everywhere)
    np.testing.assert_allclose(rings.strengths(at_rings), all_points.strengths(everywhere), rtol=1e-9, atol=1e-9)
    row = np.random.default_rng(1).normal(size=(2, 3 * len(rings.sources)))
    np.testing.assert_allclose(rings.response(row) @ at_rings, all_points.response(row) @ everywhere, rtol=1e-7)
