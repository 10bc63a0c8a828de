"""A steady state comes back from the store as it was, and starts its neighbours."""

from dataclasses import fields

import numpy as np

from capsbayes.physics.build import CaseOutcome, count_ended, variables_of
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.run import Store
from capsbayes.status import Status

SIMULATOR = Simulator(refinement=4, walls=WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5))
CASE = (0.05, 0.8)


def test_a_steady_state_comes_back_to_the_last_bit_and_starts_its_neighbour(tmp_path):
    store = Store.open(tmp_path, SIMULATOR.settings)
    state = SIMULATOR.run(capillary_number=CASE[0], size_ratio=CASE[1])
    CaseOutcome(*CASE, "rest", state.status, variables_of(state), state).save(store)
    again = CaseOutcome.find(store, *CASE, "rest", SIMULATOR.restored)
    assert again.done
    for name, value in variables_of(state).items():
        np.testing.assert_array_equal(again.variables[name], value)
    extreme = {np.argmax: ("maximum_tension", 0), np.argmin: ("minimum_tension", 1)}
    for node, (name, column) in extreme.items():
        at = node(state.principal_tensions[:, column])
        assert again.variables[name] == state.principal_tensions[at, column]
        np.testing.assert_array_equal(again.variables[f"{name}_place"], state.surface_nodes[at])
    for field in fields(state):
        np.testing.assert_array_equal(getattr(again.state, field.name), getattr(state, field.name))
    assert again.state.settings == SIMULATOR.settings
    near = [SIMULATOR.run(capillary_number=0.055, size_ratio=0.8, start=start) for start in (state, again.state)]
    assert near[0].iterations == near[1].iterations
    np.testing.assert_allclose(near[0].nodes, near[1].nodes, rtol=0, atol=1e-12)


def test_cases_that_ended_are_counted_and_other_starts_are_other_outcomes(tmp_path):
    store = Store.open(tmp_path, {})
    for status in (Status.NO_STEADY_STATE, Status.DONE):
        CaseOutcome(*CASE, "rest", status, {"slack": 0.0}).save(store)
    CaseOutcome(0.06, 0.8, 0.05, Status.RAISED, message="no inverse").save(store)
    assert count_ended(store, [CASE, (0.06, 0.8), (0.07, 0.8)]) == (2, 1)
    assert CaseOutcome.find(store, 0.06, 0.8, "rest", dict) is None
    raised = CaseOutcome.find(store, 0.06, 0.8, 0.05, dict)
    assert (raised.status, raised.message, raised.state) == (Status.RAISED, "no inverse", None)
