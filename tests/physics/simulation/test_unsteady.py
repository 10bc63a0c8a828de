"""A capsule on the way: at rest first, steady in the end, and as the transient has it in between."""

import numpy as np
import pytest

from capsbayes import Simulator
from capsbayes.errors import InputError
from capsbayes.physics.simulator import UnsteadySimulator

CASE = {"capillary_number": 0.06, "size_ratio": 0.85}
SIMULATOR = Simulator(refinement=4)


@pytest.fixture(scope="module")
def steady():
    return SIMULATOR.run(**CASE)


def test_without_unsteadiness_it_is_the_simulator(steady):
    state = UnsteadySimulator(SIMULATOR).run(**CASE)
    np.testing.assert_allclose(state.nodes, steady.nodes, atol=1e-9)


@pytest.mark.slow
def test_it_is_a_moment_of_the_transient():
    state = UnsteadySimulator(SIMULATOR, 0.5).run(**CASE)
    *_, moment = SIMULATOR.transient(**CASE, until=2.0, every=2.0)
    assert state.profile.axial_extent == pytest.approx(moment.profile.axial_extent, abs=1e-4)
    assert state.velocity_ratio == pytest.approx(moment.velocity_ratio, abs=1e-4)
    assert state.residual == pytest.approx(moment.speed, rel=0.1)


@pytest.mark.slow
def test_after_a_long_time_it_is_steady(steady):
    state = UnsteadySimulator(SIMULATOR, 0.2).run(**CASE)
    assert state.profile.axial_extent == pytest.approx(steady.profile.axial_extent, abs=2e-3)
    assert state.velocity_ratio == pytest.approx(steady.velocity_ratio, abs=2e-3)


def test_settings_tell_the_time_and_the_simulator():
    entering = UnsteadySimulator(SIMULATOR, 0.5)
    assert entering.settings == {**SIMULATOR.settings, "unsteadiness": 0.5}
    assert entering.refined(5).settings["refinement"] == 5


def test_a_negative_time_is_refused():
    with pytest.raises(InputError, match="unsteadiness: expected a number not below 0"):
        UnsteadySimulator(SIMULATOR, -1.0)
