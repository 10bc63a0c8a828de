"""A neo-Hookean capsule in simple shear without walls, against theory and published simulations."""

import numpy as np
import pytest

from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem
from capsbayes.physics.transient import transient
from evidence.verification.capsules import ShearFlow, taylor_deformation


def deformations(capillary_number, times, refinement=4):
    """Taylor's D (len(times),) of a capsule sheared from rest."""
    problem = Problem(NeoHookean(), ShearFlow(), refinement, 2e-4)
    start = problem.at_rest(capillary_number, 1.0)
    # nodes go round with the membrane, so it is D that becomes steady
    instants = transient(problem, start, times, steady=0.0)
    return np.array([taylor_deformation(problem.mesh, problem.mesh.expanded(i.iterate.free)) for i in instants])


def test_small_deformations_follow_the_linear_theory():
    """D = 25/12 Ca (Barthes-Biesel & Rallison 1981, doi 10.1017/S0022112081001481)."""
    (deformation,) = deformations(0.01, [0.3])
    assert deformation == pytest.approx(25 / 12 * 0.01, rel=0.01)


def test_large_deformations_begin_as_in_another_code():
    """At Ca = 0.6 front tracking on a fine grid gave D = 0.3686 at time 1 (Huet & Wachs 2023)."""
    (deformation,) = deformations(0.6, [1.0])
    assert deformation == pytest.approx(0.3686, rel=0.005)


@pytest.mark.slow
def test_steady_deformation_lies_among_the_published_ones():
    """At Ca = 0.15 Ramanujan & Pozrikidis (1998) found 0.261, Doddi & Bagchi (2008) 0.279."""
    (deformation,) = deformations(0.15, [5.0], refinement=5)
    assert 0.261 < deformation < 0.279


def test_symmetry_holds_the_centroid():
    problem = Problem(NeoHookean(), ShearFlow(), 4, 2e-4)
    *_, end = transient(problem, problem.at_rest(0.3, 1.0), [0.2])
    inside = problem.membrane(1.0).enclosure(end.iterate.free)
    assert end.iterate.velocity == 0.0
    assert inside.volume == pytest.approx(4 / 3 * np.pi, rel=1e-7)
