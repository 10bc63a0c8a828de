"""Which steady shape a capsule started from rest comes to."""

from __future__ import annotations

import numpy as np
import pytest

from capsbayes.physics.channel import SquareChannel
from capsbayes.physics.continuation import is_shallow, is_stable, may_buckle, near_rest, parachute, settled
from capsbayes.physics.load import profile
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem, steady_state
from capsbayes.physics.transient import transient
from capsbayes.status import Status


@pytest.fixture(scope="module")
def problem():
    return Problem(NeoHookean(), SquareChannel(), 5, 2e-4)


def extent(problem, iterate):
    return profile(problem.mesh, problem.mesh.expanded(iterate.free)).axial_extent


@pytest.mark.slow
def test_at_low_ca_it_stays_convex_as_an_exact_transient_does(problem):
    found = settled(problem, 0.008, 0.75)
    *_, instant = transient(problem, problem.at_rest(0.008, 0.75), [10.0], steady=2e-3)
    assert is_shallow(problem, found.iterate)
    assert extent(problem, found.iterate) == pytest.approx(extent(problem, instant.iterate), rel=5e-4)
    assert extent(problem, found.iterate) == pytest.approx(
        extent(problem, steady_state(problem, near_rest(problem, 0.75).result.iterate).iterate), rel=5e-3
    )


@pytest.mark.slow
def test_at_higher_ca_it_snaps_through_to_the_parachute(problem):
    found, expected = settled(problem, 0.03, 0.75), parachute(problem, 0.03, 0.75)
    assert expected.status is Status.DONE
    np.testing.assert_allclose(found.iterate.free, expected.result.iterate.free, atol=1e-6)
    assert not is_shallow(problem, found.iterate)
    assert is_stable(problem, found.iterate)


def test_buckling_is_feared_where_a_shallow_shape_is_compressed(problem):
    unstressed, compressed = problem.at_rest(0.01, 0.75), near_rest(problem, 0.9).result.iterate
    assert not may_buckle(problem, unstressed)
    assert may_buckle(problem, compressed)
    assert not may_buckle(Problem(NeoHookean(), SquareChannel(), 5, 0.02), compressed)
    assert not may_buckle(problem, parachute(problem, 0.05, 0.75).result.iterate)
