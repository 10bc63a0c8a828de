"""Derivatives along all parameters agree with differences of converged steady states."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.physics.channel import SquareChannel
from capsbayes.physics.load import changed
from capsbayes.physics.membrane import GeneralLaw
from capsbayes.physics.steady import Problem, parameter_derivatives, steady_state
from capsbayes.physics.stokes import WallDiscretisation

PROBLEM = Problem(
    GeneralLaw(2.0, 0.5),
    SquareChannel(),
    5,
    5e-3,
    0.02,
    walls=WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5),
)
STEPS = {
    "capillary_number": 1e-5,
    "size_ratio": 1e-4,
    "pre_inflation": 1e-4,
    "area_dilation_modulus": 1e-3,
    "strain_hardening": 1e-3,
    "bending": 1e-5,
}


def unknowns(iterate):
    return np.append(iterate.free, [iterate.velocity, iterate.slack])


@pytest.fixture(scope="module")
def state():
    found = steady_state(PROBLEM, PROBLEM.at_rest(0.03, 0.8), max_iterations=20, tolerance=1e-11)
    assert found.converged
    return found.iterate


@pytest.mark.parametrize("name", STEPS)
def test_derivative_is_that_of_converged_states(state, name):
    step, ends = STEPS[name], []
    for sign in (-1.0, 1.0):
        if name in ("capillary_number", "size_ratio"):
            problem, start = PROBLEM, replace(state, **{name: getattr(state, name) + sign * step})
        else:
            value = getattr(PROBLEM.law, name, None) or getattr(PROBLEM, name)
            problem, start = changed(PROBLEM, name, value + sign * step), state
        found = steady_state(problem, start, tolerance=1e-11)
        assert found.converged
        ends.append(unknowns(found.iterate))
    difference = (ends[1] - ends[0]) / (2.0 * step)
    found = parameter_derivatives(PROBLEM, state, [name])[:, 0]
    np.testing.assert_allclose(found, difference, atol=1e-3 * np.abs(difference).max())


def test_derivative_at_the_end_of_a_range_looks_inward(state):
    """The energy is linear in the hardening, so that the difference to one side is exact."""
    soft = replace(PROBLEM, law=GeneralLaw(2.0, 0.0))
    found = steady_state(soft, state, max_iterations=20, tolerance=1e-11)
    assert found.converged
    ahead = steady_state(changed(soft, "strain_hardening", 1e-4), found.iterate, tolerance=1e-11)
    difference = (unknowns(ahead.iterate) - unknowns(found.iterate)) / 1e-4
    along = parameter_derivatives(soft, found.iterate, ["strain_hardening"])[:, 0]
    np.testing.assert_allclose(along, difference, atol=1e-2 * np.abs(difference).max())
