"""Rates at which the errors fall with the mesh, and the error at refinement 8."""

import numpy as np
import pytest

from capsbayes import Database, Simulator, Status
from capsbayes.physics.channel import SquareChannel
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem
from capsbayes.physics.stokes import SingleLayer
from capsbayes.physics.surface import octasphere
from evidence.verification.closed_forms import rigid_sphere

REFINEMENTS = np.array([6, 8, 10])
POINTS = ((0.03, 0.8), (0.05, 0.9), (0.08, 0.95))
QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")


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
        rigid_sphere(Problem(NeoHookean(), SquareChannel(), n, 0.0), 0.7).extra_pressure_drop for n in (4, 6, 8, 16)
    ]
    assert fitted_rate(np.array([4, 6, 8]), np.abs(np.array(drops[:3]) - drops[3])) > 2.9


@pytest.fixture(scope="module")
def errors():
    """(refinement, point, quantity) array: L_z, L_a, V relative to the shipped cases, which have refinement 12."""
    shipped = Database.open("square-neo-hookean")
    rows = [
        np.flatnonzero((shipped["capillary_number"] == ca) & (shipped["size_ratio"] == size))[0] for ca, size in POINTS
    ]
    truth = np.stack([shipped[name][rows] for name in QUANTITIES], axis=-1)
    values = []
    for refinement in REFINEMENTS:
        simulator, state = Simulator(refinement=int(refinement)), "rest"
        for capillary_number, size_ratio in POINTS:
            state = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start=state)
            assert state.status is Status.DONE
            values.append([state.profile.axial_extent, state.profile.axial_length, state.velocity_ratio])
    return np.array(values).reshape(len(REFINEMENTS), len(POINTS), 3) / truth - 1


@pytest.mark.slow
def test_error_at_refinement_8_relative_to_12(errors):
    assert np.max(np.abs(errors[1, :, :2])) < 0.005
    assert np.max(np.abs(errors[1, :, 2])) < 0.001


@pytest.mark.slow
@pytest.mark.parametrize(("quantity", "rate"), [(0, 2.0), (1, 2.5), (2, 3.0)])
def test_lengths_and_velocity_converge(errors, quantity, rate):
    """Rates fitted to the rms over the points: 2.5 for L_z, which depends on the sharp rim, 3.5 for L_a, 5.1 for V."""
    rms = np.sqrt(np.mean(errors[:, :, quantity] ** 2, axis=1))
    assert fitted_rate(REFINEMENTS, rms) > rate
