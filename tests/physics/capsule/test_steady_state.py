from dataclasses import replace

import numpy as np
import pytest

from capsbayes.physics.channel import SquareChannel
from capsbayes.physics.continuation import fold, interpolated, near_rest, traced
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.steady import Problem, bordered, steady_residual, steady_state
from capsbayes.physics.stokes import WallDiscretisation

COARSE_WALLS = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)


@pytest.mark.parametrize("bending_energy", ["displacement", "curvature"])
def test_jacobian_is_exact(bending_energy):
    """Against central differences along smooth directions, at a shape far from rest."""
    problem = Problem(NeoHookean(), SquareChannel(), 5, 1e-3, 0.05, walls=COARSE_WALLS, bending_energy=bending_energy)
    mesh = problem.mesh
    x = mesh.nodes[mesh.wedge]
    shape = 0.8 * mesh.reduced(x * (1.02 + 0.1 * x[:, 2:] + 0.05 * (x[:, :1] ** 4 + x[:, 1:2] ** 4)))
    iterate = replace(problem.at_rest(0.1, 0.8), free=shape)
    _, slopes = problem.linearised(iterate)
    for field in (
        np.column_stack([x[:, 0] * x[:, 2], x[:, 1] * x[:, 2], np.cos(3 * x[:, 2])]),
        np.column_stack([x[:, 0] ** 3, x[:, 1] ** 3, x[:, 2] ** 2]),
    ):
        direction, step = mesh.reduced(field), 1e-6
        ahead, behind = (problem.motion(replace(iterate, free=shape + s * direction)) for s in (step, -step))
        difference = (ahead.error - behind.error) / (2 * step)
        np.testing.assert_allclose(slopes.along_shape @ direction, difference, atol=1e-6 * np.abs(difference).max())
    ahead, behind = (problem.motion(replace(iterate, capillary_number=0.1 + s)) for s in (1e-6, -1e-6))
    difference = (ahead.error - behind.error) / 2e-6
    np.testing.assert_allclose(slopes.along_ca, difference, atol=1e-6 * np.abs(difference).max())


def test_newton_converges_quadratically_from_an_inflated_capsule_at_rest():
    problem = Problem(NeoHookean(), SquareChannel(), 5, 2e-4, 0.3, walls=COARSE_WALLS)
    iterate, residuals = problem.at_rest(0.05, 0.8), []
    for _ in range(6):
        linearised = bordered(problem, iterate)
        residuals.append(np.max(np.abs(linearised.residual)))
        iterate = iterate.moved(-np.linalg.solve(linearised.matrix, linearised.residual))
    assert residuals[-1] < 30 * residuals[-2] ** 2 + 1e-11
    kept = steady_state(problem, problem.at_rest(0.05, 0.8))  # with derivatives that are kept
    assert kept.converged
    np.testing.assert_allclose(kept.iterate.free, iterate.free, atol=1e-7)


def test_tangent_predicts_the_neighbouring_state():
    problem = Problem(NeoHookean(), SquareChannel(), 5, 2e-4, 0.3, walls=COARSE_WALLS)
    here = steady_state(problem, problem.at_rest(0.05, 0.8))
    there = steady_state(problem, replace(here.iterate, capillary_number=0.052))
    predicted = here.iterate.moved(0.002 * here.tangent)
    moved = np.max(np.abs(there.iterate.free - here.iterate.free))
    assert np.max(np.abs(predicted.free - there.iterate.free)) < 0.05 * moved
    assert predicted.velocity == pytest.approx(there.iterate.velocity, abs=1e-4)


def test_iteration_that_leads_nowhere_is_given_up():
    problem = Problem(NeoHookean(), SquareChannel(), 5, 0.0, walls=COARSE_WALLS)
    result = steady_state(problem, problem.at_rest(0.02, 0.8), max_iterations=8, patience=4)
    assert not result.converged
    assert result.iterations <= 8


def test_a_branch_is_traced_through_its_fold():
    """From rest upward at low Ca; the fold is where Ca is largest, and both sides of it are steady states."""
    problem = Problem(NeoHookean(), SquareChannel(), 4, 1e-3, walls=COARSE_WALLS)
    points = []
    for point in traced(problem, near_rest(problem, 0.8).result):
        points.append(point)
        if not point.rising:
            break
    limit = fold(problem, points[-2], points[-1])
    highest = max(point.log_ca for point in points)
    assert highest <= limit.log_ca < highest + 0.01
    assert abs(limit.direction[-1]) < 0.1
    for point in (points[-1], limit):
        assert np.max(np.abs(steady_residual(problem, point.result.iterate))) < 2e-6
    between = 0.5 * (points[1].log_ca + points[2].log_ca)
    guess = interpolated(points[1], points[2], np.exp(between))
    there = steady_state(problem, guess)
    moved = np.max(np.abs(points[2].result.iterate.free - points[1].result.iterate.free))
    assert np.max(np.abs(there.iterate.free - guess.free)) < 0.02 * moved
