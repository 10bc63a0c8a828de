"""Rates at which the errors fall with the mesh, and the error at refinement 8."""

import numpy as np
import pytest

from capsbayes import Simulator, Status
from capsbayes.membrane import NeoHookean
from capsbayes.simulation.rigid import rigid_sphere
from capsbayes.simulation.steady_state import SteadyProblem
from capsbayes.stokes.channel import SquareChannel
from capsbayes.stokes.single_layer import SingleLayer
from capsbayes.surface import octasphere

REFINEMENTS = np.array([6, 8, 12])
POINTS = ((0.03, 0.8), (0.05, 0.9), (0.082, 0.96))


def fitted_rate(refinements, errors):
    """Exponent p of error ~ n^-p by least squares of the logarithms."""
    return -np.polyfit(np.log(refinements), np.log(errors), 1)[0]


def test_single_layer_of_a_translating_sphere_converges_at_third_order():
    refinements, errors = np.array([4, 6, 8, 12]), []
    for refinement in refinements:
        mesh = octasphere(int(refinement))
        matrices = SingleLayer(mesh, 1.0, mesh.nodes).matrices(mesh.nodes[mesh.wedge], target_nodes=mesh.wedge)
        velocity = (matrices.velocity @ np.tile([0, 0, 1.5], len(mesh.wedge))).reshape(-1, 3)
        errors.append(np.max(np.abs(velocity - [0, 0, 1])))
    assert fitted_rate(refinements, errors) > 2.9


@pytest.mark.slow
def test_pressure_drop_of_a_rigid_sphere_converges_at_third_order():
    drops = [
        rigid_sphere(SteadyProblem(NeoHookean(), SquareChannel(), n, 0.0), 0.7).extra_pressure_drop
        for n in (4, 6, 8, 16)
    ]
    assert fitted_rate(np.array([4, 6, 8]), np.abs(np.array(drops[:3]) - drops[3])) > 2.9


@pytest.fixture(scope="module")
def shapes():
    """(refinement, point, quantity): L_z, L_a, V."""
    values = []
    for refinement in REFINEMENTS:
        simulator, state = Simulator(refinement=int(refinement)), None
        for capillary_number, size_ratio in POINTS:
            state = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start=state)
            assert state.status is Status.DONE
            values.append([state.profile.axial_extent, state.profile.axial_length, state.velocity_ratio])
    return np.array(values).reshape(len(REFINEMENTS), len(POINTS), 3)


@pytest.mark.slow
def test_error_at_refinement_8_beside_12(shapes):
    error = np.abs(shapes[1] / shapes[2] - 1)
    assert np.max(error[:, :2]) < 0.005
    assert np.max(error[:, 2]) < 0.001


@pytest.mark.slow
def test_velocity_and_axial_length_converge_where_the_rim_is_resolved(shapes):
    """Errors beside refinement 12, fitted over 6 and 8 at the point with the roundest rim."""
    error = np.abs(shapes[:2, 0] - shapes[2, 0])
    rates = [fitted_rate(REFINEMENTS[:2], error[:, k]) for k in (1, 2)]
    assert min(rates) > 2.0
