import pickle

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.physics.channel import (
    CircularChannel,
    RectangularChannel,
    RoundedSquareChannel,
    SquareChannel,
    cross_section_named,
)
from capsbayes.physics.surface import C_INF_V, D4

CHANNELS = [
    SquareChannel(),
    CircularChannel(),
    RectangularChannel(0.7),
    RectangularChannel(1.6),
    RoundedSquareChannel(0.02),
    RoundedSquareChannel(0.3),
]


def outline(channel, spacing):
    """Points of the whole wall, and the length that each stands for."""
    points, lengths = channel.outline(spacing, 0.0)
    turns = channel.symmetry.operations[:, :2, :2]
    return np.concatenate([points @ turn.T for turn in turns]), np.tile(lengths, len(turns))


def at(points):
    return np.column_stack([points, np.zeros(len(points))])


@pytest.mark.parametrize(
    ("channel", "centre", "gradient"), [(SquareChannel(), 2.0962560, 7.113538), (CircularChannel(), 2.0, 8.0)]
)
def test_undisturbed_flow_of_classical_sections(channel, centre, gradient):
    """Closed form of the circle; series of the square (White, Viscous Fluid Flow, 3-48)."""
    assert channel.pressure_gradient == pytest.approx(gradient, abs=1e-6)
    assert channel.undisturbed(np.zeros((1, 3)))[0][0, 2] == pytest.approx(centre, abs=1e-7)


@pytest.mark.parametrize(("aspect", "friction"), [(1.0, 14.227), (2.0, 15.548), (0.5, 15.548)])
def test_friction_factor_of_rectangles(aspect, friction):
    """f Re of Shah & London 1978, Laminar Flow Forced Convection in Ducts, table 42."""
    hydraulic_diameter = 4.0 * aspect / (1.0 + aspect)
    factor = RectangularChannel(aspect).pressure_gradient * hydraulic_diameter**2 / 2.0
    assert factor == pytest.approx(friction, abs=1e-3)


@pytest.mark.parametrize("channel", CHANNELS, ids=repr)
def test_undisturbed_flow_solves_its_equation_on_the_section(channel):
    """No slip on the wall; and, by the divergence theorem, friction on the wall that balances the pressure drop."""
    wall, lengths = outline(channel, 2e-3)
    velocity, gradient = channel.undisturbed(at(wall))
    assert np.max(np.abs(velocity)) < 1e-4
    friction = np.linalg.norm(gradient[:, 2, :2], axis=1) @ lengths
    assert friction == pytest.approx(channel.pressure_gradient * channel.area, rel=2e-3)


@pytest.mark.parametrize("channel", CHANNELS, ids=repr)
def test_mean_velocity_is_one_and_points_fill_the_section(channel):
    points, areas = channel.filling(0.02, 0.0)
    share = areas * len(channel.symmetry.operations)
    assert np.sum(share) == pytest.approx(channel.area, rel=3e-3)
    assert channel.undisturbed(at(points))[0][:, 2] @ share / channel.area == pytest.approx(1.0, rel=3e-3)


@pytest.mark.parametrize("channel", CHANNELS, ids=repr)
def test_gradient_against_differences_and_symmetry(channel):
    points = np.random.default_rng(3).uniform(-0.65, 0.65, (30, 3))
    velocity, gradient = channel.undisturbed(points)
    for turn in channel.symmetry.operations:
        np.testing.assert_allclose(channel.undisturbed(points @ turn.T)[0], velocity, atol=1e-5)
    for axis in range(3):
        shift = 1e-6 * np.eye(3)[axis]
        difference = (channel.undisturbed(points + shift)[0] - channel.undisturbed(points - shift)[0]) / 2e-6
        np.testing.assert_allclose(gradient[:, :, axis], difference, atol=1e-7)


