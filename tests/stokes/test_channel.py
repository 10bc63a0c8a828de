import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.stokes.channel import SquareChannel, section_named


def test_undisturbed_flow_of_the_square_channel():
    """Centre velocity and pressure gradient of the classical series (White, Viscous Fluid Flow, 3-48)."""
    channel = SquareChannel()
    assert channel.pressure_gradient == pytest.approx(7.113538, abs=1e-6)
    assert channel.undisturbed(np.zeros((1, 3)))[0] == pytest.approx(2.0962560, abs=1e-7)


def test_undisturbed_flow_has_mean_one_and_vanishes_on_the_walls():
    channel = SquareChannel()
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x, y = (a.ravel() for a in np.meshgrid(nodes, nodes))
    speed, _ = channel.undisturbed(np.column_stack([x, y, 0 * x]))
    assert np.outer(weights, weights).ravel() @ speed / 4 == pytest.approx(1.0, abs=1e-7)
    wall = np.column_stack([np.ones(9), np.linspace(-0.9, 0.9, 9), np.zeros(9)])
    for points in (wall, wall[:, [1, 0, 2]]):
        assert np.max(np.abs(channel.undisturbed(points)[0])) < 1e-5


def test_gradient_against_finite_differences_and_symmetry():
    channel = SquareChannel()
    points = np.random.default_rng(3).uniform(-0.9, 0.9, (30, 3))
    speed, gradient = channel.undisturbed(points)
    swapped, _ = channel.undisturbed(points[:, [1, 0, 2]])
    np.testing.assert_allclose(speed, swapped, atol=2e-6)
    for axis in range(3):
        shift = 1e-6 * np.eye(3)[axis]
        difference = (channel.undisturbed(points + shift)[0] - channel.undisturbed(points - shift)[0]) / 2e-6
        np.testing.assert_allclose(gradient[:, axis], difference, atol=1e-7)


def test_unknown_section_names_those_there_are():
    with pytest.raises(InputError, match="one of square, got 'hexagon'"):
        section_named("hexagon")
