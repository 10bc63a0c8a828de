"""The simulator in cross-sections other than the square, and capsules that are spheroids at rest."""

import numpy as np
import pytest

from capsbayes import Simulator, Status
from capsbayes.physics.load import profile, silhouette
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.physics.surface import D2, octasphere

CASE = {"capillary_number": 0.05, "size_ratio": 0.8}


def simulator(**settings):
    return Simulator(
        refinement=4, pre_inflation=0.05, walls=WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5), **settings
    )


@pytest.fixture(scope="module")
def square():
    return simulator().run(**CASE)


def moved(state, other):
    """Largest distance of the membranes' nodes."""
    return np.max(np.linalg.norm(state.surface_nodes - other.surface_nodes, axis=1))


@pytest.mark.parametrize(
    "settings",
    [{"cross_section": "circular"}, {"corner_radius": 0.4}, {"section_aspect": 1.1}, {"rest_aspect": 1.1}],
    ids=lambda settings: str(*settings),
)
def test_every_section_has_a_steady_state(square, settings):
    state = simulator(**settings).run(**CASE, start=square)
    assert state.status is Status.DONE
    assert state.settings == square.settings | settings
    assert moved(state, square) > 1e-3
    membrane = simulator(**settings).problem.membrane(0.8)
    inside = membrane.enclosure(membrane.mesh.reduced(state.nodes))
    assert inside.volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=1e-7)


def test_rectangle_of_equal_sides_holds_the_capsule_of_the_square(square):
    """With half the symmetry, hence twice the unknowns."""
    state = simulator(cross_section="rectangular").run(**CASE, start=square)
    assert len(state.nodes) > 1.5 * len(square.nodes)
    assert moved(state, square) < 1e-5
    assert state.velocity_ratio == pytest.approx(square.velocity_ratio, abs=1e-5)
    assert state.extra_pressure_drop == pytest.approx(square.extra_pressure_drop, rel=1e-4)
    assert state.inner_pressure == pytest.approx(square.inner_pressure, rel=1e-4)


def test_rounded_corners_lead_back_to_the_square(square):
    distances = [moved(simulator(corner_radius=radius).run(**CASE, start=square), square) for radius in (0.02, 0.1)]
    assert distances[0] < 1e-3
    assert distances[0] < 0.1 * distances[1]


def test_capsule_fills_the_deeper_section(square):
    """Walls further away along x leave more room there than in the plane of the picture."""
    state = simulator(section_aspect=1.1).run(**CASE, start=square)
    across = np.max(np.abs(state.surface_nodes), axis=0)
    assert across[0] > across[1] + 0.01
    assert state.velocity_ratio > square.velocity_ratio


def test_outlines_of_a_shape_of_lesser_symmetry():
    """A rim that lies further back on the far sides x = +-1 than in the plane x = 0."""
    mesh = octasphere(8, D2)
    x = mesh.nodes
    back = np.where(x[:, 2] < 0, -0.8 * x[:, 0] ** 2, 0.0)
    nodes = x * [0.9, 0.8, 1.0] + np.outer(back, [0.0, 0.0, 1.0])
    here, whole = profile(mesh, nodes), silhouette(mesh, nodes)
    assert np.max(here.points[:, 1]) == pytest.approx(0.8, abs=1e-4)
    assert here.axial_extent == pytest.approx(2.0, abs=1e-4)
    assert whole.points[:, 0].min() == pytest.approx(nodes[:, 2].min(), abs=2e-3)
    assert whole.points[:, 0].min() < here.points[:, 0].min() - 0.02
