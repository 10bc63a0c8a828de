import pickle
from dataclasses import replace

import numpy as np
import pytest

from capsbayes import Simulator, Status
from capsbayes.errors import InputError
from capsbayes.physics.membrane import GeneralLaw
from capsbayes.physics.stokes import WallDiscretisation

COARSE_WALLS = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)
SIMULATOR = Simulator(refinement=4, bending=1e-3, walls=COARSE_WALLS)


@pytest.fixture(scope="module")
def state():
    return SIMULATOR.run(capillary_number=0.05, size_ratio=0.85)


def test_state_of_the_branch_from_rest(state):
    assert state.status is Status.DONE
    assert state.profile.parachute_depth > 0.05
    assert 1.0 < state.velocity_ratio < 1.6
    assert state.residual < 1e-7


def test_two_ways_to_a_case_meet(state):
    """Straight from the first state, and over a neighbour at another Ca and size."""
    detour = SIMULATOR.run(capillary_number=0.06, size_ratio=0.82, start=state)
    back = SIMULATOR.run(capillary_number=0.05, size_ratio=0.85, start=detour)
    np.testing.assert_allclose(back.nodes, state.nodes, atol=1e-6)
    assert back.velocity_ratio == pytest.approx(state.velocity_ratio, abs=1e-7)


def test_volume_and_centroid_are_those_of_the_sphere_at_the_origin(state):
    membrane = SIMULATOR.problem.membrane(0.85)
    inside = membrane.enclosure(membrane.mesh.reduced(state.nodes))
    assert inside.volume == pytest.approx(4 / 3 * np.pi * 0.85**3, rel=1e-7)
    assert inside.moment == pytest.approx(0.0, abs=1e-7)


def test_state_of_another_mesh_is_a_start(state):
    simulator = Simulator(refinement=5, bending=1e-3, walls=COARSE_WALLS)
    finer = simulator.run(capillary_number=0.05, size_ratio=0.85, start=state)
    assert finer.status is Status.DONE
    assert finer.velocity_ratio == pytest.approx(state.velocity_ratio, rel=5e-3)


def test_a_state_is_carried_to_another_membrane_and_case_at_once(state):
    """Law, bending energy, B, inflation, Ca and size together; back from there is where it came from."""
    other = Simulator(
        law=GeneralLaw(2.0, 0.4),
        refinement=4,
        bending=6e-4,
        pre_inflation=0.01,
        walls=COARSE_WALLS,
        bending_energy="curvature",
    )
    there = other.run(capillary_number=0.06, size_ratio=0.88, start=state)
    assert there.status is Status.DONE
    assert there.settings["law"] == "general K_s/G_s = 2, h = 0.4"
    assert np.max(np.abs(there.nodes - state.nodes)) > 0.02
    back = SIMULATOR.run(capillary_number=0.05, size_ratio=0.85, start=there)
    np.testing.assert_allclose(back.nodes, state.nodes, atol=1e-6)


@pytest.mark.slow
def test_a_start_that_leads_nowhere_is_told(state):
    other = replace(SIMULATOR, law=GeneralLaw(2.0, 0.0))
    ended = other.run(capillary_number=3.0, size_ratio=1.2, start=state)
    assert ended.status is Status.NOT_CONVERGED
    assert ended.detail == "The branch was followed to Ca = 0.05, a/l = 0.85."
    with pytest.raises(InputError, match="start: expected a state that converged, got NOT_CONVERGED"):
        other.run(capillary_number=0.05, size_ratio=0.85, start=ended)


def test_states_and_simulators_survive_pickling(state):
    copy = pickle.loads(pickle.dumps(state))
    np.testing.assert_array_equal(copy.surface_nodes, state.surface_nodes)
    assert pickle.loads(pickle.dumps(SIMULATOR)) == SIMULATOR


def test_stiff_pre_inflation_keeps_the_rear_convex():
    state = Simulator(refinement=4, pre_inflation=0.1, walls=COARSE_WALLS).run(capillary_number=0.05, size_ratio=0.8)
    assert state.status is Status.DONE
    assert state.profile.parachute_depth == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bending": -1}, "bending: expected a number from 0 to 1, got -1"),
        ({"bending_energy": "rubber"}, "bending_energy: expected one of displacement, curvature, got 'rubber'"),
        ({"refinement": 3}, "refinement: expected at least 4, got 3"),
        ({"rest_aspect": 0.4}, "rest_aspect: expected a number from 0.5 to 2, got 0.4"),
        ({"rest_aspect": float("nan")}, "rest_aspect: expected a number from 0.5 to 2, got nan"),
        ({"cross_section": "circular", "corner_radius": 0.1}, "corner_radius: expected 0, or a square cross-section"),
    ],
)
def test_impossible_simulators_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        Simulator(**settings)
