"""The liquids' solver against analytic and independent numbers."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.physics.channel import CircularChannel, RectangularChannel, RoundedSquareChannel, SquareChannel
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem
from capsbayes.physics.stokes import SingleLayer, WallDiscretisation
from capsbayes.physics.surface import octasphere
from evidence.verification.closed_forms import rigid_sphere

COARSE_WALLS = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)


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


@pytest.mark.parametrize(
    ("channel", "size_ratio", "velocity_ratio", "extra_pressure_drop", "tolerance"),
    [
        (SquareChannel(), 0.3, 1.990163, 0.024220, 1e-4),
        (SquareChannel(), 0.5, 1.808701, 0.320879, 1e-4),
        (SquareChannel(), 0.7, 1.563738, 1.94190, 1e-4),
        (SquareChannel(), 0.8, 1.42899, 4.3363, 1e-4),
        (SquareChannel(), 0.85, 1.36050, 6.5400, 1e-4),
        (SquareChannel(), 0.9, 1.2916, 10.198, 3e-4),
        (CircularChannel(), 0.3, 1.880918, 0.039033, 1e-4),
        (CircularChannel(), 0.5, 1.679847, 0.521839, 1e-4),
        (CircularChannel(), 0.7, 1.416279, 3.28577, 1e-4),
        (CircularChannel(), 0.8, 1.27549, 7.7354, 1e-4),
        (CircularChannel(), 0.85, 1.2052, 12.234, 1e-4),
        (CircularChannel(), 0.9, 1.1357, 20.64, 3e-4),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_rigid_sphere(channel, size_ratio, velocity_ratio, extra_pressure_drop, tolerance):
    """Values that two independent methods gave, the last digit believed; refinement 12."""
    motion = rigid_sphere(Problem(NeoHookean(), channel, 12, 0.0), size_ratio)
    assert motion.velocity_ratio == pytest.approx(velocity_ratio, rel=tolerance)
    assert motion.extra_pressure_drop == pytest.approx(extra_pressure_drop, rel=tolerance)


def coarse(channel, size_ratio, walls=COARSE_WALLS):
    return rigid_sphere(Problem(NeoHookean(), channel, 4, 0.0, walls=walls), size_ratio)


@pytest.mark.parametrize(
    "channel",
    [SquareChannel(), CircularChannel(), RectangularChannel(1.3), RoundedSquareChannel(0.2)],
    ids=lambda channel: channel.name,
)
def test_small_spheres_move_by_the_law_of_faxen(channel):
    """V = centre velocity - dp a^2 / 6; the walls add only a fifth power of a."""
    centre = channel.undisturbed(np.zeros((1, 3)))[0][0, 2]
    for size_ratio in (0.1, 0.2):
        law = centre - channel.pressure_gradient * size_ratio**2 / 6.0
        assert abs(coarse(channel, size_ratio).velocity_ratio - law) < size_ratio**5 + 1e-6


@pytest.mark.parametrize("size_ratio", [0.5, 0.8])
def test_rectangle_of_equal_sides_is_the_square(size_ratio):
    assert coarse(RectangularChannel(1.0), size_ratio) == pytest.approx(coarse(SquareChannel(), size_ratio), rel=1e-5)


def test_rectangle_is_the_same_seen_from_both_sides():
    """The section 1.25 deep, and the one 1/1.25 deep in lengths over its own half width."""
    depth, walls = 1.25, COARSE_WALLS
    scaled = {name: getattr(walls, name) / depth for name in ("spacing", "far_spacing", "end", "near")}
    one = coarse(RectangularChannel(depth), 0.8)
    other = coarse(RectangularChannel(1.0 / depth), 0.8 / depth, replace(walls, **scaled))
    assert other.velocity_ratio == pytest.approx(one.velocity_ratio, rel=1e-7)
    assert other.extra_pressure_drop / depth == pytest.approx(one.extra_pressure_drop, rel=1e-7)


def test_rounded_corners_slow_the_sphere_down_from_the_square_to_the_circle():
    square, circle = coarse(SquareChannel(), 0.8).velocity_ratio, coarse(CircularChannel(), 0.8).velocity_ratio
    velocities = [
        coarse(RoundedSquareChannel(radius), 0.8).velocity_ratio for radius in (0.01, 0.05, 0.1, 0.3, 0.6, 0.999)
    ]
    assert velocities[0] == pytest.approx(square, abs=1e-4)
    assert velocities[-1] == pytest.approx(circle, abs=1e-3)
    assert np.all(np.diff([square, *velocities, circle]) < 0.0)
