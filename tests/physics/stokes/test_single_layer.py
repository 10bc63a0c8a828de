import subprocess
import sys

import numpy as np
import pytest

from capsbayes.physics.stokes import QuadratureChoice, SingleLayer
from capsbayes.physics.surface import octasphere

ONE_RULE = QuadratureChoice(levels=(0.0,), rules=((6, 1), (6, 1)))


def wavy(mesh):
    """A symmetric shape that is no sphere, and a symmetric density on it."""
    x = mesh.nodes
    shape = 0.8 * x * (1 + 0.2 * x[:, 2:] + 0.1 * (x[:, :1] ** 4 + x[:, 1:2] ** 4))
    density = np.sin(3 * x) * [1, 1, 0] + np.cos(2 * x[:, 2:]) * [0, 0, 1]
    return shape, density


def test_derivatives_against_finite_differences():
    mesh = octasphere(5)
    shape, density = wavy(mesh)
    direction = np.random.default_rng(2).normal(size=mesh.basis.shape[1])
    change = mesh.expanded(direction)

    def velocity(step):
        nodes = shape + step * change
        layer = SingleLayer(mesh, 0.8, nodes, choice=ONE_RULE)
        return layer.matrices(nodes[mesh.wedge], target_nodes=mesh.wedge).velocity @ density[mesh.wedge].ravel()

    layer = SingleLayer(mesh, 0.8, shape, density, choice=ONE_RULE)
    matrices = layer.matrices(shape[mesh.wedge], target_nodes=mesh.wedge)
    moved = change[mesh.wedge]
    exact = np.einsum("tij,tj->ti", matrices.target_slope, moved).ravel() - matrices.source_slope @ moved.ravel()
    step = 1e-6
    difference = (velocity(step) - velocity(-step)) / (2 * step)
    assert np.max(np.abs(difference - exact)) < 1e-7 * np.max(np.abs(exact))


def test_default_rules_agree_with_much_finer_ones():
    mesh = octasphere(6)
    shape, density = wavy(mesh)
    finer = QuadratureChoice(levels=(12.0, 5.0, 2.5), rules=((5, 0), (6, 0), (6, 2), (6, 3)), singular_order=14)
    values = [
        SingleLayer(mesh, 0.8, shape, choice=choice).matrices(shape[mesh.wedge], target_nodes=mesh.wedge).velocity
        @ density[mesh.wedge].ravel()
        for choice in (QuadratureChoice(), finer)
    ]
    assert np.max(np.abs(values[0] - values[1])) < 2e-4 * np.max(np.abs(values[1]))


def test_pressure_inside_a_constant_normal_load_is_the_load():
    mesh = octasphere(8)
    layer = SingleLayer(mesh, 0.7, 0.7 * mesh.nodes, mesh.nodes)
    pressure = layer.pressure(np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0], [3.0, 0.0, 1.0]]))
    assert pressure == pytest.approx([-1.0, -1.0, 0.0], abs=2e-4)


STATE = """
import hashlib, numpy as np
from capsbayes import Simulator
nodes = Simulator(refinement=4).run(capillary_number=0.06, size_ratio=0.85).nodes
print(hashlib.sha256(np.ascontiguousarray(nodes).tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_a_state_has_the_same_bytes_in_every_process():
    """Arrays lie elsewhere in each."""
    command = [sys.executable, "-c", STATE]
    found = {subprocess.run(command, check=True, capture_output=True, text=True).stdout for _ in range(8)}
    assert len(found) == 1