@pytest.mark.parametrize("channel", CHANNELS, ids=repr)
def test_points_outside_keep_their_distance(channel):
    """Moved outwards, every point is that far from the nearest of the wall; a sharp corner moves further."""
    wall, _ = outline(channel, 5e-3)
    moved, lengths = channel.outline(0.1, 0.2)
    distance = np.min(np.linalg.norm(moved[:, None] - wall, axis=-1), axis=1)
    assert np.all((distance > 0.199) & (distance < 0.2 * np.sqrt(2.0) + 1e-9))
    assert np.all(lengths < 0.1 + 1e-12)


def test_rectangle_turned_by_a_quarter_is_the_same_flow():
    """The aspect 1/b with lengths over b l instead of l; the two series converge differently."""
    depth, points = 1.4, np.random.default_rng(5).uniform(-0.9, 0.9, (20, 3))
    one, other = RectangularChannel(depth), RectangularChannel(1.0 / depth)
    turned = points[:, [1, 0, 2]] / depth
    np.testing.assert_allclose(one.undisturbed(points)[0], other.undisturbed(turned)[0], atol=1e-5)
    assert other.pressure_gradient == pytest.approx(one.pressure_gradient * depth**2, rel=1e-9)


def test_rounded_corners_tend_to_the_square_and_to_the_circle():
    """The pressure gradient leaves the square's with the area, as r_c^2."""
    square = SquareChannel.pressure_gradient
    radii = np.array([0.005, 0.01, 0.02, 0.04])
    gaps = [square - RoundedSquareChannel(radius).pressure_gradient for radius in radii]
    assert np.all(np.array(gaps) > 0.0)
    assert np.polyfit(np.log(radii), np.log(gaps), 1)[0] == pytest.approx(2.0, abs=0.02)
    assert gaps[0] / radii[0] ** 2 == pytest.approx(square * (4.0 - np.pi) / 4.0, rel=0.02)
    assert RoundedSquareChannel(0.999).pressure_gradient == pytest.approx(CircularChannel.pressure_gradient, rel=1e-3)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.3, 0.5, 0.9])
def test_rounded_corners_leave_no_velocity_on_the_wall(radius):
    wall, _ = outline(RoundedSquareChannel(radius), 1e-3)
    assert np.max(np.abs(RoundedSquareChannel(radius).undisturbed(at(wall))[0])) < 2e-8


def test_cross_sections_by_name():
    assert cross_section_named("square") == SquareChannel()
    assert cross_section_named("square", corner_radius=0.1) == RoundedSquareChannel(0.1)
    assert (
        cross_section_named("square", aspect=0.9)
        == cross_section_named("rectangular", aspect=0.9)
        == RectangularChannel(0.9)
    )
    assert cross_section_named("rectangular") == RectangularChannel(1.0)
    assert cross_section_named("circular") == CircularChannel()
    assert all(pickle.loads(pickle.dumps(channel)) == channel for channel in CHANNELS)
    assert len(set(CHANNELS)) == len(CHANNELS)
    assert SquareChannel().symmetry is RoundedSquareChannel(0.1).symmetry is D4
    assert CircularChannel().symmetry is C_INF_V


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("hexagon",), "cross_section: expected one of square, rectangular, circular, got 'hexagon'"),
        (("circular", 0.1), "corner_radius: expected 0, or a square cross-section of equal sides, got 0.1"),
        (("rectangular", 0.1), "corner_radius: expected 0, or a square cross-section of equal sides, got 0.1"),
        (("square", -0.1), "corner_radius: expected a number between 0 and 1, got -0.1"),
        (("square", float("nan")), "corner_radius: expected a number between 0 and 1, got nan"),
        (("circular", 0.0, 0.9), "section_aspect: expected 1 for a circular cross-section, got 0.9"),
        (("square", 0.1, 1.1), "corner_radius: expected 0, or a square cross-section of equal sides, got 0.1"),
        (("rectangular", 0.0, 3.0), "section_aspect: expected a number from 0.5 to 2, got 3.0"),
    ],
)
def test_impossible_sections_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        cross_section_named(*arguments)
