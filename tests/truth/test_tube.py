"""Neo-Hookean capsules in a circular tube against an independent axisymmetric solver without bending.

Its errors are below 1e-5. Where the belly is compressed (no pre-inflation, a/R from 0.9 on) the smooth shape is
unstable: the membrane wrinkles about the axis.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from capsbayes import Simulator, Status
from capsbayes.physics.channel import FourfoldTube
from capsbayes.physics.continuation import parachute
from capsbayes.physics.load import profile
from capsbayes.physics.steady import steady_state
from capsbayes.physics.transient import growth_rates
from evidence.benchmarks import bending


def test_inflated_capsule_from_rest():
    """Ca = 0.01, a/R = 0.8, alpha = 0.02: stiff enough for Newton's iteration to converge from the sphere at rest."""
    problem = Simulator(cross_section="circular", refinement=6, pre_inflation=0.02).problem
    result = steady_state(problem, problem.at_rest(0.01, 0.8))
    outline = profile(problem.mesh, problem.mesh.expanded(result.iterate.free))
    assert result.converged
    assert outline.axial_extent == pytest.approx(1.5988, rel=2e-4)
    assert outline.axial_length == pytest.approx(1.5988, rel=2e-4)
    assert result.iterate.velocity == pytest.approx(1.27729, rel=5e-4)


@cache
def steady(capillary_number, size_ratio, pre_inflation):
    simulator = Simulator(cross_section="circular", refinement=8, pre_inflation=pre_inflation)
    return simulator.run(capillary_number=capillary_number, size_ratio=size_ratio)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "extent", "length", "velocity", "tolerance"),
    [
        ((0.05, 0.8, 0.0), 1.5345, 1.3668, 1.28055, 0.003),
        ((0.1, 0.7, 0.0), 1.3339, 1.1398, 1.39495, 0.003),
        ((0.01, 0.8, 0.02), 1.5988, 1.5988, 1.27729, 0.001),
        ((0.01, 1.0, 0.05), 2.1619, 2.1619, 1.09649, 0.001),
        ((0.05, 0.9, 0.0), 1.8957, 1.7196, 1.21894, 0.003),
        ((0.05, 1.0, 0.0), 2.3615, 2.1776, 1.18802, 0.002),
    ],
    ids=str,
)
def test_capsules_in_a_tube(case, extent, length, velocity, tolerance):
    """Cases (Ca, a/R, alpha)."""
    state = steady(*case)
    assert state.status is Status.DONE
    assert state.profile.axial_extent == pytest.approx(extent, rel=tolerance)
    assert state.profile.axial_length == pytest.approx(length, rel=tolerance)
    assert state.velocity_ratio == pytest.approx(velocity, rel=min(tolerance, 0.002))


@pytest.mark.slow
def test_wrinkles_grow_where_the_belly_is_compressed():
    assert np.isnan(steady(0.01, 1.0, 0.05).wrinkling_rate)
    assert not steady(0.05, 0.8, 0.0).wrinkling_rate > 0.0
    assert steady(0.05, 0.9, 0.0).wrinkling_rate > 1.0
    assert steady(0.05, 1.0, 0.0).wrinkling_rate > 10.0


@pytest.mark.slow
def test_wrinkled_capsule_is_longer_on_its_axis():
    """Ca = 0.05, a/R = 1.0, B = 1e-3, shapes that keep the mesh's symmetry: stable, unlike the smooth one."""
    problem = replace(Simulator(cross_section="circular", bending=1e-3).problem, flow=FourfoldTube())
    result = parachute(problem, 0.05, 1.0).result
    nodes = problem.mesh.expanded(result.iterate.free)
    rim = nodes[np.abs(problem.mesh.nodes[:, 2]) < 1e-9]
    assert result.converged
    assert np.ptp(np.hypot(rim[:, 0], rim[:, 1])) > 0.1
    assert growth_rates(problem, result.iterate)[0].real < 0.0
    assert profile(problem.mesh, nodes).axial_length == pytest.approx(1.02 * 2.1776, rel=0.005)
    assert profile(problem.mesh, nodes).axial_extent == pytest.approx(2.3615, rel=0.005)
    assert result.iterate.velocity == pytest.approx(1.18802, rel=0.005)


@pytest.mark.slow
def test_an_entry_of_the_table_of_falling_stiffness_is_found_again():
    """Ca = 0.02, a/R = 0.8, B = 2e-4, refinement 6; L_z is within 1 % of the limit B -> 0."""
    stored = bending.STORED.read()["tube 6 0.0002"]
    assert bending.tube(6, 2e-4) == pytest.approx(stored, rel=1e-5)
    assert stored[0] == pytest.approx(1.49586, rel=0.01)
    assert stored[1] == pytest.approx(1.36403, rel=0.01)


@pytest.mark.parametrize(("quantity", "unbent"), [(0, 1.49586), (1, 1.36403)])
def test_lengths_tend_to_those_without_bending(quantity, unbent):
    """Ca = 0.02, a/R = 0.8: at every B they are shorter, and their limit is that of the solver without bending."""
    stored = bending.STORED.read()
    lengths = [stored[f"tube {bending.MESHES[-1]} {stiffness:g}"][quantity] for stiffness in bending.BENDINGS]
    assert np.all(np.diff(lengths) > 0)
    assert lengths[-1] < unbent
    end, power = bending.limit(stored, quantity)
    assert end == pytest.approx(unbent, rel=2e-3)
    assert 0.2 < power < 0.8
